"""The blocks of docs/your-own-effect.md run, in order, as a reader would paste them, in an empty
folder.
"""

import re
from pathlib import Path

import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.base import Effect, Quantity
from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.mend.model_toml import AddedEffect, Value
from adaptsim_jax.mend.pendulum_model import ModelFile
from adaptsim_jax.tasks.pendulum.augmented import mended_space
from adaptsim_jax.tasks.pendulum.augmented_policy import make_world

PAGE = Path(__file__).parents[2] / "docs" / "your-own-effect.md"


@pytest.mark.slow
def test_the_pages_blocks_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)
    assert len(blocks) == 5
    names = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    assert "one_way_friction" in capsys.readouterr().out
    assert "one way friction at joint 1" in (tmp_path / "own" / "report.html").read_text().lower()


def test_a_model_takes_its_effects_from_the_library_it_was_read_with():
    size = Quantity("size", "N m", -1.0, 1.0, 0.0)
    mine = Effect("mine", "force", (size,), lambda p, m: p["size"] * m.q, "physics", "excitation")

    def value(x, unit):
        return Value(x, x, x, unit)

    declared = {"m1": value(1.5, "kg"), "m2": value(1.4, "kg")}
    declared |= {"b1": value(1.2, "N m s/rad"), "b2": value(1.8, "N m s/rad")}
    geometry, added = (
        {"l1": 1.0, "l2": 1.0, "g": 9.81},
        (AddedEffect("mine", "joint2", {"size": value(0.1, "N m")}),),
    )

    def make(library):
        return ModelFile(
            "pendulum", "linearized", "upright", geometry, declared, added, library=tuple(library)
        )

    space, _ = mended_space(make((*catalogue("pendulum"), mine)))
    assert space.names[-1] == "mine_joint2_size"
    assert make_world(make([mine])).model.layout.effects == (mine,)
    with pytest.raises(BadInput, match="mine"):
        mended_space(make(()))
