"""The command `adaptsim`, as `python -m adaptsim_jax` too: Ctrl-C ends it without Python's
traceback while its modules are loaded.
"""

import signal
import warnings


def run() -> int:
    """The exit code of the command line. Never returns where Ctrl-C comes before `cli.main` can say
    so, or after it has ended.
    """
    heeded = (
        signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )  # else a shell told us to ignore it
    if heeded:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # they name places in the installation, of which a user can mend none
    warnings.simplefilter("ignore", RuntimeWarning)
    from adaptsim_jax.cli import main

    if heeded:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return main()
    finally:
        if heeded:
            signal.signal(signal.SIGINT, signal.SIG_DFL)


if __name__ == "__main__":
    raise SystemExit(run())
