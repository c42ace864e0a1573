"""Rule 8 of docs/semantics.md, on every way in: cross a surface, slide, or refuse to choose."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

from ..switched import Pursuit, Quadrants, Rings, Timed
from .ways import SOLVERS_AND_COMPILED, spread

WAYS = SOLVERS_AND_COMPILED

TIGHT = {"rtol": 1e-9, "atol": 1e-11}

#: BDF and LSODA keep about this many digits at rtol 1e-9 (low order), RK23 is of order 3.
LOOSE = {"BDF": 2e-7, "LSODA": 2e-7, "RK23": 1e-7}


def tolerance(way, tight=1e-8):
    return LOOSE.get(way.name, tight)


class Sides(hy.Automaton):
    """On the sides of ``y = 0`` it goes at ``p + pt t`` and ``n + nt t``; ``x`` right, and left."""

    y = hy.state()
    x = hy.state()
    p: float = hy.parameter(-1.0)
    n: float = hy.parameter(1.0)
    pt: float = hy.parameter(0.0)
    nt: float = hy.parameter(0.0)
    at: float = hy.parameter(9.0, doc="when it is set onto the surface")

    @hy.mode(initial=True)
    def positive(self, t, s):
        return self.p + self.pt * t, 1.0

    @hy.mode
    def negative(self, t, s):
        return self.n + self.nt * t, -1.0

    surface = hy.switching(positive, negative, surface=lambda self, t, s: s.y)

    @hy.edge(positive, to=positive, guard=lambda self, t, s: self.at - t)
    def put(self, t, s):
        return s.replace(y=0.0)


class Strict(Sides):
    """Nothing may slide."""

    surface = hy.switching("positive", "negative", surface=lambda self, t, s: s.y, slides=False)


def went(way, result, edges, mode):
    """These jumps and no others, and where the run is then."""
    assert result.status == "reached_end"
    assert result.jumps == len(edges)
    if way.tells("edges"):
        assert result.edges == edges
    if way.tells("mode"):
        assert result.mode == mode


#: Side of the start, rates of both flows, and what follows: mode, and rates of y and x in it.
REACHED = [
    (+1, -1.0, -1.0, "negative", -1.0, -1.0),
    (-1, +1.0, +1.0, "positive", +1.0, +1.0),
    (+1, -1.0, +2.0, "slide(surface)", 0.0, 1 / 3),
    (-1, -2.0, +1.0, "slide(surface)", 0.0, -1 / 3),
    (+1, -1.0, +1e-3, "slide(surface)", 0.0, (1e-3 - 1.0) / (1e-3 + 1.0)),
]


def test_a_flow_that_reaches_the_surface_crosses_it_or_slides(way):
    """Both flows say which; the field there is the convex combination that stays on it."""
    for side, p, n, mode, up, right in REACHED:
        name = "positive" if side > 0 else "negative"
        start = {"y": float(side), "x": 0.0}
        result = way.run(Sides(p=p, n=n), start, (0.0, 3.0), mode=name, **TIGHT)
        went(way, result, ["surface"], mode)
        assert result.times[0] == pytest.approx(1.0, abs=tolerance(way))
        assert result.final.y == pytest.approx(2.0 * up, abs=tolerance(way))
        assert result.final.x == pytest.approx(side + 2.0 * right, abs=tolerance(way))
        assert result.final.y == 0.0 or mode != "slide(surface)"


def test_states_before_and_after_are_equal_and_on_the_surface(way):
    """Where sliding begins: exactly."""
    result = way.run(Sides(), {"y": 1.0, "x": 0.3}, (0.0, 3.0))
    assert result.after.y[0] == 0.0
    if way.tells("before"):
        assert result.before.y[0] == 0.0
        assert result.before.x[0] == result.after.x[0]


#: Rates and their slopes at a start on the surface, and the mode that follows.
STARTS = [
    (+1.0, +1.0, 0.0, 0.0, "positive"),
    (-1.0, -1.0, 0.0, 0.0, "negative"),
    (-1.0, +1.0, 0.0, 0.0, "slide(surface)"),
    (0.0, +1.0, +1.0, 0.0, "positive"),
    (-1.0, 0.0, 0.0, -1.0, "negative"),
    (0.0, +1.0, -1.0, 0.0, "slide(surface)"),
    (-1.0, 0.0, 0.0, +1.0, "slide(surface)"),
]


@pytest.mark.parametrize("named", ["positive", "negative"])
@pytest.mark.parametrize(("p", "n", "pt", "nt", "mode"), STARTS)
def test_a_start_on_the_surface_is_decided_by_the_same_table(way, p, n, pt, nt, mode, named):
    """Whichever of the two modes is named; a rate that is zero by the one after it."""
    model = Sides(p=p, n=n, pt=pt, nt=nt)
    result = way.run(model, {"y": 0.0, "x": 0.0}, (0.0, 1.0), mode=named, **TIGHT)
    went(way, result, ["surface"] if named != mode else [], mode)
    up = {"positive": p + pt / 2, "negative": n + nt / 2}.get(mode, 0.0)
    assert result.final.y == pytest.approx(up, abs=tolerance(way))


@pytest.mark.parametrize("named", ["positive", "negative"])
def test_two_ways_out_are_refused(way, named):
    """What follows is not unique."""
    result = way.run(Sides(p=1.0, n=-1.0), {"y": 0.0, "x": 0.0}, (0.0, 1.0), mode=named)
    assert result.status == "refused"
    if way.name != "as_function":  # which has a number for that
        assert "both lead away" in result.said


@pytest.mark.parametrize("named", ["positive", "negative"])
@pytest.mark.parametrize(("p", "n", "pt", "nt"), [(0, 0, -1, 1), (0, 0, 0, 0)])
def test_what_no_derivative_decides_is_refused(way, p, n, pt, nt, named):
    """Nor does ``a = b = 0`` say how fast it would slide."""
    model = Sides(p=float(p), n=float(n), pt=float(pt), nt=float(nt))
    result = way.run(model, {"y": 0.0, "x": 0.0}, (0.0, 1.0), mode=named)
    assert result.status == "refused"


@pytest.mark.parametrize(
    ("p", "n", "mode"),
    [(1.0, 1.0, "positive"), (-1.0, -1.0, "negative"), (-1.0, 1.0, "slide(surface)")],
)
def test_a_reset_onto_the_surface_is_decided_by_it_too(way, p, n, mode):
    """At 1/2, from far above."""
    result = way.run(Sides(p=p, n=n, at=0.5), {"y": 9.0, "x": 0.0}, (0.0, 1.0), **TIGHT)
    went(way, result, ["put"] + ["surface"] * (mode != "positive"), mode)
    up = {"positive": p, "negative": n}.get(mode, 0.0)
    assert result.final.y == pytest.approx(up / 2, abs=tolerance(way))


def test_sliding_can_be_forbidden(way):
    """A flow that would slide is refused, one that crosses is not."""
    start = {"y": 1.0, "x": 0.0}
    assert way.run(Strict(), start, (0.0, 3.0)).status == "refused"
    went(way, way.run(Strict(n=-1.0), start, (0.0, 3.0)), ["surface"], "negative")


#: Slopes of the rates from -1 and 1, and how sliding ends.
ENDS = [(+0.5, 0.0, "positive", 1.0), (0.0, -0.5, "negative", -1.0)]


@pytest.mark.parametrize(("pt", "nt", "side", "sign"), ENDS)
def test_sliding_ends_where_one_flow_leads_away(way, pt, nt, side, sign):
    """At 2, where its rate is zero; beyond it the surface function grows like a square."""
    result = way.run(Sides(pt=pt, nt=nt), {"y": 0.25, "x": 0.0}, (0.0, 4.0), **TIGHT)
    went(way, result, ["surface", f"surface.{side}"], side)
    assert result.times[1] == pytest.approx(2.0, abs=10 * tolerance(way))
    assert result.final.y == pytest.approx(sign, abs=10 * tolerance(way))


class Pushed(hy.Automaton):
    """It goes to ``y = 0`` at the rate 1 from both sides; after t = 2 it is pushed as well."""

    y = hy.state()
    push: float = hy.parameter(3.0)
    slope: float = hy.parameter(0.0)
    on: float = hy.parameter(2.0)

    def force(self, t):
        return jnp.where(t > self.on, self.push + self.slope * (t - self.on), 0.0)

    @hy.mode(initial=True)
    def positive(self, t, s):
        return (-1.0 + self.force(t),)

    @hy.mode
    def negative(self, t, s):
        return (1.0 + self.force(t),)

    surface = hy.switching(positive, negative, surface=lambda self, t, s: s.y)


#: Force after t = 2 and its slope, the side to which it pushes, and where it is a time of 1 later.
PUSHES = [
    (3.0, 0.0, "positive", 2.0),
    (-3.0, 0.0, "negative", -2.0),
    (3.0, -0.5, "positive", 1.75),
    (1.0, 1.0, "positive", 0.5),
    (-1.0, -1.0, "negative", -0.5),
    (1.0, 0.0, None, 0.0),
    (1.0, -1.0, None, 0.0),
    (0.9, 0.0, None, 0.0),
]


@pytest.mark.parametrize(("push", "slope", "side", "end"), PUSHES)
def test_sliding_ends_where_a_flow_jumps(way, push, slope, side, end):
    """A force that is switched on drives it off; one that just balances holds while it does."""
    result = way.run(Pushed(push=push, slope=slope), {"y": 0.25}, (0.0, 3.0), **TIGHT)
    edges = ["surface"] if side is None else ["surface", f"surface.{side}"]
    went(way, result, edges, side or "slide(surface)")
    assert result.final.y == pytest.approx(end, abs=tolerance(way))


@pytest.mark.parametrize("spacings", [1, 2, 8])
def test_sliding_may_end_within_rounding_of_the_start(way, spacings):
    """The force is switched on some spacings of the time after a start on the surface."""
    on = 2.0 + spacings * 2.0**-51
    result = way.run(Pushed(on=on), {"y": 0.0}, (2.0, 3.0), **TIGHT)
    assert result.final.y == pytest.approx(2.0, abs=tolerance(way))


def test_the_surfaces_own_motion_counts(way):
    """``x = 2 sin t`` is followed while ``2 |cos t| < 1``, until ``2 pi / 3``."""
    result = way.run(Pursuit(), {"x": 2.0}, (1.0, 3.0), mode="above", **TIGHT)
    went(way, result, ["target", "target.positive"], "above")
    end = 2 * np.pi / 3
    assert result.times[1] == pytest.approx(end, abs=10 * tolerance(way))
    assert result.final.x == pytest.approx(2 * np.sin(end) - (3.0 - end), abs=10 * tolerance(way))
    middle = way.run(Pursuit(), {"x": 2.0}, (1.0, 1.9), mode="above", **TIGHT)
    assert middle.final.x == pytest.approx(2 * np.sin(1.9), abs=1e-13)


@pytest.mark.each_method
def test_a_state_stays_on_a_curved_surface(way):
    """Angular speed 3/2 on the unit circle, which is held to rounding."""
    result = way.run(Rings(), {"x": 2.0, "y": 0.0}, (0.0, 20.0), **TIGHT)
    angle = np.log(2) + 1.5 * (20.0 - np.log(2))
    assert result.final.x**2 + result.final.y**2 == pytest.approx(1.0, abs=1e-12)
    # errors of steps add up over 30 radians
    assert result.final.x == pytest.approx(np.cos(angle), abs=30 * tolerance(way))


class Relieved(Timed):
    """An edge of ``down`` rings at 2 on the clock; one of the sliding mode itself at ``due``."""

    due: float = hy.parameter(9.0)

    @hy.edge("slide(relay)", to="off", guard=lambda self, t, s: self.due - s.clock)
    def relief(self, t, s):
        return s.replace(x=s.x + 7.0)


def test_edges_of_both_modes_are_watched_while_sliding(way):
    """The alarm leaves one of the two modes; it fires at 2 though neither flows alone."""
    result = way.run(Relieved(), [0.5, 0.0], (0.0, 3.0), **TIGHT)
    went(way, result, ["relay", "alarm"], "off")
    np.testing.assert_allclose(result.times, [0.5, 2.0], rtol=0, atol=tolerance(way))
    assert result.final.x == pytest.approx(3.0, abs=10 * tolerance(way))


@pytest.mark.parametrize("due", [1.5, 2.0])
def test_edges_of_the_sliding_mode_come_first(way, due):
    """Before the alarm, and in a tie with it."""
    result = way.run(Relieved(due=due), [0.5, 0.0], (0.0, 3.0), **TIGHT)
    went(way, result, ["relay", "relief"], "off")
    assert result.final.x == pytest.approx(7.0 + 3.0 * (3.0 - due), abs=10 * tolerance(way))


@pytest.mark.parametrize(("clock", "due"), [(1.4, 1.5), (1.8, 9.0)])
def test_guards_bound_where_a_state_may_slide(way, clock, due):
    """That of the sliding mode, and that of a mode of the switching, negative at the surface."""
    assert way.run(Relieved(due=due), [0.5, clock], (0.0, 3.0)).status == "refused"


def test_a_second_surface_is_refused_while_sliding(way):
    """Sliding north along x = 0 into y = 0."""
    result = way.run(Quadrants(), {"x": 0.5, "y": 1.0}, (0.0, 2.0))
    assert result.status == "refused"


def test_a_start_to_slide_must_be_on_the_surface_and_held_there(way):
    """On it and held there it slides on; else the start is refused."""
    start = {"y": 0.0, "x": 0.0}
    slides = way.run(Sides(), start, (0.0, 1.0), mode="slide(surface)")
    went(way, slides, [], "slide(surface)")
    for model, y in ((Sides(), 0.2), (Sides(p=1.0), 0.0), (Sides(n=-1.0), 0.0)):
        refused = way.run(model, {"y": y, "x": 0.0}, (0.0, 1.0), mode="slide(surface)")
        assert refused.status == "refused"


class Marked(hy.Automaton):
    """A relay across a surface that moves, which it does not leave, and marks on its way."""

    x = hy.state()
    y = hy.state()
    marks = hy.discrete(0)
    level: float = hy.parameter(0.1)

    @hy.mode(initial=True)
    def above(self, t, s):
        return 1.2 * jnp.sin(3.0 * t) - 2.0, jnp.cos(2.0 * t) - 0.5

    @hy.mode
    def below(self, t, s):
        return 1.2 * jnp.sin(3.0 * t) + 2.0, jnp.cos(2.0 * t) + 0.5

    relay = hy.switching(
        above, below, surface=lambda self, t, s: s.x + 0.5 * s.y - 0.3 * jnp.sin(2 * t)
    )

    @hy.edge(above, guard=lambda self, t, s: s.y - self.level, crossing=hy.EITHER)
    def mark(self, t, s):
        return s.replace(marks=s.marks + 1)


@pytest.mark.parametrize(
    ("way", "level"),
    spread(["DOP853", "RK45", "Radau", "taylor", "Tsit5"], [-0.3, -0.1, 0.0, 0.1, 0.2, 0.3]),
    indirect=["way"],
)
def test_a_mark_that_is_passed_while_sliding_counts_once(way, level):
    """The mark leads to a mode from whose flow the state slides on at once: that moves it onto the
    surface, by as much as the method's steps have led off it. There
    ``y' = 46/45 cos(2 t) - 4/15 sin(3 t)``."""
    start, end = {"x": 0.2, "y": 0.0}, 5.0
    run = way.run(Marked(level=level), start, (0.0, end), rtol=1e-8, atol=1e-10).run
    begins = run.jumps.t[run.jumps.edge == "relay"][0]
    t = np.linspace(begins, end, 100_001)
    y = 23.0 / 45.0 * np.sin(2.0 * t) + 4.0 / 45.0 * np.cos(3.0 * t)
    y += float(run(begins).y) - y[0] - level
    before = np.count_nonzero(run.jumps.t[run.jumps.edge == "mark"] < begins)
    assert run.final.marks == before + np.count_nonzero(np.diff(np.sign(y)))
