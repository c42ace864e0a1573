"""Windows on the past: for each lag a polynomial that represents the record.

The window of a constant lag begins where the lag looks; that of a moving lag has room on both
sides. It ends at breaking points of the record, and where one polynomial would be less accurate
than the run. Where a lag is shorter than a step, what it will see is a guess: a piece of the record
beyond the present, which is replaced by what is flown. Where the record is a function of the
caller's, Python is asked for its values. See ``docs/notes/delays.md``.
"""

from __future__ import annotations

import math

from .arrays import Floats, PastArrays
from .guesses import (
    AIMED_LENGTH,
    FRAME,
    GUESS_MARGIN,
    GUESS_SPAN,
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
    READ_FROM,
    READS,
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

#: Rounding of a window's series; and windows up to this many tolerances on equal times are not
#: halved.
WINDOW_ROUNDING, UNHALVED = 1e-15, 1e3

#: How a lag moves: not at all, or so that its place moves forwards or backwards.
FIXED, MOVES_ON, BACKWARDS = 0, 1, 2

#: A moving lag counts as at the end of its window within this many tolerances on equal times.
AT_THE_END = 1e2

#: Longest window of a moving lag, relative to the run; and the part behind the place, relative to
#: that ahead.
LONGEST_WINDOW, SIDE = 0.1, 0.25

#: Guesses of one window before a shorter one is tried.
MOST_GUESSES = 12

#: Most windows in a row from one time, with no jump between: a thousandth of the run is cut by four
#: and guessed a dozen times down to rounding in some 400.
MOST_READS = 1000

#: Number of rough places of a record that are allowed within this fraction of the run.
ROUGH_MOST, ROUGH_NEAR = 20, 1e-3


# -- reading --------------------------------------------------------------------------------


def read(t: float, again: bool, past: PastArrays) -> int:
    """Read windows from the record into ``past.shown``.

    Parameters
    ----------
    again : bool
        Whether to read what was flown on earlier windows; it follows the known part of the record.

    Returns
    -------
    status : int
        ``FOUND``; ``ASKS_VALUES``, to be called again once ``past.told`` has the values of the
        record at the requested nodes; ``RECORD_NOT_FINITE`` or ``ROUGH``, at ``ASKED_FROM``;
        ``NEXT_TO_NOTHING`` if the run does not get away from this time.
    """
    floats, ints, asking = past.floats, past.ints, past.ints[ASKING]
    if asking < 0:
        if stuck(t, past):
            return NEXT_TO_NOTHING
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
    floats[SERVES_UNTIL] = served(max(end, t + slack(t)), past)
    ints[STEPPED], ints[PIECES_KEPT] = 0, ints[PIECES_KNOWN]
    return FOUND


def stuck(t: float, past: PastArrays) -> bool:
    """Note that windows are read from a time; returns whether they have been too often."""
    past.ints[READS] = past.ints[READS] + 1 if t == past.floats[READ_FROM] else 0
    past.floats[READ_FROM] = t
    return past.ints[READS] > MOST_READS


def served(end: float, past: PastArrays) -> float:
    """Up to when windows serve that lead to a time: to the end of the run, if rounding does not
    tell the two apart. A window on what is left would show no rates."""
    final = past.floats[FINAL]
    return final if final - end <= slack(final) else end


def window(
    k: int, t: float, s: float, ahead: bool, length: float, told: bool, past: PastArrays
) -> int:
    """Find the window of a lag that looks at ``s``; returns the status of :func:`read`.

    ``ahead``: the future is guessed; ``told``: values of the record have been asked for.
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
    """Choose both ends of a window, to be shortened if it is not resolved; longer than needed where
    there is room."""
    frame, moves, span = past.windows[k], past.moves[k], past.windows[k, LONGEST]
    if moves == FIXED:
        end = min(next_break(past, s, apart), math.inf if ahead else t)
        frame[SINCE_PLACE] = s
        frame[TO_PLACE] = max(min(end, min(s + length, s + span)), s + apart)
        return
    s = beside(s, frame[SINCE_PLACE if moves == BACKWARDS else TO_PLACE], apart)
    end = min(next_break(past, s, apart), math.inf if ahead else t)
    span = min(span, LONGEST_WINDOW * (past.floats[FINAL] - past.floats[STARTED]))
    if ahead:  # a guess need not go further than it is flown over
        span = min(span, max(t - s, 2.0 * length + GUESS_MARGIN * apart))
    if moves == BACKWARDS:
        frame[SINCE_PLACE] = max(last_break(past, s - apart, False), s - span)
        frame[TO_PLACE] = min(s + apart, end)
        return
    b = min(end, s + span)
    frame[SINCE_PLACE] = min(s, max(last_break(past, s + apart, True), s - SIDE * (b - s)))
    frame[TO_PLACE] = b


def beside(s: float, reached: float, apart: float) -> float:
    """A place, or the end of the last window if it is there: of breaking points nearer to each
    other than the time can tell, each window passes one."""
    return reached if abs(s - reached) <= AT_THE_END * apart else s


def nearer(frame: Floats, s: float, apart: float) -> None:
    """Move the ends of a window nearer to a place, first the end behind it."""
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
    """A nearer end: half as far into what is guessed, at the end of a piece, or in the middle."""
    if b - t > SIDE * (t - s):
        return t + 0.5 * (b - t)
    low, high = first, last
    while low < high and not past.spans[low, UP_TO] > s + apart:
        low += 1
    while high > low and not past.spans[high - 1, UP_TO] < b - apart:
        high -= 1
    return past.spans[low + (high - low) // 2, UP_TO] if high > low else 0.5 * (s + b)


def rough(s: float, past: PastArrays) -> bool:
    """Note that the record is rough at ``s``; returns whether it is rough everywhere, not only at
    single places."""
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
    """Write the polynomial of a window on some pieces of the record; returns whether it agrees with
    the record, within the run's tolerance, and whether that is finite."""
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
    """Write the frame of a window; returns where its numbers begin."""
    base = k * (FRAME + (WINDOW_DEGREE + 1) * past.own.shape[0])
    past.shown[base], past.shown[base + 1] = 0.5 * a + 0.5 * b, 0.5 * (b - a)
    return base


def laid(base: int, size: float, noise: float, past: PastArrays) -> float:
    """Write the polynomial through an element's values, which are in the first row; returns the sum
    of its last coefficients. Coefficients that are rounding are left out, as on a short window
    their derivatives would be large."""
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
    """Keep the windows from a time on, if all places still lie in them; returns whether they do.
    Guessed windows are cut there.

    A guard that has fired is zero with these windows; with others only within the tolerance.
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
    floats[SERVES_UNTIL], floats[STRIDE], ints[TIGHT], ints[GUESSED] = served(end, past), 0.0, 0, 0
    return True


def cut(k: int, t: float, past: PastArrays) -> None:
    """End a window at a time: the same polynomial, in powers of the place in what is left."""
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
    """Read again with a guess half as far as the next event; there is none once that is as near as
    the shortest lag. Returns the status of :func:`read`, or ``NEXT_TO_NOTHING``."""
    floats, ints = past.floats, past.ints
    floats[STRIDE], ints[TIGHT] = 0.5 * max(end - t, 0.0), min(ints[TIGHT], 0)
    if floats[SHORTEST_LAG] <= slack(t) and floats[STRIDE] < GUESS_SPAN * slack(t):
        return NEXT_TO_NOTHING
    return read(t, False, past)


def confirmed(t: float, length: float, past: PastArrays) -> int:
    """Compare the windows from a time on with what was flown on them, which follows the known part
    of the record; if they differ, read them again.

    Returns
    -------
    status : int
        ``HOLDS``; otherwise the flight must be repeated, and this is the status of :func:`read`, or
        ``NEXT_TO_NOTHING`` if not even the shortest guess holds.
    """
    floats, ints, before = past.floats, past.ints, past.floats[WRONG]
    floats[WRONG] = wrong(t, past)
    stays_wrong = floats[WRONG] > 0.5 * before
    if floats[WRONG] <= 1.0 or (stays_wrong and floats[WRONG] <= 1.0 / WINDOW_SHARE):
        pays(length, past)
        return HOLDS
    ints[GUESSES] += 1
    least = GUESS_SPAN * slack(t)
    fired = least < length < 0.9 * (floats[SERVES_UNTIL] - t)
    if not fired and ints[GUESSES] <= MOST_GUESSES and not stays_wrong:
        return read(t, True, past)
    ints[PIECES_KEPT] = ints[PIECES_KNOWN]
    if fired:
        floats[STRIDE] = length
    else:
        floats[STRIDE] *= 0.25
        floats[MOST] = 2.0 * floats[STRIDE]
        if floats[STRIDE] < least and floats[SHORTEST_LAG] <= slack(t):
            return NEXT_TO_NOTHING
    return read(t, False, past)
