"""Signatures against finite differences of the simulation, one effect after the other."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.logs.segments import cut_windows
from adaptsim_jax.mechanisms.registry import make_plant
from adaptsim_jax.sysid.dictionary import make_reach
from adaptsim_jax.sysid.estimate.generic_forces import generic_forces, generic_names
from adaptsim_jax.sysid.estimate.linearize import signatures
from adaptsim_jax.sysid.estimate.output_error import least_squares
from adaptsim_jax.sysid.forward import make_model, simulate
from tests.sysid.small_rig import GEOMETRY, SIGMA, TRUE, make_trials

pytestmark = pytest.mark.slow  # one compile of the whole catalogue

# Relative gap to a finite difference. Signatures follow the smoothed measured motion and are first order, so what turns
# on or off within a row, or is measured at a size (delays, dead zones, limits), differs by its second order.
LOOSE = {
    "presliding": 0.06,
    "saturation": 0.08,
    "delay": 0.03,
    "actuator_lag": 0.03,
    "dead_zone": 0.03,
    "hard_stop": 0.05,
}
TIGHT = 0.02


@pytest.fixture(scope="module")
def case():
    trials = make_trials(seed=1, count=2, seconds=1.5, noise=0.02)
    windows = cut_windows(trials, SIGMA)
    model = make_model(make_plant("rigid_body", "hanging", GEOMETRY), catalogue())
    result = least_squares(model, model.layout.mask([]), windows, TRUE)
    reach = make_reach(model.plant, result.theta, windows)
    return model, windows, result, reach, signatures(model, result, windows, reach, basis=generic_forces)


def finite_difference(case, atom, amplitude):
    """Change of the weighted outputs per unit of one amplitude, by simulating twice."""
    model, windows, result, _, _ = case
    layout = model.layout
    instance = layout.instances[layout.index(atom.effect, atom.where)]
    names = [p.name for p in instance.effect.parameters]
    eff = layout.off()
    for name, value in atom.shape.items():
        eff[instance.at.start + names.index(name)] = value
    step = atom.shape[amplitude.name] if instance.effect.jump else 1e-5
    eff[instance.at.start + names.index(amplitude.name)] = step
    with jax.enable_x64(True):
        go = jax.jit(simulate)
        on, _ = go(model, result.theta, eff, layout.mask([(atom.effect, atom.where)]), windows, result.x0)
        off, _ = go(model, result.theta, eff, layout.mask([]), windows, result.x0)
    return (np.asarray(on - off) / step * windows.weight).reshape(len(windows.trial), -1)


@pytest.mark.parametrize("effect", catalogue(), ids=lambda e: e.name)
def test_signature_is_the_derivative(case, effect):
    atoms = [a for a in case[4].atoms if a.effect == effect.name]
    for where in {a.where for a in atoms}:
        here = [a for a in atoms if a.where == where]
        atom = here[len(here) // 2]
        for column, amplitude in zip(atom.columns, effect.amplitudes, strict=False):
            want = finite_difference(case, atom, amplitude)
            got = case[4].lin.atoms[:, :, column]
            gap = np.linalg.norm(got - want) / np.linalg.norm(want)
            assert gap < LOOSE.get(effect.name, TIGHT), (where, amplitude.name, gap)


def test_every_instance_has_atoms_and_columns_are_counted(case):
    model, _, _, _, seen = case
    named = {(a.effect, a.where) for a in seen.atoms if a.effect != "generic"}
    assert named == {(i.effect.name, i.where) for i in model.layout.instances}
    columns = [c for a in seen.atoms for c in a.columns]
    assert columns == list(range(seen.lin.atoms.shape[2]))
    assert sum(a.effect == "generic" for a in seen.atoms) == len(generic_names(2))
    assert np.isfinite(seen.lin.atoms).all()


def test_impulse_is_the_response_to_a_held_force(case):
    """A bias is the same force in every row, so its signature is the sum of all impulses."""
    seen = case[4]
    (atom,) = (a for a in seen.atoms if (a.effect, a.where) == ("bias", "joint2"))
    live = np.asarray(case[1].dt) > 0
    total = (seen.lin.impulse[:, :, 1] * live[:, None]).sum(-1)
    np.testing.assert_allclose(seen.lin.atoms[:, :, atom.columns[0]], total, rtol=1e-3, atol=1e-2 * np.abs(total).max())


def test_without_candidates_the_linearisation_is_the_same(case):
    model, windows, result, reach, seen = case
    alone = signatures(model, result, windows, reach, effects=())
    assert alone.atoms == () and alone.lin.atoms.shape[2] == 0
    np.testing.assert_array_equal(alone.lin.impulse, seen.lin.impulse)
    np.testing.assert_array_equal(alone.path.x, seen.path.x)


def test_rows_may_be_averaged_before_the_large_product(case):
    model, windows, result, reach, seen = case
    halved = lambda z: 0.5 * (z[:, 0:-1:2] + z[:, 1::2])

    def compress(lin):
        names = ("residual", "jac_state", "jac_theta", "atoms", "impulse")
        return replace(lin, **{k: halved(getattr(lin, k)) for k in names})

    early = signatures(model, result, windows, reach, basis=generic_forces, compress=compress).lin.atoms
    late = halved(seen.lin.atoms)
    scale = np.abs(late).max((0, 1)) + 1e-12
    assert np.abs((early - late) / scale).max() < 1e-5


def test_jacobian_of_the_fit_is_the_derivative(case):
    model, windows, result, _, _ = case
    with jax.enable_x64(True):
        go, off, mask = jax.jit(simulate), model.layout.off(), model.layout.mask([])
        for k, step in ((0, 1e-6), (3, 1e-6)):
            theta = result.theta + step * (np.arange(6) == k)
            up, _ = go(model, theta, off, mask, windows, result.x0)
            base, _ = go(model, result.theta, off, mask, windows, result.x0)
            want = (np.asarray(up - base) / step * windows.weight).reshape(len(windows.trial), -1)
            got = result.jac_shared[:, :, k]
            assert np.linalg.norm(got - want) < 1e-3 * np.linalg.norm(want)
