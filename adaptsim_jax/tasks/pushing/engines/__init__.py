"""The bottle push in four engines behind one signature: native MuJoCo, MJX, Drake, and the planar
model.

`simulate(params [B, 4], commands [B, 2], initial [B, 2]) -> Trajectory`: commands are actions
(speed m/s, angle rad), initial the bottle's place m, and `state [B, T, 13]` the bottle's pose and
velocity in rows (`scene.STATE`). Codes are `pushing.MESSAGES`; states are finite whatever the code.
"""

from adaptsim_jax.tasks.engine import Engines
from adaptsim_jax.tasks.pushing.model import PAPER, check_options

OURS = {
    "native": f"{__name__}.mujoco:NATIVE",
    "mjx": f"{__name__}.mujoco:MJX",
    "planar": f"{__name__}.scene:PLANAR",
    "drake": f"{__name__}.drake:ENGINE",
}
BACKENDS = Engines("pushing", OURS, PAPER, lambda name, options: check_options(options))
make_backend = BACKENDS.make
