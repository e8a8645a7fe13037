"""MuJoCo's own system identification on a recording of a hinge, the peer of `benchmarks/table.py`:
mass and damping fitted from the declared model, and nothing judged. Prints fits per minute of wall
time, and the two values. Needs `pip install mujoco[sysid]`.

    # with model.xml, and trial_00.csv ... of time, q1, tau1
    python benchmarks/mujoco_sysid.py FOLDER
"""

import sys
import time
from pathlib import Path

import mujoco
import numpy as np
from mujoco import sysid


def main(folder: Path) -> None:
    spec = mujoco.MjSpec.from_file(str(folder / "model.xml"))
    spec.add_sensor(
        name="angle",
        type=mujoco.mjtSensor.mjSENS_JOINTPOS,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        objname="hinge",
    )
    model = spec.compile()
    starts, controls, seen, names = [], [], [], []
    for file in sorted(folder.glob("trial_*.csv")):
        t, q, tau = np.loadtxt(file, delimiter=",", skiprows=1).T
        starts.append(sysid.create_initial_state(model, q[:1], np.zeros(1), None))
        controls.append(sysid.TimeSeries(t, tau[:, None]))
        seen.append(sysid.TimeSeries.from_names(t, q[:, None], model))
        names.append(file.stem)
    begin = time.perf_counter()
    params = sysid.ParameterDict()

    def mass(s, p):
        return setattr(s.body("link"), "mass", p.value[0])

    def damping(s, p):
        return s.joint("hinge").damping.__setitem__(0, p.value[0])

    params.add(sysid.Parameter("mass", 1.2, 0.1, 5.0, modifier=mass))
    params.add(sysid.Parameter("damping", 0.01, 0.0, 1.0, modifier=damping))
    sequences = sysid.ModelSequences("hinge", spec, names, starts, controls, seen)
    found, _ = sysid.optimize(
        initial_params=params,
        residual_fn=sysid.build_residual_fn(models_sequences=[sequences]),
        optimizer="mujoco",
        verbose=False,
    )
    print(
        60.0 / (time.perf_counter() - begin),
        *(float(found[k].value[0]) for k in ("mass", "damping")),
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
