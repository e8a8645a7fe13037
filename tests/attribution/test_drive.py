"""Drives that give: the rotor and the link of a joint move against each other."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution.candidates import candidates
from adaptsim_jax.attribution.estimate import fit, linear
from adaptsim_jax.attribution.held_out import modelled
from adaptsim_jax.attribution.parameters import Entry, TreeFit
from adaptsim_jax.attribution.paths import losses, ready, residuals, run, starts_of, weigh, widened
from adaptsim_jax.attribution.problem import nuisances, own_inertia, prepare, scaled_reach
from adaptsim_jax.attribution.score import table
from adaptsim_jax.attribution.stretches import JointTrack
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.mechanisms.mjcf import read_mechanism

XML = """<mujoco><option timestep="0.0002" integrator="RK4"/><worldbody><body><joint name="arm" axis="0 0 1" damping="0.02"
armature="0.02"/>{opened}<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".8" contype="0" conaffinity="0"/>
<body pos=".3 0 0"><joint name="free" axis="1 0 0" damping="0.003"/><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".015"
mass=".2" contype="0" conaffinity="0"/></body>{closed}</body></worldbody></mujoco>"""  # noqa: E501
ROTOR = '<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>'
STIFFNESS, DASHPOT, DT = 10.0, 0.03, 0.005  # N m/rad, N m s/rad, s
USED = ("viscous", "armature", "coulomb", "delay", "drive_compliance", "drive_elasticity")


def recorded(rows: int, seed: int = 0):
    """A rotary pendulum whose arm's drive gives, by MuJoCo with a joint for the spring: angles and
    speeds [rows, 3], torque [rows].
    """
    spring = f'{ROTOR}<body><joint name="spring" axis="0 0 1" stiffness="{STIFFNESS}" damping="{DASHPOT}"/>'  # noqa: E501
    model = mujoco.MjModel.from_xml_string(XML.format(opened=spring, closed="</body>"))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    data.qpos[:] = 0.3, 0.05, 0.9
    data.qvel[:] = 0.5, -0.2, 1.0
    torque = np.repeat(rng.normal(size=rows // 5 + 1), 5)[:rows]
    q, v = [], []
    for u in torque:
        q.append(data.qpos.copy())
        v.append(data.qvel.copy())
        data.qfrc_applied[0] = u
        for _ in range(round(DT / model.opt.timestep)):
            mujoco.mj_step(model, data)
    return np.array(q), np.array(v), torque


def declared(tmp_path, trials: int, link: float, rows: int = 121, noise: float = 0.0):
    """(problem, its vector with the true drive) of the machine declared rigid; link: 1 where the
    encoder is on the link's side.
    """
    (tmp_path / "arm.xml").write_text(XML.format(opened="", closed=""))
    rng, tracks = np.random.default_rng(1), []
    for k in range(trials):
        q, v, torque = recorded(rows, k)
        seen = [
            np.stack([z[:, 0] + link * z[:, 1], z[:, 2]], 1) + noise * rng.normal(size=(rows, 2))
            for z in (q, v)
        ]
        tracks.append(
            JointTrack(
                str(k), DT * np.arange(rows), seen[0], seen[1], np.stack([torque, 0.0 * torque], 1)
            )
        )
    tree = read_mechanism(tmp_path / "arm.xml").tree
    problem = prepare(tree, tracks, tuple(e for e in MACHINE if e.name in USED))
    true = {
        "compliance": 1.0 / STIFFNESS,
        "damping": DASHPOT / STIFFNESS,
        "link": link,
        "control": link,
    }
    new = [Entry("drive_elasticity", key, (0,), z, 0.0, 0.0, 9.0, "1") for key, z in true.items()]
    return problem, nuisances(problem, inertia=False).with_entries(new)


@pytest.mark.parametrize("link", (0.0, 1.0))
def test_it_moves_as_a_machine_with_a_joint_for_the_spring(tmp_path, link):
    problem, vector = declared(tmp_path, 1, link)
    q, v, _ = recorded(121)
    first = problem.groups[0].stretches.time[0, 0]
    row = round(first / DT)
    start = widened(ready(problem, vector), starts_of(problem))[0].copy()
    ahead = np.array([q[row, 1], 0.0, v[row, 1], 0.0])
    start[:, 0] = (
        *(z[row, 0] + link * z[row, 1] if k == 0 else z[row, 2] for z in (q, v) for k in (0, 1)),
        *ahead,
    )
    (path,) = run(problem, vector, (start,))
    rows = slice(row, row + len(path.x))
    assert np.allclose(path.x[:, 0, 0], q[rows, 0] + link * q[rows, 1], atol=1e-6)
    assert np.allclose(path.x[:, 1, 0], q[rows, 2], atol=1e-6)
    assert np.allclose(path.ahead[:, 0, 0], q[rows, 1], atol=1e-6)


def test_derivatives_are_those_of_the_simulation(tmp_path):
    problem, vector = declared(tmp_path, 1, 0.0)
    (start,) = widened(ready(problem, vector), starts_of(problem))
    (path,) = run(problem, vector, (start,))
    weights = replace(weigh(problem, [path]), channel=np.ones(4), stretch=np.ones(start.shape[1]))
    lin = linear(
        problem, TreeFit(vector, (start,), weights, losses(problem, [path], weights), "", 0)
    )

    def off(v, s):
        return lin.counted[0].flat(residuals(problem.groups[0], run(problem, v, (s,))[0]))

    for k in range(len(start)):
        step = 1e-6 * (np.arange(len(start)) == k)[:, None]
        slope = (off(vector, start - step) - off(vector, start + step)) / 2e-6
        assert np.allclose(lin.start[0][:, :, k], slope, atol=1e-3 * max(np.abs(slope).max(), 1e-6))
    for i, e in enumerate(vector.entries[:-2]):
        step = 1e-5 * vector.values[i] * (np.arange(len(vector)) == i)
        slope = off(vector.at(vector.values - step), start) - off(
            vector.at(vector.values + step), start
        )
        slope = slope / (2.0 * step[i])
        assert np.linalg.norm(lin.shared[0][:, :, i] - slope) < 0.1 * np.linalg.norm(slope), e.key


@pytest.mark.long
@pytest.mark.parametrize("link", (0.0, 1.0))
def test_a_score_test_finds_it_and_a_fit_its_size(tmp_path, link):
    problem, true = declared(tmp_path, 6, link, 300, 3e-4)
    rigid = nuisances(problem, inertia=False)
    base = modelled(problem, (), fit(problem, rigid, rounds=6))
    reach = scaled_reach(problem, *own_inertia(problem, rigid))
    best = table(problem, base.lin, candidates(problem, rigid, reach))[0]
    assert (best.candidate.effect, best.candidate.joints) == ("drive_elasticity", (0,))
    assert best.candidate.shaped()["link"] == link and best.p < Criteria().alpha
    found = fit(
        problem,
        true.at(true.values * np.where(true.values == link, 1.0, 1.3)),
        base.fit.starts,
        rounds=8,
    )
    values = {e.name: z for e, z in zip(found.vector.entries, found.vector.values, strict=True)}
    assert values["compliance"] == pytest.approx(1.0 / STIFFNESS, rel=0.02)


def test_a_joint_without_a_rotor_has_none(tmp_path):
    problem, _ = declared(tmp_path, 1, 0.0)
    some = candidates(
        problem,
        nuisances(problem, inertia=False),
        scaled_reach(problem, *own_inertia(problem, nuisances(problem))),
    )
    assert {c.joints for c in some if c.effect == "drive_elasticity"} == {(0,)}
