"""What the closed loop knows of a model: `Plant`. That of a declared pendulum is in
`mechanisms/double_pendulum/plant.py`.

A plant is a mechanical model in generalized coordinates,

    mass(theta, q) dv/dt = push(theta, q, v) + u + force,

whose two sides are linear in `theta` (for a rigid body these are the base parameters: Gautier and
Khalil, 1990), so that the data can fix what they can fix, no more.
Arrays carry any trailing batch axes: `x: [S, ...]`, `u: [U, ...]`, `force: [n, ...]`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.trig import once

Rows = Sequence[Any] | jax.Array  # one a state or joint, stacked or not


@dataclass(frozen=True)
class Plant:
    """A model as pure functions of `(constants, theta, ...)`.

    A pytree whose leaves are numbers, so that two plants of the same kind but other geometry share
    one compiled program.

    - `mass(constants, theta, q [n, ...])`: Rows of entries, each a number or `[...]`.
    - `gravity(constants, theta, q)`: `[n, ...]`.
    - `push(constants, theta, q, v)`: `[n, ...]`, all forces but the input.
    """

    name: str
    joint_dim: int
    command_dim: int
    theta_names: tuple[str, ...]
    theta_units: tuple[str, ...]
    mass: Callable
    push: Callable
    gravity: Callable
    constants: Mapping[str, np.ndarray]
    low: np.ndarray  # [P]
    high: np.ndarray  # [P]; low == high marks a known parameter

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(f"joint{i + 1}" for i in range(self.joint_dim))

    def deriv(
        self, theta: jax.Array, x: jax.Array, u: jax.Array, force: jax.Array, inertia: jax.Array
    ) -> jax.Array:
        """Time derivative of `x: [S, ...]` (positions, then velocities) under command `u: [U, ...]`
        N m, generalized force `force: [n, ...]` N m and extra inertia `inertia: [n, ...]` kg m^2 on
        the diagonal.
        """
        return jnp.stack(self.rates(theta, list(x), u, force, inertia))

    def rates(
        self, theta: jax.Array, x: Rows, u: Rows, force: Rows, inertia: Rows
    ) -> list[jax.Array]:
        """`deriv` a state at a time: all that is stacked there is a sequence here."""
        n = self.joint_dim
        pushed = [u[i] + force[i] for i in range(n)]
        return [*x[n:], *_accelerations(self, theta, list(x), pushed, list(inertia))]

    def gravity_force(self, theta: jax.Array, q: jax.Array) -> jax.Array:
        """Generalized force of gravity `[n, ...]` at `q: [n, ...]`; a tilt of the base adds to the
        first angle.
        """
        return self.gravity(self.constants, theta, q)

    def mass_matrix(self, theta: jax.Array, q: jax.Array) -> jax.Array:
        """`[n, n, ...]` kg m^2 at `q: [n, ...]`."""
        rows = self.mass(self.constants, theta, q)
        return jnp.stack([jnp.stack([m + jnp.zeros_like(q[0]) for m in row]) for row in rows])


jax.tree_util.register_dataclass(
    Plant,
    data_fields=["constants", "low", "high"],
    meta_fields=[
        "name",
        "joint_dim",
        "command_dim",
        "theta_names",
        "theta_units",
        "mass",
        "push",
        "gravity",
    ],
)


@jax.custom_jvp
def _accelerations(plant: Plant, theta, x: list, pushed: list, inertia: list) -> list:
    """Accelerations of the joints at `x` under the forces `pushed` besides the plant's own."""
    mass, push = _mass_and_push(plant, theta, x)
    return solve_mass(mass, inertia, [f + push[i] for i, f in enumerate(pushed)])


def _mass_and_push(plant: Plant, theta, x: list):
    q, v = jnp.stack(x[: plant.joint_dim]), jnp.stack(x[plant.joint_dim :])
    return plant.mass(plant.constants, theta, q), plant.push(plant.constants, theta, q, v)


def _by_the_balance(primals, tangents):
    """The derivative from the balance of forces at the accelerations that there are: no quotient is
    differentiated, and what the joints share is computed once.
    """
    n, (leaves, tree) = primals[0].joint_dim, jax.tree.flatten(primals)

    def zero(t):
        return isinstance(t, jax.custom_derivatives.SymbolicZero)

    slopes = jax.tree.leaves(tangents, is_leaf=zero)
    moving = [i for i, t in enumerate(slopes) if not zero(t)]
    acceleration = _accelerations(*primals)
    acceleration = once(acceleration, acceleration[0])

    def balance(some):
        """What pushes the joints beyond what these accelerations need, as some of the arguments
        change.
        """
        changed = list(leaves)
        for i, leaf in zip(moving, some, strict=True):
            changed[i] = leaf
        plant, theta, x, pushed, inertia = jax.tree.unflatten(tree, changed)
        mass, push = _mass_and_push(plant, theta, x)

        def needs(i):
            coupled = sum(mass[i][j] * acceleration[j] for j in range(n))
            return coupled + inertia[i] * acceleration[i]

        return [pushed[i] + push[i] - needs(i) for i in range(n)]

    _, rest = jax.jvp(balance, ([leaves[i] for i in moving],), ([slopes[i] for i in moving],))
    plant, theta, x, _, inertia = primals
    return acceleration, solve_mass(
        _mass_and_push(plant, theta, x)[0], inertia, once(rest, acceleration[0])
    )


_accelerations.defjvp(_by_the_balance, symbolic_zeros=True)


def solve_mass(mass: Rows, inertia: Rows, total: Rows) -> list[jax.Array]:
    """`(mass + diag(inertia))^-1 total`, a joint at a time, in closed form for one and two (batched
    LAPACK on 2x2 is slow).
    """
    n = len(total)
    if n == 1:
        return [total[0] * (1.0 / (mass[0][0] + inertia[0]))]
    if n == 2:
        m11 = mass[0][0] + inertia[0]
        m12 = mass[0][1]
        m22 = mass[1][1] + inertia[1]
        # one quotient, for along many directions they are most of the work
        shrink = 1.0 / (m11 * m22 - m12 * m12)
        first = (m22 * total[0] - m12 * total[1]) * shrink
        return [first, (m11 * total[1] - m12 * total[0]) * shrink]

    def wide(z):
        return z + jnp.zeros_like(total[0])

    full = jnp.stack([jnp.stack([wide(m) for m in row], -1) for row in mass], -2)
    full = full + jnp.stack([wide(m) for m in inertia], -1)[..., None] * jnp.eye(n)
    column = jnp.stack(list(total), -1)[..., None]
    solved = jnp.linalg.solve(full, column)[..., 0]
    return list(jnp.moveaxis(solved, -1, 0))
