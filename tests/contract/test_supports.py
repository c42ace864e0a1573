"""A body on several supports: which of them bear it."""

import jax.numpy as jnp
import pytest

import hybrid as hy

WAYS = ["DOP853", "taylor", "ensemble"]

#: Half the distance of the supports; the body has unit mass and unit moment of inertia.
HALF = 0.5


class Beam(hy.Automaton):
    """A beam on two supports, which from ``since`` on a moment turns."""

    y = hy.state()
    turn = hy.state()
    v = hy.state()
    w = hy.state()
    moment: float = hy.parameter(0.0)
    since: float = hy.parameter(-1.0)

    @hy.mode
    def free(self, t, s):
        return s.v, s.w, -1.0, jnp.where(t < self.since, 0.0, self.moment)

    left = hy.contact(free, gap=lambda self, t, s: s.y - HALF * s.turn, restitution=0.5)
    right = hy.contact(free, gap=lambda self, t, s: s.y + HALF * s.turn, restitution=0.5)


class Table(hy.Automaton):
    """A beam with a third support in the middle, of which two would do."""

    y = hy.state()
    turn = hy.state()
    v = hy.state()
    w = hy.state()

    @hy.mode
    def free(self, t, s):
        return s.v, s.w, -1.0, 0.0

    left = hy.contact(free, gap=lambda self, t, s: s.y - s.turn, restitution=0.5)
    middle = hy.contact(free, gap=lambda self, t, s: s.y, restitution=0.5)
    right = hy.contact(free, gap=lambda self, t, s: s.y + s.turn, restitution=0.5)


@pytest.mark.parametrize("since", [-1.0, 1.0])
@pytest.mark.parametrize("moment", [0.6, -0.6, 1.0, -1.0, 1.5, -1.5])
def test_a_beam_turns_about_the_support_that_still_bears_it(way, moment, since):
    """Both bear it while the moment is below 1/2; the side on which they are declared says nothing.

    About one of them the moment of inertia is 1 + 1/4, and gravity's arm is 1/2.
    """
    begins = max(since, 0.0)
    result = way.run(Beam(moment=moment, since=since), [0.0] * 4, (0.0, begins + 1.0))
    rate = (abs(moment) - HALF) / (1.0 + HALF**2)
    assert result.mode == ("free.rest(left)" if moment > 0 else "free.rest(right)")
    # A polynomial of degree two, by tolerances of 1e-8 a step.
    assert float(result.final.turn) == pytest.approx(0.5 * rate * (1 if moment > 0 else -1), 1e-7)
    assert float(result.final.y) == pytest.approx(0.25 * rate, 1e-7)


def test_supports_that_follow_from_others_are_named(way):
    """What each of three bears is not known; before that is said nothing is computed with it."""
    result = way.run(Table(), [0.0] * 4, (0.0, 1.0))
    assert result.status == "refused"
    assert "left, middle, right are closed at once" in result.said


class Valley(hy.Automaton):
    """A body between two slopes, down which it slides by turns."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    w = hy.state()

    @hy.mode
    def falls(self, t, s):
        return s.v, 0.0, s.w, -9.8

    left = hy.contact(falls, gap=lambda self, t, s: s.y - 0.2 * s.x, restitution=0.6)
    right = hy.contact(falls, gap=lambda self, t, s: s.y + 0.2 * s.x, restitution=0.6)


def test_rests_that_follow_each_other_ever_sooner_are_told():
    """Where rounding keeps the body from coming to rest on both slopes, the run does not go on
    for ever."""
    with pytest.raises(hy.JumpLoopError, match=r"left, right|right, left") as told:
        hy.simulate(
            Valley(), {"x": 0.1, "v": 0.3, "y": 1.0, "w": 0.0}, (0.0, 60.0), solver="taylor"
        )
    assert "accumulate in turn, about at t = 16.7128" in str(told.value)
