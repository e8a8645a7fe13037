"""Codes of bad input: unique, kept, documented, and printed."""

import re
import runpy
from dataclasses import replace
from pathlib import Path

import pytest

from adaptsim_jax.adaptation.sweep_spec import Lines
from adaptsim_jax.cli import main
from adaptsim_jax.core.config import pick
from adaptsim_jax.core.errors import BadInput, fault_codes

CODES = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "codes.py"))
SITES, STORED = CODES["sites"](), CODES["stored"]()


def as_made_by(place, message):
    error = BadInput(message)
    error.place = place
    return error


def test_the_file_is_what_the_code_says():
    text = CODES["FILE"].read_text(encoding="utf-8")
    assert CODES["renewed"](SITES, STORED) == text, "run `python docs/codes.py`"


def test_no_code_is_given_twice():
    every = [code for codes in STORED.values() for code in codes]
    assert len(every) == len(set(every)) == len(SITES) + len(STORED["gone"])
    assert all(re.fullmatch(r"E-[A-Z]+-\d{3}", code) for code in every)


def test_each_message_has_the_code_of_the_page():
    page, codes = CODES["page"](), CODES["codes_of"](SITES, STORED)
    assert len(set(codes.values())) == len(SITES) > 600
    for site, code in codes.items():
        assert as_made_by(site.place, site.text).code == code, site
        assert page.count(f"| `{code}` |") == 1


def test_a_code_stays_where_words_or_function_do_and_is_not_given_again():
    codes = CODES["codes_of"](SITES, STORED)
    site = next(s for s in SITES if "checkpoint payload" in s.text)
    others = [s for s in SITES if s != site]
    moved = replace(site, place=f"{site.place}_again")
    reworded = replace(site, parts=("quite", "another"))
    assert CODES["codes_of"]([*others, moved], STORED)[moved] == codes[site]
    assert CODES["codes_of"]([*others, reworded], STORED)[reworded] == codes[site]
    both = replace(moved, parts=reworded.parts)
    text = CODES["renewed"]([*others, both], STORED)
    assert f'{codes[site]} = ""' in text.partition("[gone]")[2]
    core = max(c for codes in STORED.values() for c in codes if c.startswith("E-CORE"))
    assert CODES["codes_of"]([*others, both], STORED)[both] > core


def test_a_function_that_is_called_has_its_own_code():
    with pytest.raises(BadInput) as caught:
        pick("colour", "red", ("blue",))
    assert caught.value.place == "adaptsim_jax.core.config:pick"
    assert caught.value.code in fault_codes()[caught.value.place]
    assert caught.value.coded == f"{caught.value} [{caught.value.code}]"


def test_a_message_that_is_repeated_keeps_its_code():
    with pytest.raises(BadInput) as alone:
        pick("colour", "red", ("blue",))
    with pytest.raises(BadInput) as caught, Lines("sweep.toml", "set.a = 1\n").blamed("set.a"):
        pick("colour", "red", ("blue",))
    assert "sweep.toml" in str(caught.value) and caught.value.code == alone.value.code


def test_one_of_another_package_has_none():
    error = BadInput("my own")
    assert error.code == "" and error.coded == "my own"


def test_the_command_line_ends_with_the_code(capsys):
    assert main(["trian"]) == 2
    assert re.search(r"did you mean 'train'\? \[E-CLI-\d{3}\]\n$", capsys.readouterr().err)
