"""Plots to explore: numbers thinned and rounded, nothing fetched, nothing a name can break out of,
no cost where no page is made.
"""

import json
import re
import subprocess
import sys

import numpy as np
import pytest

from adaptsim_jax.report import diagnosis_explore, explore, sweep_page
from adaptsim_jax.report.diagnosis import render
from adaptsim_jax.report.explore import Plot, SharedColumns, View
from tests.report.diagnosis_cases import REPORTS, evidence
from tests.report.sweep_cases import made
from tests.report.test_diagnosis_page import Page

ERROR = {"per_trial": [], "per_channel": {}}


def data_of(html):
    """What the explorers of a page draw from."""
    return [
        json.loads(text)
        for text in re.findall(r'<script type="application/json">(.*?)</script>', html)
    ]


def trials(count, samples, channels=("q1",)):
    time = np.linspace(0.0, 10.0, samples)

    def wave(a):
        return {c: a * np.sin(time + k) for k, c in enumerate(channels)}

    return [
        {
            "trial": f"{i:02d}",
            "time": time,
            "measured": wave(1.0),
            "before": wave(0.9),
            "after": wave(0.99),
        }
        for i in range(count)
    ]


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([0.0, 1.0, 0.123456789], [0.0, 1.0, 0.12346]),
        ([np.nan, np.inf, 2.0], [None, None, 2.0]),
        ([], []),
        ([-1e-9, 1.0], [0.0, 1.0]),
    ],
)
def test_numbers_are_rounded_to_a_part_of_their_span_and_gaps_are_null(values, expected):
    assert explore.numbers(values) == expected


def test_numbers_keep_what_a_small_residual_needs():
    values = 1.0 + 1e-6 * np.arange(50.0)
    assert np.max(np.abs(np.array(explore.numbers(values, 1e-8)) - values)) <= 0.5e-8


def test_a_trace_has_at_most_two_thousand_points_and_a_plot_of_many_trials_fewer():
    assert explore.points([50_000] * 4, 5) == (2000, 4)
    most, kept = explore.points([50_000] * 60, 22)
    assert 200 <= most < 2000 and kept == 60 and 60 * 22 * most <= explore.MOST_NUMBERS
    most, kept = explore.points([50_000] * 2000, 22)
    assert most == 200 and kept < 2000


def test_the_whole_plot_of_many_long_trials_keeps_a_page_small():
    html, left_out = diagnosis_explore.held_out(
        trials(40, 20_000, ("a", "b", "c", "d", "e", "f", "g")), ERROR
    )
    assert left_out == 0 and len(html) + len(explore.script()) < 5_500_000


def test_every_trial_and_channel_is_drawn_measured_simulated_and_their_difference():
    html, _ = diagnosis_explore.held_out(trials(3, 500, ("q1", "q2")), ERROR)
    (found,) = data_of(html)
    assert set(found["views"]) == {f"{i},{j}" for i in range(3) for j in range(2)}
    figure = found["views"]["2,1"]["figures"][0]
    models = [
        name for model in ("declared model", "mended model") for name in (model, f"{model}: error")
    ]
    assert [t["name"] for t in figure["data"]] == ["measured", *models]
    below = figure["data"][2]["y"]
    a, b = (np.array(found["columns"][name[1:]]) for name in below["minus"])
    np.testing.assert_allclose(a - b, 0.1 * np.sin(np.linspace(0, 10, 500) + 1), atol=1e-3)
    assert "<select>" in html and html.count("<option") == 5


def test_without_a_mended_model_none_is_drawn_and_one_choice_is_no_choice():
    html, _ = diagnosis_explore.held_out([t | {"after": None} for t in trials(1, 50)], ERROR)
    assert "mended" not in html and html.count("<label hidden") == 2


def test_tracks_are_one_line_a_model_broken_between_trials():
    track = np.stack([np.linspace(0, 0.5, 30), np.linspace(0, 0.1, 30)], 1)
    (found,) = data_of(
        diagnosis_explore.tracks(
            {"measured": [track, track + 0.2], "before": [track, track], "axes": ("x", "z")}
        )
    )
    figure = found["views"][""]["figures"][0]
    assert [t["name"] for t in figure["data"] if t["mode"] == "lines"] == [
        "measured",
        "declared model",
    ]
    line = found["columns"][figure["data"][0]["x"][1:]]
    assert (
        len(line) == 62
        and line[30] is None
        and figure["layout"]["yaxis"]["title"]["text"] == "z, m"
    )
    assert diagnosis_explore.tracks({}) == ""


def test_thinned_traces_say_so():
    (found,) = data_of(diagnosis_explore.held_out(trials(1, 9000), ERROR)[0])
    assert "one in 5 of 9,000 samples" in found["views"]["0,0"]["note"]
    assert max(map(len, found["columns"].values())) == 1800


def test_names_cannot_end_the_script_nor_be_read_as_markup():
    odd = "</script><b>a</b>&amp;"
    columns = SharedColumns()
    html = explore.explorer(
        {odd: [odd, "b"]}, {(0,): View([{"data": []}], odd)}, [Plot(odd)], columns
    )
    Page(html)
    assert html.count("</script>") == 1 and "<b>" not in html
    assert data_of(html)[0]["views"]["0"]["note"] == odd
    trial = trials(1, 50, (odd,))[0] | {"trial": odd}
    html, _ = diagnosis_explore.held_out([trial], ERROR)
    assert "<b>" not in html
    assert (
        "&lt;b&gt;"
        in data_of(html)[0]["views"]["0,0"]["figures"][0]["layout"]["yaxis"]["title"]["text"]
    )


def test_a_page_holds_one_plotly_and_fetches_nothing():
    tracks = {"measured": [np.zeros((5, 2))], "before": [np.ones((5, 2))], "after": None}
    html = render(REPORTS["explained"](), evidence("explained") | {"tracks": tracks})
    assert html.count('id="plotly"') == 1 and html.count('class="explore"') == 2
    assert (
        not re.findall(r"https?://", html.replace("http://www.w3.org/1999/xlink", ""))
        and "src=" not in html
    )
    assert len(html) < 6_000_000


def test_where_nothing_is_drawn_plotly_is_left_out():
    assert len(render(REPORTS["data_fault"](), {})) < 100_000


def test_without_plotly_the_page_says_what_to_install(monkeypatch):
    monkeypatch.setattr(explore, "plotly", lambda: None)
    page = Page(render(REPORTS["explained"](), evidence("explained")))
    assert "pip install plotly" in page.text and "The declared model lacks" in page.text


def test_page_of_a_sweep_says_what_was_best_and_what_failed():
    found = made()
    html = sweep_page.render(found)
    page = Page(html)
    assert (
        "23 of 26 members done, 1 failed, 2 left" in page.text
        and "a loss <is> not finite" in page.text
    )
    assert "<b>plain" not in html and not re.findall(r"https?://", html) and len(html) < 6_000_000
    over, curves = data_of(html)
    assert (
        set(over["views"]) == {"0", "1"} and len(curves["views"]) == 7
    )  # medians, and six combinations
    assert "best in training" in page.text and "delta 0.15, scaling paper" in page.text


def test_page_of_a_sweep_that_has_only_begun():
    found = made() | {"rows": [], "summary": [], "done": 0, "failed": 0}
    assert "0 of 26 members done, 26 left" in Page(sweep_page.render(found)).text
    Page(sweep_page.render(made(targets=(), seeds=1, deltas=(0.1,), choices=("paper",))))


def test_pages_of_very_many_members_stay_small():
    found = made(
        seeds=2, rounds=2000, deltas=tuple(0.1 + 0.001 * i for i in range(80)), choices=("a", "b")
    )
    html = sweep_page.render(found)
    assert len(html) < 6_000_000 and "the best 10 of 160" in html


def test_plotly_is_never_imported_and_read_only_for_a_page():
    code = (
        "import sys; from adaptsim_jax.report import diagnosis, comparison, sweep_page, explore\n"
        "assert explore.plotly.cache_info().currsize == 0; explore.plotly(); print('plotly' in "
        "sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
