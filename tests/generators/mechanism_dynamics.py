"""Forces of a serial chain at given motions, vectorised over samples: what the base parameters can
take up, and what they cannot.
"""

import numpy as np

from tests.generators.mechanism_machines import Machine, turned


def _cross(a, b):
    return np.cross(a, b)


class Chain:
    """Frames and accelerations of all bodies at S samples of q, v, a `[S, n]`; gravity [3]."""

    def __init__(self, machine: Machine, q, v, a, gravity=(0.0, 0.0, -9.81)):
        samples, _ = q.shape
        turn, place = np.broadcast_to(np.eye(3), (samples, 3, 3)), np.zeros((samples, 3))
        spin, gain = np.zeros((samples, 3)), np.zeros((samples, 3))
        lift = np.broadcast_to(
            -np.asarray(gravity, float), (samples, 3)
        )  # acceleration of the frame, less gravity
        self.machine, self.bodies, self.axes, self.anchors = machine, [], [], []
        for j, link in enumerate(machine.links):
            axis = np.asarray(link.axis, float)
            arm = turn @ link.at
            place, lift = place + arm, lift + _cross(gain, arm) + _cross(spin, _cross(spin, arm))
            z = turn @ axis
            if link.kind == "hinge":
                turn = turn @ _about(axis, q[:, j])
                gain = gain + z * a[:, j : j + 1] + _cross(spin, z * v[:, j : j + 1])
                spin = spin + z * v[:, j : j + 1]
            else:
                slid = z * q[:, j : j + 1]
                lift = lift + _cross(gain, slid) + _cross(spin, _cross(spin, slid))
                lift = lift + 2 * _cross(spin, z * v[:, j : j + 1]) + z * a[:, j : j + 1]
                place = place + slid
            self.axes.append(z)
            self.anchors.append(place)
            self.bodies.append((turn, place, spin, gain, lift))

    def force(self, body: int, mass: float, com, inertia=None) -> np.ndarray:
        """Forces at the joints `[S, n]` that move one rigid body: mass, centre of mass, inertia [3,
        3] about it (None: a point).
        """
        turn, place, spin, gain, lift = self.bodies[body]
        arm = turn @ np.asarray(com, float)
        push = mass * (lift + _cross(gain, arm) + _cross(spin, _cross(spin, arm)))
        moment = np.zeros_like(push)
        if inertia is not None:
            world = turn @ inertia @ np.swapaxes(turn, 1, 2)
            moment = np.einsum("sij,sj->si", world, gain) + _cross(
                spin, np.einsum("sij,sj->si", world, spin)
            )
        out = np.zeros((len(push), self.machine.n))
        for i in range(body + 1):
            if self.machine.links[i].kind == "slide":
                out[:, i] = np.sum(self.axes[i] * push, 1)
            else:
                out[:, i] = np.sum(
                    self.axes[i] * (_cross(place + arm - self.anchors[i], push) + moment), 1
                )
        return out

    def total(self) -> np.ndarray:
        """Forces that move all bodies, without damping and armature."""
        return sum(
            self.force(j, link.mass, link.com, turned(link))
            for j, link in enumerate(self.machine.links)
        )

    def columns(self) -> np.ndarray:
        """Forces `[S, n, 10 n]` of ten point masses on each body, which span all its inertial
        parameters.
        """
        rng = np.random.default_rng(0)
        points = rng.normal(size=(10, 3)) * 0.3
        return np.stack([self.force(j, 1.0, p) for j in range(self.machine.n) for p in points], -1)


def _about(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotations [S, 3, 3] about a unit axis."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return (
        np.eye(3) + np.sin(angle)[:, None, None] * k + (1 - np.cos(angle))[:, None, None] * (k @ k)
    )
