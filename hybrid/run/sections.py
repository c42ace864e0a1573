"""Where a run comes back: an edge, a surface, or a period of the forcing."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.markers import RISING, Crossing
from ..automaton.refusals import reason
from ..automaton.spec import Spec
from ..automaton.trace import caller, scalar, trace
from ..errors import OptionError
from ..events import Zero, fires, zeros
from ..lowering import Guard, Kind, Scene
from ..lowering.derivatives import node_shape
from ..lowering.field import Scalar
from ..lowering.jaxpr import require_written
from ..rules.guards import GUARD_ROUNDING
from ..rules.zeros import EPS
from ..trajectory.arcs import Arc, arcs_of
from ..trajectory.trajectory import Solution

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector

#: A surface on which a run starts is zero there, relative to the terms that it is made of; and its
#: zeros are known to this share of a step, and the states of an arc that rests or slides to this.
STARTS = 1e-8


@attrs.frozen
class Return:
    """Where a run meets a section: in which part, how long after that part began.

    ``flight``: in a summed series, the flight from whose start ``tau`` counts.
    """

    part: int
    tau: float
    flight: int = 0


@attrs.frozen
class Period:
    """A section in time: the states one period apart (stroboscopic)."""

    period: float

    def __str__(self) -> str:
        return f"the period {self.period!r}"


@attrs.frozen
class EdgeSection:
    """The states just after the jumps of an edge, a contact, a switching or a release."""

    name: str

    def __str__(self) -> str:
        return f"the jump {self.name!r}"

    def returns(self, run: Solution) -> Iterator[Return]:
        """The run's jumps of that name that are no part of a summed series."""
        for index, row in sorted(run.own_jumps.items()):
            part = run.parts[index]
            if row.edge == self.name and isinstance(part, Arc) and index + 1 < len(run.parts):
                yield Return(index, part.length)


@attrs.frozen(eq=False)
class Surface:
    """The states where a function of time and state crosses zero along an arc."""

    scene: Scene
    guard: Guard
    size: Scalar

    def __str__(self) -> str:
        return "the surface"

    def returns(self, run: Solution) -> Iterator[Return]:
        """The crossings after the start, those in flights of a summed series of impacts too."""
        sides = Sides(self, run.t0, run.options["rtol"])
        for index, part in enumerate(run.parts):
            for flight, arc in enumerate(arcs_of(part)):
                for tau in sides.crossings(arc):
                    yield Return(index, tau, flight)


@attrs.define(eq=False)
class Sides:
    """The crossings of a surface along the arcs of a run, asked for in their order.

    Where an arc begins or ends on the surface, as at a guard that is the same function, rounding
    decides nothing: the surface is crossed if the run leaves it to the other side than that from
    which it came. While the run stays on it, as while it slides there, or no farther from it than
    the errors of its steps, it crosses nothing.

    Attributes
    ----------
    surface : Surface
    t0 : float
        Where the run starts. A start on the surface is no crossing.
    rtol : float
        What the steps' polynomials may be off, relative to the terms of the surface.
    came : int
        The side from which the last arc came to the surface on which it ends; 0 if on none.
    """

    surface: Surface
    t0: float
    rtol: float
    came: int = 0

    def crossings(self, arc: Arc) -> Iterator[float]:
        """The local times of an arc at which it crosses the surface."""
        if not arc.segments:
            return
        value, crossing = self.surface.guard.value, self.surface.guard.crossing
        t, starts, points = arc.t0 + arc.low, arc.t0 <= self.t0, list(_points(arc))
        size = max(self.surface.size(t + tau, x.tolist()) for tau, x in points)
        noise = (STARTS if arc.constrained else GUARD_ROUNDING * EPS) * size
        values = [(tau, value(t + tau, x.tolist())) for tau, x in points]

        def stays(since: float, until: float) -> bool:
            middle = 0.5 * (since + until)
            between = [value(t + middle, arc.local(middle).tolist())]
            between += [each for tau, each in values if since < tau < until]
            return max(map(abs, between)) <= max(noise, self.rtol * size)

        here, there = value(arc.t0, arc.first.tolist()), value(arc.t1, arc.last.tolist())
        begins = abs(here) <= max(noise, STARTS * size * starts)
        ends = abs(there) <= noise
        found = list(self._zeros(arc, begins, noise))
        if begins or starts:
            since = STARTS * arc.segments[0].length
            found = [zero for zero in found if zero.tau > since and not stays(0.0, zero.tau)]
        if ends:
            until = arc.length - STARTS * arc.segments[-1].length
            found = [zero for zero in found if zero.tau < until and not stays(zero.tau, arc.length)]
        farthest = max((each for _, each in values), key=abs)
        side = int(np.sign(farthest)) if abs(farthest) > noise else 0
        turns = [zero.direction for zero in found if zero.direction]
        leaves = -turns[0] if turns else side
        if begins and leaves and self.came == -leaves and fires(crossing, leaves):
            yield 0.0
        yield from (zero.tau for zero in found if fires(crossing, zero.direction))
        self.came = (turns[-1] if turns else side or self.came) if ends else 0

    def _zeros(self, arc: Arc, begins: bool, noise: float) -> Iterator[Zero]:
        """The zeros of the function along an arc; ``begins``: on the surface."""
        guard, t, ends = self.surface.guard, arc.t0 + arc.low, dict[Any, float]()
        order, noise = int(begins), noise * begins
        for segment in arc.segments:
            yield from zeros(guard, segment, t, order, np.inf, 0.0, ends, noise)
            order = 0


def _points(arc: Arc) -> Iterator[tuple[float, StateVector]]:
    """Local times and states at the ends and in the middle of each step of an arc."""
    shares = np.array([0.0, 0.5, 1.0])
    for segment in arc.segments:
        taus = segment.start + segment.length * shares
        yield from zip(taus.tolist(), segment.at(shares), strict=True)


Section = Period | EdgeSection | Surface


def section_of(model: Any, scene: Scene, section: Any, crossing: Crossing = RISING) -> Section:
    """A section as a caller gives it: a name, a number, or a function ``(self, t, s)``.

    A function of the model alone, ``(self)``, gives a period.

    Raises
    ------
    OptionError
        If it is none of these, or the direction of a crossing is none.
    """
    if not isinstance(crossing, Crossing):
        raise OptionError(
            f"{scene.spec.model}: crossing={crossing!r}: give hy.RISING, hy.FALLING or hy.EITHER"
        )
    if isinstance(section, str):
        known = _jumps(scene)
        if section not in known:
            raise OptionError(
                f"{scene.spec.model}: section={section!r}: there are the jumps {', '.join(known)}; "
                "or give a surface (self, t, s), or a period"
            )
        return EdgeSection(section)
    if callable(section) and len(inspect.signature(section).parameters) == 1:
        section = _period_of(model, scene, section)
    if callable(section):
        return _surface(model, scene, section, crossing)
    try:
        period = float(section)
    except (TypeError, ValueError):
        period = -1.0
    if not 0 < period < float("inf"):
        raise OptionError(
            f"{scene.spec.model}: section={section!r}: the name of an edge or contact, a surface "
            "(self, t, s), a period greater than 0, or a function (self) that gives one"
        )
    return Period(period)


def _period_of(model: Any, scene: Scene, function: Callable[..., Any]) -> Any:
    """What a function of the model alone gives."""
    try:
        return function(model)
    except Exception as fault:  # whatever the caller's function raises
        raise OptionError(
            f"{scene.spec.model}: section: a function of one argument gets the model, and gives a "
            f"period; a surface is a function (self, t, s): {type(fault).__name__}: {fault}"
        ) from None


def _jumps(scene: Scene) -> list[str]:
    """The names of all jumps of a model."""
    spec = scene.spec
    ends = [end.name for switching in spec.switchings for end in switching.ends]
    names = list(dict.fromkeys(edge.name for edge in spec.transitions))
    return [*names, *(f"{name}.release" for name in names if scene.is_contact(name)), *ends]


def _require_no_signal(spec: Spec, closed: Any) -> None:
    """Refuse a surface that reads a signal."""
    used = require_written(closed) if spec.signals else set()
    end = sum(math.prod(np.shape(parameter.default)) for parameter in spec.parameters)
    for signal in spec.signals:
        begin, end = end, end + signal.size
        if used.intersection(range(begin, end)):
            raise OptionError(
                f"{spec.model}: section, a surface: it reads the signal {signal.name}, which "
                "differs between knots; give a surface of t and the state, a jump or a period"
            )


def _surface(model: Any, scene: Scene, function: Callable[..., Any], crossing: Crossing) -> Surface:
    code, spec = scene.code, scene.spec
    call = scalar(caller(type(model), spec, function))
    try:
        closed = code.once(("section", function), lambda: trace(spec, call, 0, code.shapes))
    except Exception as fault:  # whatever the caller's function raises
        raise OptionError(f"{spec.model}: section, a surface: {reason(fault)}") from fault
    _require_no_signal(spec, closed)
    graph, numbers = code.mode(spec.initial), scene.numbers(spec.initial, ())

    def bound(what: str, made: int) -> Scalar:
        program = graph.program(("section", what, function), lambda: [made])
        call = scene.bind(program, numbers)
        return lambda t, x: call(t, x)[0]

    node = code.once(("section", graph.mode, function), lambda: graph.values(closed)[0])
    free, shape = lambda *_: (0.0, 0.0, 0.0), node_shape(graph.graph, node)
    made = bound("value", node), free, *shape, lambda: closed
    size = bound("size", graph.size(node))
    return Surface(scene, Guard("section", Kind.EDGE, "", crossing, *made), size)
