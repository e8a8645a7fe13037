"""Speeds and torques of another side or sign, joints in another order, rows that a recorder
dropped, pauses: told with what to write, which is then done; and nothing told of what is right.
"""

import re
from unittest.mock import patch

import numpy as np
import pytest

from adaptsim_jax.attribution.conventions import check_conventions
from adaptsim_jax.attribution.load import load
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.quality.holes import holes
from adaptsim_jax.logs.read import read_log
from experiments import close_cartpole
from tests.faults.servo_files import noisy, sines, swung
from tests.faults.test_clocks_told import NAMES, recorded
from tests.logs.arm_files import arm
from tests.logs.log_files import HEAD

SPEEDS = {
    "a gear at both": (6.33, 6.33),
    "two gears": (9.1, -20.0),
    "one turned": (1.0, -1.0),
    "one of its rotor": (50.0, 1.0),
}


def times(trials, stem, factors):
    return [
        c | {f"{stem}{k + 1}": f * c[f"{stem}{k + 1}"] for k, f in enumerate(factors)}
        for c in trials
    ]


@pytest.mark.parametrize("factors", SPEEDS.values(), ids=SPEEDS)
def test_speeds_of_another_side_are_refused_and_read_as_advised(tmp_path, factors):
    spoiled = times(arm(4), "v", factors)
    with pytest.raises(BadInput, match=r"times d\(q_") as error:
        load(recorded(tmp_path / "a", spoiled))
    lines = re.findall(r"v_joint\d = -?[\d.]+", str(error.value))
    assert len(lines) == sum(f != 1.0 for f in factors)
    for line in lines:
        factor = factors[int(line[7]) - 1]
        assert float(line.split("= ")[1]) == pytest.approx(1.0 / factor, rel=0.01)
    machine = load(recorded(tmp_path / "b", spoiled, "[units]\n" + "\n".join(lines) + "\n"))
    assert check_conventions(machine) == ()
    assert not any("times d(" in note for note in machine.log.notes)
    ignored = re.search(r"ignore = \[.*?\]", str(error.value))
    assert ignored
    bare = load(recorded(tmp_path / "c", spoiled, ignored[0] + "\n"))
    assert bare.log.trials[0].v is None


def test_a_unit_that_is_nearly_the_ratio_is_told_and_what_is_left_too(tmp_path):
    spoiled = times(arm(4), "v", (9.1, 9.1))
    log = load(recorded(tmp_path / "a", spoiled, '[units]\nvelocity = "rpm"\n')).log
    assert any(re.search(r"v_joint1 is 0\.95\d* times d\(q_joint1\)/dt", n) for n in log.notes)


def test_speed_and_torque_against_the_angle_are_told_one_after_the_other(tmp_path):
    spoiled = times(times(arm(4), "v", (1.0, -1.0)), "tau", (1.0, -1.0))
    with pytest.raises(BadInput, match="write v_joint2 = -1 under"):
        load(recorded(tmp_path / "a", spoiled))
    half = recorded(tmp_path / "b", spoiled, "[units]\nv_joint2 = -1\n")
    with pytest.raises(BadInput, match="write tau_joint2 = -1 under"):
        check_conventions(load(half))
    whole = recorded(tmp_path / "c", spoiled, "[units]\nv_joint2 = -1\ntau_joint2 = -1\n")
    assert check_conventions(load(whole)) == ()


LEGS = ("left_hip", "left_knee", "right_hip", "right_knee")
LINK = '<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="{}"/>'


def legs() -> str:
    """MJCF of two legs of two servos, of other masses."""

    def joint(name):
        return f'<joint name="{name}" axis="0 1 0" damping="0.05" armature="0.01"/>'

    bodies = "".join(
        f'<body pos="0 {y} 0">{joint(side + "_hip")}{LINK.format(1.2)}<body pos="0 0 -0.3">'
        f"{joint(side + '_knee')}{LINK.format(mass)}</body></body>"
        for side, y, mass in (("left", 0.1, 0.9), ("right", -0.1, 0.6))
    )
    servos = "".join(f'<position name="p_{n}" joint="{n}" kp="40" kv="1.5"/>' for n in LEGS)
    flag = '<option timestep="0.001"><flag contact="disable"/></option>'
    return f"<mujoco>{flag}<worldbody>{bodies}</worldbody><actuator>{servos}</actuator></mujoco>"


def walked(seed: int, rows: int = 250, rate: float = 100.0):
    """Angles and targets `[rows, 4]` of MuJoCo's own steps."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(legs())
    data = mujoco.MjData(model)
    targets = sines(seed, rows, rate, 4, 0.3) + np.array([0.3, -0.6, 0.3, -0.6])
    data.qpos[:] = targets[0]
    out = []
    for u in targets:
        out.append(data.qpos.copy())
        data.ctrl[:] = u
        for _ in range(round(1.0 / rate / model.opt.timestep)):
            mujoco.mj_step(model, data)
    return noisy(np.array(out), seed), targets


@pytest.mark.parametrize("order", [(0, 2, 1, 3), (1, 0, 2, 3), (0, 1, 2, 3)])
def test_angles_and_targets_in_another_order_are_found_together(tmp_path, order):
    (tmp_path / "robot.xml").write_text(legs())
    for k in range(4):
        q, u = walked(k)
        np.savez(
            tmp_path / f"run_{k}.npz",
            time=np.arange(len(q)) / 100.0,
            q=q[:, list(order)],
            target=u[:, list(order)],
        )
    (tmp_path / "meta.toml").write_text(f'{HEAD}model = "robot.xml"\n')
    if order == (0, 1, 2, 3):
        assert check_conventions(load(tmp_path)) == ()
        return
    with pytest.raises(BadInput, match="look to be in the order") as error:
        check_conventions(load(tmp_path))
    lines = re.findall(r"(?:q|target) = \[.*?\](?= |$)", str(error.value))
    assert len(lines) == 2
    text = f'{HEAD}model = "robot.xml"\n[columns]\n' + "\n".join(lines) + "\n"
    (tmp_path / "meta.toml").write_text(text)
    assert check_conventions(load(tmp_path)) == ()


def test_a_joint_without_a_drive_does_not_change_places_with_one_that_has(tmp_path):
    out = [str(tmp_path / "cart"), "--seed", "3"]
    with patch("sys.argv", ["close_cartpole.py", "--out", *out]):
        close_cartpole.main()
    found = check_conventions(load(tmp_path / "cart" / "logs"))
    assert [f.kind for f in found] == ["late_motion"]  # of the motor, which is late


def dropped(seed: int, rows: int, longest: int):
    """Which rows are kept, at random but for both ends."""
    rng = np.random.default_rng(seed)
    kept = np.ones(rows, bool)
    for at in rng.choice(np.arange(8, rows - 16, 12), 5, replace=False):
        kept[at : at + rng.integers(1, longest + 1)] = False
    return kept


def with_holes(folder, kept_of, drive=sines):
    rate, rows = 50.0, 200
    for k in range(4):
        u = drive(k, rows, rate, 2)
        kept = kept_of(k, rows)
        count = int(kept.sum())
        columns = {"time": np.arange(count) / rate}
        q = noisy(swung(u, rate), k)[kept]
        columns |= {f"q{j + 1}": q[:, j] for j in range(2)}
        columns |= {f"target{j + 1}": u[kept, j] for j in range(2)}
        head = ",".join(columns)
        table = np.stack(list(columns.values()), 1)
        np.savetxt(folder / f"run_{k}.csv", table, delimiter=",", header=head, comments="")
    return read_log(folder, NAMES)


@pytest.mark.parametrize("longest", [1, 4])
def test_rows_that_even_stamps_deny_are_put_back(tmp_path, longest):
    log = with_holes(tmp_path, lambda k, rows: dropped(k, rows, longest))
    (note,) = [note for note in log.notes if "rows are missing" in note]
    assert "20 holes" in note
    for k, trial in enumerate(log.trials):
        there = np.flatnonzero(np.isfinite(trial.q[:, 0]))
        true = np.flatnonzero(dropped(k, 200, longest))
        # a hole of four rows may be taken for five: a cubic is all that is known of the motion
        np.testing.assert_allclose(np.diff(there), np.diff(true), atol=longest == 4)
        np.testing.assert_allclose(np.diff(trial.time), 0.02, atol=1e-9)


def test_steps_of_targets_and_whole_logs_have_no_holes(tmp_path):
    def steps(seed, rows, rate, joints):
        rng = np.random.default_rng(seed)
        return np.repeat(rng.uniform(-0.6, 0.6, (rows // 20, joints)), 20, axis=0)

    for name, drive in (("steps", steps), ("sines", sines)):
        (tmp_path / name).mkdir()
        log = with_holes(tmp_path / name, lambda k, rows: np.ones(rows, bool), drive)
        assert not any("rows are missing" in note for note in log.notes)


def followed(seed, late, rate, rows=500, joints=6):
    """A trial of servos that follow a target of steps within `late` s: time, angles, targets."""
    rng = np.random.default_rng(seed)
    gaps = np.cumsum(rng.integers(40, 80, rows // 40))
    poses = np.cumsum(rng.normal(0.0, 0.3, (len(gaps) + 1, joints)), axis=0)
    targets = poses[np.searchsorted(gaps, np.arange(rows), side="right")]
    q = targets.copy()
    for k in range(rows - 1):
        q[k + 1] = targets[k] + (q[k] - targets[k]) * np.exp(-1.0 / rate / late)
    return (
        np.arange(rows) / rate,
        np.round((q + rng.normal(0.0, 1e-4, q.shape)) / 5e-4) * 5e-4,
        targets,
    )


@pytest.mark.parametrize("late, rate", [(0.03, 50.0), (0.06, 30.0), (0.0845, 30.0), (0.12, 100.0)])
def test_steps_that_servos_follow_leave_no_holes(late, rate):
    assert holes([followed(k, late, rate) for k in range(6)]) is None


@pytest.mark.parametrize("pause, parts", [(600.0, 2), (2.0, 1)])
def test_a_pause_within_a_file_makes_two_trials_of_it(tmp_path, pause, parts):
    c = arm(1)[0]
    rows = len(c["time"]) // 2
    c = c | {"time": np.where(np.arange(len(c["time"])) < rows, c["time"], c["time"] + pause)}
    log = load(recorded(tmp_path / "a", [c])).log
    assert [t.name for t in log.trials] == (["run_0_1", "run_0_2"] if parts == 2 else ["run_0"])
    assert any("pauses for" in note for note in log.notes) == (parts == 2)


def test_of_motors_that_nothing_is_logged_of_nothing_can_be_said(tmp_path):
    (tmp_path / "robot.xml").write_text(legs())
    q, _ = walked(0)
    columns = {"time": np.arange(len(q)) / 100.0} | {f"q{j + 1}": q[:, j] for j in range(4)}
    head, table = ",".join(columns), np.stack(list(columns.values()), 1)
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header=head, comments="")
    (tmp_path / "meta.toml").write_text(f'{HEAD}model = "robot.xml"\n')
    with pytest.raises(BadInput, match="nothing can be said of the drives"):
        load(tmp_path)
    (tmp_path / "meta.toml").write_text(f'{HEAD}model = "robot.xml"\ninput = "none"\n')
    notes = load(tmp_path).log.notes
    assert any("if they worked, nothing can be said of the drives" in note for note in notes)
