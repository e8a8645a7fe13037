"""Pairs begin with what alone leaves least error; a look-alike takes the place of a doubtful member."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.effects.base import Reach
from adaptsim_jax.effects.layout import Layout
from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.logs.types import Atom
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.fitted import Code, Fit
from adaptsim_jax.sysid.estimate.variance import Whitened
from adaptsim_jax.sysid.score.scorer import Scorer
from adaptsim_jax.sysid.score.table import Ranked
from adaptsim_jax.sysid.select import pairs
from adaptsim_jax.sysid.select.start import own_starts

ALIKE = {"drag": ("friction",), "friction": (), "ripple": (), "lag": ()}
PAIR = (1.0, 0)  # the sum of squares of any pair, and its size
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
    return SimpleNamespace(
        criteria=Criteria(),
        model=model,
        phases=lambda active: 0,
        windows=SimpleNamespace(start=None),
        theta0=np.ones(2),
    )


def fake_fits(monkeypatch, errors=None, doubted=()):
    """Refits that only say which effects they hold; `errors` are the sums of squares of single ones, with their sizes."""

    def made(active, theta=None, ok=True):
        candidate = SimpleNamespace(
            active=active, theta=theta, eff=None, refit=SimpleNamespace(point=SimpleNamespace(x0=None))
        )
        return Fit(candidate, None, np.zeros(1), None, code=Code.SETTLED if ok else Code.RAN_AWAY)

    def fit(problem, start, response, *, weighting="gls", rounds):
        if isinstance(start, Fit):
            return start
        ran_away = start.ended is not None and start.ended.code == pairs.DIVERGED
        return made(start.active, start.theta, not ran_away)

    monkeypatch.setattr(pairs, "started", lambda *_: None)
    monkeypatch.setattr(pairs, "merged", lambda *_: None)
    monkeypatch.setattr(pairs, "own_starts", lambda *_: [])
    monkeypatch.setattr(pairs, "doubtful", lambda *_: set(doubted))
    monkeypatch.setattr(pairs, "fit", fit)

    def plainly(problem, active, theta, *_):
        if len(active) > 1:
            error, size = PAIR
        else:
            error, size = errors[active[-1][0]] if active else errors.get("nothing", (None, 0))
        error, code = (error, 0) if error is not None else (0.0, pairs.DIVERGED)
        error = error / theta[0]  # from further away, less is left
        return SimpleNamespace(code=code, cost=np.array([error]), names=["p"] * size, theta=theta, eff=None, x0=None)

    monkeypatch.setattr(pairs, "by_least_squares", plainly)
    monkeypatch.setattr(pairs, "view", lambda problem, model: Seen())
    return made((), np.ones(2))


SEEN = SimpleNamespace(response=None, ranked=Seen().ranked)


def names_of(models):
    return [tuple(name for name, _ in m.active) for m in models]


def test_the_second_is_tried_beside_those_that_alone_leave_least(monkeypatch):
    monkeypatch.setattr(pairs, "FIRSTS", 1)
    base = fake_fits(monkeypatch, {"drag": (9.0, 3), "friction": (4.0, 3), "lag": (None, 3)})
    beside_friction = [("friction",), ("friction", "drag"), ("friction", "lag")]
    assert names_of(pairs.refit_beside_first(layout(), base, SEEN)) == beside_friction
    monkeypatch.setattr(pairs, "FIRSTS", 2)
    found = names_of(pairs.refit_beside_first(layout(), base, SEEN))
    assert found[:3] == beside_friction and {first for first, *_ in found[3:]} == {"drag"}


@pytest.mark.parametrize(("suggested", "starts"), [(1.1, 1.0), (3.0, 3.0), (0.2, 1.0)])
def test_a_pair_starts_from_what_the_motion_suggests_too_where_that_is_elsewhere(monkeypatch, suggested, starts):
    """A play had bent the declared parameters so far that no pair with it came back from there. The fit that leaves less is kept."""
    base = fake_fits(monkeypatch, {"drag": (9.0, 3), "friction": (4.0, 3), "lag": (None, 3)})
    problem = layout()
    problem.theta0 = np.array([suggested, 1.0])
    _, pair, *_ = pairs.refit_beside_first(problem, base, SEEN)
    assert pair.candidate.theta[0] == starts


@pytest.mark.parametrize(("suggested", "kept"), [(1.1, 1.0), (3.0, 3.0), (0.2, 1.0)])
def test_what_fits_best_alone_is_fitted_from_what_the_motion_suggests_too(monkeypatch, suggested, kept):
    """Beside a play that was half as wide as it should be, the spring that acted with it came nowhere near the front."""
    base = fake_fits(monkeypatch, {"drag": (9.0, 3)})
    problem = layout()
    problem.theta0 = np.array([suggested, 1.0])
    drag = next(r for r in Seen().ranked(plain=True) if r.instance[0] == "drag")
    alone = pairs._alone(problem, base, pairs._without(problem, base), drag)
    assert alone[1].theta[0] == 1.0
    _, fit = pairs._closer(problem, base, alone)
    assert fit.theta[0] == kept


def test_what_fits_best_alone_is_fitted_from_its_own_starts_and_carried_on(monkeypatch):
    """From the linear score's amplitude a stop that is hit hard ended at a twelfth of its stiffness."""
    base, problem = fake_fits(monkeypatch, {"drag": (9.0, 3)}), layout()
    ended = lambda code, cost, eff: SimpleNamespace(
        code=code, cost=np.array([cost]), names=["p"], theta=problem.theta0, eff=eff, x0="there"
    )
    calls = []

    def by_least_squares(problem, active, theta, eff, x0):
        calls.append(eff)
        return ended(pairs.UNFINISHED, 2.0, "on the way") if eff == "stiff" else ended(0, 1.0, "at the end")

    monkeypatch.setattr(pairs, "by_least_squares", by_least_squares)
    monkeypatch.setattr(pairs, "own_starts", lambda *_: ["stiff"])
    alone = ((("drag", "joint1"),), ended(0, 5.0, "soft"))
    assert pairs._closer(problem, base, alone)[1].eff == "at the end"
    assert calls == ["stiff", "on the way"]
    soft = ((("drag", "joint1"),), ended(0, 1.0, "soft"))
    assert pairs._closer(problem, base, soft)[1].eff == "soft"


def test_a_stop_has_stiff_starts_of_its_own_at_the_side_where_it_is():
    effects = Layout(catalogue("pendulum"), ("joint1", "joint2"))
    two = np.ones(2)
    reach = Reach(10.0 * two, 20.0 * two, two, -1.0 * two, 2.0 * two, 6.0, 0.005, two)
    problem = SimpleNamespace(
        criteria=Criteria(), model=SimpleNamespace(layout=effects), reach=reach, bounds=effects.bounds(reach)
    )
    at = effects.instances[effects.index("hard_stop", "joint2")].at
    eff = effects.off()
    eff[at.start + 2] = -1.0  # a lower one
    starts = own_starts(problem, ("hard_stop", "joint2"), eff)
    assert len(starts) == 2
    for start in starts:
        stiffness, angle, side, loss, damping, _ = start[at]
        assert (stiffness, side, loss, damping) == (300.0, -1.0, 0.0, 0.0) and -1.0 <= angle <= -0.9
        np.testing.assert_array_equal(np.delete(start, at), np.delete(eff, at))
    assert own_starts(problem, ("spring", "joint2"), eff) == []


def test_each_effect_is_fitted_alone_from_where_the_fit_without_it_ended(monkeypatch):
    base, problem = fake_fits(monkeypatch, {"nothing": (9.0, 2), "drag": (4.0, 3)}), layout()
    ended = SimpleNamespace(code=0, theta=np.array([0.5, 1.0]), eff=None, x0="there")
    made = pairs.by_least_squares
    monkeypatch.setattr(pairs, "by_least_squares", lambda *a: ended if not a[1] else made(*a))
    plain = pairs._without(problem, base)
    assert plain.x0 == "there"
    drag = next(r for r in Seen().ranked(plain=True) if r.instance[0] == "drag")
    assert pairs._alone(problem, base, plain, drag)[1].theta[0] == 0.5
    ended.code = pairs.DIVERGED  # then from the base itself
    assert pairs._without(problem, base).theta[0] == 1.0


def test_where_every_single_fit_runs_away_there_is_no_first(monkeypatch):
    base = fake_fits(monkeypatch, dict.fromkeys(ALIKE, (None, 1)))
    assert pairs.refit_beside_first(layout(), base, SEEN) == []


def test_a_look_alike_takes_the_place_of_a_doubtful_member_alone(monkeypatch):
    base = fake_fits(monkeypatch, doubted=[("drag", "joint1")])
    both = SimpleNamespace(**{**vars(base.candidate), "active": (("drag", "joint1"), ("ripple", "joint1"))})
    pair = replace(base, candidate=both)
    assert names_of(pairs.with_look_alikes(layout(), base, pair, [], SEEN)) == [("friction", "ripple")]
    done = SimpleNamespace(active=(("ripple", "joint1"), ("friction", "joint1")))
    assert pairs.with_look_alikes(layout(), base, pair, [done], SEEN) == []
