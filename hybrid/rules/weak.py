"""A step over a place where the flow is continuous but has no Taylor series.

Such is ``|v|^1.5`` where ``v`` is zero: its series beside that place reach no further than to it,
and there are none on it. The rates change by so little around it that a polynomial of the second
degree follows the flow to rounding, for a short time. Its bend is that of a chord of the flow. Its
slopes are compared with the flow; where that jumps it cannot succeed.
"""

from __future__ import annotations

import math

from .arrays import Floats, Ints, Matrix, Programs
from .checks import (
    HELD_INSIDE,
    MISSED,
    ROUNDING_BESIDE,
    SMALLEST,
    along,
    beside,
    decided,
    led,
    look,
    place,
    rate_of,
)
from .jets import KINKS, OUTPUT, jets
from .kinks import KINK_ROW, SWITCHES, ZERO_SPACINGS, count, states
from .lengths import LAST_TERMS, LOW_ORDER, SHORTEST_STEP, own_length
from .polynomials import power_size, power_value
from .zeros import EPS

__all__ = ("few_terms", "forget", "stands", "steady", "weak_step")

#: The degree of the polynomials.
FEW = 2

#: The share of the length at which a step follows the flow to many roundings that is taken, so that
#: it loses few: what it loses grows by the length to the power 1.5 at least.
SHARE_TAKEN = 1.0 / 8.0

#: Passes in which the bend and the end of the step are found.
BEND_PASSES = 3

#: Roundings of a rate that count as none.
STEADY = 8.0

#: How far beside a state that does not move it is looked whether the flow leads back, relative to
#: the largest; how many times as far the way back may lead; and steps along it, each so large a
#: share of what is left of it.
OFF_REST, WAY_BACK, BACK_STEPS, BACK_SHARE = 1e-8, 1e4, 400, 0.25

#: Beside a jump the rates are as large so many times as far from it: a flow that goes with a power
#: of the distance has smaller ones, by more than the second number.
FURTHER_OFF, FADES = 16.0, 0.9

#: A share of a step at which the rates have changed by half as much as at its end, at most, or the
#: flow jumps: if they change by a root of the time it is a quarter.
NEAR_START = 1.0 / 16.0


def reach(
    p: Programs, program: int, t: float, x: Floats, sides: Ints, c: Matrix, work: Floats
) -> float:
    """How far series of a low order from ``(t, x)`` reach; 0 if there are none."""
    order, length = min(LOW_ORDER, c.shape[1] - 1), math.inf
    if jets(p, program, order, t, x, sides, c, work) < 0:
        return 0.0
    for i in range(x.shape[0]):
        if not math.isfinite(c[i, order]):
            return 0.0
        length = min(length, own_length(c[i, : order + 1], LAST_TERMS))
    return length


def few_terms(
    p: Programs, program: int, t: float, x: Floats, sides: Ints, c: Matrix, work: Floats
) -> bool:
    """The coefficients from ``(t, x)`` that exist up to order 2, as series that end with them;
    returns False if a state has none of order 1, or a requested function no value.

    Kinks are decided by their values: rounding may have put the state before one that is passed.
    """
    kinks = count(p, program)
    known = work[work.shape[0] - kinks :]
    for i in range(kinks):
        known[i], sides[i] = sides[i], 0
    jets(p, program, FEW, t, x, sides, c, work)
    for i in range(kinks):
        sides[i] = int(known[i]) if known[i] != 0.0 else sides[i]
    fit = True
    for i in range(states(p, program)):
        fit = fit and math.isfinite(c[i, 0]) and math.isfinite(c[i, 1])
    for j in range(p.index[program, OUTPUT], p.index[program, OUTPUT + 1]):
        fit = fit and math.isfinite(c[p.output[j], 0])
    for row in range(c.shape[0]):
        for k in range(1, c.shape[1]):
            c[row, k] = c[row, k] if k <= FEW and math.isfinite(c[row, k]) else 0.0
    return fit


def weak_step(
    p: Programs,
    program: int,
    held: bool,
    t: float,
    tau: float,
    x: Floats,
    most: float,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> float:
    """The length of a step by few terms, at most ``most``; arguments as :func:`.steps.step`. It is
    0 where there is none that is longer than one by series of a low order. A state that moves must
    come to where there are series: ``x' = sqrt(x)`` does not say when it leaves zero.

    Where rounding has put the state where the flow has no value, it starts a few roundings of the
    time later.
    """
    first, n = place(p, program, work), x.shape[0]
    point = work[first : first + n]
    for i in range(n):
        point[i] = x[i]
    forget(sides)
    least = max(reach(p, program, t, point, sides, c, work), SHORTEST_STEP)
    forget(sides)
    fit = few_terms(p, program, t, point, sides, c, work)
    if not fit:
        later = ZERO_SPACINGS * EPS * max(abs(t), tau)
        led(p, program, t, x, later, point, sides, aside, work)
        t += later
        fit = few_terms(p, program, t, point, sides, c, work)
    h = most if fit else 0.0
    while h > least and not (
        _bent(p, program, t, h, sides, c, aside, work)
        and _functions_follow(p, program, t, h, sides, c, aside, work)
        and _rates_follow(p, program, t, tau, h, sides, c, aside, work)
        and decided(p, program, t, h, False, sides, c, aside, work, point)
    ):
        h = 0.5 * h if tau + 0.5 * h > tau else 0.0
    if 0.0 < h < most:
        h = (tau + SHARE_TAKEN * h) - tau
    rests = h == most and (held or stays(p, program, t, sides, c, aside, work))
    if h > least and (rests or _leads_out(p, program, t, h, sides, c, aside, work)):
        return h
    return 0.0


def _bent(
    p: Programs,
    program: int,
    t: float,
    h: float,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Bend the polynomials so that they end as the flow does, and those of functions as these;
    returns whether the rates change little near the start."""
    n = states(p, program)
    for i in range(n):
        c[i, 2] = 0.0
    for _ in range(BEND_PASSES):
        at(p, program, t, h, sides, c, aside, work)
        for i in range(n):
            c[i, 2] = 0.5 * (rate_of(p, program, i, aside, 0) - c[i, 1]) / h
    at(p, program, t, h, sides, c, aside, work)
    for row in range(n + 1, c.shape[0]):
        bend = ((aside[row, 0] - c[row, 0]) / h - c[row, 1]) / h
        c[row, 2] = bend if math.isfinite(bend) else 0.0
    at(p, program, t, NEAR_START * h, sides, c, aside, work)
    for i in range(n):
        change = abs(rate_of(p, program, i, aside, 0) - c[i, 1])
        if not change <= abs(c[i, 2] * h) + MISSED * EPS * abs(c[i, 1]):
            return False
    return True


def _rates_follow(
    p: Programs,
    program: int,
    t: float,
    tau: float,
    h: float,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Whether what the slopes are off, inside, at the end and on each side of a kink, shows in no
    state: each is measured by itself, by how far its rate has led since the arc began, and by the
    largest."""
    if not _rate_follows(p, program, t, tau, h, HELD_INSIDE * h, sides, c, aside, work):
        return False
    if not _rate_follows(p, program, t, tau, h, h, sides, c, aside, work):
        return False
    for kink in range(p.index[program, KINKS], p.index[program, KINKS + 1]):
        if p.kinks[kink, SWITCHES] == 1:
            for s in _sides_seen(c[p.kinks[kink, KINK_ROW]], h):
                if s < h and not _rate_follows(p, program, t, tau, h, s, sides, c, aside, work):
                    return False
    return True


def _sides_seen(series: Floats, h: float) -> tuple[float, float]:
    """Where a kink turns back by its polynomial, and a place before its first zero; the end of the
    step where there is none. Before the first zero, and between two, the flow has a formula of
    which the end of the step may know nothing."""
    off, rate, bend = series[0], series[1], series[2]
    turns, zero = h, h
    if rate * bend < 0.0:
        turns = min(-0.5 * rate / bend, h)
    square = rate * rate - 4.0 * off * bend
    if square >= 0.0:
        root = -0.5 * (rate + math.copysign(math.sqrt(square), rate))
        if off * root > 0.0:
            zero = min(zero, off / root)
        if root * bend > 0.0:
            zero = min(zero, root / bend)
    return turns, HELD_INSIDE * zero if zero < h else h


def _rate_follows(
    p: Programs,
    program: int,
    t: float,
    tau: float,
    h: float,
    s: float,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Whether what the slopes are off at a place shows in no state at the end."""
    largest = 0.0
    for i in range(states(p, program)):
        largest = max(largest, abs(c[i, 0]))
    at(p, program, t, s, sides, c, aside, work)
    for i in range(states(p, program)):
        _, slope = power_value(c[i], 0, FEW, s)
        off = abs(rate_of(p, program, i, aside, 0) - slope) * h
        size = max(abs(c[i, 0]), abs(c[i, 1]) * (tau + h), SMALLEST * largest)
        if not off <= MISSED * EPS * size:
            return False
    return True


def steady(
    p: Programs,
    program: int,
    t: float,
    h: float,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Whether the rates of polynomials of few terms, as they are, are those of the flow, each to a
    few of its own roundings: so low is a flight that what has no series does not show in it."""
    for share in (0.5, 1.0):
        at(p, program, t, share * h, sides, c, aside, work)
        for i in range(states(p, program)):
            _, slope = power_value(c[i], 0, FEW, share * h)
            off, most = abs(rate_of(p, program, i, aside, 0) - slope), max(abs(slope), abs(c[i, 1]))
            if not off <= STEADY * EPS * most:
                return False
    return True


def at(
    p: Programs,
    program: int,
    t: float,
    s: float,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> None:
    """The flow and all functions on the polynomials."""
    first = place(p, program, work)
    point = work[first : first + states(p, program)]
    along(c, s, point)
    look(p, program, 0, t + s, point, False, sides, aside, work)


def _functions_follow(
    p: Programs,
    program: int,
    t: float,
    h: float,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Whether the requested functions have the values of their polynomials in the middle, up to
    rounding."""
    first = place(p, program, work)
    point, s = work[first : first + states(p, program)], 0.5 * h
    at(p, program, t, s, sides, c, aside, work)
    for j in range(p.index[program, OUTPUT], p.index[program, OUTPUT + 1]):
        aside[p.output[j], 1] = aside[p.output[j], 0]
    look(p, program, 0, beside(t + s, point), point, False, sides, aside, work)
    for j in range(p.index[program, OUTPUT], p.index[program, OUTPUT + 1]):
        row = p.output[j]
        off = abs(aside[row, 1] - power_value(c[row], 0, FEW, s)[0])
        allowed = MISSED * EPS * power_size(c[row], 0, FEW, s)
        if not off <= allowed + ROUNDING_BESIDE * abs(aside[row, 1] - aside[row, 0]):
            return False
    return True


def _leads_out(
    p: Programs,
    program: int,
    t: float,
    h: float,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Whether the flow has series again where a step ends: one that has none anywhere is refused,
    not followed in tiny steps. ``c`` is as it was before."""
    first, n = place(p, program, work), states(p, program)
    start, end = work[first - n : first], work[first : first + n]
    for i in range(n):
        start[i] = c[i, 0]
    along(c, h, end)
    forget(sides)
    fit = reach(p, program, t + h, end, sides, c, work) > 0.0
    forget(sides)
    few_terms(p, program, t, start, sides, c, work)
    _bent(p, program, t, h, sides, c, aside, work)
    forget(sides)
    return fit


def stands(
    p: Programs,
    program: int,
    t: float,
    x: Floats,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Whether a state stands still for good: the flow is zero there, and leads back from beside
    it."""
    forget(sides)
    fit = few_terms(p, program, t, x, sides, c, work)
    forget(sides)
    return fit and stays(p, program, t, sides, c, aside, work)


def stays(
    p: Programs, program: int, t: float, sides: Ints, c: Matrix, aside: Matrix, work: Floats
) -> bool:
    """Whether the state where polynomials of few terms begin does not move, and the flow leads back
    from beside it, as friction that goes with a root of the speed does. ``x' = sqrt(x)`` may leave
    zero at any time, what depends on the time may do so later, and beside a jump switching is
    declared."""
    n, size = states(p, program), 0.0
    if p.timed[program] == 1:
        return False
    for i in range(n):
        if c[i, 1] != 0.0 or c[i, 2] != 0.0:
            return False
        size = max(size, abs(c[i, 0]))
    off = OFF_REST * (size if size > 0.0 else 1.0)
    for i in range(n):
        for way in (-off, off):
            near = rates_off(p, program, t, i, way, sides, c, aside, work)
            far = rates_off(p, program, t, i, FURTHER_OFF * way, sides, c, aside, work)
            if not near <= FADES * far:
                return False
            if near > 0.0 and not returns(p, program, t, i, way, sides, c, aside, work):
                return False
    return True


def rates_off(
    p: Programs,
    program: int,
    t: float,
    i: int,
    way: float,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> float:
    """The largest of the rates where one element is off the state where polynomials begin, which is
    left in ``work``."""
    first, largest = place(p, program, work), 0.0
    for j in range(states(p, program)):
        work[first + j] = c[j, 0] + (way if j == i else 0.0)
    look(p, program, 0, t, work[first : first + states(p, program)], False, sides, aside, work)
    for j in range(states(p, program)):
        rate = abs(rate_of(p, program, j, aside, 0))
        if not rate <= largest:
            largest = rate
    return largest


def returns(
    p: Programs,
    program: int,
    t: float,
    i: int,
    way: float,
    sides: Ints,
    c: Matrix,
    aside: Matrix,
    work: Floats,
) -> bool:
    """Whether the flow from where one element is off a state ends no further off, by Euler's
    method in steps that shrink as the way back does."""
    first, n, off = place(p, program, work), states(p, program), abs(way)
    point, apart = work[first : first + n], off
    fastest = rates_off(p, program, t, i, way, sides, c, aside, work)
    for _ in range(BACK_STEPS):
        if fastest == 0.0:
            break
        for j in range(n):
            point[j] += BACK_SHARE * apart / fastest * rate_of(p, program, j, aside, 0)
        look(p, program, 0, t, point, False, sides, aside, work)
        fastest, apart = 0.0, 0.0
        for j in range(n):
            fastest = max(fastest, abs(rate_of(p, program, j, aside, 0)))
            apart = max(apart, abs(point[j] - c[j, 0]))
        if not apart <= WAY_BACK * off:
            return False
        if apart <= BACK_SHARE * off:
            break
    return apart <= off * (1.0 + BACK_SHARE)


def forget(sides: Ints) -> None:
    """Nothing is known of any kink."""
    for i in range(sides.shape[0]):
        sides[i] = 0
