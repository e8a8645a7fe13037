"""`python -m adaptsim_jax` is `adaptsim`."""

from adaptsim_jax.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
