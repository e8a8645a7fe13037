"""Pages of the site that are made from the code: the command line from its parsers, configuration
keys from their dataclasses. And what the blocks of a tutorial print, beneath each
(`docs/run_blocks.py` keeps it).

MkDocs calls `on_files` and `on_page_markdown`. `python docs/hooks.py DIR` writes the generated
pages into a folder.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
import runpy
import sys
import textwrap
from pathlib import Path
from typing import Any

from adaptsim_jax.commands import SUMMARIES
from adaptsim_jax.commands.parser import command_parser

BLOCK = re.compile(r"^```(?:bash|python)\n.*?^```\n", re.S | re.M)  # as of run_blocks.py
NOTEBOOKS = Path(__file__).with_name("notebooks")
CODES = Path(__file__).with_name("codes.py")
RULES = "<!-- the table of rules, from adaptsim_jax/diagnosis/rules.py -->"
SCHEMA = "reference/report.schema.json"
SHARED = {"--help", "--seed", "--no-cache"}
TASKS = ("pendulum", "pushing", "scooping", "environment")


def pages() -> dict[str, str]:
    """Text of the generated pages by their place under `docs/`."""
    return {
        "reference/cli.md": command_line(),
        "reference/config.md": configuration(),
        "reference/effects.md": effects(),
        "reference/errors.md": runpy.run_path(str(CODES))["page"](),
        **{
            f"notebooks/{path.stem}.md": notebook(path)
            for path in sorted(NOTEBOOKS.glob("*.ipynb"))
        },
        "explanation/rules.md": rules(),
    }


def on_files(files: Any, config: Any) -> Any:
    """MkDocs: adds the generated pages."""
    from mkdocs.structure.files import File

    for place, text in {**pages(), SCHEMA: schema()}.items():
        files.append(File.generated(config, place, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """MkDocs: a tutorial with what its blocks print, and the table of rules where a page has it."""
    source = Path(page.file.abs_src_path or "")
    return with_rules(with_outputs(markdown, source.parent / "outputs" / source.stem))


def with_rules(markdown: str) -> str:
    """The page with the rules of the search in the place of `RULES`."""
    from adaptsim_jax.diagnosis.rules import table

    return markdown.replace(RULES, table())


def with_outputs(markdown: str, outputs: Path) -> str:
    """The page with `outputs/K.txt` beneath its block K."""
    count = 0

    def shown(match: re.Match) -> str:
        nonlocal count
        count += 1
        kept = outputs / f"{count}.txt"
        if not kept.exists():
            return match[0]
        text = kept.read_text(encoding="utf-8").rstrip("\n")
        return f"{match[0]}\n```{{.text .output}}\n{text}\n```\n"

    return BLOCK.sub(shown, markdown)


def notebook(path: Path) -> str:
    """A page of the cells of a notebook, with the notebook to download."""
    parts = [
        "".join(cell["source"])
        if cell["cell_type"] == "markdown"
        else f"```python\n{''.join(cell['source'])}\n```"
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]
    ]
    title, _, rest = parts[0].partition("\n")
    return "\n\n".join([f"{title}\n\n[The notebook]({path.name}).\n{rest}", *parts[1:]]) + "\n"


def rules() -> str:
    """Why an effect is refused, from the records of the rules."""
    from adaptsim_jax.diagnosis.rules import STEPS, table

    steps = "\n".join(f"| `{code}` | {_barred(words)} |" for code, words in STEPS.items())
    return (
        "# Rules of the search\n\nMade from `adaptsim_jax/diagnosis/rules.py`. What fails at stage "
        "*model* does not predict. What fails at stage *name* predicts, and is too small, unsteady "
        "or unresolved for a name. Both go, unless the objective leaves them in the model without "
        "a name. A rule that "
        "does not apply to a search, a machine or an effect is not asked.\n\n"
        "[Every decision of the search](decisions.md), and where it is taken, has a page of its "
        "own.\n\n"
        f"{table()}\n## Other steps\n\n| code | words |\n| --- | --- |\n{steps}\n"
    )


def schema() -> str:
    """The JSON Schema of `report.json`, for programs that are not in Python."""
    from adaptsim_jax.diagnosis.schema import report_schema

    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "report.json"}
    return json.dumps(head | report_schema(), indent=1) + "\n"


def command_line() -> str:
    """A section for each command: options with their help, examples."""
    parts = [
        "# Command line\n\nMade from the parsers. Exit codes: 0, 1 (it failed), 2 (bad input), 130 "
        "(stopped). Every command takes"
        " `--help`, `--seed N` (default 0) and `--no-cache` (keep no compiled programs on disk)."
    ]
    for name, summary in SUMMARIES.items():
        parser = command_parser(name)
        rows = [
            _row(action) for action in parser._actions if SHARED.isdisjoint(action.option_strings)
        ]
        examples = textwrap.dedent((parser.epilog or "").removeprefix("examples:\n")).strip("\n")
        parts.append(
            f"## adaptsim {name}\n\n{summary[0].upper()}{summary[1:]}.\n\n| argument | meaning "
            f"|\n| --- | --- |\n" + "\n".join(rows) + f"\n\n```text\n{examples}\n```"
        )
    return "\n\n".join(parts) + "\n"


def _row(action: argparse.Action) -> str:
    words = action.metavar or ("|".join(map(str, action.choices)) if action.choices else "")
    takes = action.nargs != 0 and (words or action.type)
    name = ", ".join(action.option_strings) or words or action.dest
    value = f" {words or action.dest.upper()}" if action.option_strings and takes else ""
    needed = " (needed)" if action.option_strings and action.required else ""
    text = _barred((action.help or "").replace("%%", "%"))
    return f"| `{name}{value}`{needed} | {text} |"


OF = {
    "mechanism": (
        "Any mechanism",
        "At each joint, at all joints, or one value shared; `tilt` is of the base.",
    ),
    "pushing": ("Pushes", "Measured pushes."),
    "scooping": ("Scoops", "Measured scoops."),
    "toss": (
        "Tossed bodies",
        "Lengths in m, angles in rad; the others are shares, or s/m and 1/s of a friction and a "
        "drag.",
    ),
}


def effects() -> str:
    """What `adaptsim diagnose` can find, a table a task."""
    from adaptsim_jax.commands.effects import LEGEND, listed

    parts = [
        "# Effects\n\nWhat `adaptsim diagnose` can find, from the catalogues; `adaptsim effects "
        "TASK` prints the same with bounds. " + " ".join(LEGEND.split())
    ]
    for task, (title, text) in OF.items():
        rows = [_effect(effect) for effect in listed(task)]
        head = (
            "| effect | what it is | parameters | shown by | taken for |\n| --- | --- | --- | --- "
            "| --- |\n"
        )
        parts.append(f"## {title}\n\n{text}\n\n{head}" + "\n".join(rows))
    return "\n\n".join(parts) + "\n"


def _effect(effect: dict[str, Any]) -> str:
    numbers = effect.get("parameters") or effect["quantities"]
    named = [
        f"`{p['name']}`{' [' + p['unit'] + ']' if p.get('unit', '1') not in ('', '1') else ''}"
        for p in numbers
    ]
    alike = effect.get("look_alikes") or [
        *effect.get("absorbed_by", ()),
        *effect.get("same_as", ()),
    ]
    formula = f"<br>`{effect['formula']}`" if effect.get("formula") else ""
    cells = (
        f"`{effect['name']}`<br>{effect['place']}",
        f"{effect['physics']}{formula}",
        "<br>".join(named),
        effect["excitation"],
    )
    return f"| {' | '.join(map(_barred, cells))} | {', '.join(alike).replace('_', ' ')} |"


def _barred(text: str) -> str:
    """A cell of a table: bars are escaped outside of code, where the backslash would be seen."""
    parts = text.split("`")
    return "`".join(part if k % 2 else part.replace("|", "\\|") for k, part in enumerate(parts))


def configuration() -> str:
    """Every key of a run's configuration, by task and block, with its default; what a class says of
    its fields beneath.
    """
    from adaptsim_jax.adaptation.training import PRESETS, default_config
    from adaptsim_jax.core.config import dumps, to_table

    presets = ", ".join(f"`{name}`" for name in PRESETS)
    text = [
        "# Configuration keys\n\nMade from the dataclasses. `adaptsim train TASK --set KEY=VALUE` "
        "changes one, `--config FILE`"
        f" starts from a file of them, `--preset` from one of: {presets}. Times are in s, angles "
        f"in rad,"
        " lengths in m unless a note says otherwise."
    ]
    for task in TASKS:
        config, options = default_config(task), _options(task)
        table = to_table(config) | {"task": to_table(options)}
        text.append(
            f"## {task.capitalize()}\n\nDefaults of `adaptsim train "
            f"{task}`:\n\n```toml\n{dumps(table).strip()}\n```"
        )
    seen: set[type] = set()
    text.append("## What the keys mean")
    for task in TASKS:
        for kind in _classes(task):
            if (
                kind not in seen
                and kind.__doc__
                and not kind.__doc__.startswith(f"{kind.__name__}(")
            ):
                seen.add(kind)
                text.append(f"### {kind.__name__}\n\n{_prose(kind.__doc__)}")
    return "\n\n".join(text) + "\n"


def _options(task: str) -> Any:
    """The task's options as its preset has them, every one filled in."""
    from adaptsim_jax.adaptation.training import default_config
    from adaptsim_jax.core.config import from_table
    from adaptsim_jax.tasks.registry import TASKS as KINDS

    entry = KINDS[task]
    return from_table(
        getattr(entry, "config", None) or entry[0], dict(default_config(task).task), "preset"
    )


def _classes(task: str) -> list[type]:
    from adaptsim_jax.adaptation.training import default_config

    def walk(value: Any) -> list[type]:
        if not dataclasses.is_dataclass(value):
            return []
        return [
            type(value),
            *(k for f in dataclasses.fields(value) for k in walk(getattr(value, f.name))),
        ]

    return walk(default_config(task)) + walk(_options(task))


def _prose(text: str) -> str:
    import inspect

    return inspect.cleandoc(text).replace("<", "&lt;")


def main() -> None:
    for place, text in pages().items():
        path = Path(sys.argv[1]) / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
