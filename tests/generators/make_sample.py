"""Make the sample recording that ships with the package: `python -m tests.generators.make_sample
[FOLDER]`.
"""

import sys
from pathlib import Path

from tests.generators.dataset import make_dataset
from tests.generators.recording import write_dataset

FOLDER = Path(__file__).parents[2] / "adaptsim_jax" / "logs" / "sample"
NOTE = """# Sample recording

`recording/` is made, not measured: `python -m tests.generators.make_sample` integrates a hanging double pendulum with
NumPy (code in `tests/generators`, which shares nothing with the package), adds sensor noise, and writes what a logger
would have written: 4 trials of 4 s at 200 Hz. The rig has an effect that its declared model lacks:
{effect} of {value:.3g} {unit} at {where}.
"""  # noqa: E501


def main(folder: Path = FOLDER) -> None:
    ds = make_dataset(
        9001,
        "clean",
        [("coulomb", 1, 4.0)],
        n_trials=4,
        seconds=4.0,
        rate=200.0,
        angle_zero="hanging",
    )
    write_dataset(ds, folder / "recording", digits=6)
    hidden = ds.truth["effects"][0]
    names = {"effect": "Coulomb friction", "where": "joint 1", "unit": hidden["unit"]}
    (folder / "README.md").write_text(NOTE.format(value=hidden["parameters"]["size"], **names))


if __name__ == "__main__":
    main(*(Path(a) for a in sys.argv[1:2]))
