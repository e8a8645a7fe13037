"""A person with a robot that drifts away from every E: what is deployed is corrected by the pushes
told; and so is `adapt`'s.
"""

import json
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.adaptation import training
from adaptsim_jax.cli import main
from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing import planar as pushing_planar
from adaptsim_jax.tasks.pushing.measured import read_policy

pytestmark = pytest.mark.slow
SIZES = (
    "phase1.trajectories=4",
    "phase1.parallel=2",
    "phase1.horizon=2",
    "phase1.updates=1",
    "phase1.batch=8",
    "phase1.capacity=12",
    "phase1.archive=12",
    "phase1.hidden=[16]",
    "phase1.reuse.first=60",
    "phase1.reuse.most=90",
    "phase1.reuse.least=20",
    "phase1.reuse.capacity=12",
    "phase1.reuse.together=2",
    "task.trials=200",
    "task.tests=6",
    "task.hidden=[16]",
    "task.pretrain=true",
    "task.tune=false",
    "task.refine=6",
    "task.correct=true",
    "task.goals=spread",
    "task.trajectories=4",
    "task.shared={contexts=60,trials=32,updates=200,batch=32,candidates=8}",
)
PUSHES = 8


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "push"
    assert (
        main(
            [
                "train",
                "pushing",
                "--preset",
                "paper-pushing",
                "--run",
                str(folder),
                *(word for size in SIZES for word in ("--set", size)),
            ]
        )
        == 0
    )
    return folder


def robot(*arguments):
    return main(["robot", *map(str, arguments)])


def drifting(actions, count):
    """Tracks `[N, 131, 2]` m of a bottle that veers to the left, which no parameter makes it do,
    the more the more pushes (`count [N]`) were made; with the start.
    """
    slide = jax.jit(jax.vmap(lambda a: pushing_planar.rollout(jnp.array([0.12, 1e5, 0.5, 0.0]), a)))
    way = np.asarray(slide(jnp.asarray(actions, jnp.float32))) - model.START
    turn = 0.10 + 0.004 * np.asarray(count)[:, None]
    x, y = way[..., 0], way[..., 1]
    veered = np.stack(
        [np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y], -1
    )
    return np.concatenate([np.zeros((len(way), 1, 2)), veered], 1) + model.START


def pushed(folder, out):
    """What a camera of 100 Hz sees of the pushes of actions.csv."""
    asked = np.loadtxt(folder / "actions.csv", delimiter=",", skiprows=1)
    tracks = drifting(asked[:, 3:], asked[:, 0])
    rows = [
        f"{n:.0f},{0.01 * k:.2f},{x:.6f},{y:.6f}"
        for n, way in zip(asked[:, 0], tracks, strict=True)
        for k, (x, y) in enumerate(way)
    ]
    out.write_text("\n".join(["trial,time,x,y", *rows, ""]))
    return out


def test_a_robot_that_drifts(run, tmp_path, capsys):
    folder = tmp_path / "robot"
    assert robot("new", run, "--dir", folder, "--starts", "1", "--iterations", "1") == 0
    assert "told" not in tomllib.loads((folder / "policy.toml").read_text())
    for turn in range(2):
        assert robot("record", pushed(folder, tmp_path / f"{turn}.csv"), "--dir", folder) == 0
        assert robot("next", "--dir", folder) == 0
    assert f"its actions are corrected by the {PUSHES} pushes told" in capsys.readouterr().out
    kept = tomllib.loads((folder / "best.toml").read_text())
    assert np.shape(kept["told"]["places"]) == (PUSHES, 2)
    listed = np.loadtxt(folder / "best_actions.csv", delimiter=",", skiprows=1)
    act = read_policy(folder / "best.toml")
    np.testing.assert_allclose(act(listed[:, 1:3]), listed[:, 3:], atol=2e-3)
    config.write(tmp_path / "plain.toml", {k: v for k, v in kept.items() if k != "told"})

    def ends(act):
        return drifting(act(listed[:, 1:3]), np.full(len(listed), PUSHES + 1))[:, -1]

    missed = [
        np.linalg.norm(ends(a) - listed[:, 1:3], axis=1).mean()
        for a in (read_policy(tmp_path / "plain.toml"), act)
    ]
    assert missed[1] < 0.5 * missed[0]  # with a policy that has hardly learned
    config.write(
        tmp_path / "torn.toml",
        kept | {"told": {"actions": kept["told"]["actions"][1:], "places": kept["told"]["places"]}},
    )
    with pytest.raises(BadInput, match="told: actions and places"):
        read_policy(tmp_path / "torn.toml")


def test_adapt_says_what_is_earned_corrected(run, tmp_path, capsys, monkeypatch):
    found, adapt_run = [], training.adapt_run
    monkeypatch.setattr(
        training, "adapt_run", lambda *a, **k: found.append(adapt_run(*a, **k)) or found[0]
    )
    assert (
        main(["adapt", str(run), "--target", "wd", "--iterations", "2", "--out", str(tmp_path)])
        == 0
    )
    assert "by the pushes made before, the best policy's by all 24" in capsys.readouterr().out
    told = json.loads((tmp_path / "result.json").read_text())["history"]
    corrected, plain = (
        np.array([[visit["reward"] for visit in start] for start in told]),
        found[0].history.reward,
    )
    np.testing.assert_allclose(corrected[:, 0], plain[:, 0], atol=1e-3)  # nothing was told yet
    assert (1 - corrected[:, 1:]).mean() < 0.6 * (1 - plain[:, 1:]).mean()
