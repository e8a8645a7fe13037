"""Invented reports and evidence for the tests of the page: measured on no rig and computed by no
fit.
"""

import copy
from functools import partial

import numpy as np

from adaptsim_jax.diagnosis.schema import new_report

DATA = {"trials": 8, "samples": 14_400, "held_out_trials": 4}
FLOOR = {"q1": 0.0018, "q2": 0.0024, "v1": 0.021, "v2": 0.034}


def interval(value, half, unit, **more):
    return {"value": value, "low": value - half, "high": value + half, "unit": unit, **more}


def declared(shift=0.0, loose=("m2",)):
    rows = {
        "m1": interval(0.608 + shift, 0.011, "kg", identifiable="m1" not in loose),
        "m2": interval(0.630, 0.4, "kg", identifiable="m2" not in loose),
        "I1": interval(0.0475 - shift / 5, 0.0009, "kg m^2", identifiable=True),
        "b1": interval(0.00081 + shift / 90, 0.00012, "Nm s/rad", identifiable=True),
        "b2": interval(0.000051, 0.00002, "N*m*s/rad", identifiable=True),
    }
    return rows


BEFORE = {"q1": 0.0141, "q2": 0.0212, "v1": 0.094, "v2": 0.151}


def errors(after_share, trials=4, floor=FLOOR, size=BEFORE):
    rng = np.random.default_rng(3)
    per_channel, per_trial = (
        {},
        [{"trial": f"trial_{8 + i:02d}", "per_channel": {}} for i in range(trials)],
    )
    for channel, value in size.items():
        after = None if after_share is None else max(value * after_share, 1.05 * floor[channel])
        unit = "rad" if channel[0] == "q" else "rad/s"
        per_channel[channel] = {
            "before": value,
            "after": after,
            "unit": unit,
            "noise_floor": floor[channel],
        }
        spread = 1 + 0.18 * rng.standard_normal(trials)
        for row, factor in zip(per_trial, spread, strict=True):
            pair = {
                "before": value * factor,
                "after": None if after is None else after * (1 + (factor - 1) / 2),
            }
            row["per_channel"][channel] = pair
        per_channel[channel]["intervals"] = {"before": [0.87 * value, 1.16 * value]}
        per_channel[channel]["intervals"]["after"] = (
            None if after is None else [0.93 * after, 1.1 * after]
        )
    for row in per_trial:
        for stage in ("before", "after"):
            row[stage] = row["per_channel"]["q1"][stage]
    overall = per_channel["q1"]
    keys = ("before", "after", "noise_floor", "intervals")
    return {
        "metric": "rmse of the joint angles",
        "unit": "rad",
        **{k: overall[k] for k in keys},
    } | {
        "per_channel": per_channel,
        "per_trial": per_trial,
    }


def candidate(name, where, gain, p, accepted, why, **more):
    return {
        "name": name,
        "where": where,
        "held_out_gain": gain,
        "p_value": p,
        "accepted": accepted,
        "why": why,
    } | more


REJECTED = [
    candidate(
        "quadratic_drag",
        "joint1",
        0.21,
        0.004,
        False,
        "gain vanishes once Coulomb friction is in the model",
    ),
    candidate(
        "command_delay",
        "joint1",
        0.034,
        0.11,
        False,
        "below the least gain of 5 % declared beforehand",
    ),
    candidate(
        "torque_gain", "joint1", 0.0, None, False, "declared masses absorb it", status="rejected"
    ),
    candidate(
        "encoder_offset", "joint2", 0.012, 0.74, False, "p-value above 0.05 after correction"
    ),
    candidate("cogging", "joint2", 0.00021, 0.91, False, "p-value above 0.05 after correction"),
    candidate("torsional_spring", "joint1", -0.008, 1.0, False, "makes held-out trials worse"),
    candidate(
        "stribeck",
        "joint1",
        0.613,
        0.0005,
        False,
        "no better than Coulomb friction, one parameter more",
    ),
    candidate(
        "rotor_inertia",
        "joint2",
        0.0,
        None,
        False,
        "declared inertias absorb it",
        status="rejected",
    ),
    candidate("dead_zone", "joint2", -0.02, 1.0, False, "wrong sign: fitted width is negative"),
]


def coulomb(alternatives=()):
    return {
        "name": "coulomb_friction",
        "where": "joint1",
        "parameters": {"torque": interval(0.0312, 0.0025, "N m")},
        "alternatives": list(alternatives),
        "physics": "A torque of constant size against the motion: −c·sign(v)",
    }


def explained():
    first = candidate(
        "coulomb_friction",
        "joint1",
        0.617,
        0.0002,
        True,
        "accepted: joint refit confirms it on 4 of 4 held-out trials",
    )
    return new_report(
        "pendulum",
        "rigid_body",
        "explained",
        "Coulomb friction of 31 mN·m at joint 1 removes 85 % of the held-out error of q1; no "
        "structure is left above the noise.",
        DATA,
        effects=[coulomb()],
        error=errors(0.14),
        candidates=[first, *REJECTED],
        declared={"before": declared(0.03), "after": declared()},
        next_experiment={
            "message": "Slow reversals at joint 1: they would show a Stribeck dip below 0.2 rad/s.",
            "csv": "next_experiment.csv",
        },
    )


def explained_class():
    tilt = interval(-0.0212, 0.0031, "rad")
    effect = {
        "name": "constant_bias",
        "where": "joint1",
        "parameters": {"torque": interval(0.118, 0.009, "Nm")},
    }
    effect["alternatives"] = ["base_tilt", "encoder_offset"]
    rows = [
        candidate("constant_bias", "joint1", 0.55, 0.0004, True, "best of a class of three"),
        candidate(
            "base_tilt",
            "joint1",
            0.546,
            0.0004,
            False,
            f"same prediction here within noise (tilt {tilt['value']} rad)",
            status="look-alike",
        ),
        candidate(
            "encoder_offset",
            "joint1",
            0.538,
            0.0006,
            False,
            "same prediction here within noise",
            status="look-alike",
        ),
        *REJECTED[:4],
    ]
    return new_report(
        "pendulum",
        "linearized",
        "explained_class",
        "A constant torque at joint 1 is missing. A bias, a tilted base and an encoder offset "
        "all give it near upright.",
        DATA,
        effects=[effect],
        error=errors(0.25),
        candidates=rows,
        declared={"before": declared(), "after": declared(0.004)},
        next_experiment={
            "message": "Hold joint 1 at −60°, 0° and 60° for 2 s each: tilt changes with the "
            "angle, bias does not.",
            "csv": "next_experiment.csv",
            "separates": ["constant_bias", "base_tilt"],
        },
    )


def partly_explained():
    """One effect holds out; more is left than the noise."""
    effect = {
        "name": "coulomb",
        "where": "all joints",
        "joints": ["hip", "knee"],
        "alternatives": [],
        "parameters": {
            "level[hip]": interval(0.31, 0.02, "N m"),
            "level[knee]": interval(0.85, 0.05, "N m"),
        },
        "held_out_gain": 0.5,
        "p_value": 0.004,
        "better": 8,
        "folds": 8,
    }
    return new_report(
        "mechanism",
        "robot.xml",
        "partly_explained",
        "Coulomb friction at all joints holds out in 8 of 8; what remains is 12 times the noise "
        "floor, most of it at the knee.",
        DATA,
        effects=[effect],
        error=errors(0.5),
        candidates=[candidate("coulomb", "all joints", 0.5, 0.004, True, "named")],
        declared={"before": declared(), "after": declared(0.004)},
        remaining={"error": 0.013, "times_floor": 12.0},
    )


def structured():
    return new_report(
        "pendulum",
        "rigid_body",
        "structured_unattributed",
        "After Coulomb friction at joint 1, 38 % of the rest at joint 2 repeats between trials "
        "and goes with position; no candidate explains it.",
        DATA,
        effects=[coulomb()],
        error=errors(0.55),
        candidates=[
            candidate(
                "coulomb_friction",
                "joint1",
                0.31,
                0.0011,
                True,
                "confirmed on 4 of 4 held-out trials",
            ),
            *REJECTED,
        ],
        declared={"before": declared(0.03), "after": declared(0.01)},
        next_experiment={
            "message": "Turn joint 2 slowly through its whole range, both ways.",
            "csv": "next_experiment.csv",
        },
        not_established=["What acts at joint 2 between −0.4 and 0.9 rad."],
    )


def within_noise():
    return new_report(
        "pendulum",
        "linearized",
        "within_noise",
        "The residual of the declared model is no more structured than trials shuffled at random "
        "(p = 0.44).",
        DATA,
        error=errors(None, size=FLOOR),
        declared={"before": declared(), "after": declared()},
        power=[
            {
                "name": "coulomb_friction",
                "where": "joint1",
                "size": 0.006,
                "unit": "N m",
                "power": 0.96,
            },
            {"name": "command_delay", "where": "joint1", "size": 0.004, "unit": "s", "power": 0.71},
        ],
        not_established=[
            "Coulomb friction at joint 1 below 4 mN·m: it would have been found in fewer than 8 "
            "of 10 recordings."
        ],
    )


def data_fault():
    return new_report(
        "pendulum",
        "rigid_body",
        "data_fault",
        "Recorded velocities are 57.3 times the slope of the recorded angles: they are in deg/s.",
        DATA,
    )


_MAKERS = {
    "explained": explained,
    "explained_class": explained_class,
    "partly_explained": partly_explained,
    "structured_unattributed": structured,
    "within_noise": within_noise,
    "data_fault": data_fault,
}


def _fresh(verdict):
    return copy.deepcopy(_MAKERS[verdict]())


REPORTS = {verdict: partial(_fresh, verdict) for verdict in _MAKERS}
"""Verdict -> a function that makes a report of its own to change."""


def held_out(mended, trials=4):
    rng = np.random.default_rng(5)
    time = np.arange(0, 6, 1 / 200)
    rows = []
    for index in range(trials):
        row = {
            "trial": f"trial_{8 + index:02d}",
            "time": time,
            "measured": {},
            "before": {},
            "after": {} if mended else None,
        }
        for k, channel in enumerate(FLOOR):
            truth = (1 + 0.4 * k) * np.sin(2.1 * time + k + index) * np.exp(-0.1 * time)
            wander = np.sin(1.1 * (time % 1.0) + index) * 9 * FLOOR[channel]
            row["measured"][channel] = truth + FLOOR[channel] * rng.standard_normal(len(time))
            row["before"][channel] = np.where(time % 1.0 < 0.006, np.nan, truth + wander)
            if mended:
                row["after"][channel] = np.where(time % 1.0 < 0.006, np.nan, truth + 0.1 * wander)
        rows.append(row)
    return rows


def evidence(verdict):
    """The evidence that goes with each verdict; the poorer ones lack most keys, as real ones
    would.
    """
    run = {
        "command": "adaptsim diagnose recordings/rig --out diagnosis --seed 0",
        "version": "0.2.0",
        "seed": 0,
        "seconds": 41.27,
    }
    if verdict == "data_fault":
        return {"run": run, "audit": AUDIT_FAULT}
    mended = verdict in (
        "explained",
        "explained_class",
        "partly_explained",
        "structured_unattributed",
    )
    found = {"run": run, "audit": AUDIT, "held_out": held_out(mended)}
    if verdict == "within_noise":
        found["held_out"] = [
            row | {"before": row["after"], "after": None} for row in held_out(True)
        ]
    return found


AUDIT = [
    {
        "severity": "warning",
        "where": "trial_03, tau2",
        "message": "saturates at 0.800 N·m for 2.1 % of the samples",
    },
    {
        "severity": "note",
        "where": "all trials",
        "message": "sampling 3.30 ms ± 0.02 ms; no dropouts",
    },
]
AUDIT_FAULT = [
    {
        "severity": "fault",
        "where": "all trials, v1 and v2",
        "message": '57.3 times the slope of the angles; say velocity = "deg/s" under [units] in '
        "meta.toml",
    },
    {"severity": "warning", "where": "trial_05, time", "message": "gap of 0.412 s at 3.10 s"},
    *AUDIT[1:],
]
