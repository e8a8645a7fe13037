"""What the closed loop of a machine's servos shows: names, numbers and errors for the report.

The law of a servo is declared: what whole trials refute of it is a row of the effects, as friction,
a limit or a delay is. `servo_files.py` writes the files that hold it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.measures import WHOLE, Measure, predicts_nothing
from adaptsim_jax.attribution.posed import excluded_of
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.progress import Note
from adaptsim_jax.diagnosis.finding import Finding, Named
from adaptsim_jax.diagnosis.report import (
    Account,
    Errors,
    Headline,
    Label,
    Scored,
    error_rows,
    named_words,
    remarks,
    report_of,
)
from adaptsim_jax.diagnosis.testing import Test
from adaptsim_jax.effects.base import unit_at
from adaptsim_jax.effects.joints.actuator import ACTUATOR_LAG, DELAY, POSITION_GAIN, SATURATION
from adaptsim_jax.effects.joints.catalogue import BODY_MASS, MACHINE
from adaptsim_jax.effects.joints.forces import ARMATURE, BIAS, SPRING
from adaptsim_jax.effects.joints.friction import COULOMB
from adaptsim_jax.effects.joints.sensor import ENCODER_OFFSET
from adaptsim_jax.mechanisms.spec import Source
from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.closed_loop.identified import (
    LawMember,
    ServoLaws,
    identify_servos,
    scale_spread,
)
from adaptsim_jax.simulators.closed_loop.imposed import Recording
from adaptsim_jax.simulators.closed_loop.law import OPEN, Servo, ServoLaw, inner_damping
from adaptsim_jax.simulators.closed_loop.polish import SHARED_BY_ALL
from adaptsim_jax.simulators.closed_loop.recording import recording_of
from adaptsim_jax.simulators.closed_loop.whole import simulate, sums_by_piece

LIFT = "gravity_compensation"
NAMES = {
    "scale": POSITION_GAIN.name,
    "damping": POSITION_GAIN.name,
    "rub": COULOMB.name,
    "limit": SATURATION.name,
    "offset": BIAS.name,
    "rotor": ARMATURE.name,
    "spring": SPRING.name,
    "zero": ENCODER_OFFSET.name,
    "delay": DELAY.name,
    "lag": ACTUATOR_LAG.name,
    "payload": BODY_MASS.name,
    "reach": BODY_MASS.name,
    "lift": LIFT,
}
"""The name of the effect that a fitted number of a servo belongs to."""
PHYSICS = {
    POSITION_GAIN.name: "stiffness and damping of the controller are not the file's",
    COULOMB.name: COULOMB.physics,
    SATURATION.name: SATURATION.physics,
    BIAS.name: BIAS.physics,
    ARMATURE.name: ARMATURE.physics,
    SPRING.name: SPRING.physics,
    ENCODER_OFFSET.name: ENCODER_OFFSET.physics,
    DELAY.name: DELAY.physics,
    ACTUATOR_LAG.name: ACTUATOR_LAG.physics,
    BODY_MASS.name: BODY_MASS.physics,
    LIFT: "the controller feeds gravity forward, or another share of it than the file says",
}


@dataclass(frozen=True)
class ServoEffect:
    """An effect in closed loop. joint: -1 of all; members: what belongs to it."""

    name: str
    joint: int
    members: tuple[LawMember, ...]

    @property
    def key(self) -> tuple[str, int]:
        """What tells it from others."""
        return self.name, self.joint

    @property
    def strongest(self) -> LawMember:
        """The member that takes off most."""
        return max(self.members, key=lambda m: m.test.gain)


@dataclass(frozen=True)
class ServoModel:
    """Laws of a machine's servos. errors: RMS [P, n] of pieces of whole trials, rad."""

    laws: tuple[ServoLaw, ...]
    added: tuple[ServoEffect, ...]
    errors: np.ndarray


@dataclass(frozen=True)
class ServoDiagnosis:
    """What the closed loop shows of a machine.

    Args:
        machine: By its file.
        source: The model file.
        found: The servos.
        effects: What is named.
        scale_spread: [n] of the logarithm of kp.
    """

    machine: Machine
    source: Source
    found: ServoLaws
    effects: tuple[ServoEffect, ...]
    scale_spread: np.ndarray

    @property
    def recording(self) -> Recording:
        """What was simulated."""
        return self.found.recording

    def knows_scale(self, joint: int) -> bool:
        """Whether kp itself is known at a joint, and not only what is over it."""
        shown = self.found.scale_shown
        certain = self.scale_spread[joint] < CLOSED_LOOP.scale_known
        return bool(certain and self.shows_gain(joint) and (not shown or shown[joint]))

    def shows_gain(self, joint: int) -> bool:
        """Whether kp shows at all at a joint, damping and limit as they are."""
        return joint >= len(self.found.gain_shown) or self.found.gain_shown[joint]

    def shows_damping(self, joint: int) -> bool:
        """Whether damping shows at all at a joint, kp and limit as they are."""
        return joint >= len(self.found.damping_shown) or self.found.damping_shown[joint]


def diagnosed(
    machine: Machine,
    exclude: Sequence[str],
    few: int,
    notify: Note,
    keep: Callable[[ServoDiagnosis], None] = lambda diagnosis: None,
) -> ServoDiagnosis | None:
    """What the closed loop shows; None where not all joints follow targets, and of a machine of few
    joints where it names nothing though more than noise is left: stretches can show what no law of
    a servo has (elastic drives, play).

    Args:
        exclude: Effects that are not considered, as of `--exclude`.
        few: Joints up to which stretches are searched.
        keep: Called with what has been found so far, no kp of which is known yet.
    """
    source = machine.source
    if source is None:
        return None
    log = machine.log.pick([t.name for t in machine.tracks])
    recording = recording_of(source, log)
    if recording is None:
        return None
    names = {e.name for e in MACHINE} | {*NAMES.values()}
    everywhere, at_joints = excluded_of(exclude, names, machine.tree.joint_names)
    servos = tuple(_without(s, everywhere, at_joints) for s in recording.servos)

    def of(found: ServoLaws, spread: np.ndarray) -> ServoDiagnosis:
        return ServoDiagnosis(machine, source, found, _effects(found.members), spread)

    unknown = np.full(len(servos), np.inf)
    recording = replace(recording, servos=servos)
    found = identify_servos(recording, notify, lambda laws: keep(of(laws, unknown)))
    left = found.over_noise.max() > CLOSED_LOOP.lacks_nothing
    if left and not found.members and len(servos) <= few:
        return None
    return of(found, scale_spread(found))


def _without(servo: Servo, everywhere: set[str], at_joints: frozenset[tuple[str, int]]) -> Servo:
    """A servo of which the numbers of excluded effects are the file's."""
    gone = {n for n, e in NAMES.items() if e in everywhere or (e, servo.joint) in at_joints}
    return replace(servo, excluded=frozenset(gone))


def _effects(members: Sequence[LawMember]) -> tuple[ServoEffect, ...]:
    """Members by effect and joint."""
    by: dict[tuple[str, int], list[LawMember]] = {}
    for m in members:
        joint, name = m.coordinates[-1]
        by.setdefault((NAMES[name], joint), []).append(m)
    return tuple(ServoEffect(name, j, tuple(some)) for (name, j), some in by.items())


# ---------------------------------------------------------------- report


def reported(d: ServoDiagnosis) -> tuple[Table, Table]:
    """The report, and the arrays behind its page."""
    report = report_on(d)
    return report, {"held_out": _curves(d), "audit": remarks(report["notes"])}


def report_on(d: ServoDiagnosis) -> Table:
    """The report alone."""
    recording, found = d.recording, d.found
    file = tuple(s.law for s in recording.servos)
    before, after = (by_piece(recording, e) for e in (found.before, found.after))
    null, final = ServoModel(file, (), before), ServoModel(tuple(found.laws), d.effects, after)
    named = tuple(_named(d, e) for e in d.effects)
    finding = Finding(null, final, named, (), (), (null, final))
    account = _account(d, finding)
    report = report_of(finding, account)
    if predicts_nothing({WHOLE: measure_of(recording, after)}):
        report["message"] = (
            f"Over {judged_over(d)} this model does no better than what needs no model. "
            f"{report['message']}"
        )
    return report


def judged_over(d: ServoDiagnosis) -> str:
    """What was simulated: whole trials, or stretches of them."""
    return f"stretches of {d.recording.stretch:g} s" if d.recording.stretch else "whole trials"


def by_piece(recording: Recording, error: np.ndarray) -> np.ndarray:
    """RMS [P, n] of errors [rows of all trials, n]."""
    rows = sums_by_piece(recording, np.ones_like(error))
    return np.sqrt(sums_by_piece(recording, error) / np.maximum(rows, 1.0))


def _named(d: ServoDiagnosis, e: ServoEffect) -> Named:
    m, pieces = e.strongest, len(d.recording.pieces)
    test = Test(m.test.share, m.test.p, m.test.pieces, pieces, pieces)
    return Named(e, test, _steadiness(d, e), _alternatives(d, e))


def _alternatives(d: ServoDiagnosis, e: ServoEffect) -> tuple[ServoEffect, ...]:
    """What says the same of whole trials as a mass that is carried."""
    if e.name != BODY_MASS.name:
        return ()
    return tuple(ServoEffect(POSITION_GAIN.name, j, ()) for j in d.found.instead)


def _steadiness(d: ServoDiagnosis, e: ServoEffect) -> float:
    """Size over scatter of the number that is most certain."""
    sizes = []
    for m in e.members:
        for joint, name in m.coordinates:
            spread = d.found.spread([(joint, name)])
            j = max(joint, 0)
            sizes.append(abs(_distance(d, j, name)) / max(spread, 1e-9))
    return max(sizes, default=0.0)


def _distance(d: ServoDiagnosis, j: int, name: str) -> float:
    """How far a number is from the file's, in its coordinate."""
    file, law = d.recording.servos[j].law, d.found.laws[j]
    if name in ("scale", "damping", "limit"):
        number = "kp" if name == "scale" and law.kp > 0.0 else name.replace("scale", "damping")
        return float(np.log(getattr(law, number) / getattr(file, number)))
    unit = d.found.whole.problems[j].scales.unit(name)
    return (getattr(law, name) - getattr(file, name)) / unit


def _label(d: ServoDiagnosis, e: ServoEffect) -> Label:
    servos = d.recording.servos
    if e.name == BODY_MASS.name:
        carried = d.source.model.body(d.recording.model.body(d.recording.hand).name).name
        joint = servos[-1].name if servos else carried
        return Label(e.name, joint)
    if e.joint == SHARED_BY_ALL:
        return Label(e.name, "all joints" if len(servos) > 1 else servos[0].name)
    return Label(e.name, servos[e.joint].name)


def _account(d: ServoDiagnosis, finding: Finding) -> Account:
    recording, log = d.recording, d.machine.log
    over = d.found.over_noise
    left = bool(over.max() > CLOSED_LOOP.lacks_nothing)
    label = partial(_label, d)
    before, after = finding.null.errors, finding.final.errors
    measures = {
        "judge": WHOLE,
        "as_filed": True,
        "why": f"it follows targets, and a closed loop can be simulated over {judged_over(d)}",
        "declared": {WHOLE: measure_of(recording, before).as_dict()},
        "mended": {WHOLE: measure_of(recording, after).as_dict()},
    }
    names = [s.name for s in recording.servos]
    error = np.sqrt(np.square(d.found.after[d.found.whole.counted]).mean(0))
    more = {
        "power": [],
        "notes": [*log.notes, *d.machine.notes, *_notes(d)],
        "not_established": _doubts(d),
        "remaining": {
            "error": float(np.median(error)),
            "times_floor": float(np.median(over)),
            "joints": {
                n: {"error": float(e), "times_floor": float(o)}
                for n, e, o in zip(names, error, over, strict=True)
            },
        },
        "yardsticks": measures,
        "stages": [
            {"added": added, "error": float(np.median(e))}
            for added, e in (
                ([], before),
                ([label(e).words for e in d.effects], after),
            )
        ],
    }
    rows = [
        {"joints": _joints(d, e), "parameters": _parameters(d, e), "physics": PHYSICS[e.name]}
        for e in d.effects
    ]
    return Account(
        "mechanism",
        Path(d.machine.mechanism.path).name,
        {
            "trials": len(d.machine.tracks),
            "samples": log.samples,
            "held_out_trials": len(d.found.whole.problems[0].groups),
        },
        label,
        rows,
        [Scored(n.candidate, n.test.gain, n.test.p, "named") for n in finding.named],
        _headline(d, finding, left),
        left,
        _error(d, before, after),
        partial(_declared, d),
        more,
    )


def _joints(d: ServoDiagnosis, e: ServoEffect) -> list[str]:
    names = [s.name for s in d.recording.servos]
    return names if e.joint == SHARED_BY_ALL else [names[e.joint]]


def _headline(d: ServoDiagnosis, finding: Finding, left: bool) -> Headline:
    unit = "mm" if all(s.slides for s in d.recording.servos) else "mrad"
    sizes = [1e3 * float(np.median(m.errors)) for m in (finding.null, finding.final)]
    times = d.found.over_noise
    worst = int(np.argmax(times))
    rest = f"{times[worst]:.1f} times the noise at {d.recording.servos[worst].name}"
    over = judged_over(d)
    declared = f"The model file as it is simulates {over} to {sizes[1]:.3g} {unit}, {rest}."
    gains = [e for e in d.effects if e.name == POSITION_GAIN.name]
    others = [n for n in finding.named if n.candidate.name != POSITION_GAIN.name]
    law = f"The servos' law is not the file's: {', '.join(_law_words(d, e) for e in gains)}. "
    sizes_text = f"{over.capitalize()} {sizes[0]:.3g} to {sizes[1]:.3g} {unit}"
    rest = f"{sizes_text}; what remains is at most {rest}."
    words = named_words(others, lambda e: _label(d, e).words) if others else ""
    mended = f"{law if gains else ''}{words} {rest}".strip()
    return Headline(declared, mended)


def _law_words(d: ServoDiagnosis, e: ServoEffect) -> str:
    s, law = d.recording.servos[e.joint], d.found.laws[e.joint]
    if s.follows_speed:
        return f"{s.name} kv {law.damping:.3g} (file {s.law.damping:.3g})"
    if not d.shows_damping(e.joint):
        kp = f"kp {law.kp:.4g}" if d.shows_gain(e.joint) else "kp unknown"
        return f"{s.name} {kp} (file {s.law.kp:.4g}), damping unknown (file {s.law.damping:.3g})"
    if not d.shows_gain(e.joint):
        return f"{s.name} damping {law.damping:.3g} (file {s.law.damping:.3g})"
    if not d.knows_scale(e.joint):
        ratio, file = law.damping / law.kp, s.law.damping / s.law.kp
        return f"{s.name} damping over kp {ratio:.3g} s (file {file:.3g})"
    return (
        f"{s.name} kp {law.kp:.4g} (file {s.law.kp:.4g}), "
        f"damping {law.damping:.3g} (file {s.law.damping:.3g})"
    )


def _parameters(d: ServoDiagnosis, e: ServoEffect) -> dict[str, Table]:
    """Numbers of an effect, each with its 90 % interval and what the file says."""
    if e.name == POSITION_GAIN.name:
        return _gains(d, e.joint)
    j = max(e.joint, 0)
    s, law = d.recording.servos[j], d.found.laws[j]
    out = {}
    for joint, name in (c for m in e.members for c in m.coordinates):
        key, value, file, unit, wide = _number(d, j, name, (joint, name))
        out[key] = _row(value, wide, unit) | {"file": file}
    if "reach" in out:
        out["reach"]["meaning"] = "outward from the centre of mass of the body that carries it"
    if e.name == SATURATION.name and not law.inside:
        inner = float(inner_damping(s, law.damping))
        out["unloaded_speed"] = _row(law.limit / max(inner, 1e-12), 0.0, unit_of(s, "rad/s"))
        out["unloaded_speed"]["meaning"] = "at which the limit leaves no torque"
    return out


KEYS = {
    "rub": "level",
    "limit": "limit",
    "offset": "bias",
    "rotor": "inertia",
    "spring": "stiffness",
    "zero": "offset",
    "payload": "mass",
    "lift": "share",
}


def _number(d: ServoDiagnosis, j: int, name: str, at: tuple[int, str]):
    """(key, value, the file's, unit, half of the 90 % interval) of a fitted number."""
    s, law, ends = d.recording.servos[j], d.found.laws[j], d.found.ends()
    value, file = float(getattr(law, name)), float(getattr(s.law, name))
    key, unit = KEYS.get(name, name), UNIT_OF.get(name, "1")
    if name in ("limit", "rub"):
        coordinates = [at, (j, "scale")] if name == "limit" else [at]
        spread = d.found.spread(coordinates)
        size = value if name == "limit" else d.found.whole.problems[j].scales.unit(name)
        wide = ends * spread * size
        if name == "rub" and "scale" in d.found.found.model.fits[j].free:
            wide = float(np.hypot(wide, ends * d.found.spread([(j, "scale")]) * value))
        return key, value, None if file >= OPEN else file, unit_of(s, unit), wide
    problem = d.found.whole.problems[j]
    size = d.found.whole.rotor_unit if at == (SHARED_BY_ALL, "rotor") else problem.scales.unit(name)
    wide = ends * d.found.spread([at]) * size
    if name == "offset":  # a torque, as the effect has it
        return key, value * law.kp, 0.0, unit_of(s, "N m"), wide * law.kp
    if name == "rotor":
        value, file = value + s.armature, s.armature
    return key, value, file, unit_of(s, unit), wide


UNIT_OF = {
    "rub": "N m",
    "limit": "N m",
    "rotor": "kg m^2",
    "spring": "N m/rad",
    "zero": "rad",
    "payload": "kg",
    "reach": "m",
    "lift": "1",
    "delay": "s",
    "lag": "s",
}


def unit_of(s: Servo, unit: str) -> str:
    """A unit of a hinge, as a servo that slides has it."""
    return unit_at(unit, "slide" if s.slides else "hinge")


def _row(value: float, wide: float, unit: str) -> Table:
    return {"value": value, "low": value - wide, "high": value + wide, "unit": unit}


NOT_SHOWN = ". These data do not show it: another one is simulated as well"


def _gains(d: ServoDiagnosis, j: int) -> dict[str, Table]:
    """kp, damping and their ratio at a joint."""
    s, law, ends = d.recording.servos[j], d.found.laws[j], d.found.ends()
    whole = ends * d.found.spread([(j, "scale"), (j, "damping")])
    out = {"damping": _times(law.damping, whole, unit_of(s, "N m s/rad")) | {"file": s.law.damping}}
    if s.follows_speed:
        return out
    ratio = _times(law.damping / law.kp, ends * d.found.spread([(j, "damping")]), "s")
    gain = _times(law.kp, ends * d.found.spread([(j, "scale")]), unit_of(s, "N m/rad"))
    ratio |= {"file": s.law.damping / s.law.kp, "meaning": "damping over kp"}
    gain["meaning"] = f"the controller's stiffness; the file says {s.law.kp:.4g}"
    if not d.shows_gain(j):
        gain["meaning"] += NOT_SHOWN
    if not d.shows_damping(j):
        out["damping"]["meaning"] = f"of controller and joint{NOT_SHOWN}"
    if not (d.shows_gain(j) and d.shows_damping(j)):
        return {"kp": gain | {"file": s.law.kp}, **out}
    if not d.knows_scale(j):
        only = (
            ". Only ratios to kp are fixed by these data; its scale is that of the file's inertia"
        )
        gain["meaning"] += only
    return {"kp": gain | {"file": s.law.kp}, **out, "damping_over_kp": ratio}


def _times(value: float, wide: float, unit: str) -> Table:
    """An interval of a number whose logarithm was fitted."""
    low, high = value * float(np.exp(-wide)), value * float(np.exp(wide))
    return {"value": float(value), "low": low, "high": high, "unit": unit}


def _declared(d: ServoDiagnosis, model: ServoModel) -> Table:
    """Rows of kp and damping as a model has them."""
    rows = {}
    for j, (s, law) in enumerate(zip(d.recording.servos, model.laws, strict=True)):
        fitted = (POSITION_GAIN.name, j) in {e.key for e in model.added}
        own = _gains(d, j) if fitted else {}
        for key, number, unit in (("kp", law.kp, "N m/rad"), ("damping", law.damping, "N m s/rad")):
            if key == "kp" and s.follows_speed:
                continue
            plain = {"value": number, "low": number, "high": number, "unit": unit_of(s, unit)}
            row = {k: z for k, z in own.get(key, plain).items() if k != "meaning"}
            known = not fitted or d.knows_scale(j)
            rows[f"{key} of {s.name}"] = row | {"identifiable": known, "file": getattr(s.law, key)}
    return rows


def _error(d: ServoDiagnosis, before: np.ndarray, after: np.ndarray) -> Table:
    both = {"before": before, "after": after}
    recording = d.recording
    channels = {
        s.name: Errors(
            "m" if s.slides else "rad",
            float(recording.noise[j]),
            {k: e[:, j] for k, e in both.items()},
        )
        for j, s in enumerate(recording.servos)
    }
    units = {c.unit for c in channels.values()}
    unit = units.pop() if len(units) == 1 else "1"
    whole = Errors(unit, float(np.median(recording.noise)), both)
    trial = np.array([k for k, _, _ in recording.pieces])
    metric = "median over pieces of whole trials and joints of the RMS error of simulated angles"
    names = [t.name for t in recording.trials]
    source = "third differences of the angles, and the encoders' step"
    return error_rows(metric, source, names, whole, channels, trial)


def measure_of(recording: Recording, error: np.ndarray) -> Measure:
    """Errors [P, n] of pieces beside a straight line and holding still."""
    line, still = [], []
    for k, a, b in recording.pieces:
        t = recording.trials[k]
        q, time = t.q[a : b + 1], t.time[a : b + 1]
        still.append(np.std(q, 0))
        fit = np.polynomial.polynomial.polyfit(time - time[0], q, 1)
        rest = q - np.polynomial.polynomial.polyval(time - time[0], fit).T
        line.append(np.sqrt(np.square(rest).mean(0)))
    servos = recording.servos
    span = float(np.median([t.time[-1] for t in recording.trials]))
    units = tuple("m" if s.slides else "rad" for s in servos)
    names = tuple(s.name for s in servos)
    left, by_line, at_rest = (np.median(z, 0) for z in (error, np.array(line), np.array(still)))
    return Measure(WHOLE, span, left, by_line, at_rest, names, units)


def _notes(d: ServoDiagnosis) -> list[str]:
    notes = [
        f"Servos were simulated in closed loop over {judged_over(d)}, commands held from row to "
        "row; efforts, if logged, were not used. Each piece's errors are by the numbers that the "
        "other pieces give. Each name was tested over the trials that were fitted, one number "
        "against thousands of rows."
    ]
    if d.recording.stretch:
        notes.append(
            "Over whole trials joints run away, as at a limit, and what is wrong of a force grows "
            "with the square of time: each stretch begins as it was measured."
        )
    if not d.found.laws[0].sharp:
        notes.append(
            "Dry friction gives as MuJoCo's does: whole trials are simulated better than with "
            "friction that holds."
        )
    times = [
        law.kp / s.law.kp
        for s, law in zip(d.recording.servos, d.found.laws, strict=True)
        if s.law.kp > 0.0 and law.kp != s.law.kp
    ]
    usual = float(np.median(times)) if times else 1.0
    changed = abs(np.log(usual)) > CLOSED_LOOP.min_change
    if changed and len(times) > 1 and np.std(np.log(times)) < CLOSED_LOOP.min_change:
        notes.append(
            f"kp is {usual:.3g} of the file's at {len(times)} joints alike: bodies {1 / usual:.3g} "
            "times heavier would say the same. A known weight at the hand tells which."
        )
    return notes


def _doubts(d: ServoDiagnosis) -> list[str]:
    ratio = [
        d.recording.servos[e.joint].name
        for e in d.effects
        if e.name == POSITION_GAIN.name
        and not d.recording.servos[e.joint].follows_speed
        and not d.knows_scale(e.joint)
    ]
    if not ratio:
        return []
    return [
        f"kp itself at {', '.join(ratio)}: only damping and friction over kp are known; faster "
        "motion or a known load would tell"
    ]


def _curves(d: ServoDiagnosis) -> list[Table]:
    """Measured angles and those that were simulated, before and after, by trial."""
    recording, names = d.recording, [s.name for s in d.recording.servos]
    paths = simulate(recording, [[s.law for s in recording.servos], d.found.laws])
    out = []
    for trial in dict.fromkeys(t.name for t in recording.trials):
        parts = [k for k, t in enumerate(recording.trials) if t.name == trial]
        angles = {
            "measured": np.concatenate([recording.trials[k].q for k in parts]),
            "before": np.concatenate([paths[0][k].q for k in parts]),
            "after": np.concatenate([paths[1][k].q for k in parts]),
        }
        times = [recording.trials[k].begin + recording.trials[k].time for k in parts]
        out.append(
            {
                "trial": trial,
                "units": {s.name: "m" if s.slides else "rad" for s in recording.servos},
                "time": np.concatenate(times),
                **{key: dict(zip(names, q.T, strict=True)) for key, q in angles.items()},
            }
        )
    return out
