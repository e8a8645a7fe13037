"""What a diagnosis found in the terms of other tools: files made from templates, and what each can
say of it.
"""

import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import jinja2
import mujoco
import numpy as np

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mend.mjcf import lost_of
from adaptsim_jax.mend.model_toml import Form, Value, read_form
from adaptsim_jax.mend.movable import movable
from adaptsim_jax.mend.randomisation import (
    Randomisation,
    Randomised,
    intervals,
    read_randomisation,
)
from adaptsim_jax.mend.urdf import urdf_parts

MODEL = "model.xml"
NEEDED = ("report.json", "model.toml", MODEL, "randomisation.toml")
JOINTS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
FACTORS = (0.0, 1.0)
TOOLS = {
    "mjcf": "MuJoCo",
    "urdf": "URDF",
    "playground": "MuJoCo Playground",
    "brax": "Brax",
    "mjlab": "mjlab",
    "isaaclab": "Isaac Lab",
    "json": "any program",
}
COLUMNS = {"playground": "mjx", "brax": "mjx"}
"""Formats that say what another of `carried.toml` says."""


@dataclass(frozen=True)
class JointDrive:
    """An actuator at a joint, in numbers of the joint: N m/rad, N m s/rad, N m, s.

    kind: position, velocity or motor; limit None: nothing bounds it; delay: shortest and longest.
    passive, armature, frictionloss: of the joint itself.
    """

    joint: str
    actuator: str
    kind: str
    stiffness: float
    damping: float
    gear: float
    limit: float | None
    delay: tuple[float, float]
    lag: float
    passive: float
    armature: float
    frictionloss: float


@dataclass(frozen=True)
class Row:
    """A randomised number: kind, element and attribute of its name (of an effect its joint, and
    `EFFECT.PARAMETER`); factor: its ends over its centre.
    """

    name: str
    kind: str
    element: str
    attribute: str
    low: float
    centre: float
    high: float
    unit: str
    because: str

    @property
    def factor(self) -> tuple[float, float]:
        """Ends of the range over the centre."""
        if not self.centre:
            return FACTORS
        low, high = sorted((self.low / self.centre, self.high / self.centre))
        return low, high


@dataclass(frozen=True)
class Carried:
    """What a format makes of an effect: exact, approximated or dropped, and why."""

    effect: str
    where: str
    how: str
    why: str


@dataclass(frozen=True)
class Diagnosis:
    """The folder of a diagnosis of a mechanism."""

    folder: Path
    report: Mapping[str, Any]
    form: Form
    random: Randomisation
    model: mujoco.MjModel

    @property
    def step(self) -> float:
        """s of the file's step."""
        return float(self.model.opt.timestep)

    @cached_property
    def rows(self) -> list[Row]:
        """What is randomised."""
        return [_row(one) for one in self.random.rows]

    @cached_property
    def drives(self) -> list[JointDrive]:
        """Actuators at joints."""
        some = range(self.model.nu)
        return [_drive(self, k) for k in some if int(self.model.actuator_trntype[k]) in JOINTS]

    @property
    def joint_of(self) -> dict[str, str]:
        """The joint of each actuator."""
        return {drive.actuator: drive.joint for drive in self.drives}

    @property
    def found(self) -> list[tuple[str, str]]:
        """Effects of the mended model and where, with what stands in tables of their own."""
        effects = [(e.name, e.where) for e in self.form.effects]
        servos = [("servo", joint) for joint in self.form.own.get("servo", {})]
        named = [(e["name"], e["where"]) for e in self.report["effects"]]
        bodies = [(name, where) for name, where in named if name in ("inertia", "body_mass")]
        lift = [("lift", "base")] * ("lift" in self.form.own)
        return [*effects, *servos, *bodies, *lift]


def read_diagnosis(folder: str | Path) -> Diagnosis:
    """The folder that `adaptsim diagnose --out` wrote of a mechanism. BadInput names what is not
    there.
    """
    folder = Path(folder)
    for name in NEEDED:
        if not (folder / name).exists():
            raise BadInput(
                f"{folder / name}: no such file; give the folder that `adaptsim diagnose --out` "
                "wrote of a machine with joints"
            )
    table = config.read(folder / "model.toml")
    form = read_form(table, str(folder / "model.toml"), tuple(table))
    try:
        model = mujoco.MjModel.from_xml_path(str(folder / MODEL))
    except ValueError as error:
        raise BadInput(f"{folder / MODEL}: {' '.join(str(error).split())}") from None
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    random = read_randomisation(folder / "randomisation.toml")
    return Diagnosis(folder, report, form, random, model)


def _row(one: Randomised) -> Row:
    kind, _, rest = one.name.partition(":")
    parts = rest.rsplit(".", 2 if kind == "effect" else 1)
    numbers = one.low, one.centre, one.high, one.unit
    return Row(one.name, kind, parts[0], ".".join(parts[1:]), *numbers, one.because)


def _drive(d: Diagnosis, k: int) -> JointDrive:
    m, joint = d.model, int(d.model.actuator_trnid[k, 0])
    name, dof, gear = m.joint(joint).name, int(m.jnt_dofadr[joint]), float(m.actuator_gear[k, 0])
    gain, bias = m.actuator_gainprm[k], m.actuator_biasprm[k]
    kind = "position" if bias[1] else "velocity" if bias[2] else "motor"
    limits = [np.abs(m.actuator_forcerange[k] * gear).max()] * bool(m.actuator_forcelimited[k])
    limits += [np.abs(m.jnt_actfrcrange[joint]).max()] * bool(m.jnt_actfrclimited[joint])
    late = {r.element: (r.low, r.high) for r in d.rows if r.attribute == "delay.delay"}
    delay = float(m.actuator_delay[k])
    return JointDrive(
        name,
        m.actuator(k).name,
        kind,
        float(-bias[1] * gear**2),
        float(-bias[2] * gear**2),
        float(gear * gain[0]),
        float(min(limits)) if limits else None,
        late.get(name, (delay, delay)),
        float(m.actuator_dynprm[k, 0]) if m.actuator_dyntype[k] else 0.0,
        float(m.dof_damping[dof]),
        float(m.dof_armature[dof]),
        float(m.dof_frictionloss[dof]),
    )


def carried(d: Diagnosis, form: str) -> list[Carried]:
    """What a format makes of each effect of a diagnosis."""
    column, known = COLUMNS.get(form, form), config.read(Path(__file__).with_name("carried.toml"))
    out = []
    lost = lost_of(d.model) or ()
    for effect, where in dict.fromkeys(d.found):
        words = known.get(effect, {}).get(column, "dropped")
        if form == "json":
            words = "exact"
        elif f"{effect} at {where}" in lost:
            words = "dropped: model.xml has not got it here"
        how, _, why = words.partition(": ")
        if how == "dropped" and column == "mjx":
            why = "adaptsim's mended(env, model.toml) has it"
        out.append(Carried(effect, where, how, why))
    if d.random.names and column in ("mjlab", "isaaclab"):
        where = ", ".join(d.random.names)
        out.append(Carried("correlation", where, "dropped", "ranges are drawn one by one"))
    return out


def written(d: Diagnosis, form: str) -> dict[str, bytes]:
    """The files of a format, by name."""
    if form not in WRITERS:
        raise BadInput(f"--as {form}: no such format; {config.suggest(form, WRITERS)}")
    return {name: _bytes(content) for name, content in WRITERS[form](d, form).items()}


def _bytes(content: str | bytes) -> bytes:
    return content.encode() if isinstance(content, str) else content


def _mjcf(d: Diagnosis, form: str) -> dict[str, str | bytes]:
    return movable(d.folder / MODEL)


def _python(d: Diagnosis, form: str) -> dict[str, str | bytes]:
    template, name = {
        "mjlab": ("mjlab.py.j2", "robot.py"),
        "isaaclab": ("isaaclab.py.j2", "robot.py"),
    }.get(form, ("mjx.py.j2", "randomize.py"))
    text = filled(template, d=d, tool=TOOLS[form], notes=notes(d, form))
    return {name: text, **movable(d.folder / MODEL)}


def _urdf(d: Diagnosis, form: str) -> dict[str, str | bytes]:
    text = filled("robot.urdf.j2", name="robot", notes=notes(d, form), **urdf_parts(d.model))
    return {"robot.urdf": text}


def _json(d: Diagnosis, form: str) -> dict[str, str | bytes]:
    effects = [
        {
            "name": e.name,
            "where": e.where,
            "parameters": {
                p: _with_ends(d, (e.name, e.where, p), v) for p, v in e.parameters.items()
            },
        }
        for e in d.form.effects
    ]
    table = {
        "schema": 1,
        "verdict": d.report["verdict"],
        "effects": effects,
        "declared": d.report["declared"]["after"],
        "own": d.form.own,
        "drives": [vars(drive) for drive in d.drives],
        "randomised": {row.name: row.table() for row in d.random.rows},
        "correlation": {"names": d.random.names, "matrix": d.random.matrix},
    }
    return {"numbers.json": json.dumps(table, indent=2) + "\n"}


def _with_ends(d: Diagnosis, key: tuple[str, str, str], value: Value) -> dict[str, Any]:
    """A number with the interval that the report has of it, null where it has none."""
    ends, unit = dict(intervals(d.report)).get(key, ((value.low, value.high), value.unit))
    return {"value": value.value, "low": ends[0], "high": ends[1], "unit": unit or value.unit}


WRITERS: dict[str, Callable[[Diagnosis, str], dict[str, str | bytes]]] = {
    "mjcf": _mjcf,
    "urdf": _urdf,
    "playground": _python,
    "brax": _python,
    "mjlab": _python,
    "isaaclab": _python,
    "json": _json,
}


def notes(d: Diagnosis, form: str) -> list[str]:
    """A line for each effect that a format does not have exactly."""
    rows = [row for row in carried(d, form) if row.how != "exact"]
    return [f"{r.effect} at {r.where}: {r.how}{f', {r.why}' * bool(r.why)}" for r in rows]


def filled(template: str, **values: Any) -> str:
    """The text of a template of this room."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).with_name("templates")),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {
        "number": _number,
        "triple": lambda z: " ".join(map(_number, z)),
        "pattern": lambda text: repr(re.escape(text)),
        "identifier": lambda text: re.sub(r"\W", "_", text),
    }
    return environment.get_template(template).render(**values)


def _number(value: float) -> str:
    """A number as a literal of Python."""
    return f"{value:.8g}" if math.isfinite(value) else f'float("{value}")'
