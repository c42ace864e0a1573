"""A run that goes on where another ended, joined to it, is the run that was made in one."""

import math
import pickle

import numpy as np
import pytest

import hybrid as hy
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.hard_spring import HardSpring
from models.pyragas import Pyragas
from models.relay import Relay
from models.two_tanks import TwoTanks

from .contract.ways import SOLVERS
from .delayed import Ball, Kicked
from .systems import Counter, Shelf, Thermostat

#: Each run with the times at which it is cut: while flying, among impacts, near a limit, at rest,
#: while sliding; at an impact, at a limit and where a lag arrives, to the last bit.
RUNS = {
    "ball": (BouncingBall(), [1.0, 0.0], (0.0, 3.0), (0.3, math.sqrt(2 / 9.81), 1.2, 2.55, 2.9)),
    "table": (BeadOnTable(r=0.6, omega=3.5), [1.5, 0.0], (0.0, 9.0), (1.0, 1.79, 2.5, 5.0)),
    "relay": (Relay(), [0.5], (0.0, 6.0), (0.5, 1.8, 1.9, 2.8)),
    "tanks": (TwoTanks(), [8.0, 6.0], (0.0, 30.0), (3.0, 15.0, 19.99, 22.0)),
    "thermostat": (Thermostat(), [20.0], (0.0, 4.0), (0.1, math.log(10.0 / 8.0), 2.0)),
    "kicked": (Kicked(), [1.0], (0.0, 6.0), (0.5, 1.0, 1.5, 2.25)),
    "delayed ball": (Ball(), [1.0, 0.0], (0.0, 4.0), (0.4, 1.0, 2.2)),
}


class Echoing(hy.Automaton):
    """A ball that falls in a flow with a memory of its speed."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def fly(self, t, s, past):
        return s.v, -9.81 + 0.1 * past(0.3).v

    floor = hy.contact(fly, gap=lambda self, t, s: s.x, restitution=0.5)


#: A step may lose 1e-11 of the state, of which the cut makes one more; guards are met with a slope
#: of at least a hundredth of the state.
CLOSE = 1e-9


def the_same(one, other):
    """What two runs tell is the same, but for what a step loses."""
    assert [point.edges for point in one.zeno] == [point.edges for point in other.zeno]
    for own, theirs in zip(one.zeno, other.zeno, strict=True):
        assert own.t == pytest.approx(theirs.t, abs=CLOSE)
        assert (own.t_release is None) == (theirs.t_release is None)
        assert own.mode == theirs.mode
    jumps = [list(run.own_jumps.values()) for run in (one, other)]
    limits = [point.t for point in one.zeno]
    rows = [[r for r in each if all(abs(r.t - t) > 1e-3 for t in limits)] for each in jumps]
    if not limits:
        assert [row.edge for row in rows[0]] == [row.edge for row in rows[1]]
    listed = zip(one.jumps[: len(rows[0])], other.jumps, strict=False)
    for own, theirs in listed:
        assert (own.edge, own.t) == (theirs.edge, pytest.approx(theirs.t, abs=CLOSE))
    assert one.mode == other.mode
    for own, theirs in zip(one.final, other.final, strict=True):
        np.testing.assert_allclose(own, theirs, rtol=CLOSE, atol=CLOSE)


def parts_fit(run):
    """Arcs lead from one to the next, jumps and accumulations between them; j counts the jumps."""
    for own, after in zip(run.arcs, run.arcs[1:], strict=False):
        assert after.t0 == pytest.approx(own.t1, abs=1e-15 * max(1.0, abs(own.t1)))
        assert after.j - own.j in (0, 1)
        if after.j == own.j:
            assert own.mode != after.mode
    assert run.arcs[-1].j == len(run.jumps)


@pytest.mark.parametrize("solver", ["taylor", "DOP853", "Dopri8"])
@pytest.mark.parametrize("name", RUNS)
def test_in_two_halves_as_in_one(name, solver):
    """Wherever the run is cut, on every solver."""
    model, start, (t0, t1), cuts = RUNS[name]
    options = {**SOLVERS[solver], "rtol": 1e-11, "atol": 1e-13}
    whole = hy.simulate(model, start, (t0, t1), **options)
    for cut in cuts:
        run = hy.simulate(model, start, (t0, cut), **options)
        more = hy.simulate(model, run, (cut, t1), **options)
        both = run + more
        the_same(both, whole)
        parts_fit(both)
        assert (both.t0, both.t1) == (t0, t1)
        assert both.stats.steps == run.stats.steps + more.stats.steps
        times = np.linspace(t0, t1, 41)
        far = np.min(np.abs(times[:, None] - whole.jumps.t), axis=1, initial=np.inf) > 1e-6
        for own, theirs in zip(both(times[far]), whole(times[far]), strict=True):
            np.testing.assert_allclose(own, theirs, rtol=CLOSE, atol=CLOSE)


@pytest.mark.parametrize("cut", [1.0, 1.9, 2, 2.5, np.nextafter(2.7388763964957996, 3.0)])
def test_what_a_jump_lets_forget_stays_forgotten(cut):
    """With memory="restart", also where the run is cut at a jump, or next to it."""
    options = {"solver": "taylor", "memory": "restart", "rtol": 1e-11, "atol": 1e-13}
    model, start = Pyragas(), [2.5, 0.0]
    whole = hy.simulate(model, start, (0.0, 5.0), history={"x1": 2.5, "x2": 0.0}, **options)
    cut = whole.jumps.t[cut] if isinstance(cut, int) else cut
    run = hy.simulate(model, start, (0.0, cut), history={"x1": 2.5, "x2": 0.0}, **options)
    both = run + hy.simulate(model, run, (cut, 5.0), **options)
    the_same(both, whole)
    parts_fit(both)


class Ticking(hy.Automaton):
    """Halved four times a unit of time, and counted."""

    x = hy.state()
    n = hy.state()

    @hy.mode
    def flow(self, t, s):
        return 1.0 - s.x, 0.0

    @hy.edge(flow, to=flow, every=0.25)
    def tick(self, t, s):
        return s.replace(x=0.5 * s.x, n=s.n + 1)


@pytest.mark.parametrize("solver", ["taylor", "DOP853", "Dopri8"])
@pytest.mark.parametrize("cut", [0.1, 0.25, 1.0, np.nextafter(1.0, 0.0), np.nextafter(1.0, 2.0)])
def test_a_clock_rings_once_at_the_cut(cut, solver):
    """At, just before and just behind one of its times; and behind the last jump allowed."""
    options = {**SOLVERS[solver], "rtol": 1e-11, "atol": 1e-13}
    whole = hy.simulate(Ticking(), [0.2, 0.0], (0.0, 2.0), **options)
    assert whole.final.n == 8
    for upto, most in ((cut, None), (2.0, 3)):
        run = hy.simulate(Ticking(), [0.2, 0.0], (0.0, upto), max_jumps=most, **options)
        the_same(run + hy.simulate(Ticking(), run, (run.t1, 2.0), **options), whole)


def ball(t, start=(1.0, 0.0), **options):
    return hy.simulate(BouncingBall(), start, t, **{"solver": "taylor", **options})


def test_the_arc_that_was_cut_is_one_arc():
    """Its dense output is that of both, and its start, end and number are the whole run's."""
    whole, run = ball((0.0, 0.7)), ball((0.0, 0.3))
    both = run + ball((0.3, 0.7), run)
    assert [(arc.mode, arc.j, arc.t0) for arc in both.arcs] == [
        (arc.mode, arc.j, arc.t0) for arc in whole.arcs
    ]
    assert len(both.arcs[0].segments) == 2
    assert both(0.3).x == pytest.approx(1.0 - 4.905 * 0.09, abs=1e-15)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7])
def test_going_on_behind_the_last_jump_allowed(count):
    """A run that has used up its jumps goes on with more; no jump is made twice."""
    model, start = BeadOnTable(r=0.6, omega=3.5), [1.5, 0.0]
    whole = hy.simulate(model, start, (0.0, 9.0), solver="taylor")
    run = hy.simulate(model, start, (0.0, 9.0), solver="taylor", max_jumps=count)
    assert run.status is hy.Status.MAX_JUMPS
    both = run + hy.simulate(model, run, (run.t1, 9.0), solver="taylor")
    the_same(both, whole)
    parts_fit(both)


@pytest.mark.parametrize("count", range(1, 6))
def test_two_edges_at_one_time_are_parted(count):
    """An edge that was zero with another, and waited, fires when the run goes on."""
    options = {"solver": "taylor"}
    whole = hy.simulate(Counter(a=0.5), [0.0, 0.0], (0.0, 1.0), **options)
    run = hy.simulate(Counter(a=0.5), [0.0, 0.0], (0.0, 1.0), max_jumps=count, **options)
    if run.status is hy.Status.MAX_JUMPS:
        run = run + hy.simulate(Counter(a=0.5), run, (run.t1, 1.0), **options)
    the_same(run, whole)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("jumps", [(), ("event",), ("ring",), ("event", "ring")])
@pytest.mark.parametrize("before", [1e-4, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12])
@pytest.mark.parametrize("r", [0.3, 0.8])
def test_a_run_cut_shortly_before_a_limit_lists_it(r, before, jumps, solver):
    """Be it at a jump, which does not fire again; what is lower than rounding rests there."""
    limit = 0.5 * (1.0 + r) / (1.0 - r)
    cut, options = limit - before, {"solver": solver, "rtol": 1e-12}
    model = Shelf(r=r, **(dict.fromkeys(("event", "ring"), 9.0) | dict.fromkeys(jumps, cut)))
    first = hy.simulate(model, {"x": 21.0, "v": 0.0}, (0.0, cut), **options)
    run = first + hy.simulate(model, first, (cut, 5.0), **options)
    (point,) = run.zeno
    assert abs(point.t - limit) <= point.t_error
    assert run.final.n == len(jumps)
    assert run.mode == "flight.rest(impact)"
    if len(jumps) < 2:  # an event fires up to 64 roundings before a clock at its time
        parts_fit(run)


@pytest.mark.parametrize("before", [1e-8, 1e-9, 1e-10, 1e-11])
def test_a_run_that_goes_on_at_rest_fits_one_that_ends_in_a_low_flight(before):
    """The second finds the last flight to be rounding and drops its speed; the two are one run."""
    spring, start = HardSpring(), [2.1, 0.0]
    whole = hy.simulate(spring, start, (0.0, 4.0), solver="taylor")
    cut = whole.zeno[0].t - before
    first = hy.simulate(spring, start, (0.0, cut), solver="taylor")
    run = first + hy.simulate(spring, first, (cut, 4.0), solver="taylor")
    assert (run.mode, run.final) == (whole.mode, whole.final)
    parts_fit(run)


def test_many_short_runs_are_one():
    """As a loop goes on that looks at each of them: through the limit, into the rest."""
    run = ball((0.0, 0.05))
    for k in range(2, 61):
        run = run + ball((run.t1, 0.05 * k), run)
    the_same(run, ball((0.0, 3.0)))
    parts_fit(run)


def test_a_bound_is_that_of_the_whole_run():
    """What the first run has lost is in the error of a limit of the second."""
    exact = hy.simulate(HardSpring(), [2.1, 0.0], (0.0, 2.0), solver="taylor").zeno[0].t
    coarse = {"solver": "scipy", "method": "RK23", "rtol": 1e-4, "atol": 1e-4}
    run = hy.simulate(HardSpring(), [2.1, 0.0], (0.0, 0.1), **coarse)
    for first in (run, pickle.loads(pickle.dumps(run))):
        more = hy.simulate(HardSpring(), first, (0.1, 2.0), solver="taylor")
        point = (first + more).zeno[0]
        assert 1e-9 < abs(point.t - exact) <= point.t_error < 1e-2
        last = hy.simulate(HardSpring(), first + more, (2.0, 2.1), solver="taylor")
        assert last.mode == more.mode


def test_a_release_belongs_to_the_rest_that_it_ends():
    """Also where the rest began in the first run."""
    model, start = BeadOnTable(r=0.6, omega=3.5), [1.5, 0.0]
    whole = hy.simulate(model, start, (0.0, 9.0), solver="taylor")
    t = next(point for point in whole.zeno if point.t_release)
    cut = 0.5 * (t.t + t.t_release)
    run = hy.simulate(model, start, (0.0, cut), solver="taylor")
    more = hy.simulate(model, run, (cut, 9.0), solver="taylor")
    assert run.zeno[-1].t_release is None
    released = [point.t_release for point in (run + more).zeno]
    assert released == [
        None if point.t_release is None else pytest.approx(point.t_release, abs=1e-10)
        for point in whole.zeno
    ]


def test_a_run_from_a_file_goes_on(tmp_path):
    """Bit for bit as the one that was saved."""
    run = ball((0.0, 1.2))
    run.save(tmp_path / "run.nc")
    loaded = hy.load(tmp_path / "run.nc")
    one, other = ball((1.2, 3.0), run), ball((1.2, 3.0), loaded)
    assert one.jumps.t.tolist() == other.jumps.t.tolist()
    assert other.zeno[0].t_error == one.zeno[0].t_error
    the_same(loaded + other, run + one)


def test_states_that_were_asked_for_are_joined():
    """Those at the cut once; a joined run can be saved and read."""
    run = ball((0.0, 1.0), save=np.linspace(0.0, 1.0, 5))
    both = run + ball((1.0, 3.0), run, save=np.linspace(1.0, 3.0, 9))
    assert both.options["times"].tolist() == np.linspace(0.0, 3.0, 13).tolist()
    times = both.to_xarray().time.values
    np.testing.assert_allclose(both.samples[:, 0], ball((0.0, 3.0))(times).x, atol=1e-12)


@pytest.mark.parametrize("steps", ["scipy", "taylor", "diffrax"])
@pytest.mark.parametrize("name", ["thermostat", "table", "kicked"])
def test_a_run_that_was_interrupted_goes_on(name, steps):
    """From where it came to: in the middle of an arc, or behind a jump."""
    model, start, (t0, t1), _ = RUNS[name]
    whole = hy.simulate(model, start, (t0, t1), rtol=1e-11, solver=steps)

    def stop(t):
        if t > t0 + 0.2 * (t1 - t0):
            raise KeyboardInterrupt

    run = hy.simulate(model, start, (t0, t1), solver=steps, rtol=1e-11, progress=stop)
    assert run.status is hy.Status.INTERRUPTED
    if run.t1 < t1:
        run = run + hy.simulate(model, run, (run.t1, t1), rtol=1e-11, solver=steps)
    the_same(run, whole)
    parts_fit(run)


@pytest.mark.parametrize("until", [0.3, 0.7, math.sqrt(2 / 9.81) * 2.4, 1.2, 3.0])
def test_a_run_of_a_few_impacts_goes_on(until):
    """Before its last impact, at the time at which the contact is held, and later."""
    whole = ball((0.0, 4.0), zeno="truncate", solver="taylor")
    for end in (until, whole.zeno[0].t):
        run = ball((0.0, end), zeno="truncate", solver="taylor")
        joined = run + ball((end, 4.0), run, zeno="truncate", solver="taylor")
        the_same(joined, whole)
        assert len(joined.jumps) == len(whole.jumps)


def test_a_run_from_a_file_goes_on_at_rest_though_its_load_sees_the_past(tmp_path):
    run = hy.simulate(Echoing(), [1.0, 0.0], (0.0, 3.0))
    run.save(tmp_path / "run.nc")
    loaded = hy.load(tmp_path / "run.nc")
    assert loaded.mode == "fly.rest(floor)"
    on = hy.simulate(Echoing(), loaded, (3.0, 4.0))
    assert (on.mode, *on.final) == ("fly.rest(floor)", 0.0, 0.0)


REFUSED = [
    (lambda run: ball((2.0, 3.0), run), r"ended at t = 1.0; write t=\(run.t1, ...\)"),
    (lambda run: ball((1.0, 3.0), run, mode="flight"), "mode is the run's own; leave it out"),
    (lambda run: hy.simulate(BouncingBall(r=0.5), run, (1.0, 3.0)), "r = 0.7, not 0.5"),
    (lambda run: hy.simulate(Thermostat(), run, (1.0, 3.0)), r"one of BouncingBall\(x, v\)"),
    (lambda _: ball((3.0, 4.0), ball((0.0, 3.0), zeno="stop")), "has ended for good. .*zeno='rest"),
    (lambda run: hy.ensemble(BouncingBall(), run, (1.0, 3.0)), "run.final"),
    (lambda run: run(0.5, True), "j = True: a whole number"),
    (lambda run: run + ball((0.0, 1.0)), "ended at t = 1.0, and the other begins at 0.0"),
    (lambda run: run + ball((1.0, 3.0)), r"ended at \(x=0.*, and the other begins at"),
    (lambda run: run + ball((1.0, 3.0), run, save="jumps"), "save='dense', and the other with"),
    (
        lambda run: run + hy.simulate(BouncingBall(r=0.5), run.final, (1.0, 3.0)),
        "r = 0.7, not 0.5 in the other",
    ),
]


@pytest.mark.parametrize(("act", "said"), REFUSED)
def test_what_does_not_fit_is_refused(act, said):
    """With a sentence that says what is there and what is due."""
    with pytest.raises((hy.OptionError, hy.StartError), match=said):
        act(ball((0.0, 1.0)))
    with pytest.raises(TypeError):
        ball((0.0, 1.0)) + 1
