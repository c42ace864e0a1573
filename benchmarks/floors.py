"""What cannot be spared: one jet of a model in machine code, one zero of a gap, one evaluation."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from hybrid.lowering import native
from hybrid.lowering.lowered import Lowered
from hybrid.rules import unit
from hybrid.solvers.taylor_backend import order_at

#: Turns of what is timed beside each other.
TURNS = 5


def least(call: Callable[[], Any], lasting: float = 0.1) -> float:
    """The shortest time of a call, in seconds of the process."""
    shortest, end = float("inf"), time.perf_counter() + lasting
    while time.perf_counter() < end:
        begin = time.process_time()
        for _ in range(100):
            call()
        shortest = min(shortest, (time.process_time() - begin) / 100)
    return shortest


def jet(model: Any, start: Any, rtol: float, mode: str | None = None) -> float:
    """Seconds of one jet of the flow, of the order of that tolerance: what a call at that order
    takes more than one at order 0, which is the call's."""
    spec = type(model).spec
    values = [np.asarray(getattr(model, p.name), dtype=float) for p in spec.parameters]
    code = Lowered(type(model), tuple(v.shape for v in values))
    numbers = [number for value in values for number in value.ravel().tolist()]
    jets = code.tape(mode or spec.initial, ()).bind(numbers)
    programs = jets.alone._replace(code=np.zeros(1, dtype=np.int64))
    native.compile_all(programs)
    programs = programs if programs.code[0] else jets.alone
    tape, order, rule = jets.tape, order_at(rtol), unit("jets").jets
    sides, work = np.zeros(len(tape.kinks), dtype=np.int64), np.empty(tape.room)
    x, calls = np.array(start, dtype=float), {order: float("inf"), 0: float("inf")}
    for n in TURNS * (order, 0):  # in turns, so that what else the machine does falls on both
        c = np.empty((tape.rows, n + 1))
        call = least(lambda n=n, c=c: rule(programs, 0, n, 0.3, x, sides, c, work))
        calls[n] = min(calls[n], call)
    return max(calls[order] - calls[0], 0.0)


@cache
def root(turns: int = 1000) -> float:
    """Seconds of one zero of a series by Newton's method; NaN without numba."""
    from peers.numba_taylor import ORDER, compiled, landed

    @compiled
    def many(gap):
        total = 0.0
        for k in range(turns):
            gap[1] = 1.0 + 1e-6 * k
            total += landed(gap, 0.0, 0.3, False)
        return total

    gap = np.array([0.1, 1.0, -8.0, *(0.3**k for k in range(3, ORDER + 1))])
    many(gap)
    return least(lambda: many(gap)) / turns
