"""Recordings of scoops: what is refused, the selection over an engine of closed form, and an effect
named from the command line.
"""

import hashlib
import json

import jax
import numpy as np
import pytest

from adaptsim_jax import __version__, cli
from adaptsim_jax.commands.robot_session import recorded_trials
from adaptsim_jax.core import config, store
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.scooping import hydro, model, motion
from adaptsim_jax.tasks.scooping.diagnosis import diagnose as diagnosed
from adaptsim_jax.tasks.scooping.diagnosis import emulate, problem, simulate
from adaptsim_jax.tasks.scooping.diagnosis.diagnose import diagnose
from adaptsim_jax.tasks.scooping.diagnosis.read import assemble, read
from adaptsim_jax.tasks.scooping.diagnosis.simulate import INDEX, NAMES

COUNT, NOISE = 12, 5e-4
RNG = np.random.default_rng(3)
SPREAD = [
    RNG.permutation(np.linspace(low, high, COUNT))
    for low, high in zip(model.ACTION_LOW, model.ACTION_HIGH, strict=True)
]
ACTIONS = np.stack(SPREAD, 1)
PLACES = RNG.uniform([-0.04, -0.03], [0.04, 0.03], (COUNT, 2))
TIME = np.arange(0.0, 1.0, 1 / 60)


def closed_form(scooped, shape, values, trials, actions):
    """Poses of a scoop as simple as can be: the blade takes the piece along from where it meets it,
    less what slips.
    """
    v = dict(zip(NAMES, np.asarray(values, float).T[..., None], strict=True))
    t = np.arange(0.0, 1.0 + 1e-9, simulate.ROW)[None]
    pitch, rate, distance = np.asarray(actions, float).T[..., None]
    tip = (
        0.28 * np.clip(t / 0.7, 0, 1) ** 2 * (1 + v["speed_scale"])
        - distance
        - v["distance_offset"]
    )
    moved = np.logaddexp(0.0, 400.0 * (tip - v["start_x"] - 0.1 * v["clearance"])) / 400.0
    slid = (
        0.3 * (v["mu"] - v["tilt"])
        + 0.03 * (v["log_e"] - 5.0)
        + 0.05 * v["blade_friction"]
        + 0.01 * v["drag"] * t
    )
    rolls = {"box": 0.01 * np.sin(12.0 * t), "ellipsoid": 0.01 * np.sin(9.0 * t)}
    x = moved * (1.0 - slid - 0.2 * (pitch + v["pitch_offset"])) + rolls.get(shape, 0.0)
    z = (
        v["h"] / 2
        + 0.3 * moved * (0.2 - rate) * (1 + v["lift_scale"])
        + 1e-3 * v["adhesion"] * moved
    )
    return np.stack([x, z + 0 * x], -1)


@pytest.fixture
def simple(monkeypatch):
    """The engine replaced by the closed form, wherever it is called."""
    for module in (emulate, problem, simulate, diagnosed):
        monkeypatch.setattr(module, "poses", closed_form)


def measured(poses, seed=0, side=True, **shift):
    """Tracks `[T, R, C]` of simulated poses."""
    v = np.zeros((COUNT, len(NAMES)))
    for name, value in shift.items():
        v[:, INDEX[name]] = value

    class Blank:
        starts, aside, places = PLACES, np.zeros((COUNT, 2)), np.zeros((COUNT, 1, 3 if side else 2))
        time = np.tile(TIME, (COUNT, 1))

    out = simulate.places(Blank, v, poses, np.arange(COUNT))
    return out + NOISE * np.random.default_rng(seed).standard_normal(out.shape)


def written(folder, tracks, meta='task = "scooping"\n', rate=60.0, actions=ACTIONS):
    folder.mkdir(exist_ok=True)
    (folder / "meta.toml").write_text(meta)
    rows = [
        f"{i},{p[0]:.6f},{p[1]:.6f},{a[0]:.6f},{a[1]:.6f},{a[2]:.6f}"
        for i, (p, a) in enumerate(zip(PLACES, actions, strict=True), 1)
    ]
    (folder / "actions.csv").write_text(
        "\n".join(["trial,place_x,place_y,pitch,rate,distance", *rows, ""])
    )
    names = "x,y,z".split(",")[: tracks.shape[-1]]
    rows = [
        ",".join([str(i), f"{k / rate:.5f}", *(f"{c:.6f}" for c in row)])
        for i, track in enumerate(tracks, 1)
        for k, row in enumerate(track)
    ]
    (folder / "tracks.csv").write_text("\n".join([f"trial,time,{','.join(names)}", *rows, ""]))
    return folder


def simulated(**values):
    v = np.zeros((COUNT, len(NAMES)))
    for name, value in {"mu": 0.3, "log_e": 4.8, "h": 0.02, **values}.items():
        v[:, INDEX[name]] = value
    return closed_form(None, "cylinder", v, np.arange(COUNT), ACTIONS)


@pytest.fixture(scope="module")
def tracks():
    return measured(simulated())


def test_scoops_are_read_with_their_noise(tmp_path, tracks):
    scooped = read(written(tmp_path, tracks, 'task = "scooping"\nshape = "box"\nheight = 0.02\n'))
    assert scooped.names == tuple(map(str, range(1, COUNT + 1)))
    assert scooped.channels == ("x", "y", "z")
    assert scooped.noise == pytest.approx(NOISE, rel=0.25)
    assert (scooped.shape, scooped.height) == ("box", 0.02)
    assert len(read(tmp_path, without=["3", "5"]).names) == COUNT - 2
    assert any(
        "no heights" in note for note in read(written(tmp_path / "above", tracks[..., :2])).notes
    )


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda z: z * [-1.0, 1.0, 1.0], "another frame"),
        (lambda z: z + np.array([0.5, 0.0, 0.0]), "another frame"),
        (lambda z: 1000.0 * z, "metres"),
        (
            lambda z: np.where(np.arange(len(z))[:, None, None] == 4, z[4, 0], z),
            "trial 5: the piece never moved",
        ),
        (lambda z: z[:, ::5], "20 Hz"),
    ],
)
def test_what_cannot_be_judged_is_refused(tmp_path, tracks, change, says):
    changed = change(tracks)
    with pytest.raises(BadInput, match=says):
        read(written(tmp_path, changed, rate=60.0 * changed.shape[1] / tracks.shape[1]))


@pytest.mark.parametrize(
    ("meta", "says"),
    [
        ("shappe = 'box'", "shappe"),
        ("shape = 'cone'", "cone"),
        ("height = 20", "0.01 to 0.035 m"),
        ("repeats = [0.1]", "three sizes"),
        ("noise = 0", "no size"),
    ],
)
def test_keys_that_make_no_sense_are_refused(tmp_path, tracks, meta, says):
    with pytest.raises(BadInput, match=says):
        read(written(tmp_path, tracks, f'task = "scooping"\n{meta}\n'))


def test_a_scoop_in_degrees_is_refused(tmp_path, tracks):
    with pytest.raises(BadInput, match=r"actions\.csv: line 2: pitch .* in degrees"):
        read(written(tmp_path, tracks, actions=ACTIONS * [57.3, 1.0, 1.0]))


def test_a_session_is_read_from_the_files_that_were_told(tmp_path, tracks):
    folder = written(
        tmp_path / "told", tracks + np.array([0.3, 0.1, 0.0])
    )  # a camera with an origin of its own
    run = store.RunFolder.create(tmp_path / "run", {"task": {"clearance": 1e-4}}, task="scooping")
    file = folder / "tracks.csv"
    visit = {"file": str(file), "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}
    pairs = enumerate(zip(PLACES, ACTIONS, strict=True), 1)
    visit["scoops"] = [
        {"trial": i, "place": list(map(float, p)), "action": list(map(float, a))}
        for i, (p, a) in pairs
    ]
    session = tmp_path / "robot"
    store.save_checkpoint(
        session / store.CHECKPOINT,
        {"a": np.zeros(1)},
        task="scooping",
        step=1,
        config_hash="x",
        extra={"history": [visit]},
    )
    table = {"schema": store.SCHEMA, "version": __version__, "run": str(run.path)}
    table |= {"run_from_here": "../run", "trained": {}}
    config.write(session / "robot.toml", table | {"seed": 0, "starts": 1, "iterations": 1})
    scooped = recorded_trials(session)
    assert scooped.options.clearance == 1e-4
    np.testing.assert_allclose(scooped.actions, ACTIONS, atol=1e-9)
    assert np.abs(scooped.aside).max() < 1e-9


def test_a_scoop_as_declared_lacks_nothing(tmp_path, tracks, simple):
    report = diagnose(written(tmp_path, tracks))
    assert report["effects"] == []
    assert report["verdict"] == "within_noise"
    assert report["declared"]["before"]["h"]["value"] == pytest.approx(0.02, abs=5e-4)


@pytest.mark.long
def test_a_blade_that_runs_fast_is_named(tmp_path, simple):
    out = tmp_path / "out"
    folder = written(tmp_path / "scoops", measured(simulated(speed_scale=0.08)))
    assert cli.main(["diagnose", str(folder), "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    (effect,) = report["effects"]
    assert "speed_scale" in {effect["name"], *(a.split("@")[0] for a in effect["alternatives"])}
    assert (
        report["error"]["after"] < 1.3 * report["error"]["noise_floor"] < report["error"]["before"]
    )
    assert f'name = "{effect["name"]}"' in (out / "model.toml").read_text()
    assert "from the side" in (out / "report.html").read_text()
    assert (out / "next_experiment.csv").exists() == bool(
        (report["next_experiment"] or {}).get("csv")
    )


def test_a_blade_that_starts_farther_is_not_a_late_camera(tmp_path, simple):
    report = diagnose(written(tmp_path, measured(simulated(distance_offset=0.006))))
    (effect,) = report["effects"]
    assert effect["name"] == "distance_offset"
    assert effect["parameters"]["distance_offset"]["value"] == pytest.approx(0.006, abs=5e-4)


@pytest.mark.slow
def test_a_camera_that_is_near_is_no_scale_with_a_shift_where_pieces_rise(tmp_path, simple):
    near = measured(simulated(), near=1.0, lean_x=0.2, lean_y=-0.2)
    (effect,) = diagnose(written(tmp_path, near))["effects"]
    assert effect["name"] == "parallax" and not effect["alternatives"]
    assert effect["parameters"]["near"]["value"] == pytest.approx(1.0, abs=0.3)


def test_declared_values_stay_where_their_emulator_knows_something(tmp_path, tracks, simple):
    scooped, declared = read(written(tmp_path, tracks)), ("mu", "log_e", "h")
    quantities = problem.quantities_of(scooped)
    centre = np.array([q.default for q in quantities])
    drawn = np.isin(simulate.OWN, [INDEX[n] for n in declared])
    found = emulate.emulate(scooped, "cylinder", centre, emulate.widths(), drawn=drawn)
    mu = problem.prepare(scooped, found, (), declared, quantities, centre).quantities[INDEX["mu"]]
    reach = emulate.REACH * found.width[emulate.PLACE[INDEX["mu"]]]
    assert (mu.low, mu.high) == pytest.approx(
        (centre[INDEX["mu"]] - reach, centre[INDEX["mu"]] + reach)
    )
    values = centre + (np.arange(len(centre)) == INDEX["mu"]) * 0.02
    said = emulate.predicted(found.weights[0], found.centre, found.width, values)
    told = closed_form(scooped, "cylinder", values[None], np.arange(1), scooped.actions[:1])[0]
    assert np.abs(said - told).max() < 5e-4  # as few draws tell the few values that are drawn


def test_another_shape_than_declared_is_named(tmp_path, simple):
    report = diagnose(
        written(tmp_path, measured(simulated()), 'task = "scooping"\nshape = "box"\n')
    )
    assert [e["name"] for e in report["effects"]] == ["shape"]
    assert report["piece"] == {"shape": "cylinder", "declared": True}


def test_an_emulator_gives_back_a_quadratic(tmp_path, tracks, simple, monkeypatch):
    scooped = read(written(tmp_path, tracks))
    centre = np.array([q.default for q in problem.quantities_of(scooped)])

    def quadratic(scooped, shape, values, trials, actions):
        z = (values[:, 0] - 0.3) / 0.02
        return np.stack([1e-3 * (1.0 + z + 0.5 * z * z)] * 2, -1)[:, None]

    monkeypatch.setattr(emulate, "poses", quadratic)
    found = emulate.emulate(scooped, "cylinder", centre, emulate.widths())
    values = centre.copy()
    values[0] = 0.33
    z = (0.33 - 0.3) / 0.02
    said = emulate.predicted(found.weights[0], found.centre, found.width, values)
    assert said[0, 0] == pytest.approx(1e-3 * (1.0 + z + 0.5 * z * z), rel=0.05)
    assert found.stray.max() < 5e-5


def test_a_faster_blade_travels_farther():
    action = np.array([0.1, 0.0, 0.01], np.float32)
    slow, fast = (np.asarray(motion.motion(action, 40, speed=s)) for s in (1.0, 1.1))
    begun = slow[0, 0]
    assert (fast[-1, 0] - begun) == pytest.approx(slow[-1, 0] - begun + 0.1 * 0.2714, abs=0.02)
    still = np.asarray(motion.motion(action, 40, lift=0.0))
    np.testing.assert_allclose(still[:, 2], 0.1, atol=1e-6)


@pytest.mark.slow
def test_what_is_neutral_is_the_engine_itself():
    params, actions = model.draw(3, 4)
    values = dict(zip(("mu", "e", "g", "h"), params.T, strict=True))
    with jax.enable_x64(True):
        own = jax.jit(jax.vmap(simulate.rollout))(values, actions)
        engine = jax.jit(jax.vmap(lambda p, a: hydro.rollout(p, a).piece))(params, actions)
    np.testing.assert_allclose(np.asarray(own)[:, :80], np.asarray(engine)[:, :80], atol=1e-9)


@pytest.mark.slow
def test_a_late_camera_is_named_in_the_engine(tmp_path):
    values = np.zeros((COUNT, len(NAMES)))
    values[:, [INDEX[n] for n in ("mu", "log_e", "h")]] = 0.3, 4.8, 0.02
    scooped = assemble_blank(tmp_path)
    poses = simulate.poses(scooped, "ellipsoid", values, np.arange(COUNT), ACTIONS)
    out = tmp_path / "out"
    folder = written(tmp_path / "scoops", measured(poses, latency=0.04))
    assert cli.main(["diagnose", str(folder), "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    assert report["piece"]["shape"] == "ellipsoid"
    (effect,) = report["effects"]
    assert "latency" in {effect["name"], *(a.split("@")[0] for a in effect["alternatives"])}


def assemble_blank(folder):
    """Scoops of the module's actions, whatever their tracks."""
    own = written(folder / "blank", measured(simulated()))
    return assemble(own / "actions.csv", [own / "tracks.csv"], {}, own)
