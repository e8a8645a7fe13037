"""The push as the registry holds it, and what of a mended model it takes."""

from typing import Any

from adaptsim_jax.core.errors import BadInput, brief
from adaptsim_jax.mend.model_toml import RENEW, read_form
from adaptsim_jax.tasks.base import TaskKind
from adaptsim_jax.tasks.pushing.adapt import ADAPT, SYMBOLS
from adaptsim_jax.tasks.pushing.engines import BACKENDS
from adaptsim_jax.tasks.pushing.engines.parity import PARITY
from adaptsim_jax.tasks.pushing.model import PAPER, PARAMETERS
from adaptsim_jax.tasks.pushing.one_shot import make_pushing_one_shot
from adaptsim_jax.tasks.pushing.robot import ROBOT
from adaptsim_jax.tasks.pushing.slide import NEUTRAL
from adaptsim_jax.tasks.pushing.task import PushingConfig, make_pushing

OWN = ("friction", "mass", "coefficients")


def of_model(table: dict[str, Any], where: str) -> dict[str, Any]:
    """Options `friction`, `coefficients`, `mended` and `fitted` of a model file's table. Under
    `left_out` the names of effects that are of the measurement alone (a camera that is late or
    turned) and so none of the simulator's. Raises BadInput with the key.
    """
    form = read_form(table, where, OWN)
    if (mass := form.own.get("mass", PAPER.mass)) != PAPER.mass:
        raise BadInput(
            f"{where}: mass = {brief(mass)}; policies are trained for a bottle of {PAPER.mass} kg "
            "only"
        )
    for name in PARAMETERS:
        if name not in form.declared:
            raise BadInput(f"{where}: [declared] has no number '{name}'; {RENEW}")
    fitted = [form.declared[name].value for name in PARAMETERS]
    mended, left_out = {}, []
    for effect in form.effects:
        of_slide = {name: p.value for name, p in effect.parameters.items() if name in NEUTRAL}
        mended |= of_slide
        if not of_slide:
            left_out.append(effect.name)
    options = {key: form.own[key] for key in ("friction", "coefficients") if key in form.own}
    return options | {"mended": mended, "fitted": fitted, "left_out": left_out}


TASK = TaskKind(
    PushingConfig,
    make_pushing,
    make_pushing_one_shot,
    of_model=of_model,
    adapt=ADAPT,
    robot=ROBOT,
    symbols=SYMBOLS,
    backends=BACKENDS,
    parity=PARITY,
)
