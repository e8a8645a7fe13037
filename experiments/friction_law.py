"""Whether recordings show dry friction that gives, as MuJoCo's, or sharp friction, as of real
joints.

    python experiments/friction_law.py ../shared/data/measured_panda/rec \\
        ../shared/data/measured_furuta/rec OUT/*_3900

FOLDERS: recordings of mechanisms. Of each the share that the giving law takes off what the sharp
one leaves of the missing torque of left-out blocks, by joint (below zero: it tells less), the p of
it, and which law is taken.
"""

import argparse
from pathlib import Path

import numpy as np

from adaptsim_jax.attribution.equation.balance import balances
from adaptsim_jax.attribution.equation.confirmed import without_bodies
from adaptsim_jax.attribution.equation.models import part_of, within
from adaptsim_jax.attribution.equation.rubbing import gains, given, giving, rubbing
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.posed import declared_vector
from adaptsim_jax.attribution.problem import held, own_inertia, scaled_reach
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.testing import sign_flip
from adaptsim_jax.effects.joints.catalogue import MACHINE


def shown(folder: Path) -> str:
    """A line of a recording."""
    machine = load(folder, None)
    problem = machine.problem(MACHINE)
    null = declared_vector(machine, problem)
    reach = scaled_reach(problem, *own_inertia(problem, null))
    told, soft = balances(problem, machine.tracks), giving(problem, machine.tree)

    def part(b):
        return within(part_of(without_bodies(null) if np.any(held(machine.actuator)) else null, b))

    how = reach, Criteria(), machine.log.input_kind != "torque"
    joints = [z for b in told for z in gains(problem, soft, b, given(b, soft), part(b), *how).T]
    gives = rubbing(problem, machine.tree, told, part, *how)[0] is not problem
    each = ", ".join(
        f"{100 * (1.0 - np.exp(-z.mean())):.0f} % (p {sign_flip(z):.4f})" for z in joints
    )
    return f"{folder.parent.name}/{folder.name}: {'gives' if gives else 'sharp'}; {each}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    for folder in parser.parse_args().folders:
        print(shown(folder), flush=True)


if __name__ == "__main__":
    main()
