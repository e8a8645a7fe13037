"""An effect of another package, one file of at most 40 lines and an entry point, has all that ours
have: both judges score it, the list, `--exclude` and reports know it, and so do model files.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

BRUSH = '''
import jax.numpy as jnp

from adaptsim_jax.diagnosis import Dry, Effect, Quantity


def brush(p, m):
    """A brush that rubs above the angle zero alone."""
    return Dry(p["level"] * (m.q > 0.0))


BRUSH = Effect(
    "brush",
    "force",
    (Quantity("level", "N m", 0.0, 2.0, 0.0, sign=1, mjcf="frictionloss"),),
    brush,
    "a brush that rubs on one side",
    "slow motion on both sides",
    title="one-sided brush",
)


def magnet(p, m):
    """A magnet that no field of an MJCF holds."""
    return -p["pull"] * m.q * jnp.exp(-jnp.square(m.q / 0.3))


MAGNET = Effect(
    "magnet",
    "force",
    (Quantity("pull", "N m/rad", -5.0, 5.0, 0.0),),
    magnet,
    "a magnet near zero",
    "slow motion",
)
'''
ASKED = """
import json, sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np

from adaptsim_jax import cli
from adaptsim_jax.attribution import mend
from adaptsim_jax.attribution.posed import declared_vector, excluded_of, posed
from adaptsim_jax.attribution.equation.balance import balances
from adaptsim_jax.attribution.equation.searched import EffectTable
from adaptsim_jax.attribution.equation.models import separable_candidates
from adaptsim_jax.attribution.estimate import linear
from adaptsim_jax.attribution.candidates import candidates
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.parameters import TreeFit
from adaptsim_jax.attribution.paths import run, starts_of
from adaptsim_jax.attribution.problem import own_inertia, scaled_reach
from adaptsim_jax.attribution.score import table
from adaptsim_jax.attribution.paths import losses, weigh
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.report.diagnosis_words import effect_name
from adaptsim_jax.simulators.mujoco.build import SteppedModel
from adaptsim_jax.simulators.mujoco.catalogue import rows
from tests.pins.machines import record

machine = load(record(Path(sys.argv[1]) / "log", "motors"), None)
some = tuple(e for e in MACHINE if e.name in ("viscous", "coulomb", "brush", "magnet"))
problem = posed(machine, some, 0.5)
null = declared_vector(machine, problem)
reach = scaled_reach(problem, *own_inertia(problem, null))
own = [c for c in candidates(problem, null, reach) if c.effect in ("brush", "magnet")]

starts = starts_of(problem)
paths = run(problem, null, starts)
weights = weigh(problem, paths)
lin = linear(problem, TreeFit(null, starts, weights, losses(problem, paths, weights), "", 0))
scores = {(s.candidate.effect, *s.candidate.joints): s.scatter for s in table(problem, lin, own)}

(balance,) = balances(problem, machine.tracks)
state = SimpleNamespace(
    problem=problem, null=null, reach=reach, commanded=False, limits=Criteria().torque, balance=balance
)
columns = EffectTable(problem, balance, null)
by_torque = {
    (c.effect, *c.joints): float(np.abs(columns.stack(c.entries)).max())
    for c in separable_candidates(state)
    if c.effect in ("brush", "magnet")
}

def finding(c):
    vector = null.with_entries(c.entries, [0.25])
    model = SimpleNamespace(added=(c,), fit=SimpleNamespace(vector=vector))
    return SimpleNamespace(final=model, named=(SimpleNamespace(candidate=c),))

brush, magnet = (next(c for c in own if c.effect == name) for name in ("brush", "magnet"))
final = finding(brush).final
arm = mujoco.MjModel.from_xml_path(machine.mechanism.path)
stepped = SteppedModel("", arm, np.arange(2), -1, arm.qpos0, ())
at_elbow = replace(problem, excluded=frozenset({("magnet", 1)}))
left = [c.joints for c in candidates(at_elbow, null, reach) if c.effect == "magnet"]
print(json.dumps({
    "left": left,
    "simulated": [[*k, v] for k, v in scores.items()],
    "balance": [[*k, v] for k, v in by_torque.items()],
    "excluded": [sorted(z) for z in excluded_of(["brush", "magnet at elbow"], {e.name for e in MACHINE}, machine.tree.joint_names)],
    "words": effect_name({"name": "brush", "where": "joint1"}),
    "held": mend.changes(machine, problem, final, final).joints["frictionloss"],
    "lost": [mend.lost(machine, problem, finding(c)) for c in (brush, magnet)],
    "mujoco": [e.name for e in rows(stepped, ("shoulder", "elbow"))],
    "listed": cli.main(["effects", "mechanism", "--name", "brush"]),
}))
"""  # noqa: E501


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    assert len(BRUSH.strip().splitlines()) <= 40
    (folder / "my_brush.py").write_text(BRUSH)
    info = folder / "my_brush-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-brush\nVersion: 0.1\n")
    points = "brush = my_brush:BRUSH\nmagnet = my_brush:MAGNET\n"
    (info / "entry_points.txt").write_text(f"[adaptsim.effects]\n{points}")
    root = Path(__file__).parents[2]
    paths = os.pathsep.join([str(folder), str(root), os.environ.get("PYTHONPATH", "")])
    asked = [sys.executable, "-c", ASKED, str(folder)]
    environment = os.environ | {"PYTHONPATH": paths}
    done = subprocess.run(asked, capture_output=True, text=True, cwd=root, env=environment)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1]) | {"printed": done.stdout}


@pytest.mark.parametrize("judge", ["simulated", "balance"])
def test_both_judges_score_it_at_every_joint(answers, judge):
    found = {(name, joint): size for name, joint, size in answers[judge]}
    assert set(found) == {(name, joint) for name in ("brush", "magnet") for joint in (0, 1)}
    assert all(size > 0.0 for size in found.values()), found


def test_it_is_listed_and_excluded_by_name_and_place(answers):
    assert answers["listed"] == 0 and "a brush that rubs on one side" in answers["printed"]
    assert answers["excluded"] == [["brush"], [["magnet", 1]]]
    assert answers["left"] == [[0]]


def test_it_has_its_words(answers):
    assert answers["words"] == "one-sided brush at joint 1"


def test_the_model_file_holds_it_or_says_that_it_cannot(answers):
    kept, gone = answers["lost"]
    assert kept == [] and answers["held"]["shoulder"] == pytest.approx(0.25)
    assert "model.xml cannot hold magnet at shoulder" in gone[0]


def test_mujoco_asks_for_it_where_it_edits_a_field(answers):
    assert {"brush at shoulder", "brush at elbow"} <= set(answers["mujoco"])
    assert not any("magnet" in name for name in answers["mujoco"])
