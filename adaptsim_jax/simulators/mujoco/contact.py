"""What only contact and a base that moves show: friction, softness and bounce of what touches the
world, ground that is tilted or lies at another height, wind.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from adaptsim_jax.effects.base import Effect
from adaptsim_jax.simulators.mujoco.acting import WIND
from adaptsim_jax.simulators.mujoco.build import SteppedModel
from adaptsim_jax.simulators.mujoco.catalogue import row
from adaptsim_jax.simulators.mujoco.criteria import CANDIDATE
from adaptsim_jax.simulators.mujoco.fields import (
    CONTACT,
    GROUND,
    ModelNumber,
    grounds,
    make_number,
    model_number,
)

TRIED_RATIOS = (0.7, 1.4)  # of what the file has
DIRECTIONS = np.arange(8) * np.pi / 4


def contact_rows(stepped_model: SteppedModel) -> Iterable[Effect]:
    """Make the effects that show where anything may touch the world, and where the base moves."""
    model = stepped_model.model
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    touch = [int(g) for g in np.flatnonzero((model.geom_bodyid > 0) & solid)]
    if grounds(model) and touch:
        yield from _of_touch(model, (*grounds(model), *touch), _effective(model, touch))
        if stepped_model.free >= 0:
            tilts = [model_number(model, name) for name in GROUND[:2]]
            texts = ("what it stands on is not level", "standing, walking")
            slopes: list[Any] = []
            for w in DIRECTIONS:
                slope = CANDIDATE.slope * np.array([np.cos(w), np.sin(w)])
                slopes.append(dict(zip(GROUND[:2], slope, strict=True)))
            yield _tried_at(
                row("tilted", "ground", tilts, texts, ("a log's frame turned",)), slopes
            )
            texts = ("what it stands on lies higher or lower", "every step")
            levels = [{GROUND[2]: z} for z in (-CANDIDATE.level, CANDIDATE.level)]
            yield _tried_at(row("height", "ground", model_number(model, GROUND[2]), texts), levels)
    if stepped_model.free >= 0:
        k = int(np.flatnonzero(model.jnt_qposadr == stepped_model.free)[0])
        weight = float(model.body_mass.sum()) * 9.81
        first = int(model.jnt_dofadr[k])
        wind = [
            make_number(
                f"wind.{a}", WIND, (first,), i, 0.0, (-weight, weight), CANDIDATE.push * weight
            )
            for i, a in enumerate("xyz")
        ]
        yield row(
            "wind",
            "base",
            wind,
            ("a steady force on the base", "flight, slipping, long runs"),
            ("a tether",),
        )


def _tried_at(effect: Effect, sizes: Sequence[Mapping[str, float]]) -> Effect:
    return replace(effect, grid=({}, *sizes))


def _effective(model: mujoco.MjModel, touch: list[int]) -> list[int]:
    """Geoms of the bodies furthest out, which touch the ground first: where a model has feet,
    these; of them those whose numbers go before others' (`priority`).
    """
    ends = [g for g in touch if not np.any(model.body_parentid == model.geom_bodyid[g])] or touch
    first = model.geom_priority[ends].max()
    return [g for g in ends if model.geom_priority[g] == first]


def _of_touch(
    model: mujoco.MjModel, touching: tuple[int, ...], feet: list[int]
) -> Iterable[Effect]:
    """One number for all that touches, in proportion; its default is that of the feet."""

    def shared_number(what: str, column: int, high: float) -> ModelNumber:
        value = float(getattr(model, f"geom_{what}")[feet, column].mean())
        name, ends = f"{CONTACT}{what}[{column}]", (1e-3 * min(value, 1.0), high)
        return make_number(name, f"geom.{what}", touching, column, value, ends, 0.01 * value)

    def tried_row(
        effect: str, f: ModelNumber, texts: tuple[str, str], same: tuple[str, ...] = ()
    ) -> Effect:
        """Tried at sizes, too: where contacts chatter a derivative says little."""
        sizes = [
            {f.name: float(np.clip(share * f.default, f.low, f.high))} for share in TRIED_RATIOS
        ]
        return _tried_at(row(effect, "all contacts", f, texts, same), sizes)

    dims = int(model.geom_condim[list(touching)].max())
    if model.geom_friction[feet, 0].any():  # of none there is no share
        yield tried_row(
            "floor friction",
            shared_number("friction", 0, 5.0),
            ("a floor that is more or less slippery", "sliding"),
        )
    if dims >= 4 and model.geom_friction[feet, 1].any():
        yield tried_row(
            "torsional friction",
            shared_number("friction", 1, 1.0),
            ("turns on the spot are held more or less", "turns on a foot"),
        )
    if dims >= 6 and model.geom_friction[feet, 2].any():
        yield tried_row(
            "rolling friction",
            shared_number("friction", 2, 1.0),
            ("rolling is held more or less", "round feet, wheels, balls"),
        )
    if (model.geom_solref[feet, 0] > 0).all():
        yield tried_row(
            "contact stiffness",
            shared_number("solref", 0, 1.0),
            ("softer or harder contacts", "impacts"),
            ("soft ground",),
        )
        yield tried_row(
            "contact damping",
            shared_number("solref", 1, 5.0),
            ("contacts that bounce", "impacts, falls"),
            ("restitution",),
        )
        yield tried_row(
            "contact impedance",
            shared_number("solimp", 0, 0.9999),
            ("contacts that give from the first touch", "standing"),
        )
