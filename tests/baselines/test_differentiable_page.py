"""The blocks of docs/howto/differentiable.md run, in order, as a reader would paste them; and the
gradient is the slope.
"""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.baselines.bounds import pendulum_problem
from adaptsim_jax.tasks.pendulum.task import SETTINGS, pendulum_space

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "differentiable.md"


@pytest.mark.slow
def test_the_pages_blocks_run(capsys):
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)
    assert len(blocks) >= 4
    names = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    assert "m2" in capsys.readouterr().out


def test_gradient_is_the_difference_quotient():
    problem = pendulum_problem(pendulum_space())
    target = np.array(problem.space.values(SETTINGS["ood-4"]))
    u, h = np.array([0.3, 0.6, 0.2, 0.9]), 1e-5
    with jax.enable_x64(True):
        slope = jax.jit(problem.slope)
        _, gradient = slope(jnp.asarray(u), target)
        ends = [
            [float(slope(jnp.asarray(u + s * h * e), target)[0]) for s in (1, -1)]
            for e in np.eye(4)
        ]
    quotient = [(a - b) / (2 * h) for a, b in ends]
    # Central differences of a cost of 1e7 with h = 1e-5: rounding leaves about 1e-4 of it.
    np.testing.assert_allclose(gradient, quotient, rtol=1e-4, atol=1.0)
