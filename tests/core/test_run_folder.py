"""Run folders: what a resumed run finds is what an uninterrupted one would have had."""

import tracemalloc

import jax
import jax.numpy as jnp
import pytest

from adaptsim_jax import __version__
from adaptsim_jax.core import config, store
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.store import RunFolder

CONFIG = {"seed": 3, "rounds": 10, "hyper": {"delta": 0.1, "hidden": [64, 64]}}


def new_run(path):
    return RunFolder.create(path, CONFIG, task="pendulum")


def rows(first, last):
    return [{"step": step, "reward": step / 7} for step in range(first, last)]


def test_metrics_and_state_go_on_from_the_checkpoint(tmp_path):
    run = new_run(tmp_path / "run")
    run.append_metrics(rows(0, 4))
    run.save({"x": jnp.float32(4)}, step=4)
    run.append_metrics(rows(4, 8))  # killed before the next checkpoint,
    with open(run.metrics, "a") as file:
        file.write('{"step": 8, "rew')  # in the middle of a line
    again = RunFolder.resume(tmp_path / "run", CONFIG, task="pendulum")
    tree, step = again.restore({"x": jnp.float32(0)})
    assert (float(tree["x"]), step) == (4.0, 4)
    again.append_metrics(rows(4, 8))
    assert again.read_metrics() == rows(0, 8)
    straight = new_run(tmp_path / "straight")
    straight.append_metrics(rows(0, 8))
    assert again.metrics.read_bytes() == straight.metrics.read_bytes()


def test_killed_before_the_first_checkpoint(tmp_path):
    run = new_run(tmp_path)
    run.append_metrics(rows(0, 2))
    like = {"x": jnp.float32(1)}
    assert RunFolder.resume(tmp_path, CONFIG, task="pendulum").restore(like) == (like, 0)
    assert run.read_metrics() == []


def test_a_number_that_is_not_finite_is_null(tmp_path):
    """Strict JSON, which other readers take."""
    run = new_run(tmp_path)
    run.append_metrics([{"step": 0, "reward": float("nan"), "loss": float("inf")}])
    assert run.metrics.read_text() == '{"step": 0, "reward": null, "loss": null}\n'
    assert run.read_metrics() == [{"step": 0, "reward": None, "loss": None}]


def test_metrics_that_were_cut_are_refused(tmp_path):
    run = new_run(tmp_path)
    run.append_metrics(rows(0, 4))
    run.save({"x": jnp.float32(4)}, step=4)
    run.metrics.write_text("")
    with pytest.raises(BadInput, match=r"metrics\.jsonl: 0 bytes"):
        run.restore({"x": jnp.float32(0)})


def test_another_config_is_named_key_by_key(tmp_path):
    new_run(tmp_path)
    other = {"seed": 3, "rounds": 12, "hyper": {"delta": 0.2, "hidden": [64, 64]}}
    with pytest.raises(
        BadInput, match=r"hyper\.delta: 0\.1 there, 0\.2 asked; rounds: 10 there, 12 asked"
    ):
        RunFolder.resume(tmp_path, other, task="pendulum")


def test_a_config_edited_after_the_checkpoint_is_refused(tmp_path):
    run = new_run(tmp_path)
    run.save({"x": jnp.float32(4)}, step=4)
    path = tmp_path / store.CONFIG
    path.write_text(path.read_text().replace("delta = 0.1", "delta = 0.3"))
    with pytest.raises(BadInput, match="was changed since"):
        RunFolder.open(tmp_path).load({"x": jnp.float32(0)})


def test_a_run_is_not_written_over(tmp_path):
    new_run(tmp_path)
    with pytest.raises(BadInput, match="holds a run already; add --resume"):
        new_run(tmp_path)


def test_what_is_not_a_run_is_refused(tmp_path):
    with pytest.raises(BadInput, match="no such run folder"):
        RunFolder.open(tmp_path / "none")
    with pytest.raises(BadInput, match="not a run folder"):
        RunFolder.open(tmp_path)
    head = f'schema = 1\nversion = "{__version__}"'
    for text, says in (
        ("schema = ", "not TOML"),
        ("a = 1", "written by adaptsim_jax None"),
        (head, "is missing"),
        ('schema = 1\nversion = "7.0.0"\ntask = "pendulum"\n[config]', "install that version"),
        (f'{head}\ntask = "pushing"\n[config]', "is of task 'pushing'"),
    ):
        (tmp_path / store.CONFIG).write_text(text)
        with pytest.raises(BadInput, match=says):
            RunFolder.open(tmp_path, task="pendulum")


def test_config_survives_the_file(tmp_path):
    run = new_run(tmp_path)
    again = RunFolder.open(tmp_path, task="pendulum")
    assert again.config == CONFIG and again.config_hash == run.config_hash == config.digest(CONFIG)


@pytest.mark.parametrize("torn", ["payload", "manifest"])
def test_where_the_last_checkpoint_is_torn_the_one_before_is_taken(tmp_path, torn, capsys):
    run = new_run(tmp_path)
    for step in (2, 4, 6):
        run.append_metrics(rows(step - 2, step))
        run.save({"x": jnp.float32(step)}, step=step)
    name = store.MANIFEST
    if torn == "payload":
        name = store.read_manifest(run.checkpoint)["payload"]
    path = run.checkpoint / name
    path.write_bytes(path.read_bytes()[:-20])
    tree, step = RunFolder.open(tmp_path).load({"x": jnp.float32(0)})
    assert (float(tree["x"]), step) == (4.0, 4)
    said = capsys.readouterr().err
    assert "torn" in said and "the one before it is taken, of step 4" in said
    assert said.count("\n") == 1
    again = RunFolder.resume(tmp_path, CONFIG, task="pendulum")
    assert again.restore({"x": jnp.float32(0)})[1] == 4
    assert again.read_metrics() == rows(0, 4)
    again.append_metrics(rows(4, 6))
    again.save({"x": jnp.float32(6)}, step=6)
    before = store.load_checkpoint(run.checkpoint / store.BEFORE, tree, task="pendulum")
    assert before[1] == 4 and again.restore(tree)[1] == 6
    assert len(list(run.checkpoint.rglob("*.npz"))) == 2


def test_a_checkpoint_is_written_without_a_copy_of_all_of_it(tmp_path):
    big = {str(i): jnp.full(1_000_000, i, jnp.float32) for i in range(8)}  # 32 MB
    run = new_run(tmp_path)
    jax.block_until_ready(big)
    tracemalloc.start()
    run.save(big, step=1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6  # NumPy writes 16 MB at a time


OWN = {"seed": 3, "task": {"env": "", "length": 20, "targets": {"dry": {"friction": 1.0}}}}


def own_run(folder):
    """A run with an environment of a person's own, in the file beside it."""
    (folder / "cart.py").write_text("")
    table = {**OWN, "task": {**OWN["task"], "env": f"{folder / 'cart.py'}:make"}}
    run = RunFolder.create(folder / "a", table, task="environment")
    run.save({"x": jnp.float32(4)}, step=4)
    return table


def test_a_run_and_its_environments_file_move_together(tmp_path):
    (tmp_path / "here").mkdir()
    table = own_run(tmp_path / "here")
    (tmp_path / "here").rename(tmp_path / "there")
    run = RunFolder.open(tmp_path / "there/a")
    assert run.config["task"]["env"] == f"{tmp_path / 'there/cart.py'}:make"
    assert run.load({"x": jnp.float32(0)})[1] == 4
    moved = {**table, "task": {**table["task"], "env": f"{tmp_path / 'there/cart.py'}:make"}}
    assert RunFolder.resume(tmp_path / "there/a", moved, task="environment").config == moved


def test_a_run_that_moved_alone_is_told_where_the_file_is_by_one_line(tmp_path):
    (tmp_path / "here").mkdir()
    own_run(tmp_path / "here")
    (tmp_path / "here/a").rename(tmp_path / "b")
    path = tmp_path / "b" / store.CONFIG
    text = path.read_text()
    assert 'env = "../cart.py:make"' in text
    path.write_text(text.replace("../cart.py", str(tmp_path / "here/cart.py")))
    run = RunFolder.open(tmp_path / "b")
    assert run.config["task"]["env"] == f"{tmp_path / 'here/cart.py'}:make"
    assert run.load({"x": jnp.float32(0)})[1] == 4


def test_a_target_that_is_added_later_is_no_other_run(tmp_path):
    table = own_run(tmp_path)
    table["task"] = {**table["task"], "targets": {"wet": {"friction": 0.1}}}
    run = RunFolder.resume(tmp_path / "a", table, task="environment")
    assert run.load({"x": jnp.float32(0)})[1] == 4
    assert RunFolder.open(tmp_path / "a").config["task"]["targets"] == {"wet": {"friction": 0.1}}
    table["task"] = {**table["task"], "length": 30}
    with pytest.raises(BadInput, match=r"task\.length: 20 there, 30 asked"):
        RunFolder.resume(tmp_path / "a", table, task="environment")


def test_a_run_of_before_with_a_whole_path_is_read(tmp_path):
    table = own_run(tmp_path)
    run = RunFolder.open(tmp_path / "a")
    head = {"schema": store.SCHEMA, "version": store.__version__, "task": "environment"}
    config.write(run.path / store.CONFIG, {**head, "config": table})
    hashed = config.digest(table)
    store.save_checkpoint(
        run.checkpoint, {"x": jnp.float32(2)}, task="environment", step=2, config_hash=hashed
    )
    assert RunFolder.open(tmp_path / "a").load({"x": jnp.float32(0)})[1] == 2
