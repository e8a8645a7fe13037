"""`adaptsim parity pushing`: every pair, speeds, and engines that are not there."""

import json

import numpy as np
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.pushing import engines as parity
from adaptsim_jax.tasks.pushing import model as pushing


@pytest.fixture
def few(monkeypatch):
    """Two engines and an absent one, so that nothing long is compiled."""
    real = parity._backend

    def backend(name, options):
        if name == "drake":
            raise BadInput("backend drake is not installed; pip install 'adaptsim_jax[drake]'")
        return real(name, options)

    monkeypatch.setattr(parity, "ENGINES", ("native", "planar", "drake"))
    monkeypatch.setattr(parity, "_backend", backend)


def test_pairs_and_speeds(few, capsys):
    assert main(["parity", "pushing", "--samples", "6", "--seed", "3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    (row,) = found["pairs"]
    assert row["pair"] == ["native", "planar"] and row["compared"] == 6
    assert 0 < row["median_mm"] <= row["p90_mm"] <= row["p99_mm"] <= row["max_mm"] < 60
    assert [e["engine"] for e in found["engines"] if e["ran"]] == ["native", "planar"]
    assert all(e["pushes_per_second"] > 0 for e in found["engines"] if e["ran"])


def test_the_table_says_what_did_not_run(few, capsys):
    assert main(["parity", "pushing", "--samples", "3"]) == 0
    out = capsys.readouterr().out
    assert "native - planar" in out and "did not run: backend drake is not installed" in out


def test_pushes_that_went_wrong_are_left_out_and_counted():
    place = np.zeros((4, 2))
    code = np.array([pushing.FINE, pushing.FALLEN, pushing.FINE, pushing.UNFIT])
    a = parity.EngineRun(place, code, 0.0, 1.0, 1.0)
    b = parity.EngineRun(place + 0.003, np.zeros(4, int), 0.0, 1.0, 1.0)
    row = parity._distances(a, b)
    assert row["compared"] == 2 and row["max_mm"] == pytest.approx(3 * 2**0.5)
    assert parity._row(a)["went_wrong"] == {pushing.MESSAGES[2]: 1, pushing.MESSAGES[3]: 1}
    assert parity._distances(a, b._replace(code=code[::-1] * 0 + 1)) == {"compared": 0}
