"""Rotations as unit quaternions (w, x, y, z) `[..., 4]`, and as vectors `[..., 3]` rad."""

import numpy as np


def times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Hamilton's product, elementwise."""
    w, x, y, z = np.moveaxis(a, -1, 0)
    r, i, j, k = np.moveaxis(b, -1, 0)
    real = w * r - x * i - y * j - z * k
    about_x = w * i + x * r + y * k - z * j
    about_y = w * j - x * k + y * r + z * i
    about_z = w * k + x * j - y * i + z * r
    return np.stack([real, about_x, about_y, about_z], -1)


def inverse(q: np.ndarray) -> np.ndarray:
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def rotated(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors `v [..., 3]` rotated by `q`."""
    u = q[..., 1:]
    t = 2.0 * np.cross(u, v)
    return v + q[..., :1] * t + np.cross(u, t)


def from_rotvec(v: np.ndarray) -> np.ndarray:
    """The turn by `|v|` rad about `v [..., 3]`."""
    half = 0.5 * np.linalg.norm(v, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * v * np.sinc(half / np.pi)], -1)


def as_rotvec(q: np.ndarray) -> np.ndarray:
    """The vector `[..., 3]` rad of a turn, at most half a turn long."""
    q = np.where(q[..., :1] < 0, -q, q)
    size = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(size, q[..., :1])
    return q[..., 1:] * np.where(size > 1e-12, angle / np.maximum(size, 1e-12), 2.0)


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The vector `[..., 3]` rad of the turn from `a` to `b`, in the axes of `a`."""
    return as_rotvec(times(inverse(a), b))


def continuous(q: np.ndarray) -> np.ndarray:
    """`q [R, 4]` with signs that do not flip from row to row."""
    flips = np.cumprod(np.where(np.sum(q[1:] * q[:-1], -1) < 0, -1.0, 1.0))
    return np.concatenate([q[:1], q[1:] * flips[:, None]])
