"""Dynamics of trees of joints against MuJoCo's C engine, over random trees."""

import jax
import mujoco
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms import dynamics
from adaptsim_jax.mechanisms.mjcf import read_mechanism
from adaptsim_jax.mechanisms.tree import subtrees, take

LANES = 4


def random_mjcf(seed: int) -> str:
    """A tree of 1 to 6 bodies with one or two joints each, frames turned at random."""
    rng = np.random.default_rng(seed)

    def numbers(z):
        return " ".join(f"{x:.6g}" for x in z)

    count = int(rng.integers(1, 5))
    parts: dict[int, list[int]] = {b: [] for b in range(-1, count)}
    for b in range(count):
        parts[int(rng.integers(-1, b)) if b else -1].append(b)

    def body(b: int) -> str:
        joints = []
        for k in range(int(rng.integers(1, 3)) if rng.random() < 0.3 else 1):
            kind = "hinge" if rng.random() < 0.7 else "slide"
            joints.append(
                f'<joint name="j{b}_{k}" type="{kind}" axis="{numbers(rng.normal(size=3))}" '
                f'pos="{numbers(0.1 * rng.normal(size=3))}" '
                f'ref="{0.3 * rng.normal():.4g}" armature="{rng.uniform(0, 0.1):.4g}" '
                f'damping="{rng.uniform(0, 0.1):.4g}"/>'
            )
        inertia = np.sort(rng.uniform(0.02, 0.03, 3))
        return (
            f'<body name="b{b}" pos="{numbers(0.3 * rng.normal(size=3))}" '
            f'quat="{numbers(rng.normal(size=4))}">{"".join(joints)}'
            f'<inertial pos="{numbers(0.1 * rng.normal(size=3))}" '
            f'quat="{numbers(rng.normal(size=4))}" '
            f'mass="{rng.uniform(0.2, 2):.4g}" '
            f'diaginertia="{numbers(inertia)}"/>{"".join(body(c) for c in parts[b])}</body>'
        )

    inside = "".join(body(b) for b in parts[-1])
    return (
        f'<mujoco><option gravity="1 2 -9"/><compiler '
        f'angle="radian"/><worldbody>{inside}</worldbody></mujoco>'
    )


@jax.jit
def everything(tree, q, v, a, gravity):
    mass = dynamics.mass_matrix(tree, tree.inertial, q)
    bias = dynamics.inverse_dynamics(tree, tree.inertial, q, v, None, gravity)
    pull = -dynamics.gravity_force(tree, tree.inertial, q, gravity)
    return mass, bias, pull, dynamics.regressor(tree, q, v, a, gravity), dynamics.solve(mass, a)


@pytest.mark.parametrize(
    "seed", [s if s < 6 else pytest.param(s, marks=pytest.mark.slow) for s in range(30)]
)
def test_mass_bias_and_gravity_agree_with_mujoco(tmp_path, seed):
    path = tmp_path / "robot.xml"
    path.write_text(random_mjcf(seed))
    tree = read_mechanism(path).tree
    model = mujoco.MjModel.from_xml_path(str(path))
    rng = np.random.default_rng(seed)
    q, v, a = rng.normal(size=(3, tree.n, LANES))
    wanted = np.zeros((tree.n, tree.n, LANES)), np.zeros((tree.n, LANES)), np.zeros((tree.n, LANES))
    for lane in range(LANES):
        data = mujoco.MjData(model)
        for velocity, out in ((v[:, lane], wanted[1]), (0.0 * v[:, lane], wanted[2])):
            data.qpos[:], data.qvel[:] = q[:, lane], velocity
            mujoco.mj_forward(model, data)
            out[:, lane] = data.qfrc_bias
        full = np.zeros((tree.n, tree.n))
        mujoco.mj_fullM(model, data, full)
        wanted[0][..., lane] = full - np.diag(model.dof_armature)
    with jax.enable_x64(True):
        gravity = np.asarray(tree.gravity)
        mass, bias, pull, made, solved = (np.asarray(z) for z in everything(tree, q, v, a, gravity))

    def scale(z):
        return max(float(np.abs(z).max()), 1e-3)

    for mine, theirs in zip((mass, bias, pull), wanted, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-9 * scale(theirs))
    force = np.einsum("ijw,jw->iw", mass, a) + bias
    np.testing.assert_allclose(
        np.einsum("ikw,k->iw", made, np.ravel(tree.inertial)),
        force,
        rtol=0,
        atol=1e-9 * scale(force),
    )
    np.testing.assert_allclose(
        np.einsum("ijw,jw->iw", mass, solved), a, rtol=0, atol=1e-8 * scale(a)
    )


def test_subtrees_share_no_body(tmp_path):
    leg = (
        '<body name="{0}" pos="0 {1} 0"><joint name="{0}" axis="0 1 0"/><inertial pos="0 0 -1" '
        'mass="1" diaginertia="1 1 1"/></body>'
    )
    path = tmp_path / "legs.xml"
    path.write_text(
        f"<mujoco><worldbody>{leg.format('a', 0)}{leg.format('b', 1)}</worldbody></mujoco>"
    )
    tree = read_mechanism(path).tree
    assert subtrees(tree) == [(0,), (1,)]
    assert take(tree, (1,)).joint_names == ("b",)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (
            '<body><freejoint name="root"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 '
            '1"/></body>',
            "every joint is held",
        ),
        ("", "no joint"),
    ],
)
def test_what_has_no_joint_that_moves_is_refused_in_a_line(tmp_path, text, word):
    path = tmp_path / "robot.xml"
    path.write_text(f"<mujoco><worldbody>{text}</worldbody></mujoco>")
    with pytest.raises(BadInput, match=word) as error:
        read_mechanism(path)
    assert "robot.xml" in str(error.value) and "\n" not in str(error.value)
