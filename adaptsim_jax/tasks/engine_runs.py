"""Several engines on the same batch of trials: how each is timed, what did not run, and pair by
pair what they agree on.
"""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import Report


class Run(NamedTuple):
    """outcome `[B, ...]` and code `[B]` of the trials, and seconds: the first call (compiling), and
    a trial of a warm call by the wall clock and by processor time.
    """

    outcome: np.ndarray
    code: np.ndarray
    first: float
    each: float
    cpu_each: float


def engines_and_pairs(
    names: Sequence[str],
    run: Callable[[str], Run],
    row: Callable[[Run], dict[str, Any]],
    pair: Callable[[Run, Run], dict[str, Any]],
    progress: Report,
) -> dict[str, Any]:
    """`{cores, engines, pairs}`: a row for each engine, or why it did not run, and one for each
    pair of those that did.
    """
    runs, engines = {}, []
    for done, name in enumerate(names):
        progress(done, len(names), name)
        try:
            runs[name] = run(name)
        except BadInput as error:
            engines.append({"engine": name, "ran": False, "why": str(error)})
            continue
        engines.append({"engine": name, "ran": True, **row(runs[name])})
    pairs = [{"pair": [a, b], **pair(runs[a], runs[b])} for a, b in itertools.combinations(runs, 2)]
    return {"cores": os.cpu_count(), "engines": engines, "pairs": pairs}


def timed_run(
    simulate: Callable, batch: tuple, outcome: Callable, *, compiles: bool = True, wide: int = 0
) -> Run:
    """The outcomes of a batch, and how long it takes. An engine that compiles nothing is called
    once; `wide` trials are timed instead of the batch where an engine is made for many.
    """
    out, first, cpu = _timed(simulate, batch)
    found = outcome(np.asarray(out.state))
    if not compiles:
        return Run(found, out.code, 0.0, first / len(batch[0]), cpu / len(batch[0]))
    if wide:
        batch = tuple(np.resize(a, (wide, a.shape[1])) for a in batch)
        _timed(simulate, batch)
    _, seconds, cpu = _timed(simulate, batch)
    return Run(found, out.code, first, seconds / len(batch[0]), cpu / len(batch[0]))


def _timed(simulate: Callable, batch: tuple) -> tuple[Any, float, float]:
    begin, cpu = time.perf_counter(), time.process_time()
    out = simulate(*batch)
    np.asarray(out.state)
    return out, time.perf_counter() - begin, time.process_time() - cpu


def speed_row(run: Run, what: str, messages: Mapping[int, str]) -> dict[str, Any]:
    """Speed of one engine in `what` (pushes, trials) a second, and how many of its trials went
    wrong in which way.
    """
    return {
        f"{what}_per_second": 1 / run.each,
        f"{what}_per_cpu_second": 1 / max(run.cpu_each, 1e-9),
        "first_call_s": run.first,
        "went_wrong": {
            messages[c]: int((run.code == c).sum()) for c in messages if c and (run.code == c).any()
        },
    }
