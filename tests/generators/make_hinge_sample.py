"""Make the sample of one hinge that the tour diagnoses: `python -m
tests.generators.make_hinge_sample [FOLDER]`.
"""

import sys
from pathlib import Path

from tests.attribution.pendulum import record

FOLDER = Path(__file__).parents[2] / "adaptsim_jax" / "attribution" / "sample"
FRICTION = 0.15  # N m
NOTE = """# Sample of one hinge

`recording/` is made, not measured: `python -m tests.generators.make_hinge_sample` simulates a rod on a motor with MuJoCo's C engine,
which shares nothing with the package, adds sensor noise, and writes what a logger would have written: 6 trials of 4 s at 250 Hz.
The rod weighs 1.0 kg and rubs at its hinge with {friction:g} N m of dry friction; `model.xml` says 1.2 kg and no dry friction.
"""  # noqa: E501


def main(folder: Path = FOLDER) -> None:
    record(folder / "recording", friction=FRICTION, digits=6)
    (folder / "README.md").write_text(NOTE.format(friction=FRICTION))


if __name__ == "__main__":
    main(*(Path(a) for a in sys.argv[1:2]))
