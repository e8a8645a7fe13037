"""Frames, and inertial parameters moved between them: what reading and writing model files
needs.
"""

import numpy as np

Frame = tuple[
    np.ndarray, np.ndarray
]  # place [3] and rotation [3, 3] in the frame that it is given in


def compose(outer: Frame, inner: Frame) -> Frame:
    """Express `inner`, given in `outer`'s frame, in the frame that `outer` is given in."""
    return outer[0] + outer[1] @ inner[0], outer[1] @ inner[1]


def inverse(frame: Frame) -> Frame:
    return -frame[1].T @ frame[0], frame[1].T


def frame_along(axis: np.ndarray) -> np.ndarray:
    """A rotation [3, 3] whose third column is `axis` [3], a unit vector. Its entries are exactly 0
    and +-1 where the axis is one of the frame's, so that the dynamics can leave products out.
    """
    rounded = np.round(axis)
    axis = rounded if np.abs(axis - rounded).max() < 1e-12 else axis
    smallest = int(np.argmin(np.abs(axis)))
    first = np.eye(3)[smallest] - axis[smallest] * axis
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis], axis=1) + 0.0


def symmetric_of(six: np.ndarray) -> np.ndarray:
    """[3, 3] of Ixx, Ixy, Ixz, Iyy, Iyz, Izz."""
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def six_of(matrix: np.ndarray) -> np.ndarray:
    return matrix[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


def point_moments(place: np.ndarray) -> np.ndarray:
    """Moments [3, 3] about the origin of a unit mass at `place` [3]."""
    return place @ place * np.eye(3) - np.outer(place, place)


def inertial_about(
    mass: float, com: np.ndarray, axes: np.ndarray, moments: np.ndarray
) -> np.ndarray:
    """The 10 inertial parameters of a body with centre of mass `com` [3] and principal `moments`
    [3] about `axes` [3, 3].
    """
    central = axes @ np.diag(moments) @ axes.T
    about = central + mass * point_moments(com)
    return np.concatenate([[mass], mass * com, six_of(about)])


def central(inertial: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre of mass [3] and moments [3, 3] about it, of the 10 inertial parameters of a body
    that weighs something.
    """
    mass, com = float(inertial[0]), inertial[1:4] / inertial[0]
    return mass, com, symmetric_of(inertial[4:]) - mass * point_moments(com)


def in_frame(inertial: np.ndarray, frame: Frame) -> np.ndarray:
    """Inertial parameters given in `frame`, in the frame that `frame` is given in."""
    place, rotation = frame
    if inertial[0] == 0:
        turned = rotation @ symmetric_of(inertial[4:]) @ rotation.T
        return np.concatenate([np.zeros(4), six_of(turned)])
    mass, com, about = central(inertial)
    com = place + rotation @ com
    about = rotation @ about @ rotation.T + mass * point_moments(com)
    return np.concatenate([[mass], mass * com, six_of(about)])
