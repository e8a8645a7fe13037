"""The same rigs in MuJoCo's C engine, with MuJoCo's own joint and motor features instead of our
formulas.

Used as a second, independent world. Effects by feature: coulomb `frictionloss`; stribeck and
presliding the `dcmotor`'s LuGre friction; cogging the `dcmotor`'s; quadratic drag `damping`
polynomial; spring `stiffness`; rotor inertia `armature`; tilt a turned gravity; torque gain `gear`;
saturation `ctrlrange`; delay the actuator's history buffer; actuator lag `filterexact`; hard stop a
joint limit; bias `qfrc_applied`; encoder offset `ref`.
"""

import mujoco
import numpy as np

from tests.generators.excitation import mass_at_rest
from tests.generators.simulate import Drive, Run
from tests.generators.worlds import G, Rig

SUPPORTED = (
    "coulomb",
    "stribeck",
    "presliding",
    "cogging",
    "quadratic_drag",
    "spring",
    "rotor_inertia",
    "tilt",
    "torque_gain",
    "saturation",
    "delay",
    "actuator_lag",
    "hard_stop",
    "bias",
    "encoder_offset",
)
SMOOTH = {"spring", "tilt", "torque_gain", "saturation", "rotor_inertia", "bias", "encoder_offset"}
# A motor driven by torque: constant K over resistance R is 1, and the damping K^2/R of its back-EMF
# is nil.
TINY = 1e-9


def build(rig: Rig, hidden: list[dict], step: float) -> mujoco.MjModel:
    """A model of the rig, joint axis y, link along -z at q = 0 (or +z if zero is upright)."""
    if rig.world != "rigid_body":
        raise ValueError("the MuJoCo engine has no linearised world")
    at = {(e["name"], max(e["joint"] - 1, 0)): e["params"] for e in hidden}
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = step
    smooth = all(name in SMOOTH for name, _ in at)
    spec.option.integrator = (
        mujoco.mjtIntegrator.mjINT_RK4 if smooth else mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    )
    tilt = at.get(("tilt", 0), {"size": 0.0, "sign": 1.0})
    angle = tilt["size"] * tilt["sign"]
    spec.option.gravity = [-G * np.sin(angle) * rig.sign, 0, -G * np.cos(angle) * rig.sign]
    body = spec.worldbody
    mass = mass_at_rest(rig)
    least = np.linalg.det(mass) / np.diag(mass)[::-1]
    for j in range(2):
        body = body.add_body(pos=[0, 0, -rig.l[0] if j else 0.0])
        body.mass, body.ipos = rig.m[j], [0, 0, -rig.c[j]]
        body.inertia = np.full(3, rig.inertia[j])
        body.explicitinertial = True
        joint = body.add_joint(name=f"j{j + 1}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, -1, 0])
        _joint_features(joint, rig.b[j], j, at, least[j])
        _motor(spec.add_actuator(), j, at, step)
    return spec.compile()


def _joint_features(joint, viscous: float, j: int, at: dict, least_inertia: float) -> None:
    drag = at.get(("quadratic_drag", j), {"size": 0.0})["size"]
    joint.damping = [viscous, drag, 0.0]
    if p := at.get(("coulomb", j)):
        joint.frictionloss = p["size"]
        joint.solref_friction = [1e-3, 1.0]
        joint.solimp_friction = [0.99, 0.999, 1e-3, 0.5, 2]
    if p := at.get(("spring", j)):
        joint.stiffness, joint.springref = [p["size"], 0, 0], p["rest"]
    if p := at.get(("rotor_inertia", j)):
        joint.armature = p["size"]
    if p := at.get(("hard_stop", j)):
        edge = p["angle"]
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.range = [-50.0, edge] if p["side"] > 0 else [edge, 50.0]
        # Limits are rated by acceleration: the stop is of about, not exactly, the stiffness asked
        # for.
        rate = p["size"] / least_inertia
        joint.solref_limit = [-rate, -0.002 * rate]


def _motor(motor, j: int, at: dict, step: float) -> None:
    motor.trntype, motor.target = mujoco.mjtTrn.mjTRN_JOINT, f"j{j + 1}"
    gain = at.get(("torque_gain", j), {"size": 0.0, "sign": 1.0})
    motor.gear = [1 + gain["size"] * gain["sign"], 0, 0, 0, 0, 0]
    if p := at.get(("actuator_lag", j)):
        motor.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        motor.dynprm = [p["size"], *np.zeros(9)]
    if p := at.get(("delay", j)):
        motor.delay, motor.nsample = p["size"], int(p["size"] / step) + 3
    if p := at.get(("saturation", j)):
        limit = p["peak"] * (1 - p["size"])
        motor.ctrllimited, motor.ctrlrange = mujoco.mjtLimited.mjLIMITED_TRUE, [-limit, limit]
    cogging = at.get(("cogging", j))
    bristle = at.get(("presliding", j)) or at.get(("stribeck", j))
    if cogging or bristle:
        motor.set_to_dcmotor([TINY, TINY], TINY, **_dcmotor(cogging, bristle))


def _dcmotor(cogging: dict | None, bristle: dict | None) -> dict:
    """Cogging (amplitude, order, phase) and LuGre (stiffness, damping, Coulomb, static, Stribeck
    speed).
    """
    out = {}
    if cogging:
        out["cogging"] = [cogging["size"], cogging["order"], cogging["phase"] + np.pi]
    if bristle:
        force, angle = bristle["size"], bristle.get("stiffness_angle", 1e-3)
        damping = 0.01 * bristle.get("lugre", 1.0) * force / angle
        static, speed = force * bristle.get("ratio", 1.0), bristle.get("velocity", 1.0)
        out["lugre"] = [force / angle, damping, force, static, speed]
    return out


def run_trial(
    model: mujoco.MjModel, rig: Rig, hidden: list[dict], drive: Drive, lane: int, step: float
):
    """One trial: (states `[K, 4]`, clean readings, measured readings, commands `[K, 2]`)."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = drive.start[:2, lane], drive.start[2:, lane]
    offset, bias = np.zeros(2), np.zeros(2)
    for e in hidden:
        value = e["params"]["size"] * e["params"].get("sign", 1.0)
        if e["name"] == "encoder_offset":
            offset[e["joint"] - 1] = value
        if e["name"] == "bias":
            bias[e["joint"] - 1] = value
    times, quantum = drive.times[:, lane], drive.quantum[:, lane]
    rows = len(times)
    state, clean, measured = (np.zeros((rows, 4)) for _ in range(3))
    command = np.zeros((rows, 2))
    for k in range(rows):
        state[k] = np.concatenate([data.qpos, data.qvel])
        clean[k] = state[k] + [*offset, 0, 0]
        x = clean[k] + drive.noise[k, :, lane]
        x[:2] = np.where(quantum > 0, np.round(x[:2] / np.maximum(quantum, 1e-12)) * quantum, x[:2])
        u = drive.feedforward[k, :, lane] + drive.gain[..., lane] @ (
            drive.reference[k, :, lane] - x
        )
        measured[k], command[k] = x, np.clip(u, -drive.limit[:, lane], drive.limit[:, lane])
        data.ctrl[:] = command[k]
        data.qfrc_applied[:] = drive.disturbance[k, :, lane] + bias
        gap = times[min(k + 1, rows - 1)] - times[k]
        if gap > 0:
            pieces = max(1, int(np.ceil(gap / step - 1e-9)))
            model.opt.timestep = gap / pieces
            mujoco.mj_step(model, data, pieces)
    return state, clean, measured, command


def simulate_mujoco(drafts: list, drive: Drive) -> Run:
    """All trials of all data sets, one after another, into the same arrays as the NumPy engine
    fills.
    """
    rows, lanes = drive.times.shape
    run = Run(drive.times, *(np.zeros((rows, n, lanes)) for n in (4, 4, 4, 4, 2)))
    for d in drafts:
        missing = [e["name"] for e in d.hidden if e["name"] not in SUPPORTED]
        if missing:
            raise ValueError(f"the MuJoCo engine has no feature for {', '.join(missing)}")
        step = 5e-4 if all(e["name"] in SMOOTH for e in d.hidden) else 1e-4
        model = build(d.rig, d.hidden, step)
        for lane in range(d.lanes.start, d.lanes.stop):
            out = run_trial(model, d.rig, d.hidden, drive, lane, step)
            (
                run.state[..., lane],
                run.clean[..., lane],
                run.measured[..., lane],
                run.command[..., lane],
            ) = out
            run.smooth[..., lane] = out[1]
    return run
