"""What a model looks like in the plane, as points and lines, for animations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import OptionError
from .spec import Spec
from .trace import caller, wide

#: Attribute that marks a drawing method.
MARK = "_hybrid_picture"


def picture(function: Callable[..., Any]) -> Callable[..., Any]:
    """Declare what a model looks like: ``@hy.picture`` over a method ``def look(self, t, s)``.

    Notes
    -----
    The method returns a list of arrays of shape ``(k, 2)``, made with ``jax.numpy``: a line through
    ``k`` points each, or a dot if ``k`` is 1. Their number and shapes are the same at all times.
    ``run.animate("run.gif")`` draws them.
    """
    setattr(function, MARK, True)
    return function


def looks(spec: Spec, parameters: Any, t: Any, x: Any) -> list[np.ndarray]:
    """The lines of a model at times ``t`` and states ``x``: arrays of shape ``(n, k, 2)``.

    Raises
    ------
    OptionError
        If the model does not have exactly one such method, or the method returns something else.
    """
    import jax
    import jax.numpy as jnp

    if spec.cls is None:
        what = f"load the run with its model, hy.load(path, {spec.model})"
        raise OptionError(f"{spec.model}: a file does not contain the model's picture: {what}")
    found = [name for name in dir(spec.cls) if hasattr(getattr(spec.cls, name), MARK)]
    if len(found) != 1:
        there = f"it has {', '.join(found)}" if found else "it has no method with @hy.picture"
        raise OptionError(f"{spec.model}: exactly one method must have @hy.picture; {there}")
    call = caller(spec.cls, spec, getattr(spec.cls, found[0]))

    def shapes(values: Any, t: Any, x: Any) -> list[Any]:
        lines = call(values, t, x)
        return [jnp.asarray(line) for line in lines]

    given = [np.asarray(parameters[each.name], dtype=float) for each in spec.parameters]
    pieces = [parameters[signal.name].pieces(t) for signal in spec.signals]
    axes = (None,) * len(given) + (0,) * len(pieces)
    try:
        with wide():
            lines = jax.jit(jax.vmap(shapes, in_axes=(axes, 0, 0)))((*given, *pieces), t, x)
    except TypeError as fault:
        raise OptionError(f"{spec.model}: {found[0]}: {fault}") from None
    for line in lines:
        if line.ndim != 3 or line.shape[-1] != 2:
            raise OptionError(
                f"{spec.model}: {found[0]} gives an array of shape {line.shape[1:]}; give a list "
                "of arrays of shape (k, 2)"
            )
    return [np.asarray(line) for line in lines]
