"""The search for a periodic orbit: from a guess to a closed turn."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from ..automaton.markers import RISING, Crossing
from ..errors import HybridError, OptionError, OrbitError
from ..lowering import Scene
from ..result import Trajectory
from ..run.options import start_of, time_of
from ..variation.carried import WINDOW_SPACINGS
from .returns import FIRST_WINDOW, ReturnMap
from .shooting import EQUILIBRIUM_MOVE, Guess, Shooting, Shot

#: Turns simulated before each attempt of Newton's method.
ROUNDS = (0, 8, 64)

#: Divisors of a period that are tried to find the minimal period of an autonomous orbit.
DIVISORS = (2, 3, 4, 5)

#: Tolerated residual of the turn that follows an orbit.
LASTS = 1e-6

#: A turn that is small relative to the state is no equilibrium if it moves by this many times its
#: residual and by more than rounding (the second value, relative to the state).
OPEN, TURN_NOISE = 1e3, 1e-12


def depends_on_time(scene: Scene) -> bool:
    """Whether any flow, guard, reset or law of a model depends on time explicitly.

    The past at constant lags does not count.
    """
    code = scene.code

    def look() -> bool:
        extra = {"restitution": ["u"]}
        keys = [key for key in code.cls.traces if key[0] != "lag"]
        return any(code.timed(code.closed(*key), extra.get(key[0], ())) for key in keys)

    return bool(code.once("timed", look))


def given(scene: Scene, guess: Any, t: float, mode: str | None) -> Guess:
    """The caller's guess as a :class:`Guess`; a run is continued from its end."""
    if isinstance(guess, Trajectory):
        last = guess.mode
        history = guess if scene.spec.lags else None
        return Guess(guess.t1, guess.parts[-1].last, last, 0.0, history)
    return Guess(time_of("t", t), start_of(scene.spec, guess, what="guess"), mode, 0.0)


@attrs.frozen(eq=False)
class Search:
    """The search for an orbit, by section or by period."""

    shooting: Shooting
    section: Any
    period: float | None
    t_max: float
    crossing: Crossing = RISING

    def find(self, guess: Guess, settle: int) -> Shot:
        """A closed turn, found from the guess or from a later state of its run.

        Raises
        ------
        OrbitError
            If none is found from any of them.
        """
        reached: list[str] = []
        for turns in ROUNDS:
            try:
                guess = self.timed(self.advanced(self.timed(guess), turns + (not turns) * settle))
                turn = self.shooting.refine(self.shooting.centred(guess))
            except HybridError as fault:
                reached.append(str(fault).rstrip("."))
                continue
            if turn.residual <= self.shooting.tol:
                return self.shortest(self.lasting(self.moving(turn)))
            reached.append(
                f"Newton's method came to {self.shooting.scene.spec.record(turn.guess.x)}, whose "
                f"run of {turn.guess.period:.9g} closes to {turn.residual:.2g} of its size"
            )
        later = f"After {ROUNDS[-1]} more turns: {reached[-1]}. "
        raise OrbitError(
            f"{self.shooting.scene.spec.model}: no periodic orbit was found. From the guess: "
            f"{reached[0]}. {later if reached[-1] != reached[0] else ''}Give a guess nearer to "
            "the orbit, another section or period, or settle= a number of turns"
        )

    def timed(self, guess: Guess) -> Guess:
        """The guess with the period of its turn: the given one, or the time between returns."""
        if self.period is not None:
            return attrs.evolve(guess, period=self.period)
        shooting = self.shooting
        mode = guess.mode or shooting.scene.spec.initial
        if self.section is None:
            section = _plane(shooting, guess, self._entered(guess, mode))
        else:
            section = self.section
        way = RISING if self.section is None else self.crossing
        back = ReturnMap(shooting.model, section, mode, self.t_max, way, shooting.options)
        if self.section is None:
            run = back.run(guess.x, guess.t, guess.history)
            return attrs.evolve(guess, period=run.t1 - run.t0)
        if shooting.scene.spec.lags:
            guess = shooting.after(back.run(guess.x, guess.t, guess.history), 0.0)
            back.mode = guess.mode
            run = back.run(guess.x, guess.t, guess.history)
            return attrs.evolve(guess, period=run.t1 - run.t0)
        run, period = back.lap(guess.x, guess.t)
        return shooting.inside(run, run.t1 - period, period)

    def _entered(self, guess: Guess, mode: str) -> str:
        """The mode in which the run from a guess starts, or to which it jumps at once."""
        short = max(FIRST_WINDOW * self.t_max, WINDOW_SPACINGS * float(np.spacing(abs(guess.t))))
        return str(self.shooting.fly(attrs.evolve(guess, mode=mode), short).mode)

    def advanced(self, guess: Guess, turns: int) -> Guess:
        """The guess after a number of turns."""
        if not turns:
            return guess
        return self.shooting.after(self.shooting.fly(guess, turns * guess.period), guess.period)

    def moving(self, turn: Shot) -> Shot:
        """The turn; raises an :class:`OrbitError` if it is an equilibrium."""
        shooting, guess = self.shooting, turn.guess
        rate = np.abs(shooting.flow(guess)) / turn.scale[: len(guess.x)]
        moves = float(np.max(rate)) * guess.period
        if (
            shooting.timed
            or moves > EQUILIBRIUM_MOVE
            or moves > max(OPEN * turn.residual, TURN_NOISE)
        ):
            return turn
        raise OrbitError(
            f"{shooting.scene.spec.model}: the search ended at an equilibrium, "
            f"{shooting.scene.spec.record(guess.x)}; give a guess nearer to the orbit"
        )

    def lasting(self, turn: Shot) -> Shot:
        """The turn; raises an :class:`OptionError` if the next turn does not close, or carries
        deviations otherwise, as it may about a state that stays where it is: the model's dependence
        on time then has another period."""
        shooting, guess = self.shooting, turn.guess
        later = attrs.evolve(guess, t=guess.t + guess.period)
        if guess.history is not None:
            later = shooting.after(turn.run, guess.period)
        if not shooting.timed:
            return turn
        second = shooting.turn(later)
        closes = second.residual <= LASTS
        if closes and shooting.apart(turn, second) <= LASTS:
            return turn
        does = "carries nearby motions otherwise than the first" if closes else "does not close"
        raise OptionError(
            f"period={guess.period!r}: the next run of that length from {shooting.scene.spec.model}"
            f"'s state {shooting.scene.spec.record(guess.x)} {does}; give the period of the "
            "forcing, or a multiple of it"
        )

    def shortest(self, turn: Shot) -> Shot:
        """The turn over the minimal period, if the given turn repeats an orbit several times."""
        spread = self.shooting.spread(turn.run)
        for part in () if self.shooting.timed else DIVISORS:
            guess = attrs.evolve(turn.guess, period=turn.guess.period / part)
            apart = np.abs(self.shooting.again(turn, guess.period) - guess.x)
            if np.max(apart / spread) <= EQUILIBRIUM_MOVE:
                once = self.shooting.refine(guess)
                if once.residual <= self.shooting.tol:
                    return self.shortest(once)
        return turn


def _plane(shooting: Shooting, guess: Guess, mode: str) -> Any:
    """The plane through a state and normal to the flow, in coordinates scaled by their sizes."""
    scene = shooting.scene
    flow = shooting.flow(attrs.evolve(guess, mode=mode))
    if not np.any(flow):
        raise OrbitError(
            f"{scene.spec.model}: the guess {scene.spec.record(guess.x)} is an equilibrium; "
            "give another, or a section"
        )
    sizes = np.abs(flow) + np.abs(guess.x)
    normal = np.divide(flow, sizes**2, out=np.zeros_like(flow), where=flow != 0.0)

    def plane(self: Any, t: Any, s: Any) -> Any:
        import jax.numpy as jnp

        return (jnp.concatenate([jnp.ravel(v) for v in s]) - guess.x) @ normal

    return plane
