"""An event in one of infinitely many flights is not passed over, however brief and however late.

A sum of impacts, and the limit of a cycle, stand for flights that nobody looks along: guards of
other edges are bounded in boxes that hold them all.
"""

import pytest

import hybrid as hy

from .ways import later

#: Flights that nobody looks along have no steps: one method of SciPy stands for all.
WAYS = ["DOP853", "taylor", "Dopri8", "ensemble", "as_function", *later("Radau", "LSODA")]


class Alarmed(hy.Automaton):
    """A ball that falls from 1 with 2, and an alarm about a time, for a time of ``2 w``."""

    x = hy.state()
    v = hy.state()
    n = hy.state()
    due = hy.parameter(2.0)
    w = hy.parameter(1e-3)
    r = hy.parameter(0.7)

    @hy.mode
    def flies(self, t, s):
        return s.v, -2.0, 0.0

    @hy.edge(flies, to=flies, guard=lambda self, t, s: ((t - self.due) / self.w) ** 2 - 1.0)
    def alarm(self, t, s):
        return s.replace(n=s.n + 1)

    floor = hy.contact(flies, gap=lambda self, t, s: s.x, restitution="r")


class Counted(hy.Automaton):
    """The same, its impacts an edge."""

    x = hy.state()
    v = hy.state()
    n = hy.state()
    due = hy.parameter(2.0)
    w = hy.parameter(1e-3)
    r = hy.parameter(0.7)

    @hy.mode(initial=True)
    def flies(self, t, s):
        return s.v, -2.0, 0.0

    @hy.edge(flies, to=flies, guard=lambda self, t, s: ((t - self.due) / self.w) ** 2 - 1.0)
    def alarm(self, t, s):
        return s.replace(n=s.n + 1)

    @hy.edge(flies, to=flies, guard=lambda self, t, s: s.x)
    def hit(self, t, s):
        return s.replace(v=-self.r * s.v)

    @hy.mode(limit_of=("hit",))
    def lies(self, t, s):
        return 0.0, 0.0, 0.0


def limit(r):
    return 1.0 + 2.0 * r / (1.0 - r)


@pytest.mark.parametrize("first", [1, *later(2, 3)])
@pytest.mark.parametrize("cls", [Alarmed, Counted])
@pytest.mark.parametrize("r", [0.7, *later(0.1)])
def test_an_alarm_in_any_flight_is_heard(way, r, cls, first):
    """In the k-th flight, each third one, for a thousandth of what is left to the limit; and not
    one beyond it. The flights are higher than the tolerances of place, which leave open what is
    lower."""
    left = [0.6 * 2.0 * r**k / (1.0 - r) for k in range(first, 25, 3) if r**k > 2e-6]
    due, w = [limit(r) - gone for gone in left], [1e-3 * gone for gone in left]
    given = {"due": [*due, limit(r) + 1.0], "w": [*w, 1e-3], "r": [r] * (1 + len(left))}
    starts, until = [[1.0, 0.0, 0.0]] * len(given["r"]), (0.0, limit(r) + 0.5)
    results = way.many(cls(), starts, until, given, rtol=1e-9, atol=1e-13)
    assert [result.final.n for result in results] == [1.0] * len(left) + [0.0]
    for result in results:
        # what is lost from impact to impact, where the way does not say it: LSODA begins each
        # flight at order one
        error = result.t_error if way.tells("bound") else 1e-8
        assert abs(result.t_inf - limit(r)) <= min(error, 1e-6)
