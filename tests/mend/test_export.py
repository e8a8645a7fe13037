"""`adaptsim export`: every format of one small diagnosis, and what each says of it."""

import ast
import importlib.util
import json

import jax
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from adaptsim_jax.cli import main
from adaptsim_jax.mend.export import WRITERS, carried, read_diagnosis
from adaptsim_jax.mend.randomisation import write_randomisation
from tests.environments import catalogue
from tests.environments.in_c import mjcf_of
from tests.environments.test_diagnosed import REPORT

SERVO = {"kp of elbow": {"value": 6.0, "low": 5.4, "high": 6.6, "unit": "N m/rad"}}


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """Of the arm with friction and a late motor at the shoulder, and a servo of another kp."""
    folder = tmp_path_factory.mktemp("out")
    path = catalogue.written(folder, "stribeck")
    late = '[[effects]]\nname = "delay"\nwhere = "shoulder"\n[effects.parameters.delay]\n'
    text = f'{path.read_text()}{late}value = 0.021\nunit = "s"\n'
    path.write_text(text.replace("[[effects]]", "[servo.elbow]\nkp = 6.0\n[[effects]]", 1))
    report = REPORT | {"verdict": "explained", "declared": {"after": SERVO}}
    (folder / "report.json").write_text(json.dumps(report))
    (folder / "model.xml").write_text(mjcf_of(path))
    write_randomisation(folder)
    return folder


@pytest.mark.parametrize("form", list(WRITERS))
def test_every_format_is_written_and_says_of_each_effect_what_arrived(out, form, tmp_path, capsys):
    assert (
        main(["export", str(out), "--as", form, "--out", str(tmp_path / "to"), "--unchecked"]) == 0
    )
    printed = capsys.readouterr().out
    for name in ("coulomb", "stribeck", "delay", "servo"):
        assert name in printed
    for file in (tmp_path / "to").rglob("*.py"):
        ast.parse(file.read_text())
        assert "stribeck at shoulder: dropped" in file.read_text()
    for file in [*(tmp_path / "to").rglob("*.xml"), *(tmp_path / "to").rglob("*.urdf")]:
        assert mujoco.MjModel.from_xml_path(str(file)).njnt == 2


@pytest.mark.parametrize("form", ["playground", "brax"])
def test_worlds_differ_in_what_is_randomised_within_its_range(out, form, tmp_path):
    main(["export", str(out), "--as", form, "--out", str(tmp_path), "--unchecked"])
    spec = importlib.util.spec_from_file_location("randomize", tmp_path / "randomize.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    native = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    model = mjx.put_model(native)
    many, axes = module.domain_randomize(model, jax.random.split(jax.random.key(0), 50))
    moved = {"dof_frictionloss", "dof_damping", "dof_armature", "body_mass", "body_inertia"}
    moved |= {"actuator_gainprm", "actuator_biasprm"}
    assert [getattr(axes, name) for name in moved] == [0] * len(moved)
    assert axes.dof_solref is None
    rub = np.asarray(many.dof_frictionloss)[:, 0]
    assert 0.08 <= rub.min() < 0.09 and 0.11 < rub.max() <= 0.12
    gain, bias = (np.asarray(getattr(many, f"actuator_{z}prm"))[:, 1] for z in ("gain", "bias"))
    assert np.all((gain[:, 0] >= 5.4) & (gain[:, 0] <= 6.6)) and np.ptp(gain[:, 0]) > 0.5
    np.testing.assert_allclose(bias[:, 1], -gain[:, 0], rtol=1e-6)
    step = jax.vmap(lambda one: mjx.step(one, mjx.make_data(one)).qvel, in_axes=(axes,))
    with jax.numpy_rank_promotion("allow"):  # MJX's own
        assert np.isfinite(np.asarray(step(many))).all()


def test_delays_and_gains_stand_in_the_terms_of_each_tool(out, tmp_path):
    for form in ("mjlab", "isaaclab"):
        main(["export", str(out), "--as", form, "--out", str(tmp_path / form), "--unchecked"])
    one, other = ((tmp_path / z / "robot.py").read_text() for z in ("mjlab", "isaaclab"))
    assert "delay_min_lag=steps(0.0147, False)" in one and "stiffness=6," in one
    assert "max_delay=steps(0.0273, True)" in other and "friction=0.1," in other
    assert "NOT run by adaptsim" in one and "NOT run by adaptsim" in other


def test_a_urdf_has_the_inertias_of_the_model(out, tmp_path):
    main(["export", str(out), "--as", "urdf", "--out", str(tmp_path), "--unchecked"])
    models = [
        mujoco.MjModel.from_xml_path(str(p)) for p in (out / "model.xml", tmp_path / "robot.urdf")
    ]
    found = []
    for model in models:
        data, mass = mujoco.MjData(model), np.zeros((2, 2))
        data.qpos[:], data.qvel[:] = [0.4, -0.7], [1.0, 2.0]
        model.dof_armature[:] = 0.0
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        found.append([*mass.ravel(), *data.qfrc_bias])
    np.testing.assert_allclose(*found, rtol=1e-5, atol=1e-7)
    assert models[1].dof_damping.tolist() == [0.3, 0.05] and models[1].dof_frictionloss[0] == 0.1


def test_all_numbers_stand_in_json_with_unit_and_interval(out, tmp_path):
    main(["export", str(out), "--as", "json", "--out", str(tmp_path), "--unchecked"])
    found = json.loads((tmp_path / "numbers.json").read_text())
    level = next(e for e in found["effects"] if e["name"] == "coulomb")["parameters"]["level"]
    assert level == {"value": 0.1, "low": 0.08, "high": 0.12, "unit": "N m"}
    assert {d["joint"]: d["kind"] for d in found["drives"]} == {
        "shoulder": "motor",
        "elbow": "position",
    }
    assert found["randomised"]["actuator:elbow.gain"]["low"] == 5.4


def test_what_a_format_cannot_say_is_dropped_by_name(out):
    d = read_diagnosis(out)
    how = {form: {(r.effect, r.where): r.how for r in carried(d, form)} for form in WRITERS}
    assert how["mjcf"]["delay", "shoulder"] == "exact"
    assert how["playground"]["delay", "shoulder"] == "dropped"
    assert how["mjlab"]["delay", "shoulder"] == "approximated"
    assert all(z["stribeck", "shoulder"] == "dropped" for f, z in how.items() if f != "json")


def test_bad_input_is_one_line(tmp_path, capsys):
    assert main(["export", str(tmp_path), "--as", "mjcf"]) == 2
    assert "report.json: no such file; give the folder" in capsys.readouterr().err
    assert main(["export", str(tmp_path), "--as", "mjfc"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
