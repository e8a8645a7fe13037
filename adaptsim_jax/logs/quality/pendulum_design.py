"""The declared double pendulum as `quality.hypotheses` needs it: torque by unit of p1, p3, h1, h2,
and what its lengths may be.
"""

from collections.abc import Sequence

import numpy as np

from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.quality.contradictions import (
    AS_DECLARED,
    Told,
    Words,
    contradiction,
    late_finding,
    lateness,
)
from adaptsim_jax.logs.quality.findings import Finding
from adaptsim_jax.logs.quality.hypotheses import Design, Hypothesis, Motion, Track
from adaptsim_jax.logs.quality.trial_words import Channels
from adaptsim_jax.logs.quality.trials_differ import Differ, trials_differ
from adaptsim_jax.logs.types import Recording

FACTORS = {1e-3: "millimetres", 1e-2: "centimetres", 1e-1: None, 10.0: None, 1e3: "kilometres"}
WORDS = Words(
    ("joint 1", "joint 2"),
    ("q1", "q2"),
    ("v1", "v2"),
    ("tau1", "tau2"),
    (True, True),
    "exchange q1 and q2, v1 and v2, tau1 and tau2 in the header of each file",
    lambda j: f"turn the signs of columns q{j + 1}, v{j + 1} and tau{j + 1}",
    lambda j, parent: "write q2 - q1 into column q2, and so v2 - v1 into v2",
)

CHANNELS = Channels(WORDS.q, WORDS.tau, WORDS.hinges)


def design(l1: float, gravity: float, down: float) -> Design:
    """Base parameters of `mechanisms.double_pendulum.plant`; `down`: 1 where zero angle hangs, -1
    where it stands upright.
    """

    def columns(m: Motion, with_gravity: bool) -> np.ndarray:
        (q1, q2), (v1, v2), (a1, a2) = m.q.T, m.v.T, m.a.T
        c, s, zero = np.cos(q2), np.sin(q2), np.zeros(len(q1))
        pull = down * gravity if with_gravity else 0.0
        outer = pull * np.sin(q1 + q2)
        pairs = (
            (a1, zero),
            (a2, a1 + a2),
            (pull * np.sin(q1), zero),
            (
                l1 * (c * (2 * a1 + a2) - s * (2 * v1 * v2 + v2**2)) + outer,
                l1 * (c * a1 + s * v1**2) + outer,
            ),
        )
        return np.stack([np.stack(pair, 1) for pair in pairs], 2)

    return columns


def of_recording(recording: Recording) -> tuple[list[Track], Design] | None:
    """Tracks and design of a recording of two driven links; None where the linear fit cannot judge
    it.
    """
    geometry = recording.geometry
    if recording.model != "rigid_body" or "l1" not in geometry or recording.model_file is not None:
        return None
    tracks = [Track(t.time, t.q, t.v, t.torque) for t in recording.trials]
    down = 1.0 if recording.angle_zero == "hanging" else -1.0
    return tracks, design(geometry["l1"], geometry.get("g", GRAVITY), down)


def _contradiction(recording: Recording, tracks: Sequence[Track], declared: Design) -> Told | None:
    """See `contradictions.contradiction`."""
    l1, g = recording.geometry["l1"], recording.geometry.get("g", GRAVITY)
    down = 1.0 if recording.angle_zero == "hanging" else -1.0
    more = []
    for factor, unit in FACTORS.items():
        right = f"{factor * l1:g}"
        says = f"l1 = {l1:g} m is no length of this motion, {right} m is" + (
            f" (was it given in {unit}?)" if unit else ""
        )
        more.append(
            Hypothesis(
                "length",
                says,
                f"write l1 = {right} under [geometry] in meta.toml, and l2 likewise",
                design=design(factor * l1, g, down),
            )
        )
    if abs(g - GRAVITY) > 0.3 * GRAVITY:
        says = f"g = {g:g} m/s^2 is not the gravity of this motion, {GRAVITY:g} is"
        mend = f"write g = {GRAVITY:g} under [geometry] in meta.toml"
        more.append(Hypothesis("gravity", says, mend, design=design(l1, GRAVITY, down)))
    other = "upright" if down > 0 else "hanging"
    mend = f'write angle_zero = "{other}" in meta.toml'
    more.append(
        Hypothesis(
            "angle_zero", f"angles look to be zero when {other}", mend, design=design(l1, g, -down)
        )
    )
    return contradiction(tracks, declared, WORDS, more, chain=(-1, 0), zeros=(1,))


def pendulum_trials(recording: Recording) -> Differ | None:
    """See `trials_differ.trials_differ`."""
    found = of_recording(recording)
    if found is None:
        return None
    return trials_differ([t.name for t in recording.trials], *found)


def check_conventions(recording: Recording) -> tuple[Finding, ...]:
    """What the motion says of the declared columns. Raises BadInput where it contradicts them, with
    what to write instead.
    """
    if (found := of_recording(recording)) is None:
        return ()
    if told := _contradiction(recording, *found):
        raise BadInput(f"{recording.path}: {told.message}; {AS_DECLARED}")
    late = lateness(*found)
    step = float(np.median([t.dt for t in recording.trials]))
    if late is None:
        return ()
    return late_finding(recording.path, late, step, ("tau1", "tau2"))
