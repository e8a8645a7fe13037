"""`model.toml`: what is written is read back, and a bad file is told in one line that names the key
and the mend.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.attribution.pendulum import declared_model
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.logs.pendulum import read_pendulum
from adaptsim_jax.mechanisms.stepping import make_model
from adaptsim_jax.mend.model_toml import AddedEffect, Value
from adaptsim_jax.mend.pendulum_model import ModelFile, read_model, text_of, write_model


def example() -> ModelFile:
    """A hanging rigid pendulum with friction and a held shape, as a diagnosis would leave it."""
    theta = {"p1": 0.12, "p3": 0.03, "h1": 0.3, "h2": 0.11, "b1": 0.06, "b2": 0.03}
    units = dict(zip(theta, ["kg m^2"] * 2 + ["kg m"] * 2 + ["N m s/rad"] * 2, strict=True))
    declared = {k: Value(v, 0.9 * v, 1.1 * v, units[k]) for k, v in theta.items()}
    friction = AddedEffect("coulomb", "joint2", {"level": Value(0.02, 0.015, 0.025, "N m")})
    drag = AddedEffect(
        "quadratic_drag", "joint1", {"drag": Value(0.004, 0.003, 0.005, "N m s^2/rad^2")}
    )
    return ModelFile(
        "pendulum",
        "rigid_body",
        "hanging",
        {"l1": 0.3, "g": 9.81},
        declared,
        (friction, drag),
        {},
        {"verdict": "explained", "message": 'says "so"'},
    )


def test_what_is_written_is_read_back(tmp_path):
    model = example()
    write_model(tmp_path / "model.toml", model)
    back = read_model(tmp_path / "model.toml")
    assert [p.name for p in tmp_path.iterdir()] == ["model.toml"]
    assert (back.declared, back.effects, back.geometry) == (
        model.declared,
        model.effects,
        model.geometry,
    )
    assert back.provenance["message"] == 'says "so"'


def test_finer_shapes_of_files_of_before_are_read_over_where_they_do_nothing(tmp_path):
    path, text = tmp_path / "model.toml", text_of(example())
    more = '[effects.parameters.width]\nvalue = {}\nunit = "rad/s"\n\n[effects.parameters.level]'
    path.write_text(text.replace("[effects.parameters.level]", more.format(0.001)))
    assert set(read_model(path).effects[0].parameters) == {"level"}
    path.write_text(text.replace("[effects.parameters.level]", more.format(0.1)))
    with pytest.raises(BadInput, match="unknown parameter"):
        read_model(path)


def test_effects_land_in_their_slots_of_the_flat_vector(tmp_path):
    model = example()
    layout = make_model(model.plant(), catalogue("pendulum")).layout
    eff = model.effect_vector(layout)
    names = ["/".join(n) for n in layout.names()]
    assert eff[names.index("coulomb/joint2/level")] == 0.02
    assert eff[names.index("quadratic_drag/joint1/drag")] == 0.004
    assert np.sum(eff != layout.off()) == 2


BAD = (
    ("schema = 2", "schema = 9", "schema"),
    ('task = "pendulum"', 'task = "pushing"', "task"),
    ('model = "rigid_body"', 'model = "bendy"', "bendy"),
    ('angle_zero = "hanging"', 'angle_zero = "left"', "angle_zero"),
    ("l1 = 0.3", "l1 = nan", "geometry.l1"),
    ("l1 = 0.3", f"l1 = {10**400}", "geometry.l1"),
    ("[declared.p3]\nvalue = 0.03", f"[declared.p3]\nvalue = {10**30}\n# ", "declared.p3"),
    ("[declared.p3]\nvalue = 0.03", "[declared.p3]\nvalue = -0.03\n# ", "declared.p3"),
    ("[declared.h1]", "[declared.h9]", "h9"),
    ('unit = "kg m^2"', 'unit = "g mm^2"', "declared.p1.unit"),
    ('name = "coulomb"', 'name = "columb"', "did you mean 'coulomb'"),
    ('where = "joint2"', 'where = "joint7"', "joint7"),
    ("[effects.parameters.level]", "[effects.parameters.levels]", "levels"),
    ("value = 0.02\nlow = 0.015", "value = -0.02\nlow = -0.1", "negative"),
    ("[provenance]", "[provenence]", "provenance"),
    ("schema = 2", "schema = = 1", "TOML"),
    ("schema = 2", "schema = 1", "written by adaptsim_jax 0.1"),
)


@pytest.mark.parametrize(("old", "new", "named"), BAD)
def test_a_bad_file_is_told_in_one_line(tmp_path, old, new, named):
    text = text_of(example())
    assert old in text
    path = tmp_path / "model.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(BadInput) as caught:
        read_model(path)
    message = str(caught.value)
    assert named in message and "model.toml" in message and "\n" not in message and ";" in message


def test_missing_file_and_missing_keys(tmp_path):
    with pytest.raises(BadInput, match="no such file"):
        read_model(tmp_path / "none.toml")
    path = tmp_path / "model.toml"
    path.write_text(text_of(example()).replace("[declared.b2]", "[ignored]", 1))
    with pytest.raises(BadInput, match="ignored"):
        read_model(path)
    path.write_text('schema = 2\ntask = "pendulum"\n')
    with pytest.raises(BadInput, match="'model' is missing"):
        read_model(path)


def test_an_effect_twice_at_one_place_is_refused(tmp_path):
    model = example()
    path = tmp_path / "model.toml"
    path.write_text(text_of(replace(model, effects=(model.effects[0], model.effects[0]))))
    with pytest.raises(BadInput, match="again"):
        read_model(path)


def recording_folder(tmp_path, meta: str):
    """A short recording beside the example's file."""
    write_model(tmp_path / "model.toml", example())
    folder = tmp_path / "rig"
    folder.mkdir()
    (folder / "meta.toml").write_text(meta)
    t = np.arange(200) / 200
    rows = np.stack([t, 0.3 * np.sin(3 * t), 0.2 * np.cos(2 * t), 0 * t, 0.1 * np.sin(t)], 1)
    np.savetxt(folder / "a.csv", rows, delimiter=",", header="time,q1,q2,tau1,tau2", comments="")
    return folder


def test_a_recording_takes_the_geometry_of_its_mended_model(tmp_path):
    meta = 'task = "pendulum"\nmodel = "../model.toml"\nangle_zero = "hanging"\n'
    recording = read_pendulum(recording_folder(tmp_path, meta))
    rig = recording.meta.rig
    assert rig.model == "rigid_body" and rig.geometry["l1"] == 0.3
    given = declared_model(rig)
    assert given is not None and given.active == (
        ("coulomb", "joint2"),
        ("quadratic_drag", "joint1"),
    )


@pytest.mark.parametrize(
    ("meta", "named"),
    [
        ('angle_zero = "upright"\n', "angle_zero"),
        ('angle_zero = "hanging"\n[geometry]\nl1 = 0.5\n', "geometry.l1"),
    ],
)
def test_a_mended_model_of_another_rig_is_refused(tmp_path, meta, named):
    folder = recording_folder(tmp_path, 'task = "pendulum"\nmodel = "../model.toml"\n' + meta)
    with pytest.raises(BadInput, match=named):
        declared_model(read_pendulum(folder).meta.rig)


def test_the_text_is_plain_data():
    import tomllib

    table = tomllib.loads(text_of(example()))
    json.dumps(table)
    assert table["effects"][0]["parameters"]["level"]["unit"] == "N m"
