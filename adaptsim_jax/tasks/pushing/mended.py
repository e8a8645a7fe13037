"""A model.toml of measured pushes as options of the task, so that policies are trained on the
mended slide.
"""

from typing import Any

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.given import brief, finite
from adaptsim_jax.tasks.pushing.model import PAPER, PARAMETERS
from adaptsim_jax.tasks.pushing.slide import NEUTRAL

KEYS = ("schema", "task", "friction", "mass", "coefficients", "parameters", "effects")


def of_model(table: dict[str, Any], where: str) -> dict[str, Any]:
    """Options `friction`, `coefficients`, `mended` and `fitted` of a model file's table; under
    `left_out` the names of effects that are of the measurement alone (a camera that is late or
    turned) and so none of the simulator's. Raises BadInput with the key.
    """
    for key in table:
        if key not in KEYS:
            raise BadInput(f"{where}: unknown key '{key}'; {config.suggest(key, KEYS)}")
    for key in ("parameters", "effects"):
        if not isinstance(table.get(key), dict):
            raise BadInput(
                f"{where}: table [{key}] is missing; give a model.toml that `adaptsim diagnose` "
                f"wrote of pushes"
            )
    if (mass := table.get("mass", PAPER.mass)) != PAPER.mass:
        raise BadInput(
            f"{where}: mass = {brief(mass)}; policies are trained for a bottle of {PAPER.mass} kg "
            f"only"
        )
    fitted = []
    for name in PARAMETERS:
        value = finite(table["parameters"].get(name))
        if value is None:
            raise BadInput(
                f"{where}: [parameters] has no number '{name}'; give a model.toml that `adaptsim "
                f"diagnose` wrote"
            )
        fitted.append(value)
    mended, left_out = {}, []
    for effect, quantities in table["effects"].items():
        if not isinstance(quantities, dict):
            raise BadInput(
                f"{where}: [effects] {effect} = {brief(quantities)} is no table; give its "
                f"quantities"
            )
        for name, given in quantities.items():
            value = finite(given)
            if value is None:
                raise BadInput(
                    f"{where}: [effects.{effect}] {name} = {brief(given)} is no number; mend it"
                )
            if name in NEUTRAL:
                mended[name] = value
        if not set(quantities) & set(NEUTRAL):
            left_out.append(effect)
    options = {key: table[key] for key in ("friction", "coefficients") if key in table}
    return options | {"mended": mended, "fitted": fitted, "left_out": left_out}
