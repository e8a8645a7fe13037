"""`randomisation.toml`: how far each number of a model may be off after a diagnosis, for training.

schema = 1
model = "model.toml"
[fields."joint:elbow.frictionloss"]     # a name as env.toml has it
centre = 0.31
low = 0.28                              # 90 % interval of what was fitted, else a width
high = 0.34
unit = "N m"
source = "found"                        # found, fitted, or file: these data do not fix it
because = "coulomb at elbow"
[correlation]                           # of intervals that are known together
names = [...]
matrix = [[...]]
"""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.mend.model_toml import Form, number_at, read_form, table_at, text_at

FILE = "randomisation.toml"
SCHEMA = 1
IN_MODEL = {
    ("viscous", "damping"): "damping",
    ("coulomb", "level"): "frictionloss",
    ("armature", "inertia"): "armature",
    ("spring", "stiffness"): "stiffness",
}
"""Numbers of effects that a model has at its joints."""
UNITS = {
    "damping": "N m s/rad",
    "frictionloss": "N m",
    "armature": "kg m^2",
    "stiffness": "N m/rad",
}
SIMPLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@dataclass(frozen=True)
class Widths:
    """How far what no data fix may be off, as a share of the file's value to either side."""

    mass: float = 0.1
    """Of a body: parts are weighed or drawn, cables and screws are left out."""
    damping: float = 0.5
    """Of a joint: it doubles between cold and warm grease."""
    frictionloss: float = 0.5
    """Of a joint: it depends on load, wear and how tight its bearing is."""
    armature: float = 0.2
    """Of a joint: catalogues give a rotor's inertia to about a tenth, squared gears to more."""
    stiffness: float = 0.2
    """Of a joint's spring: springs are sold to within a tenth."""
    found: float = 0.3
    """Of an effect that was found, where its number has no interval of its own."""


@dataclass(frozen=True)
class Randomised:
    """A number, by the name of its field, and how far it may be off."""

    name: str
    centre: float
    low: float
    high: float
    unit: str
    source: str
    because: str

    def table(self) -> dict[str, Any]:
        """As the file has it."""
        names = ("centre", "low", "high", "unit", "source", "because")
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True)
class Randomisation:
    """What a file holds; names, matrix: of the correlation of some of its numbers."""

    rows: tuple[Randomised, ...]
    names: tuple[str, ...] = ()
    matrix: tuple[tuple[float, ...], ...] = ()

    def text(self) -> str:
        """The TOML text."""
        table: dict[str, Any] = {"schema": SCHEMA, "model": "model.toml"}
        table["fields"] = {row.name: row.table() for row in self.rows}
        if self.names:
            matrix = [list(row) for row in self.matrix]
            table["correlation"] = {"names": list(self.names), "matrix": matrix}
        heading = "What a diagnosis leaves open, to train with: `adaptsim train --diagnosis`."
        return config.dumps(table, heading)


def read_randomisation(path: str | Path) -> Randomisation:
    """A file of this form. BadInput names the key at fault."""
    where, table = str(path), config.read(path)
    if table.get("schema") != SCHEMA:
        raise BadInput(
            f"{where}: schema = {table.get('schema')!r}, this version reads {SCHEMA}; run "
            "`adaptsim diagnose` again"
        )
    rows = []
    for name, row in table_at(where, table, "fields").items():
        key = f'fields."{name}"'
        if not isinstance(row, dict):
            raise BadInput(f"{where}: {key} must be a table; give it centre, low and high")
        low, centre, high = (
            number_at(where, f"{key}.{k}", row.get(k)) for k in ("low", "centre", "high")
        )
        if not low <= centre <= high:
            raise BadInput(
                f"{where}: {key}: {centre:g} is outside [{low:g}, {high:g}]; mend one of them"
            )
        words = [text_at(where, row, k) for k in ("unit", "source", "because")]
        rows.append(Randomised(name, centre, low, high, *words))
    given = table_at(where, table, "correlation")
    matrix = tuple(tuple(map(float, row)) for row in given.get("matrix", ()))
    return Randomisation(tuple(rows), tuple(given.get("names", ())), matrix)


def write_randomisation(folder: str | Path) -> None:
    """`randomisation.toml` of a diagnosis of a mechanism, from the files in its folder; nothing
    where these are none.
    """
    folder = Path(folder)
    files = [folder / name for name in ("report.json", "model.toml", "declared.xml")]
    if not all(file.exists() for file in files):
        return
    table = config.read(files[1])
    if table.get("task") != "mechanism":
        return
    form = read_form(table, str(files[1]), tuple(table))
    report = json.loads(files[0].read_text(encoding="utf-8"))
    model = mujoco.MjModel.from_xml_path(str(files[2]))
    randomisation = randomisation_of(report, form, _declared(model), _servos(model))
    write_bytes(folder / FILE, randomisation.text().encode())


def _declared(model: mujoco.MjModel) -> dict[str, tuple[float, str]]:
    """Numbers of a model file by the names of fields, with units."""
    out = {}
    for b in range(1, model.nbody):
        out[f"body:{model.body(b).name}.mass"] = float(model.body_mass[b]), "kg"
    for j in range(model.njnt):
        if int(model.jnt_type[j]) not in SIMPLE:
            continue
        dof, name = model.jnt_dofadr[j], model.joint(j).name
        for key, unit in UNITS.items():
            array = (
                model.jnt_stiffness[j] if key == "stiffness" else getattr(model, f"dof_{key}")[dof]
            )
            out[f"joint:{name}.{key}"] = float(array), unit
    return out


def _servos(model: mujoco.MjModel) -> dict[str, tuple[str, float]]:
    """Return by joint the actuator at it and the square of its gear."""
    joint_transmissions = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    return {
        model.joint(model.actuator_trnid[k, 0]).name: (
            model.actuator(k).name,
            float(model.actuator_gear[k, 0] ** 2),
        )
        for k in range(model.nu)
        if int(model.actuator_trntype[k]) in joint_transmissions
    }


def randomisation_of(
    report: Mapping[str, Any],
    form: Form,
    declared: Mapping[str, tuple[float, str]],
    servos: Mapping[str, tuple[str, float]],
    widths: Widths = Widths(),
) -> Randomisation:
    """What a report and its `model.toml` leave open.

    Args:
        declared: Numbers of the model file by the names of fields, with units.
        servos: By joint the actuator at it and the square of its gear.
    """
    interval_of = dict(intervals(report))
    rows: dict[str, Randomised] = {}
    for effect in form.effects:
        for parameter, number in effect.parameters.items():
            name = _field(effect.name, effect.where, parameter)
            if name is None:
                continue
            ends, unit = interval_of.get(
                (effect.name, effect.where, parameter), (None, number.unit)
            )
            if ends is None and number.low is not None and number.high is not None:
                ends = number.low, number.high
            words = f"{effect.name.replace('_', ' ')} at {effect.where}"
            rows[name] = _row(name, number.value, ends, unit, words, widths.found)
    for joint, numbers in form.own.get("servo", {}).items():
        if joint in servos and numbers.get("kp"):
            actuator, square = servos[joint]
            name, kp = f"actuator:{actuator}.gain", numbers["kp"]
            ends, _ = interval_of.get(("kp", joint, "kp"), (None, ""))
            gain_ends = None if ends is None else (ends[0] / square, ends[1] / square)
            row = _row(name, kp / square, gain_ends, "N m/rad", f"kp of {joint}", widths.found)
            rows[name] = row
    for name, (value, unit) in declared.items():
        share = getattr(widths, name.rpartition(".")[2], None)
        if name not in rows and share is not None and value != 0.0:
            low, high = sorted((value * (1.0 - share), value * (1.0 + share)))
            why = f"these data do not fix it: the file's value, by {share:.0%} either way"
            rows[name] = Randomised(name, value, low, high, unit, "file", why)
    names, matrix = _correlations(report, servos)
    return Randomisation(tuple(rows.values()), names, matrix)


def _row(name, value: float, ends, unit: str, words: str, share: float) -> Randomised:
    if ends is None:
        ends = sorted((value * (1.0 - share), value * (1.0 + share)))
        words = f"{words}; its interval is not known, so {share:.0%} either way"
        return Randomised(name, value, *ends, unit, "found", words)
    low, high = min(ends[0], value), max(ends[1], value)
    return Randomised(name, value, low, high, unit, "fitted", words)


def _field(effect: str, where: str, parameter: str) -> str | None:
    """The name of a field; None of what has none (of the whole base, a shape that is chosen)."""
    if where == "base" or parameter in ("before", "link", "control", "side", "peak", "low", "high"):
        return None
    if (effect, parameter) in IN_MODEL:
        return f"joint:{where}.{IN_MODEL[effect, parameter]}"
    if effect == "spring":
        return None
    return f"effect:{where}.{effect}.{parameter}"


def intervals(report: Mapping[str, Any]) -> Iterator[tuple[tuple[str, str, str], tuple]]:
    """`(effect, joint, parameter)` and `((low, high), unit)` of what a report has intervals of;
    numbers of servos go by their own name.
    """
    for row in report["effects"]:
        for joint in row.get("joints") or [row["where"]]:
            for name, number in row["parameters"].items():
                if ends := _ends(number):
                    yield (row["name"], joint, name), (ends, number.get("unit", ""))
    for words, number in report["declared"]["after"].items():
        name, _, joint = words.rpartition(" of ")
        ends = _ends(number)
        if joint and ends and number.get("identifiable", True):
            yield (name, joint, name), (ends, number.get("unit", ""))


def _ends(number: Mapping[str, Any]) -> tuple[float, float] | None:
    low, high = number.get("low"), number.get("high")
    if low is None or high is None:
        return None
    return float(low), float(high)


def _correlations(report, servos) -> tuple[tuple[str, ...], tuple]:
    """Correlations that a report's intervals tell: of stiffness and damping of servos, whose
    quotient has an interval of its own.
    """
    pairs = []
    for row in report["effects"]:
        numbers = row["parameters"]
        relative_widths = [
            _relative(numbers.get(n, {})) for n in ("kp", "damping", "damping_over_kp")
        ]
        joint = row["where"]
        if joint not in servos or not all(relative_widths):
            continue
        kp, damping, quotient = (z for z in relative_widths if z)
        r = (kp**2 + damping**2 - quotient**2) / (2.0 * kp * damping)
        pairs.append((joint, max(-1.0, min(1.0, r))))
    names = [n for j, _ in pairs for n in (f"actuator:{servos[j][0]}.gain", f"joint:{j}.damping")]
    matrix = [[float(i == k) for k in range(len(names))] for i in range(len(names))]
    for i, (_, r) in enumerate(pairs):
        matrix[2 * i][2 * i + 1] = matrix[2 * i + 1][2 * i] = r
    return tuple(names), tuple(map(tuple, matrix))


def _relative(number: Mapping[str, Any]) -> float | None:
    """Width of an interval over its value; None where there is none."""
    ends = _ends(number)
    if ends is None or not number.get("value"):
        return None
    width = (ends[1] - ends[0]) / abs(float(number["value"]))
    return width if math.isfinite(width) and width > 0.0 else None
