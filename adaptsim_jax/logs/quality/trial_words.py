"""What differs between trials, in the words and numbers of a report: which trials, by how much, and
what to do.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from adaptsim_jax.logs.criteria import TRIAL
from adaptsim_jax.logs.quality.contradictions import Words
from adaptsim_jax.logs.quality.findings import WORDS
from adaptsim_jax.logs.quality.trials_differ import OutlierTrial, TrialDifferences

DIFFERENCES: dict[str, dict[str, str]] = WORDS["difference"]


def add_trials(
    report: dict[str, Any],
    evidence: dict[str, Any],
    differ: TrialDifferences | None,
    channels: Words,
) -> None:
    """Put `trials` into a report, and a warning for all that differs between them and that the
    final model does not explain.
    """
    if differ is None:
        return
    differ = confirmed(differ, report["error"])
    warnings = sentences(differ, channels)
    leave_out = sorted({*differ.outlying, *(o.trial for o in differ.outliers)})
    rows = [_each(differ, i, report["error"], channels) for i in range(len(differ.names))]
    report["trials"] = {
        "differ": differ.kind or None,
        "takes": differ.explained_share if differ.kind else None,
        "leave_out": leave_out,
        "headline": headline(differ),
        "warnings": warnings,
        "each": rows,
    }
    report["warnings"] = [*(report.get("warnings") or []), *warnings]
    evidence["audit"] = [
        {"severity": "warn", "where": "trials", "message": m} for m in warnings
    ] + list(evidence.get("audit") or [])


def confirmed(differ: TrialDifferences, error: Mapping[str, Any]) -> TrialDifferences:
    """What of it the final model leaves: nothing where its error is about the noise, no odd trial
    that it simulates as the others, unless that is because the trial spoiled the fit of all.
    """
    error_after, floor = error.get("after") or error.get("before"), error.get("noise_floor")
    if error_after is not None and floor and error_after < TRIAL.min_noise_ratio * floor:
        return TrialDifferences(differ.names, differ.error)
    errors = _errors(error)
    usual_error = float(np.median(list(errors.values()))) if errors else 0.0
    is_spoilt = bool(floor) and usual_error > TRIAL.min_spoiling_ratio * floor
    outliers = tuple(
        o
        for o in differ.outliers
        if errors.get(o.trial, np.inf) > TRIAL.min_unusual_ratio * usual_error
        or (is_spoilt and o.times > TRIAL.min_spoiling_ratio)
    )
    return replace(differ, outliers=outliers)


def _errors(error: Mapping[str, Any]) -> dict[str, float]:
    """Error of the final model by trial, rad."""
    rows = [
        (t.get("trial"), t.get("after") if t.get("after") is not None else t.get("before"))
        for t in error["per_trial"]
    ]
    return {str(name): float(e) for name, e in rows if e is not None}


def headline(differ: TrialDifferences) -> str | None:
    """The end of a sentence; None where nothing differs."""
    if differ.kind and not differ.outlying:
        return f"{DIFFERENCES[differ.kind]['differs']} from trial to trial"
    outlying = sorted({*differ.outlying, *(o.trial for o in differ.outliers)})
    if not outlying:
        return None
    verb = "are" if len(outlying) > 1 else "is"
    return f"{', '.join(outlying[:6])} {verb} apart from the other trials"


def sentences(differ: TrialDifferences, channels: Words) -> list[str]:
    """A warning for what differs in all trials, and one for each odd trial."""
    warnings = []
    if differ.kind and differ.size is not None:
        words = DIFFERENCES[differ.kind]
        spread_of = np.nanmax(differ.size, axis=0) - np.nanmin(differ.size, axis=0)
        spread = ", ".join(
            _amount(differ.kind, spread_of, k, channels)
            for k in np.flatnonzero(spread_of > TRIAL.min_shown_ratio * spread_of.max())
        )
        mend = words["mend"]
        if differ.outlying:
            mend = f"leave the odd ones out: --without {','.join(differ.outlying)}"
        warnings.append(
            f"{words['differs']} from trial to trial, by about {spread}: that is "
            f"{100 * differ.explained_share:.0f} % of what the model leaves unexplained, or an "
            f"effect without a name that acts otherwise in each trial; {mend}"
        )
    return warnings + [_outlier_words(o, channels) for o in differ.outliers]


def _names(kind: str, channels: Words) -> tuple[str, ...]:
    """Return the names of the numbers of a kind."""
    if kind == "load":
        return ("share",)
    return channels.q if kind == "zero" else channels.tau


def _amount(kind: str, size: np.ndarray, k: int, channels: Words) -> str:
    """The `k`-th number in words."""
    words, x = DIFFERENCES[kind], float(size[k])
    form = words["amount" if channels.hinges[k] or "slides" not in words else "slides"]
    name = _names(kind, channels)[k]
    return form.format(x=x, percent=100 * x, degrees=np.degrees(x), mm=1e3 * x, name=name)


def _outlier_words(o: OutlierTrial, channels: Words) -> str:
    why = (
        "nothing simple explains it: did a drive trip, a sensor drop out, are its columns or "
        "units other, or does an effect act that the other trials hardly show?"
    )
    if o.kind:
        size = np.array(o.size)
        amount = _amount(o.kind, size, int(np.argmax(np.abs(size))), channels)
        why = f"its {DIFFERENCES[o.kind]['own']} looks otherwise, by {amount}"
    return (
        f"{o.trial} does not follow the model of the other trials ({o.times:.0f} times as much "
        f"torque is unexplained): {why}; leave it out: --without {o.trial}"
    )


def _each(
    differ: TrialDifferences, i: int, error: Mapping[str, Any], channels: Words
) -> dict[str, Any]:
    name = differ.names[i]
    outlier = next((o for o in differ.outliers if o.trial == name), None)
    size, unexplained = None, float(differ.error[i])
    if differ.kind and differ.size is not None and np.all(np.isfinite(differ.size[i])):
        size = dict(zip(_names(differ.kind, channels), map(float, differ.size[i]), strict=True))
    return {
        "trial": name,
        "error": _errors(error).get(name),
        "unexplained_torque": unexplained if np.isfinite(unexplained) else None,
        "size": size,
        "odd": outlier is not None or name in differ.outlying,
        "kind": outlier.kind or None if outlier else None,
    }
