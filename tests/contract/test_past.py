"""Rule 9 of docs/semantics.md, on every solver: what is seen of a record that jumps."""

import pytest

import hybrid as hy
from models.delay_bounce import HISTORY, DelayBounce
from models.delay_jump import DelayJump
from models.pyragas import Pyragas

#: Methods that know no delays.
WITHOUT = {"Taylor"}


class Seen(hy.Automaton):
    """``y`` jumps from 1 to 3 at 1/2; a lag of 1 later something looks."""

    y = hy.state()
    z = hy.state(doc="what a reset saw")

    level: float = hy.parameter(2.0)
    look: float = hy.parameter(9.0)

    @hy.mode(initial=True)
    def waits(self, t, s):
        return 0.0, 0.0

    @hy.mode
    def after(self, t, s):
        return 0.0, 0.0

    @hy.edge(waits, to=waits, guard=lambda self, t, s: t - 0.5, crossing=hy.EITHER)
    def kick(self, t, s):
        return s.replace(y=3.0)

    @hy.edge(waits, to=after, guard=lambda self, t, s, past: self.level - past(1.0).y)
    def carried(self, t, s, past):
        return s.replace(z=past(1.0).y)

    @hy.edge(waits, to=after, guard=lambda self, t, s: self.look - t)
    def comes(self, t, s, past):
        return s.replace(z=past(1.0).y)


def test_a_breaking_point_is_no_jump(solver):
    """One arc from the jump on, through breaking points at 1, 3/2, 2, ...; exact polynomials."""
    run = hy.simulate(DelayJump(), {"y": 1.0}, (0.0, 3.0), rtol=1e-7, atol=1e-9, **solver)
    assert [arc.t0 for arc in run.arcs] == [0.0, 0.5]
    assert run(0.5, side="left").y == pytest.approx(0.5, abs=1e-6)
    assert run(1.5).y == pytest.approx(13 / 8, abs=1e-5)
    assert run.final.y == pytest.approx(-11 / 12, abs=1e-4)


def test_a_guard_that_comes_to_zero_there_sees_left_values(solver):
    """Its jump ends the arc before the breaking point."""
    run = hy.simulate(Seen(level=9.0, look=1.5), {"y": 1.0, "z": 0.0}, (0.0, 3.0), **solver)
    assert list(run.jumps.edge) == ["kick", "comes"]
    assert run.jumps.t[1] == 1.5
    assert run.final.z == pytest.approx(1.0, abs=1e-12)


def test_a_guard_carried_over_zero_fires_there_and_sees_right_values(solver):
    """By a jump of what it sees."""
    run = hy.simulate(Seen(), {"y": 1.0, "z": 0.0}, (0.0, 3.0), **solver)
    assert list(run.jumps.edge) == ["kick", "carried"]
    assert run.jumps.t[1] == 1.5
    assert run.final.z == pytest.approx(3.0, abs=1e-12)


def test_what_a_restarted_memory_shows(solver):
    """The state after the jump, and not the jump: nothing is carried a lag later."""
    start = {"y": 1.0, "z": 0.0}
    run = hy.simulate(Seen(level=4.0), start, (0.0, 3.0), memory="restart", **solver)
    assert list(run.jumps.edge) == ["kick"]
    run = hy.simulate(Seen(level=4.0, look=0.75), start, (0.0, 3.0), memory="restart", **solver)
    assert run.final.z == pytest.approx(3.0, abs=1e-12)


def test_a_load_carried_below_zero_releases_there(solver):
    """At ``t0 + tau``, where the history did not lead to the start."""
    start = {"y": 0.05, "v": 0.0}
    run = hy.simulate(DelayBounce(), start, (0.0, 2.0), history=HISTORY, **solver)
    assert run.zeno[0].t_release == pytest.approx(1.0, abs=1e-15)
    assert run(1.1).y > 0.0


def test_an_accumulation_is_seen_and_passed(solver):
    """A rest begins, and ends by what is seen of the flights before it."""
    run = hy.simulate(
        Pyragas(C=60.0, r=0.2), {"x1": 2.5, "x2": 0.0}, (0.0, 4.0), rtol=1e-6, atol=1e-8, **solver
    )
    times = [t for point in run.zeno for t in (point.t, point.t_release)]
    known = [2.450940744376058, 2.659592992729097, 3.489179517880435, 3.873441893315749]
    assert times == pytest.approx(known, abs=2e-2)


class Ahead(hy.Automaton):
    """A lag that is negative unless the parameter says otherwise."""

    y = hy.state()
    lag: float = hy.parameter(-1.0)

    @hy.mode
    def flow(self, t, s, past):
        return -past(self.lag).y


def test_a_negative_lag_is_an_error(solver):
    """Said with the model, the time, and which lag it is."""
    with pytest.raises(hy.FlowError, match=r"Ahead, t = 0.0, .*: the lag lag is -1.0"):
        hy.simulate(Ahead(), {"y": 1.0}, (0.0, 1.0), **solver)


def test_dense_output_is_fit_to_be_seen(solver):
    """At its tolerance, where steps are exact and no reason to be short: polynomials."""
    options = {"rtol": 1e-7, "atol": 1e-7}
    run = hy.simulate(DelayJump(), {"y": 1.0}, (0.0, 10.0), **options, **solver)
    assert run.final.y == pytest.approx(0.09445695934262015, abs=3e-5)
    assert run(4.75).y == pytest.approx(0.1156982421875, abs=3e-5)


def test_an_edge_carried_over_zero_may_leave_its_guard_as_it_is(solver):
    """The guard is not zero after the jump: the run goes on on its other side."""

    class Late(hy.Automaton):
        y = hy.state()
        z = hy.state()

        @hy.mode
        def flow(self, t, s):
            return 0.0, 0.0

        @hy.edge(flow, to=flow, guard=lambda self, t, s: t - 0.5, crossing=hy.EITHER)
        def kick(self, t, s):
            return s.replace(y=s.y + 2.0)

        @hy.edge(
            flow, to=flow, guard=lambda self, t, s, past: past(1.0).y - 2.0, crossing=hy.EITHER
        )
        def seen(self, t, s, past):
            return s.replace(z=past(1.0).y)

    run = hy.simulate(Late(), {"y": 1.0, "z": 0.0}, (0.0, 4.0), **solver)
    assert run.jumps.edge.tolist() == ["kick", "seen"]
    assert run.final.z == pytest.approx(3.0, abs=1e-12)  # rounding of a window
