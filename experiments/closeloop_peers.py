"""Side by side on the same data sets and splits: `diagnose`, and four ways that people accept an effect today.

    python -m experiments.closeloop_suites --suite null single --count 40 --seed 0 --out DIR
    python -m experiments.closeloop_peers  --suite null single --count 40 --seed 0 --out DIR --pysindy PYTHON

Only the rule that accepts differs: the declared fit, every refit and the held-out simulation are the package's own.

    ours          the report of `closeloop_suites` in DIR/reports where there is one, else `diagnose` now
    fit_only      the declared model, fitted; it names nothing
    bic           forward selection by BIC over samples: of the candidates that explain most, each refitted by least squares, the
                  one with the least n ln(SS / n) + k ln n is taken while that falls
    coulomb       Coulomb friction at every joint, always
    pysindy       `closeloop_sindy`: an ensemble of sparse regressions on the torque that the declared model lacks

Finished cases are kept in DIR/peers, so a stopped run goes on; DIR/peers.json and DIR/peers.md hold the table. Seeds 0-9999
are for tuning, from 10000 on for scoring.
"""

import argparse
import json
import shutil
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from statistics import median

import numpy as np

from experiments import closeloop_sindy
from experiments.closeloop_scores import gap_closed, score_case, share
from experiments.closeloop_suites import diagnose_folder, write_batch
from tests.generators.suites import SUITES, Case

METHODS = ("ours", "fit_only", "bic", "coulomb", "pysindy")
MOST, SHORTLIST = 3, 8  # effects at most, and candidates refitted for each: as in the search
Active = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Declared:
    """One data set with its declared model fitted: what all peers start from."""

    problem: object
    base: object
    view: object
    error: object


def declared(folder: Path, exclude: tuple[str, ...]) -> Declared:
    """The package's own steps up to the declared model and its held-out error."""
    from adaptsim_jax.logs.noise.floor import noise_floor
    from adaptsim_jax.logs.quality.audit import audit, usable
    from adaptsim_jax.sysid import catalogue, read_recording
    from adaptsim_jax.sysid.estimate.problem import prepare_within_reach
    from adaptsim_jax.sysid.evaluate.crossval import cross_validate
    from adaptsim_jax.sysid.nuisance.null_model import declared, timed

    recording = read_recording(folder)
    checked = audit(recording)
    recording = usable(recording, checked)
    effects = tuple(e for e in catalogue(recording.task) if e.name not in exclude)
    problem, start = prepare_within_reach(recording, checked, noise_floor(recording, checked), effects)
    base, view = declared(problem, start)
    problem, view = timed(problem, base, view)
    return Declared(problem, base, view, cross_validate(problem, base, view))


def nothing(d: Declared, python: str) -> Active:
    return ()


def always_coulomb(d: Declared, python: str) -> Active:
    return tuple(("coulomb", joint) for joint in d.problem.plant.joints)


def sparse_regression(d: Declared, python: str) -> Active:
    from adaptsim_jax.sysid.estimate.variance import unexplained_force

    force, _ = unexplained_force(d.view.lin, d.base.parts)
    live = (d.problem.windows.dt > 0) & d.problem.windows.real[:, None]
    known = {(i.effect.name, i.where) for i in d.problem.model.layout.instances}
    return tuple(e for e in closeloop_sindy.named(d.view, force, live, python) if e in known)


def bic_forward(d: Declared, python: str) -> Active:
    """Least squares and BIC, every sample counted as independent."""
    from adaptsim_jax.sysid.estimate.output_error import ROOM
    from adaptsim_jax.sysid.estimate.problem import by_least_squares
    from adaptsim_jax.sysid.score.table import view
    from adaptsim_jax.sysid.select.start import started

    problem, current, seen = d.problem, d.base, d.view
    samples = int((np.asarray(problem.windows.weight) > 0).sum())

    def bic(result) -> float:
        squares = float(np.sum(np.square(result.residual)))
        finite = np.isfinite(squares) and result.ok
        return samples * np.log(squares / samples) + len(result.names) * np.log(samples) if finite else np.inf

    c = current.candidate
    best = bic(by_least_squares(problem, c.active, c.theta, c.eff, c.refit.point.x0))
    while len(current.active) < MOST:
        c, tried = current.candidate, []
        for r in seen.ranked(exclude=current.active, plain=True)[:SHORTLIST]:
            active = (*current.active, r.instance)
            if _size(problem, active) > ROOM[-1]:
                continue  # more than the package's fit takes at once
            result = by_least_squares(problem, active, c.theta, started(problem, current, r), c.refit.point.x0)
            tried.append((bic(result), active, result))
        score, active, result = min(tried, key=lambda t: t[0], default=(np.inf, (), None))
        if score >= best:
            break
        best, current = score, refitted(d, active, result.theta, result.eff, result.x0)
        seen = view(problem, current)
    return current.active


def _size(problem, active: Active) -> int:
    """Effect parameters that a fit of those effects would move."""
    layout = problem.model.layout
    return sum(not p.held for a in active for p in layout.instances[layout.index(*a)].effect.parameters)


def refitted(d: Declared, active: Active, theta=None, eff=None, x0=None):
    """The package's own refit of a model with those effects, from the declared one where no start is given."""
    from adaptsim_jax.sysid.estimate.fit import fit
    from adaptsim_jax.sysid.estimate.fitted import Start
    from adaptsim_jax.sysid.estimate.problem import Diverged

    c = d.base.candidate
    theta, eff, x0 = (a if b is None else b for a, b in ((c.theta, theta), (c.eff, eff), (c.refit.point.x0, x0)))
    model = fit(d.problem, Start(active, theta, eff, x0, d.base.parts), d.view.response, rounds=2)
    if not model.ok:
        raise Diverged(f"{active}: {model.code.value}")
    return model


def from_scores(d: Declared, active: Active) -> np.ndarray:
    """Effect parameters `[E]` to start from: each effect at its best shape and linear amplitude, small where none is."""
    from adaptsim_jax.sysid.select.start import started

    eff = d.base.candidate.eff.copy()
    ranked = {r.instance: r for r in d.view.ranked()}
    for effect in active:
        at = d.problem.model.layout.instances[d.problem.model.layout.index(*effect)].at
        eff[at] = started(d.problem, d.base, ranked[effect])[at]
    return eff


RULES: dict[str, Callable[[Declared, str], Active]] = {
    "fit_only": nothing,
    "bic": bic_forward,
    "coulomb": always_coulomb,
    "pysindy": sparse_regression,
}


def report_of(d: Declared, active: Active) -> dict:
    """What `score_case` needs: the names, and the held-out error before and after by the package's own simulation."""
    from adaptsim_jax.sysid.estimate.problem import Diverged
    from adaptsim_jax.sysid.evaluate.crossval import cross_validate
    from adaptsim_jax.sysid.score.table import view

    noise, error, why = d.problem.noise.std, d.error.rmse(), ""
    if active:
        try:
            model = refitted(d, active, eff=from_scores(d, active))
            error = cross_validate(d.problem, model, view(d.problem, model)).rmse()
        except (Diverged, ValueError, np.linalg.LinAlgError) as problem:
            why = f"the model with {active} was not simulated, its error is that of the declared one: {problem}"
    floor = float(np.sqrt(np.mean([noise[c] ** 2 for c in ("q1", "q2")])))
    return {
        "verdict": "explained" if active else "within_noise", "message": why,
        "effects": [{"name": n, "where": w} for n, w in active],
        "error": {"before": d.error.rmse(), "after": error, "noise_floor": floor},
    }  # fmt: skip


def ours(case: Case, folder: Path, out: Path) -> dict:
    """The report that `closeloop_suites` kept, or a new one; without a name, the error after is that before."""
    kept = out / "reports" / f"{case.name}.json"
    report = (
        json.loads(kept.read_text()) if kept.exists() else diagnose_folder(str(folder), case.exclude, case.variant)[0]
    )
    error = report.get("error") or {}
    if error.get("after") is None and error.get("before") is not None:
        report["error"] = error | {"after": error["before"]}
    return report


def _kept_seconds(case: Case, out: Path) -> float | None:
    """How long `closeloop_suites` took for a report that it kept; None where it kept none."""
    kept = out / "cases" / f"{case.name}.json"
    there = kept.exists() and (out / "reports" / kept.name).exists()
    return json.loads(kept.read_text())["seconds"] if there else None


def run_case(suite: str, case: Case, out: Path, methods: tuple[str, ...], python: str) -> None:
    """Every method on one data set that has not been run on it yet."""
    file = out / "peers" / f"{case.name}.json"
    records = json.loads(file.read_text()) if file.exists() else {}
    todo = [m for m in methods if m not in records]
    if not todo:
        return
    ((_, folder, truth),) = write_batch([case], out)
    d = declared(folder, case.exclude) if set(todo) - {"ours"} else None
    for method in todo:
        began = time.perf_counter()
        report = ours(case, folder, out) if method == "ours" else report_of(d, RULES[method](d, python))
        seconds = _kept_seconds(case, out) if method == "ours" else None
        record = score_case(suite, case, truth, report) | {"seconds": seconds or time.perf_counter() - began}
        records[method] = record
        file.write_text(json.dumps(records, indent=1, default=float))
        print(f"{case.name:16s} {method:9s} {record['brief']}  {record['seconds']:.1f} s", flush=True)
    shutil.rmtree(folder)


def summarise(out: Path) -> dict:
    """Per method: false alarms on null data sets, names on single ones, and held-out errors on both."""
    files = sorted((out / "peers").glob("*.json"))
    table = {}
    for method in METHODS:
        rs = [r[method] for r in (json.loads(f.read_text()) for f in files) if method in r]
        null, single = ([r for r in rs if r["suite"] == s] for s in ("null", "single"))
        if rs:
            table[method] = {
                "false_alarms": share(null, lambda r: bool(r["named"])),
                "right": share(single, lambda r: all(r["hits"])),
                "right_alone": share(single, lambda r: all(r["hits"]) and not r["wrong"]),
                "any_wrong_name": share(single, lambda r: r["wrong"] > 0),
                "error_over_declared_null": _ratio(null),
                "error_over_declared_single": _ratio(single),
                "gap_closed_single": _median([gap_closed(r) for r in single]),
                "seconds": _median([r["seconds"] for r in rs]),
            }
    return table


def _ratio(rs: list[dict]) -> float | None:
    errors = [(r["error"] or {}) for r in rs]
    return _median([e["after"] / e["before"] for e in errors if e.get("before") and e.get("after")])


def _median(values: list) -> float | None:
    real = [v for v in values if v is not None]
    return median(real) if real else None


TITLES = {
    "false_alarms": "null: an effect named", "right": "one effect: right one named", "right_alone": "and no other",
    "any_wrong_name": "a wrong name", "error_over_declared_null": "null: held-out error / declared",
    "error_over_declared_single": "one effect: held-out error / declared", "gap_closed_single": "gap to noise closed",
    "seconds": "s a data set",
}  # fmt: skip


def markdown(table: dict) -> str:
    """The table; shares with 95 % Wilson intervals, errors as medians over data sets."""

    def cell(value) -> str:
        if isinstance(value, dict):
            if value["share"] is None:
                return "-"
            return f"{value['hits']}/{value['of']} ({100 * value['low']:.0f}-{100 * value['high']:.0f} %)"
        return "-" if value is None else f"{value:.3g}"

    lines = [f"| method | {' | '.join(TITLES.values())} |", f"| --- |{' --- |' * len(TITLES)}"]
    lines += [f"| {m} | {' | '.join(cell(row[k]) for k in TITLES)} |" for m, row in table.items()]
    return "\n".join(lines) + "\n"


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--suite", nargs="+", default=["null", "single"], choices=("null", "single"))
    p.add_argument("--count", type=int, default=40)
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--out", type=Path, required=True)
    p.add_argument("--jobs", type=int, default=1)
    p.add_argument("--methods", nargs="+", default=list(METHODS), choices=METHODS)
    p.add_argument("--pysindy", default=sys.executable, metavar="PYTHON", help="a Python that has pysindy")
    a = p.parse_args()
    methods = tuple(a.methods)
    if "pysindy" in methods and (why := closeloop_sindy.absent(a.pysindy)):
        print(why, file=sys.stderr)
        methods = tuple(m for m in methods if m != "pysindy")
    for name in ("peers", "data"):
        (a.out / name).mkdir(parents=True, exist_ok=True)
    jobs = [(suite, c, a.out, methods, a.pysindy) for suite in a.suite for c in SUITES[suite](a.count, a.seed)]
    if a.jobs == 1:
        for job in jobs:
            run_case(*job)
    else:
        with ProcessPoolExecutor(a.jobs, mp_context=get_context("spawn")) as pool:
            for done in [pool.submit(run_case, *job) for job in jobs]:
                done.result()
    table = summarise(a.out)
    (a.out / "peers.json").write_text(json.dumps(table, indent=1))
    (a.out / "peers.md").write_text(markdown(table))
    print(markdown(table))


if __name__ == "__main__":
    main()
