"""Newton's method for orbits of models with delays whose memory restarts at jumps.

The state just after a jump, and the time of the jump, determine the future; they are the unknowns.
A turn ends just after a jump of the same edge: the one closest to one period later.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import attrs
import numpy as np

from ..errors import OrbitError
from ..result import Trajectory
from ..run.sections import Return
from ..simulation import simulate, whole
from ..trajectory.arcs import Arc
from ..variation import Strand
from .cut import behind, cut
from .delayed import carried
from .shooting import EQUILIBRIUM_MOVE, Description, Guess, Shooting, Shot

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers, StateVector

#: Duration, in periods, of the run in which the jump that ends a turn is sought.
PERIODS_FLOWN = 1.5


@attrs.frozen(eq=False)
class Landed(Guess):
    """A guess just after a jump of ``edge``."""

    edge: str = ""


class RestartShooting(Shooting):
    """Newton's method on the states after jumps."""

    def centred(self, guess: Guess) -> Guess:
        """The same turn, started just after the jump that precedes its longest arc."""
        run = self.fly(guess, PERIODS_FLOWN * guess.period + guess.period)
        jumps = {i: row for i, row in run.own_jumps.items() if isinstance(run.parts[i + 1], Arc)}
        chosen = [i for i, row in jumps.items() if row.t >= run.t1 - PERIODS_FLOWN * guess.period]
        if not chosen:
            raise OrbitError(
                f"{run.spec.model}: no jump in a turn from t = {guess.t:.9g}: nothing restarts; "
                'use memory="keep"'
            )
        index = max(chosen, key=lambda i: run.parts[i + 1].t1 - run.parts[i + 1].t0)
        return self._landed(run, index, guess.period)

    def fly(self, guess: Guess, length: float) -> Trajectory:
        """The run of a given length from a guess; from just behind an event, it does not meet that
        again."""
        run = super().fly(guess, length)
        event = behind(run, guess.edge) if isinstance(guess, Landed) else None
        if event is None:
            return run
        return whole(simulate(self.model, event, (run.t0, run.t1), **self.options))

    def _landed(self, run: Trajectory, index: int, period: float) -> Landed:
        row, mode = run.own_jumps[index], run.parts[index + 1].mode
        return Landed(row.t, self._closed(row.edge, row.t, row.after), mode, period, None, row.edge)

    def _closed(self, edge: str, t: float, x: StateVector) -> StateVector:
        """A state projected onto the contact ``edge``; unchanged if ``edge`` is not a contact."""
        if not self.scene.is_contact(edge):
            return x
        return np.array(self.scene.contact(edge).land(t, x.tolist()))

    def turn(self, guess: Guess) -> Shot:
        """The run from just after a jump to just after the corresponding jump a period later."""
        assert isinstance(guess, Landed)
        x = self._closed(guess.edge, guess.t, guess.x)
        guess = attrs.evolve(guess, x=x, history=None)
        whole = self.fly(guess, PERIODS_FLOWN * guess.period)
        index = self._nearest(whole, guess)
        run = cut(whole, Return(index, whole.parts[index].length))  # type: ignore[union-attr]
        row = run.own_jumps[index]
        scale = self._scale(run)
        lasted, period = row.t - guess.t, guess.period
        if not self.timed:
            guess, period = attrs.evolve(guess, period=lasted), lasted
        miss = np.append(row.after - x, lasted - period)
        sizes = np.append(scale, period)
        apart = self._apart(run)
        return Shot(guess, run, miss, sizes, float(np.max(np.abs(miss) / sizes)) + apart)

    def _nearest(self, run: Trajectory, guess: Landed) -> int:
        """The jump of a guess's edge closest to one period later."""
        rows = {i: row for i, row in run.own_jumps.items() if row.edge == guess.edge}
        if not rows:
            raise OrbitError(f"{run.spec.model}: the run does not jump by {guess.edge} again")
        return min(rows, key=lambda i: abs(rows[i].t - guess.t - guess.period))

    def _measure(self, turn: Shot) -> Numbers:
        return turn.scale

    def _step(self, turn: Shot) -> tuple[np.ndarray, float]:
        """Newton step: change of the state after the jump and of the jump's time, in one array; and
        0, as the period is not an unknown."""
        matrix = self._carried(turn).matrix - np.eye(len(turn.scale))
        count = len(turn.scale) if self.timed else len(turn.scale) - 1
        system = (matrix * turn.scale / turn.scale[:, None])[:count, :count]
        found = np.linalg.lstsq(system, -(turn.miss / turn.scale)[:count], rcond=1e-12)[0]
        return np.append(found, np.zeros(len(turn.scale) - count)) * turn.scale, 0.0

    def moved(self, turn: Shot, step: Numbers, stretch: float) -> Guess:
        """The guess of a turn changed by a step."""
        guess = turn.guess
        return attrs.evolve(guess, x=guess.x + step[:-1], t=guess.t + float(step[-1]))

    def again(self, turn: Shot, period: float) -> StateVector:
        """The state after the jump that comes a given shorter period later; NaN without a jump."""
        guess = attrs.evolve(turn.guess, period=period)
        assert isinstance(guess, Landed)
        row = turn.run.own_jumps[self._nearest(turn.run, guess)]
        there = abs(row.t - guess.t - period) <= EQUILIBRIUM_MOVE * period
        return np.where(there, row.after, np.nan)

    def describe(self, turn: Shot) -> Description:
        """The multipliers: eigenvalues of the map of the state after the jump and the jump's time,
        without the one that is 0."""
        found = self._carried(turn)
        values = np.linalg.eigvals(found.matrix).astype(complex)
        values = values[np.argsort(-np.abs(values))][:-1]
        return attrs.evolve(found, multipliers=values)

    def _carried(self, turn: Shot) -> Description:
        """The derivative of the state after the last jump, and of its time, by those of the first
        jump, shape ``(n + 1, n + 1)``."""
        run, size = turn.run, len(turn.guess.x)
        start = np.eye(size, 1 + size)
        now = start - np.outer(self.flow(turn.guess), np.eye(1, 1 + size, size)[0])
        found, _ = carried(run, now, [Strand(run.t0 - 1.0, run.t0, start[None])])
        assert found.last is not None
        matrix = np.vstack([found.last.after, found.last.time])
        return Description(matrix, found.saltations, np.empty(0))
