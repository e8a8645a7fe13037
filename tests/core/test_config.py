"""Config tables: what is written is read back, and every wrong key is named with the mend."""

import tomllib
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput


class Hyper(NamedTuple):
    rate: Any = 1e-3
    tau: float = 0.01


@dataclass(frozen=True)
class Sizes:
    hidden: tuple[int, ...] = (64, 64)
    act: Literal["elu", "relu"] = "elu"


@dataclass(frozen=True)
class Settings:
    task: str
    rounds: int = 10
    delta: float = 0.1
    path: str | None = None
    on: bool = True
    box: tuple[float, float] = (0.0, 1.0)
    sizes: Sizes = field(default_factory=Sizes)
    hyper: Hyper = field(default_factory=Hyper)
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Plan:
    sizes: Sizes = field(default_factory=lambda: Sizes((8,), "relu"))
    whole: Settings = field(default_factory=lambda: Settings("push", hyper=Hyper(tau=0.5)))


def test_a_nested_table_keeps_the_rest_of_that_fields_default():
    plan = config.from_table(
        Plan, {"sizes": {"hidden": [9]}, "whole": {"hyper": {"rate": 2.0}}}, "test"
    )
    assert plan == Plan(Sizes((9,), "relu"), Settings("push", hyper=Hyper(2.0, 0.5)))


def test_round_trip():
    given_config = Settings(
        "pendulum", path="a/b", sizes=Sizes((3,), "relu"), hyper=Hyper(0.5, 0.25)
    )
    text = config.dumps(config.to_table(given_config))
    assert config.from_table(Settings, tomllib.loads(text), "config.toml") == given_config


@pytest.mark.parametrize(
    "table, says",
    [
        ({"task": "p", "round": 3}, "c.toml: unknown key 'round'; did you mean 'rounds'?"),
        ({"task": "p", "tau": 3}, "c.toml: unknown key 'tau'; did you mean 'hyper.tau'?"),
        ({"rounds": 3}, "c.toml: key 'task' is missing"),
        ({"task": "p", "rounds": 3.5}, "key 'rounds' is 3.5; a value of type int"),
        ({"task": "p", "rounds": True}, "key 'rounds' is True; a value of type int"),
        ({"task": "p", "delta": "x"}, "key 'delta' is 'x'; a value of type float"),
        ({"task": 3}, "key 'task' is 3; a value of type str"),
        ({"task": "p", "box": [0.0]}, "key 'box' has 1 entries; 2 are wanted"),
        ({"task": "p", "box": [0.0, "b"]}, r"key 'box\[1\]' is 'b'"),
        (
            {"task": "p", "sizes": {"hiden": [1]}},
            "unknown key 'sizes.hiden'; did you mean 'hidden'?",
        ),
        ({"task": "p", "sizes": {"act": "gelu"}}, "key 'sizes.act' is 'gelu'; one of"),
        ({"task": "p", "hyper": {"rte": 1}}, "unknown key 'hyper.rte'; did you mean 'rate'?"),
        ({"task": "p", "sizes": 3}, "key 'sizes' is 3"),
        ({"task": "p", "delta": float("nan")}, "key 'delta' is nan; a finite number is wanted"),
        ({"task": "p", "hyper": {"tau": float("inf")}}, "key 'hyper.tau' is inf; a finite number"),
        ({"task": "p", "delta": 10**400}, "key 'delta' is 1000.*; a finite number is wanted"),
        ({"task": 16**9000}, "key 'task' is a number of thousands of digits; a value of type str"),
    ],
)
def test_wrong_keys(table, says):
    with pytest.raises(BadInput, match=says):
        config.from_table(Settings, table, "c.toml")


def test_settings_from_the_command_line():
    start = Settings("pendulum")
    new = config.with_settings(
        start, ["rounds=3", "hyper.rate=0.5", "sizes.act=relu", "sizes.hidden=[8]"]
    )
    assert (new.rounds, new.hyper.rate, new.sizes) == (3, 0.5, Sizes((8,), "relu"))
    for setting, says in (
        ("rounds", "write --set key=value"),
        ("round=3", "did you mean 'rounds'"),
        ("hypr.rate=3", "unknown key 'hypr'; did you mean 'hyper'"),
        ("rounds.x=3", "'rounds' is no table; write --set rounds=VALUE"),
        ("sizes.hiden.x=3", "unknown key 'sizes.hiden'; did you mean 'hidden'"),
        ("rounds=" + "9" * 5000, "key 'rounds' is '999.*; a value of type int"),
    ):
        with pytest.raises(BadInput, match=says):
            config.with_settings(start, [setting])


def test_settings_reach_into_a_table_of_any_keys():
    start = Settings("push", options={"trials": 3})
    new = config.with_settings(start, ["options.training.block=300", "options.training.wide.a=x"])
    assert new.options == {"trials": 3, "training": {"block": 300, "wide": {"a": "x"}}}
    assert start.options == {"trials": 3}
    with pytest.raises(
        BadInput, match=r"'options\.trials' is no table; write --set options\.trials=VALUE"
    ):
        config.with_settings(start, ["options.trials.x=3"])


def test_the_nearest_name_is_found_whatever_its_case():
    assert config.suggest("RAD", ["rad", "deg"]) == "did you mean 'rad'?"
    assert config.suggest("x", ["rad", "deg"]) == "known: rad, deg"
    assert config.suggest("line", ["seed", "task.line", "lines"]) == "did you mean 'task.line'?"
    assert config.suggest("x", []) == "known: none"


def test_a_mark_before_the_text_is_no_part_of_it(tmp_path):
    (tmp_path / "c.toml").write_bytes(b"\xef\xbb\xbfa = 1\n")
    assert config.read(tmp_path / "c.toml") == {"a": 1}


@pytest.mark.parametrize("text", ["a = " + "1" * 5000, "a = " + "[" * 3000, "a = 1979-13-01"])
def test_what_python_cannot_parse_is_one_line(tmp_path, text):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(BadInput, match=r"c\.toml: not TOML") as caught:
        config.read(tmp_path / "c.toml")
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300 + len(str(tmp_path))


@pytest.mark.parametrize("path", [r"..\models\arm.xml", r"..\users\arm.xml", r"\x\arm.xml"])
def test_a_backslash_between_double_quotes_is_named(tmp_path, path):
    (tmp_path / "c.toml").write_text(f'model = "{path}"\n')
    with pytest.raises(BadInput, match="write / in place of a backslash"):
        config.read(tmp_path / "c.toml")
    (tmp_path / "c.toml").write_text("model = \n")
    with pytest.raises(BadInput, match="mend that line"):
        config.read(tmp_path / "c.toml")


_text = st.text(st.characters(codec="utf-8"), max_size=8)
_leaf = st.one_of(st.booleans(), st.integers(-(2**62), 2**62), st.floats(allow_nan=False), _text)
_table = st.recursive(
    st.dictionaries(_text, st.one_of(_leaf, st.lists(_leaf, max_size=3)), max_size=3),
    lambda inner: st.dictionaries(_text, st.one_of(_leaf, inner), max_size=3),
    max_leaves=6,
)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(_table)
def test_any_table_is_written_as_toml(table):
    assert tomllib.loads(config.dumps(table)) == table
    assert config.digest(table) == config.digest(dict(reversed(table.items())))
    assert config.differences(table, table) == []


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=40))
def test_any_bytes_are_a_table_or_one_line(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("toml") / "c.toml"
    path.write_bytes(data)
    try:
        table = config.read(path)
    except BadInput as error:
        assert "\n" not in str(error) and str(path) in str(error)
    else:
        assert isinstance(table, dict)
