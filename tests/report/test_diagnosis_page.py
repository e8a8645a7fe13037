"""Page and files of a diagnosis: whole for every verdict, self-contained, honest about what is not
there.
"""

import io
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from rich.console import Console

from adaptsim_jax.diagnosis.schema import VERDICTS, ReportError, read_report
from adaptsim_jax.report.diagnosis import print_summary, render, write_diagnosis
from adaptsim_jax.report.diagnosis_words import effect_name, headline
from tests.report.diagnosis_cases import REPORTS, evidence, held_out

VOID = {"meta", "link", "br", "img", "hr", "input"}


class Page(HTMLParser):
    """Checks that tags nest, and gathers text, addresses and ids."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open, self.addresses, self.ids, self.words, self.titles = [], [], [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        found = dict(attrs)
        self.addresses += [
            found[key] for key in ("href", "src", "xlink:href", "action") if key in found
        ]
        self.ids += [found["id"]] if "id" in found else []

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"style", "svg", "script"} & set(self.open):
            self.words.append(data)
        if self.open and self.open[-1] == "h2":
            self.titles.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Every verdict's folder, written once, with its page parsed."""
    folders = {}
    for verdict, report in REPORTS.items():
        out = tmp_path_factory.mktemp(verdict)
        found = evidence(verdict)
        found["held_out"] = found.get("held_out", [])[:1]
        if report()["next_experiment"]:
            (out / "next_experiment.csv").write_text("time,tau1,tau2\n")
        if report()["effects"]:
            (out / "model.toml").write_text("[effects]\n")
        write_diagnosis(out, report(), found)
        folders[verdict] = (out, Page((out / "report.html").read_text()))
    return folders


def test_fixtures_cover_every_verdict():
    assert tuple(REPORTS) == VERDICTS


@pytest.mark.slow
@pytest.mark.parametrize("verdict", VERDICTS)
def test_page_is_self_contained(written, verdict):
    out, page = written[verdict]
    for address in page.addresses:
        assert address.startswith("#") or address == "data:," or (out / address).exists(), address
    html = (out / "report.html").read_text()
    assert "@import" not in html and "src=" not in html
    links = re.findall(r"https?://[^\"' )]+", html)
    assert set(links) <= {"http://www.w3.org/1999/xlink"}  # a namespace's name, never fetched
    for used in re.findall(r"url\(#([^)]+)\)", html):
        assert used in page.ids
    assert len(page.ids) == len(set(page.ids))
    assert (out / "report.html").stat().st_size < 3_000_000  # two of them Plotly, packed


@pytest.mark.parametrize("verdict", VERDICTS)
def test_page_says_the_verdict_and_the_message(written, verdict):
    out, page = written[verdict]
    report = read_report(out / "report.json")
    assert report["verdict"] == verdict
    assert " ".join(report["message"].split()) in page.text
    assert "How this was made" in page.titles and "adaptsim diagnose recordings/rig" in page.text
    assert "nan" not in page.text.lower().split() and "None" not in page.text


@pytest.mark.parametrize(
    ("verdict", "sentence"),
    [
        ("explained", "The declared model lacks Coulomb friction at joint 1."),
        (
            "explained_class",
            "The declared model lacks constant bias, base tilt or encoder offset at joint 1",
        ),
        ("structured_unattributed", "Coulomb friction at joint 1 found, and something more"),
        ("within_noise", "The declared model explains these data to within the noise."),
        ("data_fault", "The data must be mended before a model can be judged."),
    ],
)
def test_headlines(written, verdict, sentence):
    assert sentence in written[verdict][1].text


def test_within_noise_says_how_much_is_left_where_that_is_far_more_than_the_sensors():
    report = REPORTS["within_noise"]()
    report["error"] |= {"before": 17.0e-4, "noise_floor": 1.0e-4}
    assert "17 times the sensors' noise" in headline(report)
    report["error"]["before"] = 1.1e-4
    assert headline(report) == "The declared model explains these data to within the noise."


def test_numbers_are_for_people(written):
    text = written["explained"][1].text
    assert "31.2 [28.7, 33.7] mN·m" in text
    assert "14.1 [12.3, 16.4] mrad" in text
    assert not re.search(r"\d\.\d{6}", text)


def test_no_number_is_shown_for_what_the_data_do_not_fix(written):
    _, page = written["explained"]
    assert "not identifiable" in page.text
    assert "0.63 [" not in page.text and "0.630" not in page.text
    assert "The value of m2" in page.text


def test_nothing_is_called_mended_where_nothing_was(written):
    for verdict in ("within_noise", "data_fault"):
        assert "mended model" not in written[verdict][1].text, verdict


def test_an_after_without_an_effect_is_not_an_improvement():
    report, found = REPORTS["within_noise"](), {}
    report["error"]["after"] = 0.5 * report["error"]["before"]
    page = Page(render(report, found))
    assert "% less" not in page.text and "mended" not in page.text


def test_a_fault_puts_the_audit_first(written):
    titles = written["data_fault"][1].titles
    assert titles[0] == "Audit of the data"
    assert written["explained"][1].titles.index("Audit of the data") > 3
    assert "gap of 0.412 s" in written["data_fault"][1].text


def test_ladder_shows_every_candidate_and_its_reason(written):
    report, text = REPORTS["explained"](), written["explained"][1].text
    for row in report["candidates"]:
        assert row["why"] in text
    for status in ("accepted", "rejected"):
        assert status in text
    assert "look-alike" in written["explained_class"][1].text


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_evidence_key_may_be_missing(verdict):
    page = Page(render(REPORTS[verdict](), {}))
    assert " ".join(REPORTS[verdict]()["message"].split()) in page.text


def test_every_evidence_key_may_come_alone():
    full = evidence("structured_unattributed")
    full["held_out"] = full["held_out"][:1]
    report = REPORTS["structured_unattributed"]()
    report["error"] |= {"before": None, "per_channel": {}}  # its figures are drawn elsewhere
    for key, value in full.items():
        Page(render(report, {key: value}))


def test_poor_evidence_is_drawn_without_a_warning():
    gaps = np.full(50, np.nan)
    bad = {
        "held_out": [
            {
                "trial": "a",
                "time": np.arange(50.0),
                "measured": {"q1": gaps},
                "before": {},
                "after": None,
            }
        ],
        "tracks": {
            "measured": [np.full((5, 2), np.nan)],
            "before": [np.zeros((5, 2))],
            "after": None,
        },
        "audit": [{"severity": "note", "message": "one"}],
        "run": {},
    }
    with np.errstate(all="raise"):
        page = Page(render(REPORTS["explained"](), bad))
    assert "Tracks from above" in page.titles


def test_finer_shapes_that_stayed_at_zero_are_not_listed_as_found():
    report = REPORTS["explained"]()
    zero, fitted = (
        {"value": 0.0, "low": low, "high": high, "unit": "rad/s"}
        for low, high in ((0.0, 0.0), (0.0, 0.1))
    )
    report["effects"][0]["parameters"] |= {"softness": zero, "width": fitted}
    text = Page(render(report, {})).text
    assert "width" in text and "softness" not in text


def test_text_from_files_is_escaped():
    report = REPORTS["explained"]()
    report["message"] = "<script>alert(1)</script> & co"
    trial = held_out(True, trials=1)[0] | {"trial": "$a<b$&c"}
    html = render(report, {"held_out": [trial], "run": {"command": "<b>x</b>"}})
    assert "<script>alert" not in html and "<b>x</b>" not in html
    Page(html)
    assert "$a&lt;b$&amp;c" in html


def test_a_bad_report_leaves_the_old_files_alone(tmp_path):
    write_diagnosis(tmp_path, REPORTS["data_fault"](), {})
    old = (tmp_path / "report.json").read_bytes()
    with pytest.raises(ReportError, match="verdict"):
        write_diagnosis(tmp_path, REPORTS["explained"]() | {"verdict": "certain"}, {})
    assert (tmp_path / "report.json").read_bytes() == old
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "report.json"]


def test_nan_becomes_null(tmp_path):
    report = REPORTS["explained"]()
    report["error"]["noise_floor"] = float("nan")
    report["candidates"][0]["held_out_gain"] = np.float32("inf")
    report["extra"] = {"matrix": np.array([[1.0, np.nan]])}
    write_diagnosis(tmp_path, report, {})

    def refuse(literal):
        raise AssertionError(literal)

    read = json.loads((tmp_path / "report.json").read_text(), parse_constant=refuse)
    assert read["error"]["noise_floor"] is None and read["extra"]["matrix"] == [[1.0, None]]


@pytest.mark.parametrize("verdict", VERDICTS)
def test_summary(written, verdict):
    out, _ = written[verdict]
    console = Console(file=io.StringIO(), width=100)
    print_summary(REPORTS[verdict](), console, out)
    text = console.file.getvalue()
    assert text.startswith(verdict) and str(out / "report.html") in text and "next" in text
    if verdict == "explained":
        assert (
            "31.2 [28.7, 33.7] mN·m" in text
            and "14.1 [12.3, 16.4] mrad" in text
            and "86 % less" in text
        )
    else:
        print_summary(REPORTS[verdict](), Console(file=io.StringIO(), width=30))


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        ({"name": "coulomb at elbow"}, "Coulomb friction at elbow"),
        ({"name": "coulomb"}, "Coulomb friction at elbow"),
        (
            {"name": "coulomb at elbow", "alternatives": ["payload at hand"]},
            "Coulomb friction at elbow or payload at hand",
        ),
    ],
)
def test_a_place_is_said_once(effect, words):
    assert effect_name({"where": "elbow"} | effect) == words
