"""Alternatives of the declared model, which are compared before effects are searched for.

| alternative | where |
| --- | --- |
| dry friction that is sharp, or gives as a simulator's does | `attribution/equation/rubbing.py` |
| bodies and damping of the file, or fitted | `attribution/equation/confirmed.py` |
| what like joints have, at all of them | `attribution/equation/balance_objective.py` |
| values and effects of another objective | `attribution/tree_objective.py` |
| another shape of the piece | `tasks/scooping/diagnosis/passes.py` |
| kp of a servo, and a limit beside it | `attribution/servo.py`, by numbers of its own |

Both models are fitted to the same recording and compared on what was left out, by one test.
"""

from adaptsim_jax.diagnosis.testing import Test


def preferred(test: Test, size: float, level: float, family: int = 1) -> bool:
    """Whether an alternative is taken instead of the declared model.

    Args:
        test: of the alternative against the declared model, by what was left out.
        size: share of the loss that it must take off.
        level: probability of a false choice.
        family: places at which the same was asked.
    """
    return test.gain > size and test.p * family <= level
