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
from adaptsim_jax.logs.speeds import DEGREE, MISTAKES, agreement, common


@dataclass(frozen=True)
class Question:
    """A unit that may be meant, and is not taken until a person says so."""

    unit: str


Units = dict[str, tuple[str | Scale | Question, str]]


@dataclass(frozen=True)
class _Columns:
    """Columns as written by joint, as the columns name it: of joints that turn, and of those that
    slide. `name`: the joint's own.
    """

    q: dict[int | str | None, np.ndarray]
    v: dict[int | str | None, np.ndarray]
    target: dict[int | str | None, np.ndarray]
    name: dict[int | str | None, str]
    limits: dict[int | str | None, tuple[float, float]] = field(default_factory=dict)
    servos: frozenset[int | str | None] = frozenset()

    def reach(self, joint: int | str | None) -> float:
        return float(np.nanmax(np.abs(self.q[joint]), initial=0.0))

    def reaches(self, joint: int | str | None) -> str:
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
    reported = [
        one
        for name, found in roles.items()
        if (one := _of_heading(name, found, roles, headings or {}, model))
    ]
    reported = [
        one
        for one in reported
        if one.quantity not in ("angle", "length") or str(roles[one.column].joint) not in scales
    ]
    out: Units = {}
    for key, one in lines(reported).items():
        differ = any(
            t.quantity == one.quantity and t.unit != one.unit and t.slides == one.slides
            for t in reported
            if t.fits
        )
        if one.quantity and differ:
            also = f"; other headings of {one.quantity} say otherwise"
        else:
            also = ""
        if key != "time":
            out[key] = (one.unit, f"the heading says so ({one.heading}){also}")
    for one in reported:
        if not one.fits:
            why = f"the heading says so ({one.heading}), but that is no unit of {one.quantity}"
            out[one.column] = (Question(one.unit), why)
    out = _time(columns, next((one for one in reported if one.quantity == "time"), None)) | out
    out |= {scale.line.partition(" ")[0]: (scale, scale.why) for scale in scales.values()}
    time = next((columns[name] for name in TIME if name in columns), None)
    unit = out.get("time", ("s", ""))[0]
    if time is None or not isinstance(unit, str):
        seconds = None
    else:
        seconds = time * TIME_UNITS[unit]
    turning, sliding = (_by_joint(columns, roles, scales, model, kind) for kind in (False, True))
    out = _lengths(out, reported, seconds, sliding)
    return _angles(out, reported, seconds, turning, lerobot, model is None)


def _of_heading(
    name: str,
    found: Role,
    roles: Mapping[str, Role],
    headings: Mapping[str, str],
    model: ModelNames | None,
) -> HeadingUnit | None:
    j = _index(found, roles, model)
    if model is None or j is None:
        slides = None
    else:
        slides = model.joints[j] in model.slides
    return heading_unit(
        name, headings.get(name, name), found, slides, model.joints if model else ()
    )


def _index(found: Role, roles: Mapping[str, Role], model: ModelNames | None) -> int | None:
    """The number of the model's joint that a column speaks of; None where that is not known."""
    if model is None or found.stem == "ctrl":
        return None
    if isinstance(found.joint, str):
        if found.joint in model.joints:
            return model.joints.index(found.joint)
        return None
    first = 0 if any(r.joint == 0 for r in roles.values()) else 1
    j = 0 if found.joint is None else found.joint - first
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
    for name, found in roles.items():
        if found.stem in ("q", "target") and found.joint is not None:
            by_joint.setdefault(str(found.joint), []).append(columns[name])
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
    for name, found in roles.items():
        joint, j = found.joint, _index(found, roles, model)
        own = model.joints[j] if model is not None and j is not None else None
        goes = model is not None and own in model.slides
        scaled = found.stem != "v" and str(joint) in scales
        if found.stem not in by_stem or goes != slides or scaled:
            continue
        by_stem[found.stem][joint] = columns[name]
        names[joint] = own or str(joint or name)
        if model is None or j is None:
            continue
        if bounds := model.limits_of(j):
            limits[joint] = bounds
        if any(a.kind == "position" and a.joint == own for a in model.actuators or ()):
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
        name = next((n for n, s in TIME_UNITS.items() if step * s <= TABLE.slowest), "ns")
    if heading is None:
        if name in (None, "s"):
            return {}
        return {"time": (name, f"a row every {step:.4g}")}
    why = f"the heading says so ({heading.heading})"
    if step is not None and not TABLE.fastest <= step * heading.scale <= TABLE.slowest:
        why += (
            f", but a row every {step:.4g} "
            f"{'looks like ' + str(name) if name != heading.unit else 'looks like a larger unit'}"
        )
    elif heading.unit == "s":
        return {}
    return {"time": (heading.unit, why)}


def _lengths(
    out: Units, reported: Sequence[HeadingUnit], time: np.ndarray | None, observed: _Columns
) -> Units:
    """With the unit of sliding joints' ways, by the headings, else by their speeds, ranges,
    sizes.
    """
    if any(one.quantity == "length" and one.fits for one in reported):
        return out
    gain = None if time is None else _gain(time, observed.q, observed.v)
    own = [one.scale for one in reported if one.quantity == "velocity" and one.slides and one.fits]
    if gain is not None:  # of speeds in m/s, where no heading says otherwise
        for unit, scale in LENGTH_UNITS.items():
            if scale != 1.0 and _like(gain * (own[0] if own else 1.0), scale):
                if own:
                    speeds = {}
                else:
                    speeds = {
                        f"v_{observed.name[j]}": ("m/s", "see length")
                        for j in observed.v
                        if j in observed.q
                    }
                return out | {"length": (unit, "ways against speeds tell")} | speeds
        return out
    for joint in observed.q:
        reach, name = observed.reach(joint), observed.name[joint]
        if (limits := observed.limits.get(joint)) and (
            units := lengths_within(times_range(reach, limits))
        ):
            low, high = limits
            why = f"{name} reaches {reach:.4g}, its range in the model is {low:g} to {high:g} m"
            sure = len(units) == 1
            return out | {
                "length": (
                    units[0] if sure else Question(units[0]),
                    why if sure else f"{why}: {' or '.join(units)}?",
                )
            }
        if limits is None and reach > UNIT.long:
            return out | {
                "length": (
                    Question("mm"),
                    f"{name} reaches {reach:.4g}: if that is no metres, say so",
                )
            }
    return out


def _angles(
    out: Units,
    reported: Sequence[HeadingUnit],
    time: np.ndarray | None,
    observed: _Columns,
    lerobot: bool,
    unknown: bool,
) -> Units:
    """With the units of angles and of their speeds."""
    gain = None if time is None else _gain(time, observed.q, observed.v)
    angle = {one.scale for one in reported if one.quantity == "angle" and one.fits}
    speed = {
        one.scale for one in reported if one.quantity == "velocity" and one.fits and not one.slides
    }
    if angle or speed:
        return _by_headings(out, gain, angle, speed, observed)
    for size, (_, units) in MISTAKES.items():
        if gain is not None and "time" not in units and _like(gain, size):
            why = f"speeds are {gain:.3g} times the angles' slopes"
            return out | {key: (unit, why) for key, unit in units.items()}
    return out | _by_size(time, observed, lerobot, unknown)


def _by_headings(
    out: Units, gain: float | None, angle: set[float], speed: set[float], observed: _Columns
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
    for joint, limits in observed.limits.items():
        if joint in observed.q:
            times = times_range(observed.reach(joint), limits)
        else:
            times = 0.0
        if (
            angle == {1.0}
            and times > UNIT.hint
            and times * DEGREE <= UNIT.inside
            and "angle" in out
        ):
            unit, why = out["angle"]
            return out | {"angle": (unit, f"{why}, but {observed.reaches(joint)} rad")}
    return out


def _by_size(time: np.ndarray | None, observed: _Columns, lerobot: bool, unknown: bool) -> Units:
    """Degrees, where something beside the size backs them; a question where the size is all there
    is.

    Args:
        unknown: No model is known.
    """
    asked: Units = {}
    for joint, q in observed.q.items():
        reach = observed.reach(joint)
        if reach <= UNIT.large:
            continue
        limits = observed.limits.get(joint)
        if (
            limits
            and times_range(reach, limits) > UNIT.hint
            and times_range(reach, limits) * DEGREE <= UNIT.inside
        ):
            why = f"{observed.reaches(joint)} rad"
            return {"angle": ("deg", why)}
        turns = f"angles reach {reach:.4g}; rad, if the joint turns {reach / (2 * np.pi):.2g} times"
        fast = (
            time is not None
            and np.nanquantile(np.abs(np.gradient(q, time)), 0.99) > UNIT.swift
            and reach <= UNIT.degrees
        )
        if lerobot or (fast and (unknown or joint in observed.servos)):
            return {"angle": ("deg", turns)}
        asked = asked or {"angle": (Question("deg"), turns)}
    return asked


def _like(gain: float, scale: float) -> bool:
    return abs(np.log(gain / scale)) < UNIT.alike


def _gain(time: np.ndarray, angles: dict, speeds: dict) -> float | None:
    """Logged speed over the slope of the angle, where joints agree on it."""
    both = [(angles[joint], v) for joint, v in speeds.items() if joint in angles]
    gain = common([found for q, v in both if (found := agreement(time, q, v))])
    return gain if gain is not None and gain > 0 else None
