"""Tossed bodies: what is read and refused, what is simulated, and what is named."""

import json
import os
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from adaptsim_jax import cli
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.quaternions import between
from adaptsim_jax.tasks.toss.body import mended_xml, read_body
from adaptsim_jax.tasks.toss.catalogue import EFFECTS, quantities
from adaptsim_jax.tasks.toss.diagnose import diagnose
from adaptsim_jax.tasks.toss.flight import free_flight, values_of, whole_tosses
from adaptsim_jax.tasks.toss.read import read
from adaptsim_jax.tasks.toss.simulate import poses
from adaptsim_jax.tasks.toss.windows import cut
from experiments.cube_tosses import slide_ends
from tests.generators import tosses

FEW = {"clock_scale", "tilt", "plane_height"}
REST = tuple(e.name for e in EFFECTS if e.name not in FEW)


def folder(tmp_path, name=None, seed=31, effect=None, count=6, seconds=0.45, **more):
    """A world whose declared contact is its own."""
    truth, recorded = tosses.world(seed, name, count, seconds, effect, **more)
    declared = {k: truth[k] for k in ("friction", "time", "damping")}
    return tosses.written(tmp_path / (name or "null"), truth, recorded, declared)


@pytest.fixture(scope="module")
def null(tmp_path_factory):
    return folder(tmp_path_factory.mktemp("toss"))


def test_tosses_are_read_with_their_noise(null):
    tossed = read(null)
    assert len(tossed.names) == 6
    assert tossed.noise == pytest.approx(tosses.NOISE, rel=0.3)
    assert tossed.noise_turn == pytest.approx(tosses.NOISE_TURN, rel=0.4)
    assert tossed.body.friction == pytest.approx(
        json.loads((null / "truth.json").read_text())["friction"]
    )


def test_one_table_of_all_tosses_is_read_alike(null, tmp_path):
    tossed = read(null)
    rows = ["trial,time,x,y,z,qw,qx,qy,qz"]
    for i, file in enumerate(sorted(null.glob("*.csv")), 1):
        rows += [f"{i},{line}" for line in file.read_text().splitlines()[1:]]
    (tmp_path / "all.csv").write_text("\n".join([*rows, ""]))
    for name in ("meta.toml", "cube.xml"):
        (tmp_path / name).write_text((null / name).read_text())
    again = read(tmp_path)
    assert again.names == tuple("123456")
    np.testing.assert_allclose(again.place[3], tossed.place[3])


def changed(lines, column, what):
    """A file's lines with a column's cells changed."""
    at = lines[0].split(",").index(column)
    cells = [line.split(",") for line in lines[1:]]
    return [
        lines[0],
        *[",".join([*c[:at], what(i, c[at]), *c[at + 1 :]]) for i, c in enumerate(cells)],
    ]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            lambda z: changed(z, "x", lambda i, c: "nan" if i == 4 else c),
            "line 6: column x holds no number",
        ),
        (lambda z: changed(z, "x", lambda i, c: f"{1e3 * float(c) + 1e5:g}"), "is it in mm or cm"),
        (
            lambda z: changed(z, "qw", lambda i, c: "3.0" if i == 4 else c),
            "line 6: the quaternion's length is",
        ),
        (lambda z: [z[0].replace("qz", "q4"), *z[1:]], "column 'qz' is missing"),
        (lambda z: [z[0].replace("qw,qx,qy,qz", "qx,qy,qz,qw"), *z[1:]], "have w last"),
        (lambda z: changed(z, "z", lambda i, c: f"{float(c) - 0.5:g}"), "below the plane z = 0"),
        (lambda z: changed(z, "z", lambda i, c: f"{float(c) + 0.5:g}"), "never come nearer"),
        (lambda z: z[:12], "a toss needs 20"),
        (lambda z: [*z[:30], z[29], *z[30:]], "time repeats"),
        (lambda z: changed(z, "y", lambda i, c: "1.5" if i == 9 else c), "line 11: the body jumps"),
    ],
)
def test_what_cannot_be_judged_is_refused(null, tmp_path, change, says):
    for name in ("meta.toml", "cube.xml"):
        (tmp_path / name).write_text((null / name).read_text())
    for file in null.glob("*.csv"):
        (tmp_path / file.name).write_text("\n".join([*change(file.read_text().splitlines()), ""]))
    with pytest.raises(BadInput, match=says):
        read(tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("<freejoint/>", '<joint type="slide"/>', "one body with a <freejoint/>"),
        ('type="plane"', 'type="plane" pos="0 0 0.1"', "the plane is not z = 0"),
        ('timestep="0.001"', 'timestep="0.01"', "longer than an impact"),
        ("0 0 -9.81", "0 0 0", "write gravity"),
    ],
)
def test_a_model_that_is_no_toss_is_refused(null, tmp_path, old, new, says):
    (tmp_path / "cube.xml").write_text((null / "cube.xml").read_text().replace(old, new))
    with pytest.raises(BadInput, match=says):
        read_body(tmp_path / "cube.xml")


def test_a_key_that_is_unknown_and_a_toss_that_is_not_there(null, tmp_path):
    (tmp_path / "meta.toml").write_text('task = "toss"\nmodle = "cube.xml"\n')
    with pytest.raises(BadInput, match="modle"):
        read(tmp_path)
    with pytest.raises(BadInput, match="no toss is named '77'"):
        read(null).without(["77"])


def test_a_toss_that_never_moves_is_named_with_a_mend_that_works(null):
    tossed = read(null)
    still = replace(
        tossed,
        place=(np.broadcast_to(tossed.place[0][-1], tossed.place[0].shape), *tossed.place[1:]),
        turn=(np.broadcast_to(tossed.turn[0][-1], tossed.turn[0].shape), *tossed.turn[1:]),
    )
    with pytest.raises(BadInput, match=f"{tossed.names[0]}: .*--without {tossed.names[0]}"):
        cut(still)
    assert set(cut(still.without([tossed.names[0]])).toss) == set(range(len(tossed.names) - 1))


def test_a_start_is_where_it_was_recorded_whatever_the_measurement_lacks(null):
    tossed = read(null)
    q = quantities(tossed.body)
    rng = np.random.default_rng(0)
    values = np.array([[z.default + 3 * z.scale * rng.normal() for z in q] for _ in range(5)])
    start = rng.normal(size=(5, 13))
    start[:, 3:7] /= np.linalg.norm(start[:, 3:7], axis=1, keepdims=True)
    start[:, 2] = 2.0
    time = np.tile([0.0, 0.004], (5, 1))
    place, turn = poses(tossed.body, [z.name for z in q], values, start, time)
    np.testing.assert_allclose(place[:, 0], start[:, :3], atol=1e-12)
    np.testing.assert_allclose(between(turn[:, 0], start[:, 3:7]), 0.0, atol=1e-9)
    speed = (place[:, 1] - place[:, 0]) / 0.004
    np.testing.assert_allclose(
        speed, start[:, 7:10], atol=0.15
    )  # gravity acts, and the recorded point turns
    spin = between(turn[:, 0], turn[:, 1]) / 0.004
    np.testing.assert_allclose(spin, start[:, 10:], atol=0.02)


def test_the_model_file_is_the_mended_body(null, tmp_path):
    tossed = read(null)
    given = {
        "friction": 0.3,
        "damping": 0.7,
        "com_x": 0.004,
        "inertia": 0.2,
        "tilt_y": 0.03,
        "size": 0.03,
    }
    values = values_of(tossed, given)
    names = [z.name for z in quantities(tossed.body)]
    (tmp_path / "mended.xml").write_text(
        mended_xml(tossed.body, dict(zip(names, values, strict=True)), ["a note"])
    )
    again = read_body(tmp_path / "mended.xml")
    start = np.array([[0.0, 0.0, 0.12, 0.8, 0.6, 0.0, 0.0, 1.0, 0.5, 0.0, 1.0, 2.0, 3.0]])
    time = np.linspace(0.0, 0.3, 40)[None]
    ours, _ = poses(tossed.body, names, values[None], start, time)
    # a tilt in the file is its gravity's direction, which a reading of the file keeps
    theirs = mujoco.MjData(again.model)
    theirs.qpos[:], theirs.qvel[:] = start[0, :7], start[0, 7:]
    rows = [theirs.qpos[:3].copy()]
    for _ in range(310):
        mujoco.mj_step(again.model, theirs)
        rows.append(theirs.qpos[:3].copy())
    at = time[0] / again.step
    expected = np.stack(
        [np.interp(at, np.arange(len(rows)), np.array(rows)[:, k]) for k in range(3)], 1
    )
    np.testing.assert_allclose(ours[0, :20], expected[:20], atol=1e-7)
    np.testing.assert_allclose(
        ours[0], expected, atol=1e-3
    )  # the file has six digits, which strikes magnify


def test_a_clock_that_is_off_shows_in_free_flight(tmp_path):
    flown = free_flight(read(folder(tmp_path, "clock_scale", effect=0.03, count=12, seconds=0.3)))
    assert flown.off
    assert flown.clock == pytest.approx(-0.03, abs=0.01)


def test_the_declared_world_predicts_whole_tosses(null):
    tossed = read(null)
    vectors = np.tile(values_of(tossed, {}), (6, 1))
    assert np.median(whole_tosses(tossed, vectors)) < 0.02
    assert np.median(slide_ends(tossed, vectors[0])) < 0.01


@pytest.mark.slow
def test_nothing_is_named_where_nothing_lacks(null):
    report = diagnose(null, exclude=REST)
    assert not report["effects"]
    assert report["verdict"] == "within_noise"


@pytest.mark.slow
@pytest.mark.xfail(
    reason="named right, but by 0.012 of the 0.03 that are there: hard strikes make the loss rough "
    "(contact_tasks.md)"
)
def test_a_clock_is_named_from_the_command_line(tmp_path):
    out = tmp_path / "out"
    data = folder(
        tmp_path, "clock_scale", effect=0.03, count=8, height=(0.4, 0.5)
    )  # a long flight shows it
    assert cli.main(["diagnose", str(data), "--out", str(out), "--exclude", *REST]) == 0
    report = json.loads((out / "report.json").read_text())
    (effect,) = report["effects"]
    assert effect["name"] == "clock_scale"
    assert "gravity@force" in effect["alternatives"]
    assert effect["parameters"]["clock"]["value"] == pytest.approx(0.03, abs=0.006)
    assert report["error"]["after"] < report["error"]["before"]
    assert 'name = "clock_scale"' in (out / "model.toml").read_text()
    assert "clock_scale" in (out / "model.xml").read_text()
    assert "Tracks from above" in (out / "report.html").read_text()


def test_the_measured_cube_falls_slowly(tmp_path):
    root = Path(__file__).resolve().parents[3]
    data = (
        Path(os.environ.get("ADAPTSIM_DATA", root.parent / "shared" / "data"))
        / "measured_cube_tosses"
    )
    if not data.is_dir():
        pytest.skip(
            "the cube's tosses are not at hand: set ADAPTSIM_DATA to the folder that holds "
            "measured_cube_tosses"
        )
    from experiments.cube_tosses import written

    tossed = read(written(data, tmp_path)["scored"])
    flown = free_flight(tossed)
    assert 9.55 < flown.low < flown.gravity < flown.high < 9.75
