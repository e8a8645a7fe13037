"""Whether a recorded motion touches anything, as the model file has its shapes."""

import mujoco
import numpy as np

from adaptsim_jax.logs.log import Log
from adaptsim_jax.simulators.mujoco.build import Stepped
from adaptsim_jax.simulators.mujoco.criteria import REMARK


def touching(made: Stepped, log: Log) -> str:
    """In words which bodies touch, and in how many of the recorded poses; '' where hardly any
    do.
    """
    model = made.model
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT):
        return ""
    data = mujoco.MjData(model)
    q = np.concatenate([t.q for t in log.trials])
    if made.base < 0:
        base = None
    else:
        base = np.concatenate([t.base for t in log.trials if t.base is not None])
    rows = np.unique(np.linspace(0, len(q) - 1, min(REMARK.pose_rows, len(q))).astype(int))
    hits, pairs = 0, {}
    for row in rows:
        if not np.isfinite(q[row]).all():
            continue
        data.qpos[:] = made.pose
        data.qpos[made.angle] = q[row]
        if base is not None:
            data.qpos[made.base : made.base + 7] = base[row]
        mujoco.mj_fwdPosition(model, data)
        found = {
            tuple(sorted(model.geom_bodyid[[c.geom1, c.geom2]]))
            for c in data.contact[: data.ncon]
            if c.dist < 0 and c.geom1 >= 0
        }
        hits += bool(found)
        for pair in found:
            pairs[pair] = pairs.get(pair, 0) + 1
    if hits <= REMARK.touching_share * len(rows):
        return ""
    one, two = max(pairs, key=pairs.__getitem__)
    share = 100 * hits / len(rows)
    names = [model.body(int(b)).name or "world" for b in (one, two)]
    return f"contact: {names[0]} and {names[1]} touch in {share:.0f} % of the poses"
