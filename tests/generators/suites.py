"""Which data sets make up each suite: null, one effect, outside the catalogue, two at once, power,
metamorphic.
"""

from dataclasses import dataclass, replace

import numpy as np

from tests.generators.conditions import NULL_CONDITIONS
from tests.generators.dataset import Spec
from tests.generators.effects import EFFECTS
from tests.generators.recording import Dataset

PLACES = tuple((n, j) for n in EFFECTS for j in ((0,) if n == "tilt" else (1, 2)))
EFFECT_CONDITIONS = (
    "clean",
    "clean",
    "low_noise",
    "jitter",
    "closed_loop",
    "no_velocity",
    "quantised",
    "coloured",
)
POWER_MULTIPLES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0)

# Effects that no recording can tell apart, by physics: turning the base and turning the first
# encoder's zero both shift q1 against gravity, and nothing else in the equations of motion depends
# on q1.
SAME = {
    ("tilt", "base"): {("encoder_offset", "joint1")},
    ("encoder_offset", "joint1"): {("tilt", "base")},
}
# Names under which one family may be listed in a catalogue.
ALIASES = {
    "dahl": "presliding",
    "lugre": "presliding",
    "viscous_drift": "friction_drift",
    "armature": "rotor_inertia",
}
# Effects close enough in kind that two of them in one data set would be one question asked twice.
KIN = (
    {"coulomb", "stribeck", "presliding", "load_friction"},
    {"bias", "tilt", "encoder_offset", "spring"},
    {"delay", "actuator_lag", "sensor_lag"},
    {"torque_gain", "saturation", "dead_zone"},
)


@dataclass(frozen=True)
class Case:
    """One data set of a suite, with what `diagnose` is told and what was done to the files."""

    name: str
    spec: Spec
    exclude: tuple[str, ...] = ()
    variant: str = ""  # metamorphic: duplicated | shuffled | milliseconds | filtered | irrelevant


def _world(rng: np.random.Generator) -> str:
    return "linearized" if rng.random() < 0.2 else "rigid_body"


def null_cases(n: int, seed: int) -> list[Case]:
    """Nothing hidden; the conditions take turns."""
    out = []
    for i in range(n):
        rng = np.random.default_rng([seed + i, 7])
        spec = Spec(seed + i, NULL_CONDITIONS[i % len(NULL_CONDITIONS)], world=_world(rng))
        out.append(Case(f"null_{seed + i}", spec))
    return out


def single_spec(seed: int, low: float = 3.0, high: float = 10.0, index: int | None = None) -> Spec:
    """One effect: catalogue and joints take turns by `index`, size log-uniform from 3 times what
    just matters.
    """
    rng = np.random.default_rng([seed, 8])
    world = _world(rng)
    condition = str(rng.choice(EFFECT_CONDITIONS))
    name, joint = PLACES[seed % len(PLACES) if index is None else index % len(PLACES)]
    multiple = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return Spec(seed, condition, ((name, joint, multiple),), world)


def single_cases(n: int, seed: int) -> list[Case]:
    return [Case(f"single_{seed + i}", single_spec(seed + i)) for i in range(n)]


def outside_cases(n: int, seed: int) -> list[Case]:
    """One effect whose name the catalogue is denied, with whatever cannot be told from it by
    physics.
    """
    out = []
    for i in range(n):
        spec = single_spec(seed + i)
        name = spec.effects[0][0]
        same = {other for (own, _), twins in SAME.items() if own == name for other, _ in twins}
        out.append(Case(f"outside_{seed + i}", spec, exclude=(name, *sorted(same))))
    return out


def two_cases(n: int, seed: int) -> list[Case]:
    """Two effects of different kinds, 3 to 8 times the size that just matters each."""
    out = []
    for i in range(n):
        rng = np.random.default_rng([seed + i, 9])
        first = PLACES[(seed + i) % len(PLACES)]
        kin = next((k for k in KIN if first[0] in k), {first[0]})
        others = [p for p in PLACES if p[0] not in kin and p != ("rotor_inertia", 1)]
        second = others[rng.integers(len(others))]
        sizes = np.exp(rng.uniform(np.log(3), np.log(8), 2))
        hidden = tuple(
            (name, j, float(m)) for (name, j), m in zip((first, second), sizes, strict=True)
        )
        out.append(Case(f"two_{seed + i}", Spec(seed + i, "clean", hidden, _world(rng))))
    return out


def power_cases(n: int, seed: int) -> list[Case]:
    """The same rig and effect at all of `POWER_MULTIPLES`; `n` counts data sets."""
    out = []
    for i in range(n):
        base = single_spec(seed + i // len(POWER_MULTIPLES))
        m = POWER_MULTIPLES[i % len(POWER_MULTIPLES)]
        name, joint, _ = base.effects[0]
        spec = replace(base, effects=((name, joint, m),), condition="clean")
        out.append(Case(f"power_{spec.seed}_{m:g}", spec))
    return out


VARIANTS = ("", "duplicated", "shuffled", "milliseconds", "filtered", "irrelevant")


def metamorphic_cases(n: int, seed: int) -> list[Case]:
    """`n` data sets, half of them null, each as it is and in five disguises (so 6 n diagnoses)."""
    out = []
    for i in range(n):
        spec = single_spec(seed + i) if i % 2 else null_cases(n, seed)[i].spec
        out += [Case(f"meta_{seed + i}_{v or 'plain'}", spec, variant=v) for v in VARIANTS]
    return out


SUITES = {
    "null": null_cases,
    "single": single_cases,
    "outside": outside_cases,
    "two": two_cases,
    "power": power_cases,
    "metamorphic": metamorphic_cases,
}


def disguise(ds: Dataset, variant: str, seed: int) -> Dataset:
    """The same measurements in another form; no honest verdict may depend on it."""
    if variant == "duplicated":
        return replace(ds, trials=[t for t in ds.trials for _ in range(2)])
    if variant == "shuffled":
        order = np.random.default_rng([seed, 11]).permutation(len(ds.trials))
        return replace(ds, trials=[ds.trials[i] for i in order])
    if variant == "milliseconds":
        trials = [t | {"time": 1e3 * t["time"]} for t in ds.trials]
        return replace(ds, trials=trials, meta=ds.meta | {"units": {"time": "ms"}})
    if variant == "filtered":
        return replace(ds, trials=[_three_point(t) for t in ds.trials])
    return ds


def _three_point(trial: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Angles and velocities smoothed by (1, 6, 1) / 8: zero phase, mild, its ends left alone."""
    out = dict(trial)
    for c in ("q1", "q2", "v1", "v2"):
        if c in trial:
            x = trial[c]
            out[c] = np.concatenate([x[:1], (x[:-2] + 6 * x[1:-1] + x[2:]) / 8, x[-1:]])
    return out
