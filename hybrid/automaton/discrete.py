"""Discrete variables, which only jumps change: ``count = hy.discrete(0)``.

They follow the states in the state vector and have derivative zero. One declared with a whole
number or a flag is an integer or a boolean wherever an author or a user sees it.
"""

from __future__ import annotations

import math
from typing import Any

import attrs
import numpy as np

from ..errors import FlowError
from .markers import State

#: Kind of a discrete variable, by numpy's dtype letters.
KIND_OF = {"b": "bool", "i": "int", "u": "int", "f": "float"}

#: All whole numbers up to this are exact in a double.
MOST_EXACT = 2.0**53

#: Dtype letters that a reset may return for each kind, and the remedy for others.
DUE_KINDS = {"int": "iu", "bool": "b", "float": "iufb"}
KIND_REMEDIES = {
    "int": "a whole number is due: jnp.floor(...).astype(int), or declare hy.discrete(0.0)",
    "bool": "True or False is due: a comparison, or ~s.name",
}


@attrs.define(slots=False, eq=False)
class Discrete(State):
    """Marker of a discrete variable; made by :func:`discrete`."""

    default: Any = 0

    @property
    def kind(self) -> str:
        """``"int"``, ``"float"`` or ``"bool"``; empty if the default is no such value."""
        try:
            value = np.asarray(self.default)
        except ValueError:
            return ""
        finite = value.shape == () and value.dtype.kind in KIND_OF and math.isfinite(self.default)
        kind = KIND_OF[value.dtype.kind] if finite else ""
        return "" if kind == "int" and abs(self.default) > MOST_EXACT else kind


def discrete(default: Any = 0, doc: str = "") -> Any:
    """Declare a discrete variable: it is constant between jumps, and resets may change it.

    Parameters
    ----------
    default : int, float or bool
        The value at the start of a run that gives none. Its type is that of the variable: an
        integer (exact up to 2^53), a real number, or a boolean.
    doc : str
        A short description.

    Notes
    -----
    Flows, guards, gaps, resets and restitutions read it by name, ``s.count``; resets change it,
    ``s.replace(count=s.count + 1)``. Flows do not return it, and ``x, v = s`` leaves it out.
    """
    return Discrete("", doc, (), default)


def typed(name: str, kind: str, part: np.ndarray) -> np.ndarray:
    """Values of a run converted to the declared kind; unchanged if any is not finite.

    Raises
    ------
    FlowError
        If a whole number is too large to be exact in a double.
    """
    if kind == "bool" and np.isfinite(part).all():
        return part > 0.5
    if kind != "int" or not np.isfinite(part).all():
        return part
    if np.any(np.abs(part) > MOST_EXACT):
        raise FlowError(
            f"the discrete variable {name} has reached {np.abs(part).max():g}: whole numbers are "
            "exact to 2^53 only; reset it before, or declare hy.discrete(0.0)"
        )
    return np.rint(part).astype(np.int64)


def traced(name: str, kind: str, part: Any) -> Any:
    """The counterpart of :func:`typed` for traces."""
    import jax.numpy as jnp

    if kind == "bool":
        return part > 0.5
    return jnp.floor(part + 0.5).astype(int) if kind == "int" else part


def number(name: str, kind: str, part: Any) -> Any:
    """``part`` unchanged: the counterpart of :func:`typed` that converts nothing."""
    return part


def require_kind(name: str, kind: str, dtype: Any) -> None:
    """Refuse a reset's value whose dtype does not fit the kind."""
    if np.dtype(dtype).kind not in DUE_KINDS.get(kind, np.dtype(dtype).kind):
        raise ValueError(f"{name}: a value of type {dtype} where {KIND_REMEDIES[kind]}")


def misfit(kind: str, values: np.ndarray) -> str | None:
    """Why start values do not fit a kind; None if they do."""
    if kind == "int" and not np.all((values == np.rint(values)) & (np.abs(values) <= MOST_EXACT)):
        return "is not a whole number up to 2^53"
    if kind == "bool" and not np.all((values == 0) | (values == 1)):
        return "is neither True nor False"
    return None
