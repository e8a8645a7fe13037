"""Worlds of pushes made by Drake or by the native MuJoCo scene, with or without an effect: tracks
that a camera would record.

Parameters, actions, effects and camera are drawn as in `pushing_worlds.py`; the bottle is moved by
an engine of the package in three dimensions, which is not the planar model that a diagnosis
simulates. What can be injected there: a table that is not level (gravity turned), commands other
than meant, bottles put down elsewhere, mass beside the axis, and what the camera does. Needs the
package.

    python -m experiments.pushing_worlds_3d --engine drake --suite nulls --seed 1 --out worlds/
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from adaptsim_jax.tasks.pushing import model
from adaptsim_jax.tasks.pushing.engines import make_backend
from experiments.pushing_worlds import LATE, LENGTH, world, write_world

ROW, RATE = 0.01, 500  # s between the engine's rows; 1/s of the tracks that the camera looks at
MOVED = (
    "tilt",
    "speed_scale",
    "speed_offset",
    "heading_offset",
    "start_pose",
    "placement",
    "off_axis",
)
SEEN = (
    "camera_shift",
    "camera_scale",
    "camera_scale_at_start",
    "camera_turn",
    "camera_turn_at_start",
    "latency",
    "clock_scale",
)


def gravity(tilt_x: float, tilt_y: float) -> tuple[float, float, float]:
    """Gravity m/s2 over a table tilted by angles in rad, positive downhill towards +x, +y."""
    downhill = np.array([np.sin(tilt_x), np.sin(tilt_y)])
    return tuple(
        (model.GRAVITY * np.array([*downhill, -np.sqrt(1 - downhill @ downhill)])).tolist()
    )


def simulate(engine: str, lanes: dict[str, np.ndarray], **settings) -> np.ndarray:
    """Places `[pushes, N, 2]` m every `1 / RATE` s of one world's lanes (see
    `pushing_worlds.world`), moved by `engine`.
    """
    p, one = lanes, {k: float(v[0]) for k, v in lanes.items()}
    turning = {}
    if one["light"]:  # a moment of inertia that lets it turn, and a mass that makes it
        spin = model.NOMINAL_MASS / one["light"]
        turning = {
            "com": (one["com_x"], one["com_y"], model.PAPER.com[2]),
            "inertia": (*model.PAPER.inertia[:2], spin),
        }
    options = model.PushOptions(duration=round(LENGTH + LATE, 3), row=ROW, **turning)
    settings["gravity"] = gravity(one["tilt_x"], one["tilt_y"])
    params = np.stack([p[k] for k in ("mu", "e", "mu_p", "y_p")], 1)
    actions = np.stack(
        [p["speed"] * (1 + p["speed_scale"]) + p["speed_offset"], p["angle"] + p["heading_offset"]],
        1,
    )
    starts = np.array(model.START) + np.stack([p["start_x"], p["start_y"]], 1)
    found = make_backend(engine, options, **settings).simulate(params, actions, starts)
    if np.any(found.code != model.FINE):
        raise SystemExit(f"{engine}: {[model.MESSAGES[c] for c in found.code if c != model.FINE]}")
    still = np.zeros((len(starts), 1, 2))
    place = np.concatenate([starts[:, None], found.state[:, :, :2]], 1)
    speed = np.concatenate([still, found.state[:, :, 7:9]], 1)
    if one[
        "light"
        # the state moves with the axis already; its speed is the body's origin, which lies on the
        # axis
    ]:
        speed = np.gradient(place, ROW, axis=1)
    times = ROW * np.arange(place.shape[1])
    return CubicHermiteSpline(times, place, speed, axis=1)(np.arange(0, times[-1], 1 / RATE))


def suite(name: str, seed: int, count: int) -> list[tuple[str, int]]:
    """Kinds and seeds of so many worlds: `nulls`, or `singles`, each kind of this file in turn."""
    kinds = ("null",) if name == "nulls" else (*MOVED, *SEEN)
    return [(kinds[i % len(kinds)], 1000 * seed + i) for i in range(count)]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--engine", choices=("drake", "native"), required=True)
    parser.add_argument("--suite", choices=("nulls", "singles"), required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=14)
    parser.add_argument("--pushes", type=int, default=18)
    parser.add_argument("--dt", type=float, help="step of the native scene, s (0.005)")
    parser.add_argument(
        "--declared",
        choices=("drake", "native"),
        help="which planar twin is declared (the engine's)",
    )
    parser.add_argument("--out", required=True)
    a = parser.parse_args()
    settings = {"dt": a.dt} if a.dt else {}
    for kind, seed in suite(a.suite, a.seed, a.count):
        own, truth = world(kind, seed, a.pushes)
        tracks = simulate(a.engine, own, **settings)
        meta = f'coefficients = "{a.declared or a.engine}"\n'
        rng = np.random.default_rng([seed, 7])
        write_world(
            Path(a.out) / f"{kind}-{seed}",
            own,
            truth | {"engine": a.engine},
            tracks,
            rng,
            meta=meta,
        )


if __name__ == "__main__":
    main()
