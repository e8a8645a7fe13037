"""What a user holds on to: public names, help, exit codes, the catalogue, keys and types of
reports, experiments that can be imported.
"""

import contextlib
import importlib
import inspect
import io
import json
from pathlib import Path
from typing import Any

import pytest

import adaptsim_jax
import adaptsim_jax.diagnosis
from adaptsim_jax import cli
from adaptsim_jax.commands import SUMMARIES
from adaptsim_jax.diagnosis.simulated import diagnose_simulator
from tests.diagnosis.test_simulator import recorded
from tests.pins.stored import check

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def signature(thing: Any) -> str:
    """How a public thing is called: names of its arguments, without types."""
    try:
        return f"({', '.join(inspect.signature(thing).parameters)})"
    except (TypeError, ValueError):
        return type(thing).__name__


@pytest.mark.parametrize("module", [adaptsim_jax, adaptsim_jax.diagnosis], ids=lambda m: m.__name__)
def test_public_names_and_their_arguments(module):
    names = {name: signature(getattr(module, name)) for name in sorted(module.__all__)}
    check(f"public_{module.__name__.replace('.', '_')}", names)


def run(*words: str) -> tuple[int, str]:
    """Exit code and what is printed."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        try:
            code = cli.main(list(words))
        except SystemExit as leaving:
            code = int(leaving.code or 0)
    return code, out.getvalue()


def test_help_of_all_commands(monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    pages = {name: run(name, "--help")[1].splitlines() for name in SUMMARIES}
    check("help", {"": run("--help")[1].splitlines(), **pages})


def test_exit_codes(tmp_path):
    codes = {
        "--version": run("--version")[0],
        "effects": run("effects")[0],
        "effects nothing": run("effects", "no_such_effect")[0],
        "unknown command": run("no_such_command")[0],
        "diagnose nothing": run("diagnose", str(tmp_path / "none"))[0],
        "replay nothing": run("replay", str(tmp_path / "none"))[0],
        "train unknown option": run("train", "--no-such-option")[0],
    }
    check("exit_codes", codes)


def test_the_catalogue_as_json():
    check("effects", json.loads(run("effects", "--json")[1]))


def kinds(z: Any) -> Any:
    """Keys and types of a report, of a list those of its first row."""
    if isinstance(z, dict):
        return {k: kinds(v) for k, v in z.items()}
    if isinstance(z, list):
        return [kinds(z[0])] if z else []
    return "number" if type(z) in (int, float) else type(z).__name__


@pytest.mark.parametrize("hidden", ["leak", "nothing"])
def test_keys_and_types_of_a_simulators_report(hidden):
    report = diagnose_simulator(recorded({"leak": 0.004} if hidden == "leak" else {}, seed=3))
    check(f"report_simulator_{hidden}", kinds(report))


@pytest.mark.parametrize("name", sorted(p.stem for p in EXPERIMENTS.glob("[!_]*.py")))
def test_an_experiment_can_be_imported(name, monkeypatch):
    monkeypatch.syspath_prepend(EXPERIMENTS)
    importlib.import_module(f"experiments.{name}")
