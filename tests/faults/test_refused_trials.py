"""What cameras and loggers do to pushes and scoops, from the command line: told with what to write,
before anything is searched.
"""

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from tests.faults import readers_of_trials as trials
from tests.faults.damage import Recording
from tests.faults.test_refused import refused

TASKS = {"pushing": trials.pushed, "scooping": trials.scooped}
LENGTHS = ("x", "y", "z")


def scaled(names, factor):
    return lambda c: c | {k: factor * c[k] for k in names if k in c}


def frozen(c, first, last):
    def hold(x):
        return np.concatenate([x[:first], np.full(last - first, x[first]), x[last:]])

    return c | {k: hold(c[k]) for k in LENGTHS if k in c}


SPOILED = {
    "slow clock": (scaled(["time"], 4.0), "times too slow", "divide column time by"),
    "fast clock": (scaled(["time"], 0.25), "times too fast", "multiply column time by"),
    "cm": (scaled(LENGTHS, 100.0), "looks like cm", "write metres"),
    "mm": (scaled(LENGTHS, 1000.0), "looks like mm", "write metres"),
    "mirrored": (scaled(["y"], -1.0), "mirrored", "turn the sign of y"),
    "frozen": (lambda c: frozen(c, 25, 32), "stands still to the digit", "leave x and y empty"),
    "frozen to the end": (
        lambda c: frozen(c, 27, len(c["time"])),
        "stands still to the digit",
        "leave x and y empty",
    ),
    "held": (
        lambda c: {k: x if k == "time" else np.repeat(x[::3], 3)[: len(x)] for k, x in c.items()},
        "once in 3 rows",
        "keep the rows",
    ),
}


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("name", SPOILED)
def test_spoiled_tracks_are_refused_with_a_mend(tmp_path, capsys, task, name):
    spoil, says, mend = SPOILED[name]
    healthy = TASKS[task]()[0]
    data = trials.write_tracks(task)(
        tmp_path / "data", Recording([spoil(c) for c in healthy.trials], healthy.actions)
    )
    line = refused(capsys, "diagnose", data, "--out", tmp_path / "out")
    assert says in line and mend in line, line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["slow clock", "fast clock", "cm", "frozen", "held"])
def test_a_robot_s_record_is_refused_likewise(tmp_path, name):
    spoil, says, mend = SPOILED[name]
    records = (
        (trials.asked_pushes, trials.read_push_record),
        (trials.asked_scoops, trials.read_scoop_record),
    )
    for made, read in records[
        : 1 if "clock" in name else 2
    ]:  # these scoops' actions are no robot's
        record = trials.write_record(
            tmp_path / "record", Recording([spoil(c) for c in made()[0].trials])
        )
        with pytest.raises(BadInput) as error:
            read(record)
        assert says in str(error.value) and mend in str(error.value)


def test_what_was_frozen_and_is_taken_out_is_read(tmp_path):
    """The mend of the message works."""
    healthy = trials.pushed()[0]
    lost = [{k: [*map(str, x)] for k, x in c.items()} for c in healthy.trials]
    for k in ("x", "y"):
        lost[2][k][25:32] = [""] * 7
    data = trials.write_tracks("pushing")(tmp_path / "data", Recording(lost, healthy.actions))
    assert "nothing was recorded from" in trials.read_pushes(data).told
