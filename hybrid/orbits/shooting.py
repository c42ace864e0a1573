"""Newton's method for periodic orbits: a *turn*, the run of one period, must end where it begins.

The unknowns are the state in the middle of an arc, where no guard is about to fire, and, in an
autonomous model, the period. With the monodromy matrix ``M`` of the run from ``x`` to ``y`` ::

    (M - 1) dx + f(y) dT = x - y,        f(x) . dx = 0

where the last equation fixes the position of the start along the orbit. If the model depends on
time, ``T`` is known and the first equation is solved with ``dT = 0``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..delay.hindsight import Hindsight
from ..delay.history import pieces
from ..errors import HybridError, OrbitError
from ..lowering import Scene, scene_of
from ..result import Trajectory
from ..rules.zeros import EPS
from ..simulation import simulate, whole
from ..trajectory.arcs import Arc
from ..trajectory.log import Log
from ..variation import Factor, factors, largest

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers, StateVector

#: Most Newton steps, and most halvings of one.
NEWTON_STEPS, NEWTON_HALVINGS = 40, 8

#: Largest change by a Newton step at first, relative to the size of the orbit or to the period. It
#: doubles with each step that is not halved: near a state that stays where it is a turn is small.
NEWTON_REACH = 0.5

#: The scale of a state element is at least this many times ``atol``.
FLOOR_ATOLS = 1e3

#: Added to the residual if the ends of a turn are in different modes.
OTHER_MODE = 1.0

#: Motion per period, relative to the state, below which an orbit counts as an equilibrium.
EQUILIBRIUM_MOVE = 1e-6

#: The range of an element, used for scaling, is at least this fraction of its size.
HARDLY = 1e-9

#: How many roundings of the others a turn leaves in an element.
TURN_ROUNDINGS = 16.0

#: Shortest arc, relative to the period, in which an orbit may start (neither rest nor sliding).
SHORTEST_ARC = 1e-2


@attrs.frozen(eq=False)
class Guess:
    """The start of a turn, its period, and the history of a model with delays."""

    t: float
    x: StateVector
    mode: str | None
    period: float
    history: Any = None


@attrs.frozen(eq=False)
class Shot:
    """A run of one period, and how far it is from being closed.

    Attributes
    ----------
    miss, scale : array
        Differences between the ends of the run in each unknown, and their scales.
    residual : float
        Largest ``|miss|`` relative to ``scale``; plus 1 if the ends are in different modes.
    """

    guess: Guess
    run: Trajectory
    miss: Numbers
    scale: Numbers
    residual: float


@attrs.frozen(eq=False)
class Description:
    """The first variation over a turn.

    Attributes
    ----------
    matrix : array
        The monodromy matrix.
    saltations : list of Factor
    multipliers : array of complex
        Largest first.
    errors : array or None
        Errors of the multipliers, if known.
    """

    matrix: Matrix
    saltations: list[Factor]
    multipliers: np.ndarray
    errors: Numbers | None = None


class Shooting:
    """Newton's method on the turns of one model."""

    def __init__(self, model: Any, timed: bool, tol: float, options: dict[str, Any]) -> None:
        self.model, self.timed, self.tol, self.options = model, timed, tol, options
        self.scene: Scene = scene_of(model, by="hy.periodic_orbit")

    def turn(self, guess: Guess) -> Shot:
        """The run of one period from a guess, and its miss."""
        field = None if guess.mode is None else self.scene.field(guess.mode)
        x = guess.x
        if field is not None and field.project is not None:
            x = np.array(field.project(guess.t, x.tolist()))
        guess = attrs.evolve(guess, x=x)
        run = self.fly(guess, guess.period)
        miss, scale = run.parts[-1].last - run.parts[0].first, self._scale(run)  # type: ignore[union-attr]
        residual = float(np.max(np.abs(miss) / scale))
        if residual > self.tol:
            scale = np.maximum(scale, self._rounding(run) / self.tol)
            residual = float(np.max(np.abs(miss) / scale))
        return Shot(guess, run, miss, scale, residual + self._apart(run))

    def fly(self, guess: Guess, length: float) -> Trajectory:
        """The run of a given length from a guess."""
        span, start = (guess.t, guess.t + length), self.scene.spec.record(guess.x)
        options = {**self.options, "history": guess.history}
        run = whole(simulate(self.model, start, span, mode=guess.mode, **options))
        if run.t1 < span[1]:
            raise OrbitError(f"{run.spec.model}: the run ended at t = {run.t1:.9g}: {run.status}")
        return run

    def after(self, run: Trajectory, period: float) -> Guess:
        """A guess at the end of a run."""
        history = run.hindsight.before(len(run.parts) - 1, run.t1)
        last = run.mode
        return Guess(run.t1, run.parts[-1].last, last, period, history)

    def inside(self, run: Trajectory, since: float, period: float) -> Guess:
        """A guess in the middle of a run's longest arc after a given time.

        On a section, or just after a jump, a guard may be about to fire.
        """
        arcs = [arc for arc in run.parts if isinstance(arc, Arc) and arc.t1 > since]
        lasts = [arc.t1 - max(arc.t0, since) for arc in arcs]
        arc = arcs[int(np.argmax(lasts))]
        t = arc.t1 - 0.5 * max(lasts)
        tau = min(max((t - arc.t0) - arc.low, 0.0), arc.length)
        return Guess(t, arc.local(np.array(tau)), arc.mode, period)

    def _apart(self, run: Trajectory) -> float:
        """The addition to the residual: :data:`OTHER_MODE` if the ends are in different modes."""
        same = run.mode == run.parts[0].mode
        return 0.0 if same else OTHER_MODE

    def _scale(self, run: Trajectory) -> StateVector:
        sizes = largest(run.parts)
        atol = np.broadcast_to(np.asarray(self.options["atol"], dtype=float), sizes.shape)
        return np.maximum(sizes, np.maximum(FLOOR_ATOLS * atol, 1e-300))

    def spread(self, run: Trajectory) -> StateVector:
        """The range of each element along a run, at least a small fraction of its size."""
        ends = [state for arc in run.arcs for state in (arc.first, arc.last)]
        inside = [s(s.start + 0.5 * s.length) for a in run.arcs for s in a.segments]
        goes: np.ndarray = np.ptp(np.array(ends + inside), axis=0)
        return np.maximum(goes, HARDLY * self._scale(run))

    def centred(self, guess: Guess) -> Guess:
        """The same turn, started in the middle of its longest arc; of an arc at rest or sliding
        only if there is no other.

        A small change of the start then neither changes its mode nor fires a guard at once.
        """
        run = self.turn(guess).run
        arcs = [arc for arc in run.parts if isinstance(arc, Arc)]
        plain = [a for a in arcs if not a.constrained and a.length > SHORTEST_ARC * guess.period]
        arc = max(plain or arcs, key=lambda arc: arc.length)
        half = 0.5 * arc.length
        t = arc.t0 + (arc.low + half) if self.timed else guess.t
        return Guess(t, arc.local(np.array(half)), arc.mode, guess.period)

    def refine(self, guess: Guess) -> Shot:
        """Newton's method from a guess, until it stops improving."""
        turn, reach = self.turn(guess), NEWTON_REACH
        for _ in range(NEWTON_STEPS):
            better, halvings = self._improved(turn, reach)
            if better is None:
                break
            turn, reach = better, NEWTON_REACH if halvings else 2.0 * reach
        return turn

    def _rounding(self, run: Trajectory) -> StateVector:
        """What the rounding of the states leaves in each of them in a turn, by the flow at its
        start: an element that is zero all along, beside others that are not, has no other size."""
        first, sizes = run.parts[0], largest(run.parts)
        jacobian = self.scene.field(first.mode).jacobian
        if jacobian is None:
            return np.zeros(len(sizes))
        start = first.first.tolist()  # type: ignore[union-attr]
        matrix = np.reshape(jacobian(run.t0, start), (len(sizes), -1))
        left = TURN_ROUNDINGS * EPS * (run.t1 - run.t0) * (np.abs(matrix) @ sizes)
        return np.where(np.isfinite(left), left, 0.0)

    def _improved(self, turn: Shot, reach: float) -> tuple[Shot | None, int]:
        """The turn after a Newton step no longer than ``reach``, shortened until the residual
        falls, and how often it was halved; None if the residual does not fall."""
        step, stretch = self._step(turn)
        far = float(np.max(np.abs(step) / self._measure(turn)))
        size = max(far, abs(stretch) / turn.guess.period)
        share = min(1.0, reach / size) if size else 1.0
        for halving in range(1 if turn.residual <= self.tol else NEWTON_HALVINGS):
            part = share * 0.5**halving
            try:
                found = self.turn(self.moved(turn, part * step, part * stretch))
            except HybridError:
                continue
            if found.residual < (1.0 - 0.25 * part) * turn.residual:
                return found, halving
        return None, 0

    def moved(self, turn: Shot, step: StateVector, stretch: float) -> Guess:
        """The guess of a turn, changed by a Newton step of the state and of the period."""
        guess = turn.guess
        return attrs.evolve(guess, x=guess.x + step, period=guess.period + stretch)

    def _step(self, turn: Shot) -> tuple[np.ndarray, float]:
        """Newton step: changes of the state and of the period."""
        guess, run, scale = turn.guess, turn.run, self._measure(turn)
        matrix = self.variation(run)[0] - np.eye(len(scale))
        system = matrix * scale / scale[:, None]
        right = -turn.miss / scale
        if not self.timed:
            last = attrs.evolve(self.after(run, 0.0), mode=run.mode)
            start = self.flow(attrs.evolve(guess, mode=run.parts[0].mode)) / scale
            end = self.flow(last) / scale
            row = np.append(start / np.linalg.norm(start), 0.0)
            system = np.vstack([np.column_stack([system, end * guess.period]), row])
            right = np.append(right, 0.0)
        found = np.linalg.lstsq(system, right, rcond=1e-12)[0]
        step: np.ndarray = found[: len(scale)] * scale
        return step, 0.0 if self.timed else float(found[-1]) * guess.period

    def _measure(self, turn: Shot) -> StateVector:
        """Scales of the unknowns: their ranges along the run, which do not depend on an origin."""
        return self.spread(turn.run)

    def flow(self, guess: Guess) -> StateVector:
        """The flow at a guess."""
        scene = self.scene
        if scene.spec.lags:
            history = pieces(scene.spec, guess.history, guess.t, guess.x)
            scene = Hindsight(scene, history, "keep", Log()).at(0, guess.t, "left")
        mode = guess.mode or scene.spec.initial
        return np.array(scene.field(mode).rhs(guess.t, guess.x.tolist()))

    def again(self, turn: Shot, period: float) -> StateVector:
        """The state of a turn's run after a given shorter period."""
        return np.concatenate([np.ravel(v) for v in turn.run(turn.guess.t + period)])

    def describe(self, turn: Shot) -> Description:
        """The first variation over a turn, and its multipliers."""
        matrix, saltations = self.variation(turn.run)
        values = np.linalg.eigvals(matrix).astype(complex)
        return Description(matrix, saltations, values[np.argsort(-np.abs(values))])

    def apart(self, turn: Shot, other: Shot) -> float:
        """How far the first variations over two turns are apart, relative to the larger of their
        elements and 1, with the states relative to their scales."""
        one, two = (self.describe(shot).matrix / turn.scale[:, None] for shot in (turn, other))
        sizes = turn.scale * np.maximum(np.abs(one), np.abs(two))
        return float(np.max(np.abs(one - two) * turn.scale) / max(1.0, float(np.max(sizes))))

    def variation(self, run: Trajectory) -> tuple[np.ndarray, list[Factor]]:
        """The monodromy matrix of a run, and the factors of its jumps and accumulations."""
        matrix, jumps = np.eye(run.spec.dimension), []
        for factor in factors(self.model, run):
            matrix = factor.applied(matrix)
            if factor.edge is not None:
                jumps.append(factor)
        return matrix, jumps
