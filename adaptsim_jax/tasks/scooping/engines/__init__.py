"""Scooping in four engines behind one signature: ours in JAX (hydro), Drake, and a sphere cloud in
MJX and native MuJoCo.

`simulate(params [B, 4], commands [B, 3], initial [B, 2]) -> Trajectory`: commands are actions as
executed (pitch rad, rate rad/s, distance m), initial the place of the piece m. `state [B, T, 6]`
holds, in rows of 10 ms, the piece's x, y, z m and the tip's x, z m and pitch rad. Codes are
`scooping.MESSAGES`; states are finite whatever the code.
"""

from adaptsim_jax.tasks.engine import Engines
from adaptsim_jax.tasks.scooping.model import ScoopOptions, check_options

OURS = {
    "hydro": f"{__name__}.scene:HYDRO",
    "drake": f"{__name__}.drake:ENGINE",
    "mjx": f"{__name__}.mujoco:MJX",
    "native": f"{__name__}.mujoco:NATIVE",
}
BACKENDS = Engines("scooping", OURS, ScoopOptions(), lambda name, options: check_options(options))
make_backend = BACKENDS.make
