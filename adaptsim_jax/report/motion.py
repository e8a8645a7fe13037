"""The figure of a motion to record: angles, speeds and torques of each joint within its limits."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from adaptsim_jax.report.figures import GRID, MUTED

if TYPE_CHECKING:
    from adaptsim_jax.attribution.excitation import Excitation
    from adaptsim_jax.mechanisms.allowed import Allowed

CURVE = "#1767b0"
ROW = 1.1  # inches, of a joint
UNITS = {"hinge": ("rad", "rad/s", "N m"), "slide": ("m", "m/s", "N")}


def save_motion(may: Allowed, found: Excitation, path: Path) -> None:
    """A row a joint; limits, less what is kept from them, are dashed."""
    tree = may.mechanism.tree
    figure = Figure(figsize=(10.0, 1.0 + ROW * tree.n), layout="constrained")
    axes = figure.subplots(tree.n, 3, sharex=True, squeeze=False)
    columns = (
        ("angle", found.q, may.low, may.high),
        ("speed", found.v, -may.speed, may.speed),
        ("torque", found.torque, -may.torque, may.torque),
    )
    for k, (title, z, low, high) in enumerate(columns):
        for j, name in enumerate(tree.joint_names):
            axis = axes[j, k]
            axis.plot(found.time, z[:, j], color=CURVE, linewidth=1.0)
            for limit in (low[j], high[j]):
                if np.isfinite(limit):
                    axis.axhline(limit, color=MUTED, linewidth=0.8, linestyle="--")
            axis.set_ylabel(UNITS[tree.kinds[j]][k], fontsize=8)
            axis.tick_params(labelsize=7)
            axis.grid(color=GRID, linewidth=0.5)
            if k == 0:
                axis.set_title(name, loc="left", fontsize=9)
        axes[0, k].set_title(title, fontsize=9)
        axes[-1, k].set_xlabel("time, s", fontsize=8)
    figure.savefig(path, dpi=120)
