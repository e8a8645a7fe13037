"""A dozen recordings and what is said of them: a change of structure leaves names, verdicts and numbers as they are.

Where a rule is changed on purpose, `python -m tests.sysid.test_golden` writes `golden.json` anew, and its difference is reviewed.
"""

import json
import sys
import tempfile
from pathlib import Path

import pytest

from adaptsim_jax.commands.diagnose import diagnose
from tests.generators import Spec, make_datasets, write_dataset

GOLDEN = Path(__file__).with_name("golden.json")
SHORT = {"n_trials": 4, "seconds": 3.0}
LINEAR = SHORT | {"world": "linearized"}

CASES = {
    "null": Spec(401, **SHORT),
    "null_linearized": Spec(402, **LINEAR),
    "null_closed_loop": Spec(403, "closed_loop", **SHORT),
    "coulomb": Spec(404, effects=(("coulomb", 2, 4.0),), **LINEAR),
    "spring": Spec(405, effects=(("spring", 1, 4.0),), **SHORT),
    "delay": Spec(406, effects=(("delay", 1, 4.0),), **LINEAR),
    "closed_loop": Spec(407, "closed_loop", (("bias", 2, 4.0),), **SHORT),
    "small": Spec(408, effects=(("quadratic_drag", 2, 0.02),), **LINEAR),
    "outside": Spec(409, effects=(("coulomb", 1, 5.0),), **LINEAR),
    "wrong_mass": Spec(301, n_trials=4, seconds=4.0, world="linearized"),
    "wrong_length": Spec(410, "low_noise", **SHORT),
}


def folder_of(name: str, into: Path) -> tuple[Path, list[str]]:
    """The recording of a case, and what is left out of the catalogue."""
    (data,) = make_datasets([CASES[name]])
    folder = Path(write_dataset(data, into / name))
    meta = folder / "meta.toml"
    if name == "wrong_mass":
        meta.write_text(meta.read_text() + f"\n[known]\nm2 = {1.2 * data.truth['declared']['m2']}\n")
    if name == "wrong_length":
        lines = meta.read_text().splitlines()
        wrong = [f"l1 = {1.02 * float(x.split('=')[1])}" if x.startswith("l1 ") else x for x in lines]
        assert wrong != lines
        meta.write_text("\n".join([*wrong, ""]))
    return folder, ["coulomb", "stribeck", "presliding", "load_friction"] if name == "outside" else []


def said(name: str, into: Path) -> dict:
    """Verdict, names with their values, and errors, of which four digits count."""
    folder, exclude = folder_of(name, into)
    report = diagnose(folder, exclude=exclude, follow_up=False, strict=True)
    digits = lambda x: float(f"{x:.4g}")
    return {
        "verdict": report["verdict"],
        "message": report["message"],
        "effects": [
            {"name": e["name"], "where": e["where"], "alternatives": sorted(map(str, e["alternatives"]))}
            | {k: digits(p["value"]) for k, p in e["parameters"].items()}
            for e in report["effects"]
        ],
        "error": {k: digits(report["error"][k]) for k in ("before", "after", "noise_floor")},
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_names_verdicts_and_numbers_are_as_they_were(name, tmp_path):
    expected, now = json.loads(GOLDEN.read_text())[name], said(name, tmp_path)
    assert (now["verdict"], len(now["effects"])) == (expected["verdict"], len(expected["effects"]))
    for one, other in zip(now["effects"], expected["effects"], strict=True):
        assert {k: v for k, v in one.items() if not isinstance(v, float)} == {
            k: v for k, v in other.items() if not isinstance(v, float)
        }
        assert [v for v in one.values() if isinstance(v, float)] == pytest.approx(
            [v for v in other.values() if isinstance(v, float)], rel=1e-3
        )
    assert now["error"] == pytest.approx(expected["error"], rel=1e-3)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        found = {name: said(name, Path(folder)) for name in sys.argv[1:] or CASES}
    GOLDEN.write_text(json.dumps((json.loads(GOLDEN.read_text()) if GOLDEN.exists() else {}) | found, indent=1) + "\n")
