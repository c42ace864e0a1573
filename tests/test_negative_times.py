"""What is measured in spacings of the time is measured the same before zero as behind it."""

import pytest

import hybrid as hy

SOLVERS = pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])


class Undecided(hy.Automaton):
    """A relay without hysteresis, written as two edges."""

    x = hy.state()

    @hy.mode(initial=True)
    def down(self, t, s):
        return -1.0

    @hy.mode
    def up(self, t, s):
        return 1.0

    lowered = hy.edge(down, to=up, guard=lambda self, t, s: s.x)
    raised = hy.edge(up, to=down, guard=lambda self, t, s: s.x, crossing=hy.RISING)


class Kicked(hy.Automaton):
    """A ball, and a clock whose condition always fails."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -10.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.25)

    @hy.edge(flight, every=0.25, when=lambda self, t, s: s.x - 1.0)
    def kick(self, t, s):
        return s.replace(v=1.0)


@SOLVERS
@pytest.mark.parametrize("begin", [-1.0, -1e6])
def test_jumps_without_end_are_refused(begin, solver):
    with pytest.raises(hy.JumpLoopError, match="lowered"):
        hy.simulate(Undecided(), {"x": 0.5}, (begin, begin + 2.0), solver=solver)


@SOLVERS
@pytest.mark.parametrize("begin", [-0.99, -100.0, -1e6])
def test_impacts_accumulate_behind_a_clock_that_does_not_fire(begin, solver):
    run = hy.simulate(Kicked(), {"x": 0.0125, "v": 0.0}, (begin, begin + 0.5), solver=solver)
    (point,) = run.zeno
    # 0.05 * (1 + r) / (1 - r) behind the start
    assert abs(point.t - (begin + 0.25 / 3.0)) <= point.t_error < 1e-11 * max(1.0, abs(begin))
    assert run.mode == "flight.rest(impact)"
