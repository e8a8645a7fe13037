"""Pairs are made of the leaders of both scores, never of look-alikes at one joint; amplitudes are those of the two together."""

from types import SimpleNamespace

import numpy as np

from adaptsim_jax.closeloop.disturbance import Whitened
from adaptsim_jax.closeloop.pairs import leading_pairs
from adaptsim_jax.closeloop.score import Atom, Scorer
from adaptsim_jax.closeloop.view import Ranked

ALIKE = {"drag": ("friction",), "friction": (), "ripple": (), "lag": ()}
PLACES = [(name, "joint1") for name in ALIKE]


class Seen:
    """Two atoms of each effect; `drag` and `ripple` make the residual together, and each score leads with another one."""

    def __init__(self):
        rng = np.random.default_rng(5)
        columns = rng.normal(size=(8, 40, 8))
        columns[..., 4] += 0.9 * columns[..., 0]  # the ripple's first shape leans on the drag's
        residual = 2.0 * columns[..., 0] - 3.0 * columns[..., 5] + 0.1 * rng.normal(size=(8, 40))
        white = Whitened(residual, rng.normal(size=(8, 40, 1)), columns, np.arange(8), np.full(8, 40))
        self.scorer = Scorer(white, np.arange(8))
        self.instances = {p: [Atom(*p, {"k": j}, (2 * i + j,)) for j in (0, 1)] for i, p in enumerate(PLACES)}

    def ranked(self, exclude=(), *, plain=False):
        names = ("drag", "friction", "lag") if plain else ("ripple", "friction")
        made = [((n, "joint1"), self.instances[n, "joint1"][0]) for n in names if (n, "joint1") not in exclude]
        return [Ranked(p, a, self.scorer.score([a]), 2, plain) for p, a in made]


def layout():
    instances = [SimpleNamespace(effect=SimpleNamespace(look_alikes=ALIKE[n])) for n, _ in PLACES]
    model = SimpleNamespace(layout=SimpleNamespace(instances=instances, index=lambda *p: PLACES.index(p)))
    return SimpleNamespace(model=model)


def test_pairs_cross_the_two_scores_and_leave_out_look_alikes():
    names = {frozenset(r.instance[0] for r in pair) for pair in leading_pairs(layout(), Seen(), ())}
    assert names == {
        frozenset(p) for p in (("drag", "ripple"), ("friction", "ripple"), ("lag", "ripple"), ("friction", "lag"))
    }


def test_a_pair_has_the_shapes_and_amplitudes_of_both_together():
    pairs = {frozenset(r.instance[0] for r in pair): pair for pair in leading_pairs(layout(), Seen(), ())}
    found = {r.instance[0]: r for r in pairs[frozenset(("drag", "ripple"))]}
    assert found["drag"].atom.shape == {"k": 0} and found["ripple"].atom.shape == {"k": 1}
    np.testing.assert_allclose(found["drag"].score.amplitude, [2.0], atol=0.05)
    np.testing.assert_allclose(found["ripple"].score.amplitude, [-3.0], atol=0.05)
    assert found["drag"].tried == 2


def test_what_the_model_has_already_is_in_no_pair():
    pairs = leading_pairs(layout(), Seen(), (("ripple", "joint1"),))
    assert all(r.instance[0] != "ripple" for pair in pairs for r in pair)
