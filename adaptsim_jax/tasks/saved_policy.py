"""A NAF policy as `adaptsim robot` writes it to a file, back as a function."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput


def read_saved(
    path: str | Path, kind: type, policy: type, make_naf: Callable, make_policy: Callable, what: str
):
    """`act(seen [2] or [N, 2]) -> actions` of a `best.toml` or `policy.toml`.

    kind: of the task's configuration, which has `hidden`; policy: of its policies, made of weights;
    make_naf(config) and make_policy(config): the task's own; what: the task in a message. Raises
    BadInput where the file holds no policy of this task.
    """
    table = configs.read(path)
    given, hidden = table.get("policy"), table.get("hidden")
    weights = given.get("weights") if isinstance(given, dict) else None
    if isinstance(hidden, list) and all(isinstance(n, int) and 0 < n <= 4096 for n in hidden):
        sizes = hidden
    else:
        sizes = None
    config = None if sizes is None else kind(hidden=tuple(sizes))
    if (
        config is None
        or not isinstance(weights, list)
        or np.shape(weights) != (_count(make_naf(config)),)
    ):
        raise BadInput(
            f"{path}: holds no policy of {what}; write it again with 'adaptsim robot next'"
        )
    act, learned = jax.jit(make_policy(config)), policy(jnp.asarray(weights, jnp.float32))
    return lambda seen: np.asarray(act(learned, jnp.asarray(seen, jnp.float32)))


def _count(naf: Any) -> int:
    """How many weights the networks of `naf` have."""
    return jax.eval_shape(lambda: naf.init(jax.random.key(0)).online).size


def leaves_by_name(policy: Any) -> dict[str, Any]:
    """The leaves of a task policy as nested lists, by name."""
    import jax
    import numpy as np

    leaves = jax.tree_util.tree_flatten_with_path(policy)[0]
    return {
        jax.tree_util.keystr(path).strip(".[]'"): np.asarray(leaf).tolist() for path, leaf in leaves
    }
