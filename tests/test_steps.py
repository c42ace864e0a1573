"""Steps and flights by rules: as machine code, and as Python that refuses indices below zero."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.errors import FlowError
from hybrid.lowering import tape as reader
from hybrid.lowering.lowered import ORDER
from hybrid.lowering.scene import scene_of
from hybrid.lowering.tape import KINDS, linked
from hybrid.rules.flights import TOO_LONG, most_pieces
from hybrid.rules.kinks import NO_SERIES, NOT_FINITE
from hybrid.rules.load import Library
from hybrid.rules.steps import NO_STEP
from hybrid.rules.terms import TERMS_BESIDE
from hybrid.solvers import taylor_backend
from hybrid.solvers.taylor_backend import TaylorSolver, TaylorStepper
from hybrid.zeno import flight
from hybrid.zeno.flight import falls, fly, room_for_sums

from .systems import Drag, ForcedOscillator, Oscillator

EPS = 2.0**-52


@pytest.fixture(params=["machine", "checked"], autouse=True)
def unit(request, monkeypatch):
    """The rules as machine code, and as plain Python that refuses indices below zero."""
    monkeypatch.setenv("HYBRID_RULES", request.param)
    unit = Library("hybrid.rules").unit
    for module in (reader, taylor_backend, flight):
        monkeypatch.setattr(module, "unit", unit)
    return unit


def field(expression):
    """The flow ``x' = expression(x, y)``, ``y' = 0``."""

    class Flow(hy.Automaton):
        x = hy.state()
        y = hy.state()

        @hy.mode
        def flow(self, t, s):
            return expression(s.x, s.y), 0.0

    return scene_of(Flow()).field("flow")


def start(field, x, t=0.0):
    return TaylorStepper(TaylorSolver(None, 0, 0), field, t, np.array(x, dtype=float), 1e3)


def stepped(unit, field, x, t=0.0, most=10.0, tau=0.0):
    """Status, length and kink of one step, the arrays it worked in, and the state at its end."""
    room, end = field.jets.room(ORDER), np.full(2, np.nan)
    *arrays, sides, _, _ = room
    made = unit("steps").step(
        *(field.jets.alone, 0, False, t, tau, np.array(x, dtype=float), most, np.zeros(3), sides),
        *(*arrays, end),
    )
    return made, room, end


# ---------------------------------------------------------------------------------------
# steps


def test_steps_are_exact_to_rounding():
    """x' = -0.7 x over twenty time constants: no more than the rounding of each step."""
    stepper, made = start(field(lambda x, y: -0.7 * x), [1.0, 0.0]), 0
    while stepper.tau < 30.0:
        stepper.step(30.0)
        made += 1
    assert stepper.tau == 30.0
    assert stepper.x[0] == pytest.approx(math.exp(-21.0), rel=made * 8 * EPS)


def test_a_step_is_no_longer_than_the_series_is_exact():
    """1 / (1 - t) has radius 1: the step is 0.1 of it, for order 16 and rounding."""
    stepper = start(field(lambda x, y: x * x), [1.0, 0.0])
    stepper.step(10.0)
    assert 0.05 < stepper.tau < 0.15
    assert stepper.x[0] == pytest.approx(1.0 / (1.0 - stepper.tau), rel=4 * EPS)


def test_a_step_ends_on_a_kink_and_the_next_is_on_its_other_side():
    """x' = 1 below 0.5, 1 + x above: the zero of ``x - 0.5`` to rounding, crossed once."""
    stepper = start(field(lambda x, y: jnp.where(x < 0.5, 1.0, 1.0 + x)), [0.0, 0.0])
    while stepper.tau < 0.5:
        stepper.step(2.0)
    assert (stepper.tau, stepper.x[0]) == pytest.approx((0.5, 0.5), rel=2 * EPS)
    assert sorted(map(abs, stepper.room.sides)) == [0] * (len(stepper.room.sides) - 1) + [1]
    stepper.step(1.0)
    grown = 1.5 * math.exp(stepper.tau - 0.5) - 1.0
    assert stepper.x[0] == pytest.approx(grown, rel=16 * EPS)


def test_a_step_cut_before_a_kink_forgets_its_side():
    """``land`` ends the step early: the kink is ahead again."""
    stepper = start(field(lambda x, y: jnp.where(x < 0.5, 1.0, 1.0 + x)), [0.0, 0.0])
    while stepper.tau < 0.5:
        stepper.step(2.0)
    segment = stepper.land(0.49)
    assert (segment.end, stepper.x[0]) == pytest.approx((0.49, 0.49), rel=4 * EPS)
    assert not stepper.room.sides.any()


def test_kinks_crossed_at_once_are_one_step(unit):
    """Two kinks on the same point, at which the step begins: both are on their far sides."""
    expression = lambda x, y: jnp.abs(x) + jnp.maximum(x, 0.0) + 1.0  # noqa: E731
    (status, h, _), room, end = stepped(unit, field(expression), [0.0, 0.0])
    assert status == 0
    assert h > 0.0
    assert end[0] == pytest.approx(0.5 * math.expm1(2.0 * h), rel=16 * EPS)
    assert room.c[0, 2] == 1.0


@pytest.mark.parametrize(
    ("unit", "width"),
    [("machine", 1e-2), ("machine", 1e-4), ("machine", 1e-6), ("checked", 1e-4)],
    indirect=["unit"],
)
def test_a_pulse_that_is_flat_to_rounding_from_afar_is_not_passed(width):
    """A Gaussian of area 1 at 0.5, of which no coefficient at 0 knows."""
    scale = 1.0 / (width * math.sqrt(math.pi))

    class Pulse(hy.Automaton):
        x = hy.state()

        @hy.mode
        def flow(self, t, s):
            return scale * jnp.exp(-(((t - 0.5) / width) ** 2))

    solver, field = TaylorSolver(None, 0, 0), scene_of(Pulse()).field("flow")
    stepper = TaylorStepper(solver, field, 0.0, np.zeros(1), 1.0)
    while stepper.tau < 1.0:
        stepper.step(1.0)
    assert stepper.x[0] == pytest.approx(1.0, abs=1e-13 + 4 * EPS / width)


def test_why_there_is_no_step(unit):
    """No series where a root begins; a state that is not finite; a jump that leads back."""
    root = field(lambda x, y: jnp.sqrt(x))
    assert stepped(unit, root, [0.0, 1.0])[0] == (NO_SERIES, 0.0, -1)
    ends = field(lambda x, y: jnp.sqrt(x) - 1e3)
    assert stepped(unit, ends, [math.nan, 1.0])[0][0] == NO_SERIES
    square = field(lambda x, y: x * x)
    assert stepped(unit, square, [1e200, 1.0])[0][0] in (NO_SERIES, NOT_FINITE, NO_STEP)
    back = field(lambda x, y: jnp.where(x > 0.0, -1.0, 1.0))
    stepper = start(back, [0.5, 0.0])
    stepper.step(2.0)
    with pytest.raises(FlowError, match=r"declare hy\.switching"):
        stepper.finish(2.0)


def test_the_state_may_be_stepped_in_place(unit):
    """``end`` may be the array of the state itself."""
    one = field(lambda x, y: jnp.where(x < 0.5, 1.0, 1.0 + x))
    *arrays, sides, _, _ = one.jets.room(ORDER)
    x, program = np.array([0.1, 0.2]), (one.jets.alone, 0, False)
    made = unit("steps").step(*program, 0.0, 0.0, x, 0.2, np.zeros(3), sides, *arrays, x)
    other, _, end = stepped(unit, one, [0.1, 0.2], most=0.2)
    assert made == other
    assert x.tolist() == end.tolist()


def test_a_program_steps_alike_among_others(unit):
    """The second of two linked programs, in arrays that are large enough for both."""
    first, second = field(lambda x, y: jnp.abs(x) - y), field(lambda x, y: jnp.sin(x) * y)
    alone, _, end = stepped(unit, second, [0.3, 0.4])
    both = linked([first.jets, second.jets])
    rows = max(part.jets.tape.rows for part in (first, second))
    work = np.empty(max(part.jets.tape.room for part in (first, second)))
    c, aside = np.empty((rows, ORDER + 1)), np.empty((rows, TERMS_BESIDE + 1))
    sides, there = np.zeros(9, dtype=np.int64), np.empty(2)
    _, _, _, *room, _, _, _ = second.jets.room(ORDER)
    made = unit("steps").step(
        *(both, 1, False, 0.0, 0.0, np.array([0.3, 0.4]), 10.0, np.zeros(3)),
        *(sides, c, aside, work, *room, there),
    )
    assert made == alone
    assert there.tolist() == end.tolist()


def test_kinds_are_numbered_alike():
    """What the rules call a step is the kind that the tape calls so."""
    from hybrid.rules import kinks

    named = {"step": kinks.STEP_KINK, "band": kinks.BAND, "pole": kinks.POLE, "point": kinks.POINT}
    assert named == {name: KINDS.index(name) for name in named}


# ---------------------------------------------------------------------------------------
# lengths


def test_the_length_of_a_geometric_series(unit):
    """1 + s/r + (s/r)^2 + ...: the last terms are a share of the first at share^(1/16) r."""
    for r in (1e-9, 1.0, 1e9):
        c = r ** -np.arange(ORDER + 1.0)
        assert unit("lengths").own_length(c, 1e-16) == pytest.approx(0.1 * r, rel=0.15)
    assert unit("lengths").step_length(np.ones((1, ORDER + 1)), 1) == pytest.approx(0.1, rel=0.15)


def test_the_length_of_a_series_whose_last_terms_are_next_to_nothing(unit):
    """It is that of the series up to those that are not."""
    c = 1e20 ** -np.arange(ORDER + 1.0)
    assert 0.0 < c[ORDER] < c[ORDER - 1] < 1e-290
    assert unit("lengths").own_length(c, 1e-16) == pytest.approx(10 ** (-16 / 13) * 1e20, rel=1e-9)
    short = c[: ORDER - 1].copy()
    c[ORDER - 1 :] = 0.0
    step = unit("lengths").step_length
    assert step(c[None], 1) == step(short[None], 1)


def test_no_length_is_longer_than_that_of_the_series(unit):
    """Whatever length is given; none is infinitely long, as a flight is of free fall."""
    c, least = 2.0 ** -np.arange(ORDER + 1.0), unit("lengths").min_own_length
    own = unit("lengths").own_length(c, 1e-16)
    assert least(c, 1e-16, math.inf) == least(c, 1e-16, 1e3) == own
    assert least(c, 1e-16, 0.5 * own) == 0.5 * own


def test_polynomials_are_exact_everywhere(unit):
    """No last terms, no end; a state that is zero and at rest asks for nothing."""
    c = np.zeros((2, ORDER + 1))
    c[0, :3] = 1.0, 2.0, 3.0
    assert unit("lengths").own_length(c[0], 1e-16) == math.inf
    assert unit("lengths").step_length(c, 2) == math.inf


def test_a_gap_falls_beyond_its_start():
    """s - s^2 falls at 1; from below zero nothing falls; beyond its reach it is not seen."""
    gap = [0.0, 1.0, -1.0, *[0.0] * (ORDER - 2)]
    assert falls([[1.0, *[0.0] * ORDER]], gap) == pytest.approx(1.0, rel=EPS)
    assert falls([[1.0, *[0.0] * ORDER]], [-1.0, *gap[1:]]) is None
    short = [[(1 / 0.05) ** k for k in range(ORDER + 1)]]
    assert falls(short, gap) is None
    assert falls(short, gap, 400.0) == pytest.approx(1.0, rel=EPS)


# ---------------------------------------------------------------------------------------
# flights


def falling(cls, mode, **parameters):
    return scene_of(cls(**parameters)).field(mode)


class Raised(hy.Automaton):
    """A ball over a floor at 2."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - 2.0, restitution=0.5)


class Distance(hy.Automaton):
    """A ball over the corner of ``|x|``."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0

    impact = hy.contact(flight, gap=lambda self, t, s: jnp.abs(s.x - 2.0), restitution=0.5)


class Stirred(hy.Automaton):
    """A ball over a floor at 0 whose weight changes at 0.3 of the way of a flight from 0."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, jnp.where(t < 0.3, -2.0, -1.0)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)


@pytest.mark.parametrize("v", [1e-17, 1e-9, 1e-3, 1.0])
def test_a_low_flight_is_as_exact_as_a_high_one(v):
    """Over a floor at 2 a flight of height 1e-34 is nothing beside the state: T = 2 v / g."""
    flown = fly(falling(Raised, "flight"), 0, 0.3, [2.0, v], v)
    assert flown is not None
    assert (flown.time, flown.u) == pytest.approx((v, -v), rel=4 * EPS)
    assert flown.x == pytest.approx([2.0, -v], rel=4 * EPS)
    assert (len(flown.pieces), flown.branch) == (1, ())


@pytest.mark.parametrize("v", [1e-17, 1e-8, 1e-3, 1.0])
def test_a_gap_may_have_its_corner_where_the_impacts_are(v):
    """Above it it is ``x - 2``, also where rounding puts the state on it or below."""
    flown = fly(falling(Distance, "flight"), 0, 0.5, [2.0, v], v)
    assert flown is not None
    assert (flown.time, flown.u) == pytest.approx((v, -v), rel=8 * EPS)


def test_a_flight_over_a_kink_says_so():
    """Gravity falls by half at 0.3: v^2 stays, but for what the change of force adds."""
    flown = fly(falling(Stirred, "flight"), 0, 0.0, [0.0, 1.0], 1.0)
    assert flown is not None
    height, speed = 0.3 - 0.09, 1.0 - 0.6
    u = -math.sqrt(speed**2 + 2 * height)
    assert (flown.time, flown.u) == pytest.approx((0.3 + speed - u, u), rel=16 * EPS)
    starts = [piece[0] for piece in flown.pieces]
    assert flown.branch in ((1, 0), (-1, 0))
    assert max(starts) == pytest.approx(0.3, rel=2 * EPS)
    segments = flown.segments()
    assert segments[-1].end == pytest.approx(flown.time, rel=2 * EPS)
    assert segments[0](0.2) == pytest.approx([0.16, 0.6], rel=8 * EPS)


def test_a_long_flight_belongs_to_the_solver(unit):
    """Many turns of a forced oscillator: the arrays for its pieces are not written beyond."""
    one = falling(ForcedOscillator, "flight")
    assert fly(one, 0, 0.0, [0.0, 1e9], 1e9) is None
    room, most = room_for_sums(one.jets.tape.needs, 2), 2
    starts, lengths = np.full(most + 1, -1.0), np.full(most + 1, -1.0)
    series = np.full((2 * most + 2, ORDER + 1), -1.0)
    room = room._replace(starts=starts[:most], lengths=lengths[:most])
    made = unit("flights").fly(
        *(one.jets.alone, 0, 0, False, 0.0, np.array([0.0, 1e3]), 1e3, room.c, series[:-2]),
        *(np.zeros(0, dtype=np.int64), 0.0, 1e-16, room),  # no guards are looked at
    )
    assert made[0] == TOO_LONG
    assert made[3] == most
    assert starts[most] == lengths[most] == -1.0
    assert (series[-2:] == -1.0).all()


def test_what_makes_a_flight_long():
    """A piece for each turn, and two for each kink."""
    assert most_pieces(0) + 4 == most_pieces(2)


def test_a_flight_without_series_is_none():
    """A state that is not a number; a ball that is thrown down."""
    one = falling(Drag, "flight")
    assert fly(one, 0, 0.0, [0.0, math.nan], 1.0) is None
    assert fly(one, 0, 0.0, [0.0, -1.0], -1.0) is None


def test_the_state_is_that_of_the_rounded_time():
    """Far from the start of an arc the end of a step is rounded to a spacing of 1e-11."""
    stepper = start(scene_of(Oscillator(wall=-5.0)).field("flight"), [1.0, 0.0])
    stepper.tau = begin = 1e5
    for _ in range(1000):
        stepper.step(2e5)
    # a rounding of the state in each step; those of the time would add up to some 1e-9
    assert stepper.x[0] == pytest.approx(math.cos(stepper.tau - begin), abs=1e-13)
