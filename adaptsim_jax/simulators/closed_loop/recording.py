"""A log of servos as it is simulated in closed loop."""

from dataclasses import replace

import mujoco
import numpy as np

from adaptsim_jax.logs.log import Log
from adaptsim_jax.mechanisms.spec import Source, without_shapes
from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.closed_loop.imposed import Recording
from adaptsim_jax.simulators.closed_loop.law import Servo, servos_of
from adaptsim_jax.simulators.closed_loop.pieces import (
    encoder_noise,
    pieces_of,
    trials_of,
)
from adaptsim_jax.simulators.mujoco.build import make_stepped_model, turns_of_balls

NO_LIFT = 1e-12  # share of gravity that is compensated nowhere, and can be changed


def recording_of(source: Source, log: Log) -> Recording | None:
    """The log where all of its joints follow targets; None of any other machine."""
    if log.input_kind != "command" or any(t.base is not None for t in log.trials):
        return None
    if turns_of_balls(source, log):
        return None
    stepped_model = make_stepped_model(source, log, _prepare_spec)
    model = stepped_model.model
    servos = _with_file_delays(source, servos_of(stepped_model, log))
    if not servos:
        return None
    trials = trials_of(log, servos)
    pieces = pieces_of(trials)
    if len(pieces) < 3:
        return None
    declared = log.meta.least_noise("q", log.joint_names)[[s.joint for s in servos]]
    noise = np.maximum(encoder_noise(trials), declared)
    step = float(model.opt.timestep)
    hand = _hand(model, servos)
    outward = _outward(model, hand)
    return Recording(model, stepped_model.pose, servos, trials, pieces, noise, hand, outward, step)


def _with_file_delays(source: Source, servos: tuple[Servo, ...]) -> tuple[Servo, ...]:
    """Put the delays of the file's actuators into the laws, which are simulated as those that are
    fitted.
    """
    delay = {
        source.model.actuator(k).name: float(z) for k, z in enumerate(source.model.actuator_delay)
    }
    return tuple(replace(s, law=s.law._replace(delay=delay.get(s.driver, 0.0))) for s in servos)


def _prepare_spec(spec: mujoco.MjSpec) -> None:
    """Fine steps without contact; what only looks goes, gravity's compensation can be changed."""
    without_shapes(spec)
    option = spec.option
    option.timestep = min(option.timestep, CLOSED_LOOP.step)
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for actuator in spec.actuators:
        actuator.delay, actuator.nsample = 0.0, 0
    for body in spec.bodies[1:]:
        body.gravcomp = max(body.gravcomp, NO_LIFT)


def _hand(model: mujoco.MjModel, servos: tuple[Servo, ...]) -> int:
    """The body that all joints carry: that of the last one of a single chain, else -1."""
    hinges = [s for s in servos if not s.slides]
    bodies = [int(model.dof_bodyid[s.dof]) for s in hinges or servos]
    last = max(bodies, key=lambda b: len(_chain(model, b)))
    if set(bodies) <= set(_chain(model, last)):
        return last
    return -1


def _outward(model: mujoco.MjModel, hand: int) -> np.ndarray:
    """[3] from a body's joint to its centre of mass, or along the joint's axis where both are near
    each other.
    """
    joint = int(model.body_jntadr[hand])
    direction = model.body_ipos[hand] - model.jnt_pos[joint]
    if np.linalg.norm(direction) < CLOSED_LOOP.near:
        direction = model.jnt_axis[joint]
    return direction / np.linalg.norm(direction)


def _chain(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and those that carry it."""
    out = []
    while body:
        out.append(body)
        body = int(model.body_parentid[body])
    return out
