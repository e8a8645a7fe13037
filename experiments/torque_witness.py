"""The torque along the measured motion as a witness: what it names on one recording, and what of
the torque it misses on others.

    python experiments/torque_witness.py ../shared/data/measured_panda/rec --judge \\
        ../shared/data/measured_panda/val
    python experiments/torque_witness.py ../shared/data/measured_kr300/rec --leave-out

--leave-out: each trial in turn takes no part and is the judge. Seconds are of the processor,
without reading.
"""

import argparse
import time

import numpy as np

from adaptsim_jax.attribution.equation.balance import balances, residual
from adaptsim_jax.attribution.equation.models import search_balances
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.parameters import INERTIA, Vector
from adaptsim_jax.attribution.posed import declared_vector, factor_of
from adaptsim_jax.attribution.problem import own_inertia, scaled_reach
from adaptsim_jax.attribution.sentences import place
from adaptsim_jax.core import process
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.joints.catalogue import MACHINE


def prepared(machine: Machine):
    problem = machine.problem(MACHINE)
    return problem, balances(problem, machine.tracks)


def examined(machine: Machine, judge: Machine) -> None:
    """Print names, sizes and what is missing, of a machine's recording and of another."""
    began = time.process_time()
    problem, told = prepared(machine)
    null = declared_vector(machine, problem)
    reach = scaled_reach(problem, *own_inertia(problem, null))
    commanded = machine.log.input_kind != "torque"
    found = search_balances(
        problem, told, null, reach, Criteria(), commanded, factor_of(machine.log.meta)
    )
    print(
        f"{machine.log.path}: {[t.name for t in machine.tracks]}, "
        f"{time.process_time() - began:.0f} s"
    )
    for n in found.named:
        own = [
            (e.name, z, s)
            for e, z, s in zip(found.final.entries, found.final.values, found.errors, strict=True)
            if e.owner == n.candidate.effect and set(e.joints) <= set(n.candidate.joints)
        ]
        size = ", ".join(f"{name} {z:.4g} +- {s:.2g}" for name, z, s in own)
        print(
            f"  {n.candidate.effect} at {place(problem, n.candidate)}: {size}; gain "
            f"{n.test.gain:.2f}, p {n.test.p:.2g}"
        )
    print(
        "  damping",
        np.round(
            [
                z
                for e, z in zip(found.final.entries, found.final.values, strict=True)
                if e.owner == "viscous"
            ],
            4,
        ),
    )
    eta = [
        abs(z)
        for e, z in zip(found.final.entries, found.final.values, strict=True)
        if e.owner == INERTIA
    ]
    print(f"  farthest inertial coordinate {max(eta, default=0.0):.2f} (bound 0.55)")
    other, there = prepared(judge)
    shares = []
    for b in there:

        def root(z):
            return np.sqrt(np.mean(np.square(z), 0))

        shares.append(
            root(residual(other, b, found.final))
            / root(residual(other, b, Vector((), np.zeros(0))))
        )
    share = np.concatenate(shares)
    print(
        f"  judged on {[t.name for t in judge.tracks]}: missing torque, share of the file's "
        f"{np.round(share, 3)}, mean {share.mean():.3f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data")
    parser.add_argument("--model")
    parser.add_argument("--judge")
    parser.add_argument("--leave-out", action="store_true")
    args = parser.parse_args()
    process.small_steps()
    machine = load(args.data, args.model)
    names = [t.name for t in machine.tracks]
    if args.leave_out:
        for name in names:
            examined(machine.without([name]), machine.without([n for n in names if n != name]))
    else:
        examined(machine, load(args.judge, args.model) if args.judge else machine)


if __name__ == "__main__":
    main()
