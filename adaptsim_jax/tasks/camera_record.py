"""What records of trials that a camera saw have in common: which trials were asked for, units, and times that run forward."""

from collections.abc import Callable, Mapping

import numpy as np

from adaptsim_jax.core.errors import BadInput


def check_numbers(numbers: np.ndarray, at: Callable[[int], str], asked: np.ndarray) -> None:
    """BadInput at the first row of `numbers [T]` that is none of the trials `asked [N]`."""
    for i in np.flatnonzero(~np.isin(numbers, asked))[:1]:
        now, number = " and ".join(map(str, asked)), numbers[i]
        if number != np.round(number):
            raise BadInput(f"{at(i)}: trial {number:g} is no whole number; number the trials as in actions.csv")
        if 0 < number < asked[0]:
            raise BadInput(f"{at(i)}: trial {number:g} was told already; name the file of {now}")
        raise BadInput(f"{at(i)}: trial {number:g} was never asked for; asked are {now}, see actions.csv")


def check_unit(columns: Mapping[str, np.ndarray], at: Callable[[int], str], far: float, what: str) -> None:
    """BadInput at the first place farther than `far` m."""
    for name in ("x", "y"):
        for i in np.flatnonzero(np.abs(columns[name]) > far)[:1]:
            value = columns[name][i]
            raise BadInput(f"{at(i)}: {name} = {value:.6g} m is beyond any {what}; is it in mm or cm? write metres")


def check_increasing(time: np.ndarray, told: Callable[[int], str]) -> None:
    """BadInput at the first row of one trial's `time [T]` s that is not after the one before."""
    for k in np.flatnonzero(np.diff(time) <= 0)[:1] + 1:
        word = "repeats" if time[k] == time[k - 1] else "runs backwards"
        raise BadInput(f"{told(k)}: time {word} ({time[k - 1]:.9g} then {time[k]:.9g}); sort or remove such rows")
