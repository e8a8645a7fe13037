"""`adaptsim effects`."""

from __future__ import annotations

import argparse
import json
from typing import Any

from adaptsim_jax.core.config import Table
from adaptsim_jax.effects.registry import CATALOGUES, catalogue

LEGEND = """
Formulas: q, v angle and velocity of the joint, t time; a force adds to the joint's torque.
Amplitude: zero switches the effect off. Shape: how it acts. Torque scale: what the joint's torque exceeds 0.2 % of the time."""  # noqa: E501
EXAMPLES = """
  adaptsim effects                           physics, parameters, bounds, look-alikes, what shows each
  adaptsim effects mechanism --brief         of any MJCF or URDF, a line for each; likewise pushing, scooping, toss
  adaptsim effects mechanism --name stribeck  one of them
  adaptsim effects --json                    for a program
"""  # noqa: E501


def run(args: argparse.Namespace) -> int:
    """List the catalogue of a task."""
    from adaptsim_jax.commands.parser import next_step
    from adaptsim_jax.core.config import pick

    effects = listed(pick("task", args.task, CATALOGUES))
    if args.name:
        pick("effect", args.name, [effect["name"] for effect in effects])
        effects = [effect for effect in effects if effect["name"] == args.name]
    if args.json:
        print(json.dumps(effects, indent=1))
    elif args.brief:
        _brief(effects)
    else:
        for effect in effects:
            (_show_trials if "quantities" in effect else _show)(effect)
        if "formula" in effects[0]:
            print(LEGEND)
    if not args.json:
        next_step("new effect NAME    an effect of your own")
    return 0


def listed(task: str) -> list[Table]:
    """The catalogue of a task as plain data."""
    show = describe if task in ("pendulum", "mechanism") else of_trials
    return [show(effect) for effect in catalogue(task)]


def of_trials(effect: Any) -> Table:
    """An effect of short trials as plain data."""
    return {
        "name": effect.name,
        "place": effect.place,
        "physics": effect.physics,
        "quantities": [
            {"name": q.name, "unit": q.unit, "low": q.low, "high": q.high}
            for q in effect.parameters
        ],
        "absorbed_by": list(effect.look_alikes),
        "same_as": list(effect.same),
        "excitation": effect.excitation,
    }


def describe(effect: Any) -> Table:
    """An effect of the catalogue as plain data; bounds are for a torque scale of 1 N m."""

    def table(*names):
        return {name: getattr(effect, name) for name in names}

    parameters = {"parameters": [_parameter(parameter) for parameter in effect.parameters]}
    head = table("name", "place", "scope", "physics", "formula")
    return head | parameters | table("look_alikes", "contains", "excitation")


def _parameter(parameter: Any) -> Table:
    sign = {1: "positive", -1: "negative", 0: "either"}[parameter.sign]
    sign = "positive" if parameter.low >= 0 else sign
    role = "shape" if parameter.shape else "amplitude"
    table = {name: getattr(parameter, name) for name in ("unit", "low", "high", "default")}
    off = {"off": None if parameter.shape else parameter.default, "meaning": parameter.meaning}
    return {"name": parameter.name, "role": role, "sign": sign, **table, **off}


def _brief(effects: list[Table]) -> None:
    width = max(len(effect["name"]) for effect in effects)
    for effect in effects:
        print(f"{effect['name']:{width}}  {effect['place']:11}  {effect['physics']}")


def _show(effect: Table) -> None:
    from adaptsim_jax.effects.base import exponents

    if effect["scope"] == "joint":
        where = "at each joint"
    else:
        where = f"at the {effect['scope']}"
    print(
        f"{effect['name']}: acts on the {effect['place']} {where}"
        if effect["place"] != "force"
        else f"{effect['name']}: a force {where}"
    )
    print(f"  physics      {effect['physics']}")
    if effect["formula"]:
        print(f"  formula      {effect['formula']}")
    for p in effect["parameters"]:
        torques, times = exponents(p["unit"]) or (0, 0)
        scaled = " times the torque scale" if torques else ""
        if torques and times > 0:
            slow = ", wider for joints slower than 1 rad/s"
        else:
            slow = ""
        bounds = f"{p['low']:g} to {p['high']:g}{scaled}{slow}"
        bounds = bounds if p["high"] < 1e6 else "of the recording"
        meaning = f"; {p['meaning']}" if p["meaning"] else ""
        print(f"  {p['name']:12} [{p['unit']}] {bounds}; {p['sign']} sign; {p['role']}{meaning}")
    print(f"  look-alikes  {', '.join(effect['look_alikes']) or 'none known'}")
    print(f"  shown by     {effect['excitation']}")


def _show_trials(effect: Table) -> None:
    print(f"{effect['name']}: acts on the {effect['place']}")
    print(f"  physics      {effect['physics']}")
    for q in effect["quantities"]:
        print(f"  {q['name']:12} [{q['unit'] or '1'}] {q['low']:g} to {q['high']:g}")
    if effect["absorbed_by"] or effect["same_as"]:
        print(f"  look-alikes  {', '.join([*effect['absorbed_by'], *effect['same_as']])}")
    print(f"  shown by     {effect['excitation']}")
