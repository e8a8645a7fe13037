"""Means of E drawn evenly from Omega: what any adaptation has to beat."""

import numpy as np

from adaptsim_jax.baselines.arena import MethodRun, Visits


def random_search(run: MethodRun) -> Visits:
    """As many visits as AdaptSim makes, from the seeds' own draws."""
    shape = (len(run.targets), run.config.starts, run.config.iterations + 1, run.problem.space.dim)
    means = [np.random.default_rng(int(seed)).uniform(size=shape) for seed in run.seeds]
    return Visits(np.stack(means, 1), shape[1] * shape[2])
