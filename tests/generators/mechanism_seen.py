"""What of an effect can be told apart: its share of the torque, what inertias and damping leave of
it, and what does just the same.

All in torques along the true motion: an effect is the force by which a model without it errs. Base
inertial parameters and damping are projected off; a name whose own force then leaves no more than 3
% of the effect is an exact equivalent.
"""

from dataclasses import dataclass

import numpy as np

from tests.generators.mechanism_dynamics import Chain
from tests.generators.mechanism_engine import STEP, Drive, Plant, Run
from tests.generators.mechanism_forces import Effect
from tests.generators.mechanism_log import readings
from tests.generators.mechanism_machines import Machine

SENSOR = ("encoder_offset", "encoder_scale", "sensor_delay", "sensor_lag")
SAME = 0.03  # of an effect that an equivalent may leave
SEEN = 0.03  # of a joint's torque: less, and nobody need name it there
BARELY = 0.01  # of a joint's torque: less, and nobody can see it
MOST = {
    "torque_gain": 0.5,
    "position_gain": 0.5,
    "load_friction": 0.9,
    "encoder_offset": 0.5,
    "encoder_scale": 0.3,
    "tilt": 0.3,
}
"""Sizes beyond which a rival is absurd: a gain of -1 with no inertias explains anything."""
LEFT = 0.05  # of an effect that inertias and damping leave when they absorb it


@dataclass(frozen=True)
class Motion:
    """Samples `[M, n]` of the true motion and of the command as logged; scale [n]: torque of each
    joint.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    u: np.ndarray
    c: np.ndarray
    rate: np.ndarray
    scale: np.ndarray


class Sight:
    """Judges the effects of one world."""

    def __init__(
        self,
        machine: Machine,
        plant: Plant,
        drive: Drive,
        run: Run,
        effects: tuple[Effect, ...],
        tilt,
        own: np.ndarray,
    ):
        self.machine, self.plant, self.effects, self.tilt = machine, plant, effects, tilt
        steps = np.arange(200, len(run.q) - 200, max(1, len(run.q) // 100))

        def flat(z):
            return z[steps].reshape(-1, machine.n)

        self.flat = flat

        def rms(x):
            return np.sqrt(np.mean(x**2, 0))

        rate = (run.sent[steps + 8] - run.sent[steps - 8]).reshape(-1, machine.n) / (16 * STEP)
        u = flat(run.u)
        scale = np.maximum(rms(u), own * rms(flat(run.a)))
        self.m = Motion(flat(run.q), flat(run.v), flat(run.a), u, flat(run.sent), rate, scale)
        self.chain = Chain(machine, self.m.q, self.m.v, self.m.a)
        self.base = self._base()
        self.parts = [
            self._part(e, part, run, steps) for e, part in zip(effects, run.parts, strict=True)
        ]

    def _wide(self, x: np.ndarray) -> np.ndarray:
        """Forces `[M, n, ...]` over the torque of each joint, flattened `[M n, ...]`."""
        shape = (1, -1) + (1,) * (x.ndim - 2)
        return (x / self.m.scale.reshape(shape)).reshape(-1, *x.shape[2:])

    def _base(self) -> np.ndarray:
        """Orthonormal columns of what inertial parameters and damping can do."""
        n, columns = self.machine.n, self.chain.columns()
        damping = np.zeros((*self.m.v.shape, n))
        damping[:, range(n), range(n)] = self.m.v
        return _span(self._wide(np.concatenate([columns, damping], -1)))

    def _law(self, q, v) -> np.ndarray:
        """Actuators' force without effects for logged commands."""
        if self.plant.mode == "torque":
            return self.m.c
        return self.plant.servo[:, 0] * (self.m.c - q) - self.plant.servo[:, 1] * v

    def _model(self, q, v, a) -> np.ndarray:
        """Forces that a motion needs, of true parameters."""
        links = self.machine.links
        extra = (
            np.array([link.damping for link in links]) * v
            + np.array([link.armature for link in links]) * a
        )
        return Chain(self.machine, q, v, a).total() + extra

    def _part(self, e: Effect, part: np.ndarray, run: Run, steps: np.ndarray) -> np.ndarray:
        m = self.m
        if e.name in SENSOR:
            q, v, a = (self.flat(z) for z in readings(run, (e,), accelerations=True))
            fed = e.name in ("encoder_offset", "encoder_scale")  # servos see these too
            change = self._model(q, v, a) - self._model(m.q, m.v, m.a)
            return change if fed else change - self._law(q, v) + self._law(m.q, m.v)
        if e.name == "tilt":
            return Chain(self.machine, m.q, m.v, m.a, self.tilt).total() - self.chain.total()
        if e.name == "dropped_mass":
            still = Chain(self.machine, m.q, 0 * m.v, 0 * m.a)
            on = np.repeat(steps * STEP >= e.params[0]["time"], run.q.shape[1])
            mass = e.params[0]["mass"]
            return -still.force(self.machine.n - 1, mass, self.machine.links[-1].com) * on[:, None]
        if e.name == "armature":
            out = np.zeros_like(m.a)
            for j, p in e.each():
                out[:, j] = -p["inertia"] * m.a[:, j]
            return out
        if e.name == "delay" and e.params[0]["delay"] < 0:
            out = np.zeros_like(m.u)
            for j, p in e.each():
                late = np.maximum(steps + round(p["delay"] / STEP), 0)
                out[:, j] = (run.sent[steps][:, :, j] - run.sent[late][:, :, j]).reshape(-1)
            return out * (1.0 if self.plant.mode == "torque" else self.plant.servo[:, 0])
        if e.name in ("backlash", "drive_elasticity", "drive_play"):
            return np.zeros_like(m.u)  # a kink of the kinematics; `kinematic`
        return self.flat(part)

    def judge(self, k: int) -> dict:
        """share and seen by joint; absorbed; accept: names and the joints where each must be told;
        also_right.
        """
        e, n = self.effects[k], self.machine.n

        def names(js):
            return [self.machine.joints[j] for j in js]

        def rms(x):
            return np.sqrt(np.mean(x.reshape(-1, n) ** 2, 0))

        y = self._wide(self.parts[k])
        others = [self._wide(p)[:, None] for i, p in enumerate(self.parts) if i != k and np.any(p)]
        base = _span(np.hstack([self.base, *others])) if others else self.base
        left = y - base @ (base.T @ y)
        share, seen = rms(y), rms(left)
        absorbed = bool(
            np.sqrt(np.sum(seen**2)) < LEFT * np.sqrt(np.sum(share**2)) or max(seen) < BARELY
        )
        where = list(e.joints) or [int(np.argmax(seen))]
        must = [j for j in e.joints if seen[j] >= SEEN * (0.5 if len(e.joints) == 1 else 1)]
        told = {
            "share": dict(zip(names(where), share[where].tolist(), strict=True)),
            "seen": dict(zip(names(where), seen[where].tolist(), strict=True)),
            "absorbed": absorbed,
        }
        accept = [{"name": e.name, "joints": names(must or e.joints)}]
        also = [{"name": e.name, "joints": names(e.joints)}]
        size = np.linalg.norm(left)
        for name, joints, columns in self._rivals():
            if (name, joints) != (e.name, e.joints) and size > 0:
                whole = self._wide(columns)
                z = whole - base @ (base.T @ whole)
                if np.any(np.linalg.norm(z, axis=0) < 1e-3 * np.linalg.norm(whole, axis=0)):
                    continue  # it is absorbed itself
                gain = np.linalg.lstsq(z, left)[0]
                if np.linalg.norm(left - z @ gain) < SAME * size and np.abs(gain[0]) < MOST.get(
                    name, np.inf
                ):
                    accept.append({"name": name, "joints": names(joints)})
        for name, joints, needed in self._known(e):
            (accept if needed else also).append({"name": name, "joints": names(joints)})
        return told | {"accept": accept, "also_right": also}

    def _known(self, e: Effect):
        """(name, joints, whether it may stand for the effect) by physics: the same but for
        sticking, or a part of it.
        """
        everywhere, driven = tuple(range(self.machine.n)), self.plant.driven
        if e.name == "asymmetric_coulomb":  # while it slides
            yield "bias", e.joints, True
        elif e.name == "sensor_delay" and e.joints == everywhere:
            yield "delay", driven, True
        elif e.name == "delay" and e.joints == driven and e.params[0]["delay"] > 0:
            yield "sensor_delay", everywhere, True
        elif e.name in ("torque_coupling", "friction_coupling"):  # told at the later of its joints
            yield e.name, e.joints[1:], True
        elif (
            e.name == "drive_elasticity" and not e.params[0]["link_side"]
        ):  # an encoder on the motor's side
            yield "drive_compliance", e.joints, True
        elif e.name == "drive_play":
            yield "drive_backlash", e.joints, True
            if not e.params[0]["link_side"]:
                yield "backlash", e.joints, True
        elif e.name == "spring":
            yield "bias", e.joints, False
        elif e.name == "magnet":
            yield "angle_torque", e.joints, True
        elif e.name == "place_friction":  # and its mean
            yield "angle_friction", e.joints, True
            yield "coulomb", e.joints, False

    def _rivals(self):
        """(name, joints, forces `[M, n, k]`) of effects that are linear in their parameters, at
        their smallest.
        """
        m, n, driven = self.m, self.machine.n, self.plant.driven
        sign = np.tanh(m.v / (0.01 * np.sqrt(np.mean(m.v**2, 0))))
        by_joint = {
            "bias": [np.ones_like(m.q)],
            "spring": [m.q, np.ones_like(m.q)],
            "armature": [m.a],
            "coulomb": [sign],
            "quadratic_drag": [m.v * np.abs(m.v)],
        }
        by_motor = {"torque_gain": [m.u], "load_friction": [np.abs(m.u) * sign]}
        if self.plant.mode == "position":
            by_motor["position_gain"] = [self.plant.servo[:, 0] * (m.c - m.q)]
        for table, joints in ((by_joint, range(n)), (by_motor, driven)):
            for name, columns in table.items():
                for j in joints:
                    yield name, (j,), self._at(j, columns)
        now = self._model(m.q, m.v, m.a)
        for j in range(n):
            for name, size in (("encoder_offset", 1e-4), ("encoder_scale", 1e-4)):
                q, v, a = (z.copy() for z in (m.q, m.v, m.a))
                if name == "encoder_offset":
                    q[:, j] += size
                else:
                    for z in (q, v, a):
                        z[:, j] *= 1 + size
                yield name, (j,), ((self._model(q, v, a) - now) / size)[..., None]
        turned = [
            Chain(self.machine, m.q, m.v, m.a, g).total()
            for g in ((9.81e-4, 0, -9.81), (0, 9.81e-4, -9.81))
        ]
        yield "tilt", (), (np.stack(turned, -1) - self.chain.total()[..., None]) * 1e4

    def _at(self, j: int, columns: list[np.ndarray]) -> np.ndarray:
        out = np.zeros((*self.m.q.shape, len(columns)))
        for k, c in enumerate(columns):
            out[:, j, k] = c[:, j]
        return out


def _span(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis of the columns' span, by their Gram matrix, twice for precision."""
    size = np.linalg.norm(columns, axis=0)
    u = columns[:, size > 0] / size[size > 0]
    for _ in range(2):
        w, z = np.linalg.eigh(u.T @ u)
        keep = w > 1e-12 * w[-1]
        u = u @ (z[:, keep] / np.sqrt(w[keep]))
    return u
