"""A slow, simple simulator that says who is right. It shares no line with ``hybrid/``.

A scene is plain Python: modes with a flow (or, where it is known, its closed form) and edges with
guards and resets, all functions of mpmath's numbers. Between jumps a guard is sampled, a change of
its sign is narrowed down, the reset is applied as written. Jumps that accumulate are made one by
one, down to gaps of a billionth, and what is left is summed as a geometric series. All in 40
digits; what is not resolved by ``sample`` is not seen, and a guard that only just misses zero is
told (``Outcome.nearest``), so that a scene on which two correct answers could differ can be left
out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from mpmath import mp, mpf

#: Digits of all numbers.
DIGITS = 40

#: A guard this small at the start of an arc is the zero at which the arc began.
ZERO = mpf(10) ** -30

#: A guard this small is zero: the last flights of a tail, of 1e-9, then keep 25 digits.
FOUND = mpf(10) ** -36

#: Turns of a cycle that are this short are summed as a geometric series: their ratio still changes
#: by about as much from turn to turn, so that the sum is off by about the square of this.
SHORT = mpf(10) ** -9

#: Extrapolated midpoint rules: steps of each row. Eight rows are of order 16.
ROWS = range(2, 18, 2)

State = list[Any]


def keep(t: Any, x: State) -> State:
    """The reset that changes nothing."""
    return x


@dataclass(frozen=True)
class Edge:
    """A jump, where ``guard(t, x)`` reaches zero from above, or is found below it.

    Attributes
    ----------
    either : bool
        From below as well.
    silent : bool
        Only the formula of the flow changes there: no jump is listed.
    """

    name: str
    to: str
    guard: Callable[[Any, State], Any]
    reset: Callable[[Any, State], State] = keep
    either: bool = False
    silent: bool = False


@dataclass(frozen=True)
class Mode:
    """How the state moves, and what ends that.

    Attributes
    ----------
    flow : callable ``(t, x)``
        The derivative: integrated in small steps.
    motion : callable ``(t0, x0, t)``
        Its closed form, used where it is given.
    """

    edges: Sequence[Edge] = ()
    flow: Callable[[Any, State], State] | None = None
    motion: Callable[[Any, State, Any], State] | None = None


@dataclass(frozen=True)
class Cycle:
    """Edges whose turns may shrink to a limit, and what follows it.

    ``to`` names the mode that follows each in which the last jump may end; ``settle(t, x)`` puts
    the state there onto its limit.
    """

    edges: tuple[str, ...]
    to: dict[str, str]
    settle: Callable[[Any, State], State] = keep


@dataclass
class Outcome:
    """What happened.

    Attributes
    ----------
    jumps : list of (t, edge, before, after)
    limits : list of (t, x)
        Where jumps accumulate.
    nearest : number
        The smallest positive minimum of a guard.
    """

    t: Any
    x: State
    mode: str
    jumps: list[tuple[Any, str, State, State]] = field(default_factory=list)
    limits: list[tuple[Any, State]] = field(default_factory=list)
    nearest: Any = mp.inf


def simulate(
    modes: dict[str, Mode],
    mode: str,
    x: Sequence[float],
    span: tuple[float, float],
    sample: float,
    cycles: Sequence[Cycle] = (),
) -> Outcome:
    """Run a scene; guards are sampled each ``sample``, which must resolve them."""
    with mp.workdps(DIGITS):
        out = Outcome(mpf(span[0]), [mpf(v) for v in x], mode)
        used = ""
        while out.t < span[1]:
            here = modes[out.mode]
            path = _Path(here, out.t, out.x, mpf(sample))
            edge, s = _first(here.edges, path, mpf(span[1]) - out.t, used, out)
            before, out.t = path(s), out.t + s
            out.x = before
            if edge is None:
                break
            out.x, out.mode, used = edge.reset(out.t, before), edge.to, edge.name
            if edge.silent:
                continue
            out.jumps.append((out.t, edge.name, before, out.x))
            if _pass_limit(out, cycles):
                used = ""
        return out


class _Path:
    """The state along an arc as a function of the time in it."""

    def __init__(self, mode: Mode, t: Any, x: State, step: Any) -> None:
        self.mode, self.t, self.x, self.step = mode, t, x, step
        self.known = [x]

    def __call__(self, s: Any) -> State:
        if self.mode.motion is not None:
            return self.mode.motion(self.t, self.x, self.t + s)
        k = int(s / self.step)
        while len(self.known) <= k:
            last = len(self.known) - 1
            self.known.append(self._go(self.t + last * self.step, self.known[last], self.step))
        return self._go(self.t + k * self.step, self.known[k], s - k * self.step)

    def _go(self, t: Any, x: State, h: Any) -> State:
        """One step: the midpoint rule with 2, 4, 6, ... parts, extrapolated to no length."""
        if h == 0:
            return x
        row: list[State] = []
        for j, n in enumerate(ROWS):
            new = [_midpoint(self.mode.flow, t, x, h, n)]
            for k in range(j):
                share = 1 / ((mpf(n) / ROWS[j - k - 1]) ** 2 - 1)
                new.append(
                    [a + (a - b) * share for a, b in zip(new[k], row[k], strict=True)],
                )
            row = new
        return row[-1]


def _midpoint(flow: Any, t: Any, x: State, h: Any, n: int) -> State:
    """Gragg's midpoint rule, whose error has even powers of the part ``h / n`` only."""
    part = h / n
    old, new = x, [a + part * d for a, d in zip(x, flow(t, x), strict=True)]
    for i in range(1, n):
        slope = flow(t + i * part, new)
        old, new = new, [a + 2 * part * d for a, d in zip(old, slope, strict=True)]
    slope = flow(t + h, new)
    return [(a + b + part * d) / 2 for a, b, d in zip(old, new, slope, strict=True)]


def _first(
    edges: Sequence[Edge], path: _Path, length: Any, used: str, out: Outcome
) -> tuple[Edge | None, Any]:
    """The edge that fires first and when; where none does, None and the length."""

    def along(edge: Edge) -> Any:
        return lambda s: edge.guard(path.t + s, path(s))

    functions = [along(edge) for edge in edges]
    rows = [[(mpf(0), g(mpf(0)))] for g in functions]
    for edge, g, row in zip(edges, functions, rows, strict=True):
        if abs(row[0][1]) <= ZERO and not edge.either:
            begins = _leaves_zero(g, min(path.step, length))
            if begins is None and edge.name != used:
                return edge, mpf(0)
            row[:] = [begins] if begins is not None else row
        elif row[0][1] < 0 and not edge.either:
            return edge, mpf(0)
    at = mpf(0)
    while at < length:
        at = min(at + path.step, length)
        found = []
        for edge, g, row in zip(edges, functions, rows, strict=True):
            if row[-1][0] < at:
                row.append((at, g(at)))
            (a, before), (b, after) = row[-2:] if len(row) > 1 else row * 2
            falls, rises = before > ZERO >= after, edge.either and before < -ZERO <= after
            if falls or rises:
                found.append((zero(g, a, before, b, after), edge))
            out.nearest = min(out.nearest, _lowest(row[-3:]))
        if found:
            s, edge = min(found, key=lambda pair: pair[0])  # of equal times the first declared
            return edge, s
    return None, length


def _leaves_zero(g: Any, s: Any) -> tuple[Any, Any] | None:
    """A time after which a guard, zero at first, is above zero, with its value; None: it is not."""
    for _ in range(60):
        value = g(s)
        if value > 0:
            return s, value
        s /= 2
    return None


def _lowest(row: list[tuple[Any, Any]]) -> Any:
    """The minimum of the parabola through three samples, where it lies between them."""
    if len(row) < 3 or not 0 < row[1][1] <= min(row[0][1], row[2][1]):
        return mp.inf
    (a, u), (b, v), (c, w) = row
    first, second = (v - u) / (b - a), (w - v) / (c - b)
    bend = (second - first) / (c - a)
    slope = first + bend * (b - a)
    return v - slope**2 / (4 * bend) if bend > 0 else v


def zero(g: Any, a: Any, u: Any, b: Any, v: Any) -> Any:
    """A zero of ``g`` between ``a`` and ``b``, where it is ``u`` and ``v``, of different sign.

    False position, with the weight of an end that stays halved (Illinois), until the bracket has
    no length or the guard is rounding.
    """
    while abs(v) > FOUND and abs(b - a) > FOUND * abs(b):
        c = b - v * (b - a) / (v - u)
        w = g(c)
        if (w < 0) == (v < 0):
            u /= 2
        else:
            a, u = b, v
        b, v = c, w
    return b


def _pass_limit(out: Outcome, cycles: Sequence[Cycle]) -> bool:
    """Where the turns of a cycle have become short: to its limit, by a geometric series."""
    for cycle in cycles:
        size = len(cycle.edges)
        last = out.jumps[-3 * size - 1 :]
        names = [name for _, name, _, _ in last[1:]]
        if len(last) <= 3 * size or names != list(cycle.edges) * 3:
            continue
        times = [t for t, *_ in last][::size]
        turns = [after - before for before, after in pairwise(times)]
        ratio = turns[2] / turns[1]
        if not (turns[2] < SHORT and turns[2] < turns[1] < turns[0]):
            continue
        out.t += turns[2] * ratio / (1 - ratio)
        out.x, out.mode = cycle.settle(out.t, out.x), cycle.to[out.mode]
        out.limits.append((out.t, out.x))
        return True
    return False
