"""The blocks of docs/your-own-effect.md run, in order, as a reader would paste them, in an empty
folder.
"""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "your-own-effect.md"


@pytest.mark.slow
def test_the_pages_blocks_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)
    assert len(blocks) == 3
    names = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    assert "one_way_friction" in capsys.readouterr().out
    assert "one way friction at joint 1" in (tmp_path / "own" / "report.html").read_text().lower()
