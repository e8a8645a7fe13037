"""The tour on the smallest sizes: ordinary run folders, numbers that agree with the other commands,
one whole page.
"""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from adaptsim_jax.adaptation.phase1 import Phase1Config
from adaptsim_jax.adaptation.training import TrainConfig, load_run
from adaptsim_jax.baselines.mdn import FitConfig
from adaptsim_jax.baselines.sysid import SysIdConfig
from adaptsim_jax.cli import main
from adaptsim_jax.commands import demo_tour
from adaptsim_jax.commands.demo import TITLES, _show
from adaptsim_jax.commands.demo_config import SHORT, DemoConfig
from adaptsim_jax.commands.demo_tour import Before, demo
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.store import RunFolder
from adaptsim_jax.tasks.pushing.task import pushing_space
from adaptsim_jax.tasks.scooping.task import scooping_space

pytestmark = pytest.mark.slow
FIT = FitConfig(updates=20)
SIZES = DemoConfig(
    seeds=2,
    iterations=3,
    train=TrainConfig(
        phase1=Phase1Config(trajectories=40, parallel=10, updates=4, capacity=1000, archive=1000)
    ),
    sysid=SysIdConfig(simulations=64, draws=50, first_fit=FIT, next_fit=FIT),
    baselines=(
        "sysid_point",
        "udr",
        "best_in_omega",
    ),  # SysID-Bayes has the longest compile, and tests of its own
)


def tiny(task):
    options = {"push": {"shared": {"updates": 20, "contexts": 8, "trials": 32}}, "scoop": {}}[task]
    return replace(
        getattr(SHORT, task), trajectories=4, parallel=2, updates=4, iterations=2, options=options
    )


def adapted(task, figure, ends=()):
    """A push or a scoop that was adapted; both have tests of their own and take a minute."""
    space = {"pushing": pushing_space, "scooping": scooping_space}[task]()
    params = dict(zip(space.names, map(float, space.physical(np.full(4, 0.5))), strict=True))
    found = {"target": {"name": "wd", "params": params}, "best": {"params": params}, "trials": 18}
    return Before(40, found, 0, 36, 0.25, 0.75, figure, ends)


@pytest.fixture(scope="module")
def stand_ins():
    """The push, the scoop and the diagnosis, as the tour would have found them."""
    from adaptsim_jax.tasks.pushing.figures import Push, before_after
    from adaptsim_jax.tasks.scooping.film import ending, film_strips
    from tests.report.diagnosis_cases import explained
    from tests.report.test_scooping_film import clip

    tracks = np.linspace((0.6, 0.0), (0.9, 0.1), 20)
    pushes = [Push(np.array(goal), tracks, 0.5) for goal in ((0.8, 0.05), (0.9, -0.1))]
    clips = [clip(success=False), clip()]
    push = adapted("pushing", before_after({"before": pushes, "after": pushes}, 0.05))
    ends = tuple(map(ending, clips))
    scoop = adapted("scooping", film_strips(clips, ("before", "after")), ends)
    return push, scoop, explained()


def put_in(patch, stand_ins):
    """Patch the tour so that the pendulum alone is computed."""
    push, scoop, found = stand_ins

    def contact(out, seed, config, progress):
        for name in ("push", "scoop"):
            progress(name, 0, 1)
            progress(name, 1, 1)
            (out / name).mkdir(exist_ok=True)
            (out / name / "result.json").write_text("{}")
        return push, scoop

    patch.setattr(demo_tour, "contact_parts", contact)
    patch.setattr(demo_tour, "diagnosed", lambda data, out, report: found)


@pytest.fixture(scope="module")
def tour(tmp_path_factory, stand_ins):
    """A tour in a folder, of the pendulum alone."""
    told = []
    out = tmp_path_factory.mktemp("demo")
    with pytest.MonkeyPatch.context() as patch:
        put_in(patch, stand_ins)

        def say(part, done, total, note=""):
            return told.append((part, done / total, note))

        found = demo(out, 5, say, SIZES)
    return out, found, told


def test_progress_only_goes_forward(tour):
    for part in ("pendulum", "baselines", "push", "page"):
        shares = [share for name, share, _ in tour[2] if name == part]
        assert shares == sorted(shares) and shares[0] == 0.0 and shares[-1] == pytest.approx(1.0)
    assert {part for part, _, _ in tour[2]} <= set(TITLES)


def test_its_runs_are_ordinary_and_adapt_alike(tour, tmp_path):
    out, found, _ = tour
    assert load_run(RunFolder.open(out / "runs" / "seed-6")).rounds == 4
    again = [
        "adapt",
        str(out / "runs" / "seed-5"),
        "--target",
        "ood-1",
        "--seed",
        "5",
        "--iterations",
        "3",
    ]
    assert main([*again, "--out", str(tmp_path / "a")]) == 0
    best = json.loads((tmp_path / "a" / "result.json").read_text())["best"]
    assert best["reward"] == pytest.approx(float(found.adapted[0].result.reward), rel=1e-5)


def test_rows_of_all_methods_with_all_seeds(tour):
    results = json.loads((tour[0] / "comparison" / "results.json").read_text())
    rows = {row["method"]: row for row in results["rows"]}
    assert set(rows) == {"adaptsim", *SIZES.baselines}
    assert all(len(row["per_seed"]) == 2 for row in rows.values())
    assert len(rows["adaptsim"]["curve"]["median"]) == 4
    assert rows["adaptsim"]["target_trials"] == 2 * 4


class Reader(HTMLParser):
    def __init__(self):
        super().__init__()
        self.links, self.text = [], []

    def handle_starttag(self, tag, attrs):
        self.links += [value for name, value in attrs if name in ("href", "src") and value]

    def handle_data(self, data):
        self.text.append(data)


def test_the_page_is_whole_and_its_links_lead_somewhere(tour):
    out, found, _ = tour
    page = (out / "index.html").read_text()
    reader = Reader()
    reader.feed(page)
    for link in reader.links:
        if not link.startswith(("data:", "#", "diagnosis/")):  # the stand-in wrote no report
            assert (out / link).exists(), link
    words = " ".join(reader.text)
    rows = {row["method"]: row for row in found.results["rows"]}
    value = rows["adaptsim"]["mean"]
    assert ("fails" if value is None else f"{value:.2f}".replace("-", "\u2212")) in words
    assert found.diagnosis["message"] in words
    assert "0.25" in words and "0.75" in words and "not on the spatula" in page
    assert page.count("<svg") == 4 and page.rstrip().endswith("</html>")
    assert not re.search(r"https?://(?!www\.w3\.org|purl\.org|creativecommons|matplotlib)", page)


def test_a_tour_again_takes_the_runs_up(tour, monkeypatch, stand_ins):
    out, found, _ = tour
    before = (out / "runs" / "seed-5" / "metrics.jsonl").read_bytes()
    put_in(monkeypatch, stand_ins)
    again = demo(out, 5, config=SIZES)
    assert (out / "runs" / "seed-5" / "metrics.jsonl").read_bytes() == before
    assert np.array_equal(again.adapted[0].result.mean, found.adapted[0].result.mean)


def test_a_tour_killed_before_its_first_config_is_taken_up(tmp_path, monkeypatch):
    """`RunFolder.create` makes the folder first; a kill then leaves it empty."""

    def train(config, folder, progress):
        raise KeyboardInterrupt

    (tmp_path / "runs" / "seed-5").mkdir(parents=True)
    monkeypatch.setattr(demo_tour, "train_run", train)
    for _ in range(2):  # first in the empty folder, then in the one that has its config
        with pytest.raises(KeyboardInterrupt):
            demo(tmp_path, 5, config=SIZES)
        assert RunFolder.open(tmp_path / "runs" / "seed-5").config["seed"] == 5


def test_other_sizes_in_the_same_folder_are_refused(tour):
    other = replace(SIZES, train=replace(SIZES.train, every=7))
    with pytest.raises(BadInput, match="every: 20 there, 7 asked"):
        demo(tour[0], 5, config=other)


def test_the_summary_says_where_things_lie(tour, capsys):
    out, found, _ = tour
    _show(found, out)
    printed = capsys.readouterr().out
    assert str(out / "index.html") in printed and str(out / "runs") in printed
    assert printed.count("0.25 before adaptation, 0.75 after") == 2


def test_a_folder_that_cannot_be_written(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["demo", "--out", str(tmp_path / "file")]) == 2
    error = capsys.readouterr().err
    assert "file" in error and error.count("\n") == 1


@pytest.mark.parametrize("task", ["push", "scoop"])
def test_a_push_and_a_scoop_before_and_after(task, tmp_path):
    """The real thing on the smallest sizes: a run folder, a result that agrees with what is
    shown.
    """
    from adaptsim_jax.commands.demo_tour import contact_part

    told = []

    def say(done, total, note=""):
        return told.append(done / total)

    name = {"push": "pushing", "scoop": "scooping"}[task]
    found = contact_part(tmp_path, task, name, 3, tiny(task), False, say)
    assert told == sorted(told) and told[-1] == 1.0
    assert (tmp_path / "runs" / task / "config.toml").exists()
    result = json.loads((tmp_path / task / "result.json").read_text())
    assert result["best"]["reward"] == pytest.approx(found.after)
    assert result["history"][found.start][0]["reward"] == pytest.approx(found.before)
    assert found.trials == 2 * 2 * 3  # two a visit, of two starts, at three visits
