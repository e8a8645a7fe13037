"""The audit: each fault put into clean data is found, and clean data come through without one."""

from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.pendulum import read_pendulum
from adaptsim_jax.logs.quality.audit import audit, usable, without_copies
from adaptsim_jax.logs.quality.consistency import (
    command_agreement,
    lattice_step,
    velocity_agreement,
)
from adaptsim_jax.logs.quality.pendulum_design import check_conventions
from tests.logs.measured_files import META, real_rig, simulate, table, write


@pytest.fixture(scope="module")
def motions():
    """Three noisy trials of the simulated arm: `(time, q, v, torque)` each."""
    rng = np.random.default_rng(5)
    made = []
    for seed in range(3):
        time, q, v, torque = simulate(seed, seconds=3.0)
        made.append(
            (
                time,
                q + 5e-4 * rng.standard_normal(q.shape),
                v + 0.01 * rng.standard_normal(v.shape),
                torque,
            )
        )
    return made


@pytest.fixture(scope="module")
def clean(motions, tmp_path_factory):
    """The clean recording."""
    trials = {f"trial_{i:02d}": table(*m) for i, m in enumerate(motions)}
    return read_pendulum(write(tmp_path_factory.mktemp("clean"), trials))


def changed(recording, change, trials=None):
    """The recording with `change(trial) -> fields` applied to some trials (all by default)."""
    names = trials or [t.name for t in recording.trials]
    return replace(
        recording,
        trials=tuple(replace(t, **change(t)) if t.name in names else t for t in recording.trials),
    )


def kinds(found, severity=("warn", "fault")):
    return {f.kind for f in found.findings if f.severity in severity}


def test_clean_data_pass_without_a_warning(clean):
    found = audit(clean)
    assert not found.fault and kinds(found) == set() and found.exclude == ()
    assert all(keep.all() for keep in found.valid.values())
    assert found.of("sampling")[0].value == pytest.approx(200, rel=1e-6)
    assert len(found.of("excitation")) == 6


def test_a_stuck_sensor_is_a_fault_in_most_trials_and_an_exclusion_in_one(clean):
    def stick(t):
        return {"q": np.stack([t.q[:, 0], np.full(len(t.q), 0.3)], axis=1)}

    found = audit(changed(clean, stick))
    assert found.fault and "q2 stands still in 3 of 3" in found.message
    one = audit(changed(clean, stick, ["trial_01"]))
    assert not one.fault and one.exclude == ("trial_01",)
    assert [t.name for t in usable(clean, one).trials] == ["trial_00", "trial_02"]


def test_a_sensor_that_freezes_for_a_while_loses_those_rows_only(clean):
    def freeze(t):
        q = t.q.copy()
        start = 40 + int(np.argmax(np.abs(t.v[40:-60, 0])))
        q[start : start + 20, 0] = q[start, 0]
        return {"q": q}

    found = audit(changed(clean, freeze, ["trial_00"]))
    assert "frozen" in kinds(found) and not found.fault
    assert 20 <= np.sum(~found.valid["trial_00"]) <= 22 and found.valid["trial_01"].all()


@pytest.mark.parametrize(("scale", "fault"), [(-1.0, True), (0.1, True), (6.0, True), (1.1, False)])
def test_velocity_that_contradicts_the_angles(clean, scale, fault):
    found = audit(changed(clean, lambda t: {"v": t.v * np.array([1.0, scale])}))
    assert found.fault is fault
    measured = (found.of("velocity") + found.of("velocity_scale"))[0]
    assert measured.where == "v2" and measured.value == pytest.approx(scale, rel=0.03)


def test_velocity_from_elsewhere_is_a_fault(clean):
    rng = np.random.default_rng(0)
    found = audit(changed(clean, lambda t: {"v": rng.standard_normal(t.v.shape)}))
    assert found.fault and "contradicts the angle's slope" in found.message


@pytest.mark.parametrize("lag_ms", [5, 20])
def test_the_lag_of_a_velocity_filter_is_measured(motions, lag_ms):
    time, q, v, _ = motions[0]
    late = np.interp(time - lag_ms * 1e-3, time, v[:, 0])
    agreement = velocity_agreement(time, q[:, 0], late)
    assert agreement.lag == pytest.approx(lag_ms * 1e-3, rel=0.15)
    assert agreement.gain == pytest.approx(1.0, abs=0.03)


def test_command_gain_and_lag_are_measured(motions):
    time, _, _, torque = motions[0]
    measured = 0.8 * np.interp(time - 0.0175, time, torque[:, 0]) + 0.05
    agreement = command_agreement(time, torque[:, 0], measured)
    assert agreement.lag == pytest.approx(0.0175, abs=0.002) and agreement.gain == pytest.approx(
        0.8, rel=0.02
    )


def test_gaps_jitter_spikes_wraps_and_clipping_are_found(clean):
    def gap(t):
        keep = np.r_[0:200, 220 : len(t.time)]
        return {k: getattr(t, k)[keep] for k in ("time", "q", "v", "u")}

    assert audit(changed(clean, gap)).of("gap")[0].value == pytest.approx(0.105, rel=0.01)

    def spike(t):
        q = t.q.copy()
        q[150, 1] += 1.0
        return {"q": q}

    found = audit(changed(clean, spike, ["trial_02"]))
    assert kinds(found) == {"spike"} and np.flatnonzero(~found.valid["trial_02"]).tolist() == [150]

    def clip(t):
        return {"u": np.clip(t.u, -0.2, 0.2)}

    clipped = audit(changed(clean, clip)).of("saturation")
    assert {f.where for f in clipped} == {"tau1", "tau2"}


def test_velocities_made_from_the_angles_are_told(clean):
    def derive(t):
        v = np.zeros_like(t.q)
        v[1:] = np.diff(t.q, axis=0) / np.diff(t.time)[:, None]
        return {"v": v}

    derived = changed(clean, derive)
    found = audit(derived)
    assert len(found.of("velocity_derived")) == 6 and not found.fault
    assert all(t.v is None for t in usable(derived, found).trials)
    assert not audit(clean).of("velocity_derived")
    assert all(t.v is not None for t in usable(clean, audit(clean)).trials)


def test_wraps_are_taken_out(motions, tmp_path):
    def wrapped(q):
        return (q + np.pi + 3.0) % (2 * np.pi) - np.pi

    turned = {f"{i}": table(t, wrapped(q), v, u) for i, (t, q, v, u) in enumerate(motions)}
    read = read_pendulum(write(tmp_path / "wrapped", turned))
    assert any("jumps of whole turns taken out" in note for note in read.notes)
    assert not audit(read).fault
    for (_, before, _, _), after in zip(motions, read.trials, strict=True):
        np.testing.assert_allclose(np.diff(after.q, axis=0), np.diff(before, axis=0), atol=1e-12)


@pytest.mark.parametrize("step", [2 * np.pi / 4096, 3.8147e-4, 0.01])
def test_quantisation_steps_are_recovered(motions, step):
    q = motions[0][1][:, 0]
    assert lattice_step(np.round(q / step) * step) == pytest.approx(step, rel=1e-4)
    assert lattice_step(np.round(np.round(q / step) * step, 6)) == pytest.approx(step, rel=1e-3)
    assert lattice_step(q) == 0.0


def test_copies_are_found_and_counted_once(clean):
    copies = tuple(replace(t, name=f"{t.name}_copy") for t in clean.trials)
    doubled = replace(clean, trials=clean.trials + copies)
    assert without_copies(doubled) == replace(doubled, trials=clean.trials)
    found = audit(doubled)
    assert not found.fault
    assert [t.name for t in usable(doubled, found).trials] == [t.name for t in clean.trials]


def test_a_wrong_angle_zero_is_refused(motions, tmp_path):
    trials = {f"trial_{i:02d}": table(*m) for i, m in enumerate(motions)}
    other = write(tmp_path, trials, META.replace("hanging", "upright"))
    with pytest.raises(BadInput, match="angles look to be zero when hanging"):
        check_conventions(read_pendulum(other))


def test_rest_where_gravity_forbids_it_is_warned_of(tmp_path):
    time, q, v, torque = simulate(0, seconds=2.0)
    q, v = q - q[0], v.copy()
    q[:30], v[:30], torque = q[0], 0.0, np.zeros_like(torque)
    trials = {"t": table(time, q + np.array([1.2, 0.0]), v, torque)}
    (found,) = check_conventions(read_pendulum(write(tmp_path, trials)))
    assert (found.kind, found.severity) == ("angle_zero", "warn")


def test_an_arm_at_rest_teaches_nothing(clean):
    still = changed(clean, lambda t: {"q": 1e-3 * t.q, "v": 1e-3 * t.v})
    assert audit(still).fault and "nothing can be learned" in audit(still).message


@pytest.mark.parametrize("rig", ["rig_a", "rig_c"])
def test_the_real_rigs_are_quantised_and_have_no_fault(rig):
    found = audit(read_pendulum(real_rig(rig)))
    assert not found.fault and found.exclude == ()
    # Both drivers read angles with 14 bits a turn: 2 pi / 2^14 = 3.8e-4 rad.
    for channel in ("q1", "q2"):
        assert found.quantisation[channel] == pytest.approx(2 * np.pi / 2**14, rel=0.01)
    assert found.quantisation["tau1"] == pytest.approx(5.861e-3, rel=0.01)
