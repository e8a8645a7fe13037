"""Table, figures and page of a comparison whose rows are made up, with everything odd that rows may
hold.
"""

import numpy as np
import pytest

from adaptsim_jax.baselines.results import row
from adaptsim_jax.report import figures as look
from adaptsim_jax.report.adaptation_page import headline, render, write_adaptation_page
from adaptsim_jax.report.comparison import table, write_comparison
from experiments.curves import against, reward_against_trials, reward_over_iterations

METHODS = ("adaptsim", "adaptsim_state", "sysid_bayes", "sysid_point", "gradient")


@pytest.fixture(scope="module")
def results():
    rng = np.random.default_rng(0)
    rows = []
    for method in METHODS:
        for setting in ("wd", "ood-1"):
            curves = np.cumsum(rng.uniform(0, 0.1, (4, 11)), axis=1)
            if (method, setting) == ("sysid_bayes", "ood-1"):
                curves[0] = -np.inf  # one seed destabilised the target at every iteration
            found = {"mean": 3.0, "median": 2.5, "per_seed": np.ones(4)}
            params = rng.uniform(1, 2, (4, 4))
            rows.append(
                row(
                    method,
                    setting,
                    curves,
                    oracle=1.0,
                    target_trials=11,
                    discrepancy=found,
                    best_params=params,
                    failed=0,
                )
            )
    rows += [row("udr", s, np.zeros((4, 1)), oracle=1.0, target_trials=0) for s in ("wd", "ood-1")]
    settings = {"wd": {"params": [1.8, 1.2, 1.5, 1.5]}, "ood-1": {"params": [1.8, 0.3, 1.5, 1.5]}}
    return {
        "task": "pendulum",
        "seeds": 4,
        "iterations": 10,
        "starts": 2,
        "settings": settings,
        "rows": rows,
        "command": "adaptsim compare <pendulum> & more",
        "versions": {"adaptsim_jax": "0", "jax": "0"},
    }


def section(results):
    return render(results).partition("<main>")[2].partition("<footer>")[0]


def test_table_tells_failures_and_trials(results):
    text = table(results)
    lines = [line for line in text.splitlines() if line.startswith("| SysID-Bayes |")]
    assert "fails" in lines[0].split("|")[3] and "fails" not in lines[0].split("|")[2]
    assert "AdaptSim 11" in text and "UDR 0" in text
    assert "| UDR | 0.00 [0.00, 0.00]" in text


def test_a_table_that_no_command_line_made_names_none(results):
    assert "Command: `adaptsim compare <pendulum> & more`" in table(results)
    assert "Command" not in table(results | {"command": None})


def test_everything_is_written_and_again(results, tmp_path):
    first = write_comparison(results, tmp_path)
    assert [p.name for p in first] == [p.name for p in write_comparison(results, tmp_path)]
    assert {p.name for p in first} == {"results.json", "table.md", "report.html"}
    assert {p.name for p in tmp_path.iterdir()} == {p.name for p in first}


def test_page_is_self_contained_and_escaped(results, tmp_path):
    html = write_adaptation_page(results, tmp_path / "page.html").read_text()
    assert "&lt;pendulum&gt; &amp; more" in html
    assert (
        html.count("<svg") == 0
        and html.count('class="explore"') == 1
        and html.count('class="plot"') == 2
    )
    assert "src=" not in html and "href=" not in html.replace('href="data:,"', "").replace(
        'xlink:href="#', ""
    )


def test_of_one_seed_no_interval_is_told_anywhere(results):
    """Of several there is one in the table and beside the means on the page."""
    html, text = section(results), table(results)
    assert (
        "95 % interval" in html
        and "between the quartiles" in html
        and "[95 % interval of the mean]" in text
    )

    def keep(r):
        return row(
            r["method"], r["setting"], np.full((1, 11), 0.4321), oracle=1.0, target_trials=11
        )

    lone = {**results, "seeds": 1, "rows": [keep(r) for r in results["rows"]]}
    html, text = section(lone), table(lone)
    for told in (html, text):
        assert "ne seed, no interval" in told and "0.43" in told
        assert "95 %" not in told and "uartile" not in told and "ean over seeds" not in told
    assert "[" not in text and "1 seed," in text


def test_one_seed_beside_rows_of_several_says_so(results):
    lone = row("sysid_point", "wd", np.full((1, 11), 0.4321), oracle=1.0, target_trials=11)
    rows = [r for r in results["rows"] if (r["method"], r["setting"]) != ("sysid_point", "wd")]
    assert "| 0.43 (one seed) |" in table({**results, "rows": [*rows, lone]})


def test_section_without_curves(results):
    bounds = {**results, "rows": [r for r in results["rows"] if r["method"] == "udr"]}
    html = section(bounds)
    assert "<svg" not in html and "explore" not in html


def test_headline_takes_the_better_sysid():
    rows = [
        {"method": m, "setting": "wd", "mean": v}
        for m, v in (("adaptsim", 0.9), ("sysid_bayes", 0.5), ("sysid_point", 0.7))
    ]
    assert headline(rows) == "Normalized reward of AdaptSim: WD 0.90 (system identification 0.70)"
    assert "methods that ran" in headline(rows[1:])


def test_curves_show_the_median_over_seeds(results):
    figure = reward_over_iterations(results, ["adaptsim"])
    drawn = figure.axes[0].lines[0].get_ydata()
    np.testing.assert_allclose(
        drawn, next(r for r in results["rows"] if r["method"] == "adaptsim")["curve"]["median"]
    )


def test_sweep_figures_draw_what_they_are_given(results):
    rows = [r for r in results["rows"] if r["method"] == "adaptsim"]
    panel = against({"adaptsim": rows}, ["left", "right"], "range").axes[0]
    np.testing.assert_allclose(panel.lines[0].get_ydata(), [r["mean"] for r in rows])
    panels = {"wd": [{"trials": [1, 2], "so_far": [0.1, 0.4], "method": "N = 1"}]}
    np.testing.assert_allclose(
        reward_against_trials(panels).axes[0].lines[0].get_ydata(), [0.1, 0.4]
    )


def test_every_method_has_its_own_colour_and_name():
    from adaptsim_jax.baselines.registry import exact_methods

    assert (
        len({look.colour(m) for m in exact_methods()})
        == len(exact_methods())
        == len({look.label(m) for m in exact_methods()})
    )
