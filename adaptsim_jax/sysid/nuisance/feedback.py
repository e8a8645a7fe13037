"""Whether the commands of a recording answer to its motion: a feedback that holds the mechanism somewhere.

There a torque that wanders by chance is answered within milliseconds, and by a controller that knows speeds better than the
angles show them. So what is left of the angles follows the command and the speed a little though nothing is missing from the
model, the old trouble of identification in closed loop (Gustavsson, Ljung & Soderstrom 1977), and no p-value knows of it.
"""

import numpy as np

from adaptsim_jax.logs.segments import Windows
from adaptsim_jax.sysid.criteria import Criteria


def regulated(windows: Windows, criteria: Criteria) -> bool:
    """Whether a linear feedback of angles and speeds, one for all trials, makes most of every joint's command."""
    share = feedback_share(windows)
    return bool(len(share)) and bool(np.all(share > criteria.answered))


def feedback_share(windows: Windows) -> np.ndarray:
    """The share of each driven joint's command that the best linear feedback of angles and speeds makes, over all trials `[U']`."""
    time = np.asarray(windows.time)
    live = np.diff(time, axis=1, append=-np.inf) > 0  # trials end with copies of their last row
    q, v, torque = (np.asarray(z)[live] for z in (windows.motion_q, windows.motion_v, windows.torque))
    motion = np.concatenate([np.ones((len(q), 1)), q, v], 1)
    driven = torque[:, torque.std(0) > 0] if len(torque) else torque[:, :0]
    if len(motion) <= motion.shape[1] or not driven.shape[1]:
        return np.zeros(0)
    rest = driven - motion @ np.linalg.lstsq(motion, driven, rcond=None)[0]
    return 1.0 - rest.var(0) / driven.var(0)
