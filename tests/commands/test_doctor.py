"""`adaptsim doctor` names each optional part that is absent, and the line that installs it."""

import re
import tomllib
from pathlib import Path

from adaptsim_jax.commands import doctor

ROOT = Path(__file__).parents[2]
OF_DEVELOPERS = {"test", "docs", "dev", "bench"}


def test_every_optional_part_is_known():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(doctor.EXTRAS) == set(project["optional-dependencies"]) - OF_DEVELOPERS


def test_what_is_absent_is_named_with_the_line_that_installs_it(monkeypatch, capsys):
    installed = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "ray" else installed(name))
    monkeypatch.setattr(doctor, "_TRIALS", {name: str for name in doctor._TRIALS})
    found = doctor.examine()
    assert "cluster" in found["absent_extras"]
    doctor.show(found)
    text = capsys.readouterr().out
    assert re.search(r"cluster +not installed: .*pip install \"adaptsim_jax\[cluster\]\"", text)
