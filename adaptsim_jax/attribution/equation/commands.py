"""The gains of position servos, from where they are beside where they were told to be.

A servo's force is kp (command - angle) - D speed. What it was told is exact and where it is is
known well, so the command error is the measured side: command - angle = (forces that the motion
takes, by the file's bodies) / kp + D/kp speed + friction/kp sign(speed) + rotor/kp acceleration.
All of it is linear. Only ratios to kp show unless gravity or inertia gives the scale: kp is held
where it is not told.
"""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.attribution.criteria import SERVO
from adaptsim_jax.attribution.equation.balance import Balance
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem, values_of
from adaptsim_jax.diagnosis.criteria import FOLD
from adaptsim_jax.diagnosis.folds import blocks_of_windows, folds_of
from adaptsim_jax.diagnosis.testing import jackknife, log_ratio, means, sign_flip

LIMITS = np.linspace(
    0.3, 1.0, 15
)  # quantiles of the torque that a motion needs, at which a limit may lie


@dataclass(frozen=True)
class Servo:
    """Of a joint: kp [N m/rad], D [N m s/rad], coulomb [N m], rotor [kg m^2] beside the file's,
    bias [N m]; scale: whether the joint shows kp itself, and
    not only what is over it; separation: standard errors between 1/kp and the file's, infinite
    where other joints give the scale; error: rms of the command error [rad] where the joint
    moves, and what is left of
    it by these gains and by the file's; p of a test over blocks of the one against
    the other.
    """

    joint: int
    kp: float
    damping: float
    coulomb: float
    rotor: float
    bias: float
    scale: bool
    separation: float
    error: float
    left: float
    file: float
    p: float


def servos(problem: TreeProblem, balance: Balance) -> list[Servo]:
    """Gains of the joints of a group whose actuators are told where to be."""
    values = values_of(problem, balance.group, Vector((), np.zeros(0)))
    law, gear = values.actuator[:, :, 0], values.gear[:, 0]
    takes = balance.regressor @ values.inertial[..., 0].ravel() - balance.known
    takes = takes + np.asarray(balance.group.model.tree.armature) * balance.acceleration
    found = []
    for k, j in enumerate(balance.group.joints):
        kp, kv = -law[2, k] * gear[k] ** 2, -law[3, k] * gear[k] ** 2
        if kp <= 0.0:
            continue
        # of the angle, by what the file says of the command's unit
        target = law[0, k] * gear[k] * balance.u[k] / kp
        # a joint that is held, or chatters, says nothing of a gain
        if _moved(balance, balance.q[k]) >= SERVO.stuck * _moved(balance, target):
            found.append(_command_error(balance, k, int(j), target, takes[:, k], (kp, kv)))
    # times the file's, where a joint does not tell its own
    usual = [1.0 / (error.x[0] * error.kp) for error in found if error.scale]
    like = float(np.median(usual)) if usual else 1.0
    return [error.servo(like) for error in found]


def _moved(balance: Balance, z: np.ndarray) -> float:
    """How far a quantity of the rows moves, as the mean over the runs."""
    return np.sqrt(np.mean([np.var(z[run]) for run in balance.runs]))


@dataclass(frozen=True)
class CommandError:
    """A joint's command error along the motion, regressed.

    Args:
        joint: Its number.
        kp: The file's gain, N m/rad.
        x: Per unit of what the motion takes, of speed, of its sign, of acceleration, and a bias.
        scale: Whether the error shows kp.
        separation: As of `Servo`.
        sizes: Root mean squares [rad]: of the error, of what is left, of what the file leaves.
        p: As of `Servo`.
    """

    joint: int
    kp: float
    x: np.ndarray
    scale: bool
    separation: float
    sizes: tuple[float, ...]
    p: float

    def servo(self, like: float) -> Servo:
        """The servo. like: its kp over the file's, where the error does not show it."""
        x = self.x
        kp = 1.0 / x[0] if self.scale else like * self.kp
        rubs, drags, turns = (max(kp * z, 0.0) for z in (x[2], x[1], x[3]))
        return Servo(
            self.joint,
            kp,
            drags,
            rubs,
            turns,
            kp * x[4],
            self.scale,
            self.separation,
            *self.sizes,
            p=self.p,
        )


def _command_error(
    balance: Balance,
    k: int,
    joint: int,
    target: np.ndarray,
    takes: np.ndarray,
    gains: tuple[float, float],
) -> CommandError:
    """The error of a group's joint `k` regressed on what its motion takes, N m [K]. gains: kp and
    kv of the file.
    """
    kp, kv = gains
    clear, acceleration = balance.clear[:, k], balance.acceleration[:, k]
    speed, sign = (balance.averaged(z)[:, k] for z in (balance.v, balance.sign))
    error = balance.mean @ (target - balance.q[k])
    columns = np.stack([takes, speed, sign, acceleration, np.ones(len(error))], 1)
    x, spread, left = _regressed(balance, error, columns, clear)
    scale = bool(x[0] > SERVO.significant * spread[0] and 1.0 / x[0] < 1e5)
    needs = takes + balance.group.model.tree.frictionloss[k] * sign
    file = error - (needs + kv * speed) / kp

    def size(z):
        return np.average(np.square(z), weights=clear)

    if scale:
        # at a limit, the file's or another, the error says nothing of kp
        limited = x[0] * _limited(kp * error - kv * speed, needs, clear)
        if size(limited) < min(size(file), size(left)):
            file = limited
    separation = abs(x[0] - 1.0 / kp) / spread[0] if scale else np.inf
    sizes = tuple(float(np.sqrt(size(z))) for z in (error, left, file))
    p = _better(balance, file, left)
    return CommandError(joint, kp, x, scale, float(separation), sizes, p)


def _limited(asked: np.ndarray, needs: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """What a motion needs, less what the file's gains ask for, cut off at a limit [N m]: at the
    level that leaves least.
    """
    levels = np.quantile(np.abs(needs), LIMITS)
    left = np.abs(np.clip(asked, -levels[:, None], levels[:, None]) - needs)
    return left[int(np.argmin(np.average(np.square(left), axis=1, weights=clear)))]


def _regressed(balance: Balance, y: np.ndarray, columns: np.ndarray, clear: np.ndarray):
    """Coefficients, their standard errors by a jackknife over folds, and what is left of each fold
    by the others' coefficients.
    """
    weight = np.sqrt(clear)
    fold = folds_of(balance.trial, FOLD.min_windows)
    size = np.sqrt(np.mean(np.square(columns), 0)) + 1e-300

    def solve(some):
        return (
            np.linalg.lstsq(
                (columns / size * weight[:, None])[some], (y * weight)[some], rcond=1e-6
            )[0]
            / size
        )

    whole = solve(np.ones(len(y), bool))
    each, left = [], np.zeros_like(y)
    for f in np.unique(fold):
        each.append(solve(fold != f))
        left[fold == f] = y[fold == f] - columns[fold == f] @ each[-1]
    return whole, np.maximum(jackknife(np.array(each)), 1e-300), left


def _better(balance: Balance, before: np.ndarray, after: np.ndarray) -> float:
    """p that blocks are not better explained."""
    block = blocks_of_windows(balance.trial, balance.time)
    left = [means(np.square(z), block) for z in (before, after)]
    return sign_flip(log_ratio(*left))


def drive_gains(problem: TreeProblem, balance: Balance) -> dict[int, float | None]:
    """Torque over volts or amperes of the driven joints of a group, from told = (forces that the
    motion takes, by the file's bodies) / gain
    + friction and rotor over it; None where these do not give the scale.
    """
    values = values_of(problem, balance.group, Vector((), np.zeros(0)))
    takes = balance.regressor @ values.inertial[..., 0].ravel()
    takes = takes + np.asarray(balance.group.model.tree.armature) * balance.acceleration
    averaged, speed, sign = (
        balance.averaged(balance.u),
        balance.averaged(balance.v),
        balance.averaged(balance.sign),
    )
    out: dict[int, float | None] = {}
    for k, j in enumerate(balance.group.joints):
        if not np.any(averaged[:, k]):
            continue
        columns = np.stack(
            [
                takes[:, k],
                speed[:, k],
                sign[:, k],
                balance.acceleration[:, k],
                np.ones(len(averaged)),
            ],
            1,
        )
        x, spread, _ = _regressed(balance, averaged[:, k], columns, balance.clear[:, k])
        out[int(j)] = 1.0 / x[0] if x[0] > SERVO.drive_significant * spread[0] else None
    return out
