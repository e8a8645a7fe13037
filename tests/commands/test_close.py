"""`adaptsim close`: a chain of commands, each done once; what they come to."""

import json
import subprocess
from pathlib import Path

import pytest

from adaptsim_jax.cli import main

ENV = Path(__file__).parents[2] / "examples" / "env.toml"
FOUND = {"name": "coulomb", "where": "slide", "physics": "dry friction", "parameters": {}}


def rows(base):
    cells = [("nominal", 0, 1.0), ("udr", 0, 2.0), ("adaptsim", 4, 3.0)]
    return [
        {"method": m, "setting": "dry", "target_trials": n, "returns": [base + z, base + z + 1.0]}
        for m, n, z in cells
    ]


@pytest.fixture
def ran(monkeypatch):
    """The stages that were run, by stand-ins that leave what the real ones leave."""
    every, state = [], {"effects": [FOUND], "fails": ""}

    def run(words, check):
        command = words[3:]
        every.append(command)
        out = Path(command[command.index("--out") + 1])
        if out.name == state["fails"]:
            return subprocess.CompletedProcess(words, 1)
        out.mkdir(parents=True, exist_ok=True)
        if command[0] == "diagnose":
            report = {"verdict": "explained", "message": "It rubs.", "effects": state["effects"]}
            (out / "report.json").write_text(json.dumps(report))
        else:
            base = 10.0 if "--diagnosis" in command else 0.0
            found = {"rows": rows(base), "settings": {"dry": {"udr_return": base}}}
            (out / "results.json").write_text(json.dumps(found))
        return subprocess.CompletedProcess(words, 0)

    monkeypatch.setattr(subprocess, "run", run)
    return every, state


def test_before_and_after_stand_side_by_side(ran, tmp_path, capsys):
    every, _ = ran
    words = ["close", "logs", str(ENV), "--out", str(tmp_path / "c"), "--trials", "4"]
    assert main([*words, "--seeds", "2", "--set", "train.every=7"]) == 0
    assert [c[0] for c in every] == ["diagnose", "compare", "compare"]
    both = every[1:]
    assert all("iterations=3" in c and "starts=1" in c and "train.every=7" in c for c in both)
    assert both[1][both[1].index("--diagnosis") + 1] == str(tmp_path / "c" / "diagnosis")
    found = json.loads((tmp_path / "c" / "result.json").read_text())
    means = {(r["simulator"], r["method"]): r["mean"] for r in found["rows"]}
    assert means["declared", "adaptsim"] == 3.5 and means["mended", "udr"] == 12.5
    page = (tmp_path / "c" / "report.html").read_text()
    assert "13.5 (13 to 14)" in page and "It rubs." in page and "mended/report.html" in page
    out = capsys.readouterr().out
    assert "mended 13.5 (13 to 14)" in out and "dry friction, at slide" in out
    assert "dry, AdaptSim: the mended simulator's policy returns 10 more (in every seed)." in out
    assert "returns 10 more (in every seed)" in page and "Found: dry friction, at slide." in page


def test_what_was_done_is_not_done_again(ran, tmp_path, capsys):
    every, state = ran
    words = ["close", "logs", str(ENV), "--out", str(tmp_path / "c")]
    state["fails"] = "mended"
    assert main(words) == 2
    assert "mended: `adaptsim compare" in capsys.readouterr().err
    assert not (tmp_path / "c" / "result.json").exists()
    state["fails"] = ""
    del every[:]
    assert main(words) == 0
    assert [Path(c[c.index("--out") + 1]).name for c in every] == ["mended"]


def test_where_nothing_was_found_both_are_one(ran, tmp_path):
    every, state = ran
    state["effects"] = []
    assert main(["close", "logs", str(ENV), "--out", str(tmp_path / "c")]) == 0
    assert [c[0] for c in every] == ["diagnose", "compare"]
    page = (tmp_path / "c" / "report.html").read_text()
    assert "both simulators are one" in page and "mended/report.html" not in page


def test_an_environment_that_is_none_is_refused_before_anything_is_written(ran, tmp_path, capsys):
    bad = tmp_path / "env.toml"
    bad.write_text('evn = "cartpole"\n')
    assert main(["close", "logs", str(bad), "--out", str(tmp_path / "c")]) == 2
    assert "evn" in capsys.readouterr().err and not (tmp_path / "c").exists() and not ran[0]
