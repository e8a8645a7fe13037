"""The noise floor against known noise, and the smoother against the true motion."""

import time as clock
from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.logs.noise.floor import estimate, noise_floor, smooth
from adaptsim_jax.logs.noise.smoother import fit_noise, make_prior, posterior
from adaptsim_jax.logs.quality.audit import audit
from adaptsim_jax.logs.recording import read_recording
from tests.logs.measured_files import META, real_rig, simulate, table, write


@pytest.fixture(scope="module")
def truth():
    """Clean motions by rate: `{rate: [(time, q, v, torque), ...]}`; every other arm has dry
    friction.
    """
    return {
        rate: [
            simulate(s, 4.0, rate, jitter=0.3 * (s % 2), coulomb=0.02 * (s % 2))
            for s in range(10, 14)
        ]
        for rate in (50, 100, 200, 500)
    }


def recorded(folder, motions, q_std, v_std, seed=0, meta=META):
    """A recording of the motions with white noise on angles and velocities."""
    rng = np.random.default_rng(seed)
    trials = {}
    for i, (time, q, v, torque) in enumerate(motions):
        noisy = q + q_std * rng.standard_normal(q.shape)
        trials[f"t{i}"] = table(time, noisy, v + v_std * rng.standard_normal(v.shape), torque)
    return read_recording(write(folder, trials, meta))


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "within"), [(500, 0.10), (200, 0.10), (100, 0.15)])
@pytest.mark.parametrize(("q_std", "v_std"), [(2e-4, 0.01), (1e-3, 0.03), (5e-3, 0.1)])
def test_noise_is_estimated_on_uneven_grids_and_with_dry_friction(
    truth, tmp_path, rate, within, q_std, v_std
):
    recording = recorded(tmp_path, truth[rate], q_std, v_std)
    floor = noise_floor(recording, audit(recording))
    for channel, std in floor.items():
        assert std == pytest.approx(q_std if channel[0] == "q" else v_std, rel=within), channel


def test_at_50_hz_the_estimate_is_within_a_third_where_noise_is_resolved(truth, tmp_path):
    recording = recorded(tmp_path, truth[50], 1e-3, 0.05)
    floor = noise_floor(recording, audit(recording))
    for channel, std in floor.items():
        assert std == pytest.approx(1e-3 if channel[0] == "q" else 0.05, rel=0.33), channel


def test_quantisation_sets_the_least_noise(truth, tmp_path):
    step = 2 * np.pi / 1024
    motions = [(t, np.round(q / step) * step, v, u) for t, q, v, u in truth[200]]
    recording = recorded(tmp_path, motions, 0.0, 0.02)
    checked = audit(recording)
    floor = noise_floor(recording, checked)
    assert checked.quantisation["q1"] == pytest.approx(step, rel=1e-3)
    for channel in ("q1", "q2"):
        assert step / np.sqrt(12) * 0.999 <= floor[channel] < 1.5 * step / np.sqrt(12)


def test_declared_noise_is_used_unless_the_data_contradict_it(truth, tmp_path):
    near = META + "[noise]\nq = 0.0012\nv = 0.03\n"
    recording = recorded(tmp_path / "near", truth[200], 1e-3, 0.03, meta=near)
    floor = noise_floor(recording, audit(recording))
    assert floor["q1"] == 0.0012
    low = META + "[noise]\nq1 = 0.0001\n"
    recording = recorded(tmp_path / "low", truth[200], 1e-3, 0.03, meta=low)
    floor = noise_floor(recording, audit(recording))
    assert floor["q1"] == pytest.approx(1e-3, rel=0.1)
    high = META + "[noise]\nq1 = 0.01\n"
    recording = recorded(tmp_path / "high", truth[200], 1e-3, 0.03, meta=high)
    floor = noise_floor(recording, audit(recording))
    assert floor["q1"] == 0.01


def test_repeats_give_the_noise_and_copies_do_not(truth, tmp_path):
    motion = truth[200][0]
    recording = recorded(tmp_path / "repeats", [motion] * 3, 1e-3, 0.03)
    floor = noise_floor(recording, audit(recording))
    assert floor["q1"] == pytest.approx(1e-3, rel=0.1) and floor["v2"] == pytest.approx(
        0.03, rel=0.1
    )
    one = recorded(tmp_path / "one", [motion], 1e-3, 0.03)
    copies = replace(one, trials=tuple(replace(one.trials[0], name=str(i)) for i in range(3)))
    assert noise_floor(copies, audit(copies)) == noise_floor(one, audit(one))


def test_the_smoother_equals_a_dense_least_squares_solution():
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.5, 2.0, 40))
    y = np.sin(time / 6) + 0.1 * rng.standard_normal(40)
    prior = make_prior(time, 3)
    mean, _, _ = posterior(prior, 1e-2, [np.ones(40), None, None], [y, None, None])
    dense = np.zeros((120, 120))
    for k in range(6):
        for col in range(120 - k):
            dense[col + k, col] = dense[col, col + k] = prior.bands[k, col]
    # A quadratic in time costs the white-jerk prior nothing.
    s = (time - time[0]) / prior.step
    free = np.stack([s**2 / 2, s, np.ones(40)], axis=1).reshape(-1)
    assert abs(free @ dense @ free) < 1e-6 * np.abs(dense).max()
    pick = np.zeros((40, 120))
    pick[np.arange(40), 3 * np.arange(40)] = 1.0
    expected = np.linalg.solve(dense / 1e-2 + pick.T @ pick, pick.T @ y).reshape(40, 3)
    np.testing.assert_allclose(mean, expected, rtol=1e-6, atol=1e-9)


def test_the_likelihood_finds_the_walk_that_made_the_data():
    rng = np.random.default_rng(2)
    jerk = rng.standard_normal(3000) * 0.02
    signal = np.cumsum(np.cumsum(np.cumsum(jerk)))
    fits = [
        fit_noise(np.arange(300.0), c + 0.5 * rng.standard_normal(300), 3)
        for c in signal.reshape(10, 300)
    ]
    assert np.median([f.std for f in fits]) == pytest.approx(0.5, rel=0.05)
    assert np.median([f.log_ratio for f in fits]) == pytest.approx(
        np.log((0.02 / 0.5) ** 2), abs=0.7
    )


@pytest.mark.parametrize("rate", [50, 200])
def test_the_smoother_beats_the_raw_data_and_uses_velocities(truth, tmp_path, rate):
    recording = recorded(tmp_path, truth[rate], 1e-3, 0.03)
    floor = noise_floor(recording, audit(recording))
    without = {c: s for c, s in floor.items() if c[0] == "q"}
    q_error, v_error, blind = [], [], []
    for trial, (_, q, v, _) in zip(recording.trials, truth[rate], strict=True):
        q_smooth, v_smooth = smooth(trial, floor)
        q_error.append(np.mean((q_smooth - q) ** 2))
        v_error.append(np.mean((v_smooth - v) ** 2))
        q_alone, v_alone = smooth(replace(trial, v=None), without)
        assert np.all(np.any(q_smooth != q_alone, axis=0))
        blind.append(np.mean((v_alone - v) ** 2))
    share = {50: 0.85, 200: 0.5}[rate]
    assert np.sqrt(np.median(q_error)) < share * 1e-3 and np.sqrt(np.median(v_error)) < share * 0.03
    assert np.median(v_error) < np.median(blind)


def test_a_lagging_velocity_is_not_used(truth, tmp_path):
    motions = [
        (t, q, np.stack([np.interp(t - 0.03, t, v[:, j]) for j in range(2)], axis=1), u)
        for t, q, v, u in truth[200]
    ]
    recording = recorded(tmp_path, motions, 5e-4, 0.01)
    floor = noise_floor(recording, audit(recording))
    for trial, (_, q, _, _) in zip(recording.trials, truth[200], strict=True):
        found = smooth(trial, floor)
        np.testing.assert_array_equal(found, smooth(replace(trial, v=None), floor))
        assert np.sqrt(np.mean((found[0] - q) ** 2)) < 5e-4


def test_a_long_trial_is_smoothed_in_a_fraction_of_a_second(tmp_path):
    t = np.arange(5000) / 500
    q = np.stack([np.sin(3 * t), np.sin(5 * t)], axis=1)
    v = np.stack([3 * np.cos(3 * t), 5 * np.cos(5 * t)], axis=1)
    recording = recorded(tmp_path, [(t, q, v, np.zeros_like(q))], 1e-3, 0.02)
    floor = noise_floor(recording, audit(recording))
    spent = []
    for _ in range(3):
        start = clock.process_time()
        smooth(recording.trials[0], floor)
        spent.append(clock.process_time() - start)
    # 0.1 s is usual; ten times that would mean that the cost is no longer linear in the rows.
    assert min(spent) < 1.0


def test_a_constant_signal_has_no_noise():
    assert estimate(np.arange(100.0), np.full(100, 3.0))[0] == 0.0


@pytest.mark.parametrize("rig", ["rig_a", "rig_c"])
def test_the_real_rigs_have_encoder_noise(rig):
    recording = read_recording(real_rig(rig))
    floor = noise_floor(recording, audit(recording))
    for channel in ("q1", "q2"):
        # Between the least value that 14 bits allow (1.1e-4 rad) and one whole step of them.
        assert 1.1e-4 <= floor[channel] <= 3.9e-4
