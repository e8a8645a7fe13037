"""How the diagnosis of one mechanism is judged against its truth, and the summary of many."""

import re
from collections import Counter, defaultdict
from statistics import median

from experiments.closeloop_scores import wilson

Option = tuple[str, frozenset[str]]  # a name and the joints (none: the base) at which it holds

FIELDS = (
    "kind",
    "seed",
    "machine",
    "mode",
    "hidden",
    "outside",
    "share",
    "absorbed",
    "verdict",
    "named",
    "hidden_count",
    "hits",
    "names",
    "right_names",
    "wrong_names",
    "outcome",
    "wrong",
    "before",
    "after",
    "seconds",
    "message",
)


def option(entry: str | dict, joints: frozenset[str]) -> Option:
    """`name`, `name@joint`, `name at joint, joint` or a table; without a place: at the joints
    given.
    """
    if isinstance(entry, dict):
        where = entry.get("joints", entry.get("joint"))
        where = [where] if isinstance(where, str) else where
        return entry["name"], joints if where is None else frozenset(where)
    name, _, where = re.sub(r"\s+at\s+", "@", entry.strip(), count=1).partition("@")
    return name.strip(), frozenset(filter(None, re.split(r"[,+\s]+", where))) or joints


def options(effect: dict, joints: list[str]) -> list[Option]:
    """What a named effect may be, at a machine with these joints: itself first, then what the
    report says does as well.
    """
    own = option(effect, frozenset())
    others = effect.get("class", effect.get("alternatives", [])) or []
    spelt = [x.replace("all joints", ",".join(joints)) if isinstance(x, str) else x for x in others]
    return [own] + [option(x, own[1]) for x in spelt]


def holds(name: str, joint: str | None, right: list[Option]) -> bool:
    """joint None: the base, which stands for whatever place."""
    return any(name == n and (joint is None or not js or joint in js) for n, js in right)


def judged(named: list[Option], right: list[Option]) -> list[bool]:
    """For each joint of a named effect (once, where it has none): whether it is right there, or
    something of its class is.
    """
    own, *others = named
    out = []
    for joint in sorted(own[1]) or [None]:
        there = [own] + [(n, js) for n, js in others if joint in js or joint is None]
        elsewhere = [
            (n, j)
            for n, js in others
            if joint is not None and joint not in js
            for j in (js or [None])
        ]
        out.append(
            any(holds(n, joint, right) for n, _ in there)
            or any(holds(n, j, right) for n, j in elsewhere)
        )
    return out


def covered(accept: list[dict], found: list[list[Option]]) -> bool:
    """Whether some accepted name is told at all joints where it must be."""
    at: dict[str, set[str]] = defaultdict(set)
    for entry in found:
        for name, joints in entry:
            at[name] |= joints or {""}
    return any(
        a["name"] in at and (not a["joints"] or set(a["joints"]) <= at[a["name"]]) for a in accept
    )


def judge(truth: dict, report: dict) -> dict[str, object]:
    """A row of `FIELDS` without seconds. Outcome: right (all hidden effects that the catalogue has,
    nothing else), partly, wrong (a name that is not there), missed; quiet and false_alarm where
    nothing is to be named.
    """
    hidden = [e for e in truth["effects"] if not e["outside"]]
    right = [
        (a["name"], frozenset(a["joints"]))
        for e in truth["effects"]
        for a in e["accept"] + e.get("also_right", [])
    ]
    named = report.get("effects", []) or []
    found = [options(e, truth["joints"]) for e in named]
    each = [b for f in found for b in judged(f, right)]
    needed = [e for e in hidden if not e.get("absorbed")]
    hits = sum(covered(e["accept"], found) for e in needed)
    wrong = sum(not b for b in each)
    if not needed:
        outcome = "false_alarm" if wrong else "quiet"
    else:
        whole = "right" if hits == len(needed) else "partly" if sum(each) else "missed"
        outcome = "wrong" if wrong and not sum(each) else whole
    error = report.get("error") or {}

    def value(x):
        return x.get("value", x.get("median")) if isinstance(x, dict) else x

    def number(x):
        return "" if x is None else f"{x:.5g}"

    def place(n, js):
        return f"{n}@{'+'.join(sorted(js)) or 'base'}"

    return {
        **{k: truth[k] for k in ("kind", "seed", "machine", "mode")},
        "hidden": " ".join(place(e["name"], e["joints"]) for e in hidden) or "nothing",
        "outside": " ".join(
            place(e["name"], e["joints"]) for e in truth["effects"] if e["outside"]
        ),
        "share": " ".join(f"{max(e['share'].values(), default=0.0):.3f}" for e in truth["effects"]),
        "absorbed": len(hidden) - len(needed),
        "verdict": report.get("verdict", ""),
        "named": " ".join("|".join(place(*o) for o in f) for f in found),
        "hidden_count": len(needed),
        "hits": hits,
        "names": len(each),
        "right_names": sum(each),
        "wrong_names": wrong,
        "outcome": outcome,
        "wrong": int(wrong > 0),
        "before": number(value(error.get("before"))),
        "after": number(value(error.get("after"))),
        "message": " ".join(str(report.get("message", "")).split()),
    }


def percent(hits: int, of: int) -> str:
    low, high = wilson(hits, of)
    return f"{hits}/{of} = {100 * hits / max(of, 1):.1f} % ({100 * low:.1f}-{100 * high:.1f})"


def summary(rows: list[dict[str, str]]) -> str:
    """Markdown: shares with 95 % Wilson intervals, by kind of world; what each effect was taken
    for.
    """
    lines = []
    for kind in sorted({r["kind"] for r in rows}):
        lines += _summary(kind, [r for r in rows if r["kind"] == kind])
    return "\n".join(lines)


def _summary(kind: str, rows: list[dict[str, str]]) -> list[str]:
    def count(key):
        return sum(int(r[key]) for r in rows)

    both = [(float(r["before"]), float(r["after"])) for r in rows if r["before"] and r["after"]]
    seconds = [float(r["seconds"]) for r in rows]
    verdicts = Counter(r["verdict"] for r in rows).most_common()
    table = [
        ("verdicts", ", ".join(f"{k} {v}" for k, v in verdicts)),
        ("worlds with a wrong name", percent(count("wrong"), len(rows))),
        (
            "all named that is to be named",
            percent(sum(r["outcome"] in ("right", "quiet") for r in rows), len(rows)),
        ),
        (
            "right and no wrong name",
            percent(
                sum(r["outcome"] in ("right", "quiet") and r["wrong"] == "0" for r in rows),
                len(rows),
            ),
        ),
        ("effects found", percent(count("hits"), count("hidden_count"))),
        ("names right", percent(count("right_names"), count("names"))),
        ("error after below before", percent(sum(a < b for b, a in both), len(both))),
        (
            "error after / before, median",
            f"{median(a / b for b, a in both if b > 0):.3f}" if both else "-",
        ),
        ("seconds, median and most", f"{median(seconds):.0f}, {max(seconds):.0f}"),
    ]
    lines = [
        f"## {kind}: {len(rows)} worlds",
        "",
        "| score | value |",
        "| --- | --- |",
        *(f"| {k} | {v} |" for k, v in table),
        "",
    ]
    for key in ("machine", "mode"):
        groups = defaultdict(list)
        for r in rows:
            groups[r[key]].append(r)
        lines += [f"| {key} | right | with a wrong name | seconds |", "| --- | --- | --- | --- |"]
        for name, g in sorted(groups.items()):
            good, bad = (
                sum(r["outcome"] in ("right", "quiet") for r in g),
                sum(int(r["wrong"]) for r in g),
            )
            lines.append(
                f"| {name} | {good}/{len(g)} | {bad}/{len(g)} | "
                f"{median(float(r['seconds']) for r in g):.0f} |"
            )
        lines.append("")
    if kind == "single":
        said: dict[str, Counter] = defaultdict(Counter)
        for r in rows:
            name = r["hidden"].split("@")[0]
            said[name][
                r["outcome"]
                if r["outcome"] in ("right", "quiet")
                else f"{r['outcome']}: {r['named'] or r['verdict']}"
            ] += 1
        lines += ["| hidden | outcome |", "| --- | --- |"]
        lines += [
            f"| {k} | {', '.join(f'{w} {n}' for w, n in v.most_common())} |"
            for k, v in sorted(said.items())
        ] + [""]
    return lines
