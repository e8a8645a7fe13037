"""A recording of the double pendulum as the log of a mechanism."""

from adaptsim_jax.logs.log import Log, LogTrial
from adaptsim_jax.logs.log_meta import LogMeta
from adaptsim_jax.logs.types import Recording

JOINTS = ("joint1", "joint2")


def log_of(recording: Recording) -> Log:
    """The same trials; torques at the joints that have a motor."""
    still = {
        name
        for k, name in enumerate(JOINTS)
        if not any(t.torque[:, k].any() for t in recording.trials)
    }
    driven = tuple(name for name in JOINTS if name not in still)
    at = [JOINTS.index(name) for name in driven]
    trials = tuple(
        LogTrial(t.name, t.time, t.q, t.v, t.torque[:, at], path=t.path) for t in recording.trials
    )
    meta = LogMeta(path=f"{recording.path}/meta.toml", noise=recording.noise)
    return Log(str(recording.path), meta, JOINTS, trials, "torque", driven, driven, recording.notes)
