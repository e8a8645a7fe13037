"""What a model that MuJoCo steps may lack, as numbers of it by name: friction, damping and rotors of joints, gains, a late command,
payloads, and what only contact shows: friction and stiffness of what touches the world, a world that is tilted."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from adaptsim_jax.diagnosis.problem import Candidate, Quantity
from adaptsim_jax.simulators.mujoco.build import Stepped
from adaptsim_jax.simulators.mujoco.fields import DELAY, TILTS, Field, field

DECLARED = "viscous"
"""What is fitted whatever is named."""
HEAVY = 0.05  # share of all mass, from which on a body may carry a payload
UNITS = {
    "frictionloss": "N m",
    "damping": "N m s/rad",
    "armature": "kg m^2",
    "mass": "kg",
    "friction": "1",
    "solref": "s",
    "kp": "N m/rad",
}


def candidates(
    made: Stepped, joints: Sequence[str]
) -> tuple[tuple[Field, ...], tuple[Quantity, ...], tuple[Candidate, ...]]:
    """Fields, the quantities that they are (in their order), and the candidates that free them. joints: those that were logged."""
    model = made.model
    rows: list[tuple[Field, Quantity, Candidate]] = []

    def add(effect: str, where: str, made_field: Field, physics: str, seen: str, same: tuple[str, ...] = ()) -> None:
        name, unit = made_field.name, UNITS.get(made_field.field.split(".")[-1], "1")
        q = Quantity(
            name,
            unit,
            made_field.neutral,
            made_field.low,
            made_field.high,
            10.0 * made_field.scale,
            100.0 * made_field.scale,
        )
        rows.append((made_field, q, Candidate(f"{effect} at {where}", where, (name,), physics, seen, same=same)))

    weight = _scales(model, joints)
    for name in joints:
        size = weight[name]
        sized = lambda f, share, size=size: replace(f, scale=max(f.scale, share * size))
        add("coulomb", name, sized(field(model, f"joint:{name}.frictionloss"), 0.01), "dry friction", "reversals")
        add(
            DECLARED,
            name,
            sized(field(model, f"joint:{name}.damping"), 0.01),
            "friction in proportion to speed",
            "fast motion",
        )
        rotor = field(model, f"joint:{name}.armature")
        inertia = 1.0 / max(float(model.dof_invweight0[model.jnt_dofadr[model.joint(name).id]]), 1e-9)
        add(
            "armature",
            name,
            replace(rotor, scale=max(rotor.scale, 0.01 * inertia)),
            "a rotor's inertia",
            "fast changes of speed",
        )
    for k in range(model.nu):
        name = model.actuator(k).name
        servo = model.actuator_biasprm[k, 1] < 0
        what = "kp" if servo else "gainprm[0]"
        if field(model, f"actuator:{name}.{what}").neutral:
            add(
                "gain",
                name,
                field(model, f"actuator:{name}.{what}"),
                "the drive gives more or less than told",
                "large commands",
            )
    if model.nu:
        add("delay", "all joints", field(model, DELAY), "commands act late", "fast commands")
    total = float(model.body_mass.sum())
    for b in range(1, model.nbody):
        if model.body_mass[b] > HEAVY * total and model.body_dofnum[b] > 0:
            name = model.body(b).name
            add("payload", name, field(model, f"body:{name}.mass"), "a body of another mass", "motion against gravity")
    _of_contact(made, add)
    return tuple(r[0] for r in rows), tuple(r[1] for r in rows), tuple(r[2] for r in rows)


def _of_contact(made: Stepped, add: Callable[..., None]) -> None:
    """Adds what contact with the world shows, where anything may touch it."""
    model = made.model
    ground = [
        g
        for g in range(model.ngeom)
        if model.geom_bodyid[g] == 0 and (model.geom_contype[g] or model.geom_conaffinity[g])
    ]
    touch = [
        g
        for g in range(model.ngeom)
        if model.geom_bodyid[g] > 0 and (model.geom_contype[g] or model.geom_conaffinity[g])
    ]
    if not ground or not touch:
        return
    every = tuple(ground + touch)
    friction = float(model.geom_friction[touch, 0].mean())
    soft = float(model.geom_solref[touch, 0].mean())
    scale = lambda name, what, column, neutral, high: Field(
        name, f"geom.{what}", every, column, neutral, 1e-3, high, 0.01 * neutral
    )
    add(
        "floor friction",
        "all contacts",
        scale("contact.friction", "friction", 0, friction, 5.0),
        "a floor of other friction",
        "sliding",
    )
    if soft > 0:
        add(
            "contact stiffness",
            "all contacts",
            scale("contact.solref", "solref", 0, soft, 1.0),
            "softer or harder contacts",
            "impacts",
        )
    if made.base >= 0:
        for name in TILTS:
            add(
                "tilt",
                name,
                field(model, name),
                "the ground is tilted",
                "standing and walking",
            )


def _scales(model: mujoco.MjModel, joints: Sequence[str]) -> dict[str, float]:
    """N m, N: of gravity at a joint, at least of its own inertia at an acceleration of 10 rad/s^2 (m/s^2)."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    out = {}
    for name in joints:
        dof = int(model.jnt_dofadr[model.joint(name).id])
        out[name] = max(abs(float(data.qfrc_bias[dof])), 10.0 / max(float(model.dof_invweight0[dof]), 1e-9) * 0.1, 1e-3)
    return out


def noise_of(measured: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Noise [C] of channels [W, L, C] by their third differences, of which smooth motion has next to none."""
    d = np.diff(np.where(seen, measured, np.nan), 3, axis=1)
    size = np.nanmedian(np.abs(d), axis=(0, 1)) / 0.6745 / np.sqrt(20.0)
    return np.where(np.isfinite(size), size, 0.0)
