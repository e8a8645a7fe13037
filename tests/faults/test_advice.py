"""What readers advise is done, word for word, and the log is read on: every line that proposes a
change of meta.toml or of a file.
"""

import re
from dataclasses import dataclass

import numpy as np
import pytest

from adaptsim_jax.attribution.conventions import check_conventions
from adaptsim_jax.attribution.load import load
from adaptsim_jax.core.errors import BadInput
from tests.faults.servo_files import model, sines, swung
from tests.faults.test_clocks_told import ARM, NAMES
from tests.logs.arm_files import arm
from tests.logs.log_files import folder

LEGS = ("left", "right")
RATE = 100.0
U = [sines(k, 120, RATE, 2) for k in range(2)]
Q = [swung(u, RATE) for u in U]
V = [np.gradient(q, 1.0 / RATE, axis=0) for q in Q]


def legs(k, stems=("q", "target")):
    has = {"q": Q[k], "v": V[k], "target": U[k], "tau": U[k] - Q[k]}
    return {"time": np.arange(120) / RATE} | {
        f"{s}_{n}": has[s][:, j] for s in stems for j, n in enumerate(LEGS)
    }


def without(*names):
    return lambda c: {name: x for name, x in c.items() if name not in names}


def renamed(**names):
    return lambda c: {names.get(name, name): x for name, x in c.items()}


def added(**columns):
    return lambda c: c | {name: c[of] for name, of in columns.items()}


def scaled(size, *stems):
    return lambda c: {name: x * size if name.split("_")[0] in stems else x for name, x in c.items()}


@dataclass(frozen=True)
class Told:
    """spoil: of a trial's columns (of the last alone where `last`); says: what is told, with the
        `line` and the `table` (else the top) of meta.toml that it proposes; fill: what a person
        puts for its capitals; meta: what stands there before; xml: the model's text;
    stems: columns of a trial; held: joints that the mended log lacks.
    """

    spoil: object
    says: str
    table: str = ""
    meta: str = ""
    fill: tuple = ()
    stems: tuple = ("q", "target")
    last: bool = False
    xml: str = model(LEGS)
    held: tuple = ()


MOTORS = model(LEGS, kind="motor")
ONE = model(LEGS, ("left",))
CASES = {
    "an angle in some trials": Told(
        without("q_right"), "right = 0.0", "hold", last=True, held=("right",)
    ),
    "two columns of a joint": Told(added(q2="q_right"), r"ignore = \['q\w+'\]"),
    "a strange joint": Told(added(q_wheel="q_right"), r'ignore = \["wheel"\]'),
    "a misspelt joint": Told(
        renamed(q_right="q_rigth"),
        "rename it by .columns.",
        "columns",
        fill=("rename it by [columns]", 'q_right = "q_rigth"'),
    ),
    "a number beyond": Told(added(q3="q_right"), r'ignore = \["q3"\]'),
    "no actuator of that name": Told(added(ctrl_wheel="q_right"), r'ignore = \["ctrl_wheel"\]'),
    "no actuator of that number": Told(added(ctrl3="q_right"), r'ignore = \["ctrl3"\]'),
    "no clock": Told(renamed(time="zeit"), r'time = "..."', "columns", fill=("...", "zeit")),
    "another name of the clock": Told(
        renamed(time="zeit"),
        "did you mean 'zeit'",
        "columns",
        meta='[columns]\ntime = "zeti"\n',
        fill=("did you mean 'zeit'", 'time = "zeit"'),
    ),
    "no command of a joint": Told(without("target_right"), "right = 0.0", "hold", held=("right",)),
    "a command that holds nothing": Told(
        lambda c: c | {"target_right": np.full(120, np.nan)}, "right = 0.0", "hold", held=("right",)
    ),
    "a target without a servo": Told(without(), r'ignore = \["target\w+"\]', xml=ONE),
    "a target without a servo, by number": Told(
        renamed(target_left="target1", target_right="target2", q_left="q1", q_right="q2"),
        r'ignore = \["target\w+"\]',
        xml=ONE,
    ),
    "inputs in some trials": Told(
        without("target_left", "target_right"), 'input = "none"', last=True
    ),
    "a trial without inputs": Told(
        without("target_left", "target_right"),
        ".trials. exclude",
        "trials",
        last=True,
        fill=("[trials] exclude", 'exclude = ["run_1"]'),
    ),
    "no column of the input": Told(
        renamed(target_left="a", target_right="b"),
        "or name it by .columns.",
        "columns",
        'input = "command"\n',
        ("or name it by [columns]", 'target1 = "a"\ntarget2 = "b"'),
    ),
    "motors that were off": Told(without(), 'input = "none"', stems=("q",), xml=MOTORS),
    "two inputs": Told(without(), 'input = "command"', stems=("q", "tau", "target")),
    "milliseconds": Told(scaled(1e3, "time"), 'time = "ms"', "units"),
    "microseconds": Told(scaled(1e6, "time"), 'time = "us"', "units"),
    "another unit of time": Told(
        scaled(1e3, "time"),
        "write the unit that the file has under .units.",
        "units",
        '[units]\ntime = "ns"\n',
        ("write the unit that the file has under [units]", 'time = "ms"'),
    ),
    "speeds in degrees": Told(
        scaled(180 / np.pi, "v"), 'velocity = "deg/s"', "units", stems=("q", "v", "target")
    ),
    "speeds by the minute": Told(
        scaled(30 / np.pi, "v"), 'velocity = "rpm"', "units", stems=("q", "v", "target")
    ),
    "speeds by the millisecond": Told(
        scaled(1e-3, "v"), 'velocity = "rad/ms"', "units", stems=("q", "v", "target")
    ),
    "angles in degrees, speeds not": Told(
        scaled(180 / np.pi, "q", "target"),
        'angle = "deg" and velocity = "rad/s"',
        "units",
        stems=("q", "v", "target"),
        fill=(" and ", "\n"),
    ),
    "all in degrees": Told(scaled(180 / np.pi, "q", "target"), 'angle = "deg"', "units"),
    "per cent of no range": Told(
        lambda c: c | {n: 100 * (c[n] + 2) / 4 for n in ("q_right", "target_right")},
        r"q_right = {percent = \[LOW, HIGH\]}",
        "units",
        '[units]\nq_right = "percent"\n',
        ("LOW, HIGH", "-2, 2"),
    ),
    "what is left out may be it": Told(
        renamed(q_right="q_wheel"),
        "name it by .columns.",
        "columns",
        'ignore = ["wheel", "target_right"]\n',
        ("name it by [columns]", 'q_right = "q_wheel"'),
        held=(),
        xml=ONE,
    ),
    "too few rows": Told(
        lambda c: {n: x[:9] for n, x in c.items()},
        "leave this file out",
        "trials",
        last=True,
        fill=("leave this file out", 'exclude = ["run_1"]'),
    ),
}


def with_line(meta: str, table: str, line: str) -> str:
    """meta.toml with a line more, or in place of that of its key."""
    key = line.split(" = ")[0]
    kept = [old for old in meta.splitlines() if old.split(" = ")[0] != key]
    if not table:
        return "\n".join([line, *kept, ""])
    head = [f"[{table}]"] if f"[{table}]" not in kept else []
    at = kept.index(f"[{table}]") + 1 if not head else len(kept)
    return "\n".join([*kept[:at], *head, line, *kept[at:], ""])


def said(data):
    """What is said of a folder, and its machine, if there is one."""
    try:
        machine = load(data)
        found = check_conventions(machine)
    except BadInput as error:
        return str(error), None
    return "\n".join([*machine.log.notes, *(f.message for f in found)]), machine


@pytest.mark.parametrize("name", CASES)
def test_the_line_that_is_proposed_is_written_and_the_log_reads(tmp_path, name):
    case = CASES[name]

    def put(path, meta):
        trials = [legs(k, case.stems) for k in range(2)]
        trials = [case.spoil(c) if k or not case.last else c for k, c in enumerate(trials)]
        data = folder(
            path, f'model = "robot.xml"\n{meta}', **{f"run_{k}": c for k, c in enumerate(trials)}
        )
        (path / "robot.xml").write_text(case.xml)
        return data

    told, _ = said(put(tmp_path / "a", case.meta))
    found = re.search(case.says, told)
    assert found, told
    line = found[0].replace(*case.fill) if case.fill else found[0]
    told, machine = said(put(tmp_path / "b", with_line(case.meta, case.table, line)))
    assert machine is not None, told
    assert not re.search(case.says, told) or "may be" in name
    kept = [n for n in LEGS if n not in case.held]
    assert list(machine.log.joint_names) == kept
    for track, q in zip(machine.tracks, Q, strict=False):
        np.testing.assert_allclose(track.q, q[:, [LEGS.index(n) for n in kept]], atol=1e-9)


def turned(*stems):
    return lambda c: c | {f"{s}2": -c[f"{s}2"] for s in stems}


def shifted(rows):
    def moved(x):
        return np.r_[[x[0]] * rows, x[:-rows]] if rows > 0 else np.r_[x[-rows:], [x[-1]] * -rows]

    return lambda c: c | {k: moved(c[k]) for k in ("tau1", "tau2")}


def absolute(c, sign=1):
    return c | {s + "2": c[s + "2"] + sign * c[s + "1"] for s in ("q", "v")}


def swap(*stems):
    def both(k):
        return k[:-1] + {"1": "2", "2": "1"}[k[-1]] if k[:-1] in stems else k

    return lambda c: {k: c[both(k)] for k in c}


def times(size, *names):
    return lambda c: {k: x * size if k in names else x for k, x in c.items()}


TURNS = {
    "counted the other way": (turned("q", "v", "tau"), 'reversed = ["joint1"]', "angles"),
    "absolute": (absolute, 'convention = {joint2 = "absolute"}', "angles"),
    "one torque in mN m": (times(1e3, "tau2"), 'tau_joint2 = "mNm"', "units"),
    "all torques in mN m": (times(1e3, "tau1", "tau2"), "the torques' unit under [units]", "units"),
    "one angle in degrees": (times(180 / np.pi, "q2", "v2"), 'q_joint2 = "deg"', "units"),
    "one angle in turns": (times(0.5 / np.pi, "q2", "v2"), 'q_joint2 = "rev"', "units"),
    "joints exchanged": (
        swap("q", "v", "tau"),
        "their names in the header or under [columns]",
        "columns",
    ),
    "torques exchanged": (swap("tau"), "exchange columns tau_joint1 and tau_joint2", swap("tau")),
    "angles exchanged": (
        swap("q", "v"),
        "exchange columns q_joint1 and q_joint2, and so v_joint1 and v_joint2",
        swap("q", "v"),
    ),
    "one torque turned": (turned("tau"), "turn the sign of column tau_joint2", turned("tau")),
    "all torques turned": (
        times(-1, "tau1", "tau2"),
        "turn the sign of columns tau_joint1, tau_joint2",
        times(-1, "tau1", "tau2"),
    ),
    "zero of an angle": (
        lambda c: c | {"q2": c["q2"] - np.pi},
        "add 3.1416 rad to column q_joint2",
        lambda c: c | {"q2": c["q2"] + np.pi},
    ),
    "torques late": (shifted(3), "move the input columns up by 3 rows", shifted(-3)),
}
LINES = {
    "the torques' unit under [units]": 'torque = "mNm"',
    "their names in the header or under [columns]": "\n".join(
        f'{s}_joint{j} = "{s}_joint{3 - j}"' for s in ("q", "v", "tau") for j in (1, 2)
    ),
}


@pytest.mark.parametrize("name", TURNS)
def test_what_contradicts_the_motion_is_mended_as_it_is_told(tmp_path, name):
    spoil, says, mend = TURNS[name]

    def put(path, change, meta=""):
        def columns(c):
            return {"time": c["time"]} | {
                f"{s}_{n}": c[f"{s}{j + 1}"] for s in ("q", "v", "tau") for j, n in enumerate(NAMES)
            }

        spoiled = [columns(change(spoil(c))) for c in arm(4)]
        data = folder(
            path, f'model = "robot.xml"\n{meta}', **{f"run_{k}": c for k, c in enumerate(spoiled)}
        )
        (path / "robot.xml").write_text(ARM)
        return data

    def as_it_is(c):
        return c

    told, _ = said(put(tmp_path / "a", as_it_is))
    assert says in told, told
    if callable(mend):
        told, machine = said(put(tmp_path / "b", mend))
    else:
        told, machine = said(
            put(tmp_path / "b", as_it_is, with_line("", mend, LINES.get(says, says)))
        )
    assert machine is not None, told
    for track, c in zip(machine.tracks, arm(4), strict=True):
        if "zero" not in name:  # of a machine that has a mirror image either joint may be turned
            side = -1.0 if "counted" in name else 1.0
            np.testing.assert_allclose(side * track.q, np.stack([c["q1"], c["q2"]], 1), atol=1e-6)
    assert check_conventions(machine) == ()
