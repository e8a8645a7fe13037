"""The tour on the smallest sizes: ordinary run folders, numbers that agree with the other commands, one whole page."""

import json
import re
import shlex
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from adaptsim_jax.adaptation.phase1 import Phase1Config
from adaptsim_jax.adaptation.training import TrainConfig, load_run
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.baselines.mdn import FitConfig
from adaptsim_jax.baselines.sysid import SysIdConfig
from adaptsim_jax.cli import main, parse
from adaptsim_jax.commands import demo_tour as module
from adaptsim_jax.commands.demo import _show
from adaptsim_jax.commands.demo_tour import DemoConfig, demo
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.store import RunFolder

pytestmark = pytest.mark.slow
BASELINES = ("sysid_point", "udr", "best_in_omega")  # SysID-Bayes has the longest compile, and tests of its own
FIT = FitConfig(updates=20)
SIZES = DemoConfig(
    seeds=2,
    iterations=3,
    train=TrainConfig(phase1=Phase1Config(trajectories=40, parallel=10, updates=4, capacity=1000, archive=1000)),
    sysid=SysIdConfig(simulations=64, draws=50, first_fit=FIT, next_fit=FIT),
)


@pytest.fixture(scope="module")
def diagnosis():
    from tests.report.diagnosis_cases import explained

    return explained()


@pytest.fixture(scope="module")
def tour(tmp_path_factory, diagnosis):
    """A tour in a folder; the diagnosis has tests of its own and takes a minute, so a finished one stands in for it."""
    told = []

    def stand_in(data, out, seed, progress):
        assert (data / "meta.toml").exists()
        progress(1, 2, "audit")
        return diagnosis

    out = tmp_path_factory.mktemp("demo")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "diagnose", stand_in)
        patch.setattr(module, "BASELINES", BASELINES)
        found = demo(out, 5, lambda done, total, note="": told.append((done / total, note)), SIZES)
    return out, found, told


def test_progress_only_goes_forward(tour):
    shares = [share for share, _ in tour[2]]
    assert shares == sorted(shares) and shares[-1] == pytest.approx(1.0)
    assert {note.split()[0] for _, note in tour[2]} >= {"train", "baselines", "diagnose", "page"}


def test_its_runs_are_ordinary_and_adapt_alike(tour, tmp_path):
    out, found, _ = tour
    assert load_run(RunFolder.open(out / "runs" / "seed-6")).rounds == 4
    again = ["adapt", str(out / "runs" / "seed-5"), "--target", "ood-1", "--seed", "5", "--iterations", "3"]
    assert main([*again, "--out", str(tmp_path / "a")]) == 0
    best = json.loads((tmp_path / "a" / "result.json").read_text())["best"]
    assert best["reward"] == pytest.approx(float(found.adapted[0].result.reward), rel=1e-5)


def test_rows_of_all_methods_with_all_seeds(tour):
    results = json.loads((tour[0] / "comparison" / "results.json").read_text())
    rows = {row["method"]: row for row in results["rows"]}
    assert set(rows) == {"adaptsim", *BASELINES}
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
    assert page.count("<svg") == 3 and page.rstrip().endswith("</html>")
    assert not re.search(r"https?://(?!www\.w3\.org|purl\.org|creativecommons|matplotlib)", page)


def test_a_tour_again_takes_the_runs_up(tour, monkeypatch, diagnosis):
    out, found, _ = tour
    before = (out / "runs" / "seed-5" / "metrics.jsonl").read_bytes()
    monkeypatch.setattr(module, "diagnose", lambda *_, **__: diagnosis)
    monkeypatch.setattr(module, "BASELINES", BASELINES)
    again = demo(out, 5, config=SIZES)
    assert (out / "runs" / "seed-5" / "metrics.jsonl").read_bytes() == before
    assert np.array_equal(again.adapted[0].result.mean, found.adapted[0].result.mean)


def test_a_tour_killed_before_its_first_config_is_taken_up(tmp_path, monkeypatch):
    """`RunFolder.create` makes the folder first; a kill then leaves it empty."""

    def train(config, folder, progress):
        raise KeyboardInterrupt

    (tmp_path / "runs" / "seed-5").mkdir(parents=True)
    monkeypatch.setattr(module, "train_run", train)
    for _ in range(2):  # first in the empty folder, then in the one that has its config
        with pytest.raises(KeyboardInterrupt):
            demo(tmp_path, 5, config=SIZES)
        assert RunFolder.open(tmp_path / "runs" / "seed-5").config["seed"] == 5


@pytest.mark.parametrize("sizes", [DemoConfig(), SIZES])
def test_its_commands_ask_for_the_same(tmp_path, sizes):
    from adaptsim_jax.commands import compare as compare_command
    from adaptsim_jax.commands import train as train_command

    args = {k: parse(shlex.split(line)[1:]) for k, line in module._commands(tmp_path, 5, sizes).items()}
    assert train_command.config_of({}, args["train"]) == replace(sizes.train, seed=5)
    assert args["adapt"].folder == args["train"].folder and args["adapt"].target == "ood-1"
    assert (args["adapt"].starts, args["adapt"].iterations, args["adapt"].seed) == (sizes.starts, sizes.iterations, 5)
    asked = compare_command.config_of(args["compare"])
    wanted = {name: getattr(sizes, name) for name in ("seeds", "starts", "iterations", "train", "sysid")}
    assert asked == CompareConfig(("adaptsim", *module.BASELINES), ("ood-1",), seed=5, **wanted)
    assert args["diagnose"].data == str(module.SAMPLE) and args["diagnose"].seed == 5
    for folder in (args["train"].folder, args["compare"].out, args["diagnose"].out):
        assert tmp_path / "runs" not in Path(folder).parents and Path(folder).is_relative_to(tmp_path / "again")


def test_other_sizes_in_the_same_folder_are_refused(tour):
    other = replace(SIZES, train=replace(SIZES.train, every=7))
    with pytest.raises(BadInput, match="every: 20 there, 7 asked"):
        demo(tour[0], 5, config=other)


def test_the_summary_says_where_things_lie(tour, capsys):
    out, found, _ = tour
    _show(found, out)
    printed = capsys.readouterr().out
    assert str(out / "index.html") in printed and str(out / "runs") in printed


def test_a_folder_that_cannot_be_written(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["demo", "--out", str(tmp_path / "file")]) == 2
    error = capsys.readouterr().err
    assert "file" in error and error.count("\n") == 1
