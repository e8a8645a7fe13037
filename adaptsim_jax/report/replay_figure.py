"""A figure of measured against simulated angles, stretch after stretch."""

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np

if TYPE_CHECKING:
    from adaptsim_jax.attribution.replay import Replay

MOST_JOINTS, MOST_STRETCHES = 6, 16
WIDTH, HEIGHT = 9.0, 1.7  # inches, of a joint's panel


def save(found: "Replay", path: Path) -> None:
    """Of the first trial: a panel for each joint (the worst first where there are many), measured
    and simulated.
    """
    order = np.argsort(-np.median(found.error, 0))[:MOST_JOINTS]
    joints = sorted(order)
    lanes = np.flatnonzero(found.trial == found.trial[0])[:MOST_STRETCHES]
    figure, axes = plt.subplots(
        len(joints), 1, figsize=(WIDTH, HEIGHT * len(joints) + 0.8), sharex=True, squeeze=False
    )
    for axis, j in zip(axes[:, 0], joints, strict=True):
        for k, w in enumerate(lanes):
            seen = found.seen[w, :, j] > 0
            label = {"label": "measured"} if k == 0 else {}
            axis.plot(
                found.time[w, seen], found.measured[w, seen, j], color="0.55", lw=2.2, **label
            )
            label = {"label": "simulated"} if k == 0 else {}
            axis.plot(found.time[w], found.simulated[w, :, j], color="tab:red", lw=1.0, **label)
        unit = "rad" if found.kinds[j] == "hinge" else "m"
        axis.set_ylabel(f"{found.joint_names[j]} [{unit}]", fontsize=8)
        axis.set_title(
            f"median error {1e3 * np.median(found.error[:, j]):.3g} m{unit}",
            fontsize=8,
            loc="right",
            pad=2,
        )
        axis.grid(alpha=0.3)
    axes[-1, 0].set_xlabel(f"time in trial {found.trial_names[found.trial[0]]} [s]")
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(), loc="upper left", ncol=2, frameon=False, fontsize=8
    )
    figure.tight_layout(rect=(0, 0, 1, 0.97))
    figure.savefig(path, dpi=130)
    plt.close(figure)
