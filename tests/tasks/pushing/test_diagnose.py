"""`adaptsim diagnose` on pushes, from files."""

import json

import pytest

from adaptsim_jax import cli
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.sysid.report.schema import read_report
from adaptsim_jax.tasks.pushing.tracks import read_tracks
from tests.generators.push_worlds import write_world


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_world(tmp_path_factory.mktemp("tilt"), "single", 5, "tilt") / "recording"


def changed(recording, tmp_path, change):
    """A copy whose tracks.csv went through `change(rows)`."""
    head, *rows = (recording / "tracks.csv").read_text().splitlines()
    table = [[float(x) for x in row.split(",")] for row in rows]
    (tmp_path / "tracks.csv").write_text(
        "\n".join([head, *(",".join(f"{x:.6g}" for x in r) for r in change(table))]) + "\n"
    )
    for name in ("meta.toml", "actions.csv"):
        (tmp_path / name).write_text((recording / name).read_text())
    return tmp_path


@pytest.mark.slow
def test_a_tilted_table_is_named_and_what_is_left_is_the_camera_s_noise(recording, tmp_path):
    assert cli.main(["diagnose", str(recording), "--out", str(tmp_path / "out")]) == 0
    report = read_report(tmp_path / "out" / "report.json")
    truth = json.loads((recording.parent / "truth.json").read_text())["size"]
    tilt = next(e for e in report["effects"] if e["name"] == "tilt")
    assert tilt["parameters"]["tilt_x"]["value"] == pytest.approx(truth["x"], abs=0.002)
    assert tilt["parameters"]["tilt_y"]["value"] == pytest.approx(truth["y"], abs=0.002)
    assert report["error"]["after"] < 1.5 * report["error"]["noise_floor"] < report["error"]["before"]
    assert {"model.toml", "report.html", "tracks.png"} <= {p.name for p in (tmp_path / "out").iterdir()}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda rows: [[t, time, x, -y] for t, time, x, y in rows], "y is mirrored"),
        (lambda rows: [[t, 1e3 * time, x, y] for t, time, x, y in rows], "is time in ms"),
        (lambda rows: [[t, time, 1e3 * x, 1e3 * y] for t, time, x, y in rows], "mm or cm"),
        (lambda rows: [[t, time, x + 0.5, y] for t, time, x, y in rows], "arm's base frame"),
        (lambda rows: [r for r in rows if r[0] < 4], "a diagnosis needs"),
        (lambda rows: [[t + 90, time, x, y] for t, time, x, y in rows], "no row in actions.csv"),
    ],
)
def test_what_cannot_be_meant_is_refused(recording, tmp_path, change, said):
    with pytest.raises(BadInput, match=said):
        read_tracks(changed(recording, tmp_path, change))


def test_a_bottle_that_was_not_hit_is_told_and_left_out(recording, tmp_path):
    still = lambda rows: [[t, time, 0.56, 0.0] if t == 3 else [t, time, x, y] for t, time, x, y in rows]
    tracks = read_tracks(changed(recording, tmp_path, still))
    assert "3" not in tracks.trials and any("never moved" in note for note in tracks.notes)
