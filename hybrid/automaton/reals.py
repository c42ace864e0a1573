"""Converts values given by a caller to real numbers, or refuses them."""

from __future__ import annotations

from reprlib import Repr
from typing import Any

import numpy as np

#: How long a value may be that is shown in a message.
SHOWN_SHORT = Repr()
SHOWN_SHORT.maxstring, SHOWN_SHORT.maxother = 60, 120

#: Kinds of numpy's types that turn into floats without being numbers, or lose what they are.
NOT_REAL = "cmMSU"


def short(value: Any) -> str:
    """A value as it is shown in a message: numbers of numpy as numbers, long ones cut."""
    shown = SHOWN_SHORT.repr(value.item() if isinstance(value, np.generic) else value)
    return " ".join(shown.split())


def reals(value: Any) -> np.ndarray:
    """A number, sequence or array as a float array.

    Raises
    ------
    ValueError
        If the value is text, a date, complex, masked, a set or dict, or too large for a float.
    """
    if isinstance(value, float):
        return np.asarray(value, dtype=float)
    if isinstance(value, str | bytes | set | frozenset | dict) or np.ma.is_masked(value):
        raise ValueError("no real number")
    array = np.asarray(value)
    if array.dtype.kind in NOT_REAL:
        raise ValueError("no real number")
    try:
        return np.asarray(array, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError("no real number") from None


def real(value: Any) -> float:
    """One real number as a float.

    Raises
    ------
    ValueError
        If the value is not exactly one real number.
    """
    if isinstance(value, float):
        return float(value)
    array = reals(value)
    if array.shape != ():
        raise ValueError("not one number")
    return float(array)
