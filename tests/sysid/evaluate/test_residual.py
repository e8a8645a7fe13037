"""Where what no candidate explains is said to sit: the joint, what it follows, and where else it may be."""

import numpy as np
import pytest

from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.logs.noise.floor import noise_floor
from adaptsim_jax.logs.quality.audit import audit, usable
from adaptsim_jax.logs.recording import read_recording
from adaptsim_jax.sysid.evaluate.residual import ResidualDiagnosis, residual_diagnosis
from adaptsim_jax.sysid.nuisance.prefilter import fit_unfiltered
from tests.sysid.small_rig import make_trials, written

EFFECTS = tuple(e for e in catalogue() if e.name == "quadratic_drag")
SHARE = {0: 0.3, 1: 0.4}


def left(folder, extra, shares=None) -> ResidualDiagnosis:
    """What the declared model leaves of a recording with `extra` hidden in it; shares: of the torques, instead of its own."""
    recording = read_recording(written(folder, make_trials(seed=21, count=4, noise=0.05, extra=extra)))
    checked = audit(recording)
    recording = usable(recording, checked)
    problem, base, first = fit_unfiltered(recording, checked, noise_floor(recording, checked), EFFECTS)
    force = base.parts.force_std() / problem.torque_scale
    return residual_diagnosis(problem, first, base.parts, force if shares is None else np.asarray(shares))


@pytest.mark.slow
@pytest.mark.parametrize("joint", [0, 1])
def test_a_scale_of_the_torque_is_told_at_both_joints(tmp_path, joint):
    """Masses are in units of the torque: the other joint's inverse scale makes the same motion."""
    what = left(tmp_path, lambda t, q, v, u: SHARE[joint] * u * (np.arange(2) == joint))
    assert what.p_value < 1e-6
    assert what.places[0][1] == "command"
    assert {place for place, *_ in what.told()[:2]} == {"joint1", "joint2"}
    assert "the torque's scale" in what.beside()


@pytest.mark.slow
def test_a_hidden_spring_is_placed_by_its_force_and_where_forces_are_alike_by_what_explains_more(tmp_path):
    spring = lambda t, q, v, u: np.array([0.0, -0.15 * np.sin(3.0 * q[1])])
    what = left(tmp_path, spring)
    assert what.places[0][0] == "joint2" and what.doubt is None and what.beside() == ""
    assert all(place == "joint2" for place, *_ in what.told())
    (tmp_path / "again").mkdir()
    alike = left(tmp_path / "again", spring, (0.11, 0.10))  # the larger is at the wrong joint
    assert alike.places[0][0] == "joint2"
    assert alike.doubt is not None and alike.doubt[0] == "joint1"
    assert [place for place, *_ in alike.told()[:2]] == ["joint2", "joint1"]


@pytest.mark.parametrize(
    ("variable", "words"),
    [
        ("speed", "joint 2 and follows its speed"),
        ("other", "joint 2 and follows the other joint's motion"),
        ("past", "joint 2 and follows what it did just before"),
    ],
)
def test_a_place_in_words(variable, words):
    assert ResidualDiagnosis(1e-9, 0.1, 50.0, (("joint2", variable, 0.1, 1e-9),)).where() == words


def test_what_is_told_is_first_and_sure():
    places = (("joint1", "angle", 0.1, 1e-9), ("joint1", "speed", 0.0, 0.4), ("joint2", "past", 0.02, 1e-3))
    plain = ResidualDiagnosis(1e-9, 0.1, 50.0, places)
    assert plain.told() == [places[0]]
    doubtful = ResidualDiagnosis(1e-9, 0.1, 50.0, places, doubt=("joint2", "where as much is unexplained"))
    assert doubtful.told() == [places[0], places[2]]
    assert doubtful.beside() == "; or at joint 2, where as much is unexplained"
