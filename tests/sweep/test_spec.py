"""SPEC.toml: which members it makes, and how faults in it are told."""

import numpy as np
import pytest

from adaptsim_jax.adaptation.sweep_plan import grouped, make_plan, member_bytes
from adaptsim_jax.adaptation.sweep_read import read_sweep
from adaptsim_jax.adaptation.sweep_spec import Lines
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.registry import make_task
from tests.sweep.small import SPEC, write


def test_members_are_the_grid_times_seeds(tmp_path):
    sweep = read_sweep(write(tmp_path))
    assert len(sweep.members) == 8 and sweep.swept == ("hyper.delta", "hyper.learner.learning_rate")
    assert [m.config.seed for m in sweep.members[:3]] == [0, 1, 0]
    last = sweep.members[-1].config
    assert (last.hyper.delta, last.hyper.learner.learning_rate, last.phase1.trajectories) == (
        0.15,
        1e-3,
        64,
    )
    assert len(grouped(sweep)) == 1


def test_sizes_get_programs_of_their_own(tmp_path):
    text = SPEC + "phase1.hidden = [[8], [16, 16]]\n"
    groups = grouped(read_sweep(write(tmp_path, text)))
    assert [len(g) for g in groups] == [8, 8]
    assert groups[1][0].config.phase1.hidden == (16, 16)


RANDOM = """
[random]
count = 5
seed = 3
[random.values]
hyper.gain = {low = 1, high = 100, scale = "log"}
phase1.updates = {low = 1, high = 3, integer = true}
hyper.shrink = {choice = [0.7, 1.0]}
"""


def test_random_values_lie_in_their_ranges_and_come_again(tmp_path):
    text = SPEC.split("[grid]")[0] + RANDOM
    first, again = (read_sweep(write(tmp_path, text)) for _ in range(2))
    assert [m.values for m in first.members] == [m.values for m in again.members]
    gains = np.array([m.config.hyper.gain for m in first.members])
    assert len(set(gains)) == 5 and gains.min() >= 1 and gains.max() <= 100
    assert {m.config.hyper.shrink for m in first.members} <= {0.7, 1.0}
    assert {m.config.phase1.updates for m in first.members} <= {1, 2, 3}


def test_listed_values_belong_together(tmp_path):
    text = (
        SPEC.split("[grid]")[0]
        + "[[list]]\nhyper.delta = 0.1\nhyper.shrink = 1\n[[list]]\nhyper.delta = "
        "0.3\nhyper.shrink = 0.7\n"
    )
    sweep = read_sweep(write(tmp_path, text))
    assert [m.values for m in sweep.members[::2]] == [
        {"hyper.delta": 0.1, "hyper.shrink": 1},
        {"hyper.delta": 0.3, "hyper.shrink": 0.7},
    ]


def changed(old, new):
    assert old in SPEC
    return SPEC.replace(old, new)


BAD = {
    "no such key": (
        changed("hyper.delta = [0.1", "hyper.dleta = [0.1"),
        "line 20: unknown key 'hyper.dleta'; did you mean 'delta'?",
    ),
    "no such key of the task": (
        changed("task.scaling", "task.scalign"),
        "line 8: unknown key 'task.scalign'; did you mean 'scaling'?",
    ),
    "no such table": (
        changed("[grid]", "[gird]"),
        "line 19: unknown key 'gird'; did you mean 'grid'?",
    ),
    "out of bounds": (
        changed("[0.1, 0.15]", "[0.1, -0.15]"),
        "line 20: hyper.delta = -0.15: give a positive number",
    ),
    "of another type": (
        changed("[3e-4, 1e-3]", '[3e-4, "fast"]'),
        "line 21: key 'hyper.learner.learning_rate' is 'fast'",
    ),
    "do not fit": (
        changed("parallel = 8", "parallel = 7"),
        "line 10: 64 trajectories do not divide",
    ),
    "no list": (
        changed("[0.1, 0.15]", "0.1"),
        "line 20: key 'hyper.delta' is 0.1; a list of values is wanted",
    ),
    "no such target": (
        changed('"ood-1"', '"ood-9"'),
        "line 3: unknown target 'ood-9'; did you mean",
    ),
    "a seed twice": (
        changed("seeds = 2", "seeds = [1, 1]"),
        "line 2: seeds = [1, 1]",
    ),
    "no seed": (
        changed("seeds = 2", "seeds = 0"),
        "line 2: seeds = 0",
    ),
    "the seed swept": (
        changed("hyper.delta = [0.1, 0.15]", "seed = [0, 1]"),
        "line 20: key 'seed' is not swept",
    ),
    "swept twice": (
        SPEC + '[[list]]\n"hyper.delta" = 1\n',
        "line 20: key 'hyper.delta' is swept twice",
    ),
    "no such preset": (
        'preset = "paper-pendulm"\n' + SPEC,
        "line 1: unknown preset 'paper-pendulm'; did you mean 'paper-pendulum'?",
    ),
    "no such task": (
        changed('"pendulum"', '"pendulm"'),
        "line 1: unknown task 'pendulm'; did you mean 'pendulum'?",
    ),
    "a size of nothing": (
        SPEC + "phase1.batch = [8, 0]\n",
        "line 22: phase1.batch = 0: give at least 1",
    ),
    "random without a count": (
        SPEC + "[random]\nseed = 1\n[random.values]\nhyper.gain = {low = 1, high = 2}\n",
        "line 22: random needs count",
    ),
    "high below low": (
        SPEC + "[random]\ncount = 1\n[random.values]\nhyper.gain = {low = 3, high = 2}\n",
        "line 25: key 'hyper.gain': low = 3.0, high = 2.0",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_wrong_is_named_with_its_line(name, tmp_path):
    text, said = BAD[name]
    with pytest.raises(BadInput) as error:
        read_sweep(write(tmp_path, text))
    assert f"SPEC.toml, {said}" in str(error.value), str(error.value)


def test_lines_of_arrays_that_take_several():
    lines = Lines("f", 'a = [\n  "x = 1",\n  2,\n]\n[b]\nc.d = 1\n[[e]]\nf = 2\n[[e]]\nf = 3\n')
    assert lines.at == {"a": 1, "b": 5, "b.c.d": 6, "e.0": 7, "e.0.f": 8, "e.1": 9, "e.1.f": 10}


def test_batches_fit_into_memory_and_onto_devices(tmp_path):
    sweep = read_sweep(write(tmp_path))
    config = sweep.members[0].config
    each = member_bytes(make_task("pendulum", config.task), config.phase1)
    plan = make_plan(sweep, devices=1, memory=7 * each)  # half of it is used: three members
    assert [b.last - b.first for b in plan.batches] == [3, 3, 2] and plan.groups[0].width == 3
    assert make_plan(sweep, devices=4, at_once=3).groups[0].split == (2, 2)
    assert make_plan(sweep, devices=3, at_once=8).groups[0].width == 9  # padded
    with pytest.raises(BadInput, match="a member of this sweep takes about"):
        make_plan(sweep, devices=1, memory=each)
