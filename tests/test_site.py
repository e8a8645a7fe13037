"""The documentation: its generated pages, its tutorials as a reader would run them, and that every
page is on the site.
"""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from adaptsim_jax.commands import SUMMARIES
from adaptsim_jax.commands.effects import CATALOGUES, listed

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
RUN = runpy.run_path(str(DOCS / "run_blocks.py"))
TUTORIALS = sorted(path.stem for path in (DOCS / "tutorials").glob("*.md"))


def test_every_page_is_on_the_site_and_every_entry_is_a_page():
    named = set(
        re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text().partition("\nnav:")[2])
    )
    made = {
        "reference/cli.md",
        "reference/config.md",
        "reference/effects.md",
        "reference/errors.md",
        "explanation/rules.md",
        *(f"notebooks/{path.stem}.md" for path in (DOCS / "notebooks").glob("*.ipynb")),
    }
    assert named - made == {str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md")}


def test_the_reference_holds_every_command_and_its_options():
    text = runpy.run_path(str(DOCS / "hooks.py"))["command_line"]()
    assert re.findall(r"^## adaptsim (\w+)", text, re.M) == list(SUMMARIES)
    assert "`--horizon S`" in text and "`--run DIR` (needed)" in text


def test_the_reference_holds_every_key_with_its_default():
    text = runpy.run_path(str(DOCS / "hooks.py"))["configuration"]()
    assert text.count("```toml") == 4
    assert "delta = 0.1\n" in text and "### Phase1Config" in text and "### ScoopingConfig" in text


def test_the_reference_holds_every_effect():
    text = runpy.run_path(str(DOCS / "hooks.py"))["effects"]()
    for task in CATALOGUES:
        assert all(f"| `{effect['name']}`" in text for effect in listed(task)), task
    assert (
        "`-drag v |v|`" in text
    )  # a bar in code is no border, and needs no backslash, which would be seen


def test_every_decision_of_the_search_is_where_the_page_says():
    text = (DOCS / "explanation" / "decisions.md").read_text()
    places = re.findall(r"`([\w/]+\.py)` `([\w.]+)`", text)
    assert len(places) > 100
    for path, name in places:
        source = (ROOT / "adaptsim_jax" / path).read_text()
        assert re.search(rf"\b{name.rpartition('.')[2]}\b", source), (path, name)


def test_results_are_short():
    for page in (DOCS / "results").glob("*.md"):
        assert len(page.read_text().splitlines()) <= 150, page


@pytest.mark.slow
def test_the_site_builds_strictly(tmp_path):
    """No broken link, no missing reference; with the extra `docs`."""
    pytest.importorskip("mkdocs")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(tmp_path)]
    done = subprocess.run(
        command,
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "make_phase1" in (tmp_path / "reference" / "api.html").read_text()


def blocks(name):
    return RUN["BLOCK"].findall((DOCS / "tutorials" / f"{name}.md").read_text())


@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorial_shows_what_its_blocks_print(name):
    """`make tutorials` keeps it; the site has it beneath each block, and the pictures."""
    page = DOCS / "tutorials" / f"{name}.md"
    out = RUN["outputs_of"](page)
    kept = {path.name for path in out.glob("*.txt")}
    assert kept and kept <= {f"{k}.txt" for k in range(1, len(blocks(name)) + 1)}
    shown = runpy.run_path(str(DOCS / "hooks.py"))["with_outputs"](page.read_text(), out)
    assert shown.count("```{.text .output}") == len(kept)
    pictures = RUN["FIGURE"].findall(page.read_text())
    assert pictures and {path.name for path in out.glob("*.png")} == {
        Path(p).name for p in pictures
    }


def test_outputs_of_tutorials_are_small():
    assert (
        sum(path.stat().st_size for path in (DOCS / "tutorials" / "outputs").rglob("*.*")) < 300_000
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorial_runs(name, tmp_path, monkeypatch):
    """Its blocks run in an empty folder, in order; each that prints has its output in the page,
    though numbers differ by machine.
    """
    monkeypatch.setenv("MPLBACKEND", "agg")
    page = DOCS / "tutorials" / f"{name}.md"
    printed = RUN["run_page"](page, tmp_path)
    RUN["figures_of"](page, tmp_path)
    kept = {path.name for path in RUN["outputs_of"](page).glob("*.txt")}
    assert {f"{k}.txt" for k, text in enumerate(printed, 1) if text} == kept
