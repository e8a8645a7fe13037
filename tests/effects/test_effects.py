"""One walk over the catalogue: what every entry promises, in both precisions."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.base import (
    UNITS,
    Dry,
    Effect,
    Motion,
    Quantity,
    exponents,
    of_the_engine,
    unit_at,
)
from adaptsim_jax.effects.registry import catalogue, with_function

ACTING = tuple(e for e in catalogue("mechanism") if e.place in ("command", "force", "measurement"))
# shapes of effects that do nothing on the standard motion at their defaults
SHAPES = {"saturation": {"peak": 1.0}, "hard_stop": {"angle": -0.12, "side": -1.0}}
ROUGH = ("delay", "saturation", "dead_zone", "hard_stop", "backlash", "sensor_delay")


@pytest.fixture(params=[False, True], ids=["float32", "x64"])
def x64(request):
    with jax.enable_x64(request.param):
        yield request.param


def motion(torque=1.0, time=1.0, count=40):
    """A two-joint motion in units in which torques are `torque` and times `time` as large."""
    t = np.linspace(0.0, 2.0, count)
    q = np.stack([1.1 * np.sin(2 * t), 0.9 * np.cos(3 * t) - 0.2])
    v = np.stack([2.2 * np.cos(2 * t), -2.7 * np.sin(3 * t)]) / time
    u = torque * np.stack([np.sin(5 * t), 0.4 * np.cos(4 * t)])

    def gravity(q):
        return -torque * jnp.stack([2.0 * jnp.sin(q[0]), 0.7 * jnp.sin(q[0] + q[1])])

    q, v, u, t = (jnp.asarray(z) for z in (q, v, u, t[None] * time))
    return Motion(q, v, u, t, gravity, 0.5 * u, u)


def parameters(effect, amplitude=1.0, torque=1.0, time=1.0):
    """A mid-sized setting of an effect; `amplitude` 0 is none of it, 1 a third of the way to its
    upper bound.
    """
    shape = SHAPES.get(effect.name, {})
    out = {}
    for p in effect.parameters:
        value = (
            shape.get(p.name, p.default)
            if p.shape
            else p.default + amplitude * 0.3 * (min(p.high, 0.5) - p.default)
        )
        a, b = UNITS[p.unit]
        out[p.name] = jnp.asarray(np.reshape(value * torque**a * time**b, (1, 1)))
    return out


@partial(jax.jit, static_argnums=(0, 2, 3))  # one compile an effect: op by op would take minutes
def act(effect, p, torque=1.0, time=1.0):
    """What an effect does, as a tuple of arrays, on the standard motion."""
    m = motion(torque, time)
    if effect.inertia:
        return (effect.apply(p) * jnp.ones((2, 1)),)
    if effect.place == "force":
        answer = effect.apply(p, m)
        return (
            tuple(jnp.asarray(z) + 0.0 * m.q for z in answer)
            if isinstance(answer, Dry)
            else (answer + 0.0 * m.q,)
        )
    t, flat = m.t.T, {k: v.reshape(1, 1) for k, v in p.items()}
    if effect.place == "command":
        return (effect.apply(flat, t, m.u.T),)
    carried = (m.u.T,) if effect.carried else ()
    return effect.apply(flat, t, m.q.T, m.v.T, m.q.T[0], *carried)


def untouched(effect):
    m = motion()
    if effect.place == "command":
        return (m.u.T,)
    return (m.q.T, m.v.T) if effect.place == "measurement" else None


@pytest.mark.parametrize("effect", ACTING, ids=lambda e: e.name)
def test_entry_is_complete(effect):
    names = {e.name for e in catalogue("mechanism")}
    assert effect.physics and effect.excitation and effect.look_alikes
    assert set(effect.look_alikes) <= names and set(effect.contains) <= names - {effect.name}
    for p in effect.parameters:
        assert p.low <= p.default <= p.high and p.low < p.high
        assert p.sign <= 0 or p.low >= 0 or p.default == 0.0


def test_a_slow_joint_leaves_room_for_a_drag_of_the_same_torque():
    """A rig of 80 N m that turns at 0.5 rad/s has room for a drag of 98 N m s^2/rad^2, a spring as
    much as any.
    """
    of = {
        p.name: p
        for e in catalogue()
        if e.name in ("quadratic_drag", "spring")
        for p in e.parameters
    }
    assert of["drag"].bounds(80.0, 0.5) == (0.0, 640.0) and of["drag"].bounds(80.0, 5.0) == (
        0.0,
        160.0,
    )
    assert of["stiffness"].bounds(80.0, 0.5) == of["stiffness"].bounds(80.0)


@pytest.mark.parametrize("effect", ACTING, ids=lambda e: e.name)
def test_off_value_does_nothing(effect, x64):
    got = act(effect, parameters(effect, amplitude=0.0))
    tolerance = 1e-12 if x64 else 2e-4  # a running integral of the command loses digits in float32
    if untouched(effect) is None:
        rounding = (
            1e-14 if x64 else 1e-5
        )  # a fused multiply-add may leave the last digit of gravity minus itself
        assert all(np.abs(z).max() <= rounding for z in got)
    else:
        for a, b in zip(got, untouched(effect), strict=True):
            np.testing.assert_allclose(a, b, atol=tolerance)


@pytest.mark.parametrize("effect", ACTING, ids=lambda e: e.name)
def test_size_does_something_in_the_default_precision(effect, x64):
    on, off = act(effect, parameters(effect)), act(effect, parameters(effect, amplitude=0.0))
    assert all(z.dtype == (jnp.float64 if x64 else jnp.float32) for z in on)
    assert max(float(np.abs(a - b).max()) for a, b in zip(on, off, strict=True)) > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("effect", ACTING, ids=lambda e: e.name)
def test_gradients_are_finite_and_right_where_smooth(effect, x64):
    p = parameters(effect)

    @jax.jit
    def total(p):
        return sum(jnp.sum(jnp.square(z + 0.1)) for z in act(effect, p))

    slope_of = jax.jit(jax.grad(total))
    slope = slope_of(p)
    assert all(np.isfinite(z).all() for z in jax.tree.leaves(slope))
    zero = slope_of(parameters(effect, amplitude=0.0))
    assert all(np.isfinite(z).all() for z in jax.tree.leaves(zero))
    if effect.name not in ROUGH and x64:
        for name in p:
            h = 1e-6 * max(1.0, abs(float(p[name][0, 0])))
            up, down = total(p | {name: p[name] + h}), total(p | {name: p[name] - h})
            np.testing.assert_allclose(
                slope[name].sum(), (up - down) / (2 * h), rtol=1e-4, atol=1e-6
            )


@pytest.mark.parametrize("effect", ACTING, ids=lambda e: e.name)
@pytest.mark.parametrize(
    ("torque", "time"), [(1000.0, 1.0), (1.0, 0.01)], ids=["mN m", "other seconds"]
)
def test_units_scale_as_declared(effect, torque, time):
    """Write the same motion and parameters in other units of torque or time: the same thing must
    happen.
    """
    with jax.enable_x64(True):
        base = act(effect, parameters(effect))
        other = act(effect, parameters(effect, torque=torque, time=time), torque, time)
        names = {"command": ["N m"], "measurement": ["rad", "rad/s"]}.get(effect.place)
        if names is None:
            names = ["kg m^2"] if effect.inertia else ["N m", "N m", "rad/(N m)"]
        for a, b, unit in zip(base, other, names, strict=False):
            i, j = UNITS[unit]
            np.testing.assert_allclose(
                np.asarray(a) * torque**i * time**j, b, rtol=1e-5, atol=1e-6 * torque
            )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"place": "base"}, "place 'base'"),
        ({"scope": "body"}, "scope 'body'"),
        ({"parameters": ()}, "turns it off"),
    ],
)
def test_a_wrong_entry_is_refused(change, message):
    entry = {
        "name": "x",
        "place": "force",
        "parameters": (Quantity("a", "N m", 0.0, 1.0, 0.0),),
        "apply": abs,
    }
    with pytest.raises(BadInput, match=message):
        Effect(**(entry | {"physics": "p", "excitation": "e"} | change))


def test_delay_and_lag_keep_the_impulse():
    """A short pulse arrives late but whole."""
    with jax.enable_x64(True):
        t = jnp.arange(400)[:, None] * 5e-3
        u = jnp.zeros((400, 1)).at[20:24].set(2.0)
        for effect, p in (("delay", 0.0123), ("actuator_lag", 0.02)):
            (entry,) = (e for e in catalogue() if e.name == effect)
            late = entry.apply(
                {entry.parameters[0].name: jnp.array([[p]]), "before": jnp.array([[0.0]])}, t, u
            )
            np.testing.assert_allclose(late.sum() * 5e-3, u.sum() * 5e-3, rtol=1e-9)
            mean = (late * (t + 2.5e-3)).sum() / late.sum() - (u * (t + 2.5e-3)).sum() / u.sum()
            assert abs(float(mean) - p) < 2e-3 if effect == "delay" else abs(float(mean) - p) < 5e-3


def test_what_was_commanded_before_the_recording_fades():
    """A held command arrives at once where it was there before, late where it was not; later rows
    do not know.
    """
    with jax.enable_x64(True):
        t, u = jnp.arange(100)[:, None] * 5e-3, jnp.full((100, 1), 2.0)
        for effect, size in (("delay", 0.0123), ("actuator_lag", 0.01)):
            (entry,) = (e for e in catalogue() if e.name == effect)
            p = {entry.parameters[0].name: jnp.array([[size]])}
            held = entry.apply(p | {"before": jnp.array([[1.0]])}, t, u)
            fresh = entry.apply(p | {"before": jnp.array([[0.0]])}, t, u)
            np.testing.assert_allclose(held, u, rtol=1e-9)
            assert (
                abs(float((held - fresh)[:-1].sum() * 5e-3) - 2.0 * size) < 1e-9
            )  # the impulse that is missing
            np.testing.assert_allclose(fresh[60:], u[60:], rtol=1e-9)


def test_a_torque_by_any_power_of_the_speed_has_a_unit():
    cubic = Quantity("c", "N m s^3/rad^3", 0.0, 2.0, 0.0)
    assert exponents(cubic.unit) == (1, 3) and unit_at(cubic.unit, "slide") == "N s^3/m^3"
    assert cubic.bounds(10.0, 0.5) == (0.0, 2.0 * 10.0 * 8.0)
    assert exponents("N m s^3/rad^2") is None and exponents("lbf") is None


def test_an_effect_of_another_package_without_a_function_is_refused():
    brush = catalogue("mechanism")[0]
    assert with_function(brush) is brush
    with pytest.raises(BadInput, match="effect brush: it has no function; give apply"):
        with_function(replace(brush, name="brush", apply=of_the_engine))
