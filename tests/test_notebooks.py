"""Notebooks hold no outputs, and run from top to bottom as scripts."""

import json
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "docs" / "notebooks").glob("*.ipynb"))


def cells(path, kind):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert notebook["nbformat"] == 4
    return [cell for cell in notebook["cells"] if cell["cell_type"] == kind]


def test_there_are_two_without_outputs():
    assert len(NOTEBOOKS) == 2
    for path in NOTEBOOKS:
        for cell in cells(path, "code"):
            assert cell["outputs"] == [] and cell["execution_count"] is None, path


@pytest.mark.long
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_as_a_script(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    script = "\n".join("".join(cell["source"]) for cell in cells(path, "code"))
    names = {"__name__": "__main__"}
    exec(compile(script, path.name, "exec"), names)
    plt.close("all")
    assert list(tmp_path.glob("*.png")), "no cell drew anything"
    EXPECTED[path.stem](names, capsys.readouterr().out)


def closes_the_loop(names, printed):
    level = names["report"]["effects"][0]["parameters"]["level"]
    assert level["low"] < 0.15 < level["high"] and "coulomb at" in printed
    declared, mended = (names["np"].median(names[n].error) for n in ("declared", "mended"))
    assert mended < 0.1 * declared


def adapts(names, printed):
    reward = names["np"].asarray(names["found"].history.reward)
    assert (reward[:, -1] > reward[:, 0] + 0.3).all() and "best:" in printed


EXPECTED = {"close_the_loop": closes_the_loop, "train_and_adapt": adapts}
