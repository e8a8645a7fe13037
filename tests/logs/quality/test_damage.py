"""Random damage thrown at files: each either reads, or is refused in one line that names a file."""

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.noise import local_motion
from adaptsim_jax.logs.pendulum import read_pendulum
from adaptsim_jax.logs.quality.audit import audit, usable
from tests.logs.measured_files import META, csv_text, table

FAST = settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
CELLS = [
    "",
    "nan",
    "-inf",
    "1e400",
    "1e308",
    "0x1f",
    "1_0",
    "٣",
    "0,5",
    '"',
    "text",
    "#",
    "−1",
    "1e-320",
    " 0.1 ",
    "0",
]


def columns(rows=60):
    """A plain trial."""
    t = np.arange(rows) / 100
    q = np.stack([0.5 * np.sin(3 * t), 0.8 * np.sin(5 * t)], axis=1)
    v = np.stack([1.5 * np.cos(3 * t), 4.0 * np.cos(5 * t)], axis=1)
    return table(t, q, v, np.stack([0.1 * np.sin(2 * t), np.cos(2 * t)], axis=1))


CSV = csv_text(columns()).encode()


def read_or_refuse(folder):
    """What precedes the fit works, or `BadInput` is raised: one line that names a file of the
    folder.
    """
    try:
        recording = read_pendulum(folder)
    except BadInput as refused:
        message = str(refused)
        assert str(folder) in message and len(message.splitlines()) == 1 and len(message) < 600
        return None
    found = audit(recording)
    for trial in usable(recording, found).trials:
        rows = np.isfinite(trial.q).all(axis=1)
        time, angles = trial.time[rows], trial.q[rows]
        if len(time) > 20:
            q, v = local_motion(time, angles, None if trial.v is None else trial.v[rows])
            assert np.isfinite(q).all() and np.isfinite(v).all()
    return recording


def spoil(raw, edits):
    """Bytes with pieces cut, written over or doubled: `edits` are (kind, place in [0, 1], length,
    bytes).
    """
    for kind, place, length, filling in edits:
        at = int(place * len(raw))
        middle = {"cut": b"", "over": filling, "double": raw[at : at + length] * 2}[kind]
        raw = raw[:at] + middle + raw[at + length :]
    return raw


EDITS = st.lists(
    st.tuples(
        st.sampled_from(["cut", "over", "double"]),
        st.floats(0, 1),
        st.integers(0, 200),
        st.one_of(st.binary(max_size=8), st.sampled_from([c.encode() for c in CELLS])),
    ),
    min_size=1,
    max_size=4,
)


@pytest.fixture
def folder(tmp_path):
    """A folder with a meta.toml only."""
    (tmp_path / "meta.toml").write_text(META)
    return tmp_path


@FAST
@given(edits=EDITS)
def test_damaged_bytes_of_a_csv(folder, edits):
    (folder / "t.csv").write_bytes(spoil(CSV, edits))
    read_or_refuse(folder)


@FAST
@given(edits=EDITS)
def test_damaged_bytes_of_a_meta(folder, edits):
    (folder / "t.csv").write_bytes(CSV)
    (folder / "meta.toml").write_bytes(spoil(META.encode(), edits))
    read_or_refuse(folder)


@FAST
@given(edits=EDITS)
def test_damaged_bytes_of_an_npz(folder, edits):
    np.savez(folder / "t.npz", **columns())
    (folder / "t.npz").write_bytes(spoil((folder / "t.npz").read_bytes(), edits))
    read_or_refuse(folder)


@FAST
@given(
    row=st.integers(0, 60),
    column=st.integers(0, 6),
    cell=st.one_of(st.sampled_from(CELLS), st.floats().map(repr), st.text(max_size=5)),
    deal=st.sampled_from(["cell", "drop", "repeat", "swap"]),
)
@example(row=1, column=0, cell="-140737488355328.0", deal="cell")
@example(row=1, column=0, cell="-70368744177664.0", deal="cell")
@example(row=1, column=0, cell="-35184372088832.0", deal="cell")
@example(row=60, column=0, cell="140737488355328.0", deal="cell")
def test_damaged_rows(folder, row, column, cell, deal):
    lines = CSV.decode().splitlines()
    cells = lines[row].split(",")
    cells[column] = cell
    other = {
        "cell": [",".join(cells)],
        "drop": [],
        "repeat": [lines[row]] * 2,
        "swap": lines[row : row + 2][::-1],
    }
    lines[row : row + (2 if deal == "swap" else 1)] = other[deal]
    (folder / "t.csv").write_text("\n".join(lines), encoding="utf-8", errors="surrogatepass")
    read_or_refuse(folder)


@FAST
@given(data=st.data())
def test_arbitrary_numbers_never_break_the_audit(folder, data):
    rows = data.draw(st.integers(20, 40))
    kinds = st.sampled_from(["zero", "constant", "noise", "huge", "two", "walk"])
    rng = np.random.default_rng(data.draw(st.integers(0, 2**16)))
    made = {"time": np.cumsum(rng.exponential(0.01, rows) + 1e-6)}
    for name in list(columns())[1:]:
        kind = data.draw(kinds)
        made[name] = {
            "zero": np.zeros(rows),
            "constant": np.full(rows, 0.7),
            "noise": rng.normal(0, 1e-3, rows),
            "huge": rng.normal(0, 3e4, rows),
            "two": rng.choice([-1.0, 1.0], rows),
            "walk": np.cumsum(rng.normal(0, 0.1, rows)),
        }[kind]
    (folder / "t.csv").write_text(csv_text(made))
    read_or_refuse(folder)


def test_the_undamaged_trial_reads(folder):
    (folder / "t.csv").write_bytes(CSV)
    assert read_or_refuse(folder).samples == 60


@pytest.mark.parametrize(
    "rest", [b"", b" \n", b"\xef\xbb\xbf", b"\xef\xbb\xbf\n", b",,,,\n", b"\n;;;\n"]
)
def test_what_a_spreadsheet_leaves_of_nothing_is_empty(folder, rest):
    (folder / "t.csv").write_bytes(rest)
    with pytest.raises(BadInput, match=r"t\.csv: is empty"):
        read_pendulum(folder)
