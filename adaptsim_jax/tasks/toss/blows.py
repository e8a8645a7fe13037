"""What impacts say of the frame of places and turns.

A body that strikes the plane at `r` from its centre of mass with the impulse `m dv` spins faster by
`I^-1 (r x m dv)`, whatever friction and stiffness are. Places of a mirrored or turned camera break
that, and so do turns from world to body: told before anything is fitted.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.quaternions import between, inverse, rotated, times
from adaptsim_jax.tasks.toss.body import TossedBody


@dataclass(frozen=True)
class BlowCriteria:
    """What decides whether blows show another frame.

    Args:
        step: m/s by which a speed must change from row to row for a blow: more than noise makes.
        alone: Of the body's size, by which the corner that strikes must be lower than the others.
        blows: Blows from which their median says something.
        better: Times by which another frame must explain the changes of spin better.
    """

    step: float = 0.3
    alone: float = 0.2
    blows: int = 5
    better: float = 1.7


BLOW = BlowCriteria()


TURN_MEND = "give places and turns in one frame: x, y, z right-handed with z upwards from the plane"
FRAMES = {
    "": np.array([[1.0, 0.0], [0.0, 1.0]]),
    "mirrored in x": np.array([[-1.0, 0.0], [0.0, 1.0]]),
    "mirrored in y": np.array([[1.0, 0.0], [0.0, -1.0]]),
    "turned by half a turn about z": np.array([[-1.0, 0.0], [0.0, -1.0]]),
    "turned by a quarter about z": np.array([[0.0, -1.0], [1.0, 0.0]]),
    "turned by a quarter about z the other way": np.array([[0.0, 1.0], [-1.0, 0.0]]),
    "with x and y exchanged": np.array([[0.0, 1.0], [1.0, 0.0]]),
    "with x and -y exchanged": np.array([[0.0, -1.0], [-1.0, 0.0]]),
}
"""Frames of the places, as seen from that of the turns."""


def check_blows(
    body: TossedBody, time: Sequence, place: Sequence, turn: Sequence, where: str
) -> None:
    """BadInput, naming `where`, where the blows of all tosses are explained in another frame, or
    with turns the other way round.
    """
    left: dict[tuple[str, bool], float] = {}
    for flipped in (False, True):
        each = [
            _blows(body, t, p, inverse(q) if flipped else q)
            for t, p, q in zip(time, place, turn, strict=True)
        ]
        dv, ds, r, axes = (np.concatenate([b[k] for b in each]) for k in range(4))
        for name, frame in FRAMES.items() if len(dv) >= BLOW.blows else ():
            observed = np.concatenate([dv[:, :2] @ frame.T, dv[:, 2:]], 1)
            left[name, flipped] = float(
                np.median(np.linalg.norm(ds - _spun(body, r, observed, axes), axis=1))
            )
    if ("", False) not in left:
        return
    (name, flipped), minimum = min(left.items(), key=lambda item: item[1])
    if minimum * BLOW.better > left["", False]:
        return
    if flipped:
        text = ["quaternions turn from the world to the body, not from the body to the world"]
    else:
        text = []
    text += [f"places look {name}, as against the quaternions"] if name else []
    if flipped and not name:
        mend = "turn the signs of qx, qy, qz"
    else:
        mend = TURN_MEND
    raise BadInput(
        f"{where}: by how bodies spin after they strike the plane, {' and '.join(text)}: {mend}; "
        "if all is as declared, add --as-declared"
    )


def _blows(
    body: TossedBody, time: np.ndarray, place: np.ndarray, turn: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Of each blow of a toss: changes of the centre's velocity and of the spin `[B, 3]` (world),
    the lowest corner from the centre `[B, 3]` m, and the turn `[B, 4]` then.
    """
    centre = place + rotated(turn, np.broadcast_to(body.model.body_ipos[body.at], place.shape))
    gaps = np.diff(time)[:, None]
    speed = np.diff(centre, axis=0) / gaps
    spin = rotated(turn[:-1], between(turn[:-1], turn[1:])) / gaps
    fall = -body.gravity * (time[3:] - time[:-3])[:, None] * np.array([0.0, 0.0, 2.0 / 3.0])
    dv, ds = speed[2:] - speed[:-2] - fall, spin[2:] - spin[:-2]
    size = np.linalg.norm(dv, axis=1)
    peak = size > BLOW.step
    peak[1:] &= size[1:] >= size[:-1]
    peak[:-1] &= size[:-1] > size[1:]
    at = np.flatnonzero(peak)
    corners = body.corners() - body.model.body_ipos[body.at]
    out = rotated(turn[:, None], corners[None])
    height = centre[:, None, 2] + out[..., 2]
    near = np.sort(height, axis=1)
    # the row at which the corner is lowest; alone, before and after it strikes
    row = np.where(near[at + 1, 0] < near[at + 2, 0], at + 1, at + 2)
    lead = near[:, 1] - near[:, 0]
    alone = np.minimum(lead[at + 1], lead[at + 2]) > BLOW.alone * body.size
    r = np.take_along_axis(out[row], np.argmin(height[row], 1)[:, None, None], 1)[:, 0]
    return dv[at][alone], ds[at][alone], r[alone], turn[row][alone]


def _spun(body: TossedBody, r: np.ndarray, dv: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Changes of spin `[B, 3]` by blows at `r` that change the centre's velocity by `dv`."""
    m = body.model
    axes = times(turn, np.broadcast_to(m.body_iquat[body.at], turn.shape))
    moment = rotated(inverse(axes), np.cross(r, m.body_mass[body.at] * dv))
    return rotated(axes, moment / m.body_inertia[body.at])
