"""The first variation along a run: fundamental matrices of arcs, saltation matrices of jumps.

A small change of the state is carried along an arc by ``d(Phi)/dt = Df Phi``, ``Phi = 1`` at
its start. Through a jump with guard ``g`` and reset ``R``, from the flow ``f-`` to ``f+``, it is
carried by the saltation matrix (all derivatives at the state before the jump) ::

    S = R_x + (f+ - R_x f- - R_t) g_x / (g_t + g_x f-)

which accounts for the neighbour's jumping a little earlier or later. Both are taken at equal
times. See ``docs/notes/orbits.md``; di Bernardo, Budd, Champneys & Kowalczyk,
*Piecewise-smooth Dynamical Systems* (2008), sections 2.5 and 6.2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import attrs
import numpy as np
from numpy.polynomial import legendre

from ..arcs import Arc, JumpRow, Part, TailPart
from ..errors import OrbitError
from ..scene import Field, Guard, scene_of
from ..segment import Segment
from ..trajectory import Trajectory
from .derivatives import Derivatives, Matrix

#: Stages of the collocation, whose order is twice as many.
STAGES = 8

#: Steps are halved until both halves say the same, relative; and most halvings of one.
RESOLVED, DEPTH = 1e-12, 24

#: What is left of a difference, relative, that is rounding.
ROUNDING = 1e-14

#: Kinds of jumps that leave the state and, where they begin, the flow as they are.
SMOOTH = ("release", "leave")


@attrs.frozen(eq=False)
class Factor:
    """A matrix by which a piece of a run carries a small change of the state.

    Attributes
    ----------
    t : float
        Time at its end.
    edge : str or None
        Of a jump: its edge; of an accumulation: those that accumulate. None along an arc.
    matrix : array, shape (n, n)
    """

    t: float
    edge: str | None
    matrix: np.ndarray


def factors(model: Any, run: Trajectory) -> Iterator[Factor]:
    """The first variation along a run, piece by piece, in order.

    Parameters
    ----------
    model : Automaton
        The model of the run.
    run : Trajectory
        With dense output.

    Yields
    ------
    Factor
        For each step of each arc, each jump and each accumulation of impacts.

    Raises
    ------
    OrbitError
        Where the run passes the limit of a cycle of several edges, for which no derivative is
        known; or where the neighbours of the run take another course. In a model with delays.
    """
    if run.spec.lags:
        raise OrbitError(
            f"{run.spec.model} looks into the past: a change of its state does not decide on what "
            "follows; hy.periodic_orbit gives the multipliers of its orbits"
        )
    walk = _Walk(model, run)
    if any(isinstance(part, Arc) and part.length and not part.segments for part in run.parts):
        raise OrbitError(f"{run.spec.model}: the first variation needs a run with save='dense'")
    yield from walk.factors()


class _Walk:
    """A walk over the parts of a run."""

    def __init__(self, model: Any, run: Trajectory) -> None:
        self.run, self.scene = run, scene_of(model)
        self.derivatives = Derivatives(self.scene)

    def factors(self) -> Iterator[Factor]:
        group: list[tuple[Field, JumpRow]] = []  # jumps with no time between them
        parts, jumps = self.run.parts, self.run.own_jumps
        yield from self.start(parts[0])
        for index, part in enumerate(parts):
            field, last = self.scene.field(part.mode), index + 1 == len(parts)
            instant = isinstance(part, Arc) and not part.length
            if group and (last or not instant):
                yield self.jump(group, field)
                group = []
            if isinstance(part, Arc):
                yield from self.arc(part, field)
            elif not last:
                yield self.limit(part)
            if index in jumps:
                group.append((field, jumps[index]))
            elif not last and isinstance(part, Arc):
                raise OrbitError(
                    f"{self.run.spec.model}: the run passes the limit of a cycle of several edges "
                    f"at t = {part.t1!r}; its first variation is known for one contact only"
                )

    def start(self, part: Part) -> Iterator[Factor]:
        """A run that begins at rest, or sliding, begins with its start's projection."""
        field = self.scene.field(part.mode)
        if isinstance(part, Arc) and field.project is not None:
            onto = self.derivatives.project(field)(part.t0, part.first)[:, 1:]
            yield Factor(part.t0, None, cleared(onto, np.ones_like(onto), ROUNDING))

    def arc(self, arc: Arc, field: Field) -> Iterator[Factor]:
        rate, t = self.derivatives.flow(field), arc.t0 + arc.low
        for segment in arc.segments:
            yield Factor(t + segment.end, None, transition(rate, t, [segment]))

    def limit(self, part: TailPart) -> Factor:
        from .limit import through

        edge = f"limit of {part.tail.contact.name}"
        return Factor(part.t1, edge, through(self.derivatives, part.tail))

    def jump(self, group: Sequence[tuple[Field, JumpRow]], after: Field) -> Factor:
        """One jump, or several with no time between them."""
        field, row = group[0]
        guard = field.guards[field.column(row.edge)]
        edge = " ".join(jump.edge for _, jump in group)
        return Factor(row.t, edge, self.saltation(field, guard, group, after))

    def saltation(
        self,
        field: Field,
        guard: Guard,
        group: Sequence[tuple[Field, JumpRow]],
        after: Field,
    ) -> np.ndarray:
        size, (first, last) = self.derivatives.size, (group[0][1], group[-1][1])
        reset = np.eye(size, 1 + size, 1)
        for source, row in group:
            kind = source.guards[source.column(row.edge)].kind
            of = self.derivatives.reset(row.edge, kind)(row.t, row.before)
            reset = of[:, 1:] @ reset + np.eye(1, 1 + size) * of[:, :1]
        if guard.kind in SMOOTH and len(group) == 1:
            return reset[:, 1:]
        gradient = self.derivatives.guard(guard, field)(first.t, first.before)[0]
        before = np.array([1.0, *field.rhs(first.t, first.before.tolist())])
        rate = float(gradient @ before)
        if rate == 0.0:
            raise OrbitError(
                f"{self.run.spec.model}, t = {first.t!r}: the guard of {first.edge} is reached "
                "without speed; a jump that grazes has no first variation"
            )
        change = np.array(after.rhs(last.t, last.after.tolist())) - reset @ before
        sooner = np.outer(change, gradient[1:]) / rate
        return cleared(reset[:, 1:] + sooner, np.abs(reset[:, 1:]) + np.abs(sooner), ROUNDING)


def cleared(matrix: np.ndarray, sizes: np.ndarray, relative: float) -> np.ndarray:
    """A matrix with 0 for what is rounding of the terms it is made of: a lost rank stays lost."""
    return np.where(np.abs(matrix) <= relative * sizes, 0.0, matrix)


def transition(rate: Matrix, t: float, segments: Sequence[Segment]) -> np.ndarray:
    """The fundamental matrix of ``d(Phi)/dt = rate(t, x) Phi`` along dense output.

    Parameters
    ----------
    rate : callable ``(t, x) -> (m, 1 + m)``
        Derivatives of a flow (the first column, by time, is not used).
    t : float
        Time at the start of the arc to which the segments belong.
    segments : sequence of Segment

    Returns
    -------
    array, shape (m, m)
        By Gauss collocation of order 16, each step halved until it is resolved.
    """
    result = None
    for segment in segments:
        whole = _collocate(rate, t, segment, segment.start, segment.length)
        piece = _resolve(rate, t, segment, segment.start, segment.length, whole, DEPTH)
        result = piece if result is None else piece @ result
    assert result is not None
    return result


def _resolve(
    rate: Matrix,
    t: float,
    segment: Segment,
    start: float,
    length: float,
    whole: np.ndarray,
    depth: int,
) -> np.ndarray:
    half = 0.5 * length
    first = _collocate(rate, t, segment, start, half)
    second = _collocate(rate, t, segment, start + half, half)
    both: np.ndarray = second @ first
    if not depth or np.abs(both - whole).max() <= RESOLVED * np.abs(both).max():
        return both
    first = _resolve(rate, t, segment, start, half, first, depth - 1)
    return _resolve(rate, t, segment, start + half, half, second, depth - 1) @ first


def _collocate(rate: Matrix, t: float, segment: Segment, start: float, length: float) -> np.ndarray:
    points, inner, weights = _gauss()
    taus = start + length * points
    states = segment(taus)
    rates = np.array([rate(t + tau, x) for tau, x in zip(taus.tolist(), states, strict=True)])
    rates, size = rates[:, :, 1:], rates.shape[1]
    coupling = np.einsum("ij,iab->iajb", -length * inner, rates)
    system = np.eye(STAGES * size) + coupling.reshape(STAGES * size, STAGES * size)
    slopes = np.linalg.solve(system, rates.reshape(STAGES * size, size))
    return np.eye(size) + length * np.einsum("i,iab->ab", weights, slopes.reshape(rates.shape))


@cache
def _gauss() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of Gauss and Legendre on [0, 1], integrals to each of them, and to 1."""
    points, weights = legendre.leggauss(STAGES)
    values = np.linalg.inv(legendre.legvander(points, STAGES - 1))
    whole = [legendre.legint(row, lbnd=-1.0) for row in np.eye(STAGES)]
    inner = np.array([legendre.legval(points, row) for row in whole]).T @ values
    return 0.5 + 0.5 * points, 0.5 * inner, 0.5 * weights
