"""Registers whose sign is a bit, or was not read, and counters that go on from their other end."""

import numpy as np
import pytest

from adaptsim_jax.logs.read import read_log
from tests.logs.log_files import folder, motion

M = motion(2, rows=200)
ARM = ("shoulder", "elbow")
ZERO = 150
COUNTS = np.round(M["q"] / (2 * np.pi) * 4096).astype(int) + ZERO  # below zero for a while
TICKS = "".join(f"q_{j} = {{ticks = 4096, zero = {ZERO}}}\n" for j in ARM)
WORDS = {
    "sign in bit 15": (lambda n: np.where(n < 0, 32768 - n, n), "bit 15 taken as the sign"),
    "sign in bit 11": (lambda n: np.where(n < 0, 2048 - n, n), "bit 11 taken as the sign"),
    "16 bits": (lambda n: n % 2**16, "words of 16 bits"),
    "32 bits": (lambda n: n % 2**32, "words of 32 bits"),
}


def columns(q, v=None):
    out = {"time": M["time"]} | {f"q_{j}": 1.0 * q[:, k] for k, j in enumerate(ARM)}
    out |= {f"tau_{j}": M["tau"][:, k] for k, j in enumerate(ARM)}
    if v is not None:
        out |= {f"v_{j}": 1.0 * v[:, k] for k, j in enumerate(ARM)}
    return out


@pytest.mark.parametrize("kind", WORDS)
def test_words_below_zero_are_the_numbers_that_they_mean(tmp_path, kind):
    write, says = WORDS[kind]
    data = folder(tmp_path, f"[units]\n{TICKS}", a=columns(write(COUNTS)), b=columns(write(COUNTS)))
    log = read_log(data, ARM)
    for trial in log.trials:
        np.testing.assert_allclose(trial.q, M["q"], atol=np.pi / 4096 + 1e-9)
    assert any("column q_elbow: whole numbers leap" in n and says in n for n in log.notes)
    assert not any("whole turns" in note for note in log.notes)


def test_a_trial_that_stays_below_zero_is_read_as_the_others(tmp_path):
    below = np.where(COUNTS < 0, 32768 - COUNTS, COUNTS)
    least = 32768 + 40 + np.round(30 * (1 + M["q"]))
    log = read_log(folder(tmp_path, f"[units]\n{TICKS}", a=columns(below), b=columns(least)), ARM)
    assert np.all(log.trials[1].q < 0) and np.all(log.trials[1].q > -0.6)


def test_speeds_of_16_bits_are_signed(tmp_path):
    speeds = np.round(M["v"] * 1000).astype(int)
    meta = f"[units]\n{TICKS}v = 0.001\n"
    log = read_log(folder(tmp_path, meta, a=columns(COUNTS, speeds % 2**16)), ARM)
    assert log.trials[0].v is not None
    np.testing.assert_allclose(log.trials[0].v, M["v"], atol=6e-4)


def test_a_counter_that_wraps_and_turns_that_an_encoder_counts_itself(tmp_path):
    """A counter of 16 bits that passes 2^15 goes on; the 4096 of a turn are no jump of it."""
    far = COUNTS * 40
    log = read_log(
        folder(tmp_path / "a", f"[units]\n{TICKS}", a=columns((far + 3 * 2**14) % 2**16 - 2**15)),
        ARM,
    )
    moved = log.trials[0].q - log.trials[0].q[:1]
    np.testing.assert_allclose(moved, (far - far[:1]) * 2 * np.pi / 4096, atol=1e-6)
    steps = np.cumsum(np.where(np.arange(200) % 50 == 49, 4096, 3))[:, None] * np.ones(2)
    log = read_log(folder(tmp_path / "b", f"[units]\n{TICKS}", a=columns(steps)), ARM)
    np.testing.assert_allclose(log.trials[0].q, (steps - ZERO) * 2 * np.pi / 4096)


def test_an_encoder_that_counts_within_a_turn_still_has_its_turns_taken_out(tmp_path):
    count = np.round(30 * M["time"] * 4096 / (2 * np.pi)).astype(int)[:, None] * np.ones((1, 2))
    log = read_log(folder(tmp_path, f"[units]\n{TICKS}", a=columns(count % 4096)), ARM)
    np.testing.assert_allclose(np.diff(log.trials[0].q, axis=0), 0.3, atol=2e-3)
    assert any("whole turns" in note for note in log.notes)


@pytest.mark.parametrize("far", [255, 2000, 40000])
def test_targets_that_step_are_no_words(tmp_path, far):
    """A gripper's 0 and 255, or ticks of a servo that is told to go far at once."""
    steps = 100 + np.where(np.arange(200) // 50 % 2 == 0, 0.0, far)
    data = columns(COUNTS - COUNTS.min()) | {f"target_{j}": steps for j in ARM}
    meta = 'input = "command"\n[units]\n' + TICKS.replace("q_", "target_") + TICKS
    log = read_log(folder(tmp_path, meta, a=data), ARM)
    np.testing.assert_allclose(log.trials[0].u[:, 0], (steps - ZERO) * 2 * np.pi / 4096)
