"""Numbers as text: digits, prefixes, intervals; thinned series keep their gaps; colours follow the
page.
"""

import numpy as np
import pytest

from adaptsim_jax.report import diagnosis_figures as svg
from adaptsim_jax.report import diagnosis_format as fmt
from adaptsim_jax.report import diagnosis_words as words
from adaptsim_jax.report.diagnosis_explore import held_out
from adaptsim_jax.report.diagnosis_rows import declared_rows, effect_rows


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (float("nan"), "–"),
        (0.0, "0"),
        (3.14159, "3.14"),
        (-0.0123, "−0.0123"),
        (0.9999, "1.00"),
        (99949.0, "99949"),
        (123456.0, "1.23×10⁵"),
        (0.000421, "4.21×10⁻⁴"),
    ],
)
def test_number(value, text):
    assert fmt.number(value) == text


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0141, "rad", "14.1 mrad"),
        (0.5, "rad", "0.500 rad"),
        (2.1e-5, "s", "21.0 µs"),
        (0.03, "Nm", "30.0 mN·m"),
        (0.0008, "N*m*s/rad", "0.800 mN·m·s/rad"),
        (0.05, "kg m^2", "0.0500 kg·m²"),
        (0.05, "m^2", "0.0500 m²"),
        (0.25, "1", "0.250"),
        (None, "rad", "–"),
    ],
)
def test_quantity(value, unit, text):
    assert fmt.quantity(value, unit) == text


@pytest.mark.parametrize(
    ("row", "text"),
    [
        ((0.0312, 0.0287, 0.0338, "N m"), "31.2 [28.7, 33.8] mN·m"),
        ((0.118, 0.109, 0.127, "N m"), "0.118 [0.109, 0.127] N·m"),
        ((1.234, -50.0, 90.0, "kg"), "1 [−50, 90] kg"),
        ((3.12e-5, -1e-5, 5e-5, "kg m^2"), "3.1 [−1.0, 5.0] ×10⁻⁵ kg·m²"),
        ((9.81, 9.81, 9.81, "m/s^2"), "9.81 [9.81, 9.81] m/s²"),
        ((0.0, 0.0, 0.0, "rad"), "0 [0, 0] rad"),
        ((0.5, None, 0.7, "rad"), "0.500 rad"),
    ],
)
def test_between(row, text):
    assert fmt.between(*row) == text


@pytest.mark.parametrize("seed", range(3))
def test_an_interval_reads_back_to_what_it_was(seed):
    """Rounding moves no end by more than a third of the half width, or 1 in 10^4 of the value."""
    rng = np.random.default_rng(seed)
    for _ in range(200):
        value, half = rng.normal() * 10 ** rng.uniform(-6, 6), 10 ** rng.uniform(-7, 6)
        text = fmt.between(value, value - half, value + half, "").replace("−", "-")
        body, _, power = text.partition(" ×10")
        scale = (
            10.0 ** int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")))
            if power
            else 1.0
        )
        numbers = [
            scale * float(x)
            for x in body.replace("[", "").replace("]", "").replace(",", "").split()
        ]
        error = np.abs(np.array(numbers) - [value, value - half, value + half])
        assert np.all(error <= 0.34 * half + 1e-4 * (abs(value) + half)), (text, value, half)


def test_percent_never_rounds_to_all_or_nothing():
    assert fmt.percent(0.9996) == "99.9 %" and fmt.percent(0.0004) == "< 0.1 %"
    assert (
        fmt.percent(1.0) == "100 %"
        and fmt.percent(0.0) == "0.0 %"
        and fmt.percent(-0.008) == "−0.8 %"
    )


def test_p_values_and_lists():
    assert (
        fmt.p_value(2e-5) == "< 0.001"
        and fmt.p_value(0.032) == "0.032"
        and fmt.p_value(None) == "–"
    )
    assert fmt.listing(["a", "b", "c"], "or") == "a, b or c" and fmt.listing([]) == ""
    assert fmt.count(1, "trial") == "1 trial" and fmt.count(7200, "sample") == "7,200 samples"


def test_names_read_as_words():
    assert (
        words.plain("coulomb_friction") == "Coulomb friction"
        and words.plain("joint12") == "joint 12"
    )
    assert (
        words.effect_name({"name": "bias", "where": "joint2", "alternatives": ["tilt"]})
        == "bias or tilt at joint 2"
    )
    both = {"name": "torque_gain", "where": "joint1", "alternatives": ["torque_gain@joint2"]}
    assert words.effect_name(both) == "torque gain at joint 1 or torque gain at joint 2"


def test_improvement_counts_down_to_the_noise_floor():
    assert words.improvement({"before": 10.0, "after": 4.0, "noise_floor": 2.0}) == {
        "change": "60 % less",
        "closed": "75 %",
    }
    assert words.improvement({"before": 4.0, "after": 5.0, "noise_floor": 2.0}) == {
        "change": "25 % more",
        "closed": None,
    }
    assert words.improvement({"before": 4.0, "after": None}) == {"change": None, "closed": None}


def test_thinned_series_keep_their_gaps_and_their_length():
    time, values = np.arange(3000.0), np.sin(np.arange(3000.0))
    values[1501] = np.nan
    short_time, short = svg.thin(time, values, most=700)
    assert len(short) <= 700 and len(short) == len(short_time)
    assert np.isnan(short).sum() == 1 and abs(short_time[np.isnan(short)][0] - 1501) < 5
    assert svg.thin(time[:10])[0].tolist() == time[:10].tolist()


def test_figures_take_their_colours_from_the_page():
    text = svg.draw(
        lambda figure: figure.subplots().plot([0, 1], color=svg.AFTER), 2.0, 'a "figure" & more'
    )
    assert "var(--after)" in text and svg.AFTER not in text
    assert 'aria-label="a &quot;figure&quot; &amp; more"' in text and not text.startswith("<?xml")


def test_declared_parameters_stand_beside_the_model_files_and_combinations_are_explained():
    row = {"value": 0.0552, "low": 0.055, "high": 0.0554, "unit": "kg m^2", "identifiable": True}
    table = {"before": {"inertia about J": row | {"file": 0.0498}, "p1": row}, "after": {}}
    of_machine, other = declared_rows({"task": "mechanism", "declared": table})
    assert (of_machine["file"], other["file"], other["note"]) == ("0.0498 kg·m²", "", "")
    assert "I1 + m1 lc1²" in declared_rows({"task": "pendulum", "declared": table})[1]["note"]


def test_names_that_the_report_lists_already_are_not_listed_again_and_many_are_counted():
    loose = {"value": 0.0, "low": None, "high": None, "unit": "kg", "identifiable": False}
    report = {
        "effects": [],
        "verdict": "explained",
        "declared": {"before": {"m1": loose, "m2": loose}, "after": {}},
    }
    said = "m1, m2 one by one: the motion fixes only the combinations listed."
    assert (
        sum("m1" in line for line in words.not_established(report | {"not_established": [said]}))
        == 1
    )
    report["declared"]["before"] = {f"mass of {k}": loose for k in range(18)}
    assert words.not_established(report)[0].startswith(
        "The values of 18 numbers listed under Declared parameters:"
    )


def test_the_joint_that_is_furthest_off_is_shown_first():
    flat = np.zeros(5)
    trial = {
        "trial": "a",
        "time": np.arange(5.0),
        "measured": {"shoulder": flat, "elbow": flat},
        "after": None,
    }
    trial |= {
        "before": {"shoulder": flat + 0.1, "elbow": flat + 1.0},
        "units": {"shoulder": "rad", "elbow": "rad"},
    }
    channels = {
        name: {"before": size, "unit": "rad"} for name, size in (("shoulder", 0.1), ("elbow", 1.0))
    }
    html, _ = held_out([trial], {"per_channel": channels, "per_trial": []})
    assert html.index(">elbow</option>") < html.index(">shoulder</option>")


def test_a_gain_is_read_as_a_factor():
    """report.json has what it is more than 1 by; of parameters of other effects nothing is
    changed.
    """
    found = {"value": -0.3, "low": -0.31, "high": -0.29, "unit": "1"}
    rows = [
        {
            "name": "torque_gain",
            "where": "joint1",
            "alternatives": [],
            "parameters": {"gain": found},
        },
        {"name": "own", "where": "joint1", "alternatives": [], "parameters": {"gain": found}},
        {
            "name": "camera_scale",
            "where": "",
            "alternatives": [],
            "parameters": {"scale": found | {"low": None}},
        },
    ]
    texts = [
        (p["name"], p["value"]) for row in effect_rows({"effects": rows}) for p in row["parameters"]
    ]
    assert dict(texts) == {
        "gain (1: none)": "0.700 [0.690, 0.710]",
        "gain": "−0.300 [−0.310, −0.290]",
        "scale (1: none)": "0.700",
    }


@pytest.mark.parametrize(
    ("skill", "begins"),
    [(0.2, "Do not rely on the mended model yet: at best it is 20 %"), (0.9, "Use")],
)
def test_a_model_that_hardly_beats_a_straight_line_is_not_recommended(skill, begins):
    mended = {"stretches": {"skill": -0.3}, "torque": {"skill": skill}}
    report = {"verdict": "partly_explained", "effects": [{}], "yardsticks": {"mended": mended}}
    assert words.todo(report).startswith(begins)
