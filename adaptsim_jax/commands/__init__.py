"""One module a command, with `run(args) -> exit code`, which alone loads JAX; what each takes is in
`options.toml`.
"""

SUMMARIES = {
    "demo": "the tour: train, adapt, close the loop on sample data; a few minutes on two cores",
    "train": "Phase 1: learn how to adapt simulation parameters, in simulation",
    "sweep": "many runs of Phase 1 and 2: hyper-parameters x seeds, on all devices or many "
    "machines",
    "adapt": "Phase 2: adapt a trained run to a target",
    "close": "recordings and an env.toml in: diagnose, mend, train and adapt, before and after",
    "compare": "methods x settings x seeds, as in Table 1 of the paper",
    "init": "a meta.toml for recordings of a mechanism, guesses marked as such",
    "diagnose": "close the loop: measured data in, cause of the residual and mended model out",
    "excite": "the motion to record next, and from which size on it shows each effect",
    "replay": "simulate any model file over recordings: error by trial, joint and horizon",
    "export": "a diagnosis for MuJoCo, Playground, Brax, mjlab, Isaac Lab, as URDF or JSON",
    "effects": "the catalogue of effects that a model may lack",
    "robot": "ask/tell adaptation with a real robot",
    "parity": "physics backends against each other over random samples",
    "new": "files to start an effect, a mechanism, a task, an environment, an engine or a baseline "
    "from",
    "completion": "completion of commands and options for bash, zsh or fish",
    "doctor": "versions, devices, backends that work here, compile-cache folder",
}
