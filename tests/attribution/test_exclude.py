"""What `--exclude` takes out of a mechanism's effects."""

import pytest

from adaptsim_jax.attribution.posed import excluded_of
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.joints.catalogue import MACHINE

JOINTS = ("shoulder", "elbow")


def test_an_effect_is_excluded_everywhere_or_at_a_joint():
    assert excluded_of(["tilt", "coulomb at elbow"], {e.name for e in MACHINE}, JOINTS) == (
        {"tilt"},
        frozenset({("coulomb", 1)}),
    )


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("magic", "no effect of a mechanism"),
        ("coulomb at wrist", "no joint is named 'wrist'"),
        ("tilt at elbow", "--exclude tilt"),
    ],
)
def test_what_cannot_be_excluded_is_refused(text, says):
    with pytest.raises(BadInput, match=says):
        excluded_of([text], {e.name for e in MACHINE}, JOINTS)
