"""How one diagnosis is judged against the truth, and how judgements become the table of a suite."""

import re
from collections import Counter, defaultdict
from statistics import median

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import binomtest

from tests.generators.suites import ALIASES, SAME, Case

Named = tuple[str, str]  # effect, place

LEVELLED = ("presliding", "stribeck", "friction_drift")
NOTHING = ("within_noise",)


def wilson(hits: int, n: int) -> tuple[float, float]:
    """The 95 % Wilson interval of a share."""
    if n == 0:
        return 0.0, 1.0
    interval = binomtest(hits, n).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def place(text: str) -> str:
    """`joint 1`, `joint1`, `1` -> `joint1`; anything else without blanks."""
    digit = re.search(r"[12]", str(text))
    return f"joint{digit.group()}" if digit else str(text).strip().replace(" ", "_") or "base"


def parse(entry: str | dict, where: str) -> Named:
    """An alternative as `name`, `name@joint2`, `name at joint 2` or a table; without a place: the
    effect's own.
    """
    if isinstance(entry, dict):
        name, spot = entry["name"], entry.get("where", where)
    else:
        name, _, spot = re.sub(r"\s+at\s+|\s+|:", "@", entry.strip(), count=1).partition("@")
    name = ALIASES.get(name, name)
    return name, "base" if name == "tilt" else place(spot or where)


def classes(report: dict) -> list[set[Named]]:
    """Each named effect with the alternatives that the report admits, and what physics makes the
    same.
    """
    out = []
    for e in report.get("effects", []):
        own = parse({"name": e["name"], "where": e.get("where", "")}, "")
        members = {own} | {parse(x, own[1]) for x in e.get("alternatives", [])}
        out.append(members | {twin for m in members for twin in SAME.get(m, set())})
    return out


def localised(record: dict) -> bool:
    """Whether what is left is said to sit at the joint where it is hidden; the base acts on both. A
    gain of one joint's torque is the inverse gain of the other's: where both are told, that is
    right.
    """
    told = record["leftover"] or []
    scale = (
        bool(told)
        and told[0]["variable"] == "command"
        and any(name == "torque_gain" for name, _ in record["hidden"])
    )
    found = [place(at["joint"]) for at in told[: 2 if scale else 1]]
    return any(where == "base" or where in found for _, where in record["hidden"])


def matched(hidden: list[Named], found: list[set[Named]]) -> list[bool]:
    """Whether each hidden effect is in the class of a named one, of its own: one name is not two
    effects.
    """
    fits = np.array([[h in c for c in found] for h in hidden], bool).reshape(
        len(hidden), len(found)
    )
    rows, columns = linear_sum_assignment(fits, maximize=True)
    return [bool(h in rows and fits[h, columns[list(rows).index(h)]]) for h in range(len(hidden))]


def score_case(suite: str, case: Case, truth: dict, report: dict) -> dict:
    """What was hidden, what was named, and whether each name is right."""
    found = classes(report)
    hidden = [(e["name"], e["where"]) for e in truth["effects"]]
    confounded = [e["confounded"] for e in truth["effects"]]
    hits = matched(hidden, found)
    verdict = report["verdict"]
    if suite != "outside":
        quiet = verdict in NOTHING and not found
        hits = [hit or (absorbed and quiet) for hit, absorbed in zip(hits, confounded, strict=True)]
    # dry friction's level stands beside its bristles and its rise at creeping speed: it is a part
    # of what was hidden
    parts = {("coulomb", where) for name, where in hidden if name in LEVELLED}
    found_alone = [c for c in found if not c & parts] if any(hits) else found
    wrong = sum(not any(h in c for h in hidden) for c in found_alone)
    first = [f"{e['name']}@{place(e.get('where', ''))}" for e in report.get("effects", [])]
    right = ",".join(f"{n}@{w}" for n, w in hidden) or "nothing"
    return {
        "suite": suite,
        "name": case.name,
        "seed": case.spec.seed,
        "condition": case.spec.condition,
        "world": case.spec.world,
        "variant": case.variant,
        "hidden": hidden,
        "confounded": confounded,
        "multiples": [e["multiple_reached"] for e in truth["effects"]],
        "verdict": verdict,
        "named": first,
        "classes": [sorted(f"{n}@{w}" for n, w in c) for c in found],
        "hits": hits,
        "wrong": wrong,
        "error": report.get("error", {}),
        "declared": declared_errors(truth.get("declared", {}), report.get("declared") or {}),
        "leftover": report.get("leftover"),
        "message": report.get("message", ""),
        "brief": f"{right} -> {verdict} {first} {'hit ' * sum(hits)}{'WRONG ' * wrong}",
    }


def declared_errors(truth: dict[str, float], declared: dict) -> dict[str, dict]:
    """Per identifiable declared parameter: relative error before and after, and whether the 90 %
    interval holds it.
    """
    out = {}
    for name, true in truth.items():
        before, after = (declared.get(stage, {}).get(name) or {} for stage in ("before", "after"))
        if (
            before.get("value") is None
            or after.get("value") is None
            or after.get("identifiable") is False
        ):
            continue
        errors = {
            k: (e["value"] - true) / abs(true) for k, e in (("before", before), ("after", after))
        }
        if after.get("low") is not None and after.get("high") is not None:
            errors["covered"] = after["low"] <= true <= after["high"]
        out[name] = errors
    return out


def share(records: list, test) -> dict:
    """How many pass a test, with the Wilson interval."""
    n, hits = len(records), sum(bool(test(r)) for r in records)
    low, high = wilson(hits, n)
    return {"hits": hits, "of": n, "share": hits / n if n else None, "low": low, "high": high}


def gap_closed(r: dict) -> float | None:
    """(before - after) / (before - floor) of the simulated held-out error."""
    e = r["error"] or {}
    values = [e.get(k) for k in ("before", "after", "noise_floor")]
    numbers = [v.get("value") if isinstance(v, dict) else v for v in values]
    if any(v is None for v in numbers) or numbers[0] <= numbers[2]:
        return None
    return (numbers[0] - numbers[1]) / (numbers[0] - numbers[2])


def consistent(group: list[dict]) -> float:
    """Share of disguises with the verdict and the names of the plain recording."""
    plain = next(r for r in group if not r["variant"])
    others = [r for r in group if r["variant"]]
    same = [
        (r["verdict"], sorted(r["named"])) == (plain["verdict"], sorted(plain["named"]))
        for r in others
    ]
    return sum(same) / max(len(same), 1)


def summarise(records: list[dict]) -> dict:
    """The scores of every suite that has finished cases."""
    suites: dict[str, list[dict]] = defaultdict(list)
    for r in records:
        suites[r["suite"]].append(r)
    return {name: _suite(name, rs) for name, rs in suites.items()}


def _suite(name: str, rs: list[dict]) -> dict:
    errors = [e for r in rs for e in r["declared"].values()]
    covered = [e for e in errors if "covered" in e]
    gaps = [g for g in map(gap_closed, rs) if g is not None]
    out: dict = {
        "cases": len(rs),
        "verdicts": dict(Counter(r["verdict"] for r in rs)),
        "seconds_median": median(r["seconds"] for r in rs),
        "seconds_most": max(r["seconds"] for r in rs),
        "crashes": [r["name"] for r in rs if r["verdict"] == "error"],
        "any_wrong_name": share(rs, lambda r: r["wrong"] > 0),
        "gap_closed_median": median(gaps) if gaps else None,
        "declared_error_before": median(abs(e["before"]) for e in errors) if errors else None,
        "declared_error_after": median(abs(e["after"]) for e in errors) if errors else None,
        "declared_covered": share(covered, lambda e: e["covered"]),
    }
    if name == "null":
        out["false_alarms"] = by(rs, "condition", lambda r: bool(r["named"]))
    if name in ("single", "power"):
        out["right"] = share(rs, lambda r: all(r["hits"]))
        out["wrong_without_right"] = share(rs, lambda r: r["wrong"] > 0 and not any(r["hits"]))
        out["confusion"] = confusion(rs)
    if name == "power":
        out["right_by_size"] = by(rs, "multiple", lambda r: all(r["hits"]))
    if name == "outside":

        def unattributed(r):
            return r["verdict"] == "structured_unattributed" and not r["named"]

        out["unattributed"] = share(rs, unattributed)
        out["localised"] = share(rs, lambda r: unattributed(r) and localised(r))
    if name == "two":
        out["both"] = share(rs, lambda r: all(r["hits"]))
        out["at_least_one"] = share(rs, lambda r: any(r["hits"]))
    if name == "metamorphic":
        groups = defaultdict(list)
        for r in rs:
            groups[r["seed"]].append(r)
        whole = [g for g in groups.values() if any(not r["variant"] for r in g)]
        out["consistent"] = sum(map(consistent, whole)) / max(len(whole), 1)
    return out


def by(rs: list[dict], key: str, test) -> dict:
    """A share for each value of a key; `multiple` is the size aimed at, from the case's name."""
    groups = defaultdict(list)
    for r in rs:
        groups[r["name"].rsplit("_", 1)[1] if key == "multiple" else r[key]].append(r)
    return {k: share(g, test) for k, g in sorted(groups.items())}


def confusion(rs: list[dict]) -> dict[str, dict[str, int]]:
    """Hidden effect -> what was said (the right name if in a class, else the first name or the
    verdict).
    """
    out: dict[str, Counter] = defaultdict(Counter)
    for r in rs:
        hidden = "@".join(r["hidden"][0])
        said = hidden if all(r["hits"]) else (r["named"] or [r["verdict"]])[0]
        out[hidden][said] += 1
    return {k: dict(v.most_common()) for k, v in sorted(out.items())}


def _percent(s: dict) -> str:
    if s["share"] is None:
        return "-"
    return (
        f"{s['hits']}/{s['of']} = {100 * s['share']:.1f} % "
        f"({100 * s['low']:.1f}-{100 * s['high']:.1f})"
    )


def table(results: dict) -> str:
    """The scores as Markdown; shares with their 95 % Wilson intervals."""
    lines = []
    for suite, r in results.items():
        lines += [f"## {suite}: {r['cases']} data sets", "", "| score | value |", "| --- | --- |"]
        for key, value in r.items():
            if isinstance(value, dict) and "share" in value:
                lines.append(f"| {key} | {_percent(value)} |")
            elif key in ("false_alarms", "right_by_size"):
                lines += [f"| {key}: {k} | {_percent(v)} |" for k, v in value.items()]
            elif key == "verdicts":
                lines.append(f"| {key} | {', '.join(f'{k} {v}' for k, v in value.items())} |")
            elif key != "confusion" and key != "cases":
                lines.append(f"| {key} | {value} |")
        if "confusion" in r:
            lines += ["", "| hidden | said |", "| --- | --- |"]
            lines += [
                f"| {h} | {', '.join(f'{k} {v}' for k, v in s.items())} |"
                for h, s in r["confusion"].items()
            ]
        lines.append("")
    return "\n".join(lines)


def row(r: dict) -> dict[str, object]:
    """One case in a line, for `cases.csv`: what was hidden and said, errors in rad, declared values
    covered of those told.
    """
    error, declared = r["error"] or {}, [e for e in r["declared"].values() if "covered" in e]

    def number(x):
        return "" if x is None else f"{x:.4g}"

    return {
        "case": r["name"],
        "condition": r["condition"],
        "world": r["world"],
        "variant": r["variant"],
        "hidden": " + ".join(f"{n}@{w}" for n, w in r["hidden"]),
        "multiple": " + ".join(number(m) for m in r["multiples"]),
        "absorbed": sum(r["confounded"]),
        "verdict": r["verdict"],
        "said": " + ".join("|".join(c) for c in r["classes"]),
        "right": sum(r["hits"]),
        "wrong": r["wrong"],
        "left_at": r["leftover"][0]["joint"]
        if r["leftover"] and r["verdict"] == "structured_unattributed"
        else "",
        **{k: number(error.get(k)) for k in ("before", "after", "noise_floor")},
        "covered": sum(e["covered"] for e in declared),
        "told": len(declared),
        "seconds": f"{r['seconds']:.0f}",
    }
