"""Derivatives of a model's flows, guards and resets, as scalar code.

Each is traced from the trace of the function itself, once for a class, and read like any
other program (:mod:`hybrid.scene.python`). Columns are time first, then the elements of the
state; in a model with delays then what each lag shows of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..automaton.trace import again, trace
from ..scene import Field, Guard, Scene

Matrix = Callable[[float, np.ndarray], np.ndarray]


class Derivatives:
    """The derivatives of one scene, made when first asked for."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.size = scene, scene.spec.dimension
        self.columns = 1 + self.size * (1 + len(scene.spec.lags))
        self._made: dict[Any, Matrix] = {}

    def flow(self, field: Field) -> Matrix:
        """``(t, x) -> (n, 1 + n)``: of the flow of a mode, at rest and sliding as well."""
        return self._of(("flow", field.name), self.size, lambda: again(field.closed))

    def guard(self, guard: Guard, field: Field) -> Matrix:
        """``(t, x) -> (1, 1 + n)``: of a guard."""
        return self._of(("guard", guard.edge, field.name), 1, lambda: again(guard.closed))

    def reset(self, edge: str, kind: str) -> Matrix:
        """``(t, x) -> (n, 1 + n)``: of what a jump does to the state."""
        code, size = self.scene.code, self.size
        if kind == "contact":
            impact = lambda: _but_last(code.laws(edge).impact)  # noqa: E731
            return self._of(("impact", edge), size, impact)
        if kind == "edge":
            return self._of(("reset", edge), size, lambda: again(code.closed("reset", edge)))
        same = np.eye(size, self.columns, 1)
        return lambda t, x: same

    def project(self, field: Field) -> Matrix:
        """``(t, x) -> (n, 1 + n)``: of the way back onto the contacts held, or the surface."""
        code, switching = self.scene.code, self.scene.spec.sliding(field.mode)
        if switching is None:
            onto = lambda: code.held(field.held).project  # noqa: E731
        else:
            onto = lambda: code.sliding(switching.name).project  # noqa: E731
        return self._of(("project", field.name), self.size, onto)

    def speed(self, guard: Guard, field: Field) -> Matrix:
        """``(t, x) -> (1, 1 + n)``: of a guard's rate along the flow."""
        from ..scene.contact import lie

        rate = lambda: lie(again(guard.closed), again(field.closed))  # noqa: E731
        return self._of(("rate", guard.edge, field.name), 1, rate)

    def _of(self, key: Any, rows: int, function: Callable[[], Any]) -> Matrix:
        if key not in self._made:
            self._made[key] = self._make(key, rows, function)
        return self._made[key]

    def _make(self, key: Any, rows: int, function: Callable[[], Any]) -> Matrix:
        code, shape = self.scene.code, (rows, self.columns)
        shows = range(1 + len(code.shapes) - len(code.spec.windows), len(code.shapes), 2)
        jacobian = lambda: _jacobian(function(), shows)  # noqa: E731
        closed = lambda: trace(code.spec, jacobian(), 0, code.shapes)  # noqa: E731
        call = self.scene.bind(code.program(("derivative", *key), closed))
        return lambda t, x: np.array(call(t, x.tolist())).reshape(shape)


def _jacobian(function: Any, shows: Sequence[int]) -> Any:
    """The derivatives of ``function(parameters, t, x)`` along time and each element.

    ``shows`` are the places among the parameters of the windows' coefficients: the first row of
    them is a change of what is seen.
    """

    def columns(parameters: Any, t: Any, x: Any) -> Any:
        import jax
        import jax.numpy as jnp

        def of(t: Any, x: Any, seen: Any) -> Any:
            given = list(parameters)
            for place, shift in zip(shows, seen, strict=True):
                given[place] = given[place].at[0].add(shift)
            return jnp.atleast_1d(function(tuple(given), t, x))

        here = t, x, [jnp.zeros_like(x) for _ in shows]
        sizes = [1, *[x.size] * (1 + len(shows))]
        steps = []
        for unit in jnp.eye(sum(sizes)):
            dt, dx, *seen = jnp.split(unit, [1 + x.size * k for k in range(1 + len(shows))])
            steps.append(jax.jvp(of, here, (dt[0], dx, seen))[1])
        return jnp.stack(steps, axis=1)

    return columns


def _but_last(function: Any) -> Any:
    return lambda parameters, t, x: function(parameters, t, x)[:-1]
