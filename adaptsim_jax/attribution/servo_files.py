"""Files that hold what the closed loop of a machine's servos shows: model.toml, model.xml, and how
these simulate.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from adaptsim_jax.attribution import model_toml
from adaptsim_jax.attribution.closed_loop import ServoDiagnosis, by_piece, measure_of
from adaptsim_jax.attribution.in_mjcf import changes_of
from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.recommended import WHOLE_TRIALS, FileReplay, joint_errors
from adaptsim_jax.effects.joints.actuator import ACTUATOR_LAG, DELAY
from adaptsim_jax.effects.joints.forces import ARMATURE, SPRING
from adaptsim_jax.effects.joints.friction import COULOMB, VISCOUS
from adaptsim_jax.effects.joints.sensor import ENCODER_OFFSET
from adaptsim_jax.mechanisms.spec import read_source
from adaptsim_jax.mend.mjcf import Changes, mended_mjcf
from adaptsim_jax.mend.model_toml import FILE as MODEL_FILE
from adaptsim_jax.mend.model_toml import AddedEffect, Form, Value
from adaptsim_jax.simulators.closed_loop.law import OPEN, Servo, inner_damping
from adaptsim_jax.simulators.closed_loop.recording import recording_of
from adaptsim_jax.simulators.closed_loop.whole import simulate, trial_errors


def files(d: ServoDiagnosis, run: Table) -> dict[str, Callable[[], str]]:
    """What makes the text of each file that holds the model."""
    form, mechanism = _form(d, run), d.machine.mechanism
    changes = _changes(d, form)
    return {
        MODEL_FILE: lambda: form.text("`adaptsim replay model.toml DATA` simulates all of it"),
        model_toml.DECLARED: lambda: mended_mjcf(mechanism, Changes()),
        "model.xml": lambda: mended_mjcf(mechanism, changes),
    }


def _loaded(d: ServoDiagnosis) -> np.ndarray | None:
    """Inertial parameters [n, 10] with the payload where the last body carries it."""
    (payload, reach), recording = (d.found.laws[0].payload, d.found.laws[0].reach), d.recording
    if recording.hand < 0 or not payload:
        return None
    model, tree = recording.model, d.machine.tree
    body = model.body(recording.hand).name
    frames = d.machine.mechanism.frames
    at = model.body_ipos[recording.hand] + reach * recording.outward
    centre = frames.place[body] + frames.rotation[body] @ at
    inertial = np.array(tree.inertial, float)
    carrier = tree.body_names.index(body) if body in tree.body_names else frames.carrier[body]
    inertial[carrier] += _point_mass(payload, centre)
    return inertial


def _point_mass(mass: float, at: np.ndarray) -> np.ndarray:
    """Inertial parameters [10] of a mass at a point."""
    x, y, z = at
    second = mass * np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])
    return np.concatenate([[mass], mass * np.asarray(at), second])


def _changes(d: ServoDiagnosis, form: Form) -> Changes:
    """What model.xml changes."""
    comments = [f"written by adaptsim from {Path(d.machine.mechanism.path).name}"]
    return replace(changes_of(d.machine, form), comments=comments, lost=())


def _form(d: ServoDiagnosis, run: Table) -> Form:
    """model.toml: servos by joint, the payload in the bodies, and what else is added."""
    servos, laws = d.recording.servos, d.found.laws
    own: Table = {}
    loaded = _loaded(d)
    if loaded is not None:
        own["inertial"] = {
            n: [float(z) for z in row]
            for n, row in zip(d.machine.tree.joint_names, loaded, strict=True)
        }
    table, effects = {}, []
    for s, law in zip(servos, laws, strict=True):
        inner = float(inner_damping(s, law.damping)) * law.inside
        numbers = {"kp": float(law.kp), "kv": inner}
        if law.limit < OPEN:
            numbers["limit"] = float(law.limit)
        if law.offset:
            numbers["offset"] = float(law.offset)
        table[s.name] = numbers
        passive = {"damping": law.damping - inner}
        effects += _added(s, VISCOUS.name, passive, {"damping": s.passive})
        effects += _added(s, COULOMB.name, {"level": law.rub}, {"level": s.law.rub})
        effects += _added(s, DELAY.name, {"delay": law.delay}, {"delay": s.law.delay})
        effects += _added(s, ACTUATOR_LAG.name, {"lag": law.lag}, {"lag": s.law.lag})
        inertia = {"inertia": s.armature + law.rotor}
        effects += _added(s, ARMATURE.name, inertia, {"inertia": s.armature})
        springs = [{"stiffness": z, "preload": z * s.rest} for z in (law.spring, s.law.spring)]
        effects += _added(s, SPRING.name, *springs)
        effects += _added(s, ENCODER_OFFSET.name, {"offset": law.zero}, {"offset": 0.0})
    own["servo"] = table
    if not laws[0].sharp:
        own["friction"] = model_toml.GIVES
    if laws[0].lift != servos[0].law.lift:
        own["lift"] = float(laws[0].lift)
    return Form("mechanism", model_toml.DECLARED, {}, tuple(effects), own, run)


def _added(s: Servo, name: str, numbers: dict[str, float], file: dict[str, float]):
    """The effect at a joint where it is not as the file has it."""
    if numbers == file:
        return []
    return [AddedEffect(name, s.name, {k: Value(float(z)) for k, z in numbers.items()})]


def verifier(d: ServoDiagnosis) -> Callable[[Path], Table]:
    """What runs model.xml over whole trials in closed loop, beside the declared file."""
    log = d.machine.log.pick([t.name for t in d.machine.tracks])

    def run(file: Path | None, span: float) -> FileReplay:
        recording = recording_of(d.source if file is None else read_source(file), log)
        assert recording is not None  # the same joints follow the same targets
        recording = recording.restepped(d.recording.whole_step / recording.whole_step)
        (motions,) = simulate(recording, [[s.law for s in recording.servos]])
        error = by_piece(recording, trial_errors(recording, motions))
        measure = measure_of(recording, error)
        nothing = np.minimum(measure.line, measure.still)[None]
        return FileReplay(measure.joints, measure.units, error, nothing)

    def verify(folder: Path) -> Table:
        return joint_errors(run, [folder / "model.xml"], {WHOLE_TRIALS: 0.0})

    return verify
