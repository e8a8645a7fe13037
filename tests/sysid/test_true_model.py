"""The truth of a generated data set, in the catalogue's words, is a model that leaves nothing but the sensors' noise."""

from adaptsim_jax.effects.registry import catalogue
from experiments.closeloop_truth import MEMBERS, true_error
from tests.generators import make_datasets, write_dataset
from tests.generators.dataset import Spec
from tests.generators.effects import EFFECTS


def test_every_hidden_effect_has_words_in_the_catalogue():
    moving = {"heave", "sway"}  # a base that the generators hold still; test_moving_base.py moves it
    assert set(MEMBERS) == set(EFFECTS) == {e.name for e in catalogue("pendulum")} - moving


def test_the_true_model_leaves_the_noise(tmp_path):
    spec = Spec(41, "low_noise", (("periodic_disturbance", 1, 5.0),))
    (data,) = make_datasets([spec])
    error = true_error(write_dataset(data, tmp_path / "data"), data.truth)
    assert error["rmse"] < 1.15 * data.truth["sensor"]["q"]
