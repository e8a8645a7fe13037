"""The `adaptsim` command: parse, set the compile cache up, run one command, turn errors into one
line.

Exit codes: 0, 1 (it failed), 2 (bad input: one line that names it and the mend), 130 (stopped by
Ctrl-C or SIGTERM). Nothing here imports JAX or NumPy, so that `--help` answers at once.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import os
import sys
import traceback
from functools import partial

from adaptsim_jax.commands import SUMMARIES
from adaptsim_jax.commands.parser import Parser, command_parser, top_parser
from adaptsim_jax.core import process
from adaptsim_jax.core.config import nearest, suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.registry import own_line

FAILED, BAD_INPUT, STOPPED = 1, 2, 130
_DISK = (errno.ENOSPC, errno.EDQUOT)
_OUTSIDE = (
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.ENOTDIR,
    errno.EISDIR,
    errno.ENAMETOOLONG,
    errno.EFBIG,
)


def _print_help(parser: argparse.ArgumentParser, _: argparse.Namespace) -> None:
    parser.print_help()


def main(argv: list[str] | None = None) -> int:
    """Run one command line (default: `sys.argv`); returns the exit code and never raises for bad
    input.
    """
    argv = sys.argv[1:] if argv is None else list(argv)
    args = None
    try:
        process.patient_output()
        process.legible_streams()
        args = parse(argv)
        process.check_process()
        for word in process.computing():
            print(f"adaptsim: {word}", file=sys.stderr)
        _limit_blas_threads()
        os.environ.setdefault(
            "TF_CPP_MIN_LOG_LEVEL", "3"
        )  # XLA's alarm at slow compiles, where a machine is busy
        _set_up_cache(args)
        _set_up_memory()
        with process.stopped_by_sigterm():
            return args.run(args) or 0
    except SystemExit as stop:  # argparse's --help and --version
        if isinstance(stop.code, int):
            return stop.code
        return FAILED
    except BadInput as error:
        return _report(error.coded, BAD_INPUT)
    except KeyboardInterrupt:
        hint = getattr(args, "resume_hint", None)
        return _report(
            f"stopped; {hint}" if hint else "stopped; nothing half-written is left", STOPPED
        )
    except OSError as error:
        return _file_system(error)
    except Exception as error:
        if _interrupted(error):  # Ctrl-C while a library was being imported
            return _report("stopped; nothing half-written is left", STOPPED)
        if where := own_line(error):
            return _report(f"in your {where}: {type(error).__name__}: {error}; mend it", BAD_INPUT)
        traceback.print_exc()
        where = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
        return _report(
            f"failed: {type(error).__name__}: {error}; this is a fault of the program{where}",
            FAILED,
        )


def _interrupted(error: BaseException | None) -> bool:
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def parse(argv: list[str]) -> argparse.Namespace:
    """The arguments of one command, with `run` set to it; only that command's module is loaded."""
    if not argv or argv[0].startswith("-"):
        parser = top_parser()
        options, unknown = parser.parse_known_args(argv)  # --help, --version, or an error
        if unknown:
            raise BadInput(
                f"'{unknown[0]}' stands before the command; write 'adaptsim COMMAND {unknown[0]}'"
            )
        options.run = partial(_print_help, parser)
        return options
    name, *after = argv
    if name not in SUMMARIES:
        raise BadInput(f"unknown command '{name}'; {suggest(name, SUMMARIES)}")
    command = command_parser(name)
    args, unknown = command.parse_known_args(after)
    if unknown:
        raise BadInput(_unknown_argument(command, unknown[0]))
    args.seed_given, args.seed = args.seed is not None, args.seed or 0
    return args


def _unknown_argument(parser: Parser, word: str) -> str:
    options = [option for action in parser._actions for option in action.option_strings]
    near = nearest(word.partition("=")[0], options)
    if near:
        mend = f"did you mean '{near}'?"
    else:
        mend = f"see '{parser.prog} --help'"
    return f"unknown argument '{word}'; {mend}"


def _limit_blas_threads() -> None:
    # The matrices here are small: OpenBLAS's threads gain nothing on them, and spin while they
    # wait, which takes the cores away from XLA. NumPy reads these when it is imported, which
    # happens later.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _set_up_cache(args: argparse.Namespace) -> None:
    if "jax" in sys.modules:
        return
    if getattr(args, "no_cache", False):
        process.disable_cache()
    elif trouble := process.enable_cache():
        print(f"adaptsim: {trouble}", file=sys.stderr)


def _set_up_memory() -> None:
    if "jax" not in sys.modules:  # else a Python program called us, whose memory is its own
        from adaptsim_jax.core import process

        process.keep_freed()
        process.collect_rarely()


def _file_system(error: OSError) -> int:
    where = f"{error.filename}: " if error.filename else ""
    what = error.strerror or str(error)
    if error.errno in _DISK:
        return _report(f"{where}no space left on the disk; free some and run again", BAD_INPUT)
    if error.errno == errno.ENOENT and error.filename:
        return _report(f"{where}no such file or folder; check the name", BAD_INPUT)
    if error.errno in _OUTSIDE:
        return _report(f"{where}{what}; name a file or folder that you may use", BAD_INPUT)
    traceback.print_exc()
    return _report(f"failed: {where}{what}", FAILED)


def _report(message: str, code: int) -> int:
    with contextlib.suppress(OSError, ValueError):
        print(f"adaptsim: {' '.join(message.split())}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
