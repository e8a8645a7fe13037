"""The sentences of a diagnosis: what each verdict means, what it leaves open, what to do next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.config import read
from adaptsim_jax.diagnosis.criteria import REPORT
from adaptsim_jax.effects.registry import of_joints
from adaptsim_jax.report import diagnosis_format as fmt

VERDICTS = read(Path(__file__).with_name("verdicts.toml"))
"""Of each verdict: tone, label, meaning, next."""
BASE = {
    "p1": "inertia about joint 1, I1 + m1 lc1² + I2 + m2 (l1² + lc2²)",
    "p3": "inertia about joint 2, I2 + m2 lc2²",
    "h1": "first moment, m1 lc1 + m2 l1",
    "h2": "first moment, m2 lc2",
    "b1": "damping of joint 1",
    "b2": "damping of joint 2",
}
"""Of a double pendulum, the combinations that a motion fixes (rotors' inertias belong to them as
well).
"""
MANY = 8  # names in one sentence: more are listed elsewhere in the page
LOUD = 4.0  # times the sensors' noise: from here on a reader asks what the rest is


@cache
def proper_words() -> dict[str, str]:
    """Names of people in those of effects, which keep their capitals."""
    words = (word for e in of_joints().values() for word in e.title.split())
    return {"lugre": "LuGre", "dahl": "Dahl"} | {w.lower(): w for w in words if w[:1].isupper()}


def plain(name: str) -> str:
    """`command_delay` -> `command delay`; `coulomb` -> `Coulomb friction`; `joint1` -> `joint
    1`.
    """
    effect = of_joints().get(name)
    if effect is not None and effect.title:
        return effect.title
    text = " ".join(proper_words().get(word, word) for word in name.replace("_", " ").split())
    if text.startswith(("joint", "link", "body")) and text[-1:].isdigit() and " " not in text:
        stem = text.rstrip("0123456789")
        return f"{stem} {text[len(stem) :]}"
    return text


def effect_name(effect: Mapping) -> str:
    """`Coulomb friction at joint 1`; a class as `bias or spring at joint 1`, or `bias at joint 1 or
    tilt at base`.
    """
    names = [effect["name"], *(effect.get("alternatives") or [])]
    names_and_places = [name_and_place(name, effect["where"]) for name in names]
    if len({where for _, where in names_and_places}) == 1:
        return _at(
            fmt.listing([plain(name) for name, _ in names_and_places], "or"), effect["where"]
        )
    return fmt.listing([_at(plain(name), where) for name, where in names_and_places], "or")


def name_and_place(alternative: str, where: str) -> tuple[str, str]:
    """Name and place of `name@where`, or of `name at where`; a name alone is at `where`."""
    for between in ("@", " at "):
        name, _, place = alternative.partition(between)
        if place:
            return name, place
    return alternative, where


def effect_of(candidate: str) -> str:
    """The effect of `name@where` or `name at where`, in words."""
    return plain(name_and_place(candidate, "")[0])


NOWHERE = ("", "all", "whole", "command", "contact", "force", "measurement")
"""What `where` says that is no part of a machine."""


def _at(text: str, where: str) -> str:
    place = plain(where)
    if place in NOWHERE:
        return text
    return f"{text} at {place}"


def effect_names(report: Mapping) -> str:
    """All that were found, in one phrase."""
    names = [effect_name(effect) for effect in report["effects"]]
    if len(names) > 1 and any(effect.get("alternatives") for effect in report["effects"]):
        return "; ".join(f"({k}) {name}" for k, name in enumerate(names, 1))
    return fmt.listing(names)


def headline(report: Mapping) -> str:
    """The verdict in a sentence, and in another that trials differ, where they do."""
    differ = (report.get("trials") or {}).get("headline")
    words = _verdict(report)
    if differ:
        words = f"{words} But {differ}."
    for caveat in (worse_files(report), unpredicted(report)):
        if caveat:
            words = f"{words} But {caveat}."
    return words


def worse_files(report: Mapping) -> str:
    """Say which written files simulate a joint worse than the declared one.

    Names the joint at which each is worst, and by how much. Empty where none does.
    """
    parts = []
    for name, rows in _worse(report).items():
        if rows:
            row = rows[0]
            after = fmt.quantity(row["after"], row["unit"])
            before = fmt.quantity(row["before"], row["unit"])
            others = f" and {len(rows) - 1} more" if len(rows) > 1 else ""
            parts.append(
                f"{name} simulates {plain(row['joint'])}{others} worse than the declared file: "
                f"{after} for {before} over {row['over']}"
            )
    return "; ".join(parts)


def _worse(report: Mapping) -> dict[str, list[Mapping]]:
    """Return by file the rows of joints that it simulates worse than the declared, worst first."""
    files = report.get("files") or {}
    return {name: [row for row in rows if row["worse"]] for name, rows in files.items()}


def unpredicted(report: Mapping) -> str:
    """Say that a straight line simulates most joints better than any file, and at how many.

    Empty where files do better, or none was run.
    """
    rows = [row for file_rows in (report.get("files") or {}).values() for row in file_rows]
    joints = {row["joint"] for row in rows}
    predicted = {row["joint"] for row in rows if min(row["before"], row["after"]) < row["nothing"]}
    if 2 * len(predicted) >= len(joints):
        return ""
    return (
        f"a straight line simulates {len(joints - predicted)} of {len(joints)} joints better than "
        "any file, the declared one too"
    )


def _files(report: Mapping) -> str:
    """Say what to take the files for where one is worse than the declared one, or none simulates.

    Empty otherwise.
    """
    if caveat := unpredicted(report):
        return (
            f"Do not simulate these motions by any file: {caveat}. The mended model is good for "
            "the torque along a motion, and in closed loop with the robot's own controller."
        )
    usable, worse = recommended(report), worse_files(report)
    if len(usable) == len(report.get("files") or {}):
        return ""
    if not usable:
        return f"Keep the declared file for simulation: {worse}. Look where the rest sits."
    return f"Simulate with {fmt.listing(usable)} alone: {worse or _behind(report, usable[0])}."


def _behind(report: Mapping, best: str) -> str:
    """Say where a file that is no worse than the declared one is farthest behind the best."""
    files = report["files"]
    pairs = [
        (name, row, best_row)
        for name in files
        for row, best_row in zip(_in_order(files[name]), _in_order(files[best]), strict=True)
    ]
    name, row, best_row = max(pairs, key=lambda pair: pair[1]["after"] / pair[2]["after"])
    after, best_error = (fmt.quantity(z["after"], row["unit"]) for z in (row, best_row))
    place = f"{plain(row['joint'])} over {row['over']}"
    return f"{name} leaves {after} at {place}, where it leaves {best_error}"


def recommended(report: Mapping) -> list[str]:
    """Files that simulate no joint worse than the declared one, nor than that of them which leaves
    least of all joints.
    """
    files, worse = report.get("files") or {}, _worse(report)
    not_worse = [name for name in files if not worse[name]]
    errors = {name: [row["after"] for row in _in_order(files[name])] for name in not_worse}
    if len(not_worse) < 2 or not all(errors.values()):
        return not_worse
    best = np.array(min(errors.values(), key=lambda z: np.sum(np.log(z))))
    return [name for name in not_worse if np.all(np.array(errors[name]) <= REPORT.slack * best)]


def _in_order(rows: Sequence[Mapping]) -> list[Mapping]:
    return sorted(rows, key=lambda row: (row["over"], row["joint"]))


def _verdict(report: Mapping) -> str:
    verdict, names, caveat = report["verdict"], effect_names(report), _error_caveat(report["error"])
    if verdict == "explained":
        return f"The declared model lacks {names}{caveat}."
    if verdict == "explained_class":
        if names:
            return f"The declared model lacks {names}; these trials cannot tell which{caveat}."
        return ""
    if verdict == "partly_explained":
        return f"The declared model lacks {names}, and something more that has no name."
    if verdict == "structured_unattributed":
        if names:
            opening = f"{names[:1].upper()}{names[1:]} found, and"
        else:
            opening = "The declared model leaves structure:"
        if names:
            return f"{opening} something more that no candidate explains."
        return f"{opening} no candidate explains it."
    return {
        "within_noise": _nothing_more(report),
        "data_fault": "The data must be mended before a model can be judged.",
    }[verdict]


def _error_caveat(error: Mapping) -> str:
    """A caveat where what a named effect leaves is many times the noise: its size may then be off
    by more than its interval.
    """
    after, floor = error.get("after"), error.get("noise_floor")
    if after is None or not floor or after < LOUD * floor:
        return ""
    return f", yet {after / floor:.0f} times the sensors' noise is left: its size is not sure"


def _nothing_more(report: Mapping) -> str:
    """`within_noise` in a sentence: a torque that wanders by chance may leave many times what the
    sensors do.
    """
    before, floor = report["error"].get("before"), report["error"].get("noise_floor")
    if before is None or not floor or before < LOUD * floor:
        if report.get("unlike_file"):
            unlike = ", with fitted values unlike its file's,"
        else:
            unlike = ""
        return f"The declared model{unlike} explains these data to within the noise."
    return (
        f"The declared model leaves {before / floor:.0f} times the sensors' noise, and nothing in "
        "it but chance was found."
    )


def status(candidate: Mapping, report: Mapping) -> str:
    """The given status of a candidate, else what its flags say."""
    if candidate.get("status"):
        return candidate["status"]
    if candidate["accepted"]:
        return "accepted"
    own_name_and_place = name_and_place(candidate["name"], candidate["where"])
    if any(
        own_name_and_place == name_and_place(a, e["where"])
        for e in report["effects"]
        for a in e.get("alternatives") or []
    ):
        return "look-alike"
    return "rejected"


def improvement(error: Mapping) -> dict[str, str | None]:
    """How much of the error went, and how much of what could go (down to the noise floor)."""
    before, after, floor = error.get("before"), error.get("after"), error.get("noise_floor")
    if before is None or after is None or before <= 0 or after == before:
        return {"change": None, "closed": None}
    change = (before - after) / before
    words = f"{fmt.percent(abs(change))} {'less' if change > 0 else 'more'}"
    closed = None
    if floor is not None and before > floor and change > 0:
        closed = fmt.percent(min(1.0, (before - after) / (before - floor)))
    return {"change": words, "closed": closed}


def not_established(report: Mapping) -> list[str]:
    """What must not be taken for granted: the report's own sentences, then what its numbers
    imply.
    """
    lines = list(report.get("not_established") or [])
    for effect in report["effects"]:
        if effect.get("alternatives"):
            lines.append(f"Which it is: {effect_name(effect)}.")
    unidentified_names = unidentified(report)
    if unidentified_names and not any(
        line.startswith(", ".join(unidentified_names)) for line in lines
    ):
        is_one = len(unidentified_names) == 1
        if len(unidentified_names) <= MANY:
            listed = fmt.listing(unidentified_names)
        else:
            listed = f"{len(unidentified_names)} numbers listed under Declared parameters"
        lines.append(
            f"The value{'' if is_one else 's'} of {listed}: these motions show only "
            f"{'a combination of it with others' if is_one else 'combinations of them'}."
        )
    if report["verdict"] in (
        "explained",
        "explained_class",
        "partly_explained",
        "within_noise",
        "structured_unattributed",
    ):
        lines.append(
            "Anything outside the speeds, angles, loads and frequencies of these trials, or on "
            "another rig."
        )
    if report["verdict"] == "within_noise":
        lines.append("That no effect exists: only that none shows above the noise here.")
    return list(dict.fromkeys(lines))


def unidentified(report: Mapping) -> list[str]:
    """Declared parameters that the data do not fix, in the fit that counts (after, else before)."""
    table = report["declared"]["after"] or report["declared"]["before"]
    return [name for name, row in table.items() if not row["identifiable"]]


def todo(report: Mapping) -> str:
    """What to do now; it points to the next experiment where there is one."""
    next_experiment = report.get("next_experiment")
    has_no_next = report["verdict"] in ("within_noise", "data_fault")
    if report["effects"] and (skill := _skill(report)) < REPORT.useful_skill:
        return (
            f"Do not rely on the mended model yet: at best it is {100 * max(skill, 0.0):.0f} % "
            "better than what needs no model. Look where the rest sits."
        )
    if files := _files(report):
        return files
    if report["verdict"] == "within_noise" and not report["declared"]["after"]:
        return "Add no effect, and keep the file's values: nothing was fitted."
    return VERDICTS[report["verdict"]]["next"] + (
        " See the next experiment below." if next_experiment and not has_no_next else ""
    )


def next_words(report: Mapping) -> str:
    """What the next experiment is for; empty where there is none."""
    experiment: Any = report.get("next_experiment") or ""
    if isinstance(experiment, Mapping):
        return experiment["message"]
    return experiment


def _skill(report: Mapping) -> float:
    """Return the mended model's skill by the yardstick that favours it most, or 1."""
    skills = [row["skill"] for row in (report.get("yardsticks") or {}).get("mended", {}).values()]
    return max((z for z in skills if z is not None and z == z), default=1.0)
