"""Units of a log's columns guessed by what tells most: the headings, else recorded speeds, else the
model's ranges, else sizes.

A size alone is a question, not a guess: a wheel that turns five times reaches as far as an arm that
moves by 30 degrees.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from adaptsim_jax.logs.columns import TIME, Role, roles_of
from adaptsim_jax.logs.criteria import TABLE, UNIT
from adaptsim_jax.logs.headings import HeadingUnit, heading_unit, lines
from adaptsim_jax.logs.log import ModelNames
from adaptsim_jax.logs.log_units import LENGTH_UNITS, TIME_UNITS
from adaptsim_jax.logs.scales import Scale, lengths_within, scales_of, times_range
from adaptsim_jax.logs.speeds import DEGREE, MISTAKES, agreement, common_ratio


@dataclass(frozen=True)
class Question:
    """A unit that may be meant, and is not taken until a person says so."""

    unit: str


Units = dict[str, tuple[str | Scale | Question, str]]


@dataclass(frozen=True)
class _Columns:
    """Columns `q`, `v`, `target` as written, by joint as the columns call it, of joints that turn
    or of those that slide. `name`: the joint's own; `servos`: joints that a servo drives.
    """

    q: dict[int | str | None, np.ndarray]
    v: dict[int | str | None, np.ndarray]
    target: dict[int | str | None, np.ndarray]
    name: dict[int | str | None, str]
    limits: dict[int | str | None, tuple[float, float]] = field(default_factory=dict)
    servos: frozenset[int | str | None] = frozenset()

    def reach(self, joint: int | str | None) -> float:
        return float(np.nanmax(np.abs(self.q[joint]), initial=0.0))

    def reach_text(self, joint: int | str | None) -> str:
        """How far a joint moves, and how far its model lets it, in words."""
        low, high = self.limits[joint]
        reached = f"{self.name[joint]} reaches {self.reach(joint):.4g}"
        return f"{reached}, its range in the model is {low:.3g} to {high:.3g}"


def guess_units(
    columns: dict[str, np.ndarray],
    joints: Sequence[str] = (),
    lerobot: bool = False,
    model: ModelNames | None = None,
    headings: Mapping[str, str] | None = None,
) -> Units:
    """Units that headings say or numbers betray, and by what: key of `[units]` -> (unit, why), or a
    `Scale`, which is a whole line; a quantity that looks SI is not listed.

    Args:
        columns: our name -> `[T]` as written.
        joints: the model's, where known.
        lerobot: whether the columns are of a LeRobot data set.
        model: what else is known of the model.
        headings: our name -> what the file calls it.
    """
    roles = roles_of(columns, joints)
    scales = _scales(columns, roles, joints, lerobot, model)
    heading_units = [
        row
        for name, column_role in roles.items()
        if (row := _of_heading(name, column_role, roles, headings or {}, model))
    ]
    heading_units = [
        row
        for row in heading_units
        if row.quantity not in ("angle", "length") or str(roles[row.column].joint) not in scales
    ]
    out: Units = {}
    for key, row in lines(heading_units).items():
        is_contradicted = any(
            t.quantity == row.quantity and t.unit != row.unit and t.slides == row.slides
            for t in heading_units
            if t.fits
        )
        if row.quantity and is_contradicted:
            caveat = f"; other headings of {row.quantity} say otherwise"
        else:
            caveat = ""
        if key != "time":
            out[key] = (row.unit, f"the heading says so ({row.heading}){caveat}")
    for row in heading_units:
        if not row.fits:
            why = f"the heading says so ({row.heading}), but that is no unit of {row.quantity}"
            out[row.column] = (Question(row.unit), why)
    out = _time(columns, next((row for row in heading_units if row.quantity == "time"), None)) | out
    out |= {scale.line.partition(" ")[0]: (scale, scale.why) for scale in scales.values()}
    time = next((columns[name] for name in TIME if name in columns), None)
    unit = out.get("time", ("s", ""))[0]
    if time is None or not isinstance(unit, str):
        seconds = None
    else:
        seconds = time * TIME_UNITS[unit]
    turning, sliding = (_by_joint(columns, roles, scales, model, kind) for kind in (False, True))
    out = _lengths(out, heading_units, seconds, sliding)
    return _angles(out, heading_units, seconds, turning, lerobot, model is None)


def _of_heading(
    name: str,
    column_role: Role,
    roles: Mapping[str, Role],
    headings: Mapping[str, str],
    model: ModelNames | None,
) -> HeadingUnit | None:
    j = _index(column_role, roles, model)
    if model is None or j is None:
        slides = None
    else:
        slides = model.joints[j] in model.slides
    return heading_unit(
        name, headings.get(name, name), column_role, slides, model.joints if model else ()
    )


def _index(column_role: Role, roles: Mapping[str, Role], model: ModelNames | None) -> int | None:
    """The number of the model's joint that a column speaks of; None where that is not known."""
    if model is None or column_role.stem == "ctrl":
        return None
    if isinstance(column_role.joint, str):
        if column_role.joint in model.joints:
            return model.joints.index(column_role.joint)
        return None
    first = 0 if any(r.joint == 0 for r in roles.values()) else 1
    j = 0 if column_role.joint is None else column_role.joint - first
    if 0 <= j < len(model.joints):
        return j
    return None


def _scales(
    columns: dict[str, np.ndarray],
    roles: dict,
    joints: Sequence[str],
    lerobot: bool,
    model: ModelNames | None,
) -> dict[str, Scale]:
    """Scales that are no units of angle, by joint as the columns name it."""
    by_joint: dict[str, list[np.ndarray]] = {}
    for name, column_role in roles.items():
        if column_role.stem in ("q", "target") and column_role.joint is not None:
            by_joint.setdefault(str(column_role.joint), []).append(columns[name])
    ranges = {j: limits for k, j in enumerate(joints) if model and (limits := model.limits_of(k))}
    return scales_of(by_joint, tuple(by_joint), lerobot, ranges)


def _by_joint(
    columns: dict[str, np.ndarray],
    roles: dict[str, Role],
    scales: Mapping[str, Scale],
    model: ModelNames | None,
    slides: bool,
) -> _Columns:
    by_stem: dict[str, dict[int | str | None, np.ndarray]] = {"q": {}, "v": {}, "target": {}}
    names, limits, servos = {}, {}, set()
    for name, column_role in roles.items():
        joint, j = column_role.joint, _index(column_role, roles, model)
        joint_name = model.joints[j] if model is not None and j is not None else None
        is_slide = model is not None and joint_name in model.slides
        has_scale = column_role.stem != "v" and str(joint) in scales
        if column_role.stem not in by_stem or is_slide != slides or has_scale:
            continue
        by_stem[column_role.stem][joint] = columns[name]
        names[joint] = joint_name or str(joint or name)
        if model is None or j is None:
            continue
        if bounds := model.limits_of(j):
            limits[joint] = bounds
        if any(a.kind == "position" and a.joint == joint_name for a in model.actuators or ()):
            servos.add(joint)
    return _Columns(**by_stem, name=names, limits=limits, servos=frozenset(servos))


def _time(columns: dict[str, np.ndarray], heading: HeadingUnit | None) -> Units:
    """The unit of time, by the heading, else by the interval of rows."""
    time = next((columns[name] for name in TIME if name in columns), None)
    if time is not None and len(time) > 2:
        step = float(np.median(np.diff(time)))
    else:
        step = None
    if step is None:
        name = None
    else:
        name = next((n for n, s in TIME_UNITS.items() if step * s <= TABLE.max_interval), "ns")
    if heading is None:
        if name in (None, "s"):
            return {}
        return {"time": (name, f"a row every {step:.4g}")}
    why = f"the heading says so ({heading.heading})"
    if step is not None and not TABLE.min_interval <= step * heading.scale <= TABLE.max_interval:
        why += (
            f", but a row every {step:.4g} "
            f"{'looks like ' + str(name) if name != heading.unit else 'looks like a larger unit'}"
        )
    elif heading.unit == "s":
        return {}
    return {"time": (heading.unit, why)}


def _lengths(
    out: Units, heading_units: Sequence[HeadingUnit], time: np.ndarray | None, columns: _Columns
) -> Units:
    """Add the unit of sliding joints' positions to `out`, by the headings, else by their speeds,
    ranges, sizes.
    """
    if any(row.quantity == "length" and row.fits for row in heading_units):
        return out
    gain = None if time is None else _gain(time, columns.q, columns.v)
    speed_scales = [
        row.scale for row in heading_units if row.quantity == "velocity" and row.slides and row.fits
    ]
    if gain is not None:  # of speeds in m/s, where no heading says otherwise
        for unit, scale in LENGTH_UNITS.items():
            if scale != 1.0 and _like(gain * (speed_scales[0] if speed_scales else 1.0), scale):
                if speed_scales:
                    speeds = {}
                else:
                    speeds = {
                        f"v_{columns.name[j]}": ("m/s", "see length")
                        for j in columns.v
                        if j in columns.q
                    }
                return out | {"length": (unit, "ways against speeds tell")} | speeds
        return out
    for joint in columns.q:
        reach, name = columns.reach(joint), columns.name[joint]
        if (limits := columns.limits.get(joint)) and (
            units := lengths_within(times_range(reach, limits))
        ):
            low, high = limits
            why = f"{name} reaches {reach:.4g}, its range in the model is {low:g} to {high:g} m"
            is_unique = len(units) == 1
            return out | {
                "length": (
                    units[0] if is_unique else Question(units[0]),
                    why if is_unique else f"{why}: {' or '.join(units)}?",
                )
            }
        if limits is None and reach > UNIT.max_slide_length:
            return out | {
                "length": (
                    Question("mm"),
                    f"{name} reaches {reach:.4g}: if that is no metres, say so",
                )
            }
    return out


def _angles(
    out: Units,
    heading_units: Sequence[HeadingUnit],
    time: np.ndarray | None,
    columns: _Columns,
    lerobot: bool,
    unknown: bool,
) -> Units:
    """Add the units of angles and of their speeds to `out`."""
    gain = None if time is None else _gain(time, columns.q, columns.v)
    angle = {row.scale for row in heading_units if row.quantity == "angle" and row.fits}
    speed = {
        row.scale
        for row in heading_units
        if row.quantity == "velocity" and row.fits and not row.slides
    }
    if angle or speed:
        return _by_headings(out, gain, angle, speed, columns)
    for size, (_, units) in MISTAKES.items():
        if gain is not None and "time" not in units and _like(gain, size):
            why = f"speeds are {gain:.3g} times the angles' slopes"
            return out | {key: (unit, why) for key, unit in units.items()}
    return out | _by_size(time, columns, lerobot, unknown)


def _by_headings(
    out: Units, gain: float | None, angle: set[float], speed: set[float], columns: _Columns
) -> Units:
    """What headings say of angles and speeds, with what follows for the others, and what
    contradicts them.
    """
    if (
        gain is not None
        and len(angle) == 1
        and not speed
        and _like(gain, *angle)
        and angle != {1.0}
    ):
        out = out | {"velocity": ("rad/s", "speeds fit rad/s")}
    elif gain is not None and len(speed) == 1 and not angle and _like(gain * min(speed), DEGREE):
        out = out | {"angle": ("deg", "angles are 57 times larger than speeds tell")}
    elif (
        gain is not None and len(angle) == len(speed) == 1 and not _like(gain * min(speed), *angle)
    ):
        key = next(
            key for key in ("velocity", *out) if key in out and (key == "velocity" or key[0] == "v")
        )
        unit, why = out[key]
        times = gain * min(speed) / min(angle)
        out = out | {
            key: (
                unit,
                f"{why}, but speeds are {times:.3g} times what the angles' slopes are by their "
                "heading",
            )
        }
    for joint, limits in columns.limits.items():
        if joint in columns.q:
            times = times_range(columns.reach(joint), limits)
        else:
            times = 0.0
        if (
            angle == {1.0}
            and times > UNIT.hint_ranges
            and times * DEGREE <= UNIT.max_ranges_in_unit
            and "angle" in out
        ):
            unit, why = out["angle"]
            return out | {"angle": (unit, f"{why}, but {columns.reach_text(joint)} rad")}
    return out


def _by_size(time: np.ndarray | None, columns: _Columns, lerobot: bool, unknown: bool) -> Units:
    """Degrees, where something beside the size backs them; a question where the size is all there
    is.

    Args:
        unknown: No model is known.
    """
    questions: Units = {}
    for joint, q in columns.q.items():
        reach = columns.reach(joint)
        if reach <= UNIT.max_angle:
            continue
        limits = columns.limits.get(joint)
        if (
            limits
            and times_range(reach, limits) > UNIT.hint_ranges
            and times_range(reach, limits) * DEGREE <= UNIT.max_ranges_in_unit
        ):
            why = f"{columns.reach_text(joint)} rad"
            return {"angle": ("deg", why)}
        turns = f"angles reach {reach:.4g}; rad, if the joint turns {reach / (2 * np.pi):.2g} times"
        fast = (
            time is not None
            and np.nanquantile(np.abs(np.gradient(q, time)), 0.99) > UNIT.min_degree_speed
            and reach <= UNIT.max_degrees
        )
        if lerobot or (fast and (unknown or joint in columns.servos)):
            return {"angle": ("deg", turns)}
        questions = questions or {"angle": (Question("deg"), turns)}
    return questions


def _like(gain: float, scale: float) -> bool:
    return abs(np.log(gain / scale)) < UNIT.log_tolerance


def _gain(time: np.ndarray, angles: dict, speeds: dict) -> float | None:
    """Logged speed over the slope of the angle, where joints agree on it."""
    pairs = [(angles[joint], v) for joint, v in speeds.items() if joint in angles]
    gain = common_ratio([estimate for q, v in pairs if (estimate := agreement(time, q, v))])
    return gain if gain is not None and gain > 0 else None
