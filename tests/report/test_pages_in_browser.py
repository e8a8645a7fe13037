"""The pages in headless Chromium: plots are drawn, tables sort, nothing is fetched, nothing is
wider than a phone.
"""

from pathlib import Path

import pytest

from adaptsim_jax.report.adaptation_page import write_adaptation_page
from adaptsim_jax.report.diagnosis import write_diagnosis
from adaptsim_jax.report.sweep_page import write_sweep_page
from tests.report.browser import CHROMIUM, Browser
from tests.report.diagnosis_cases import REPORTS, evidence
from tests.report.sweep_cases import made
from tests.report.test_comparison import results  # noqa: F401  (a fixture)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine"),
]
CHOOSE = (
    "Object.assign(document.querySelectorAll('#held-out select')[{}], {{value: "
    "'1'}}).dispatchEvent(new Event('change'))"
)
PLOTS = {"diagnosis": 1, "comparison": 2, "sweep": 2}


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture(scope="module")
def pages(tmp_path_factory, results) -> dict[str, Path]:  # noqa: F811
    out = tmp_path_factory.mktemp("pages")
    write_diagnosis(out, REPORTS["explained"](), evidence("explained"))
    (out / "sweep").mkdir()
    return {
        "diagnosis": out / "report.html",
        "comparison": write_adaptation_page(results, out / "comparison.html"),
        "sweep": write_sweep_page(made(), out / "sweep"),
    }


@pytest.mark.parametrize("name", PLOTS)
@pytest.mark.parametrize("dark", [False, True])
def test_plots_are_drawn_and_nothing_is_fetched(browser, pages, name, dark):
    browser.show(pages[name], dark=dark)
    assert browser.run("document.querySelectorAll('.js-plotly-plot').length") == PLOTS[name]
    drawn = (
        "[...document.querySelectorAll('.js-plotly-plot')].every(p => "
        "p.querySelectorAll('.scatterlayer path').length > 0)"
    )
    assert browser.run(drawn)
    assert browser.errors == []
    assert [url for url in browser.asked if not url.startswith(("file:", "data:", "blob:"))] == []


@pytest.mark.parametrize("name", PLOTS)
def test_nothing_is_wider_than_a_phone(browser, pages, name):
    browser.show(pages[name], width=400)
    assert browser.run(
        "document.documentElement.scrollWidth <= document.documentElement.clientWidth"
    )
    plots = "[...document.querySelectorAll('.js-plotly-plot')]"
    right = "p.querySelector('.main-svg').getBoundingClientRect().right"
    assert browser.run(f"Math.max(...{plots}.map(p => {right}))") <= 400
    # a legend of many names must leave room for the lines
    assert browser.run(f"Math.min(...{plots}.map(p => p._fullLayout._size.h))") > 120
    assert browser.errors == []


def column(browser, table, index):
    return browser.run(
        f"[...document.querySelector('{table}').tBodies[0].rows].filter(r => !r.hidden).map(r => "
        f"r.cells[{index}].innerText.trim())"
    )


def test_candidates_sort_by_a_click_and_the_rest_unfolds(browser, pages):
    browser.show(pages["diagnosis"])
    table, press = (
        "#candidates table",
        "document.querySelectorAll('#candidates th button')[{}].click()",
    )
    total = len(REPORTS["explained"]()["candidates"])
    assert len(column(browser, table, 0)) == 8 < total
    browser.run("document.querySelector('#candidates .more').click()")
    first = column(browser, table, 0)
    assert len(first) == total
    browser.run(press.format(0))
    assert column(browser, table, 0) == sorted(first, key=str.lower)
    browser.run(press.format(2))
    gains = [row["held_out_gain"] for row in REPORTS["explained"]()["candidates"]]
    shown = browser.run(
        f"[...document.querySelectorAll('{table} tbody tr')].map(r => Number(r.cells[2].dataset.v))"
    )
    assert shown == sorted(gains, reverse=True)
    browser.run(press.format(2))
    shown = browser.run(
        f"[...document.querySelectorAll('{table} tbody tr')].map(r => Number(r.cells[2].dataset.v))"
    )
    assert shown == sorted(gains)
    assert browser.run("document.querySelectorAll('#candidates th[aria-sort]').length") == 1


@pytest.mark.parametrize(
    ("name", "table", "index"),
    [("comparison", "#adaptation table", 1), ("sweep", "#combinations table", 3)],
)
def test_other_tables_sort_too_and_what_has_no_number_comes_last(
    browser, pages, name, table, index
):
    browser.show(pages[name])
    browser.run(f"document.querySelectorAll('{table} th button')[{index}].click()")
    shown = [float(text.split()[0]) for text in column(browser, table, index)]
    assert shown == sorted(shown, reverse=True) and len(shown) > 4


def test_selectors_draw_another_trial_and_signal(browser, pages):
    browser.show(pages["diagnosis"])
    first = "document.querySelector('#held-out .plot').data[0].y.slice(0, 50).join()"
    before, note = (
        browser.run(first),
        browser.run("document.querySelector('#held-out .said').innerText"),
    )
    assert "declared" in note and "mended" in note
    browser.run(CHOOSE.format(0))
    trial = browser.run(first)
    browser.run(CHOOSE.format(1))
    assert len({before, trial, browser.run(first)}) == 3
    title = browser.run("document.querySelector('#held-out .plot').layout.yaxis.title.text")
    assert title == "q2, rad"


def test_plots_follow_the_colour_scheme(browser, pages):
    browser.show(pages["diagnosis"])
    ink = "document.querySelector('#held-out .plot').layout.font.color"
    light = browser.run(ink)
    browser.scheme(dark=True)
    browser.until(f"{ink} !== '{light}'")
    assert browser.run("document.querySelector('#held-out .plot').data[1].line.color") == "#f0924d"


def test_a_zoom_in_time_stays_for_the_next_signal_and_goes_with_the_trial(browser, pages):
    browser.show(pages["diagnosis"])
    plot = "document.querySelector('#held-out .plot')"
    browser.run(f"Plotly.relayout({plot}, {{'xaxis.range': [1, 2]}}).then(() => 0)")
    browser.run(CHOOSE.format(1))
    assert browser.run(f"{plot}.layout.xaxis.range") == [1, 2]
    browser.run(CHOOSE.format(0))
    assert browser.run(f"{plot}._fullLayout.xaxis.range[0]") < 1
