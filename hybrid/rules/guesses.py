"""Guesses of what a lag shorter than a step will see, and how long they may be."""

from __future__ import annotations

import math

from .arrays import PastArrays
from .places import (
    BREAKS,
    FINAL,
    GUESSES,
    MOST,
    PIECES_KEPT,
    PIECES_KNOWN,
    REST_OF_GUESSES,
    SHORTEST_LAG,
    STARTED,
    STRIDE,
    TIGHT,
    WINDOW_DEGREE,
)
from .record import (
    BEGIN,
    FROM,
    FROM_LOW,
    PIECE_HALF,
    PIECE_MIDDLE,
    UP_TO,
    allowed,
    at,
    following,
    next_break,
    slack,
)
from .sums import SMALLEST_DIVISOR

#: Numbers of a window's frame; columns of its row: where it begins and ends, how long the next may
#: be, and how long it was to be at first.
FRAME = 2
SINCE_PLACE, TO_PLACE, LONGEST, AIMED_LENGTH = range(4)

#: How far the last piece of a record may be extrapolated, relative to its length.
GOES_ON_FOR = 2.0

#: How far the piece of a guess reaches beyond it, in tolerances on equal times.
GUESS_MARGIN = 1e4

#: Windows without a guess after one that did not pay, which doubles each time up to a maximum; and
#: the number of guesses of one window up to which the next is longer.
GUESS_REST, LONGEST_REST, EASY = 30, 1 << 16, 2

#: Consecutive windows of one step before longer ones are guessed; the first length of these, in
#: lags; and where a lag vanishes, relative to the run, and the shortest, in tolerances on equal
#: times.
TIGHT_WINDOWS, FIRST_GUESS, VANISHING_WINDOW, GUESS_SPAN = 3, 4.0, 1e-4, 100.0


def wanted(t: float, past: PastArrays) -> None:
    """Find the length of windows to guess; 0 where the record reaches far enough."""
    floats, ints, shortest = past.floats, past.ints, math.inf
    for k in range(past.lags.shape[0]):
        shortest = min(shortest, past.lags[k])
    floats[SHORTEST_LAG] = shortest
    nothing = shortest <= slack(t)
    if not nothing and next_break(past, t - shortest, slack(t)) <= t:
        ints[TIGHT], floats[STRIDE] = 0, 0.0
        return
    if 0.0 < floats[STRIDE] <= shortest:
        ints[TIGHT], floats[STRIDE] = 0, 0.0
    if floats[STRIDE] == 0.0 and (nothing or ints[TIGHT] >= TIGHT_WINDOWS):
        least = VANISHING_WINDOW * (floats[FINAL] - floats[STARTED]) if nothing else 0.0
        floats[STRIDE] = max(FIRST_GUESS * shortest, least)
    if nothing:  # behind a flight that was shorter than any guess
        floats[STRIDE] = max(floats[STRIDE], GUESS_SPAN * slack(t))


def guess(t: float, b: float, past: PastArrays) -> None:
    """Write a piece of the record up to ``b``: the last piece continued, or a constant state.

    Far beyond its end a polynomial is useless; there the piece is a straight line.
    """
    n, place = past.own.shape[0], past.ints[PIECES_KNOWN]
    last, span, length = (
        past.spans[place - 1],
        past.spans[place],
        max(b - t, GUESS_MARGIN * slack(t)),
    )
    first = following(past, last[UP_TO] - slack(t), False)
    stops = past.degrees[place - 1] < 0
    if first < past.ints[BREAKS]:  # at the present: later ones are not known yet
        for i in range(n):
            stops = stops or past.orders[first, i] == 0
    on = b <= last[UP_TO] + GOES_ON_FOR * (last[UP_TO] - last[BEGIN])
    for c in range(BEGIN, PIECE_HALF + 1):
        span[c] = last[c]
    span[BEGIN], span[UP_TO] = t, t + length
    if not (on and not stops):
        span[FROM], span[FROM_LOW] = t, 0.0
        span[PIECE_MIDDLE], span[PIECE_HALF] = 0.5 * length, 0.5 * length
    past.degrees[place] = past.degrees[place - 1] if on and not stops else 1
    for i in range(n):
        row, known = past.rows[place * n + i], past.rows[(place - 1) * n + i]
        if on and not stops:
            for j in range(past.degrees[place] + 1):
                row[j] = known[j]
        else:
            rate = 0.0
            for j in range(1, 1 if stops else past.degrees[place - 1] + 1):
                rate += j * j * known[j] / last[PIECE_HALF]
            row[0], row[1] = past.present[i] + 0.5 * rate * length, 0.5 * rate * length
    past.ints[PIECES_KEPT] = place + 1


def wrong(t: float, past: PastArrays) -> float:
    """The error of guesses compared with what was flown, relative to the allowed one."""
    n, worst, first, end = past.own.shape[0], 0.0, past.ints[PIECES_KNOWN], past.ints[PIECES_KEPT]
    for k in range(past.lags.shape[0]):
        a, b = past.windows[k, SINCE_PLACE], past.windows[k, TO_PLACE]
        low, high = max(a, past.spans[first, BEGIN]), min(b, past.spans[end - 1, UP_TO])
        base, half = k * (FRAME + (WINDOW_DEGREE + 1) * n) + FRAME, 0.5 * (b - a)
        for i in range(n if beyond(t, a, b) and low < high else 0):
            if past.seen[k, i] == 1:
                change, size, least, most, piece = 0.0, 0.0, math.inf, -math.inf, first
                for j in range(WINDOW_DEGREE + 1):
                    since = (high - low) * past.nodes[j]
                    while piece + 1 < end and past.spans[piece + 1, BEGIN] - low <= since:
                        piece += 1
                    there = at(past, piece, i, low, since)
                    here = seen_at(past, base + i, (low - a) / half - 1.0, since / half)
                    apart = abs(there - here)
                    change = max(change, apart if apart == apart else math.inf)
                    size, least, most = max(size, abs(there)), min(least, there), max(most, there)
                noise = 0.5 * max(slack(t), slack(a)) / (high - low) * (most - least)
                worst = max(worst, change / (allowed(past, i, size) + noise + SMALLEST_DIVISOR))
    return worst


def beyond(t: float, a: float, b: float) -> bool:
    """Whether a window reaches beyond a time."""
    return b > t + slack(t) or t - a <= slack(t)


def pays(length: float, past: PastArrays) -> None:
    """Make longer guesses next if they were easy, and none for a while if they cost too much."""
    floats, ints = past.floats, past.ints
    floats[MOST] *= 1.2
    floats[STRIDE] = min((2.0 if ints[GUESSES] <= EASY else 1.0) * length, floats[MOST])
    if length < (1 + ints[GUESSES]) * floats[SHORTEST_LAG]:
        floats[STRIDE], ints[TIGHT] = 0.0, -ints[REST_OF_GUESSES]
        ints[REST_OF_GUESSES] = min(2 * ints[REST_OF_GUESSES], LONGEST_REST)
        floats[MOST] = math.inf
    else:
        ints[REST_OF_GUESSES] = GUESS_REST


def seen_at(past: PastArrays, base: int, s: float, since: float) -> float:
    """An element's value in a window, whose coefficients begin at ``base``, at ``since`` after
    ``s`` (counted from the middle, in half lengths of the window)."""
    n, there, value = past.own.shape[0], s + since, 0.0
    for j in range(WINDOW_DEGREE, -1, -1):
        value = value * there + past.shown[base + j * n]
    return value
