"""Windows, simulation and fit on recordings made with SciPy's integrator."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.logs.segments import cut_windows, local_motion
from adaptsim_jax.mechanisms.registry import make_plant
from adaptsim_jax.sysid.estimate.output_error import least_squares
from adaptsim_jax.sysid.forward import driven, make_model, simulate
from tests.sysid.small_rig import GEOMETRY, SIGMA, TRUE, make_trials

FEW = tuple(e for e in catalogue() if e.name in ("coulomb", "bias", "delay", "presliding"))
LEVEL = 0.02


def rub(t, q, v, u):
    """Coulomb friction at joint 2, as steep as SciPy's adaptive steps bear."""
    return np.array([0.0, -LEVEL * np.tanh(v[1] / 2e-3)])


@pytest.fixture(scope="module")
def clean():
    return make_trials(seed=3, count=3)


@pytest.fixture(scope="module")
def rubbing():
    return make_trials(seed=4, count=3, extra=rub)


@pytest.fixture(scope="module")
def model():
    return make_model(make_plant("rigid_body", "hanging", GEOMETRY), FEW)


def start(model, trials):
    motions = [local_motion(t.time, t.q, t.v) for t in trials]
    return model.plant.initial_theta([(t.time, *m, t.torque) for t, m in zip(trials, motions, strict=True)])


def chi_square(result, windows):
    return 2 * result.cost.sum() / (windows.weight > 0).sum()


def fitted(model, trials, active=(), **kwargs):
    windows = cut_windows(trials, SIGMA)
    return least_squares(model, model.layout.mask(list(active)), windows, start(model, trials), **kwargs), windows


def test_regression_starts_near_the_truth(model, clean):
    np.testing.assert_allclose(start(model, clean), TRUE, rtol=0.1)


@pytest.mark.slow
def test_declared_fit_finds_the_truth_within_its_errors(model, clean):
    result, windows = fitted(model, clean)
    assert result.ok and result.names == model.plant.theta_names
    error = np.sqrt(np.diag(result.covariance))
    assert np.all(np.abs(result.theta - TRUE) < 4 * error)
    assert 0.9 < chi_square(result, windows) < 1.1
    assert np.all(error < 0.01 * TRUE)


def test_friction_is_found_and_the_declared_model_cannot_replace_it(model, rubbing):
    without, windows = fitted(model, rubbing)
    result, _ = fitted(model, rubbing, [("coulomb", "joint2")])
    level = result.eff[model.layout.instances[model.layout.index("coulomb", "joint2")].at][0]
    assert chi_square(without, windows) > 3
    assert chi_square(result, windows) < 1.15  # steps of 5 ms turn round within a row: the rest is what that costs
    assert level == pytest.approx(LEVEL, rel=0.02)
    assert "coulomb/joint2/level" in result.names


def test_one_program_serves_every_mask_and_every_held_out_trial(model, rubbing):
    from adaptsim_jax.sysid.estimate.output_error import _solve

    compiled = lambda: len(_solve.programs) + _solve.plain._cache_size()
    fitted(model, rubbing)
    before = compiled()
    fitted(model, rubbing, [("delay", "joint1"), ("bias", "joint2")])
    fitted(model, rubbing, [("presliding", "joint2")], trial_weight=np.array([1.0, 0.0, 1.0]))
    assert compiled() == before > 0


def test_left_out_trial_does_not_inform_the_parameters(model, rubbing):
    bent = [*rubbing[:2], SimpleNamespace(**{**vars(rubbing[2]), "torque": 2.0 * rubbing[2].torque})]
    weight = np.array([1.0, 1.0, 0.0])
    a, _ = fitted(model, rubbing, [("coulomb", "joint2")], trial_weight=weight)
    windows = cut_windows(bent, SIGMA)
    b = least_squares(model, a.mask, windows, a.theta, a.eff, a.x0, trial_weight=weight)
    np.testing.assert_allclose(a.theta, b.theta, rtol=2e-3)
    held_out = np.asarray(windows.trial)[windows.real] == 2
    assert b.cost[windows.real][held_out].mean() > 10 * b.cost[windows.real][~held_out].mean()


def test_known_parameters_stay(clean):
    plant = make_plant("rigid_body", "hanging", GEOMETRY, {"b1": 0.06})
    result, _ = fitted(make_model(plant, FEW), clean)
    assert result.theta[4] == 0.06 and "b1" not in result.names


@pytest.mark.slow
def test_joint_one_offset_is_reported_as_singular_with_the_tilt(clean):
    effects = tuple(e for e in catalogue() if e.name in ("tilt", "encoder_offset"))
    plant = make_plant("rigid_body", "hanging", GEOMETRY)
    result, _ = fitted(make_model(plant, effects), clean, [("tilt", "base"), ("encoder_offset", "joint1")])
    assert result.condition > 1e6
    shares = result.singular[0][1]
    assert {"tilt/base/angle", "encoder_offset/joint1/offset"} <= set(shares)


@pytest.mark.slow
def test_without_velocities_and_unevenly(model):
    trials = make_trials(seed=5, count=3, velocity=False)
    keep = np.random.default_rng(0).random(len(trials[0].time)) > 0.1
    result, windows = fitted(model, trials)
    assert windows.measured.shape[2] == 2 and 0.85 < chi_square(result, windows) < 1.15
    gappy = [SimpleNamespace(**{k: None if v is None else v[keep] for k, v in vars(t).items()}) for t in trials]
    assert cut_windows(gappy, SIGMA).dt.max() < 0.0075  # long steps are split


def test_windows_begin_where_something_was_measured():
    """On which side of a play a stretch begins, only its first reading tells: missing rows and faulty ones are passed over."""
    trials = make_trials(seed=5, count=2, velocity=False)
    present = np.r_[np.arange(0, 98), np.arange(103, 400)]  # a row every 5 ms; the first window would end in the gap
    gappy = [SimpleNamespace(**{k: None if v is None else v[present] for k, v in vars(t).items()}) for t in trials]
    gappy[1].q = gappy[1].q.copy()
    gappy[1].q[100:103] = np.nan
    windows = cut_windows(gappy, SIGMA)
    weight, count = np.asarray(windows.weight), [int((windows.trial[windows.real] == k).sum()) for k in (0, 1)]
    assert np.all(weight[windows.real][:, 0] > 0) and count == [4, 4]
    ends, starts = windows.times[windows.real][:, -1], windows.times[windows.real][:, 0]
    same = np.diff(windows.trial[windows.real]) == 0
    jumps = (starts[1:] - ends[:-1])[same]
    assert np.all(jumps > -1e-9) and np.all(jumps < 0.03)  # no more is lost than is missing


def test_commands_keep_their_impulse_through_merging_and_splitting(model, clean):
    fine = [SimpleNamespace(**vars(t)) for t in clean]
    for rate in (250.0, 60.0):
        windows = cut_windows(fine, SIGMA, max_rate=rate)
        eff, mask = model.layout.off(), model.layout.mask([])
        with jax.enable_x64(True):
            drive = jax.jit(driven)(model, TRUE, eff, mask, windows)
        got = (np.asarray(drive.u) * np.asarray(drive.dt)[:, None]).sum(0).T
        for k in np.flatnonzero(windows.real)[:3]:
            first, last = windows.rows[k, 0], windows.rows[k, -1]
            u, dt = clean[windows.trial[k]].torque, np.diff(clean[windows.trial[k]].time)
            np.testing.assert_allclose(got[k], (u[first:last] * dt[first:last, None]).sum(0), atol=1e-9)


@pytest.mark.slow
def test_simulation_agrees_with_scipy_to_the_last_micro_radian(model):
    (trial,) = make_trials(seed=6, count=1, noise=0.0)
    windows = cut_windows([trial], SIGMA, duration=1.0)
    x0 = np.concatenate([trial.q, trial.v], 1)[windows.rows[:, 0]]
    with jax.enable_x64(True):
        y, _ = jax.jit(simulate)(model, TRUE, model.layout.off(), model.layout.mask([]), windows, x0)
    gap = np.abs(np.asarray(y) - windows.measured) * (windows.weight > 0)
    assert gap[..., :2].max() < 1e-6  # Runge-Kutta 4 at 5 ms on motions of a few hertz


def test_a_trial_that_is_too_short_is_refused(clean):
    stub = SimpleNamespace(**{k: v[:3] for k, v in vars(clean[0]).items()})
    with pytest.raises(BadInput, match="too short"):
        cut_windows([stub], SIGMA)


def test_a_vibration_spoils_no_start(model):
    """A motor on a soft coupling shakes its encoder: balances from point to point follow the shaking, averaged ones do not."""
    trials = make_trials(seed=5, count=4, seconds=3.0, noise=0.1)
    shaken = []
    for k, t in enumerate(trials):
        phase = 2 * np.pi * 14.0 * t.time + k
        q, v = t.q.copy(), t.v.copy()
        q[:, 0] += 0.02 * np.sin(phase)
        v[:, 0] += 0.02 * 2 * np.pi * 14.0 * np.cos(phase)
        shaken.append((t.time, q, v, t.torque))
    away = lambda theta: np.abs(theta / TRUE - 1.0)[:4].max()  # damping is small beside the rest
    point, averaged = away(model.plant.initial_theta(shaken)), away(model.plant.averaged_theta(shaken))
    assert averaged < 0.1 and 3.0 * averaged < point


def test_averaged_balances_agree_with_the_others(model, clean):
    motions = [(t.time, *local_motion(t.time, t.q, t.v), t.torque) for t in clean]
    np.testing.assert_allclose(model.plant.averaged_theta(motions), TRUE, rtol=0.15)
