"""Where each method of diagnosis lives, once: what is searched for is how a second one would look."""  # noqa: E501

import re
from pathlib import Path

import pytest

import adaptsim_jax

PACKAGE = Path(adaptsim_jax.__file__).parent
# rooms that learn or plan have steps of their own, of policies
ROOMS = (
    "attribution",
    "diagnosis",
    "logs",
    "mechanisms/quaternions.py",
    "simulators",
    "tasks/toss",
    "tasks/trial_record.py",
)
FILES = [
    f
    for room in ROOMS
    for f in ([PACKAGE / room] if room.endswith(".py") else sorted((PACKAGE / room).rglob("*.py")))
]
METHODS = {
    "sign-flip test": ("diagnosis/testing.py", r"\[-1\.0, 1\.0\]|2\*\*count"),
    "logarithms of losses": ("diagnosis/testing.py", r"np\.log\(\(\w+ \+ usual\)"),
    "level of few blocks": ("diagnosis/testing.py", r"2\.0 ?\*\* ?-"),
    "false discovery": ("diagnosis/testing.py", r"np\.arange\(1, len\(\w+\) \+ 1\) / "),
    "jackknife": (
        "diagnosis/testing.py",
        r"\(\(?\w+(\(\w+\))? - 1\) / \w+(\(\w+\))? \* np\.square",
    ),
    "score test": ("diagnosis/testing.py", r"stats\.(t|f|chi2)\.sf"),
    "bounded step": ("diagnosis/steps.py", r"\w+ = \w+ & \(\((step|out) < (low|floor)\)"),
    "loop of damped steps": ("diagnosis/steps.py", r"damping = max\(|damping \*= "),
    "loop of starts": ("diagnosis/steps.py", r"rest = .*~good"),
    "search for effects": (
        "diagnosis/search.py",
        r'Step\("added", (best|better|score)|while len\((\w+\.)?added\) <',
    ),
    "pieces of trials": ("diagnosis/folds.py", r"in np\.array_split\(mine"),
    "stretches cut": ("logs/stretch_rows.py", r"inside\[-1\]\) \+ 1|max\(5\.0 \* dt"),
    "mean of a held command": ("attribution/stretches.py", r"np\.cumsum\(u\[:-1\] \*"),
    "rows of candidates": ("diagnosis/report.py", r'"status": status'),
    "interval of an error": (
        "diagnosis/testing.py",
        r"np\.median\(errors\[unit == |for d in draws",
    ),
    "standard errors of an interval": ("diagnosis/testing.py", r"stats\.t\.isf|1\.64[0-9]*\b"),
    "straight line through a stretch": (
        "diagnosis/straight.py",
        r"count \* total\(|t \* t \* mask",
    ),
    "noise by differences": (
        "logs/noise.py",
        r"np\.diff\([^()]+, (3|order)[,)]|0\.6745",
    ),
    "rotation vector": ("mechanisms/quaternions.py", r"np\.arctan2\(size, |mju_subQuat"),
}


@pytest.mark.parametrize("method", METHODS)
def test_a_method_lives_in_one_file(method):
    home, looks = METHODS[method]
    found = {str(f.relative_to(PACKAGE)) for f in FILES if re.search(looks, f.read_text())}
    assert found == {home}
