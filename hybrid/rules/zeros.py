"""Zeros of a polynomial: all that cross, those that touch, the first, the turning points.

The sign changes of its Bernstein coefficients bound the number of zeros in (0, 1) from above, and
differ from it by an even number (Descartes): none means no zero, one means exactly one, which
Newton's method finds within a bracket; where there are more, both halves are looked at, from an
explicit stack. A half has no more sign changes than the whole, in floating point as well, and the
signs at its ends are those of the whole: crossings are never lost or doubled but in pairs.

``work`` has ``degree + SPARE_ROWS`` rows and ``degree + 5`` columns, ``found`` two columns (a
point, and 1 where the polynomial rises there, -1 where it falls, 0 where it touches zero) and
``2 degree + 4`` rows. Nothing need be in them.
"""

from __future__ import annotations

import math

from .arrays import Floats, Matrix
from .polynomials import (
    bernstein_value,
    from_powers,
    halve,
    newton,
    power_bound,
    power_value,
    weigh,
)

__all__ = ("crossings", "first", "series", "turns")

#: Status codes: a coefficient is not finite; the work array is too small; all are zero.
UNFIT, WORK_FULL, VANISHES = -1, -2, -3

#: Rows of the work array: the polynomial, one to reckon in, and from here on the stack. On it lie
#: parts with a sign change each, or with a zero exactly at their start: no more than the degree.
STACK, SPARE_ROWS = 2, 8

#: Steps of Newton's method after which the bracket is halved every second time, and most steps:
#: a bracket from 0 to 1 has an exponent after 11 halvings, and 53 digits after 53 more.
NEWTON_PATIENCE, ZERO_STEPS = 8, 160

#: A tolerance for touching that nothing meets.
NEVER = -1.0

#: Two neighbouring floats, relative to them; the smallest normal float.
EPS, SMALLEST_NORMAL = 2.0**-52, 2.0**-1022

#: Sizes beyond which a polynomial is scaled (by a power of two), so that binomials fit.
SCALED_ABOVE, SCALED_BELOW = 2.0**900, 2.0**-900

#: A zero in Bernstein's form, improved by one step in powers, moves by rounding only; and what a
#: step of Newton's method, by which it moves so little, leaves of it is less than that.
POLISH = 1e-8

#: So far is looked whether a series crosses zero where its first two terms say.
FURTHER = 1.5


def crossings(
    b: Floats, degree: int, order: int, tolerance: float, work: Matrix, found: Matrix
) -> int:
    """All zeros in (0, 1] of a polynomial in Bernstein's form, in order.

    A zero at the right end counts as reached, from the sign before it. Where the polynomial does
    not vanish at 0 by construction (``order`` 0), turning points no further than ``tolerance``
    from zero, seen from the side on which it stays, are listed as touching.

    Parameters
    ----------
    order : int
        The power of the variable by which it vanishes at 0; it is divided out, untested.

    Returns
    -------
    int
        How many, or a status code.
    """
    scale = prepared(b, degree, order, work)
    if scale <= 0.0:
        return int(scale)
    return every(work, degree - order, tolerance * scale if order == 0 else NEVER, found)


def turns(b: Floats, degree: int, work: Matrix, found: Matrix) -> int:
    """Where in (0, 1) a polynomial in Bernstein's form turns: 1 at a minimum, -1 at a maximum."""
    scale = prepared(b, degree, 0, work)
    if scale <= 0.0:
        return int(scale)
    return turning(work, degree, found, 0)


def series(
    c: Floats,
    degree: int,
    reach: float,
    order: int,
    tolerance: float,
    work: Matrix,
    found: Matrix,
) -> int:
    """All zeros in ``(0, reach]`` of the sum of ``c[k] s^k``, in order, as :func:`crossings`.

    Parameters
    ----------
    reach : float
        May be infinite: no zero is further than a bound that the coefficients give.
    order : int
        The power by which it vanishes at 0; what is below is not looked at.
    tolerance : float
        As in :func:`crossings`; below zero nothing is listed as touching.
    """
    last = last_power(c, order, degree)
    if last < order:
        return last
    n = last - order
    if outweighs(c, order, last, reach, tolerance):
        return 0
    if not from_powers(c, order, last, reach, work, 0):
        reach = min(reach, power_bound(c, order, last))
        if not from_powers(c, order, last, reach, work, 0):
            return UNFIT
    count = every(work, n, tolerance if order == 0 else NEVER, found)
    for k in range(count):
        s = reach * found[k, 0]
        crosses = found[k, 0] < 1.0 and found[k, 1] != 0.0
        found[k, 0] = polished(c, order, last, s, reach) if crosses else s
    return count


def first(
    c: Floats,
    degree: int,
    reach: float,
    order: int,
    direction: int,
    noise: float,
    work: Matrix,
    found: Matrix,
) -> float:
    """The first zero in ``(0, reach]`` of the sum of ``c[k] s^k``; infinity if there is none.

    Parameters
    ----------
    direction : int
        1 for one that it rises through, -1 to fall, 0 for either.
    noise : float
        Rounding of the terms, in spacings: zeros behind which it goes no further are left out.

    Returns
    -------
    float
        NaN where a coefficient or the work array is unfit.
    """
    count = series(c, degree, reach, order, NEVER, work, found)
    if count < 0:
        return math.inf if count == VANISHES else math.nan
    for k in range(count):
        if direction * found[k, 1] >= 0.0 and passes(c, order, degree, found[k, 0], noise):
            return found[k, 0]
    return math.inf


# ---------------------------------------------------------------------------------------
# preparing


def prepared(b: Floats, degree: int, order: int, work: Matrix) -> float:
    """Copy a polynomial, divided by a power of the variable; its scale, or a status code."""
    largest = 0.0
    for k in range(degree + 1):
        if not math.isfinite(b[k]):
            return UNFIT
        if k >= order:
            largest = max(largest, abs(b[k]))
    if largest == 0.0:
        return VANISHES
    scale = 2.0**-200 if largest > SCALED_ABOVE else 2.0**200 if largest < SCALED_BELOW else 1.0
    for k in range(degree - order + 1):
        value = b[k + order] * scale
        for j in range(order):
            value = value * (degree - j) / (k + order - j)
        work[0, k] = value
    return scale


def last_power(c: Floats, low: int, degree: int) -> int:
    """The last coefficient that is not zero, or a status code."""
    last = VANISHES
    for k in range(low, degree + 1):
        if not math.isfinite(c[k]):
            return UNFIT
        if c[k] != 0.0:
            last = k
    return last


def outweighs(c: Floats, low: int, degree: int, reach: float, tolerance: float) -> bool:
    """Whether the first three terms stay further from zero than all others go, as far as
    ``reach``: the cheapest test."""
    rest = abs(c[degree]) if degree > low + 2 else 0.0
    for k in range(degree - 1, low + 2, -1):
        rest = rest * reach + abs(c[k])
    side = 1.0 if c[low] > 0.0 else -1.0
    one = side * c[low + 1] * reach if degree > low else 0.0
    two = side * c[low + 2] * reach * reach if degree > low + 1 else 0.0
    rest = rest * reach * reach * reach if degree > low + 2 else 0.0
    drop = min(0.0, one + two)
    if 0.0 < -one < 2.0 * two:
        drop = -0.25 * one * one / two
    rounding = 64.0 * EPS * (abs(c[low]) + abs(one) + abs(two) + rest)
    return abs(c[low]) + drop > rest + rounding + max(tolerance, 0.0)


def soon(c: Floats, low: int, degree: int, reach: float) -> float:
    """The first zero in ``(0, reach]`` of the sum of ``c[low + k] s^k``, where the first two terms
    show it: the sum crosses zero half as far again as they say, and only rises or falls till then.

    Infinity if they do not show it. It may be another than :func:`series` finds, by rounding: where
    a kink is zero with a guard both are found in one way.
    """
    if degree == low or not c[low] * c[low + 1] < 0.0:
        return math.inf
    s = -c[low] / c[low + 1]
    high = min(reach, FURTHER * s)
    slope, size = 0.0, 0.0
    for k in range(degree, low + 1, -1):
        slope = (slope + (k - low) * abs(c[k])) * high
        size = (size + abs(c[k])) * high
    size = abs(c[low]) + (size + abs(c[low + 1])) * high
    end, _ = power_value(c, low, degree, high)
    crosses = end * c[low] < 0.0 and abs(end) > 64.0 * EPS * size
    if not (crosses and abs(c[low + 1]) > slope * (1.0 + 64.0 * EPS)):
        return math.inf
    before = 0.0
    for _ in range(ZERO_STEPS):
        if not before < s < high:
            s = 0.5 * (before + high)
        value, slope = power_value(c, low, degree, s)
        new = s - value / slope
        if abs(new - s) <= POLISH * s and new <= reach:
            return new
        if value * c[low] > 0.0:
            before = s
        else:
            high = s
        s = new
    return math.inf


def stays_away(work: Matrix, row: int, n: int, tolerance: float) -> bool:
    """Whether all coefficients are on one side of zero, and further than a tolerance."""
    low = work[row, 0]
    high = low
    for k in range(1, n + 1):
        low = min(low, work[row, k])
        high = max(high, work[row, k])
    return low > max(tolerance, 0.0) or high < -max(tolerance, 0.0)


def whole(work: Matrix, n: int) -> None:
    """Say that what lies on the stack is all of [0, 1]: its start, width, and the sign before."""
    work[STACK, n + 1] = 0.0
    work[STACK, n + 2] = 1.0
    work[STACK, n + 3] = 0.0


# ---------------------------------------------------------------------------------------
# isolating


def every(work: Matrix, n: int, tolerance: float, found: Matrix) -> int:
    """Zeros in (0, 1] of the polynomial in the first row, and where it touches zero."""
    if stays_away(work, 0, n, tolerance):
        return 0
    for k in range(n + 1):
        work[STACK, k] = work[0, k]
    whole(work, n)
    count = isolate(work, n, found, 0)
    return touches(work, n, tolerance, found, count) if count >= 0 and tolerance >= 0.0 else count


def isolate(work: Matrix, n: int, found: Matrix, count: int) -> int:
    """Crossings of what lies on the stack, behind those found; how many there are then."""
    top = STACK
    while top >= STACK:
        changes, sign, last = signs(work, top, n)
        left = work[top, n + 1]
        middle = left + 0.5 * work[top, n + 2]
        right = left + work[top, n + 2]
        if changes >= 2 and left < middle < right:
            if top + 1 >= work.shape[0]:
                return WORK_FULL
            top = split(work, top, n, middle)
            continue
        if work[top, 0] == 0.0 and work[top, n + 3] * sign < 0.0:
            count = noted(found, count, left, sign)
        if changes >= 2 and sign != last:
            count = noted(found, count, middle, last)
        if changes == 1:
            s = one_zero(work, top, n, last)
            count = noted(found, count, left + work[top, n + 2] * s, last)
        if right == 1.0 and work[top, n] == 0.0 and last != 0.0:
            count = noted(found, count, 1.0, -last)
        top -= 1
    return count


def signs(work: Matrix, row: int, n: int) -> tuple[int, float, float]:
    """Sign changes of coefficients, zeros left out; the first and the last sign (0: none)."""
    count = 0
    sign = 0.0
    last = 0.0
    for k in range(n + 1):
        value = work[row, k]
        if value != 0.0:
            now = 1.0 if value > 0.0 else -1.0
            if last == 0.0:
                sign = now
            elif now != last:
                count += 1
            last = now
    return count, sign, last


def split(work: Matrix, top: int, n: int, middle: float) -> int:
    """Put the halves of the topmost part in its place, the left one on top; the new top.

    A right half without a zero is dropped: so the stack stays low.
    """
    left = work[top, n + 1]
    width = 0.5 * work[top, n + 2]
    before = work[top, n + 3]
    halve(work, top, n)
    _, _, last = signs(work, top + 1, n)
    work[top, n + 1] = middle
    work[top, n + 2] = width
    work[top, n + 3] = last if last != 0.0 else before
    changes, _, _ = signs(work, top, n)
    at_end = middle + width == 1.0 and work[top, n] == 0.0
    if changes > 0 or work[top, 0] == 0.0 or at_end:
        top += 1
    else:
        for k in range(n + 1):
            work[top, k] = work[top + 1, k]
    work[top, n + 1] = left
    work[top, n + 2] = width
    work[top, n + 3] = before
    return top


def noted(found: Matrix, count: int, point: float, sign: float) -> int:
    """List a zero."""
    if count >= found.shape[0]:
        return count
    found[count, 0] = point
    found[count, 1] = sign
    return count + 1


def one_zero(work: Matrix, row: int, n: int, last: float) -> float:
    """The zero in (0, 1) of a polynomial with exactly one sign change, to relative accuracy."""
    degree = weigh(work, row, n, 1)
    low = 0.0
    high = 1.0
    s = of_polygon(work, row, n)
    for step in range(ZERO_STEPS):
        if not low < s < high or (step >= NEWTON_PATIENCE and step % 2 == 0):
            s = between(low, high)
        value, new = newton(work, 1, degree, s)
        if value == 0.0 or not low < s < high:
            return s
        if value * last > 0.0:
            high = s
        else:
            low = s
        if abs(new - s) <= EPS * s and low <= new <= high:
            return new
        if high - low <= EPS * high:
            return s
        s = new
    return s


def of_polygon(work: Matrix, row: int, n: int) -> float:
    """Where the polygon of the coefficients changes its sign."""
    before = 0
    for k in range(1, n + 1):
        if work[row, k] != 0.0:
            product = (1.0 if work[row, k] > 0.0 else -1.0) * work[row, before]
            if product < 0.0:
                share = work[row, before] / (work[row, before] - work[row, k])
                return (before + share * (k - before)) / n
            before = k
    return 0.5


def between(low: float, high: float) -> float:
    """The middle of a bracket: of the exponents, where they differ."""
    if high > 4.0 * low:
        return math.sqrt(max(low, SMALLEST_NORMAL)) * math.sqrt(high)
    return 0.5 * (low + high)


def polished(c: Floats, low: int, degree: int, s: float, reach: float) -> float:
    """A zero after one more step of Newton's method, in powers."""
    value, slope = power_value(c, low, degree, s)
    if slope == 0.0:
        return s
    new = s - value / slope
    return new if abs(new - s) <= POLISH * s and new <= reach else s


def passes(c: Floats, low: int, degree: int, s: float, noise: float) -> bool:
    """Whether a series goes beyond a zero by more than the rounding of its terms there."""
    value = 0.0
    slope = 0.0
    bend = 0.0
    size = 0.0
    for k in range(degree, low - 1, -1):
        bend = bend * s + slope
        slope = slope * s + value
        value = value * s + c[k]
        size = size * s + abs(c[k])
    return noise == 0.0 or abs(slope) > 2.0 * math.sqrt(abs(bend)) * math.sqrt(noise * EPS * size)


# ---------------------------------------------------------------------------------------
# turning points


def turning(work: Matrix, n: int, found: Matrix, count: int) -> int:
    """Zeros in (0, 1) of the slope, behind those found; how many there are then."""
    for k in range(n):
        work[STACK, k] = work[0, k + 1] - work[0, k]
    if n < 1:
        return count
    whole(work, n - 1)
    total = isolate(work, n - 1, found, count)
    if total > count and found[total - 1, 0] == 1.0:
        total -= 1
    return total


def touches(work: Matrix, n: int, tolerance: float, found: Matrix, count: int) -> int:
    """Turning points within a tolerance of zero, put in order among the crossings.

    Of those towards zero from the side on which the polynomial is by the crossings that were
    found: rounding may have put a double zero on the other side.
    """
    _, start, _ = signs(work, 0, n)
    total = turning(work, n, found, count)
    kept = count
    for j in range(count, total):
        point = found[j, 0]
        bend = found[j, 1]
        k = kept
        side = start
        for i in range(kept):
            if found[i, 0] > point:
                k = min(k, i)
            elif found[i, 1] != 0.0:
                side = found[i, 1]
        if side * bend > 0.0 and abs(bernstein_value(work, 0, n, point, 1)) <= tolerance:
            for i in range(kept, k, -1):
                found[i, 0] = found[i - 1, 0]
                found[i, 1] = found[i - 1, 1]
            found[k, 0] = point
            found[k, 1] = 0.0
            kept += 1
    return kept if total >= 0 else total
