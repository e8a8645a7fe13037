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

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.trial_record import TrialKind


@dataclass(frozen=True)
class FrameCriteria:
    """What decides whether the frame of pushes is refused.

    Args:
        sure: rad (root mean square) by which the bottles must miss their pushes' angles: 0.001
            rad where all is right.
        better: Times by which they must miss less in another frame.
        slight: rad by which all may be turned without a word: plates are held as badly.
        turned: rad by which all are turned from which on that is refused.
        outlier: rad by which one bottle may go elsewhere than the others, for its push.
        way: m that a bottle must have gone for its direction to say anything.
        still: m: every push within the bounds moves the bottle farther.
    """

    sure: float = 0.1
    better: float = 3.0
    slight: float = 0.05
    turned: float = 0.35
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
TURN_MEND = "give tracks in the arm's base frame (x ahead, y to the left)"


@dataclass(frozen=True)
class FrameFault:
    """What looks otherwise: `name`, `statement`, `mend`; `slight`: no reason to refuse the
    tracks.
    """

    name: str
    statement: str
    mend: str
    slight: bool = False


OTHERS = (
    (
        FrameFault(
            "mirrored",
            "the bottles came out on the other side of the line than they were pushed to: the "
            "tracks look mirrored",
            "turn the sign of y (or of the angles: to the left is positive)",
        ),
        lambda a: -a,
    ),
    (
        FrameFault(
            "degrees",
            "the bottles went straight ahead whatever the angle: the robot looks to have taken "
            "the angles for degrees",
            "give the robot radians, and push again",
        ),
        np.radians,
    ),
    (
        FrameFault(
            "in_degrees",
            "the bottles went much wider than they were pushed: the angles look to be other than "
            "in radians",
            "write the angles in radians",
        ),
        np.degrees,
    ),
)


def frame_fault(angles: np.ndarray, way: np.ndarray) -> FrameFault | None:
    """What pushes at `angles [N]` rad say of the frame of bottles that went `way [N, 2]` m; None
    where all agrees.
    """
    distant = np.linalg.norm(way, axis=1) > FRAME.way
    angles, went = np.asarray(angles, float)[distant], np.arctan2(way[distant, 1], way[distant, 0])
    if not len(angles):
        return None
    missed = _rms(went - angles)
    turn = float(np.angle(np.mean(np.exp(1j * (went - angles)))))
    turned = _rms(went - angles - turn)
    if missed > FRAME.sure:
        for trials, frame in OTHERS:
            left = _rms(went - frame(angles))
            # pushes in about one direction do not tell a small turn apart from another frame
            if left * FRAME.better < missed and (
                left * FRAME.better < turned or abs(turn) > 0.5 * FRAME.turned
            ):
                return trials
    alike = turned < 0.5 * abs(turn)
    if alike and abs(turn) > FRAME.slight and (len(angles) > 1 or abs(turn) > FRAME.turned):
        what = (
            f"the bottles went {abs(np.degrees(turn)):.0f} degrees to the "
            f"{'left' if turn > 0 else 'right'} of their pushes"
        )
        slight = abs(turn) < FRAME.turned
        return FrameFault(
            "turned",
            f"{what}: {'is the frame turned a little' if slight else 'another frame'}?",
            TURN_MEND,
            slight,
        )
    if missed > 2.0 * FRAME.turned:
        return FrameFault(
            "frame", "the bottles did not go where they were pushed: another frame?", TURN_MEND
        )
    return None


def check_frame(angles: np.ndarray, way: np.ndarray, where: str) -> str | None:
    """A sentence where the frame looks a little turned, else None. BadInput, naming `where`, where
    it looks another.
    """
    trials = frame_fault(angles, way)
    if trials is None:
        return None
    if trials.slight:
        return f"{trials.statement}; {trials.mend}"
    raise BadInput(
        f"{where}: {trials.statement}; {trials.mend}; if all is as declared, add --as-declared"
    )


def check_each(names: Sequence[float], angles: np.ndarray, way: np.ndarray, where: str) -> None:
    """BadInput at the first push `[N]` whose bottle went elsewhere by far than the others did,
    beside the angles of their pushes.
    """
    went = np.arctan2(way[:, 1], way[:, 0])
    off = np.angle(np.exp(1j * (went - np.asarray(angles, float))))
    distant = np.linalg.norm(way, axis=1) > FRAME.way
    if np.sum(distant) < 3:
        return
    off = off - np.median(off[distant])
    alike = float(np.median(np.abs(off[distant]))) < FRAME.sure
    for k in np.flatnonzero(distant & alike & (np.abs(off) > FRAME.outlier))[:1]:
        raise BadInput(
            f"{where}: trial {names[k]:g}: the bottle went {abs(np.degrees(off[k])):.0f} degrees "
            f"to the {'left' if off[k] > 0 else 'right'} of its push, the others did not: the "
            "track of another push, or of another frame? mend it, or leave it out (--without "
            f"{names[k]:g}); if all is as declared, add --as-declared"
        )


def check_order(names: Sequence[float], angles: np.ndarray, way: np.ndarray, where: str) -> None:
    """BadInput where bottles went where other pushes of the file were made: two tracks exchanged,
    or all numbers off by one.
    """
    distant = np.linalg.norm(way, axis=1) > FRAME.way
    angles, went = np.asarray(angles, float), np.arctan2(way[:, 1], way[:, 0])
    if np.sum(distant) < 2:
        return
    mend = "give each track its own number; if all is as declared, add --as-declared"
    off = _wrapped(went - angles)
    usual = float(np.median(off[distant])) if np.sum(distant) > 4 else 0.0

    def miss(i, j):
        return abs(_wrapped(went[i] - angles[j] - usual))

    def left(order):
        return _rms((went - angles[order] - usual)[distant])

    own = np.arange(len(angles))
    for by in (-1, 1):
        if (
            len(angles) > 2
            and left(own) > FRAME.sure
            and FRAME.better * left(np.roll(own, by)) < left(own)
        ):
            which = "next" if by < 0 else "last"
            raise BadInput(
                f"{where}: the bottles went where the {which} push was made: are the numbers off "
                f"by one? {mend}"
            )
    for i, j in itertools.combinations(np.flatnonzero(distant).tolist(), 2):
        as_given, exchanged = min(miss(i, i), miss(j, j)), max(miss(i, j), miss(j, i))
        if as_given > FRAME.sure and FRAME.better * exchanged < as_given:
            raise BadInput(
                f"{where}: trials {names[i]:g} and {names[j]:g} went where the other was pushed: "
                f"exchanged? {mend}"
            )


def _wrapped(off):
    return np.angle(np.exp(1j * off))


def _rms(off: np.ndarray) -> float:
    """Of angles, whole turns apart."""
    return float(np.sqrt(np.mean(np.square(np.angle(np.exp(1j * off))))))
