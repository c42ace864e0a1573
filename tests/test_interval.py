"""The interval reader: what it returns holds for every point of a box."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flint import arb, ctx
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import hybrid as hy
from hybrid.bounds.balls import BALLS, Undefined, high, low
from hybrid.bounds.exact import FixedGraph
from hybrid.bounds.extrema import ScalarFunction, continuous, extrema
from hybrid.bounds.interval import IntervalProgram, Undecided, ball
from hybrid.lowering.arithmetic import FORGIVING, OPERATIONS
from hybrid.lowering.derivatives import along
from hybrid.lowering.graph import Graph
from hybrid.lowering.jaxpr import ELEMENTWISE, read
from hybrid.lowering.lowered import Lowered
from hybrid.lowering.ranges import RANGES
from hybrid.rules import unit
from hybrid.rules.bounds import outwards
from tests.test_readers import EXPRESSIONS, automaton

FLAGS = {"and", "or", "xor", "not"}
NUMBERS = sorted(set(OPERATIONS) - FLAGS - {"select", "real", "is_finite"})
TWO = {"add", "sub", "mul", "div", "pow", "rem", "max", "min", "atan2"} | {
    *("gt", "ge", "lt", "le", "eq", "ne")
}

#: Mixes values at which operations change their formula with arbitrary ones.
FLOATS = st.one_of(
    st.sampled_from([-2.5, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0]),
    st.floats(-6.0, 6.0, allow_subnormal=False).filter(lambda v: v == 0 or abs(v) > 1e-9),
)


@st.composite
def interval_and_point(draw):
    a, b = sorted((draw(FLOATS), draw(FLOATS)))
    share = draw(st.sampled_from([0.0, 0.25, 0.5, 0.9, 1.0]))
    return (a, b), min(max(a + share * (b - a), a), b)


def holds(enclosure, value):
    """A float computed with a few roundings of its own lies in the ball, up to those."""
    if isinstance(value, bool | np.bool_):
        return enclosure is None or enclosure == bool(value)
    room = 1e-13 * max(1.0, abs(value))
    return float(enclosure.lower()) - room <= value <= float(enclosure.upper()) + room


def plain(op, arguments):
    """IEEE arithmetic, as the generated code computes; nan where it is undefined."""
    with np.errstate(all="ignore"):
        try:
            return OPERATIONS[op](*arguments)
        except (ValueError, OverflowError, ZeroDivisionError):
            value = FORGIVING[op](*map(np.float64, arguments))
            return value if np.isfinite(value) else math.nan


@pytest.mark.parametrize("op", NUMBERS)
@settings(max_examples=80, deadline=None)
@given(st.data())
def test_every_operation_encloses_its_values(op, data):
    """At a point drawn from the box; an undefined value is never enclosed."""
    pairs = [data.draw(interval_and_point()) for _ in range(2 if op in TWO else 1)]
    with ctx.workprec(96):
        enclosure = BALLS[op](*(ball(bounds) for bounds, _ in pairs))
    if isinstance(enclosure, Undefined):
        return
    value = plain(op, [point for _, point in pairs])
    assert value == value, f"{op}{pairs} is not defined, but {enclosure} was returned"
    assert holds(enclosure, value), f"{op}{pairs} = {value} is not in {enclosure}"


def ranged(op, *boxes):
    """What is said of an operation on bounds."""
    graph = Graph()
    inputs = [graph.input(f"x{i}") for i in range(len(boxes))]
    node = graph.node("mul", *inputs, *inputs) if op == "square" else graph.node(op, *inputs)
    found = IntervalProgram(graph, [node]).ranges({f"x{i}": box for i, box in enumerate(boxes)})
    return found and found[0]


@pytest.mark.parametrize("op", RANGES)
@settings(max_examples=100, deadline=None)
@given(st.data())
def test_ranges_of_doubles_hold_the_values_of_an_operation(op, data):
    """Bounds in doubles hold what balls of many bits say of a point in the box."""
    drawn = [data.draw(interval_and_point()) for _ in range(2 if op in TWO else 1)]
    found = ranged(op, *(box for box, _ in drawn))
    assume(found is not None)
    with ctx.workprec(200):
        exact = BALLS[op](*(arb(point) for _, point in drawn))
        assert found[0] <= exact <= found[1]


@given(st.floats(allow_infinity=False, allow_nan=False))
def test_bounds_move_outwards_by_a_float(value):
    """By two where the spacing of floats no longer falls with their size."""
    low, high = outwards(value, value)
    one = math.nextafter(value, -math.inf), math.nextafter(value, math.inf)
    assert low <= one[0]
    assert high >= one[1]
    if abs(value) > 2.0**-1020:
        assert (low, high) == one
    assert low >= math.nextafter(one[0], -math.inf)
    assert high <= math.nextafter(one[1], math.inf)


@pytest.mark.parametrize("op", RANGES)
@settings(max_examples=50, deadline=None)
@given(st.data())
def test_values_at_points_are_those_of_an_operation(op, data):
    """One point beside another; NaN where the operation has no value."""
    graph, count = Graph(), 2 if op in TWO else 1
    inputs = [graph.input(f"x{i}") for i in range(count)]
    node = graph.node("mul", *inputs, *inputs) if op == "square" else graph.node(op, *inputs)
    program = IntervalProgram(graph, [node])
    points = np.array([[data.draw(FLOATS) for _ in range(3)] for _ in range(count)])
    found = np.zeros((len(program), 3))
    unit("bounds").at_points(program._ranges, 0, points, 3, found)
    there = found[program._ranges.results[0]].tolist()
    for point, value in zip(points.T.tolist(), there, strict=True):
        own = point * 2 if op == "square" else point
        exact = plain("mul" if op == "square" else op, own)
        assert value == pytest.approx(exact, rel=1e-15, nan_ok=True) or math.isinf(exact)


@pytest.mark.parametrize(("function", "op"), [(math.sin, "sin"), (math.cos, "cos")])
def test_ranges_of_waves_hold_their_turns(function, op):
    """Whatever half turns lie in an interval, their values 1 and -1 lie in the bounds."""
    for begin in np.arange(-10.0, 10.0, 0.37).tolist():
        for width in (0.0, 0.01, 1.0, 2.0, 3.5, 5.0, 7.0):
            least, most = ranged(op, (begin, begin + width))
            values = [function(v) for v in np.linspace(begin, begin + width, 400).tolist()]
            assert 0.0 <= min(values) - least <= 1e-4  # an extremum between two of 400 points
            assert 0.0 <= most - max(values) <= 1e-4


def test_a_range_is_left_to_balls_where_it_says_nothing():
    """Of a formula that is switched, of one beyond its domain, of an overflow nothing is said."""
    graph = Graph()
    x = graph.input("x0")
    ways = [graph.node("floor", x), graph.node("sqrt", x), graph.node("exp", x)]
    boxes = [(0.0, 0.5), (-1.0, 1.0), (0.0, 1e3)]
    for way, box in zip(ways, boxes, strict=True):
        assert IntervalProgram(graph, [way]).ranges({"x0": box}) is None


def test_every_operation_of_a_graph_has_a_rule():
    """What the other readers can compute, this one can bound."""
    assert set(OPERATIONS) | ELEMENTWISE <= set(BALLS) | {"select"}


@pytest.mark.parametrize("op", ["exp", "tanh", "sqrt", "atan", "erf", "cosh", "abs", "mul", "pow"])
def test_wide_balls_stay_tight(op):
    """Ends to ends: no more than the radius' 30 bits beyond the range."""
    second = {"mul": [(0.5, 3.0)], "pow": [3.0]}.get(op, [])
    enclosure = BALLS[op](ball((0.5, 2.5)), *map(ball, second))
    ends = [[0.5, 2.5], *([v] if isinstance(v, float) else list(v) for v in second)]
    values = [plain(op, p) for p in np.array(np.meshgrid(*ends)).reshape(len(ends), -1).T]
    assert float(enclosure.lower()) == pytest.approx(min(values), rel=1e-7)
    assert float(enclosure.upper()) == pytest.approx(max(values), rel=1e-7)


@pytest.mark.parametrize("flag", [True, False, None])
@pytest.mark.parametrize("other", [True, False, None])
def test_tests_that_are_not_decided(flag, other):
    """Three-valued logic: sure exactly where every case gives one answer."""
    cases = [[v] if v is not None else [True, False] for v in (flag, other)]
    for op in ("and", "or", "xor"):
        possible = {OPERATIONS[op](a, b) for a in cases[0] for b in cases[1]}
        assert BALLS[op](flag, other) == (possible.pop() if len(possible) == 1 else None)


def program_of(expression):
    code = Lowered(automaton(expression), ((),))
    graph = Graph()
    (roots,) = read(graph, code.closed("flow", "flow"), code.inputs(graph))
    return IntervalProgram(graph, roots), code.flow("flow").bind([0.7])


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_expressions_of_models_are_enclosed(name):
    """The reader beside the generated code, on random boxes and random points in them."""
    program, rhs = program_of(EXPRESSIONS[name])
    draw, decided = np.random.default_rng(0), 0
    for _ in range(60):
        centre, radius = draw.uniform(-1, 1, 3), 10.0 ** draw.uniform(-6, -0.5)
        box = [(c - radius, c + radius) for c in centre.tolist()]
        try:
            bounds = program([0.7], box[0], box[1:])
        except Undecided:
            continue
        decided += 1
        for _ in range(5):
            t, *x = [draw.uniform(a, b) for a, b in box]
            assert all(map(holds, bounds, rhs(t, x)))
    assert decided > 20


def test_domains_are_respected():
    """A root of what may be negative: no enclosure; in the branch not taken: no matter."""
    program, _ = program_of(lambda t, x, y: jnp.sqrt(x) + 1 / y)
    with pytest.raises(Undecided, match="outside its domain"):
        program([1.0], 0.0, [(-0.1, 1.0), 1.0])
    with pytest.raises(Undecided, match="may be zero"):
        program([1.0], 0.0, [1.0, (-0.1, 1.0)])
    guarded, _ = program_of(lambda t, x, y: jnp.where(x > 0, jnp.log(x), 0.0) + y)
    assert guarded([1.0], 0.0, [(-2.0, -1.0), 0.0])[0] == 0
    with pytest.raises(Undecided):
        guarded([1.0], 0.0, [(-2.0, 1.0), 0.0])


def test_a_square_is_not_negative():
    """Both factors are one node; balls alone would give [-1, 1]."""
    program, _ = program_of(lambda t, x, y: x * x + y**4 + (x - x))
    assert low(program([1.0], 0.0, [(-1.0, 1.0), (-1.0, 1.0)])[0]) >= 0.0


def test_the_lie_derivatives_of_a_moving_gap():
    """Gap, speed and acceleration over balls of parameters, time and state."""

    class Table(hy.Automaton):
        x = hy.state()
        v = hy.state()
        g = hy.parameter(9.8)
        omega = hy.parameter(2.0)

        @hy.mode
        def flight(self, t, s):
            return s.v, -self.g

        impact = hy.contact(
            flight, gap=lambda self, t, s: s.x - jnp.sin(self.omega * t), restitution=0.5
        )

    code = Lowered(Table, ((), ()))
    graph = FixedGraph(exact=True)
    inputs = code.inputs(graph)
    gap, *flow = (
        int(node)
        for closed in (code.closed("gap", "impact"), code.closed("flow", "flight"))
        for node in read(graph, closed, inputs)[0].reshape(-1)
    )
    moving = {
        int(inputs[-2]): graph.const(1.0),
        **dict(zip(map(int, inputs[-1]), flow, strict=True)),
    }
    speed = along(graph, gap, moving)
    enclosure = IntervalProgram(graph, [gap, speed, along(graph, speed, moving)])
    mode = code.mode("flight")
    exact = mode.program("lies", lambda: mode.lie("impact", False)).bind([9.8, 2.0, 0.0])
    bounds = enclosure([9.8, (1.999, 2.001)], (0.3, 0.31), [(1.0, 1.1), (-0.5, 0.5)])
    assert all(map(holds, bounds, exact(0.305, [1.05, 0.2])))
    acceleration = bounds[2]
    assert low(acceleration) > -9.8 + 4 * 0.55
    assert high(acceleration) < -9.8 + 4 * 0.6


# -- branch and bound -------------------------------------------------------------------


def function_of(expression):
    """An expression of t, x0, x1 with its gradient."""

    class Model(hy.Automaton):
        x = hy.state()
        y = hy.state()

        @hy.mode
        def flow(self, t, s):
            return s.x, s.y

    def stacked(parameters, t, x):
        value, slopes = jax.value_and_grad(lambda t, x: expression(t, *x), (0, 1))(t, x)
        return jnp.stack([value, slopes[0], *slopes[1]])

    code, graph = Lowered(Model, ()), Graph()
    (roots,) = read(graph, code.trace(stacked), code.inputs(graph))
    value, slopes = IntervalProgram(graph, roots[:1]), IntervalProgram(graph, roots[1:])
    return ScalarFunction(value, slopes, ["t", "x0", "x1"])


BOX = {"t": (0.0, 1.0), "x0": (2.0, 2.5), "x1": (-7.0, 7.0)}


def test_extrema_of_example_1():
    """Minus cos v - x^3: -7 at v = pi, -16.625 at v = 0, both bounds within 1e-11."""
    least, most = extrema(function_of(lambda t, x, v: -jnp.cos(v) - x**3), BOX)
    assert most.low <= -7.0 <= most.high
    assert most.high - most.low < 1e-11
    assert most.at["x0"] == 2.0
    assert abs(most.at["x1"]) == pytest.approx(math.pi, abs=1e-5)  # a flat maximum
    assert least.low <= -16.625 <= least.high
    assert least.high - least.low < 1e-10


@pytest.mark.parametrize(
    "expression",
    [
        lambda t, x, v: x * v - v * v * t,
        lambda t, x, v: jnp.abs(v - t) * jnp.exp(-x),
        lambda t, x, v: jnp.where(v > x, v, 0.5 * t),
        lambda t, x, v: jnp.maximum(jnp.sin(v), x - 2.2) / (1 + t * x),
        lambda t, x, v: jnp.sqrt(v + 7.0) * x,
    ],
)
def test_extrema_hold_and_are_attained(expression):
    """No value at a random point is outside; the bounds from inside are values."""
    function = function_of(expression)
    least, most = extrema(function, BOX, 1e-6)
    draw = np.random.default_rng(2)
    values = [float(expression(*(draw.uniform(a, b) for a, b in BOX.values()))) for _ in range(200)]
    assert least.low <= min(values)
    assert max(values) <= most.high
    for extreme in (least, most):
        point = {**{name: bounds[0] for name, bounds in BOX.items()}, **extreme.at}
        assert extreme.low <= function.at(point) <= extreme.high


@pytest.mark.long
def test_an_effort_that_ends_early_still_bounds():
    """A tolerance that cannot be met: wide, but true."""
    from hybrid.bounds.extrema import supremum

    function = function_of(lambda t, x, v: jnp.sin(5 * v) * jnp.cos(7 * x * t) * v)
    most = supremum(function, BOX, 0.0, effort=1)
    fine = supremum(function, BOX, 1e-9)
    assert most.low <= fine.low + 1e-9
    assert most.high >= fine.high - 1e-9
    assert most.high > most.low


def test_continuity_is_shown_or_not():
    """A step inside the box, an infinite slope at its edge, a kink."""
    assert continuous(function_of(lambda t, x, v: jnp.abs(v) + jnp.maximum(v, t)), BOX)
    assert continuous(function_of(lambda t, x, v: jnp.where(x > 1.0, v, -v)), BOX)
    assert not continuous(function_of(lambda t, x, v: jnp.where(v > 1.0, v, -v)), BOX)
    assert not continuous(function_of(lambda t, x, v: jnp.floor(v) + x), BOX)
    assert not continuous(function_of(lambda t, x, v: jnp.sqrt(v + 7.0)), BOX)


def test_bounds_as_floats_are_outside():
    """Rounded away from the ball, by at most one float."""
    with ctx.workprec(96):
        third = arb(1) / 3
    assert low(third) < high(third) == math.nextafter(low(third), 1.0)
    assert low(arb(0.1)) == high(arb(0.1)) == 0.1
