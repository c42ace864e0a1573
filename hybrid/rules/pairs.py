"""Steps of explicit Runge-Kutta pairs, for runs whose loop asks another solver for steps.

Tables and step size control are those of the library that has the method
(:mod:`hybrid.solvers.pairs`), so the steps are its own up to rounding. Where the library would find
no step, the run is left to the driver, which says why.
"""

from __future__ import annotations

import math

from .arcs import SAFETY, copied
from .arrays import AutomatonArrays, Floats, Now, Pair, Room
from .jets import FLOW, afresh
from .operations import integrate
from .places import (
    AIM,
    CHANGES,
    EXPANSIONS,
    FIELD,
    FIELD_PROGRAM,
    FIRST_LENGTH,
    LAND_ON,
    LOW,
    MADE,
    PLAIN,
    SHOW,
    STEP,
    STEP_END,
    TAU,
    TO_TAU,
    UNTIL,
    T,
)
from .zeros import EPS

__all__ = ("answers",)

#: Entries of the step size control: safety factor, and exponent of the error; least factor after a
#: rejected step; least and largest factor after an accepted one, and the largest if it was tried
#: before; least length in spacings of the time; whether a step that was cut short is followed by
#: one of its original length; whether a step onto a guard is accepted whatever its error; relative
#: tolerance; then the absolute tolerances.
CAREFUL, ERROR_POWER, REFUSED_LEAST, KEPT_LEAST, KEPT_MOST, TRIED_MOST, LEAST_LENGTH = range(7)
KEEPS_LENGTH, LANDS_ANYWAY, OWN_RTOL, OWN_ATOL = range(7, 11)

#: Entries of the memory of an arc: length of the next step and of the last; and to detect ever
#: shorter steps: their count, the count of the next check, count and time of the last check, the
#: way covered before that, and how often in a row the way has become less.
NEXT_LENGTH, LAST_LENGTH, STEP_COUNT, LOOK_DUE, COUNTED_FROM = range(5)
TIME_FROM, WAY_BEFORE, LESS_IN_A_ROW, PACE_PLACES = range(5, 9)

#: Rows of states: at the start of a step, at its end, and at a stage.
STEP_FROM, STEP_ONTO, STAGE_STATE, STEP_STATES = 0, 1, 2, 3

#: A step rejected at this many spacings of the time is left to the driver.
SHORTEST_SPACINGS = 64.0

#: Weight of the second error estimate of a pair with two, relative to the first (Hairer, Norsett
#: and Wanner, DOP853).
SECOND_ESTIMATE = 0.01

#: A flow is taken to oscillate ever faster up to a time that is never reached if, ROWS times in a
#: row, twice as many steps have covered less than SWING_SHARE of the way of those before, counted
#: from COUNTED steps on, and more than STEPS_LEFT steps of the last length are left. Steps that
#: shrink with a power p > 1 of the time left have the share 2^(-1/(p-1)): 1/2 for sin(1/x).
ROWS, SWING_SHARE, COUNTED, STEPS_LEFT = 4, 0.8, 512, 1e6

#: Steps of this many spacings of the time are stuck. A method that goes back and forth over a jump
#: of the flow is never further from it than this many of its steps.
FEW_STEPS = 4.0


def answers(status: int, a: AutomatonArrays, run: Floats, now: Now, room: Room, pair: Pair) -> bool:
    """Do what the loop has asked for; returns whether that is possible here."""
    if status == SHOW:
        return shows(a, now, room, pair)
    if status == LAND_ON:
        return arrives(a, now, room, pair)
    made = now.ints[MADE]
    if status != STEP:
        return False
    length = (run[UNTIL] - now.floats[T]) - now.floats[LOW]
    if a.fields[now.ints[FIELD], PLAIN] == CHANGES:
        return False
    if made == 0:
        pair.going[NEXT_LENGTH] = min(
            min(now.floats[FIRST_LENGTH], SAFETY * length), now.floats[AIM]
        )
        for k in range(STEP_COUNT, PACE_PLACES):
            pair.going[k] = 0.0
        pair.going[LOOK_DUE] = COUNTED
        rates(a, now, room, now.floats[T], now.x, pair.rates[0])
    else:
        copied(pair.rates[pair.errors.shape[1] - 1], pair.rates[0])
    copied(now.end, pair.states[STEP_FROM])
    now.ints[EXPANSIONS] += 1
    return pair.going[NEXT_LENGTH] > 0.0 and steps(a, now, room, pair) and paced(now, pair, length)


def steps(a: AutomatonArrays, now: Now, room: Room, pair: Pair) -> bool:
    """Make a step that the pair accepts, no further than the loop has said; returns whether there
    is one.

    After SciPy's ``RungeKutta._step_impl`` and Diffrax's ``PIDController.adapt_step_size``.
    """
    control, going = pair.control, pair.going
    tau, limit = now.floats[TAU], now.floats[TO_TAU]
    spacing, most = EPS * tau, control[KEPT_MOST]
    going[NEXT_LENGTH] = max(going[NEXT_LENGTH], control[LEAST_LENGTH] * spacing)
    while True:
        end = min(tau + going[NEXT_LENGTH], limit)
        error = attempt(a, now, room, pair, end - tau)
        factor = scaled_by(control, error)
        if error < 1.0:
            break
        going[NEXT_LENGTH] = (end - tau) * max(
            control[REFUSED_LEAST], min(factor, control[CAREFUL])
        )
        most = control[TRIED_MOST]
        if not going[NEXT_LENGTH] > SHORTEST_SPACINGS * spacing:
            return False
    following = (end - tau) * min(max(factor, control[KEPT_LEAST]), most)
    if control[KEEPS_LENGTH] == 1.0 and end < tau + going[NEXT_LENGTH]:
        following = max(following, going[NEXT_LENGTH])
    going[NEXT_LENGTH] = following
    ends(now, pair, end)
    return True


def scaled_by(control: Floats, error: float) -> float:
    """The factor by which to change the length of a step."""
    if error == 0.0:
        return math.inf
    return control[CAREFUL] * error ** control[ERROR_POWER] if error < math.inf else 0.0


def ends(now: Now, pair: Pair, end: float) -> None:
    """Tell the loop where a step ends."""
    pair.going[LAST_LENGTH] = end - now.floats[TAU]
    now.floats[STEP_END] = now.floats[TO_TAU] = end
    copied(pair.states[STEP_ONTO], now.end)


def paced(now: Now, pair: Pair, length: float) -> bool:
    """Count a step; returns whether steps do not become ever shorter (:mod:`hybrid.run.pace`)."""
    going, end = pair.going, now.floats[STEP_END]
    going[STEP_COUNT] += 1.0
    if going[STEP_COUNT] < going[LOOK_DUE]:
        return True
    made, gone = going[STEP_COUNT] - going[COUNTED_FROM], end - going[TIME_FROM]
    falls = going[LOOK_DUE] > COUNTED and gone < SWING_SHARE * going[WAY_BEFORE]
    going[LESS_IN_A_ROW] = going[LESS_IN_A_ROW] + 1.0 if falls else 0.0
    going[COUNTED_FROM], going[TIME_FROM], going[WAY_BEFORE] = going[STEP_COUNT], end, gone
    going[LOOK_DUE] = 2.0 * going[STEP_COUNT]
    stuck = gone <= FEW_STEPS * EPS * end * made or going[LESS_IN_A_ROW] >= ROWS
    return not (stuck and length - end > STEPS_LEFT * going[LAST_LENGTH])


def shows(a: AutomatonArrays, now: Now, room: Room, pair: Pair) -> bool:
    """Show the polynomial of the last step, the pair's own dense output."""
    h, n = pair.going[LAST_LENGTH], now.x.shape[0]
    stages(a, now, room, pair, h, pair.errors.shape[1], pair.matrix.shape[0])
    fit = True
    for i in range(n):
        c = room.c[i]
        for k in range(c.shape[0]):
            c[k] = 0.0
        c[0], power = pair.states[STEP_FROM, i], 1.0
        for k in range(pair.dense.shape[1]):
            total = 0.0
            for s in range(pair.dense.shape[0]):
                total += pair.dense[s, k] * pair.rates[s, i]
            c[k + 1] = total / power if power > 0.0 else math.inf
            power *= h
            fit = fit and math.isfinite(c[k + 1])
    return fit


def arrives(a: AutomatonArrays, now: Now, room: Room, pair: Pair) -> bool:
    """Repeat the last step up to the zero of a guard; use the interpolant of the longer step if the
    pair rejects it."""
    end, n, before = now.floats[TO_TAU], now.x.shape[0], pair.going[LAST_LENGTH]
    error = attempt(a, now, room, pair, end - now.floats[TAU])
    if error < 1.0 or (pair.control[LANDS_ANYWAY] == 1.0 and error < math.inf):
        ends(now, pair, end)
        return True
    if not attempt(a, now, room, pair, before) < math.inf or not shows(a, now, room, pair):
        return False
    h = end - now.floats[TAU]
    for i in range(n):
        value = 0.0
        for k in range(pair.dense.shape[1], -1, -1):
            value = value * h + room.c[i, k]
        now.end[i] = value
    now.floats[STEP_END] = end
    return True


def attempt(a: AutomatonArrays, now: Now, room: Room, pair: Pair, h: float) -> float:
    """Try a step of a given length; returns its error relative to the tolerances, infinite if it
    does not exist."""
    last, n = pair.errors.shape[1] - 1, now.x.shape[0]
    stages(a, now, room, pair, h, 1, last + 1)
    first, second = 0.0, 0.0
    for i in range(n):
        there, here = abs(pair.states[STEP_FROM, i]), abs(pair.states[STEP_ONTO, i])
        scale = pair.control[OWN_ATOL + i] + pair.control[OWN_RTOL] * max(there, here)
        if not (math.isfinite(here) and scale > 0.0):
            return math.inf
        own = weighed(pair, 0, i) / scale
        first += own * own
        if pair.errors.shape[0] > 1:
            own = weighed(pair, 1, i) / scale
            second += own * own
    if not (math.isfinite(first) and math.isfinite(second)):
        return math.inf
    if first == 0.0:
        return 0.0
    if pair.errors.shape[0] == 1:
        return h * math.sqrt(first / n)
    return h * first / math.sqrt((first + SECOND_ESTIMATE * second) * n)


def weighed(pair: Pair, row: int, i: int) -> float:
    """An error estimate of one element, divided by the length of the step."""
    total = 0.0
    for s in range(pair.errors.shape[1]):
        total += pair.errors[row, s] * pair.rates[s, i]
    return total


def stages(
    a: AutomatonArrays, now: Now, room: Room, pair: Pair, h: float, first: int, until: int
) -> None:
    """Compute the flow at some stages of a step, and its end."""
    last, tau = pair.errors.shape[1] - 1, now.floats[TAU]
    for s in range(first, until):
        x = pair.states[STEP_ONTO if s == last else STAGE_STATE]
        for i in range(x.shape[0]):
            total = 0.0
            for j in range(s):
                total += pair.matrix[s, j] * pair.rates[j, i]
            x[i] = pair.states[STEP_FROM, i] + h * total
        rates(a, now, room, now.floats[T] + (tau + pair.fractions[s] * h), x, pair.rates[s])


def rates(a: AutomatonArrays, now: Now, room: Room, t: float, x: Floats, written: Floats) -> None:
    """Compute the flow of the present field; other outputs of its program need not exist."""
    program = a.fields[now.ints[FIELD], FIELD_PROGRAM]
    afresh(a.programs, program, 0, t, x, room.still, room.aside, room.work)
    first = a.programs.index[program, FLOW]
    for i in range(x.shape[0]):
        integrate(i, a.programs.flow[first + i], a.programs.numbers, room.aside, 0)
        written[i] = room.aside[i, 1]
