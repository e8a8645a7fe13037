"""Tracks of pushes from above, measured and simulated before and after, and the error of each push."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.attribution.trials import Problem, Selection
from adaptsim_jax.tasks.pushing.tracks import Tracks, errors, predicted

MOST = 24


def save(path: Path, tracks: Tracks, problem: Problem, found: Selection) -> None:
    """Write the figure."""
    import matplotlib

    matplotlib.use("Agg", force=False)
    import matplotlib.pyplot as plt

    count = min(MOST, len(tracks.trials))
    duration = min(max(tracks.duration, 0.9), 6.0)
    when = jnp.linspace(0.0, duration, 120)
    models = [("declared, fitted", found.null, "tab:orange"), ("with what is named", found.final, "tab:green")]
    models = models if found.named else models[:1]
    figure, axes = plt.subplots(1, 1 + len(models), figsize=(5.5 * (1 + len(models)), 4.6), layout="constrained")
    with jax.enable_x64(True):
        run = jax.vmap(lambda v, a: predicted(v, a, when, duration))
        for axis, (title, model, colour) in zip(axes, models, strict=False):
            path_of = np.asarray(run(jnp.asarray(model.folds[:count]), jnp.asarray(tracks.actions[:count])))
            for k in range(count):
                on = tracks.seen[k] > 0
                axis.plot(*tracks.place[k][on].T, ".", ms=2.5, color="0.35", label="measured" if k == 0 else None)
                axis.plot(*path_of[k].T, "-", lw=1.0, color=colour, label="simulated, left out" if k == 0 else None)
            axis.set(title=title, xlabel="x (m)", ylabel="y (m)", aspect="equal")
            axis.legend(loc="upper left", fontsize=8)
    place = np.arange(len(tracks.trials))
    for k, (title, model, colour) in enumerate(models):
        error = 1e3 * errors(tracks, problem, model.folds)
        axes[-1].bar(place + 0.4 * k, error, 0.4, color=colour, label=title)
    axes[-1].axhline(1e3 * tracks.noise * np.sqrt(2), color="0.4", ls=":", label="noise floor")
    axes[-1].set(xticks=place + 0.2, xlabel="push", ylabel="error of the left-out push (mm)", yscale="log")
    axes[-1].set_xticklabels(tracks.trials, fontsize=7)
    axes[-1].legend(fontsize=8)
    figure.savefig(path, dpi=120)
    plt.close(figure)
