"""Commands that the motion contradicts (`logs.quality.commands`): exchanged between joints, cut on
their way to the drive, or with another gain in some trials. Reported with the mend; never applied.
"""

import numpy as np

from adaptsim_jax.attribution.criteria import TEXT
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.quality.commands import (
    TargetLimit,
    detect_target_limit,
    find_exchanged,
    gains_by_trial,
    other_unit,
    pulls_away,
)
from adaptsim_jax.logs.quality.contradictions import AS_DECLARED
from adaptsim_jax.logs.quality.findings import AuditFinding
from adaptsim_jax.logs.quality.hypotheses import Track


def check_commands(machine: Machine) -> tuple[AuditFinding, ...]:
    """What the motion says of the commands of actuators. Raises BadInput where they are another
    joint's, or were cut on their way by what no servo does itself.
    """
    if machine.log.input_kind != "command":
        return ()
    tracks = [Track(t.time, t.q, t.v, t.u) for t in machine.tracks]
    driven = [j for j in range(machine.tree.n) if machine.actuator[0, j] != 0.0]
    _check_units(machine)
    _check_order(machine, tracks, driven)
    found = []
    for j in driven:
        stiff, damped = -machine.actuator[2, j], -machine.actuator[3, j]
        if stiff > 0 and pulls_away(tracks, j):
            name = machine.tree.joint_names[j]
            raise BadInput(
                f"{machine.log.path}: the targets of {name} count against its angles, which go the "
                f"other way; write target_{name} = -1 under [units] in meta.toml; {AS_DECLARED}"
            )
        if stiff > 0 and (
            limited := detect_target_limit(tracks, j, max(damped, 0.0) / stiff / machine.gear[j])
        ):
            name = machine.tree.joint_names[j]
            text = _cut(name, limited, machine.tree.unit(j))
            if limited.kind == "rate":
                raise BadInput(f"{machine.log.path}: {text}; {AS_DECLARED}")
            text += "; a limit of its torque does the same, and is looked for"
            found.append(AuditFinding("target_within", "warn", "", name, text, limited.size))
        gains = gains_by_trial(tracks, j)
        if gains is not None:
            found.append(_gains(machine, j, gains))
    return tuple(found)


def _check_units(machine: Machine) -> None:
    """BadInput where a servo's target follows its angle in another unit."""
    log, names = machine.log, machine.tree.joint_names
    for a in machine.mechanism.actuators:
        if a.kind != "position" or a.more or a.name not in log.input_names:
            continue
        j, k = a.joint, log.input_names.index(a.name)
        slides = machine.tree.kinds[j] == "slide"
        if unit_found := other_unit(
            [t.q[:, j] for t in log.trials], [t.u[:, k] for t in log.trials], slides
        ):
            lines = f'q_{names[j]} = "{unit_found[0]}" and target_{names[j]} = "{unit_found[1]}"'
            raise BadInput(
                f"{log.path}: the targets of {names[j]} look to be in {unit_found[1]} where its "
                f"angles are in {unit_found[0]}; write {lines} under [units] in meta.toml; "
                f"{AS_DECLARED}"
            )


def _check_order(machine: Machine, tracks: list[Track], driven: list[int]) -> None:
    swapped = find_exchanged(tracks, driven)
    if swapped is None:
        return
    names, log = machine.tree.joint_names, machine.log
    moved = [(j, k) for j, k in zip(driven, swapped.order, strict=True) if j != k]
    times = float(
        np.exp(
            np.mean(
                [
                    np.log(a / max(b, 1e-6))
                    for a, b in zip(swapped.share_as_declared, swapped.share_otherwise, strict=True)
                    if a != b
                ]
            )
        )
    )
    pairs = ", ".join(f"{names[j]} moves as that of {names[k]} says" for j, k in moved)
    columns = {j: _columns(machine, j) for j, _ in moved}
    lines = ", ".join(f'{columns[j][0]} = "{columns[k][1]}"' for j, k in moved)
    raise BadInput(
        f"{log.path}: the commands are in another order than the actuators: {pairs} (which leaves "
        f"{float(f'{min(times, 9999.0):.2g}'):g} times less of the motion unexplained); exchange "
        f"them, under [columns] in meta.toml: {lines}; {AS_DECLARED}"
    )


def _columns(machine: Machine, joint: int) -> tuple[str, str]:
    """Our name of the column of a joint's command, and the file's."""
    log, name = machine.log, machine.tree.joint_names[joint]
    for k, column in enumerate(log.input_names):
        own = next((a for a in machine.mechanism.actuators if a.name == column), None)
        if (own is not None and own.joint == joint) or column == name:
            if k < len(log.input_columns):
                theirs = log.input_columns[k]
            else:
                theirs = f"ctrl{k + 1}"
            return (
                f"target_{name}" if theirs.startswith("target") else f"ctrl_{column}"
            ), log.meta.columns.get(theirs, theirs)
    return f"ctrl_{name}", f"ctrl_{name}"


def _cut(joint: str, limit: TargetLimit, unit: str) -> str:
    size = float(f"{limit.size:.3g}")
    if limit.kind == "rate":
        phrase, line = (
            f"by a rate limit of about {size:g} {unit}/s",
            f"rate = {{{joint} = {size:g}}}",
        )
    else:
        phrase, line = (
            f"to within about {size:g} {unit} of the angle",
            f"within = {{{joint} = {size:g}}}",
        )
    return (
        f"the targets of {joint} are not what acted: it moves as if they were cut {phrase} on "
        f"their way (of its acceleration {100 * limit.share_as_declared:.0f} % is unexplained as "
        "recorded, "
        f"{100 * limit.share_otherwise:.2g} % so); log what was sent, or write {line} under "
        "[commands] in meta.toml"
    )


def _gains(machine: Machine, joint: int, gains: np.ndarray) -> AuditFinding:
    name = machine.tree.joint_names[joint]
    size = gains / gains[0]
    order = sorted(range(len(size)), key=lambda k: -abs(np.log(size[k])))[: TEXT.trials]
    listed = ", ".join(f"{machine.tracks[k].name} {size[k]:.2f}" for k in sorted(order))
    if len(size) <= TEXT.trials:
        more = ""
    else:
        more = f", and {len(size) - TEXT.trials} more"
    text = (
        f"what the commands of {name} do differs from trial to trial, its actuator's gain or what "
        f"it moves: times that of {machine.tracks[0].name}: {listed}{more}; diagnose trials of one "
        "gain (--without), or give each its own model"
    )
    return AuditFinding(
        "gain_by_trial", "warn", "", name, text, float(np.max(gains) / np.min(gains))
    )
