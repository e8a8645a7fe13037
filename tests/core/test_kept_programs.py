"""Traces kept between processes: found again, told apart, and never a reason to fail or to answer for another program."""

import functools
import os
import subprocess
import sys
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core import kept_programs
from adaptsim_jax.core.kept_programs import Kept, kept, spelled, structure
from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.mechanisms.registry import make_plant
from adaptsim_jax.mechanisms.stepping import Model, make_model, remember
from adaptsim_jax.sysid.estimate import linearize  # noqa: F401  (says how a `Drive` is written)
from adaptsim_jax.sysid.forward import Drive, mean_speed, timeless

SPEEDS = np.arange(6.0, dtype=np.float32).reshape(3, 2)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(kept_programs, "cache_folder", lambda: tmp_path / "traced")
    return tmp_path / "traced"


@pytest.fixture
def read_only(monkeypatch):
    """From when it is called on, nothing may be traced."""

    def refuse(*_):
        raise AssertionError("traced again")

    return lambda: monkeypatch.setattr(kept_programs, "_traced", refuse)


def pendulum(*excluded: str, l1: float = 0.2) -> Model:
    effects = tuple(e for e in catalogue("pendulum") if e.name not in excluded)
    return make_model(make_plant("rigid_body", "hanging", {"l1": l1, "l2": 0.2}, {}), effects)


def test_another_process_finds_the_trace(folder, read_only):
    first = Kept(mean_speed)(SPEEDS)
    assert [path.name.split("-")[0] for path in folder.iterdir()] == ["mean_speed"]
    read_only()
    again = Kept(mean_speed)  # knows nothing of the first
    np.testing.assert_array_equal(again(SPEEDS), first)
    np.testing.assert_array_equal(again(2 * SPEEDS), mean_speed(2 * SPEEDS))
    with pytest.raises(AssertionError, match="traced again"):
        again(SPEEDS[:2])  # another shape


def test_records_come_back_as_they_were(folder, read_only, monkeypatch):
    monkeypatch.setattr(_unchanged, "__module__", "adaptsim_jax.made_up")
    drive = Drive(*(np.full((2, 1), k, np.float32) for k in range(5)), (np.ones((2, 1), np.float32),))
    Kept(_unchanged)(drive)
    read_only()
    again = Kept(_unchanged)(drive)
    assert type(again) is type(drive)
    jax.tree.map(np.testing.assert_array_equal, again, drive)


def _unchanged(value):
    return value


def test_damage_is_mended(folder):
    first = Kept(mean_speed)(SPEEDS)
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    for damage in (b"", whole[:-1], whole[:60] + b"x" + whole[61:]):
        path.write_bytes(damage)
        np.testing.assert_array_equal(Kept(mean_speed)(SPEEDS), first)
        assert len(path.read_bytes()) == len(whole)


def test_other_sources_are_another_program(folder, monkeypatch):
    Kept(mean_speed)(SPEEDS)
    monkeypatch.setattr(kept_programs, "origin", lambda: "changed")
    Kept(mean_speed)(SPEEDS)
    assert len(list(folder.iterdir())) == 2


def test_what_is_fixed_tells_programs_apart_and_numbers_do_not():
    name = lambda model: structure(jax.tree.structure(model))
    assert name(pendulum()) == name(pendulum(l1=0.3))
    assert name(pendulum()) != name(pendulum("coulomb"))
    effects = catalogue("pendulum")
    other = replace(
        effects[0], parameters=(replace(effects[0].parameters[0], default=0.125), *effects[0].parameters[1:])
    )
    assert spelled(effects[0]) != spelled(other)
    assert spelled(functools.partial(mean_speed, 1)) != spelled(functools.partial(mean_speed, 2))
    assert spelled(mean_speed) != spelled(timeless) != spelled(remember)
    assert spelled((1, True, "1")) != spelled((1, 1, 1))


def test_the_same_words_in_every_process():
    code = (
        "import jax, hashlib; from tests.core.test_kept_programs import pendulum; from adaptsim_jax.core.kept_programs import *;"
        "print(hashlib.sha256((structure(jax.tree.structure(pendulum())) + origin()).encode()).hexdigest())"
    )
    run = lambda seed: subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONHASHSEED": seed},
        capture_output=True,
        text=True,
        check=True,
    )
    assert run("1").stdout == run("2").stdout != ""


@dataclass(frozen=True)
class Drag:
    """A callable whose text says nothing of what it does."""

    size: float = 1.0

    def __call__(self, p, motion):
        return -self.size * motion.v


PASTED: dict = {}  # as into a shell that has no name: its functions are of no module, its classes of `builtins`
exec("def drag(p, motion):\n return motion.v\nclass Pasted: pass", PASTED)
THEIRS = [
    lambda p, motion: motion.v,
    Drag(),
    functools.partial(Drag(), motion=None),
    Drag,
    PASTED["drag"],
    PASTED["Pasted"],
]


@pytest.mark.parametrize("apply", THEIRS)
def test_what_is_not_of_this_package_is_traced_each_time(folder, apply):
    theirs = replace(catalogue("pendulum")[0], apply=apply)
    model = make_model(pendulum().plant, (theirs,))
    with pytest.raises(kept_programs.Unnamed):
        structure(jax.tree.structure(model))
    np.testing.assert_array_equal(Kept(_unchanged)(SPEEDS), SPEEDS)  # a function of the tests
    assert not folder.exists()


def test_within_another_trace_it_is_jit(folder):
    doubled = jax.vmap(Kept(mean_speed))(np.stack([SPEEDS, SPEEDS]))
    np.testing.assert_array_equal(doubled[1], mean_speed(SPEEDS))
    assert not folder.exists()


def test_a_folder_that_cannot_be_written_is_no_reason_to_fail(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(kept_programs, "cache_folder", lambda: tmp_path / "file" / "traced")
    np.testing.assert_array_equal(Kept(mean_speed)(SPEEDS), mean_speed(SPEEDS))


def test_it_follows_the_compile_cache(tmp_path):
    before = jax.config.jax_compilation_cache_dir
    try:
        jax.config.update("jax_compilation_cache_dir", str(tmp_path))
        assert kept_programs.cache_folder() == tmp_path / "traced"
        jax.config.update("jax_compilation_cache_dir", "gs://somewhere")
        assert kept_programs.cache_folder() is None
        jax.config.update("jax_compilation_cache_dir", None)
        assert kept_programs.cache_folder() is None
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


def test_single_and_double_precision_are_kept_apart(folder):
    function = kept()(mean_speed)
    assert function(SPEEDS).dtype == jnp.float32
    with jax.enable_x64(True):
        assert function(SPEEDS.astype(float)).dtype == jnp.float64
    assert len(list(folder.iterdir())) == 2
