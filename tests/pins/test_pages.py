"""The page of each pinned report: its markup whole, figures by what they name and how many curves
they have.

The arrays behind a page are pinned by `test_reports`, four numbers each. Waves of the same lengths
stand in for them here.
"""

import json
import re
from collections import Counter
from typing import Any

import numpy as np
import pytest

from adaptsim_jax.report import explore
from adaptsim_jax.report.diagnosis import render
from tests.pins.stored import FOLDER, check
from tests.report.diagnosis_cases import REPORTS
from tests.report.diagnosis_cases import evidence as invented

PINNED = {
    "tree": "motors_stretches",
    "balance": "motors_torque_armature_coulomb",
    "pendulum": "pendulum",
    "mujoco": "mujoco",
    "short trials": "tanks",
    "scoops": "scoops",
    "tosses": "toss",
}
"""Kind of diagnosis -> a report that is pinned."""
RUN = {"command": "adaptsim diagnose LOG", "version": "0", "seed": 0, "seconds": 1.0}
PLANE = 2  # coordinates of a track
SCAFFOLD = ("grid", "muted")  # colours of what stands about curves: ticks, lines of a grid
TRACE = ("name", "mode", "visible", "showlegend", "hovertemplate")
VERDICTS = ("data_fault", "explained", "within_noise")
"""Invented reports whose pages have sections that no pinned one has: an audit that comes first, a
reward, the next experiment, what would have been found.
"""


@pytest.fixture(autouse=True)
def light(monkeypatch):
    """Without the megabytes of Plotly, which every page holds."""
    monkeypatch.setattr(explore, "plotly", lambda: "plotly")


def wave(size: int, level: float) -> np.ndarray:
    """An array [size] of about a size, the same each time."""
    return level * np.sin(0.3 + 0.1 * np.arange(size))


def stand_in(z: Any, key: str = "") -> Any:
    """Stored evidence with waves in the place of arrays; time goes on evenly."""
    if isinstance(z, dict):
        return {k: stand_in(v, k) for k, v in z.items()}
    if not isinstance(z, list):
        return z
    if len(z) == 4 and all(isinstance(n, float) for n in z):
        size, level = int(z[0]), z[1]
        return 0.01 * np.arange(size) if key == "time" else wave(size, level)
    return [stand_in(v, key) for v in z]


def evidence_of(stored: dict[str, Any]) -> dict[str, Any]:
    """What a page gets, of a pinned report."""
    evidence = stand_in(stored["evidence"]) | {"run": RUN}
    if "tracks" in evidence:
        tracks = evidence["tracks"]
        for stage in {"measured", "before", "after"} & set(tracks):
            rows = tracks[stage] or []
            tracks[stage] = [z.reshape(-1, PLANE) for z in rows] or None
    return evidence


def drawn(svg: str) -> str:
    """A figure in words: its label, size, what is written in it but numbers, curves and marks by
    colour.
    """
    head = re.search(r'viewBox="([^"]*)".*?aria-label="([^"]*)"', svg)
    assert head
    words = [t for t in re.findall(r"<text[^>]*>([^<]*)</text>", svg) if re.search("[a-zA-Z]", t)]
    curves = Counter(re.findall(r"<(path [^>]*clip-path|use )[^>]*?var\(--(\w+)\)", svg))
    counts = {
        f"{kind.split()[0]} {colour}": number
        for (kind, colour), number in sorted(curves.items())
        if colour not in SCAFFOLD
    }
    return f"<svg {head[2]}: {head[1]}; {words}; {counts}>"


def explored(found: re.Match[str]) -> str:
    """What each choice of an explorer shows: its note, titles, and traces by name with their
    lengths.
    """
    table = json.loads(found[1])
    lines = []
    for key, view in table["views"].items():
        lines.append(f"<view {key} {view['note']}>")
        for figure in view["figures"]:
            layout = figure["layout"]
            axes = {k: v.get("title") for k, v in layout.items() if "axis" in k}
            lines.append(f"<figure {layout['title']} {axes}>")
            for trace in figure["data"]:
                ends = [_length(trace[k], table["columns"]) for k in ("x", "y")]
                style = [trace[k] for k in TRACE if k in trace]
                lines.append(f"<trace {ends} {style}>")
    return "\n".join(lines)


def _length(z: Any, columns: dict[str, list[float]]) -> int:
    return len(columns[z[1:]] if isinstance(z, str) else z)


def outline(page: str) -> list[str]:
    """The body of a page in lines, one for each element with text in it."""
    body = page[page.index("<main>") : page.index("</main>")]
    body = re.sub(r"<svg.*?</svg>", lambda found: drawn(found[0]), body, flags=re.S)
    body = re.sub(
        r'<script type="application/json">(.*?)</script>',
        lambda found: explored(found) + "\n",
        body,
        flags=re.S,
    )
    lines = re.sub(r"(</(tr|p|div|section|h1|h2|ul|label)>)", r"\1\n", body).splitlines()
    return [line.strip() for line in lines if line.strip()]


@pytest.mark.parametrize("name", PINNED.values(), ids=PINNED)
def test_the_page_of_a_pinned_report_is_the_same(name, tmp_path):
    stored = json.loads((FOLDER / f"report_{name}.json").read_text())
    for file in stored["files"]:
        (tmp_path / file).touch()
    page = render(stored["report"], evidence_of(stored), tmp_path)
    check(f"page_{name}", outline(page))


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_page_of_an_invented_report_is_the_same(verdict):
    page = render(REPORTS[verdict](), invented(verdict) | {"run": RUN})
    check(f"page_verdict_{verdict}", outline(page))
