"""A simulator of one's own (`examples/coupled_tanks.py`): what is named, what is not, what could
have been, and what is refused.
"""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adaptsim_jax import BadInput, Effect, Quantity, Simulator, diagnose_simulator
from adaptsim_jax.cli import main
from adaptsim_jax.core.registry import Registry
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.fit import completed, jacobian
from adaptsim_jax.diagnosis.rows import check_exclude
from adaptsim_jax.diagnosis.schema import read_report
from adaptsim_jax.diagnosis.simulated import check_skill, unweighted
from adaptsim_jax.diagnosis.simulator import SIMULATORS, simulator_named
from adaptsim_jax.diagnosis.starts import problem_of, settle
from adaptsim_jax.diagnosis.trials import search_trials

EXAMPLE = Path(__file__).parents[2] / "examples" / "coupled_tanks.py"
TANKS = runpy.run_path(str(EXAMPLE))
recorded = TANKS["recorded"]


@pytest.mark.parametrize(
    ("name", "size"), [("leak", 0.004), ("dead_voltage", 0.8), ("sensor_offset", 30.0)]
)
def test_what_the_plant_has_besides_is_named_with_its_size(name, size, tmp_path):
    report = diagnose_simulator(recorded({name: size}, seed=3), out=tmp_path)
    (effect,) = report["effects"]
    value = effect["parameters"][name]
    assert effect["name"] == name and value["value"] == pytest.approx(size, rel=0.1)
    assert report["error"]["after"] < 1.2 < report["error"]["before"]
    assert (tmp_path / "report.json").exists() and f'name = "{name}"' in (
        tmp_path / "model.toml"
    ).read_text()


@pytest.mark.parametrize("seed", range(4))
def test_a_plant_that_is_the_model_has_nothing_named(seed):
    report = diagnose_simulator(recorded({"gain": 1.1, "drain_2": 0.27}, seed=seed))
    assert report["verdict"] == "within_noise" and not report["effects"]
    assert report["declared"]["after"]["gain"]["value"] == pytest.approx(1.1, rel=0.02)
    power = {row["name"]: row["power"] for row in report["power"]}
    assert power["leak"] < 0.9 and set(power) == {c.name for c in TANKS["CANDIDATES"]}


def test_an_error_is_held_against_doing_nothing():
    report = diagnose_simulator(recorded({"leak": 0.004}, seed=3))
    error = report["error"]
    assert error["after"] < error["straight_line"] < error["hold_still"]
    assert error["skill"]["after"] == pytest.approx(1.0 - error["after"] / error["straight_line"])


def test_a_model_that_predicts_nothing_names_nothing():
    """Tanks that nothing flows out of, under noise that is said to be a hundredth of what it is:
    any leak helps, and is no finding.
    """
    tanks = recorded({"gain": 0.02, "drain_1": 0.001, "drain_2": 0.001}, seed=4)
    noisy = tanks.stretches.measured + 20.0 * np.random.default_rng(0).standard_normal(
        tanks.stretches.measured.shape
    )
    ramp = (
        3.0
        * np.arange(noisy.shape[1])[None, :, None]
        * np.random.default_rng(1).standard_normal((len(noisy), 1, 2))
    )
    object.__setattr__(tanks, "stretches", replace(tanks.stretches, measured=noisy + ramp))
    report = diagnose_simulator(tanks)
    assert not report["effects"] and report["message"].startswith("The model predicts nothing")
    assert report["error"]["skill"]["after"] < 0.0


@pytest.mark.parametrize(("after", "named"), [(0.97, True), (0.99, False)])
def test_names_need_a_model_better_than_a_straight_line(after, named):
    """Whatever the declared model is worth: what the final one is decides."""
    error = {"after": after, "straight_line": 1.0, "hold_still": 2.0}
    error["skill"] = {"before": 0.5, "after": 1.0 - after}
    report = {"error": error, "effects": [{"name": "leak", "where": "tank_1"}], "message": ""}
    report |= {"not_established": [], "candidates": []}
    check_skill(report, Criteria())
    assert bool(report["effects"]) is named


def test_a_stretch_far_off_counts_whole_in_what_is_reported():
    """A weight of a half had taken its squared error to a quarter."""
    problem = problem_of(recorded({"leak": 0.004}, seed=3))
    model = search_trials(problem, Criteria()).final
    halved = replace(problem, weight=np.full(len(model.fit.held), 0.5))
    assert unweighted(halved, model).fit.held == pytest.approx(4.0 * model.fit.held)


def test_few_trials_are_left_out_by_blocks():
    report = diagnose_simulator(recorded({"leak": 0.004}, seed=5, trials=3))
    assert [e["name"] for e in report["effects"]] == ["leak"]
    assert report["data"] == {
        "trials": 3,
        "samples": 3 * 120,
        "held_out_trials": 8 if report["data"]["held_out_trials"] == 8 else 9,
    }


def test_look_alikes_are_told_as_a_class_with_the_motion_that_parts_them():
    """A second name for the same quantity does as well, whatever is run."""
    tanks = recorded({"leak": 0.004}, seed=6)
    twin = replace(tanks.candidates[0], name="evaporation")
    object.__setattr__(tanks, "candidates", (*tanks.candidates, twin))
    report = diagnose_simulator(tanks, proposals={"fast": recorded({}, seed=7)})
    (effect,) = report["effects"]
    assert report["verdict"] == "explained_class" and len(effect["alternatives"]) == 1
    assert (
        report["next_experiment"]["distance"] < 1.0
        and "hardly seen" in report["next_experiment"]["message"]
    )
    assert report["next_experiment"]["proposal"] == "fast"


def test_starts_are_fitted_and_taken_out_of_the_columns():
    tanks = recorded({}, seed=8)
    far = tanks.stretches.start + 20.0
    values = np.tile([q.default for q in tanks.quantities], (tanks.stretches.count, 1))
    found = settle(tanks, values, far, 12)
    free = tanks.stretches.measured[0].size - 2
    assert np.median(np.square(found.residual).sum(1) / free) == pytest.approx(1.0, abs=0.4)
    problem = problem_of(tanks)
    own = jacobian(problem, values[0], ["sensor_offset"])
    whole = jacobian(problem, values[0], ["gain"])
    assert own.shape == whole.shape == (tanks.stretches.count, tanks.stretches.measured[0].size, 1)
    assert np.square(own).sum() < np.square(
        tanks.stretches.measured[0].size
    )  # an offset is mostly another start
    fit = completed(problem, problem.declared, values[0])
    assert fit.vectors.shape == values.shape and len(np.unique(fit.vectors, axis=0)) == len(
        tanks.stretches.names
    )


def test_what_is_no_simulator_is_refused_in_one_line():
    tanks = recorded({}, seed=9)
    hole = tanks.stretches.measured.copy()
    hole[1, 3, 1] = np.nan
    spoilt = {
        "shape": {"stretches": replace(tanks.stretches, start=tanks.stretches.start[:, :1])},
        "'leek'": {"declared": ("leek",)},
        "a name twice": {"quantities": (*tanks.quantities, tanks.quantities[0])},
        "too few": {"stretches": tanks.stretches.of(np.arange(2))},
        "row 3, channel level_2 is not finite": {
            "stretches": replace(tanks.stretches, measured=hole)
        },
        "no finite numbers": {
            "predict": lambda v, s, w: np.full(
                (len(w), *tanks.stretches.measured.shape[1:]), np.nan
            )
        },
        "two answers": {
            "predict": lambda v, s, w: np.random.default_rng().normal(size=(len(w), 30, 2))
        },
    }
    for words, change in spoilt.items():
        bad = recorded({}, seed=9)
        for key, value in change.items():
            object.__setattr__(bad, key, value)
        with pytest.raises(BadInput, match=words):
            diagnose_simulator(bad)
    with pytest.raises(BadInput, match="leak"):
        diagnose_simulator(tanks, exclude=("leek",))


def test_what_shows_nothing_to_first_order_is_begun_at_a_size():
    """A filter's lag of 0 has no derivative: e^(-dt / lag) is flat there."""
    tanks = recorded({}, seed=11)
    lag = Quantity("lag", "s", 0.0, 60.0, prior=100.0)

    def predict(values, starts, which):
        h = TANKS["levels"](values[:, :-1], starts, tanks.volts[which])
        keep = np.exp(-TANKS["DT"] / np.maximum(values[:, -1], 1e-9))[:, None]
        seen = [h[:, 0]]
        for k in range(1, h.shape[1]):
            seen.append(keep * seen[-1] + (1.0 - keep) * h[:, k])
        return np.stack(seen, 1)

    own = Effect("lag", "sensors", (lag,), physics="levels are read late", excitation="steps")
    object.__setattr__(tanks, "quantities", (*tanks.quantities, lag))
    object.__setattr__(tanks, "candidates", (own, *tanks.candidates))
    object.__setattr__(tanks, "predict", predict)
    true, s = (
        np.tile([*(q.default for q in tanks.quantities[:-1]), 12.0], (tanks.stretches.count, 1)),
        tanks.stretches,
    )
    seen = predict(true, s.start, np.arange(s.count)) + 0.5 * np.random.default_rng(
        0
    ).standard_normal(s.measured.shape)
    object.__setattr__(tanks, "stretches", replace(s, measured=seen))
    report = diagnose_simulator(tanks)
    assert [e["name"] for e in report["effects"]] == ["lag"]
    assert report["effects"][0]["parameters"]["lag"]["value"] == pytest.approx(12.0, rel=0.1)


def test_what_was_not_fitted_is_not_said_to_be_worse_and_few_stretches_are_told():
    report = diagnose_simulator(recorded({}, seed=12, trials=1))
    assert any("Only 4 stretches" in note for note in report["notes"])
    assert all("was not fitted" in c["why"] or "held-out" in c["why"] for c in report["candidates"])


def test_the_protocol_is_what_is_asked_for():
    """Every member of the contract is there with the right sizes, and prediction of a part is a
    part of the prediction.
    """
    tanks = recorded({"leak": 0.002}, seed=10)
    assert all(hasattr(tanks, name) for name in (n for n in vars(Simulator) if n[0] != "_"))
    s, values = tanks.stretches, np.array([[q.default for q in tanks.quantities]])
    whole = tanks.predict(np.tile(values, (s.count, 1)), s.start, np.arange(s.count))
    some = np.array([5, 2])
    np.testing.assert_array_equal(
        tanks.predict(np.tile(values, (2, 1)), s.start[some], some), whole[some]
    )
    np.testing.assert_array_equal(s.of(some).measured, s.measured[some])


def test_a_file_of_its_own_that_fails_is_a_line_and_loses_nothing(tmp_path):
    tanks = recorded({"leak": 0.004}, seed=9)

    def fails(values):
        raise OSError("the disk is full")

    object.__setattr__(
        tanks, "mended", {"own.txt": lambda values: f"leak {values['leak']:.3f}", "bad.txt": fails}
    )
    report = diagnose_simulator(tanks, out=tmp_path)
    assert (tmp_path / "own.txt").read_text() == "leak 0.004" and (
        tmp_path / "report.json"
    ).exists()
    assert any(
        "bad.txt could not be written: OSError: the disk is full" in line
        for line in report["warnings"]
    )


def test_a_search_that_is_cut_off_leaves_what_it_had_found(tmp_path):
    def cut(done: float, total: float, note: str) -> None:
        if note.startswith("without"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        diagnose_simulator(recorded({"leak": 0.004}, seed=3), out=tmp_path, progress=cut)
    told = read_report(tmp_path / "report.json")
    assert told["unfinished"] and "leak" in told["message"] and not told["effects"]
    assert told["error"]["after"] < 0.7 * told["error"]["before"]


def logged(folder: Path) -> Path:
    """Six recordings of tanks that leak, as CSV."""
    made = recorded({"leak": 0.004}, seed=3)
    volts = made.volts.reshape(6, -1, 1)
    levels = made.stretches.measured.reshape(6, -1, 2)
    folder.mkdir()
    for name, rows in zip(made.stretches.names, np.concatenate([volts, levels], -1), strict=True):
        np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header="volts,level_1,level_2")
    return folder


def test_a_simulator_in_a_file_is_diagnosed_from_the_command_line(tmp_path, capsys):
    data, out = logged(tmp_path / "logs"), tmp_path / "out"
    asked = ["diagnose", str(data), "--out", str(out), "--simulator", f"{EXAMPLE}:of_folder"]
    assert main(asked) == 0
    assert "leak" in capsys.readouterr().out
    report = read_report(out / "report.json")
    assert [e["name"] for e in report["effects"]] == ["leak"]
    assert report["run"]["command"].endswith(f"--simulator {EXAMPLE}:of_folder")
    assert (out / "report.html").exists() and (out / "model.toml").exists()
    assert main([*asked, "--exclude", "leek"]) == 2
    assert "'leek' is no effect" in capsys.readouterr().err


def test_a_simulator_is_known_by_its_entry_point(tmp_path, monkeypatch, capsys):
    (tmp_path / "my_tanks.py").write_text(EXAMPLE.read_text())
    about = tmp_path / "my_tanks-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: my_tanks\nVersion: 1.0\n")
    point = "[adaptsim.simulators]\ntanks = my_tanks:of_folder\n"
    (about / "entry_points.txt").write_text(point)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(SIMULATORS.__dict__, "others", Registry("simulators", own={}).others)
    made = simulator_named("tanks")(logged(tmp_path / "logs"))
    assert made.stretches.count == 24
    asked = ["diagnose", str(tmp_path / "logs"), "--out", str(tmp_path / "out"), "--simulator"]
    assert main([*asked, "tank"]) == 2
    assert "did you mean 'tanks'" in capsys.readouterr().err
    assert main([*asked, "tanks", "--horizon", "1"]) == 2
    assert "--horizon: a simulator of your own reads DATA itself" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_effect_is_excluded_everywhere_or_at_a_place():
    def candidate(name, where):
        return Effect(name, where, (Quantity("q", "1", 0.0, 1.0),))

    every = tuple(candidate(f"coulomb at {joint}", joint) for joint in ("lift", "elbow"))
    assert check_exclude(("coulomb",), every, "machine") == ()
    assert check_exclude(("coulomb at lift",), every, "machine") == every[1:]
    with pytest.raises(BadInput, match=r"'spring' is no effect of a machine; it has coulomb"):
        check_exclude(("spring",), every, "machine")
