"""One trial of each task in MJX, small: that it compiles and moves. How well it agrees with other
engines is asked by the slow tests of each task.
"""

import numpy as np

from adaptsim_jax.tasks.pushing import engines as pushing
from adaptsim_jax.tasks.pushing import model as push
from adaptsim_jax.tasks.scooping import engines as scooping
from adaptsim_jax.tasks.scooping import model


def test_a_push():
    out = pushing.make_backend("mjx").simulate(*push.draw(seed=3, samples=1))
    assert not out.code.any() and np.isfinite(out.state).all()
    assert out.state[0, -1, 0] - out.state[0, 0, 0] > 0.02  # m, along the push


def test_a_scoop():
    params, actions = model.draw(7, 1)
    simulate = scooping.make_backend("mjx", dt=0.005, batch=1).simulate
    out = simulate(params, actions, np.zeros((1, 2)))
    assert not out.code.any() and np.isfinite(out.state).all()
    assert np.ptp(out.state[0, :, 3]) > 0.05  # m, the blade goes
