"""From a specification to a recording: draw the rig, the trials and the effects, size them, run."""

from dataclasses import dataclass, field

import numpy as np

from tests.generators import conditions, effects, forces, sizing
from tests.generators.conditions import CONDITIONS, Condition
from tests.generators.excitation import OPEN_KINDS, Trial, make_trial
from tests.generators.recording import Dataset
from tests.generators.simulate import Drive, Run, simulate
from tests.generators.worlds import Rig, draw_rig, lanes_of, mass_matrix

BATCH = 24  # data sets simulated together
SIZING_STEP = 2.5e-3


@dataclass(frozen=True)
class Spec:
    """What to make. effects: (name, joint 1 | 2 | 0 for the base, multiple of the size that just
    matters).
    """

    seed: int
    condition: str = "clean"
    effects: tuple[tuple[str, int, float], ...] = ()
    world: str = "rigid_body"
    engine: str = "scipy"
    n_trials: int = 6
    seconds: float = 6.0
    rate: float = 200.0
    angle_zero: str | None = None  # None: hanging, one rig in eight upright
    declare_noise: bool = False


@dataclass
class Draft:
    """One data set being made."""

    spec: Spec
    condition: Condition
    rig: Rig
    trials: list[Trial]
    lanes: slice = field(default_factory=lambda: slice(0, 0))
    sensor: dict = field(default_factory=dict)
    hidden: list[dict] = field(default_factory=list)  # name, joint, multiple, params

    def valid(self, rows: int) -> np.ndarray:
        """Which rows of which trial are real rather than padding, `[trials, rows]`; the last has no
        torque after.
        """
        return np.arange(rows)[None] < np.array([[len(t.times) - 1] for t in self.trials])


def stream(spec: Spec, tag: int) -> np.random.Generator:
    """A random stream of its own for each purpose, so that one seed means the same rig under any
    condition.
    """
    return np.random.default_rng([spec.seed, tag])


def make_dataset(seed: int, condition: str = "clean", effects=(), **kwargs) -> Dataset:
    """One data set (see `Spec`). Batches are far faster: `make_datasets`."""
    hidden = tuple((str(n), int(j), float(m)) for n, j, m in effects)
    return make_datasets([Spec(seed, condition, hidden, **kwargs)])[0]


def make_datasets(specs: list[Spec]) -> list[Dataset]:
    """Many data sets, simulated together in batches of the same world and engine."""
    out: list[Dataset | None] = [None] * len(specs)
    groups: dict[tuple, list[int]] = {}
    for i, s in enumerate(specs):
        groups.setdefault((s.world, s.engine, bool(s.effects)), []).append(i)
    for (_, engine, _), members in groups.items():
        for at in range(0, len(members), BATCH):
            chunk = members[at : at + BATCH]
            made = _batch([specs[i] for i in chunk], engine)
            for i, ds in zip(chunk, made, strict=True):
                out[i] = ds
    return [ds for ds in out if ds is not None]


def _batch(specs: list[Spec], engine: str) -> list[Dataset]:
    drafts = [draft(s) for s in specs]
    drive = stack(drafts)
    nominal = _tame(drafts, drive)
    _hide(drafts, drive, nominal)
    _sensors(drafts, drive, nominal)
    if engine == "mujoco":
        from tests.generators.mujoco_engine import simulate_mujoco  # only this engine needs mujoco

        run = simulate_mujoco(drafts, drive)
    else:
        table = effect_table(drafts, drive.times.shape[1])
        run = simulate(_lanes(drafts), table, drive, table.step())
        _tell_widths(drafts, table.step())
    return [_finish(d, run, drive) for d in drafts]


def draft(spec: Spec) -> Draft:
    """Rig and trials of a specification, nothing hidden yet."""
    c = CONDITIONS[spec.condition]
    rng = stream(spec, 0)
    zero = spec.angle_zero or ("upright" if rng.random() < 0.125 else "hanging")
    zero = "upright" if spec.world == "linearized" else zero
    rig = draw_rig(stream(spec, 1), spec.world, zero)
    kinds = c.kinds or (("balance",) if zero == "upright" else OPEN_KINDS)
    if zero == "upright" and "open_upright" not in kinds:
        kinds = ("balance",)
    rng = stream(spec, 2)
    rate = float(rng.choice(c.rates)) if c.rates else spec.rate
    trials = []
    for i in range(c.n_trials or spec.n_trials):
        times = conditions.row_times(rng, c, rate, c.seconds or spec.seconds)
        trials.append(make_trial(rng, rig, kinds[i % len(kinds)], times))
    return Draft(spec, c, rig, trials)


def _lanes(drafts: list[Draft]):
    return lanes_of([d.rig for d in drafts], [len(d.trials) for d in drafts])


def stack(drafts: list[Draft]) -> Drive:
    """All trials of all data sets side by side, padded at the end by rows of no duration; no noise
    yet.
    """
    at = 0
    for d in drafts:
        d.lanes = slice(at, at := at + len(d.trials))
    trials = [t for d in drafts for t in d.trials]
    rows, n = max(len(t.times) for t in trials), at

    def pad(x):
        return np.concatenate([x, np.repeat(x[-1:], rows - len(x), 0)])

    def lane(name):
        return np.stack([pad(getattr(t, name)) for t in trials], -1)

    limit = np.concatenate(
        [np.repeat(4.0 * d.rig.gravity_torque()[:, None], len(d.trials), 1) for d in drafts], 1
    )
    phase = np.concatenate([stream(d.spec, 3).uniform(0, 2 * np.pi, len(d.trials)) for d in drafts])
    return Drive(
        times=lane("times"),
        feedforward=lane("feedforward"),
        gain=np.stack([t.gain for t in trials], -1),
        reference=lane("reference"),
        limit=limit,
        start=np.stack([t.start for t in trials], -1),
        noise=np.zeros((rows, 4, n)),
        quantum=np.zeros((2, n)),
        disturbance=np.zeros((rows, 2, n)),
        free_phase=phase,
    )


def _tame(drafts: list[Draft], drive: Drive) -> Run:
    """Run without effects; halve the torques of trials that spin over, up to three times."""
    p = _lanes(drafts)
    for _ in range(4):
        run = simulate(p, effects.Table(drive.times.shape[1]), drive.quiet(), SIZING_STEP)
        fast = np.abs(run.state).max(0)
        wild = ((fast[:2].max(0) > 3.8) | (fast[2:].max(0) > 20)) & (
            np.abs(drive.feedforward).max((0, 1)) > 0
        )
        if p.linear or not wild.any():
            break
        drive.feedforward[..., wild] *= 0.6
    return run


def ruler(d: Draft, run: Run, joint: int) -> effects.Scale:
    """The scales of one joint in a nominal run."""
    valid = d.valid(len(run.times))

    def pick(x, j):
        return x[:, j, d.lanes].T[valid]

    u, q, v = pick(run.command, joint), pick(run.state, joint), pick(run.state, 2 + joint)
    low, high = np.quantile(q, [0.02, 0.98])
    rms = np.sqrt(np.mean(u**2)) + 1e-6
    inertia = d.rig.inertia[joint] + d.rig.m[joint] * d.rig.c[joint] ** 2
    peak = np.quantile(np.abs(u), 0.999)
    return effects.Scale(rms, peak, np.sqrt(np.mean(v**2)) + 1e-3, low, high, inertia)


def _hide(drafts: list[Draft], drive: Drive, nominal: Run) -> None:
    """Draw the effects of every data set and size each alone, by a few quiet runs of all of them
    together.
    """
    jobs = []
    for d in drafts:
        for i, (name, joint, multiple) in enumerate(d.spec.effects):
            j = max(joint - 1, 0)
            params = effects.draw(
                name,
                stream(d.spec, 100 + 10 * effects.EFFECTS.index(name) + i),
                ruler(d, nominal, j),
            )
            d.hidden.append({"name": name, "joint": joint, "multiple": multiple, "params": params})
            jobs.append((d, d.hidden[-1]))
    if jobs:
        _size(jobs, drive)


def _size(jobs: list[tuple[Draft, dict]], drive: Drive, rounds: int = 4) -> None:
    lanes = np.concatenate([np.arange(d.lanes.start, d.lanes.stop) for d, _ in jobs])
    alone, p = (
        drive.quiet().pick(lanes),
        lanes_of([d.rig for d, _ in jobs], [len(d.trials) for d, _ in jobs]),
    )
    spans, at = [], 0
    for d, _ in jobs:
        spans.append(slice(at, at := at + len(d.trials)))
    tried: list[tuple[list[float], list[float]]] = [([], []) for _ in jobs]
    for turn in range(rounds):
        table = effects.Table(len(lanes))
        for (_, e), span in zip(jobs, spans, strict=True):
            table.add(e["name"], max(e["joint"] - 1, 0), span, e["params"])
        step = (
            1.25e-3
            if {"presliding", "hard_stop", "actuator_lag", "sensor_lag"} & set(table.values)
            else SIZING_STEP
        )
        run = simulate(p, table, alone, step)
        for (d, e), span, (sizes, shares) in zip(jobs, spans, tried, strict=True):
            share = sizing.measure(d.rig, run, span, d.valid(len(run.times)))
            sizes.append(e["params"]["size"])
            shares.append(share.counted)
            e["share"] = share
            if turn < rounds - 1:
                low, high = (
                    effects.SMALLEST.get(e["name"], 0.0),
                    effects.LARGEST.get(e["name"], np.inf),
                )
                target = sizing.aimed_at(e["multiple"]) * sizing.JUST_MATTERS
                e["params"]["size"] = sizing.next_size(sizes, shares, target, low, high)
    for _, e in jobs:
        sized = e["params"]["size"]
        small = sized * e["multiple"] / sizing.aimed_at(e["multiple"])
        e["params"]["size"] = max(small, effects.SMALLEST.get(e["name"], 0.0))
        e["reached"] = e["share"].counted / sizing.JUST_MATTERS * e["params"]["size"] / sized


def effect_table(drafts: list[Draft], lanes: int) -> effects.Table:
    table = effects.Table(lanes)
    for d in drafts:
        for e in d.hidden:
            table.add(e["name"], max(e["joint"] - 1, 0), d.lanes, e["params"])
    return table


def _tell_widths(drafts: list[Draft], step: float) -> None:
    """Put the speed within which dry friction turned into its parameters: on light links it is no
    small one.
    """
    for d in drafts:
        m11, m12, m22 = (m[0] for m in mass_matrix(lanes_of([d.rig], [1]), np.zeros((2, 1))))
        inertia = (m11 * m22 - m12**2) / np.array([m22, m11])
        for e in d.hidden:
            if e["name"] in ("coulomb", "stribeck"):
                level = e["params"]["size"] * e["params"].get("ratio", 1.0)
                e["params"]["width"] = float(
                    forces.stick_speed(level, inertia[e["joint"] - 1], step)
                )


def _sensors(drafts: list[Draft], drive: Drive, nominal: Run) -> None:
    """Draw sensor noise, encoder steps and disturbance torques into the drive."""
    for d in drafts:
        rng, c = stream(d.spec, 4), d.condition
        std = np.repeat(
            [conditions.log_uniform(rng, c.q_noise), conditions.log_uniform(rng, c.v_noise)], 2
        )
        bits = int(rng.integers(c.bits[0], c.bits[1] + 1))
        share, tau = rng.uniform(*c.disturbance), rng.uniform(0.05, 0.5)
        rms = share * np.array([ruler(d, nominal, j).torque for j in range(2)])
        for lane, t in enumerate(d.trials, d.lanes.start):
            k = len(t.times)
            drive.noise[:k, :, lane] = rng.normal(size=(k, 4)) * std
            drive.quantum[:, lane] = 2 * np.pi / 2**bits if bits else 0.0
            if share > 0:
                drive.disturbance[:k, :, lane] = conditions.ornstein_uhlenbeck(
                    rng, t.times, rms, tau
                )
        d.sensor = {
            "q": std[0],
            "v": std[2],
            "bits": bits,
            "disturbance_share": share,
            "disturbance_tau": tau,
        }


def _finish(d: Draft, run: Run, drive: Drive) -> Dataset:
    trials = []
    for lane, t in enumerate(d.trials, d.lanes.start):
        k = len(t.times)
        x, u = run.measured[:k, :, lane], run.command[:k, :, lane]
        columns = {"time": t.times, "q1": x[:, 0], "q2": x[:, 1]}
        if d.condition.velocities:
            columns |= {"v1": x[:, 2], "v2": x[:, 3]}
        trials.append(columns | {"tau1": u[:, 0], "tau2": u[:, 1]})
    return Dataset(trials, _meta(d), _truth(d) | {"free_phase": drive.free_phase[d.lanes].tolist()})


def _meta(d: Draft) -> dict:
    rig = d.rig
    meta = {
        "task": "pendulum",
        "model": rig.world,
        "angle_zero": "hanging" if rig.sign > 0 else "upright",
        "geometry": {"l1": float(rig.l[0]), "l2": float(rig.l[1]), "g": 9.81},
    }
    if d.spec.declare_noise:
        names = ("q1", "q2", "v1", "v2") if d.condition.velocities else ("q1", "q2")
        meta["noise"] = {n: float(d.sensor[n[0]]) for n in names}
    return meta


def _truth(d: Draft) -> dict:
    hidden = []
    for e in d.hidden:
        share = e["share"]
        where = "base" if e["name"] == "tilt" else f"joint{e['joint']}"
        hidden.append(
            {
                "name": e["name"],
                "where": where,
                "multiple": e["multiple"],
                "multiple_reached": e["reached"],
                "share_raw": share.raw,
                "share_unexplained": share.unexplained,
                "confounded": share.confounded,
                "torque_rms": share.torque.tolist(),
                "unit": effects.UNITS[e["name"]],
                "parameters": {k: float(v) for k, v in e["params"].items()},
            }
        )
    return {
        "seed": d.spec.seed,
        "condition": d.spec.condition,
        "engine": d.spec.engine,
        "effects": hidden,
        "rig": d.rig.truth(),
        "declared": d.rig.declared(),
        "sensor": d.sensor,
        "kinds": [t.kind for t in d.trials],
    }
