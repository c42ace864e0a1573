"""One trajectory on its way, as arrays: what the pieces of a compiled run pass on.

What changes within an arc is kept apart (:class:`Going`): the innermost loop should carry
little.
"""

from __future__ import annotations

from typing import Any, NamedTuple

#: What a lane does next: flow a step, step onto a guard, jump, enter a mode.
FLOW, LAND, JUMP, ENTER = range(4)

#: Why a lane stands still.
RUNNING, END, MAX_JUMPS, ZENO, NO_REST, CLOSE, JUDGE = range(7)
MAX_STEPS, NOT_FINITE, OUTSIDE, UNDECIDED, LOOP, FORGOTTEN = range(7, 13)


class Going(NamedTuple):
    """What changes within an arc.

    Attributes
    ----------
    tau, x
        Local time in the arc, and the state there.
    h, reach, cap
        The step the controller wants; the length of a landing; a bound on the step, so that
        the guards can be seen.
    ends, largest : array, shape (slots,)
        The guards here, and their largest size in this arc so far.
    slot, stage, tries
        The guard that fires, what comes next, and how often a landing was tried.
    steps, status
        Attempts so far, and why the lane stands still.
    """

    tau: Any
    x: Any
    h: Any
    reach: Any
    cap: Any
    ends: Any
    largest: Any
    slot: Any
    stage: Any
    tries: Any
    steps: Any
    status: Any


class Lane(NamedTuple):
    """One trajectory on its way.

    Attributes
    ----------
    t, low
        Start of the present arc, in two floats.
    mode, held
        The mode's number, and the contacts held.
    orders, limit
        Powers of ``tau`` by which the guards vanish at the arc's start; a bound on the
        first step.
    jumps, stuck
        Jumps so far, and how many of them with no time between.
    series, count, tried, speed
        A series of impacts: the slot, how many, the speed of the last try to sum it, and
        the speed after the impact just made (0 after another jump).
    """

    t: Any
    low: Any
    mode: Any
    held: Any
    orders: Any
    limit: Any
    jumps: Any
    stuck: Any
    series: Any
    count: Any
    tried: Any
    speed: Any
    going: Going

    @property
    def now(self) -> Any:
        """The present time, rounded."""
        return self.t + (self.low + self.going.tau)

    def left(self, t: Any) -> Any:
        """Duration from here to ``t``."""
        return ((t - self.t) - self.low) - self.going.tau

    def but(self, **changes: Any) -> Lane:
        """The lane with some entries of ``going`` changed."""
        return self._replace(going=self.going._replace(**changes))


class Run(NamedTuple):
    """What is asked for: traced, so that no number compiles anew.

    ``until``: how far the parameters serve, where they hold windows of the past.
    """

    parameters: Any
    t0: Any
    t1: Any
    rtol: Any
    atol: Any
    max_jumps: Any
    max_steps: Any
    until: Any = None

    @property
    def end(self) -> Any:
        """How far steps may go."""
        return self.t1 if self.until is None else self.until


class Step(NamedTuple):
    """What an attempt shows a recorder: the states at the method's nodes."""

    values: Any
    start: Any
    length: Any
