"""From Drake's hydroelastic modulus e to the contact of our models: the map is fitted to where
Drake's bottles go.

    # the map of the MuJoCo scene (native, MJX)
    python experiments/pushing_elasticity.py --fit native --against drake
    # the planar model as a twin of that scene
    python experiments/pushing_elasticity.py --fit planar --against native
    python experiments/pushing_elasticity.py --fit planar --against drake

Half of the random pushes are fitted to (Nelder and Mead), the other half judge: both errors are
printed, with the coefficients. `--keep FILE.npz` saves the pushes of the reference, `--use
FILE.npz` takes them up again, `--out FILE.toml` saves the coefficients. Drake on two cores computes
about ten pushes a second.
"""

import argparse
from pathlib import Path

import numpy as np
import pushing_fit

from adaptsim_jax import BadInput
from adaptsim_jax.core import config, files
from adaptsim_jax.core.progress import progress
from adaptsim_jax.tasks.pushing.engines import BACKENDS, make_backend
from adaptsim_jax.tasks.pushing.engines.drake import PushContact
from adaptsim_jax.tasks.pushing.model import PushOptions, check_options


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--fit", choices=("native", "planar"), required=True, help="whose coefficients"
    )
    parser.add_argument(
        "--against", choices=BACKENDS, default="drake", help="whose bottles are right (drake)"
    )
    parser.add_argument("--friction", choices=("clean", "coupled"), default="clean")
    parser.add_argument("--samples", type=int, default=200, help="random pushes (200)")
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--rounds", type=int, help="evaluations from each of two starts")
    parser.add_argument(
        "--solver", default=PushContact.solver, help="Drake's contact approximation (lagged)"
    )
    parser.add_argument("--dt", type=float, default=PushContact.dt, help="Drake's step, s (0.002)")
    parser.add_argument("--keep", type=Path, metavar="FILE.npz")
    parser.add_argument("--use", type=Path, metavar="FILE.npz")
    parser.add_argument("--out", type=Path, metavar="FILE.toml")
    return parser.parse_args()


def reference(args: argparse.Namespace, options: PushOptions) -> pushing_fit.Reference:
    if args.use:
        with np.load(args.use) as saved:
            return pushing_fit.Reference(*(saved[name] for name in pushing_fit.Reference._fields))
    settings = {"contact": PushContact(args.solver, args.dt)} if args.against == "drake" else {}
    found = pushing_fit.observe(
        make_backend(args.against, options, **settings), args.seed, args.samples
    )
    if args.keep:
        np.savez(args.keep, **found._asdict())
    return found


def main() -> None:
    args = arguments()
    options = check_options(PushOptions(friction=args.friction))
    rounds = {"rounds": args.rounds} if args.rounds else {}
    pushes = reference(args, options)
    with progress(f"fit {args.fit} to {args.against}") as report:
        if args.fit == "planar":
            fit = pushing_fit.fit_planar(pushes, options, **rounds)
        else:
            fit = pushing_fit.fit_elasticity(pushes, options, **rounds, progress=report)
    print(f"{args.fit} to {args.against}, {len(pushes.rows)} pushes, {fit.evaluations} evaluations")
    for what, errors in (("fitted to", fit.fitted), ("held out", fit.held_out)):
        print(
            f"{what:10} median {1e3 * errors[0]:.1f}  p90 {1e3 * errors[1]:.1f}  max "
            f"{1e3 * errors[2]:.1f} mm"
        )
    table = config.to_table(fit.coefficients)
    print(config.dumps(table))
    if args.out:
        files.write_bytes(args.out, config.dumps(table).encode())


if __name__ == "__main__":
    try:
        main()
    except BadInput as error:
        raise SystemExit(f"pushing_elasticity: {error}") from None
