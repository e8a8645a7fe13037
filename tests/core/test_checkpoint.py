"""Checkpoints: the same bits back, and one line for anything that is not a whole checkpoint of this
task.
"""

import errno
import hashlib
import json
import os
import signal
import subprocess
import sys
import textwrap

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from adaptsim_jax.core import files, store
from adaptsim_jax.core.errors import BadInput

TASK = "pendulum"


def a_tree():
    return {
        "key": jax.random.key(7),
        "keys": jax.random.split(jax.random.key(1, impl="rbg"), 3),
        "weights": [jax.random.normal(jax.random.key(0), (4, 3)), jnp.float32(0.1)],
        "half": jnp.array([1.5, -0.0, jnp.inf], jnp.bfloat16),
        "special": jnp.array([jnp.nan, -jnp.inf, 1e-45], jnp.float32),
        "counts": (jnp.arange(5), np.arange(3, dtype=np.int64)),
        "flag": jnp.array(True),
        "empty": jnp.zeros((0, 2)),
        "plain": 0.1,
        "rounds": 3,
    }


def save(folder, tree, step=5, task=TASK):
    store.save_checkpoint(folder, tree, task=task, step=step, config_hash="c")


def bits(leaf):
    if hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        leaf = jax.random.key_data(leaf)
    array = np.asarray(leaf)
    return array.dtype.name, array.shape, array.tobytes()


def assert_same(a, b):
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert type(x) is type(y)
        assert bits(x) == bits(y)


def test_round_trip_is_bit_exact(tmp_path):
    tree = a_tree()
    save(tmp_path, tree)
    loaded, step = store.load_checkpoint(tmp_path, tree, task=TASK)
    assert step == 5
    assert_same(loaded, tree)
    assert jax.random.bits(loaded["key"]) == jax.random.bits(tree["key"])


def test_round_trip_in_x64(tmp_path):
    with jax.enable_x64(True):
        tree = {"a": jnp.array([1.0 / 3.0]), "n": jnp.array(2**40)}
        save(tmp_path, tree)
        assert_same(store.load_checkpoint(tmp_path, tree, task=TASK)[0], tree)
    with pytest.raises(BadInput, match="dtype float64"):
        store.load_checkpoint(tmp_path, {"a": jnp.zeros(1), "n": jnp.array(1)}, task=TASK)


def test_like_may_be_shapes_only(tmp_path):
    tree = {"key": jax.random.key(3), "x": jnp.arange(4.0)}
    save(tmp_path, tree)
    like = jax.eval_shape(lambda: {"key": jax.random.key(0), "x": jnp.zeros(4)})
    assert_same(store.load_checkpoint(tmp_path, like, task=TASK)[0], tree)


def test_the_last_one_replaces_the_one_before(tmp_path):
    for step in range(3):
        save(tmp_path, {"x": jnp.float32(step)}, step=step)
        save(tmp_path, {"x": jnp.float32(step) + 10}, step=step)
    loaded, step = store.load_checkpoint(tmp_path, {"x": jnp.float32(0)}, task=TASK)
    assert (float(loaded["x"]), step) == (12.0, 2)
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize(
    "like, says",
    [
        ({"x": jnp.zeros(3)}, "shape"),
        ({"x": jnp.zeros(2, jnp.int32)}, "dtype"),
        ({"y": jnp.zeros(2)}, "other arrays"),
        ({"x": jnp.zeros(2), "y": jnp.zeros(2)}, "other arrays"),
    ],
)
def test_another_structure_is_refused(tmp_path, like, says):
    save(tmp_path, {"x": jnp.zeros(2)})
    with pytest.raises(BadInput, match=says):
        store.load_checkpoint(tmp_path, like, task=TASK)


def test_another_task_version_or_program_is_refused(tmp_path):
    like = {"x": jnp.zeros(2)}
    with pytest.raises(BadInput, match="no checkpoint"):
        store.load_checkpoint(tmp_path, like, task=TASK)
    save(tmp_path, like)
    with pytest.raises(BadInput, match="of task 'pendulum', not 'pushing'"):
        store.load_checkpoint(tmp_path, like, task="pushing")
    manifest = json.loads((tmp_path / store.MANIFEST).read_text())
    for change, says in (
        ({"version": "99.0.0"}, "written by adaptsim_jax 99.0.0"),
        ({"schema": 2}, "schema 2"),
        ({"package": "other"}, "not a checkpoint of adaptsim_jax"),
        ({"step": 6}, "torn"),
        ({"payload": "../state.npz"}, "torn"),
    ):
        (tmp_path / store.MANIFEST).write_text(json.dumps({**manifest, **change}))
        with pytest.raises(BadInput, match=says):
            store.load_checkpoint(tmp_path, like, task=TASK)


class Bomb:
    def __reduce__(self):
        return os.system, ("touch exploded",)


def test_loading_never_unpickles(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    like = {"x": jnp.zeros(2)}
    save(tmp_path, like)
    manifest = json.loads((tmp_path / store.MANIFEST).read_text())
    payload = tmp_path / manifest["payload"]
    np.savez(payload, a0=np.array([Bomb(), Bomb()], dtype=object))
    data = payload.read_bytes()
    manifest |= {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    manifest["seal"] = store._seal(manifest)
    (tmp_path / store.MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(BadInput, match="not a checkpoint payload"):
        store.load_checkpoint(tmp_path, like, task=TASK)
    assert not (tmp_path / "exploded").exists()


def test_a_leaf_that_is_no_array_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(TypeError, match="name"):
        save(tmp_path / "c", {"name": "text"})
    assert not list((tmp_path / "c").glob("*"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    tree = {"key": jax.random.key(2), "x": jnp.arange(40.0)}
    save(folder, tree)
    return tree, {path.name: path.read_bytes() for path in folder.iterdir()}


@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_torn_anywhere(whole, tmp_path_factory, data):
    """Cut, flip, overwrite or extend either file at any byte: refused in one line, or the very same
    bits.
    """
    tree, contents = whole
    name = data.draw(st.sampled_from(sorted(contents)))
    old = contents[name]
    place = data.draw(st.integers(0, len(old) - 1))
    damage = data.draw(st.sampled_from(["cut", "flip", "zero", "extend", "insert"]))
    new = {
        "cut": lambda: old[:place],
        "flip": lambda: (
            old[:place]
            + bytes([old[place] ^ (1 << data.draw(st.integers(0, 7)))])
            + old[place + 1 :]
        ),
        "zero": lambda: old[:place] + bytes(len(old) - place),
        "extend": lambda: old + data.draw(st.binary(min_size=1, max_size=9)),
        "insert": lambda: old[:place] + data.draw(st.binary(min_size=1, max_size=9)) + old[place:],
    }[damage]()
    folder = tmp_path_factory.mktemp("torn")
    for other, content in contents.items():
        (folder / other).write_bytes(new if other == name else content)
    try:
        loaded, step = store.load_checkpoint(folder, tree, task=TASK)
    except BadInput as error:
        assert "\n" not in str(error) and str(folder) in str(error)
    else:
        # zeros over zeros are no damage, and white space in JSON carries nothing
        assert new == old or (name == store.MANIFEST and json.loads(new) == json.loads(old))
        assert step == 5
        assert_same(loaded, tree)


def test_every_truncation_of_both_files_is_refused(whole, tmp_path):
    tree, contents = whole
    for name, old in contents.items():
        for other, content in contents.items():
            (tmp_path / other).write_bytes(content)
        # the last byte of the manifest is its line end
        for length in range(0, len(old) - 1, 7):
            (tmp_path / name).write_bytes(old[:length])
            with pytest.raises(BadInput):
                store.load_checkpoint(tmp_path, tree, task=TASK)
        (tmp_path / name).unlink()
        with pytest.raises(BadInput):
            store.load_checkpoint(tmp_path, tree, task=TASK)


@pytest.mark.parametrize("call", ["write", "fsync", "replace"])
def test_a_disk_that_fills_leaves_the_old_checkpoint(tmp_path, monkeypatch, call):
    old, new = {"x": jnp.zeros(1000)}, {"x": jnp.ones(1000)}
    save(tmp_path, old, step=1)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def full(*_args, **_kwargs):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        if call == "write":
            real = os.fdopen
            patch.setattr(files.os, "fdopen", lambda handle, mode: _FullFile(real(handle, mode)))
        else:
            patch.setattr(files.os, call, full)
        with pytest.raises(BadInput, match="no space left on the disk; free some"):
            save(tmp_path, new, step=2)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert_same(store.load_checkpoint(tmp_path, old, task=TASK)[0], old)


class _FullFile:
    """A file on a disk with room for ten bytes."""

    def __init__(self, file):
        self.file = file

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.file.close()

    def write(self, data):
        self.file.write(data[:10])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_folder_below_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="cannot be written"):
        save(tmp_path / "file" / "run", {"x": jnp.zeros(1)})


WRITER = """
import sys, jax.numpy as jnp
from adaptsim_jax.core import store
step = 0
while True:
    step += 1
    tree = {"x": jnp.full(20_000, step, jnp.float32)}
    store.save_checkpoint(sys.argv[1], tree, task="pendulum", step=step, config_hash="c")
    if step == 1:
        print("ready", flush=True)
"""


def test_killed_at_any_moment_a_whole_checkpoint_is_there(tmp_path):
    """SIGKILL while checkpoints are written without pause, at several moments."""
    like = {"x": jnp.zeros(20_000)}
    for delay in (0.0, 0.003, 0.011, 0.023):
        process = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(WRITER), str(tmp_path)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert process.stdout.readline() == "ready\n"
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(delay)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        loaded, step = store.load_checkpoint(tmp_path, like, task=TASK)
        assert np.all(np.asarray(loaded["x"]) == step)
    save(tmp_path, like)
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".json", ".npz"]


def test_ctrl_c_as_a_part_is_opened_stays_ctrl_c(tmp_path, monkeypatch):
    """`zipfile` says that it cannot close the archive, in the place of it."""

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("zipfile._get_compressor", interrupted)
    with pytest.raises(KeyboardInterrupt):
        store.save_checkpoint(tmp_path / "c", a_tree(), task=TASK, step=1, config_hash="")
