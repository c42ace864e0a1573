"""Windows on the past: the record of a run, read as one polynomial for each lag.

A window of a lag that is constant begins where the lag looks; that of one which moves has room on
both sides. It ends at the breaking points of the record, and where one polynomial would not be as
accurate as the run. Where a lag is shorter than a step what it will see is a guess: a piece of the
record beyond the present, which gives way to what is flown. Where the record is a function of the
caller's, Python is asked for its values. See ``docs/notes/delays.md``.
"""

from __future__ import annotations

import math

from .arrays import Floats, PastArrays
from .guesses import (
    AIMED_LENGTH,
    FRAME,
    GUESS_MARGIN,
    LONGEST,
    SINCE_PLACE,
    TO_PLACE,
    beyond,
    guess,
    pays,
    seen_at,
    wanted,
    wrong,
)
from .places import (
    ASKED,
    ASKED_FROM,
    ASKED_UNTIL,
    ASKED_UP_TO,
    ASKING,
    ASKS_VALUES,
    FINAL,
    FOUND,
    GUESSED,
    GUESSES,
    HOLDS,
    MOST,
    NEXT_TO_NOTHING,
    PIECES_KEPT,
    PIECES_KNOWN,
    RECORD_NOT_FINITE,
    ROUGH,
    ROUGH_FROM,
    ROUGH_PLACES,
    SERVES_UNTIL,
    SHORTEST_LAG,
    STARTED,
    STEPPED,
    STRIDE,
    TIGHT,
    WINDOW_DEGREE,
    WRONG,
)
from .record import (
    BEGIN,
    UP_TO,
    WINDOW_SHARE,
    allowed,
    at,
    holding,
    last_break,
    next_break,
    slack,
)

__all__ = ("confirmed", "nearer_guess", "read", "stays")

#: Rounding of the series of a window; windows this many times as long as those at which times are
#: one are not halved.
WINDOW_ROUNDING, UNHALVED = 1e-15, 1e3

#: How a lag moves: not, with its place going forwards, or back.
FIXED, MOVES_ON, BACKWARDS = 0, 1, 2

#: Longest window of a lag that moves, against the run, and what part of it may lie behind, against
#: the part ahead.
LONGEST_WINDOW, SIDE = 0.1, 0.25

#: Guesses at a window before a shorter one is tried, and times between which times are one that a
#: guess spans at least.
MOST_GUESSES, GUESS_SPAN = 12, 100.0

#: Places at which a record may be rough within a time this short against the run.
ROUGH_MOST, ROUGH_NEAR = 20, 1e-3


# -- reading --------------------------------------------------------------------------------


def read(t: float, again: bool, past: PastArrays) -> int:
    """Read windows off the record, into ``past.shown``.

    Parameters
    ----------
    again : bool
        On what was flown on earlier ones, which stands in the record behind what was known.

    Returns
    -------
    status : int
        ``FOUND``; ``ASKS_VALUES``, to be called again once ``past.told`` has the values of the
        record at the nodes of what is asked for; ``RECORD_NOT_FINITE``, at ``ASKED_FROM``;
        ``ROUGH``, there.
    """
    floats, ints, asking = past.floats, past.ints, past.ints[ASKING]
    if asking < 0:
        ints[GUESSED] = 0
        if not again:
            ints[GUESSES], floats[WRONG] = 0, math.inf
            wanted(t, past)
            ints[PIECES_KNOWN] = ints[PIECES_KEPT]
    ahead = floats[STRIDE] > 0.0
    end = min(floats[FINAL], t + floats[STRIDE]) if ahead else floats[FINAL]
    if again:  # no further than has been flown
        end = min(end, floats[SERVES_UNTIL])
    for k in range(past.lags.shape[0]):
        s = t - past.lags[k]
        if k >= asking:
            status = window(k, t, s, ahead, end - t, k == asking, past)
            ints[ASKING] = k if status == ASKS_VALUES else -1
            if status != FOUND:
                return status
        if past.moves[k] == FIXED:
            end = min(end, past.windows[k, TO_PLACE] + (t - s))
    floats[SERVES_UNTIL] = min(floats[FINAL], max(end, t + slack(t)))
    ints[STEPPED], ints[PIECES_KEPT] = 0, ints[PIECES_KNOWN]
    return FOUND


def window(
    k: int, t: float, s: float, ahead: bool, length: float, told: bool, past: PastArrays
) -> int:
    """Find the window of a lag that looks at ``s``; the status as in :func:`read`.

    ``ahead``: what comes is guessed; ``told``: values of the record have been asked for.
    """
    apart, moves, frame = max(slack(t), slack(s)), past.moves[k], past.windows[k]
    pad = 0.0 if moves == FIXED else 0.5 * apart
    if not told:
        aim(k, t, s, ahead, length, apart, past)
        frame[AIMED_LENGTH] = frame[TO_PLACE] - frame[SINCE_PLACE]
    while True:
        a, b = frame[SINCE_PLACE], frame[TO_PLACE]
        if ahead and past.ints[GUESSES] == 0:
            guess(t, b, past)
        first = holding(a + apart, past)
        last, given = first + 1, past.degrees[first] >= 0
        while last < past.ints[PIECES_KEPT] and past.spans[last, BEGIN] < b - apart:
            given = given and past.degrees[last] >= 0
            last += 1
        if not (given or told):
            past.floats[ASKED_FROM], past.floats[ASKED_UNTIL] = a - pad, b + pad
            past.ints[ASKED], past.ints[ASKED_UP_TO] = first, last
            return ASKS_VALUES
        guessed = ahead and beyond(t, a - pad, b)
        exact = given and last == first + 1 and past.degrees[first] <= WINDOW_DEGREE
        fine, finite = shown(k, t, a - pad, b + pad, first, last, told, past)
        fine, told = fine or (exact and not guessed), False
        brief = b - a <= UNHALVED * apart
        if finite and (fine or brief):
            if not fine and rough(s, past):
                return ROUGH
            if b - a < frame[AIMED_LENGTH] or frame[AIMED_LENGTH] >= frame[LONGEST]:
                frame[LONGEST] = 2.0 * (b - a)
            frame[SINCE_PLACE], frame[TO_PLACE] = a - pad, b + pad
            past.ints[GUESSED] = max(past.ints[GUESSED], 1 if guessed else 0)
            return FOUND
        if not finite:
            if moves == FIXED or brief:
                return RECORD_NOT_FINITE
            nearer(frame, s, apart)  # it need not look there
        elif moves == BACKWARDS:
            frame[SINCE_PLACE] = 0.5 * (a + b)
        else:
            b = shorter(s, b, t, first, last, apart, past)
            frame[SINCE_PLACE], frame[TO_PLACE] = max(a, s - SIDE * (b - s)), b


def aim(
    k: int, t: float, s: float, ahead: bool, length: float, apart: float, past: PastArrays
) -> None:
    """Both ends of a window, if it is resolved: where there is room, more than is needed."""
    frame, moves = past.windows[k], past.moves[k]
    end, span = min(next_break(past, s, apart), math.inf if ahead else t), frame[LONGEST]
    if moves == FIXED:
        frame[SINCE_PLACE] = s
        frame[TO_PLACE] = max(min(end, min(s + length, s + span)), s + apart)
        return
    span = min(span, LONGEST_WINDOW * (past.floats[FINAL] - past.floats[STARTED]))
    if ahead:  # a guess need not go further than it is flown over
        span = min(span, 2.0 * length + GUESS_MARGIN * apart)
    if moves == BACKWARDS:
        frame[SINCE_PLACE] = max(last_break(past, s - apart, False), s - span)
        frame[TO_PLACE] = min(s + apart, end)
        return
    b = min(end, s + span)
    frame[SINCE_PLACE] = min(s, max(last_break(past, s + apart, True), s - SIDE * (b - s)))
    frame[TO_PLACE] = b


def nearer(frame: Floats, s: float, apart: float) -> None:
    """Nearer ends on both sides of a place, that behind it first."""
    a, b = frame[SINCE_PLACE], frame[TO_PLACE]
    if s - a > UNHALVED * apart:
        frame[SINCE_PLACE] = s - 0.25 * (s - a)
    elif a < s:
        frame[SINCE_PLACE] = s
    else:
        frame[TO_PLACE] = s + 0.5 * (b - s)


def shorter(
    s: float, b: float, t: float, first: int, last: int, apart: float, past: PastArrays
) -> float:
    """A nearer end: half as far in what is guessed, that of a piece, or the middle."""
    if b - t > SIDE * (t - s):
        return t + 0.5 * (b - t)
    low, high = first, last
    while low < high and not past.spans[low, UP_TO] > s + apart:
        low += 1
    while high > low and not past.spans[high - 1, UP_TO] < b - apart:
        high -= 1
    return past.spans[low + (high - low) // 2, UP_TO] if high > low else 0.5 * (s + b)


def rough(s: float, past: PastArrays) -> bool:
    """Whether the record is rough everywhere, not at some places only: one more is at ``s``."""
    floats, ints = past.floats, past.ints
    near = ROUGH_NEAR * (floats[FINAL] - floats[STARTED])
    if ints[ROUGH_PLACES] == 0 or not abs(s - floats[ROUGH_FROM]) < near:
        ints[ROUGH_PLACES], floats[ROUGH_FROM] = 0, s
    ints[ROUGH_PLACES] += 1
    floats[ASKED_FROM] = s
    return ints[ROUGH_PLACES] >= ROUGH_MOST


def shown(
    k: int, t: float, a: float, b: float, first: int, last: int, told: bool, past: PastArrays
) -> tuple[bool, bool]:
    """Put down what a window shows of pieces of the record; whether its polynomial is the record,
    as far as the run can tell, and whether that is finite."""
    n, fine, share = past.own.shape[0], True, 0.5 * max(slack(t), slack(a)) / (b - a)
    base = framed(k, a, b, past)
    for i in range(n):
        if past.seen[k, i] == 1:
            low, high, size, piece = math.inf, -math.inf, 0.0, first
            for j in range(WINDOW_DEGREE + 1):
                since = (b - a) * past.nodes[j]
                while piece + 1 < last and past.spans[piece + 1, BEGIN] - a <= since:
                    piece += 1
                value = past.told[i, j] if told else at(past, piece, i, a, since)
                if not math.isfinite(value):
                    past.floats[ASKED_FROM] = a + since
                    return False, False
                past.values[0, j] = value
                low, high, size = min(low, value), max(high, value), max(size, abs(value))
            noise = share * (high - low)
            rest = laid(base + FRAME + i, size, noise, past)
            fine = fine and rest <= allowed(past, i, size) + noise
    return fine, True


def framed(k: int, a: float, b: float, past: PastArrays) -> int:
    """Put the frame of a window down; where its numbers begin."""
    base = k * (FRAME + (WINDOW_DEGREE + 1) * past.own.shape[0])
    past.shown[base], past.shown[base + 1] = 0.5 * a + 0.5 * b, 0.5 * (b - a)
    return base


def laid(base: int, size: float, noise: float, past: PastArrays) -> float:
    """Put down the polynomial through an element's values, which are in the first row; the sum of
    its last coefficients. What is rounding is left out: on a short window the derivatives of
    rounding would be large."""
    n, rest, heard = past.own.shape[0], 0.0, False
    for j in range(WINDOW_DEGREE, -1, -1):
        term = 0.0
        for m in range(WINDOW_DEGREE + 1):
            term += past.series[j, m] * past.values[0, m]
        rest += abs(term) if j > WINDOW_DEGREE - 3 else 0.0
        heard = heard or abs(term) > WINDOW_ROUNDING * size + noise
        past.values[1, j] = term if heard else 0.0
    for j in range(WINDOW_DEGREE + 1):
        power = 0.0
        for m in range(j, WINDOW_DEGREE + 1):
            power += past.powers[j, m] * past.values[1, m]
        past.shown[base + j * n] = power
    return rest


# -- behind a jump --------------------------------------------------------------------------


def stays(t: float, past: PastArrays) -> bool:
    """Look through the same windows from a time on, guessed ones cut off there, if all places are
    still in them; whether they are.

    A guard that has fired is zero through these: through others only to the tolerance.
    """
    apart, floats, ints = slack(t), past.floats, past.ints
    for k in range(past.lags.shape[0]):
        s, a, b = t - past.lags[k], past.windows[k, SINCE_PLACE], past.windows[k, TO_PLACE]
        b = t if a < t < b else b
        if not a + apart < s < b - apart:
            return False
    end = floats[FINAL]
    for k in range(past.lags.shape[0]):
        if past.windows[k, SINCE_PLACE] < t < past.windows[k, TO_PLACE]:
            cut(k, t, past)
        if past.moves[k] == FIXED:
            end = min(end, past.windows[k, TO_PLACE] + past.lags[k])
    floats[SERVES_UNTIL], floats[STRIDE], ints[TIGHT], ints[GUESSED] = end, 0.0, 0, 0
    return True


def cut(k: int, t: float, past: PastArrays) -> None:
    """Let a window end at a time: the same polynomial, by powers of the place in what is left."""
    n, a, b = past.own.shape[0], past.windows[k, SINCE_PLACE], past.windows[k, TO_PLACE]
    base, half = framed(k, a, t, past), 0.5 * (b - a)
    for i in range(n):
        if past.seen[k, i] == 1:
            size = 0.0
            for j in range(WINDOW_DEGREE + 1):
                since = (t - a) * past.nodes[j] / half
                past.values[0, j] = seen_at(past, base + FRAME + i, -1.0, since)
                size = max(size, abs(past.values[0, j]))
            laid(base + FRAME + i, size, 0.0, past)
    past.windows[k, TO_PLACE] = t


# -- guesses --------------------------------------------------------------------------------


def nearer_guess(t: float, end: float, past: PastArrays) -> int:
    """Look again, half as far as to what is to be done at a time: nothing is guessed once that is
    as near as the shortest lag. The status as in :func:`read`, or ``NEXT_TO_NOTHING``."""
    floats, ints = past.floats, past.ints
    floats[STRIDE], ints[TIGHT] = 0.5 * max(end - t, 0.0), min(ints[TIGHT], 0)
    if floats[SHORTEST_LAG] <= slack(t) and floats[STRIDE] < GUESS_SPAN * slack(t):
        return NEXT_TO_NOTHING
    return read(t, False, past)


def confirmed(t: float, length: float, past: PastArrays) -> int:
    """Whether windows from a time on have shown what was flown through them, which stands in the
    record behind what was known; if not, read them again.

    Returns
    -------
    status : int
        ``HOLDS``; or it is to be flown again, and the status is that of :func:`read`, or
        ``NEXT_TO_NOTHING``, where not even the shortest guess holds.
    """
    floats, ints, before = past.floats, past.ints, past.floats[WRONG]
    floats[WRONG] = wrong(t, past)
    stuck = floats[WRONG] > 0.5 * before
    if floats[WRONG] <= 1.0 or (stuck and floats[WRONG] <= 1.0 / WINDOW_SHARE):
        pays(length, past)
        return HOLDS
    ints[GUESSES] += 1
    fired = length < 0.9 * (floats[SERVES_UNTIL] - t)
    if not fired and ints[GUESSES] <= MOST_GUESSES and not stuck:
        return read(t, True, past)
    ints[PIECES_KEPT] = ints[PIECES_KNOWN]
    if fired:
        floats[STRIDE] = max(length, GUESS_SPAN * slack(t))
    else:
        floats[STRIDE] *= 0.25
        floats[MOST] = 2.0 * floats[STRIDE]
        if floats[STRIDE] < GUESS_SPAN * slack(t) and floats[SHORTEST_LAG] <= slack(t):
            return NEXT_TO_NOTHING
    return read(t, False, past)
