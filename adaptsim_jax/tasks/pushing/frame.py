"""Where bottles went against where they were pushed: a mirrored or turned camera and angles in
another unit, told before they count.

A bottle slides along its push's angle, whatever the frictions are, in every engine to 0.001 rad. A
plate that is not held square or a camera that is not level adds some degrees, which the task adapts
to and `diagnose` names.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import theilslopes

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.trial_record import TrialKind


@dataclass(frozen=True)
class FrameCriteria:
    """What decides whether the frame of pushes is refused.

    Args:
        sure: rad by which most bottles must miss their pushes' angles: 0.001
            rad where all is right.
        better: Times by which they must miss less in another order.
        turned: rad by which all are turned from which on that is refused.
        share: By how much of their pushes' angles bottles must turn at least, and one over that at
            most: -1 where mirrored, nearly 0 or 57 where one of both is in degrees.
        outlier: rad by which one bottle may go elsewhere than the others, for its push.
        way: m that a bottle must have gone for its direction to say anything.
        still: m: every push within the bounds moves the bottle farther.
    """

    sure: float = 0.1
    better: float = 3.0
    turned: float = 0.35
    share: float = 0.5
    outlier: float = 0.6
    way: float = 0.02
    still: float = 0.005


FRAME = FrameCriteria()


KIND = TrialKind(
    "push",
    "pushes",
    "the bottle",
    reach=3.0,
    fastest=3.0,
    slip=0.03,
    moves=2 * FRAME.still,
    ends=3.0,
    usual=0.7,
    still=0.15,
    aside=0.15,
    never="the hit never came, or the track ends before",
    optional=("yaw",),
    angles=("yaw",),
)


def check_frame(names: Sequence[float], angles: np.ndarray, way: np.ndarray, where: str) -> None:
    """BadInput, naming `where`, where bottles that went `way [N, 2]` m did not go along the `angles
    [N]` rad of their pushes: another order, another frame, or one of them elsewhere.
    """
    distant = np.linalg.norm(way, axis=1) > FRAME.way
    if not distant.any():
        return
    names = [name for name, counts in zip(names, distant, strict=True) if counts]
    angles, way = np.asarray(angles, float)[distant], way[distant]
    went = np.arctan2(way[:, 1], way[:, 0])
    off = _wrapped(went - angles)
    turn = float(np.median(off))
    left = _wrapped(off - turn)
    mend = "if all is as declared, add --as-declared"
    for by, which in ((-1, "next"), (1, "last")):
        other = _wrapped(went - np.roll(angles, by))
        other = _rms(_wrapped(other - np.median(other)))
        if len(angles) > 2 and _rms(left) > max(FRAME.sure, FRAME.better * other):
            raise BadInput(
                f"{where}: the bottles went where the {which} push was made: are the numbers off "
                f"by one? give each track its own number; {mend}"
            )
    share = 1.0
    if np.median(np.abs(left)) > FRAME.sure and np.ptp(angles) > 0.0:
        share += float(theilslopes(left, angles)[0])
    if abs(turn) > FRAME.turned or not FRAME.share < share < 1.0 / FRAME.share:
        raise BadInput(
            f"{where}: the bottles went {np.degrees(turn):.0f} degrees to the left of their "
            f"pushes, and turned by {share:.2g} of their angles: another frame? give tracks in the "
            "arm's base frame (x ahead, y to the left; mirrored? turn the sign of y) and "
            f"angles in radians; {mend}"
        )
    _check_each(names, went, angles + turn, where, mend)


def _check_each(names: Sequence[float], went, asked, where: str, mend: str) -> None:
    """Two tracks exchanged, or one of another frame: bottles that went `went [N]` where the others
    would have gone `asked [N]` rad.
    """

    def miss(i, j):
        return abs(_wrapped(went[i] - asked[j]))

    for i, j in itertools.combinations(range(len(went)), 2):
        as_given, exchanged = min(miss(i, i), miss(j, j)), max(miss(i, j), miss(j, i))
        if as_given > FRAME.sure and FRAME.better * exchanged < as_given:
            raise BadInput(
                f"{where}: trials {names[i]:g} and {names[j]:g} went where the other was pushed: "
                f"exchanged? give each track its own number; {mend}"
            )
    off = np.abs(_wrapped(went - asked))
    for k in np.flatnonzero((off > FRAME.outlier) & (np.median(off) < FRAME.sure))[:1]:
        raise BadInput(
            f"{where}: trial {names[k]:g}: the bottle went {np.degrees(off[k]):.0f} degrees beside "
            "its push, the others did not: the track of another push, or of another frame? mend "
            f"it, or leave it out (--without {names[k]:g}); {mend}"
        )


def _wrapped(off):
    return np.angle(np.exp(1j * off))


def _rms(off: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(off))))
