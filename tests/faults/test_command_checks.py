"""Commands that are not what acted: cut on their way, another joint's, of another gain in some
trials, counted anew each turn. What is advised is done, and the log is read on.
"""

import re

import numpy as np
import pytest

from adaptsim_jax.attribution.command_checks import check_commands
from adaptsim_jax.attribution.load import load
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.criteria import COMMAND
from adaptsim_jax.logs.quality.commands import detect_target_limit, unexplained
from adaptsim_jax.logs.quality.hypotheses import Track
from tests.faults.servo_files import log, model, noisy, sines, steps, swung

RATE = 50.0
ARM = ("arm",)


def trials(make, count=4, seconds=2.5, rate=RATE):
    """make(seed, rows) -> (angles, what is logged of the targets)."""
    rows = int(seconds * rate)
    out = []
    for seed in range(count):
        q, u = make(seed, rows)
        out.append((np.arange(rows) / rate, noisy(q, seed), u))
    return out


def advised(told: str, pattern: str) -> str:
    found = re.search(pattern, told)
    assert found, told
    return found[0]


CUTS = {
    "rate": lambda u, last, q: np.clip(u, last - 0.06, last + 0.06),
    "within": lambda u, last, q: np.clip(u, q - 0.15, q + 0.15),
}


@pytest.mark.parametrize("how", CUTS)
def test_targets_that_the_driver_cuts_are_read_as_advised(tmp_path, how):
    """A limit of rate is refused; one about the angle is a servo's limit of torque as well."""

    def made(seed, rows):
        u = steps(seed, rows, 25)
        return swung(u, RATE, sent=CUTS[how]), u

    data = log(tmp_path / "a", "", ARM, trials(made))
    if how == "rate":
        with pytest.raises(BadInput, match=r"not what acted.*rate") as error:
            check_commands(load(data))
        text = str(error.value)
    else:
        (warning,) = check_commands(load(data))
        text = warning.message
        assert warning.severity == "warn" and "limit of its torque" in text
    line = advised(text, rf"{how} = {{.*?}}")
    size = float(line.split("=")[-1].strip(" }"))
    assert size == pytest.approx({"rate": 0.06 * RATE, "within": 0.15}[how], rel=0.15)
    mended = log(tmp_path / "b", f"[commands]\n{line}\n", ARM, trials(made))
    machine = load(mended)
    assert check_commands(machine) == ()
    assert (
        np.ptp(np.diff(machine.tracks[0].u[:, 0]))
        < np.ptp(np.diff(load(data).tracks[0].u[:, 0])) / 2
    )


@pytest.mark.parametrize("seed", [0, 10, 20])
def test_a_limit_of_force_that_a_much_damped_joint_meets_now_and_then_is_no_limit_of_rate(seed):
    """At it the joint moves at one speed."""
    rate, rows, stiff, damping, inertia = 200.0, 1000, 35.0, 3.07, 0.06
    drawn = [np.random.default_rng(seed + k) for k in range(4)]

    def wave(rng):
        return 2 * np.pi * rng.uniform(0.2, 1.2, 3) * np.arange(rows)[:, None] / rate + rng.uniform(
            0, 6.28, 3
        )

    u = [0.25 * np.sin(wave(rng)).sum(1) for rng in drawn]
    limit = 0.8 * damping * max(np.abs(np.gradient(x, 1 / rate)).max() for x in u)
    tracks, h = [], 1 / rate / 10
    for rng, targets in zip(drawn, u, strict=True):
        q, v, out = targets[0], 0.0, []
        for target in targets:
            out.append(q)
            for _ in range(10):
                force = np.clip(stiff * (target - q), -limit, limit)
                v = (inertia * v + h * force) / (inertia + h * damping)
                q = q + h * v
        angles = np.array(out)[:, None] + 1e-4 * rng.normal(size=(rows, 1))
        tracks.append(Track(np.arange(rows) / rate, angles, None, targets[:, None]))
    assert (
        unexplained(tracks) > COMMAND.min_doubted_share
        and detect_target_limit(tracks, 0, 0.0) is None
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_limit_of_force_and_targets_as_sent_are_no_cuts(tmp_path, seed):
    from tests.faults import servo_files

    def limited(k, rows):  # the servo's force ends at 1.2 N m, so that it lags behind steps
        u = steps(10 * seed + k, rows, 25)
        most = 1.2 / servo_files.KP
        q, v, out = np.array([u[0, 0]]), np.zeros(1), []
        inertia, pull = (
            servo_files.MASS * servo_files.LENGTH**2 / 3,
            servo_files.MASS * servo_files.G * servo_files.LENGTH / 2,
        )
        for target in u:
            out.append(q.copy())
            for _ in range(20):
                force = servo_files.KP * np.clip(
                    target - q - servo_files.KV / servo_files.KP * v, -most, most
                )
                v = v + 1e-3 * (force - servo_files.DAMPING * v - pull * np.sin(q)) / inertia
                q = q + 1e-3 * v
        return np.array(out), u

    def plain(k, rows):
        u = steps(10 * seed + k, rows, 25)
        return swung(u, RATE), u

    def some(k, rows):  # one trial of four reaches the limit
        return limited(k, rows) if k == 1 else plain(k, rows)

    for name, make in (("force", limited), ("plain", plain), ("some", some)):
        assert check_commands(load(log(tmp_path / name, "", ARM, trials(make)))) == ()


@pytest.mark.parametrize("which, mend", [("target", 'target_arm = "deg"'), ("q", 'q_arm = "deg"')])
def test_targets_in_another_unit_than_their_angles_are_told_and_read_as_advised(
    tmp_path, which, mend
):
    whole = trials(lambda seed, rows: (lambda u: (swung(u, RATE), u))(sines(seed, rows, RATE, 1)))
    size = {which: 180 / np.pi}
    spoiled = [(t, size.get("q", 1.0) * q, size.get("target", 1.0) * u) for t, q, u in whole]
    with pytest.raises(BadInput, match="targets of arm look to be in") as error:
        check_commands(load(log(tmp_path / "a", "", ARM, spoiled)))
    lines = advised(str(error.value), r'q_arm = "\w+" and target_arm = "\w+"')
    assert mend in lines
    machine = load(log(tmp_path / "b", "[units]\n" + lines.replace(" and ", "\n"), ARM, spoiled))
    assert check_commands(machine) == ()
    for track, (_, q, u) in zip(machine.tracks, whole, strict=True):
        np.testing.assert_allclose(np.c_[track.q, track.u], np.c_[q, u], atol=1e-9)


def test_commands_in_the_order_of_the_joints_are_told_and_read_as_advised(tmp_path):
    names = ("left", "right")
    meta = '[columns]\nctrl1 = "c1"\nctrl2 = "c2"\n'

    def write(path, more):
        from tests.logs.log_files import folder

        columns = {}
        for seed in range(3):
            u = sines(seed, 125, RATE, 2)
            q = noisy(swung(u, RATE), seed)
            # the actuators are right, left; the array is left, right
            columns[f"run_{seed}"] = {
                "time": np.arange(125) / RATE,
                "q_left": q[:, 0],
                "q_right": q[:, 1],
                "c1": u[:, 0],
                "c2": u[:, 1],
            }
        folder(path, f'model = "robot.xml"\n{more}', **columns)
        (path / "robot.xml").write_text(model(names, ("right", "left")))
        return path

    with pytest.raises(
        BadInput, match=r"another order than the actuators.*left moves as that of right"
    ) as error:
        check_commands(load(write(tmp_path / "a", meta)))
    lines = advised(str(error.value), r'ctrl_\w+ = "\w+", ctrl_\w+ = "\w+"').replace(", ", "\n")
    assert check_commands(load(write(tmp_path / "b", f"[columns]\n{lines}\n"))) == ()


@pytest.mark.parametrize("gains", [(1.0, 2.0), (1.0, 1.0), (1.0, 1.3)])
def test_gains_that_differ_by_trial_are_told_by_trial(tmp_path, gains):
    def made(seed, rows):
        u = sines(seed, rows, 100.0, 1, 0.6)
        return swung(u, 100.0, gain=gains[seed % 2]), u

    data = log(tmp_path / "a", "", ARM, trials(made, 6, rate=100.0))
    told = check_commands(load(data))
    if gains[0] == gains[1]:
        assert told == ()
        return
    (finding,) = told
    values = {
        name: float(x)
        for name, x in re.findall(r"(run_\d) ([\d.]+)", finding.message.split(": ", 1)[1])
    }
    for k in range(1, 6):
        assert values[f"run_{k}"] == pytest.approx(gains[k % 2], rel=0.1)
    odd = [f"run_{k}" for k in range(6) if k % 2]
    assert check_commands(load(data).without(odd)) == ()  # as advised


def wrap(x, begin=-np.pi):
    return (x - begin) % (2 * np.pi) + begin


@pytest.mark.parametrize(
    "angle, target",
    [(wrap, wrap), (lambda x: wrap(x, 0.0), wrap), (lambda x: x, wrap), (wrap, lambda x: x)],
)
def test_a_target_has_the_turns_of_its_angle(tmp_path, angle, target):
    def made(seed, rows):
        u = 4.0 * np.arange(rows)[:, None] / 100.0 + 0.3 * sines(seed, rows, 100.0, 1)
        return swung(u, 100.0), u

    whole = trials(made, 3, rate=100.0)
    data = log(tmp_path / "a", "", ARM, [(t, angle(q), target(u)) for t, q, u in whole])
    for track, (_, q, u) in zip(load(data).tracks, whole, strict=True):
        np.testing.assert_allclose(track.u[:, 0] - track.q[:, 0], (u - q)[:, 0], atol=1e-6)
    # a joint that stays within a turn and whose targets step by more than half of one is left as it
    # is
    far = trials(lambda seed, rows: (lambda u: (swung(u, RATE), u))(steps(seed, rows, 40, 2.6)), 2)
    log_ = load(log(tmp_path / "b", "", ARM, far))
    for track, (_, _, u) in zip(log_.tracks, far, strict=True):
        np.testing.assert_allclose(track.u, u, atol=1e-9)
