"""Clocks and efforts that gravity contradicts: the declared masses say how fast a motion is, and
what torque it needs.

The inverse dynamics of the declared tree are `tau = alpha D(q, v, a) + G(q)`. With a clock that
runs slow by a factor s the accelerations and squared speeds come out s^2 too small, gravity as it
is: alpha is s^2 (Khalil and Dombre 2002, ch. 9, for the regression). With efforts that are no
torques each joint needs a multiple of its own.
"""

import numpy as np

from adaptsim_jax.attribution.criteria import PACE
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.criteria import BLOCK, COMMAND, CONTRADICTION
from adaptsim_jax.logs.log_units import TIME_UNITS, Affine
from adaptsim_jax.logs.quality.contradictions import AS_DECLARED
from adaptsim_jax.logs.quality.findings import AuditFinding
from adaptsim_jax.logs.quality.hypotheses import (
    BlockMeans,
    Design,
    Track,
    blocks,
    motion_of,
    rubbing,
)


def check_pace(machine: Machine, tracks: list[Track], design: Design) -> tuple[AuditFinding, ...]:
    """Raises BadInput where gravity says that time runs otherwise than it was stamped."""
    # long blocks average noise, short ones follow fast motion
    looks = [_paced(motion, design) for motion in (motion_of(tracks), _sharp(tracks))]
    looks = [look for look in looks if look is not None]
    if not looks or np.linalg.norm(machine.tree.gravity) == 0.0:
        return ()
    left, factor, as_is = min(looks)
    if (
        left > PACE.explained
        or not 1.0 / 20.0 < factor < 20.0
        or 1.0 / PACE.clock_factor < factor < PACE.clock_factor
    ):
        return ()
    step = float(np.median(np.concatenate([np.diff(t.time) for t in tracks])))
    even = all(np.max(np.abs(np.diff(t.time) - step)) < PACE.even * step for t in tracks)
    if even:
        counted = f"; its stamps are exactly {1e3 * step:.4g} ms apart, as if counted"
    else:
        counted = ""
    how = "slow" if factor > 1 else "fast"
    size = max(factor, 1.0 / factor)
    line = f"time = {float(f'{_seconds(machine) / factor:.3g}'):g}"
    phrase = (
        f"time runs too {how}, {size:.3g} times: with the declared masses gravity moves the "
        f"machine in {step / factor:.3g} s from row to row, not in {step:.3g} s{counted}"
    )
    mend = f"write {line} under [units] in meta.toml (seconds a unit), or mend the stamps"
    if as_is > PACE.better_than_rotors * left and as_is > CONTRADICTION.min_doubted_share:
        raise BadInput(f"{machine.log.path}: {phrase}; {mend}; {AS_DECLARED}")
    if not all(t.path.endswith(".parquet") for t in machine.log.trials) or not even:
        return ()
    text = (
        f"{phrase}; {mend}. Or the rotors have inertia that the model lacks: one joint alone "
        "cannot tell the two apart"
    )
    return (AuditFinding("pace", "warn", "", "time", text, factor),)


def _paced(motion: BlockMeans, design: Design) -> tuple[float, float, float] | None:
    """What another clock leaves, how many times slow this one runs by it, and what rotors leave in
    its place.
    """
    if len(motion.q) < BLOCK.min_blocks or not np.all(np.isfinite(motion.a)):
        return None
    n = motion.q.shape[1]
    moving, weight = _parts(motion, design)
    rest = motion.tau - weight
    spread = np.maximum(np.std(rest, axis=0), 1e-9)
    if np.max(spread) < 1e-6:
        return None

    def describe(columns):
        return (columns / spread[None, :, None]).reshape(len(motion.q) * n, -1)

    y = (rest / spread).reshape(-1)
    rubs = describe(rubbing(motion)[:, :, [4 * j + k for j in range(n) for k in (0, 1, 2)]])
    rotors = describe(motion.a[:, :, None] * np.eye(n))
    pace = describe(moving[:, :, None])
    as_is = _left(y - pace[:, 0], np.concatenate([rubs, rotors], 1))[0]
    left, x = _left(y, np.concatenate([pace, rubs], 1))
    return left, float(np.sqrt(x[0])) if x[0] > 0 else 0.0, as_is


def _seconds(machine: Machine) -> float:
    unit = machine.log.meta.units.get("time", "s")
    if isinstance(unit, Affine):
        return unit.scale
    return TIME_UNITS.get(unit, 1.0)


def _parts(motion: BlockMeans, design: Design) -> tuple[np.ndarray, np.ndarray]:
    """Torque `[K, n]` of the declared masses that motion needs, and that gravity does."""
    n = motion.q.shape[1]
    whole, moving = (design(motion, gravity)[:, :, :n].sum(2) for gravity in (True, False))
    return moving, whole - moving


def _left(y: np.ndarray, columns: np.ndarray) -> tuple[float, np.ndarray]:
    """Share of the square of `y [K]` that the best multiples of `columns` leave, and these."""
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    x, *_ = np.linalg.lstsq(columns / size, y, rcond=1e-9)
    return float(
        np.sum((y - columns / size @ x) ** 2) / max(float(np.sum((y - y.mean()) ** 2)), 1e-12)
    ), x / size


def _sharp(tracks: list[Track]) -> BlockMeans:
    """Short blocks of as many trials as a design takes: exact where motion is fast."""
    parts: list[tuple[np.ndarray, ...]] = []
    for track in tracks:
        room = BLOCK.max_blocks - sum(len(p[0]) for p in parts)
        parts.append(tuple(x[:room] for x in blocks(track, sharp=True)[:4]))
    return BlockMeans(*(np.concatenate([p[k] for p in parts]) for k in range(4)))


def _smoothed(columns: np.ndarray) -> np.ndarray:
    """Both sides of an equation `[K, P]` over some blocks: the same equation, with less of the
    sensors' noise.
    """
    mean = np.ones(COMMAND.n_smoothed_blocks) / COMMAND.n_smoothed_blocks
    return np.stack([np.convolve(c, mean, "valid") for c in columns.T], 1)


def amperes(machine: Machine, tracks: list[Track], design: Design) -> tuple[AuditFinding, ...]:
    """A question where every driven joint needs several times its logged effort, a multiple of its
    own: motors' currents are like that.
    """
    if machine.log.input_kind != "torque":
        return ()
    motion = _sharp(tracks)
    if len(motion.q) < BLOCK.min_blocks or not np.all(np.isfinite(motion.a)):
        return ()
    names = machine.tree.joint_names
    moving, weight = _parts(motion, design)
    driven = [j for j in range(motion.q.shape[1]) if np.ptp(motion.tau[:, j]) > 1e-9]
    need = {}
    for j in driven:
        rubs = rubbing(motion)[:, j, [4 * j, 4 * j + 1, 4 * j + 2]]
        columns = np.column_stack([motion.tau[:, j], -rubs, -motion.a[:, j]])
        whole = _smoothed(np.column_stack([moving[:, j] + weight[:, j], columns]))
        left, x = _left(whole[:, 0], whole[:, 1:])
        if left > CONTRADICTION.min_doubted_share or x[0] <= 0:
            return ()
        need[j] = float(x[0])
    if len(need) < 2 or not all(
        x > CONTRADICTION.max_torque_ratio or x < 1.0 / CONTRADICTION.max_torque_ratio
        for x in need.values()
    ):
        return ()
    if max(need.values()) < 1.5 * min(need.values()):
        return ()  # of one scale all: a unit
    factors = ", ".join(f"{float(f'{x:.2g}'):g} at {names[j]}" for j, x in need.items())
    lines = ", ".join(f'i_{names[j]} = "{_column(machine, j)}"' for j in need)
    text = (
        f"the masses of {machine.mechanism.path} need {factors} times the logged efforts: are "
        f"these currents (A), not torques? "
        f'Then write input = "current" and, under [columns], {lines} in meta.toml, or the efforts '
        f"in N m"
    )
    return (
        AuditFinding(
            "currents", "warn", "", "efforts", text, float(np.median(list(need.values())))
        ),
    )


def held_fast(machine: Machine, tracks: list[Track], design: Design) -> tuple[AuditFinding, ...]:
    """Joints that move though the file gives them more dry friction than motion and gravity leave
    of any logged torque.
    """
    levels = np.asarray(machine.tree.frictionloss)
    motion = _sharp(tracks) if np.any(levels > 0) else None
    if (
        motion is None
        or len(motion.q) < BLOCK.min_blocks
        or not np.all(np.isfinite(motion.a))
        or not np.ptp(motion.tau, axis=0).any()
    ):
        return ()
    rest = np.abs(motion.tau - sum(_parts(motion, design)))
    out = []
    for j in np.flatnonzero(levels > 0):
        moves = np.abs(motion.v[:, j]) > 0.2 * np.max(np.abs(motion.v[:, j]))
        most = float(np.quantile(rest[moves, j], 0.9))
        if levels[j] > PACE.friction_factor * most:
            name, unit = (
                machine.tree.joint_names[j],
                "N m" if machine.tree.kinds[j] == "hinge" else "N",
            )
            text = (
                f"{machine.mechanism.path} declares friction of {levels[j]:g} {unit} at {name}, "
                f"{levels[j] / most:.2g} times what its motion leaves for it: a placeholder? Put "
                "in a measured friction, or 0"
            )
            out.append(AuditFinding("friction", "warn", "", name, text, float(levels[j])))
    return tuple(out)


def _column(machine: Machine, joint: int) -> str:
    log, name = machine.log, machine.tree.joint_names[joint]
    known = dict(zip(log.input_names, log.input_columns, strict=False))
    ours = known.get(name) or f"tau_{name}"
    return log.meta.columns.get(ours, ours)
