"""The declared double pendulum as `quality.hypotheses` needs it: torque by unit of p1, p3, h1, h2,
and what its lengths may be.
"""

import math

import numpy as np

from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.criteria import REST, UNIT
from adaptsim_jax.logs.log import Log, LogTrial
from adaptsim_jax.logs.log_meta import Rig
from adaptsim_jax.logs.quality.contradictions import (
    AS_DECLARED,
    Words,
    contradiction,
    late_finding,
    lateness,
)
from adaptsim_jax.logs.quality.findings import AuditFinding, finding
from adaptsim_jax.logs.quality.hypotheses import BlockMeans, Design, Hypothesis, Track, hypothesis
from adaptsim_jax.logs.quality.trials_differ import TrialDifferences, trials_differ

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


def design(l1: float, gravity: float, down: float) -> Design:
    """Base parameters of `mechanisms.double_pendulum.plant`.

    Args:
        down: 1 where zero angle hangs, -1 where it stands upright.
    """

    def columns(m: BlockMeans, with_gravity: bool) -> np.ndarray:
        (q1, q2), (v1, v2), (a1, a2) = m.q.T, m.v.T, m.a.T
        c, s, zero = np.cos(q2), np.sin(q2), np.zeros(len(q1))
        pull = down * gravity if with_gravity else 0.0
        outer = pull * np.sin(q1 + q2)
        first = l1 * (c * (2 * a1 + a2) - s * (2 * v1 * v2 + v2**2)) + outer
        second = l1 * (c * a1 + s * v1**2) + outer
        pairs = ((a1, zero), (a2, a1 + a2), (pull * np.sin(q1), zero), (first, second))
        return np.stack([np.stack(pair, 1) for pair in pairs], 2)

    return columns


def linear_design(gravity: float) -> Design:
    """Masses of the linearized double pendulum."""

    def columns(m: BlockMeans, with_gravity: bool) -> np.ndarray:
        (q1, q2), (a1, a2) = m.q.T, m.a.T
        pull = gravity if with_gravity else 0.0
        second = 2 * a1 + a2 - pull * (q1 + q2)
        pairs = ((a1 - pull * q1, 0.0 * q1), (2 * a1 + a2 - pull * q1 + second, second))
        return np.stack([np.stack(pair, 1) for pair in pairs], 2)

    return columns


def rig_design(rig: Rig) -> Design:
    """The design of a rig's declared model."""
    gravity = rig.geometry.get("g", GRAVITY)
    if rig.model == "linearized":
        return linear_design(gravity)
    return design(rig.geometry["l1"], gravity, _down(rig))


def tracks_of(log: Log) -> list[Track]:
    """Trials with torques at the joints."""
    return [Track(t.time, t.q, t.v, torques(log, t)) for t in log.trials]


def tracks_and_design(log: Log) -> tuple[list[Track], Design] | None:
    """Tracks and design of a log of two driven links; None where the linear fit cannot judge it."""
    rig = log.meta.rig
    if rig is None or rig.model != "rigid_body" or "l1" not in rig.geometry or rig.model_file:
        return None
    return tracks_of(log), rig_design(rig)


def torques(log: Log, trial: LogTrial) -> np.ndarray:
    """`[T, n]` N m at the joints, 0 at those without a motor."""
    out = np.zeros_like(trial.q)
    for k, name in enumerate(log.input_names):
        out[:, log.joint_names.index(name)] = trial.u[:, k]
    return out


def _down(rig: Rig) -> float:
    if rig.angle_zero == "hanging":
        return 1.0
    return -1.0


def _alternatives(rig: Rig) -> list[Hypothesis]:
    """What else of the rig itself may be otherwise than declared: lengths, gravity, the zero."""
    l1, g, down = rig.geometry["l1"], rig.geometry.get("g", GRAVITY), _down(rig)
    out = []
    for factor, unit in FACTORS.items():
        facts = {
            "l1": l1,
            "right": f"{factor * l1:g}",
            "unit": f" (was it given in {unit}?)" if unit else "",
        }
        out.append(hypothesis("length", design=design(factor * l1, g, down), **facts))
    if abs(g - GRAVITY) > UNIT.gravity_tolerance * GRAVITY:
        out.append(hypothesis("gravity", design=design(l1, GRAVITY, down), g=g, earth=GRAVITY))
    other = "upright" if down > 0 else "hanging"
    out.append(hypothesis("angle_zero", design=design(l1, g, -down), other=other))
    return out


def pendulum_trials(log: Log) -> TrialDifferences | None:
    """See `trials_differ.trials_differ`."""
    if (rig := tracks_and_design(log)) is None:
        return None
    return trials_differ([t.name for t in log.trials], *rig)


def check_conventions(log: Log) -> tuple[AuditFinding, ...]:
    """What the motion says of the declared columns. Raises BadInput where it contradicts them, with
    what to write instead.
    """
    findings = _rest_findings(log)
    if (rig := tracks_and_design(log)) is None:
        return findings
    assert log.meta.rig is not None  # see `of_rig`
    alternatives = _alternatives(log.meta.rig)
    if other := contradiction(*rig, WORDS, alternatives, chain=(-1, 0), zeros=(1,)):
        raise BadInput(f"{log.path}: {other.message}; {AS_DECLARED}")
    if (late := lateness(*rig)) is None:
        return findings
    step = float(np.median([t.dt for t in log.trials]))
    return findings + late_finding(log.path, late, step, WORDS.tau)


def _rest_findings(log: Log) -> tuple[AuditFinding, ...]:
    """At rest without torque the arm hangs or stands: each link near 0 or half a turn from it."""
    rig = log.meta.rig
    if rig is None or rig.model != "rigid_body" or rig.geometry.get("g", GRAVITY) == 0:
        return ()
    for trial in log.trials:
        q = trial.q[: min(REST.n_rows, len(trial.time))]
        torque = torques(log, trial)[: len(q)]
        is_still = np.all(np.ptp(q, axis=0) < REST.max_range) and np.all(
            np.abs(torque) < REST.max_torque
        )
        if not is_still or np.ptp(trial.q) < REST.min_range:
            continue
        tilt = max(abs(math.remainder(x, math.pi)) for x in (q[0, 0], q[0].sum()))
        if tilt > REST.max_tilt:
            facts = {"q1": q[0, 0], "q2": q[0, 1]}
            return (finding("angle_zero", trial.name, "meta.toml", tilt, **facts),)
    return ()
