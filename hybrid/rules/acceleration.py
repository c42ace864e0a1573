"""Limits of sequences by acceleration: Wynn's epsilon algorithm, Levin's transformation, and
Aitken's formula for a few terms.

Estimates are made from more and more terms. The change between the last of them bounds the error,
with what becomes of them without the last term, and if the terms move by their rounding. Weniger,
*Nonlinear sequence transformations*, Computer Physics Reports 10 (1989).
"""

from __future__ import annotations

import math

from .advance import GOLDEN
from .arrays import Floats, Matrix
from .linear import solve

__all__ = ("accelerated",)

#: Turns that establish a cycle, and turns needed if durations fall like a power of their number:
#: with no more than the first Aitken's formula is used, and the last of the second are Wynn's.
LEAST_CYCLES, POWER_CYCLES = 6, 48

#: Most terms of Levin's transformation, and the ratio of the indices of successive terms used.
TERMS, THIN = 12, 0.7

#: Safety factor on the change between the last estimates.
ESTIMATE_CAUTION = 8.0

#: Relative rounding of times and states.
CYCLE_ROUNDING = 4e-16

# Rows to work in: the sequence moved by its rounding; estimates and what they are off as the clock
# is, of both; the last two columns of Wynn's table; the indices of the terms used; equations, and
# their right sides.
(
    MOVED,
    VALUES,
    NOISES,
    OTHERS,
    OTHER_NOISES,
    BEFORE,
    NOW,
    TERM_PLACES,
    EQUATION_ROWS,
) = range(9)
RIGHT_ROWS = EQUATION_ROWS + TERMS + 1
WORK_ROWS, LEAST_COLUMNS = RIGHT_ROWS + TERMS + 1, POWER_CYCLES + 1


def accelerated(
    sequences: Matrix, clock: Matrix, closely: bool, work: Matrix, found: Matrix
) -> None:
    """Limits of sequences.

    Parameters
    ----------
    sequences : Matrix
        One in each row.
    clock : Matrix
        What the terms of a sequence count, and what that is off, if they fall like a power; no
        columns where their number serves.
    closely : bool
        Whether what estimates agree on is tried on other sequences, too.
    work : Matrix
        ``WORK_ROWS`` rows, ``LEAST_COLUMNS`` columns or one for each term and one more.
    found : Matrix
        Gets for each the limit, a bound on its error, and what of this is rounding by the clock.
    """
    for i in range(sequences.shape[0]):
        now, error, noise = (
            tried(sequences[i], clock, work)
            if closely
            else estimate(sequences[i], sequences[i], False, clock, work)
        )
        found[i, 0], found[i, 1], found[i, 2] = now, error, noise


def tried(sequence: Floats, clock: Matrix, work: Matrix) -> tuple[float, float, float]:
    """The limit of a sequence, a bound on its error, and what of this is rounding by the clock.

    Estimates may agree by chance. The bound is also that of what becomes of them without the last
    term, and if the terms move by their rounding, which estimates amplify; by a clock they tell
    what that makes of them.
    """
    n = sequence.shape[0]
    if n <= LEAST_CYCLES + 1:
        return estimate(sequence, sequence, False, clock, work)
    moves, moved = clock.shape[1] == 0, work[MOVED, :n]
    shake(sequence, moved)
    now, error, noise = estimate(sequence, moved, moves, clock, work)
    shorter, _, _ = estimate(sequence[: n - 1], moved[: n - 1], moves, clock, work)
    return now, max(error, abs(now - shorter)), noise


def shake(sequence: Floats, moved: Floats) -> None:
    """Move the terms of a sequence by half a spacing of its largest, to either side."""
    high = largest(sequence)
    spacing = math.nextafter(high, math.inf) - high
    for k in range(sequence.shape[0]):
        moved[k] = sequence[k] + (0.5 if (k * GOLDEN) % 1.0 < 0.5 else -0.5) * spacing


def largest(sequence: Floats) -> float:
    """The size of the largest term."""
    size = 0.0
    for k in range(sequence.shape[0]):
        size = max(size, abs(sequence[k]))
    return size


def estimate(
    sequence: Floats, moved: Floats, moves: bool, clock: Matrix, work: Matrix
) -> tuple[float, float, float]:
    """The limit of a sequence, how well the last estimates of it agree, with ``moves`` also with
    those of the sequence ``moved`` by its rounding, and what of this is rounding by the clock."""
    n = sequence.shape[0]
    if n <= LEAST_CYCLES:
        before, now = aitken(sequence[: n - 1], n - 1), aitken(sequence, n)
        return now, ESTIMATE_CAUTION * abs(now - before), 0.0
    best, error, noise = sequence[n - 1], math.inf, 0.0
    for way in range(2):
        if way == 0 and clock.shape[1] > 0:
            continue
        values, noises = work[VALUES], work[NOISES]
        count = table(way, sequence, clock, values, noises, work)
        others, common = values, count
        if moves:
            others = work[OTHERS]
            common = min(count, table(way, moved, clock, others, work[OTHER_NOISES], work))
        for k in range(2, common):
            one, two = abs(values[k - 1] - values[k - 2]), abs(values[k] - values[k - 1])
            apart = abs(values[k] - others[k])
            if one < math.inf and two < math.inf and apart < math.inf:
                off = ESTIMATE_CAUTION * max(one, max(two, apart)) + noises[k]
                if off < error:
                    best, error, noise = values[k], off, noises[k]
    return best, error, noise


def table(
    way: int, sequence: Floats, clock: Matrix, values: Floats, noises: Floats, work: Matrix
) -> int:
    """Estimates from more and more of a sequence by a transformation that may be exact, what they
    are off as the clock is, and how many there are."""
    if way == 0:
        return wynn(sequence[max(0, sequence.shape[0] - POWER_CYCLES) :], values, noises, work)
    return levin(sequence, clock, values, noises, work)


def aitken(sequence: Floats, n: int) -> float:
    """Aitken's formula on the last three terms: the limit of a geometric sequence."""
    end = sequence[n - 1]
    before, last = sequence[n - 2] - sequence[n - 3], end - sequence[n - 2]
    if abs(last) <= CYCLE_ROUNDING * n * abs(end):
        return end
    return end + last * ratio(last, before - last)


def ratio(a: float, b: float) -> float:
    """A quotient; infinite, or no number, where there is none."""
    return a / b if b != 0.0 else math.inf * a


def wynn(sequence: Floats, values: Floats, noises: Floats, work: Matrix) -> int:
    """Limits of a sequence by Wynn's epsilon algorithm: the last entry of each even column.

    It ends with a column that has come to rest: later ones would be made of its rounding.
    """
    n, before, now = sequence.shape[0], work[BEFORE], work[NOW]
    still = CYCLE_ROUNDING * n * largest(sequence)
    for k in range(n):
        now[k], before[k] = sequence[k], 0.0
    before[n], count = 0.0, 1
    values[0], noises[0] = sequence[n - 1], 0.0
    for column in range(1, n):
        last = n - column  # of the column before
        steps = abs(now[last] - now[last - 1])
        if last > 1:
            steps = max(steps, abs(now[last - 1] - now[last - 2]))
        if column % 2 == 1 and steps <= still:
            for _ in range(2):
                values[count], noises[count] = now[last], 0.0
                count += 1
            return count
        for k in range(last):
            before[k] = before[k + 1] + ratio(1.0, now[k + 1] - now[k])
        before, now = now, before
        if column % 2 == 0:
            values[count], noises[count] = now[last - 1], 0.0
            count += 1
    return count


def levin(sequence: Floats, clock: Matrix, values: Floats, noises: Floats, work: Matrix) -> int:
    """Limits of a sequence by Levin's transformation with increasing numbers of terms, and what
    they are off as the clock and the terms are.

    The remainder is modelled as ``z a`` times a polynomial in ``1/z``, with ``z`` the clock; the
    number of the term where there is none. The terms used have geometrically spaced indices;
    successive ones, as in Levin's u-transform, have the same limit but amplify rounding.
    """
    n, end = sequence.shape[0], sequence[sequence.shape[0] - 1]
    last, before = abs(end - sequence[n - 2]), abs(sequence[n - 2] - sequence[n - 3])
    if max(last, before) <= CYCLE_ROUNDING * n * largest(sequence):
        for k in range(3):
            values[k], noises[k] = end, 0.0
        return 3
    for k in range(n - 1):
        if sequence[k + 1] == sequence[k]:  # it has not fallen all along
            return 0
    timed, count = clock.shape[1] > 0, 0
    for k in range(1, TERMS + 1):
        found = places(n - 1, k, work[TERM_PLACES])
        if found <= k or work[TERM_PLACES, 0] < (2.0 if timed else 1.0):
            break
        rights = k + 2 if timed else 1
        equations(sequence, clock, k + 1, rights, work)
        if not solve(work[EQUATION_ROWS:RIGHT_ROWS], k + 1, work[RIGHT_ROWS:], rights):
            return 0  # the terms do not fall: no limit can be found
        values[count] = work[RIGHT_ROWS, 0]
        noises[count] = off(sequence, clock, k + 1, work) if timed else 0.0
        count += 1
    return count


def places(count: int, k: int, found: Floats) -> int:
    """Indices of terms, geometrically spaced up to the last of so many; returns how many differ."""
    size = 0
    for j in range(k, -1, -1):
        place = float(math.floor(count * THIN**j + 0.5))
        if size == 0 or place != found[size - 1]:
            found[size] = place
            size += 1
    return size


def model(
    sequence: Floats, clock: Matrix, work: Matrix, size: int, i: int
) -> tuple[float, float, float]:
    """Of one of the terms used: its clock, that of the last against it, and its size."""
    place, end = int(work[TERM_PLACES, i]), int(work[TERM_PLACES, size - 1])
    timed = clock.shape[1] > 0
    own = clock[0, place - 1] if timed else float(place)
    last = clock[0, end - 1] if timed else float(end)
    return own, ratio(last, own), sequence[place] - sequence[place - 1]


def equations(sequence: Floats, clock: Matrix, size: int, rights: int, work: Matrix) -> None:
    """Write down those of the limit and of the polynomial; behind their right side, unit vectors:
    the limit that each gives is the share that a term has in it."""
    for i in range(size):
        own, falls, term = model(sequence, clock, work, size, i)
        row, right, part = work[EQUATION_ROWS + i], work[RIGHT_ROWS + i], own * term
        row[0], right[0] = 1.0, sequence[int(work[TERM_PLACES, i])]
        for j in range(1, size):
            row[j] = part
            part *= falls
        for j in range(1, rights):
            right[j] = 1.0 if j == i + 1 else 0.0


def off(sequence: Floats, clock: Matrix, size: int, work: Matrix) -> float:
    """What the limit is off as the clock and the terms are, each by its share."""
    total, limit = 0.0, work[RIGHT_ROWS, 0]
    for i in range(size):
        _, falls, term = model(sequence, clock, work, size, i)
        place = int(work[TERM_PLACES, i])
        bends, part = 0.0, term
        for j in range(size - 1):
            bends += part * (1 - j) * work[RIGHT_ROWS + 1 + j, 0]
            part *= falls
        left = abs(sequence[place] - limit)
        known = CYCLE_ROUNDING * abs(sequence[place]) * (1.0 + 2.0 * left / abs(term))
        known += clock[1, place - 1] * abs(bends)
        total += (work[RIGHT_ROWS, 1 + i] * known) ** 2
    return math.sqrt(total)
