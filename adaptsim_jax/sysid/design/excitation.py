"""A library of commanded torques for a next experiment: what moves a rig in which way. Unit amplitude, `[T, 2]`."""

import numpy as np


def library(time: np.ndarray, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Torque shapes `[T, 2]` within [-1, 1] by name, on `time: [T]` s; all begin and end at zero."""
    span = float(time[-1] - time[0]) + 1e-9
    t = time - time[0]
    both = lambda a, b: np.stack([a, b], 1)
    sines = lambda low, high: _multisine(t, low, high, rng)
    shapes = {
        "a multi-sine of 0.3 to 2 Hz": both(sines(0.3, 2.0), sines(0.3, 2.0)),
        "slow triangles": both(_triangle(t, 3.0 / span), _triangle(t, 5.0 / span)),
        "bursts with reversals": both(_burst(t, span, 1.0), _burst(t, span, 1.7)),
        "steps and dwells": both(_steps(t, span, rng), _steps(t, span, rng)),
        "a multi-sine of 1 to 6 Hz": both(sines(1.0, 6.0), sines(1.0, 6.0)),
        "pulses and free swings": both(_pulse(t, 0.1, 0.5), _pulse(t, 0.25, 0.4)),
        "a multi-sine of 0.1 to 0.5 Hz": both(sines(0.1, 0.5), sines(0.1, 0.5)),
        "a creeping sweep with a ripple": both(_creep(t, span, 4.0), _creep(t, span, 5.0)),
        "a sweep from 0.2 to 5 Hz": both(_chirp(t, span, 0.0), _chirp(t, span, 1.5)),
        "small fast reversals on joint 1": both(0.3 * sines(2.0, 4.0), 0.0 * t),
        "joint 1 alone": both(sines(0.3, 2.0), 0.0 * t),
        "joint 2 alone": both(0.0 * t, sines(0.3, 2.0)),
    }
    fade = np.minimum(1.0, np.minimum(t, span - t) / min(0.2, 0.1 * span))[:, None]
    return {name: np.clip(shape, -1.0, 1.0) * np.maximum(fade, 0.0) for name, shape in shapes.items()}


def _multisine(t: np.ndarray, low: float, high: float, rng: np.random.Generator) -> np.ndarray:
    """Five sines of random phase, its largest value 1."""
    hertz = np.geomspace(low, high, 5)
    wave = np.sin(2 * np.pi * hertz * t[:, None] + rng.uniform(0, 2 * np.pi, 5)) @ (hertz / low) ** -0.25
    return wave / max(np.abs(wave).max(), 1e-12)


def _triangle(t: np.ndarray, hertz: float) -> np.ndarray:
    return 2.0 / np.pi * np.arcsin(np.sin(2 * np.pi * hertz * t))


def _burst(t: np.ndarray, span: float, hertz: float) -> np.ndarray:
    return np.sign(np.sin(2 * np.pi * hertz * t)) * np.abs(np.sin(np.pi * 3 * t / span))


def _steps(t: np.ndarray, span: float, rng: np.random.Generator, count: int = 8) -> np.ndarray:
    levels = rng.permutation(np.linspace(-1.0, 1.0, count))
    return levels[np.minimum((count * t / span).astype(int), count - 1)]


def _pulse(t: np.ndarray, first: float, length: float) -> np.ndarray:
    """A push either way in the first half, then nothing: the rig swings freely."""
    return ((t > first) & (t < first + length)) * 1.0 - ((t > first + length) & (t < first + 2 * length)) * 1.0


def _creep(t: np.ndarray, span: float, hertz: float) -> np.ndarray:
    return 0.85 * np.sin(2 * np.pi * t / span) + 0.15 * np.sin(2 * np.pi * hertz * t)


def _chirp(t: np.ndarray, span: float, phase: float) -> np.ndarray:
    return np.sin(2 * np.pi * (0.2 * t + 0.5 * 4.8 * t**2 / span) + phase)
