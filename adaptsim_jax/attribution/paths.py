"""A problem simulated: how its stretches are stepped, where they begin, and what is left of the
measured ones.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np

from adaptsim_jax.attribution.acting import Values, bristles, drive_of, gives, held_by, rough
from adaptsim_jax.attribution.criteria import STRETCH
from adaptsim_jax.attribution.drive import MIN_INERTIA
from adaptsim_jax.attribution.parameters import Vector, Weights
from adaptsim_jax.attribution.problem import Group, TreeProblem, group_inertia, values_of
from adaptsim_jax.attribution.simulate import Path, Scheme, simulate, with_drives
from adaptsim_jax.attribution.stops import inverse_weight, limited, rates
from adaptsim_jax.effects.joints.forces import ARMATURE

STABLE_STEP = 1.0  # of a row's step times the fastest rate (1), for Runge and Kutta
MAX_SUBSTEPS = 12  # steps of a row, beyond which a machine counts as stiff
TURN_STEPS = 4.0  # steps in which friction that gives turns, at least


def starts_of(problem: TreeProblem) -> tuple[np.ndarray, ...]:
    """Smoothed starts, by group."""
    return tuple(g.stretches.start for g in problem.groups)


def scheme(group: Group, at: Values, some: Values | None = None) -> Scheme:
    """Steps within a row such that Runge and Kutta's method is stable and good for drag,
    controllers and drives; where controllers want more than there may be, as much work goes into
    stiff steps, which have half as many stages. some: other values, for each stretch, of which dry
    friction may be.
    """
    some = at if some is None else some
    inertia = group_inertia(at, group)[0]
    stiffness, damping = (np.abs(np.asarray(z)[:, 0]) for z in held_by(at))
    gaps = np.diff(group.stretches.time, axis=0)
    row = float(np.median(gaps[gaps > 0]))
    giving, fastest = np.zeros(0, int), 200.0
    if gives(group.model, at):
        rotor = at.effects[ARMATURE.name]["inertia"][:, 0]
        drive = drive_of(group.model, at)
        compliance, dashpot = (np.asarray(z)[:, 0] for z in (drive.compliance, drive.damping))
        soft = compliance > 0.0
        both = np.where(
            soft,
            1.0 / np.maximum(rotor, MIN_INERTIA) + 1.0 / np.maximum(inertia - rotor, MIN_INERTIA),
            0.0,
        )
        both = both / np.where(soft, compliance, 1.0)
        fastest = max(fastest, float(np.sqrt(both).max()), float((dashpot * both).max()))
        inertia = np.where(soft, np.maximum(rotor, MIN_INERTIA), inertia)
        giving = np.flatnonzero(soft)
    ends = np.asarray(group.model.tree.stop_params)[limited(group.model.tree)]
    if len(ends):
        pull, drag = (np.asarray(z) for z in rates(ends))
        fastest = max(fastest, float(drag.max()), 2.0 * float(np.sqrt(pull).max()))
    fastest = max(
        fastest,
        TURN_STEPS * float(np.asarray(group.model.tree.friction_softness)[:, 0].max(initial=0.0)),
    )
    swing = np.sqrt(stiffness / inertia) * 2.0
    need = row * max(float((damping / inertia).max()), float(swing.max()), fastest) / STABLE_STEP
    stiff = bool(need > MAX_SUBSTEPS) and not len(giving)
    if need > MAX_SUBSTEPS:
        steps = 2 * MAX_SUBSTEPS
    else:
        steps = max(1, int(np.ceil(need)))
    return Scheme(
        steps,
        rough(group.model, some),
        giving,
        group.stretches.past,
        bristles(group.model, some),
        stiff,
    )


class Ready(NamedTuple):
    """A group ready to be stepped through: its values, those of each stretch where they differ, and
    how.
    """

    group: Group
    at: Values
    values: Values
    how: Scheme


def ready(
    problem: TreeProblem, vector: Vector, rows: np.ndarray | None = None
) -> tuple[Ready, ...]:
    """By group; rows [W, P]: other parameters for each stretch."""
    out = []
    with jax.enable_x64(True):
        for group in problem.groups:
            at = values = _eased(group, values_of(problem, group, vector))
            if rows is not None:
                values = _eased(group, values_of(problem, group, vector, rows))
            out.append(Ready(group, at, values, scheme(group, at, values)))
    return tuple(out)


def _eased(group: Group, values: Values) -> Values:
    return values._replace(ease=ease(group, values))


def ease(group: Group, values: Values) -> np.ndarray:
    """Inverse weights of the joints [n, .] at `values` over those of the model file.

    MuJoCo scales the softness of dry friction and of the ends of ranges with the inverse mass
    matrix's diagonal at the file's zero. So an inertia that is fitted changes them as one in the
    file does.
    """
    tree = group.model.tree
    if not any(tree.limited) and not np.any(tree.friction_softness):
        return np.ones((tree.n, 1))
    armature = values.effects.get(ARMATURE.name, {}).get("inertia", tree.armature[:, None])
    declared = inverse_weight(tree, tree.inertial[..., None], tree.armature[:, None])
    return np.asarray(inverse_weight(tree, values.inertial, armature) / declared)


def widened(made: Sequence[Ready], starts: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Starts by group as the model has them: [2n, W], or [4n, W] where drives give."""
    return tuple(_start(group, at, x) for (group, at, *_), x in zip(made, starts, strict=True))


def _start(group: Group, values: Values, x: np.ndarray) -> np.ndarray:
    moves = 2 * len(group.joints)
    if not gives(group.model, values):
        return x[:moves]
    if len(x) > moves:
        return x
    s = group.stretches
    with jax.enable_x64(True):
        return np.asarray(with_drives(group.model, values, s.time, s.stamp, s.command, x, s.past))


def at_ends(made: Sequence[Ready]) -> list[tuple[np.ndarray, ...]]:
    """Other starts by group: each joint whose sensor has play begins at either end of it
    (`Effect.slack`).
    """
    out = []
    for group, at, *_ in made:
        for effect in group.model.effects:
            if not effect.slack or effect.name not in at.effects:
                continue
            gap = np.asarray(at.effects[effect.name][effect.slack])[:, 0]
            for k in np.flatnonzero(gap):
                for end in (0.5, -0.5):
                    shift = np.where(np.arange(2 * len(gap)) == k, end * gap[k], 0.0)
                    out.append((group, shift[:, None]))
    return [
        tuple(g.stretches.start + (shift if g is group else 0.0) for g, *_ in made)
        for group, shift in out
    ]


def run(problem: TreeProblem, vector: Vector, starts: Sequence[np.ndarray]) -> list[Path]:
    """Simulated paths by group."""
    made = ready(problem, vector)
    return simulated(made, widened(made, starts))


def simulated(made: Sequence[Ready], starts: Sequence[np.ndarray]) -> list[Path]:
    """Simulated paths by group, from starts as `widened` has them."""
    out = []
    with jax.enable_x64(True):
        for (group, _, values, how), start in zip(made, starts, strict=True):
            s = group.stretches
            path = simulate(group.model, values, s.time, s.stamp, s.command, start, how)
            out.append(Path(*(np.asarray(z) for z in path)))
    return out


def residuals(group: Group, path: Path) -> np.ndarray:
    """Measured less simulated [W, L+1, 2n]; 0 where nothing was measured, and where the simulation
    ran away a large number.
    """
    s = group.stretches
    measured = np.concatenate([s.q, s.v], 1)
    mask = np.concatenate([s.seen, s.seen_v], 1)
    off = np.where(np.isfinite(path.sensed), measured - path.sensed, 1e3)
    return (np.clip(off, -1e3, 1e3) * mask).transpose(2, 0, 1)


MAX_SAMPLES = 48  # rows of a stretch that enter the sums, evenly spread: neighbours say the same


def _own(weights: Weights, group: Group, joints: int) -> np.ndarray:
    """Channel weights [2 n_g] of a group."""
    j = np.array(group.joints)
    return np.concatenate([weights.channel[j], weights.channel[joints + j]])


class Counted(NamedTuple):
    """Of a group's stretches what enters the sums: rows [T], channels [C] of its 2n (those measured
    at all), weight [W, T, C].
    """

    rows: np.ndarray
    channels: np.ndarray
    weight: np.ndarray

    def pick(self, z: np.ndarray) -> np.ndarray:
        """Of what is logged [W, L+1, 2n, ...] what counts [W, T, C, ...]."""
        return z[:, self.rows[:, None], self.channels]

    def weigh(self, z: np.ndarray) -> np.ndarray:
        """What counts [W, T, C, ...], weighted in place, as [W, T C, ...]."""
        z *= self.weight.reshape(*self.weight.shape, *[1] * (z.ndim - 3))
        return z.reshape(len(z), -1, *z.shape[3:])

    def flat(self, z: np.ndarray) -> np.ndarray:
        """What is logged [W, L+1, 2n, ...], weighted, as [W, T C, ...]."""
        return self.weigh(self.pick(z))


def counted(problem: TreeProblem, group: Group, weights: Weights) -> Counted:
    s, at = group.stretches, picked(problem)
    mask = np.concatenate([s.seen, s.seen_v], 1).transpose(2, 0, 1)[:, at]
    weight = _own(weights, group, problem.joints) * np.sqrt(weights.stretch)[:, None, None] * mask
    channels = np.flatnonzero(np.any(weight != 0.0, axis=(0, 1)))
    return Counted(at, channels, weight[..., channels])


def losses(problem: TreeProblem, paths: Sequence[Path], weights: Weights) -> np.ndarray:
    """Half the weighted sum of squares of each stretch [W], over the samples that count."""
    return np.sum(group_losses(problem, paths, weights), 0)


def group_losses(problem: TreeProblem, paths: Sequence[Path], weights: Weights) -> list[np.ndarray]:
    """The same of each group of joints by itself, [W] each."""
    out = []
    for group, path in zip(problem.groups, paths, strict=True):
        r = residuals(group, path)[:, picked(problem)] * _own(weights, group, problem.joints)
        out.append(0.5 * np.square(r).sum((1, 2)) * weights.stretch)
    return out


def picked(problem: TreeProblem) -> np.ndarray:
    """Rows of a stretch that enter the sums."""
    rows = problem.groups[0].stretches.rows
    return np.unique(np.linspace(0, rows, min(MAX_SAMPLES, rows + 1)).round().astype(int))


def weigh(problem: TreeProblem, paths: Sequence[Path]) -> Weights:
    """Weights from the residuals themselves, by medians over stretches, so that none that ran away
    decides.
    """
    n, width = problem.joints, problem.groups[0].stretches.count
    channel, share, over = np.zeros(2 * n), np.zeros((width, 2 * n)), []
    for group, path in zip(problem.groups, paths, strict=True):
        r = residuals(group, path)
        mask = np.concatenate([group.stretches.seen, group.stretches.seen_v], 1).transpose(2, 0, 1)
        count = mask.sum(1)
        rms = np.sqrt(np.square(r).sum(1) / np.maximum(count, 1))
        j = np.array(group.joints)
        for k, at in enumerate([*j, *(n + j)]):
            have = count[:, k] > 0
            if have.any():
                size = np.median(rms[have, k])
                channel[at] = 1.0 / max(size, problem.floor[at], 1e-9)
                over.append(size / max(problem.floor[at], 1e-9))
                share[:, at] = rms[:, k] * channel[at]
    used = channel > 0
    size = np.sqrt(np.square(share[:, used]).mean(1))
    if np.any(size > 0):
        usual = max(float(np.median(size[size > 0])), 1e-12)
    else:
        usual = 1.0
    # what a model lacks moves a stretch's residuals together: beside the prior, they count as one
    # where it is most of them
    alike = np.clip(np.median(over), 1.0, np.sqrt(MAX_SAMPLES)) if over else 1.0
    return Weights(
        channel / alike, 1.0 / np.square(np.maximum(1.0, size / (STRETCH.outlying * usual)))
    )
