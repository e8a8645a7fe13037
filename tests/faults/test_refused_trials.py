"""What cameras and loggers do to pushes and scoops, from the command line: told with what to write,
before anything is searched.
"""

import pytest

from adaptsim_jax.core.errors import BadInput
from tests.faults import readers_of_trials as trials
from tests.faults.damage import Recording
from tests.faults.test_refused import refused

TASKS = {"pushing": trials.pushed, "scooping": trials.scooped}
LENGTHS = ("x", "y", "z")


def scaled(names, factor):
    return lambda c: c | {k: factor * c[k] for k in names if k in c}


SPOILED = {
    "cm": (scaled(LENGTHS, 100.0), "looks like cm", "write metres"),
    "mm": (scaled(LENGTHS, 1000.0), "looks like mm", "write metres"),
    "mirrored": (scaled(["y"], -1.0), "mirrored", "turn the sign of y"),
}


@pytest.mark.parametrize(
    ("task", "name"),
    [
        (task, name)
        for task in TASKS
        for name in SPOILED
        if (task, name) != ("scooping", "mirrored")
    ],
)
def test_spoiled_tracks_are_refused_with_a_mend(tmp_path, capsys, task, name):
    spoil, says, mend = SPOILED[name]
    healthy = TASKS[task]()[0]
    data = trials.write_tracks(task)(
        tmp_path / "data", Recording([spoil(c) for c in healthy.trials], healthy.actions)
    )
    line = refused(capsys, "diagnose", data, "--out", tmp_path / "out")
    assert says in line and mend in line, line
    assert not (tmp_path / "out").exists()


def test_a_robot_s_record_is_refused_likewise(tmp_path):
    spoil, says, mend = SPOILED["cm"]
    records = (
        (trials.asked_pushes, trials.read_push_record),
        (trials.asked_scoops, trials.read_scoop_record),
    )
    for made, read in records:
        record = trials.write_record(
            tmp_path / "record", Recording([spoil(c) for c in made()[0].trials])
        )
        with pytest.raises(BadInput) as error:
            read(record)
        assert says in str(error.value) and mend in str(error.value)


def test_rows_in_which_a_body_was_lost_are_left_out(tmp_path):
    healthy = trials.pushed()[0]
    lost = [{k: [*map(str, x)] for k, x in c.items()} for c in healthy.trials]
    for k in ("x", "y"):
        lost[2][k][25:32] = [""] * 7
    data = trials.write_tracks("pushing")(tmp_path / "data", Recording(lost, healthy.actions))
    assert "nothing was recorded from" in trials.read_pushes(data).told
