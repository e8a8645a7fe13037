"""Templates of the pages, all of one environment, with the filters by which they write numbers and
names.
"""

from functools import cache
from typing import Any

import jinja2

from adaptsim_jax.report import diagnosis_format as fmt
from adaptsim_jax.report import diagnosis_words as words


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("adaptsim_jax.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    for name in ("quantity", "number", "percent", "p_value", "between", "listing", "count"):
        environment.filters[name] = getattr(fmt, name)
    environment.filters["plain"] = words.plain
    return environment


def filled(template: str, **values: Any) -> str:
    """The text of a template of this room with these values in it."""
    return _environment().get_template(template).render(**values)
