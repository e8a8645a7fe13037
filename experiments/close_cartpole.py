"""Logs of a cart-pole whose rail rubs dry and whose motor is late, recorded in MuJoCo C, and an
env.toml of the declared one with that machine as its target: what `adaptsim close` is tried on.

    python experiments/close_cartpole.py --out cart
    adaptsim close cart/logs cart/env.toml --out cart/closed --trials 10 --seeds 3

`--null` records the declared machine.
"""

import argparse
from pathlib import Path

import mujoco
import numpy as np

from adaptsim_jax.environments import own

FRICTION, LATE = 1.5, 0.03  # N, s
RATE, TRIALS, SECONDS = 100, 6, 8.0  # Hz, of the log
NOISE = (0.5e-3, 1e-3)  # m and rad
HOLD = (0.25, 0.1)  # of the motor's range for each m and m/s, so that it stays on its rail
ENV = """env = "cartpole"
length = 250

[fields]
"body:pole.mass" = [0.1, 0.5]
"body:cart.mass" = [0.6, 1.6]
"actuator:motor.gear" = [6.0, 14.0]

[targets.real]
{target}
"""


def machine(friction: float, late: float) -> mujoco.MjModel:
    """The cart-pole as it is, in steps of 1 ms."""
    spec = mujoco.MjSpec.from_file(str(Path(own.__file__).with_name("cartpole.xml")))
    spec.option.timestep = 0.001
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.iterations, spec.option.ls_iterations = 100, 50
    spec.joint("slide").frictionloss = friction
    if late:
        motor = spec.actuator("motor")
        motor.delay, motor.nsample = late, int(np.ceil(late / 0.001)) + 2
    return spec.compile()


def recorded(model: mujoco.MjModel, rng: np.random.Generator) -> np.ndarray:
    """Rows of time, both readings and the command, which holds to the next row."""
    data, rows = mujoco.MjData(model), []
    data.qpos[:] = rng.uniform(-0.3, 0.3), np.pi + rng.uniform(-0.5, 0.5)
    speed, phase = rng.uniform(0.3, 2.5, 4), rng.uniform(0, 2 * np.pi, 4)
    size = rng.uniform(0.1, 0.3, 4)
    for k in range(round(SECONDS * RATE)):
        swing = np.sum(size * np.sin(2 * np.pi * speed * k / RATE + phase))
        q = data.qpos + np.array(NOISE) * rng.standard_normal(2)
        told = float(np.clip(swing - HOLD[0] * q[0] - HOLD[1] * data.qvel[0], -1.0, 1.0))
        rows.append([k / RATE, *q, told])
        data.ctrl[0] = told
        mujoco.mj_step(model, data, 1000 // RATE)
    return np.array(rows)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    arguments.add_argument("--out", type=Path, required=True)
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--null", action="store_true", help="the machine is as declared")
    args = arguments.parse_args()
    friction, late = (0.0, 0.0) if args.null else (FRICTION, LATE)
    logs, rng = args.out / "logs", np.random.default_rng(args.seed)
    logs.mkdir(parents=True, exist_ok=True)
    xml = Path(own.__file__).with_name("cartpole.xml").read_text()
    (logs / "model.xml").write_text(xml)
    (logs / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
    model = machine(friction, late)
    for trial in range(TRIALS):
        names = "time,q_slide,q_hinge,ctrl_motor"
        rows = recorded(model, rng)
        np.savetxt(
            logs / f"run_{trial}.csv", rows, "%.7g", delimiter=",", header=names, comments=""
        )
    target = "" if args.null else f'"joint:slide.frictionloss" = {friction}\ndelay = {late}'
    (args.out / "env.toml").write_text(ENV.format(target=target))


if __name__ == "__main__":
    main()
