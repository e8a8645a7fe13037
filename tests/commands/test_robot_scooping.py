"""`adaptsim robot` and `adaptsim adapt` on a run of scooping, from Phase 1 to the best policy."""

import csv
import json
import tomllib

import numpy as np
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.report import film as films
from adaptsim_jax.tasks.scooping import film
from adaptsim_jax.tasks.scooping.measured import read_policy

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
    "task.trials=100",
    "task.tests=2",
    "task.hidden=[16]",
    "task.training={block=20,updates=5,batch=16,capacity=100,candidates=4}",
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "scoop"
    sizes = [word for size in SIZES for word in ("--set", size)]
    assert main(["train", "scooping", "--run", str(folder), *sizes]) == 0
    return folder


def scooped(folder, out, on):
    """Tracks of pieces that go 0.2 m ahead as the blade comes, the last of which ends on the
    spatula if `on`.
    """
    with open(folder / "actions.csv", newline="") as file:
        asked = list(csv.DictReader(file))
    rows = ["trial,time,x,y,on"]
    for i, scoop in enumerate(asked):
        for time in np.arange(0, 1.02, 1 / 30):
            gone = np.clip(time - 0.16, 0, 2 / 3)
            x = float(scoop["place_x"]) + 0.6 * gone - 0.45 * gone**2
            rows.append(
                f"{scoop['trial']},{time:.4f},{x:.5f},{scoop['place_y']},{int(on and i > 0)}"
            )
    out.write_text("\n".join([*rows, ""]))
    return out


def test_a_session_from_start_to_best_policy(run, tmp_path, capsys):
    folder = tmp_path / "robot"
    assert (
        main(["robot", "new", str(run), "--dir", str(folder), "--starts", "1", "--iterations", "1"])
        == 0
    )
    first = (folder / "actions.csv").read_text()
    assert (
        first.startswith("trial,place_x,place_y,pitch,rate,distance\n1,")
        and len(first.splitlines()) == 3
    )
    assert "a probe)" in capsys.readouterr().out
    record = scooped(folder, tmp_path / "a.csv", False)
    mirrored = [line.split(",") for line in record.read_text().splitlines()]
    rows = [
        ",".join([*c[:2], c[2] if k == 0 else str(-float(c[2])), *c[3:]])
        for k, c in enumerate(mirrored)
    ]
    (tmp_path / "mirrored.csv").write_text("\n".join([*rows, ""]))
    assert main(["robot", "record", str(tmp_path / "mirrored.csv"), "--dir", str(folder)]) == 2
    assert "off the spatula's way: another frame?" in capsys.readouterr().err
    assert main(["robot", "record", str(record), "--dir", str(folder)]) == 0
    assert main(["robot", "record", str(tmp_path / "a.csv"), "--dir", str(folder)]) == 2
    assert "was told already" in capsys.readouterr().err
    assert main(["robot", "next", "--dir", str(folder)]) == 0
    assert (folder / "actions.csv").read_text().splitlines()[1].startswith("3,")
    assert (
        main(
            [
                "robot",
                "record",
                str(scooped(folder, tmp_path / "b.csv", True)),
                "--dir",
                str(folder),
            ]
        )
        == 0
    )
    assert "return 0.5, the best so far" in capsys.readouterr().out
    assert main(["robot", "next", "--dir", str(folder)]) == 0
    said = capsys.readouterr().out
    assert (
        "all 2 iterations are told; best return 0.5" in said
        and "corrected by the 4 scoops told" in said
    )
    act = read_policy(folder / "best.toml")
    pitch, rate, distance = act([0.01, 0.0])
    # the scoop that won is the likeliest to win again, or near to it, wherever the piece lies
    probed = np.loadtxt(folder / "actions.csv", delimiter=",", skiprows=1)[1, 3:]
    np.testing.assert_allclose(act(np.zeros((3, 2))), np.tile([pitch, rate, distance], (3, 1)))
    half = np.array([0.07, 0.2, 0.0075])
    assert np.linalg.norm((act([0.0, 0.0]) - probed) / half) < 1.0
    kept = tomllib.loads((folder / "best.toml").read_text())
    config.write(
        tmp_path / "torn.toml", kept | {"policy": kept["policy"] | {"corrected": [0.1, 0.2]}}
    )
    with pytest.raises(BadInput, match="corrected must be three numbers"):
        read_policy(tmp_path / "torn.toml")


def test_adapt_draws_and_films(run, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(films, "rendered", lambda *_: False)
    monkeypatch.setattr(film, "FRAMES", 4)
    out = tmp_path / "adapted"
    assert (
        main(
            [
                "adapt",
                str(run),
                "--target",
                "ood-1",
                "--starts",
                "1",
                "--iterations",
                "1",
                "--out",
                str(out),
                "--video",
            ]
        )
        == 0
    )
    said = capsys.readouterr().out
    assert "scoops.png" in said and "drawn from the side" in said
    assert "scoops are corrected by those made before, the best policy's by all 4" in said
    found = json.loads((out / "result.json").read_text())
    assert np.shape(found["best"]["policy"]["told.actions"]) == (4, 3) and np.shape(
        found["history"]
    ) == (1, 2)
    assert (out / "scoops.png").stat().st_size > 10_000 and any(out.glob("scoop.*"))
