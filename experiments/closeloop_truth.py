"""The held-out error of the true model, refitted: what no diagnosis can be asked to beat.

The truth of a generated data set is written as a `model.toml` in the catalogue's own words and taken as the declared
model, so that it is fitted and judged by the same code from the same trials as the mended one.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from adaptsim_jax.core import config
from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.logs.noise.floor import noise_floor
from adaptsim_jax.logs.quality.audit import audit, usable
from adaptsim_jax.sysid import Recording, catalogue, read_recording
from adaptsim_jax.sysid.evaluate.crossval import cross_validate
from adaptsim_jax.sysid.nuisance.null_model import fit_declared

BRISTLE_DAMPING = 0.01  # s, of the generator's LuGre joint
STOP_DAMPING = 0.002  # s, of its stop
MEMBERS = {  # a generator's parameters in the catalogue's words
    "coulomb": lambda p: {"level": p["size"], "width": p.get("width", 0.0)},
    "stribeck": lambda p: {
        "level": p["size"], "excess": p["size"] * (p["ratio"] - 1.0), "speed": p["velocity"], "width": p.get("width", 0.0),
    },
    "quadratic_drag": lambda p: {"drag": p["size"]},
    "spring": lambda p: {"stiffness": p["size"], "preload": p["size"] * p["rest"]},
    "bias": lambda p: {"torque": p["size"] * p["sign"]},
    "tilt": lambda p: {"angle": p["size"] * p["sign"]},
    "encoder_offset": lambda p: {"offset": p["size"] * p["sign"]},
    "torque_gain": lambda p: {"gain": p["size"] * p["sign"]},
    "delay": lambda p: {"delay": p["size"]},
    "actuator_lag": lambda p: {"lag": p["size"]},
    "saturation": lambda p: {"cut": p["size"], "peak": p["peak"]},
    "dead_zone": lambda p: {"width": p["size"]},
    "presliding": lambda p: {
        "level": p["size"], "deflection": p["stiffness_angle"], "damping": BRISTLE_DAMPING * p["lugre"],
    },
    "backlash": lambda p: {"gap": p["size"]},
    "cogging": lambda p: {
        "sine": -p["size"] * np.cos(p["phase"]), "cosine": -p["size"] * np.sin(p["phase"]), "order": p["order"],
    },
    "rotor_inertia": lambda p: {"inertia": p["size"]},
    "friction_drift": lambda p: {"viscous": p["size"], "dry": 0.0, "decay": p["decay"]},
    "periodic_disturbance": lambda p: {
        "sine": p["size"] * np.cos(p["phase"]), "cosine": p["size"] * np.sin(p["phase"]), "frequency": p["frequency"],
    },
    "hard_stop": lambda p: {
        "stiffness": p["size"], "angle": p["angle"], "side": p["side"], "damping": STOP_DAMPING,
    },
    "load_friction": lambda p: {"share": p["size"]},
    "sensor_lag": lambda p: {"lag": p["size"]},
}  # fmt: skip


def true_model(recording: Recording, truth: dict) -> str:
    """The text of a `model.toml` that holds the truth of a generated data set."""
    units = {"p": "kg m^2", "h": "kg m", "m": "kg", "b": "N m s/rad"}
    table = {
        "schema": 1,
        "task": "pendulum",
        "model": recording.model,
        "angle_zero": recording.angle_zero,
        "geometry": {k: float(v) for k, v in recording.geometry.items()},
        "declared": {n: {"value": v, "unit": units[n[0]]} for n, v in truth["declared"].items()},
    }
    parts = [config.dumps(table)]
    for e in truth["effects"]:
        parts.append("[[effects]]\n" + config.dumps({"name": e["name"], "where": e["where"]}))
        for name, value in MEMBERS[e["name"]](e["parameters"]).items():
            parts.append(f"[effects.parameters.{name}]\n" + config.dumps({"value": float(value)}))
    clock = free_clock(truth, [t.name for t in recording.trials])
    return "\n".join([*parts, config.dumps({"trial_clock": clock}) if clock else ""])


def free_clock(truth: dict, trials: list[str]) -> dict[str, float]:
    """Shift of each trial's clock [s] where a periodic disturbance met it at a phase of its own."""
    for e in truth["effects"]:
        p = e["parameters"]
        if e["name"] == "periodic_disturbance" and p["free_phase"]:
            turns = np.asarray(truth["free_phase"]) / (2.0 * np.pi * p["frequency"])
            return dict(zip(trials, turns.tolist(), strict=True))
    return {}


def true_error(folder: Path, truth: dict, stretch: float = 0.5) -> dict:
    """Held-out RMSE [rad] over stretches of `stretch` s of the true model refitted on the data set in `folder`, and its unexplained
    force [N m] by joint. Errors over stretches of other lengths are no yardstick: of a play, which side a stretch begins on is
    read with the sensor's noise, and that counts for more in a short one."""
    recording = read_recording(folder)
    where = folder / "true_model.toml"
    write_bytes(where, true_model(recording, truth).encode())
    recording = replace(recording, model_file=str(where))
    checked = audit(recording)
    recording = usable(recording, checked)
    noise = noise_floor(recording, checked)
    problem, base, first = fit_declared(recording, checked, noise, catalogue(recording.task), duration=stretch)
    return {"rmse": cross_validate(problem, base, first).rmse(), "force": base.parts.force_std().tolist()}
