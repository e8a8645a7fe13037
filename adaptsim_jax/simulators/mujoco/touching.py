"""Whether a recorded motion touches anything, as the model file has its shapes."""

import mujoco
import numpy as np

from adaptsim_jax.logs.log import Log
from adaptsim_jax.simulators.mujoco.build import SteppedModel
from adaptsim_jax.simulators.mujoco.criteria import REMARK


def touching(stepped_model: SteppedModel, log: Log) -> str:
    """Say which bodies touch, and in how many of the recorded poses; '' where hardly any
    do.
    """
    model = stepped_model.model
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT):
        return ""
    data = mujoco.MjData(model)
    q = np.concatenate([t.q for t in log.trials])
    if stepped_model.base < 0:
        base = None
    else:
        base = np.concatenate([t.base for t in log.trials if t.base is not None])
    rows = np.unique(np.linspace(0, len(q) - 1, min(REMARK.pose_rows, len(q))).astype(int))
    n_touching, pairs = 0, {}
    for row in rows:
        if not np.isfinite(q[row]).all():
            continue
        data.qpos[:] = stepped_model.pose
        data.qpos[stepped_model.angle] = q[row]
        if base is not None:
            data.qpos[stepped_model.base : stepped_model.base + 7] = base[row]
        mujoco.mj_fwdPosition(model, data)
        pairs_here = {
            tuple(sorted(model.geom_bodyid[[c.geom1, c.geom2]]))
            for c in data.contact[: data.ncon]
            if c.dist < 0 and c.geom1 >= 0
        }
        n_touching += bool(pairs_here)
        for pair in pairs_here:
            pairs[pair] = pairs.get(pair, 0) + 1
    if n_touching <= REMARK.touching_share * len(rows):
        return ""
    one, two = max(pairs, key=pairs.__getitem__)
    share = 100 * n_touching / len(rows)
    names = [model.body(int(b)).name or "world" for b in (one, two)]
    return f"contact: {names[0]} and {names[1]} touch in {share:.0f} % of the poses"
