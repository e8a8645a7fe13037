"""A torque constant that is off at one joint, told as that of the other in another scale."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.effects.layout import Layout
from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.mechanisms.double_pendulum.rigid import Geometry, base_forward_dynamics
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.fitted import Code, Fit
from adaptsim_jax.sysid.estimate.variance import VarianceComponents
from adaptsim_jax.sysid.rivals import torque_scale
from adaptsim_jax.sysid.rivals.torque_scale import other_scale, rescaled
from adaptsim_jax.sysid.select.trace import Trace

THETA = np.array([0.4, 0.15, 0.7, 0.4, 0.01, 0.02])
LAYOUT = Layout(catalogue(), ("joint1", "joint2"))
HERE, THERE = ("torque_gain", "joint2"), ("torque_gain", "joint1")


def value(eff, name, where, parameter):
    instance = LAYOUT.instances[LAYOUT.index(name, where)]
    return eff[instance.at][[p.name for p in instance.effect.parameters].index(parameter)]


@pytest.mark.parametrize("gain", [-0.4, 0.7])
def test_both_scales_move_alike(gain):
    eff = LAYOUT.off()
    eff[LAYOUT.instances[LAYOUT.index(*HERE)].at.start] = gain
    eff[LAYOUT.instances[LAYOUT.index("spring", "joint1")].at.start] = 0.3
    active = (HERE, ("spring", "joint1"), ("backlash", "joint1"))
    theta, other = other_scale(LAYOUT, THETA, eff, active, HERE, THERE)
    geometry, q, v, u = Geometry(0.35), np.array([0.3, -0.5]), np.array([1.0, -2.0]), np.array([0.5, -0.8])

    def acceleration(theta, eff):
        gains = np.array([value(eff, "torque_gain", j, "gain") for j in ("joint1", "joint2")])
        pull = np.array([-value(eff, "spring", "joint1", "stiffness") * q[0], 0.0])
        return np.asarray(base_forward_dynamics(theta, geometry, q, v, (1.0 + gains) * u + pull))

    np.testing.assert_allclose(acceleration(theta, other), acceleration(THETA, eff), rtol=1e-4)
    assert value(other, "torque_gain", "joint2", "gain") == 0.0
    assert value(other, "backlash", "joint1", "gap") == value(eff, "backlash", "joint1", "gap")


def fitted(active, gains, likelihood, code=Code.JUDGED):
    """A fit of effects, its likelihood given; `gains` of both joints among its effect parameters."""
    eff = LAYOUT.off()
    for at, gain in zip((THERE, HERE), gains, strict=True):
        eff[LAYOUT.instances[LAYOUT.index(*at)].at.start] = gain
    point = SimpleNamespace(x0=None, z=())
    candidate = SimpleNamespace(
        active=active, theta=THETA, eff=eff, names=(), phases=0, refit=SimpleNamespace(point=point, at_bound=())
    )
    parts = VarianceComponents(np.ones(2), np.zeros((2, 1)))
    return Fit(candidate, parts, np.full(4, likelihood), np.ones((2, 1)), code=code)


@pytest.mark.parametrize(
    ("active", "low", "other", "code", "told"),
    [
        ((HERE,), 0.0, 10.0, Code.JUDGED, True),  # as likely in the other scale: no data tell them apart
        ((HERE,), 0.0, -90.0, Code.JUDGED, False),  # far less likely there
        ((HERE,), 0.0, 10.0, Code.RAN_AWAY, False),
        ((HERE,), THETA, 10.0, Code.JUDGED, False),  # a declared parameter is known: it does not shrink with the rest
        ((HERE, THERE), 0.0, 10.0, Code.JUDGED, False),  # both are named already
        ((("spring", "joint1"),), 0.0, 10.0, Code.JUDGED, False),
    ],
)
def test_the_other_joints_gain_is_told_where_it_explains_as_much(monkeypatch, active, low, other, code, told):
    asked = []

    def judged(problem, start, response, *, rounds):
        assert rounds == 0
        asked.append(start)
        mine = start.active == active
        return fitted(start.active, (0.0, 0.5), 10.0 if mine else other, Code.JUDGED if mine else code)

    monkeypatch.setattr(torque_scale, "fit", judged)
    plant = SimpleNamespace(joints=("joint1", "joint2"), low=low * np.ones(6), high=THETA)
    problem = SimpleNamespace(plant=plant, model=SimpleNamespace(layout=LAYOUT), criteria=Criteria())
    found = Trace(fitted((), (0.0, 0.0), 0.0), SimpleNamespace(response=None), ()).then(
        "found", final=fitted(active, (0.0, 0.5), 10.0), classes={HERE: (("delay", "joint2"),)}
    )
    said = rescaled(problem, found)
    if told:
        assert said.classes[HERE] == (("delay", "joint2"), THERE)
        assert asked[1].active == (THERE,) and asked[1].eff[LAYOUT.instances[LAYOUT.index(*THERE)].at.start] < 0.0
        np.testing.assert_allclose(asked[1].theta, THETA / 1.5)
    else:
        assert said is found
