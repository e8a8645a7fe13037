"""What differs between trials, in the words and numbers of a report: which trials, by how much, and
what to do.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptsim_jax.logs.criteria import TRIAL
from adaptsim_jax.logs.quality.findings import WORDS
from adaptsim_jax.logs.quality.trials_differ import Differ, OutlierTrial

DIFFERENCES: dict[str, dict[str, str]] = WORDS["difference"]


@dataclass(frozen=True)
class Channels:
    """How columns are called, `[n]`: angles `q`, torques `tau`; `hinges`: whether an angle is
    one.
    """

    q: tuple[str, ...]
    tau: tuple[str, ...]
    hinges: tuple[bool, ...]


def add_trials(
    report: dict[str, Any], evidence: dict[str, Any], differ: Differ | None, channels: Channels
) -> None:
    """Put `trials` into a report, and a warning for all that differs between them and that the
    final model does not explain.
    """
    if differ is None:
        return
    differ = confirmed(differ, report["error"])
    lines = sentences(differ, channels)
    leave_out = sorted({*differ.outlying, *(o.trial for o in differ.outliers)})
    each = [_each(differ, i, report["error"], channels) for i in range(len(differ.names))]
    report["trials"] = {
        "differ": differ.kind or None,
        "alike": list(differ.alike),
        "takes": differ.takes if differ.kind else None,
        "leave_out": leave_out,
        "headline": headline(differ),
        "warnings": lines,
        "each": each,
    }
    report["warnings"] = [*(report.get("warnings") or []), *lines]
    evidence["audit"] = [
        {"severity": "warn", "where": "trials", "message": m} for m in lines
    ] + list(evidence.get("audit") or [])


def confirmed(differ: Differ, error: Mapping[str, Any]) -> Differ:
    """What of it the final model leaves: nothing where its error is about the noise, no odd trial
    that it simulates as the others, unless that is because the trial spoiled the fit of all.
    """
    left, floor = error.get("after") or error.get("before"), error.get("noise_floor")
    if left is not None and floor and left < TRIAL.noises * floor:
        return Differ(differ.names, differ.error)
    own = _errors(error)
    usual = float(np.median(list(own.values()))) if own else 0.0
    spoilt = bool(floor) and usual > TRIAL.spoils * floor
    outlier = tuple(
        o
        for o in differ.outliers
        if own.get(o.trial, np.inf) > TRIAL.unusual * usual or (spoilt and o.times > TRIAL.spoils)
    )
    return Differ(
        differ.names, differ.error, differ.kind, differ.size, differ.takes, differ.alike, outlier
    )


def _errors(error: Mapping[str, Any]) -> dict[str, float]:
    """Error of the final model by trial, rad."""
    rows = [
        (t.get("trial"), t.get("after") if t.get("after") is not None else t.get("before"))
        for t in error["per_trial"]
    ]
    return {str(name): float(e) for name, e in rows if e is not None}


def headline(differ: Differ) -> str | None:
    """The end of a sentence; None where nothing differs."""
    if differ.kind and not differ.outlying:
        return f"{DIFFERENCES[differ.kind]['differs']} from trial to trial"
    outlier = sorted({*differ.outlying, *(o.trial for o in differ.outliers)})
    if not outlier:
        return None
    verb = "are" if len(outlier) > 1 else "is"
    return f"{', '.join(outlier[:6])} {verb} apart from the other trials"


def sentences(differ: Differ, channels: Channels) -> list[str]:
    """A warning for what differs in all trials, and one for each odd trial."""
    out = []
    if differ.kind and differ.size is not None:
        alike = [DIFFERENCES[kind]["alike"] for kind in differ.alike]
        also = f" ({' or '.join(alike)} would do as well)" if alike else ""
        spread = _spread(differ.kind, differ.size, channels)
        out.append(
            f"{DIFFERENCES[differ.kind]['differs']} from trial to trial, {spread}: that is "
            f"{100 * differ.takes:.0f} % of what the model leaves unexplained{also}, or an effect "
            f"without a name that acts otherwise in each trial; {_mend(differ)}"
        )
    out += [_outlier_words(o, channels) for o in differ.outliers]
    return out


def _mend(differ: Differ) -> str:
    if differ.outlying:
        return f"leave the odd ones out: --without {','.join(differ.outlying)}"
    return DIFFERENCES[differ.kind]["mend"]


def _spread(kind: str, size: np.ndarray, channels: Channels) -> str:
    wide = np.nanmax(size, axis=0) - np.nanmin(size, axis=0)
    if kind == "load":
        return f"by about {100 * wide[0]:.2g} % of the torque"
    names = channels.q if kind == "zero" else channels.tau
    parts = [
        (n, w, _amount(kind, w, h)) for n, w, h in zip(names, wide, channels.hinges, strict=True)
    ]
    most = max(w for _, w, _ in parts)
    return "by about " + ", ".join(f"{a} in {n}" for n, w, a in parts if w > TRIAL.shown * most)


def _amount(kind: str, size: float, hinge: bool) -> str:
    if kind == "zero":
        if hinge:
            return f"{size:.2g} rad ({np.degrees(size):.2g} degrees)"
        return f"{1e3 * size:.2g} mm"
    if kind == "torque_scale":
        return f"{100 * size:.2g} %"
    return f"{size:.2g} N m"


def _outlier_words(o: OutlierTrial, channels: Channels) -> str:
    why = (
        "nothing simple explains it: did a drive trip, a sensor drop out, are its columns or "
        "units other, or does an effect act that the other trials hardly show?"
    )
    if o.kind == "load":
        why = f"it looks to carry another load ({100 * o.size[0]:+.2g} % of the torque)"
    elif o.kind:
        names = channels.q if o.kind == "zero" else channels.tau
        k = int(np.argmax(np.abs(o.size)))
        what = DIFFERENCES[o.kind]["own"]
        amount = _amount(o.kind, o.size[k], channels.hinges[k])
        why = f"its {what} look otherwise, by {amount} in {names[k]}"
    return (
        f"{o.trial} does not follow the model of the other trials ({o.times:.0f} times as much "
        f"torque is unexplained): {why}; leave it out: --without {o.trial}"
    )


def _each(differ: Differ, i: int, error: Mapping[str, Any], channels: Channels) -> dict[str, Any]:
    name = differ.names[i]
    outlier = next((o for o in differ.outliers if o.trial == name), None)
    size: Any = None
    if differ.kind and differ.size is not None and np.all(np.isfinite(differ.size[i])):
        if differ.kind == "load":
            names = ("share",)
        elif differ.kind == "zero":
            names = channels.q
        else:
            names = channels.tau
        size = dict(zip(names, map(float, differ.size[i]), strict=True))
    if np.isfinite(differ.error[i]):
        unexplained = float(differ.error[i])
    else:
        unexplained = None
    return {
        "trial": name,
        "error": _errors(error).get(name),
        "unexplained_torque": unexplained,
        "size": size,
        "odd": outlier is not None or name in differ.outlying,
        "kind": outlier.kind or None if outlier else None,
    }
