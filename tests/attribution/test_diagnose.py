"""The whole of `adaptsim diagnose` on a mechanism, from files to a model file."""

import json

import mujoco
import numpy as np
import pytest

from adaptsim_jax import cli
from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.attribution.fitted import Selection, over_floor
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.posed import declared_vector
from adaptsim_jax.attribution.replay import replay_files
from adaptsim_jax.attribution.tree_objective import declared, select_shorter
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.schema import read_report
from adaptsim_jax.effects.joints.catalogue import MACHINE
from tests.attribution.pendulum import record, record_bristles
from tests.generators.mechanism_worlds import write_world


@pytest.mark.slow
def test_dry_friction_is_named_and_the_model_file_holds_it(tmp_path):
    data, out = record(tmp_path / "rub", friction=0.15), tmp_path / "out"
    assert cli.main(["diagnose", str(data), "--out", str(out)]) == 0
    report = read_report(out / "report.json")
    assert report["verdict"] in ("explained", "explained_class")
    (effect,) = report["effects"]
    assert effect["name"] == "coulomb" and effect["joints"] == ["hinge"]
    assert effect["parameters"]["level"]["value"] == pytest.approx(0.15, rel=0.05)
    assert report["error"]["after"] < 0.2 * report["error"]["before"]
    assert report["remaining"]["times_floor"] < 1.5
    model = mujoco.MjModel.from_xml_path(str(out / "model.xml"))
    assert model.dof_frictionloss[0] == pytest.approx(0.15, rel=0.05)
    assert replay_files(out / "model.xml", data).as_dict()["median"] == pytest.approx(
        report["error"]["after"], rel=0.15
    )
    assert (out / "report.html").exists()
    assert report["run"]["command"] == f"adaptsim diagnose {data} --out {out}"
    told = report["declared"][
        "after"
    ]  # the true link: 1 kg at 0.25 m, 0.01 kg m^2 about its centre
    assert told["inertia about hinge"]["value"] == pytest.approx(0.0725, rel=0.01)
    assert told["first moment z at hinge"]["value"] == pytest.approx(-0.25, rel=0.01)
    fixed = {name for name, row in told.items() if row["identifiable"]}
    assert {"inertia about hinge", "first moment z at hinge", "damping of hinge"} <= fixed
    assert not fixed & {"mass of link", "centre of mass z of link", "inertia yy of link"}
    assert set(report["fit_coordinates"]["after"]) >= {"size of hinge", "shift_z of hinge"}
    assert any("inertia about hinge" in note for note in report["notes"])


@pytest.mark.long
def test_a_few_short_trials_are_diagnosed_whole(tmp_path):
    """Of a small catalogue, to be quick."""
    data, out = (
        record(tmp_path / "rub", friction=0.2, trials=5, seconds=1.5, rate=125),
        tmp_path / "out",
    )
    others = [e.name for e in MACHINE if e.name not in ("viscous", "coulomb", "bias")]
    report = diagnose(data, out=out, exclude=tuple(others))
    assert [(e["name"], e["joints"]) for e in report["effects"]] == [("coulomb", ["hinge"])]
    assert report["effects"][0]["parameters"]["level"]["value"] == pytest.approx(0.2, rel=0.1)
    assert report["error"]["after"] < 0.5 * report["error"]["before"]
    assert report["candidates"][0]["accepted"] and report["candidates"][0]["name"] == "coulomb"
    assert [c["accepted"] for c in report["candidates"]].count(True) == 1
    (power,) = [
        row for row in report["power"] if row["name"] == "bias"
    ]  # what could have been found is a part of what was
    assert 0.0 < power["size"] < 0.1 and power["unit"] == "N m" and power["power"] == 0.8
    model = mujoco.MjModel.from_xml_path(str(out / "model.xml"))
    assert model.dof_frictionloss[0] == pytest.approx(0.2, rel=0.1)
    assert (out / "report.json").exists() and (out / "model.toml").exists()


@pytest.mark.slow
@pytest.mark.xfail(
    reason="named as its class: torque_gain and armature, which move to the bit like it, with "
    "inertia beside them"
)
def test_a_body_that_is_lighter_than_the_file_says_is_named_where_inertias_are_kept_and_noted_where_fitted(  # noqa: E501
    tmp_path,
):
    data = record(tmp_path / "light", friction=0.0, seed=4)
    fitted = diagnose(data)
    assert fitted["effects"] == [] and any(
        n.startswith("Unlike the model file") for n in fitted["notes"]
    )
    (data / "meta.toml").write_text((data / "meta.toml").read_text() + "[fit]\ninertias = false\n")
    report = diagnose(data, out=tmp_path / "out")
    assert ["inertia"] == [e["name"] for e in report["effects"]]

    def moment(numbers):
        return numbers["mass"] * numbers["centre_of_mass_z"]

    assert moment(
        {k: v["value"] for k, v in report["effects"][0]["parameters"].items()}
    ) == pytest.approx(-0.25, rel=0.02)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "model.xml"))
    assert model.body_mass[1] * model.body_ipos[1, 2] == pytest.approx(-0.25, rel=0.02)


@pytest.mark.slow
def test_a_lighter_body_is_one_of_a_class_where_inertias_are_kept(tmp_path):
    """Less mass with the same moment about its centre moves, to the bit, as the file's body with a
    stronger motor and a rotor: the torque 1.2 times, and (1.2 - 1) times the 0.01 kg m^2 about the
    centre.
    """
    data = record(tmp_path / "light", friction=0.0, seed=4)
    (data / "meta.toml").write_text((data / "meta.toml").read_text() + "[fit]\ninertias = false\n")
    report = diagnose(data)
    assert report["verdict"] == "explained_class"
    assert [e["alternatives"] for e in report["effects"]] == [["inertia@hinge"]] * 2
    size = {e["name"]: next(iter(e["parameters"].values()))["value"] for e in report["effects"]}
    assert size == pytest.approx({"torque_gain": 0.2, "armature": 0.2 * 0.01}, rel=0.02)


@pytest.mark.slow
def test_a_torque_that_acts_on_two_joints_is_named(tmp_path):
    world = write_world(
        tmp_path / "world", "single", 802, effect="torque_coupling", machine="furuta", mode="torque"
    )
    (effect,) = diagnose(world / "recording")["effects"]
    truth = json.loads((world / "truth.json").read_text())["effects"][0]["size"]["arm+free"]
    assert (effect["name"], effect["joints"]) == ("torque_coupling", ["free"])
    assert effect["parameters"]["onto"]["value"] == pytest.approx(truth["onto"], rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "given"),
    [
        (825, {"effect": "saturation"}),
        (830, {"effect": "saturation"}),
        (832, {"effect": "saturation"}),
    ],
)
def test_a_limit_is_named_that_acts_nearly_always_or_in_a_few_stretches_only(tmp_path, seed, given):
    write_world(tmp_path / "world", "single", seed, **given)
    (hidden,) = json.loads((tmp_path / "world/truth.json").read_text())["effects"]
    report = diagnose(tmp_path / "world/recording")
    (named,) = report["effects"]
    assert (named["name"], named["joints"], report["verdict"]) == (
        "saturation",
        hidden["joints"],
        "explained",
    )
    size = {k: row["value"] for k, row in named["parameters"].items()}
    assert (1.0 - size["cut"]) * size["peak"] == pytest.approx(
        hidden["size"][hidden["joints"][0]]["limit"], rel=0.01
    )


@pytest.mark.slow
def test_a_stop_that_a_third_of_the_stretches_hit_is_named(tmp_path):
    """Under weights that count these stretches as any other, a fit from afar is stuck."""
    write_world(tmp_path / "world", "single", 10171)
    (hidden,) = json.loads((tmp_path / "world/truth.json").read_text())["effects"]
    report = diagnose(tmp_path / "world/recording")
    (named,) = report["effects"]
    assert (named["name"], named["joints"], report["verdict"]) == (
        "hard_stop",
        hidden["joints"],
        "explained",
    )
    assert named["parameters"]["angle"]["value"] == pytest.approx(
        hidden["size"]["upper"]["angle"], rel=0.01
    )


@pytest.mark.slow
def test_friction_whose_bristles_bend_before_it_slides_is_named(tmp_path):
    report = diagnose(record_bristles(tmp_path / "lugre", level=0.3, deflection=0.03))
    size = {
        e["name"]: {k: row["value"] for k, row in e["parameters"].items()}
        for e in report["effects"]
    }
    assert set(size) == {"coulomb", "presliding"}
    assert size["coulomb"]["level"] == pytest.approx(0.3, rel=0.05)
    assert size["presliding"]["compliance"] == pytest.approx(0.1, rel=0.05)
    first = report["candidates"][
        :2
    ]  # bristles take nothing off without the friction that they bend under
    assert [(c["accepted"], c["held_out_gain"]) for c in first] == [
        (True, e["held_out_gain"]) for e in report["effects"]
    ]
    assert report["error"]["after"] < 0.1 * report["error"]["before"]


@pytest.mark.slow
def test_an_effect_whose_size_trades_places_with_inertias_is_named(tmp_path):
    write_world(tmp_path / "world", "single", 776)
    report = diagnose(tmp_path / "world/recording")
    assert [(e["name"], e["joints"]) for e in report["effects"]] == [("position_gain", ["rail"])]
    assert report["error"]["after"] < 0.3 * report["error"]["before"]


@pytest.mark.slow
@pytest.mark.xfail(
    reason="named right and 4 % too small: the torque judges this world, and a noisy motion "
    "shrinks what it tells"
)
def test_of_effects_that_do_as_well_the_simplest_has_the_name(tmp_path):
    write_world(
        tmp_path / "world", "single", 761
    )  # a constant torque, for which a score test takes a stop
    (named,) = diagnose(tmp_path / "world/recording")["effects"]
    assert (named["name"], named["joints"]) == ("bias", ["pole"])
    assert named["parameters"]["torque"]["value"] == pytest.approx(-0.0432, rel=0.02)


@pytest.mark.slow
def test_over_the_beginnings_of_stretches_friction_is_found_too(tmp_path):
    machine = load(record(tmp_path / "rub", friction=0.4), None)
    problem = machine.problem(MACHINE)
    null, criteria = declared_vector(machine, problem), Criteria()
    model = declared(problem, null, criteria)
    nothing = Selection(model, model, (), (), (), stages=(model,), last=(), reach=problem.reach)
    found = select_shorter(problem, null, criteria, nothing)
    assert found.shorter and "coulomb" in {n.candidate.effect for n in found.named}
    assert over_floor(problem, found.final) < 0.2 * over_floor(problem, model)


@pytest.mark.slow
def test_where_nothing_is_hidden_nothing_is_named(tmp_path):
    report = diagnose(record(tmp_path / "null", friction=0.0, seed=3))
    assert report["verdict"] == "within_noise" and report["effects"] == []


@pytest.mark.long
def test_torques_that_change_between_rows_are_no_effect(tmp_path):
    data = record(tmp_path / "fast", friction=0.0, rate=100, held=False, noise=5e-5)
    others = [
        e.name for e in MACHINE if e.name not in ("viscous", "delay", "sensor_delay", "torque_gain")
    ]
    report = diagnose(data, out=tmp_path / "out", exclude=tuple(others))
    assert (report["verdict"], report["effects"]) == ("within_noise", [])
    (note,) = [n for n in report["notes"] if "before their row" in n]
    assert 4.0 < float(note.split()[2]) < 6.0 and "10 ms apart" in note
    told = replay_files(tmp_path / "out" / "model.toml", data).as_dict()["median"]
    assert told == pytest.approx(report["error"]["after"], rel=0.15)


def test_the_folder_of_the_recordings_is_no_place_for_results(tmp_path, capsys):
    data = record(tmp_path / "rub", friction=0.1, trials=1, seconds=1.0)
    assert cli.main(["diagnose", str(data), "--out", str(data)]) == 2
    assert "is the folder of the recordings" in capsys.readouterr().err


def test_a_trial_that_is_not_there_cannot_be_left_out(tmp_path, capsys):
    data = record(tmp_path / "rub", friction=0.1, trials=1, seconds=1.0)
    assert (
        cli.main(["diagnose", str(data), "--out", str(tmp_path / "out"), "--without", "nine"]) == 2
    )
    assert "no trial is named 'nine'" in capsys.readouterr().err
    assert json.dumps(sorted(p.name for p in tmp_path.iterdir())) == '["rub"]'


OTHERS = tuple(e.name for e in MACHINE if e.name not in ("viscous", "bias"))


def test_a_gain_of_volts_that_was_found_is_told_and_stands_in_the_model(tmp_path):
    data, out = (
        record(tmp_path / "volts", friction=0.0, trials=5, seconds=1.5, rate=125),
        tmp_path / "out",
    )
    for path in data.glob("trial_*.csv"):
        table = np.loadtxt(path, delimiter=",", skiprows=1)
        table[:, 2] /= 0.06  # N m/V
        np.savetxt(path, table, delimiter=",", header="time,q1,u1", comments="", fmt="%.8g")
    xml = (data / "model.xml").read_text()
    (data / "model.xml").write_text(xml[: xml.index("<actuator>")] + "</mujoco>")
    with (data / "meta.toml").open("a") as file:
        file.write('[units]\nu1 = "V"\n')
    report = diagnose(data, out=out, exclude=OTHERS)
    assert any(note.startswith("Torque over input, fitted: hinge 0.0") for note in report["notes"])
    told = replay_files(out / "model.toml", data).as_dict()["median"]
    assert told == pytest.approx(report["error"]["after"], rel=0.5) and told < 2e-3


def test_one_trial_of_another_machine_is_told_whatever_the_others_say(tmp_path):
    data = record(tmp_path / "one", friction=0.0, trials=8, seconds=1.5, rate=125)
    other = record(tmp_path / "other", friction=0.3, trials=8, seconds=1.5, rate=125)
    (data / "trial_05.csv").write_text((other / "trial_05.csv").read_text())
    report = diagnose(data, exclude=OTHERS)
    assert report["verdict"] == "structured_unattributed"
    assert "of trial_05 up to" in report["message"] and "--without" in report["message"]
    assert diagnose(data, exclude=OTHERS, without=("trial_05",))["verdict"] == "within_noise"
