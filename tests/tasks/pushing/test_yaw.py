"""The bottle's turn where a camera saw it: how it is read, what is refused, and what of it enters
the residuals.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.pushing.diagnosis import catalogue
from adaptsim_jax.tasks.pushing.diagnosis.diagnose import diagnose
from adaptsim_jax.tasks.pushing.diagnosis.problem import TURNING, prepare
from adaptsim_jax.tasks.pushing.diagnosis.read import TURN, read
from experiments import pushing_worlds

NOISE = 0.01


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    folder = tmp_path_factory.mktemp("worlds")
    pushing_worlds.write([("off_axis", 9043001)], folder, pushes=6, turned=NOISE)
    return folder / "off_axis-9043001"


def test_a_turn_in_some_files_only_is_refused_by_the_file_that_lacks_it(world, tmp_path):
    folder = changed(world, tmp_path / "some", lambda yaw: yaw)
    lines = (folder / "tracks.csv").read_text().splitlines()
    last = [
        line for line in lines[1:] if float(line.split(",")[0]) == float(lines[-1].split(",")[0])
    ]
    (folder / "tracks.csv").write_text(
        "\n".join([lines[0], *(line for line in lines[1:] if line not in last), ""])
    )
    (folder / "more.csv").write_text(
        "\n".join(line.rsplit(",", 1)[0] for line in [lines[0], *last]) + "\n"
    )
    with pytest.raises(BadInput, match=r"more.csv: no column 'yaw', which tracks.csv has; add it"):
        read(folder)


def changed(world, folder, change, meta=""):
    """A copy of the world with `change(yaw [N]) -> [N]` of all rows, or without the column where
    there is none.
    """
    folder.mkdir()
    for name in ("actions.csv", "truth.json"):
        (folder / name).write_text((world / name).read_text())
    (folder / "meta.toml").write_text((world / "meta.toml").read_text() + meta)
    rows = [line.rsplit(",", 1) for line in (world / "tracks.csv").read_text().splitlines()]
    lines = [row[0] for row in rows]
    if change:
        yaw = change(np.array([float(row[1] or "nan") for row in rows[1:]]))
        lines = [
            f"{rows[0][0]},yaw",
            *(f"{a},{'' if np.isnan(z) else z}" for a, z in zip(lines[1:], yaw, strict=True)),
        ]
    (folder / "tracks.csv").write_text("\n".join([*lines, ""]))
    return folder


def test_turns_are_read_from_any_marker_without_whole_turns_and_drop_outs(world, tmp_path):
    pushed = read(world)
    assert pushed.channels == ("x", "y", "yaw") and pushed.noise_yaw == pytest.approx(
        NOISE, rel=0.3
    )
    assert 0.9 < pushed.turned.sum() / pushed.mask.sum() < 1.0
    assert np.abs(np.diff(pushed.yaw, axis=1)).max() < 0.5
    assert np.abs(pushed.yaw[:, :8]).max() < 0.05 and np.abs(pushed.yaw).max() > 0.3
    bare = read(changed(world, tmp_path / "bare", None))
    assert bare.channels == ("x", "y") and bare.yaw is None
    np.testing.assert_array_equal(bare.xy, pushed.xy)
    declared = read(changed(world, tmp_path / "declared", lambda z: z, "noise_yaw = 0.02\n"))
    assert declared.noise_yaw == 0.02
    smooth = read(changed(world, tmp_path / "smooth", lambda z: np.where(np.isnan(z), z, 0.5)))
    assert smooth.noise_yaw == TURN.smallest


@pytest.mark.parametrize(
    ("change", "meta", "says"),
    [
        (
            np.degrees,
            "",
            r"tracks.csv: line \d+: trial 1: yaw = .* rad is several turns; is it in degrees\? "
            r"write radians",
        ),
        (
            lambda z: np.where(np.arange(len(z)) == 100, z + 2.5, z),
            "",
            r"turns by 2.\d rad between two rows; empty the cells",
        ),
        (
            lambda z: np.degrees(NOISE) * np.random.default_rng(0).standard_normal(len(z)),
            "",
            "in degrees|between two rows",
        ),
        (
            lambda z: z,
            "noise_yaw = 3.0\n",
            "meta.toml: noise_yaw = 3.0 is no size in rad; write e.g. 0.01",
        ),
        (lambda z: np.nan * z, "", "column yaw holds no number in any row"),
    ],
)
def test_turns_that_cannot_be_judged_are_refused(world, tmp_path, change, meta, says):
    with pytest.raises(BadInput, match=says):
        read(changed(world, tmp_path / "bad", change, meta))


def test_residuals_hold_the_turn_whatever_way_the_marker_was_glued_on(world):
    truth = json.loads((world / "truth.json").read_text())
    pushed = read(world)
    problem = prepare(pushed, pushed.options, pushed.coefficients)
    given = {
        "mu": truth["mu"],
        "log_e": np.log10(truth["e"]),
        "mu_p": truth["mu_p"],
        "y_p": truth["y_p"],
    }
    given |= dict(
        zip(TURNING, (truth["light"] * 4.5e-4, truth["com_x"], truth["com_y"]), strict=True)
    )
    values = problem.neutral
    values[problem.at(given)] = list(given.values())
    vectors = np.tile(values, (len(pushed.names), 1))
    left = problem.residuals(vectors)
    assert problem.channels == 3 and problem.counts.sum() == pushed.known.sum() - 6
    assert np.square(left).sum() / problem.counts.sum() < 1.5
    still = vectors.copy()
    still[:, problem.at(TURNING)] = 0.0
    assert np.square(problem.residuals(still)).sum() / problem.counts.sum() > 100.0
    glued = replace(pushed, yaw=pushed.yaw + np.arange(6.0)[:, None])
    other = prepare(glued, pushed.options, pushed.coefficients)
    np.testing.assert_allclose(other.residuals(vectors), left, atol=1e-3)


def test_whether_a_bottle_turns_is_asked_where_yaw_was_measured():
    with_yaw, without = ({e.name for e in catalogue.effects_of(yaw)} for yaw in (True, False))
    assert with_yaw - without == {"turning"}


@pytest.mark.slow
def test_a_bottle_that_turns_at_the_edge_of_a_patch_is_named(tmp_path):
    pushing_worlds.write([("turning", 9045009)], tmp_path, turned=NOISE)
    (effect,) = diagnose(tmp_path / "turning-9045009")["effects"]
    assert effect["name"] == "turning"
