"""What a flow sees of the past times a zero that is written in it."""

import pytest

import hybrid as hy

WAYS = ["DOP853", "taylor", "ensemble"]


class Uncontrolled(hy.Automaton):
    """A ball with feedback of its past speed, whose gain is written as 0."""

    x = hy.state()
    v = hy.state()
    n = hy.state()
    tau: float = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s, past):
        seen = past(self.tau)
        return s.v, -2.0 + 0.0 * seen.v, seen.n

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)


@pytest.mark.parametrize("tau", [0.01, 0.5, 2.0])
def test_it_is_the_flow_without_that(way, tau):
    """At rest at 3, whatever has been seen."""
    result = way.run(Uncontrolled(tau=tau), {"x": 1.0, "v": 0.0, "n": 1.0}, (0.0, 3.5))
    assert result.mode == "flight.rest(floor)"
    assert float(result.final.x) == 0.0
    assert result.t_inf == pytest.approx(3.0, abs=1e-9)  # the tolerances are 1e-8 a step
