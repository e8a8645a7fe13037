"""The next experiment: a commanded torque trajectory on which the accepted effect and its top rival part the most.

Each command of a small library is run in the accepted model, as large as the recorded torques, angles and speeds allow.
The rival is simulated on the same commands; what it can make up for by its initial states and declared parameters is
projected off, as in the diagnosis itself. What remains, in sensor standard deviations, is what the experiment would show.
"""

import io
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.control.lqr import lqr_gain
from adaptsim_jax.logs.segments import Windows, cut_windows
from adaptsim_jax.mechanisms.closed_loop import broadcasts, history_rows, run_loop
from adaptsim_jax.mechanisms.stepping import make_model
from adaptsim_jax.sysid.design.excitation import library
from adaptsim_jax.sysid.estimate.fitted import Fit, rough_gain
from adaptsim_jax.sysid.estimate.output_error import FitSettings, least_squares
from adaptsim_jax.sysid.estimate.problem import Active, Problem, any_torque
from adaptsim_jax.sysid.evaluate.power import COMMON, Power
from adaptsim_jax.sysid.select.trace import Trace

CSV = "next_experiment.csv"
SIZES = (1.0, 0.6, 0.35, 0.2)
MARGIN = 1.15  # angles and speeds may go this far beyond the recorded ones
APART = 1.0  # sensor standard deviation: two models nearer than this are one to any trial
BATCHES = 2  # of as many commands as there are trials: each costs two simulations of the recording's size


@dataclass(frozen=True)
class Rival:
    """One of two models to tell apart."""

    label: str
    active: Active
    theta: np.ndarray
    eff: np.ndarray


@dataclass(frozen=True)
class Plan:
    """time `[T]` s, torque `[T, 2]` N m to command; distance in standard deviations there and in the recording."""

    time: np.ndarray
    torque: np.ndarray
    shape: str
    separates: tuple[str, str]
    distance: float
    recorded: float
    balanced: bool

    @property
    def message(self) -> str:
        """What to run and why, for a person."""
        how = "added to what your balancing controller commands" if self.balanced else "from rest, as it stands"
        a, b = self.separates
        if self.distance < APART:
            return (
                f"No command tried tells {a} from {b}: after every refit they come less than {_short(APART)} sensor standard "
                f"deviation apart. Measure one of them by itself, at the rig; {CSV} ({self.shape}) comes closest."
            )
        times = self.distance / max(self.recorded, 1e-9)
        gain = f", {_short(times)} times as far as a trial of these" if self.recorded > 0.5 else ""
        return (
            f"Run {CSV} ({self.shape}, {self.time[-1]:.2g} s, {how}): there {a} and {b} come {_short(self.distance)} sensor "
            f"standard deviations apart after every refit{gain}."
        )

    def told(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """What the report says and what the page draws."""
        words = {"message": self.message, "csv": CSV, "separates": list(self.separates), "shape": self.shape}
        words |= {"distance": self.distance, "distance_recorded": self.recorded, "unit": "sensor standard deviations"}
        return words, {"time": self.time, "torque": self.torque, "separates": list(self.separates), "csv": CSV}


def _short(number: float) -> str:
    """Two digits, without an exponent."""
    return f"{float(f'{number:.2g}'):,.10g}"


def csv_of(time: np.ndarray, torque: np.ndarray) -> bytes:
    """Rows `time,tau1,tau2` in s and N m, each torque held to the next row."""
    text = io.StringIO()
    np.savetxt(text, np.column_stack([time, torque]), fmt="%.7g", delimiter=",", header="time,tau1,tau2", comments="")
    return text.getvalue().encode()


def next_experiment(problem: Problem, found: Trace, named: bool, powers: list[Power], seed: int = 0) -> Plan | None:
    """The command that best parts what the diagnosis left open, or None where there is nothing to part or no safe way."""
    if not any_torque(problem.recording):  # nothing says how much torque moves this rig
        return None
    ours, rival = _pair(problem, found, named, powers)
    if rival is None:
        return None
    rng = np.random.default_rng(seed)
    best: tuple[float, str, np.ndarray, np.ndarray] | None = None
    runs = _safe_runs(problem, ours, rng)
    count = len(problem.recording.trials)
    for at in range(0, min(len(runs), BATCHES * max(count, 3)), count):
        chunk = runs[at : at + count]
        windows = _as_recorded(problem, chunk)
        for run, distance in zip(chunk, _distances(problem, ours, rival, windows), strict=False):
            if np.isfinite(distance) and (best is None or distance > best[0]):
                best = distance, run.shape, run.time, run.push
    if best is None or best[0] <= 0.0:
        return None
    recorded = float(np.median(_distances(problem, ours, rival, problem.windows, found.final.candidate.refit.point.x0)))
    distance, shape, time, push = best
    return Plan(time, push, shape, (ours.label, rival.label), float(distance), recorded, _upright(problem))


def _pair(problem: Problem, found: Trace, named: bool, powers: list[Power]) -> tuple[Rival, Rival | None]:
    """What was accepted (or the declared model) and what is hardest to tell from it."""
    if named and found.added:
        effect = found.added[-1]
        ours = _of(found.final, effect)
        others = [t for t in found.tried if effect not in t.active and len(t.active) == len(found.final.active)]
        others = [t for t in others if not _holds(problem, t.active[-1], effect)]
        alike = [t for t in others if any(t.active[-1] == r for r in found.classes.get(effect, ()))]
        best = max(alike or others, key=lambda t: t.total, default=None)
        return ours, _of(best, best.active[-1]) if best is not None else _of(found.base, None)
    ours = _of(found.base, None)
    weak = [p for p in powers if p.name in COMMON and (p.name, p.where) not in found.base.active]
    tried = max(found.tried, key=lambda t: t.total, default=None)
    if tried is not None and rough_gain(tried, found.base) > 10.0:
        return ours, _of(tried, tried.active[-1])
    if not weak:
        return ours, None
    return ours, _with(problem, ours, max(weak, key=lambda p: p.smallest))


def _holds(problem: Problem, wider, effect) -> bool:
    """Whether an effect has the other as a special case: nothing can part those."""
    layout = problem.model.layout
    return wider[1] == effect[1] and effect[0] in layout.instances[layout.index(*wider)].effect.contains


def _of(model: Fit, effect) -> Rival:
    c = model.candidate
    label = "the declared model" if effect is None else f"{effect[0].replace('_', ' ')} at {effect[1]}"
    return Rival(label, c.active, c.theta, c.eff)


def _with(problem: Problem, ours: Rival, power: Power) -> Rival:
    """The declared model with an effect of the size that just matters."""
    layout, reach = problem.model.layout, problem.reach
    instance = layout.instances[layout.index(power.name, power.where)]
    j = instance.joint
    few = problem.criteria.matters * problem.torque_rms[j]
    span = max(float(reach.q_high[j] - reach.q_low[j]), 1e-3)
    size = {
        "coulomb": few, "bias": few, "quadratic_drag": few / reach.speed[j] ** 2, "spring": few / (span / 3),
        "torque_gain": problem.criteria.matters, "delay": 0.004,
    }[power.name]  # fmt: skip
    eff = ours.eff.copy()
    eff[instance.at.start] = size
    return Rival(
        f"{power.name.replace('_', ' ')} at {power.where}", (*ours.active, (power.name, power.where)), ours.theta, eff
    )


@dataclass(frozen=True)
class _Run:
    """A library command as it would run: time `[T]`, push `[T, 2]` to command, torque `[T, 2]` and state `[T, 4]`."""

    shape: str
    time: np.ndarray
    push: np.ndarray
    torque: np.ndarray
    state: np.ndarray


def _upright(problem: Problem) -> bool:
    return problem.recording.angle_zero == "upright"


def _safe_runs(problem: Problem, ours: Rival, rng: np.random.Generator) -> list[_Run]:
    """Every library command that stays within limits in our model, at its largest safe size."""
    trials = problem.recording.trials
    dt = max(float(np.median([t.dt for t in trials])), 2e-3)
    seconds = float(np.median([t.time[-1] - t.time[0] for t in trials]))
    time = dt * np.arange(int(np.clip(seconds, 2.0, 20.0) / dt))
    shapes = library(time, rng)
    push = np.stack(list(shapes.values())) * np.asarray(problem.reach.torque)
    sized = np.concatenate([s * push for s in SIZES])
    state, torque = _simulated(problem, ours, sized, dt)
    low = np.min([t.q.min(0) for t in trials], 0)
    high = np.max([t.q.max(0) for t in trials], 0)
    middle, half = 0.5 * (low + high), 0.5 * MARGIN * (high - low)
    speed = MARGIN * np.max(np.abs(problem.windows.motion_v), (0, 1))
    limit = 1.001 * np.max([np.abs(t.torque).max(0) for t in trials], 0)
    inside = np.all(np.abs(state[..., :2] - middle) <= half, (1, 2)) & np.all(np.abs(state[..., 2:]) <= speed, (1, 2))
    inside &= np.all(np.abs(torque) <= limit, (1, 2))
    out = []
    for k, name in enumerate(shapes):
        fits = [i for i in range(len(SIZES)) if inside[i * len(shapes) + k]]
        if fits:
            at = fits[0] * len(shapes) + k
            out.append(_Run(name, time, sized[at], torque[at], state[at]))
    return out


def _simulated(problem: Problem, ours: Rival, push: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """States `[K, T, 4]` and torques `[K, T, 2]` of our model under each push, from rest; upright under an LQR."""
    layout = problem.model.layout
    chosen = dict.fromkeys(name for name, _ in ours.active)
    model = make_model(problem.plant, tuple(e for e in layout.effects if e.name in chosen))
    eff = model.layout.off()
    for name, where in ours.active:
        eff[model.layout.instances[model.layout.index(name, where)].at] = ours.eff[
            layout.instances[layout.index(name, where)].at
        ]
    gain = _balance(problem, ours) if _upright(problem) else np.zeros((2, 4))
    rows = history_rows(model, eff, dt)
    start = jnp.zeros(4)
    sent, held, theta, sizes = (jnp.asarray(z, jnp.float32) for z in (push, gain, ours.theta, eff))
    state, torque = _runs(model, sent, held, theta, sizes, start, dt, rows)
    return np.asarray(state, float), np.asarray(torque, float)


@broadcasts
def _runs(model, push, gain, theta, eff, start, dt: float, history: int):
    def one(push):
        law = lambda y, past, t: push[jnp.clip(jnp.round(t / dt).astype(int), 0, len(push) - 1)] - gain @ y
        loop = run_loop(model, theta, eff, law, start, push.shape[0], dt, history)
        return loop.state, loop.command

    return jax.jit(jax.vmap(one))(push)


@broadcasts
def _balance(problem: Problem, ours: Rival) -> np.ndarray:
    """A gain `[2, 4]` that holds the rig upright, by the declared part of our model."""
    zero = jnp.zeros((2, 1))

    @jax.jit  # one program: run one by one, its operations would be a hundred to compile
    def gain(theta, scale):
        deriv = lambda x, u: problem.plant.deriv(theta, x[:, None], u[:, None], zero, zero)[:, 0]
        A, B = jax.jacfwd(deriv, (0, 1))(jnp.zeros(4), jnp.zeros(2))
        return lqr_gain(A, B, jnp.eye(4), jnp.diag(1.0 / jnp.square(scale))).gain

    return np.asarray(gain(jnp.asarray(ours.theta, jnp.float32), jnp.asarray(problem.reach.torque, jnp.float32)))


def _as_recorded(problem: Problem, runs: list[_Run]) -> Windows:
    """The runs as if they were the recording's trials, cut alike, so that compiled programs serve again."""
    noise = problem.noise.std
    sigma = np.array([noise["q1"], noise["q2"], np.inf, np.inf])
    trials, motions = [], []
    for i, trial in enumerate(problem.recording.trials):
        run = runs[min(i, len(runs) - 1)]
        time = trial.time - trial.time[0]
        at = np.clip(np.searchsorted(run.time, time + 1e-9, side="right") - 1, 0, len(run.time) - 1)
        motion = np.stack([np.interp(time, run.time, run.state[:, k]) for k in range(4)], 1)
        trials.append(SimpleNamespace(time=time, q=motion[:, :2], v=None, torque=run.torque[at]))
        motions.append((motion[:, :2], motion[:, 2:]))
    length = np.asarray(problem.windows.times)
    duration = float(np.median((length[:, -1] - length[:, 0])[problem.windows.real]))
    return cut_windows(trials, sigma, duration=duration, motions=motions, use_velocity=False)


def _distances(problem: Problem, ours: Rival, rival: Rival, windows: Windows, x0=None) -> np.ndarray:
    """Per trial, how far the rival stays from us `[N]` in standard deviations when its initial states and parameters
    have made up for what they can (linearized)."""
    results = [_at(problem, m, windows, x0) for m in (ours, rival)]
    count = len(windows.trial)
    gap = (results[1].residual - results[0].residual).reshape(count, -1)
    q, _ = np.linalg.qr(results[1].jac_state + 1e-12)
    clean = lambda z: z - q @ (np.swapaxes(q, 1, 2) @ z)
    gap, shared = clean(gap[..., None])[..., 0], clean(results[1].jac_shared)
    out = []
    for i in range(len(problem.recording.trials)):
        pick = (np.asarray(windows.trial) == i) & windows.real
        design, target = shared[pick].reshape(-1, shared.shape[2]), gap[pick].ravel()
        if not (np.all(np.isfinite(target)) and np.all(np.isfinite(design))):
            out.append(np.nan)  # one of the two ran away there: no place for an experiment
            continue
        scale = np.linalg.norm(design, axis=0) + 1e-30
        rest = target - (design / scale) @ np.linalg.lstsq(design / scale, target, rcond=1e-8)[0]
        out.append(np.linalg.norm(rest))
    return np.array(out)


def _at(problem: Problem, model: Rival, windows: Windows, x0):
    mask = problem.model.layout.mask(list(model.active))
    start = windows.start if x0 is None else x0
    return least_squares(
        problem.model, mask, windows, model.theta, model.eff, start,
        bounds=problem.bounds, settings=FitSettings(iterations=0),
    )  # fmt: skip
