"""Cycles of jumps that accumulate, from every way in: resets that move the state among them."""

import math
from decimal import Decimal, localcontext
from fractions import Fraction
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from tests.test_cycles import Twisting

from .ways import later

#: Lanes and functions, which tell less, are in ``test_cycles_in_lanes.py``. A limit is found from
#: jumps, whatever made the steps between them: one method of SciPy stands for all, and Diffrax's
#: steps find some in ``tests/test_cycles.py``.
WAYS = ["DOP853", "taylor", *later("Radau", "Dopri8")]


#: A wheel of which a strike leaves a fourteenth of the speed.
STEEP = {"a": 0.75, "slope": 0.0}


class Wheel(hy.Automaton):
    """A wheel of spokes without a rim, which falls from spoke to spoke (McGeer 1990)."""

    q = hy.state(unit="rad", doc="angle of the spoke that stands")
    w = hy.state(unit="rad/s")

    a: float = hy.parameter(math.pi / 8, doc="half the angle between two spokes")
    slope: float = hy.parameter(0.02)
    g: float = hy.parameter(9.81, doc="gravity over the spokes' length")

    @hy.mode(initial=True)
    def stance(self, t, s):
        return s.w, self.g * jnp.sin(s.q)

    @hy.mode(limit_of=("fore", "back"))
    def stands(self, t, s):
        return 0.0 * s.w, 0.0 * s.q

    @hy.edge(stance, to=stance, guard=lambda self, t, s: self.slope + self.a - s.q)
    def fore(self, t, s):
        return s.replace(q=self.slope - self.a, w=s.w * jnp.cos(2 * self.a))

    @hy.edge(stance, to=stance, guard=lambda self, t, s: s.q - self.slope + self.a)
    def back(self, t, s):
        return s.replace(q=self.slope + self.a, w=s.w * jnp.cos(2 * self.a))


class Counted(hy.Automaton):
    """The same, which counts its steps, and names no mode for the limit; angles from the slope."""

    q = hy.state()
    w = hy.state()
    steps = hy.state()

    a: float = hy.parameter(math.pi / 8)
    g: float = hy.parameter(9.81)
    counts: float = hy.parameter(1.0)

    @hy.mode
    def stance(self, t, s):
        return s.w, self.g * jnp.sin(s.q), 0.0

    @hy.edge(stance, to=stance, guard=lambda self, t, s: self.a**2 - s.q**2)
    def strike(self, t, s):
        return -s.q, s.w * jnp.cos(2 * self.a), s.steps + self.counts


class Block(hy.Automaton):
    """A block that rocks from edge to edge (Housner 1963), at any angle."""

    angle = hy.state()
    rate = hy.state()

    p: float = hy.parameter(2.0)
    alpha: float = hy.parameter(0.25)
    r: float = hy.parameter(0.9)

    @hy.mode(initial=True)
    def right(self, t, s):
        return s.rate, -(self.p**2) * jnp.sin(self.alpha - s.angle)

    @hy.mode
    def left(self, t, s):
        return s.rate, self.p**2 * jnp.sin(self.alpha + s.angle)

    @hy.mode(limit_of=("to_left", "to_right"))
    def stands(self, t, s):
        return 0.0 * s.rate, 0.0 * s.angle

    @hy.edge(right, to=left, guard=lambda self, t, s: s.angle)
    def to_left(self, t, s):
        return s.angle, self.r * s.rate

    @hy.edge(left, to=right, guard=lambda self, t, s: s.angle, crossing=hy.RISING)
    def to_right(self, t, s):
        return s.angle, self.r * s.rate


class Fuller(hy.Automaton):
    """The control that is best for the integral of ``x^2`` (Fuller 1960): it switches for ever."""

    x = hy.state()
    v = hy.state()

    beta: float = hy.parameter(math.sqrt((math.sqrt(33.0) - 1.0) / 24.0))

    @hy.mode(initial=True)
    def pulls(self, t, s):
        return s.v, -1.0

    @hy.mode
    def pushes(self, t, s):
        return s.v, 1.0

    curve = hy.switching(
        pulls, pushes, surface=lambda self, t, s: s.x + self.beta * s.v * jnp.abs(s.v)
    )


class Signed(hy.Automaton):
    """The same with the control's sign as a state: it comes round after two jumps of one edge."""

    x = hy.state()
    v = hy.state()
    u = hy.state()

    beta: float = hy.parameter(math.sqrt((math.sqrt(33.0) - 1.0) / 24.0))

    @hy.mode
    def flow(self, t, s):
        return s.v, s.u, 0.0

    @hy.edge(flow, to=flow, guard=lambda self, t, s: -s.u * (s.x + self.beta * s.v * jnp.abs(s.v)))
    def turns(self, t, s):
        return s.x, s.v, -s.u


class Tanks(hy.Automaton):
    """Two leaking tanks and one hose, each tank with its own mark."""

    x1 = hy.state()
    x2 = hy.state()

    w: float = hy.parameter(1.8)
    v1: float = hy.parameter(1.0)
    v2: float = hy.parameter(1.0)
    low: float = hy.parameter(5.0)

    @hy.mode(initial=True)
    def fills_first(self, t, s):
        return self.w - self.v1, -self.v2

    @hy.mode
    def fills_second(self, t, s):
        return -self.v1, self.w - self.v2

    @hy.mode(limit_of=("to_second", "to_first"))
    def shares(self, t, s):
        falls = 0.5 * (self.w - self.v1 - self.v2)
        return falls, falls

    @hy.edge(fills_first, to=fills_second, guard=lambda self, t, s: s.x2 - self.low)
    def to_second(self, t, s):
        return s

    @hy.edge(fills_second, to=fills_first, guard=lambda self, t, s: s.x1 - self.low)
    def to_first(self, t, s):
        return s


class Clocked(Tanks):
    """The same, beside which a clock rings while the hose moves."""

    rings = hy.discrete(0)
    period: float = hy.parameter(1.5)

    @hy.edge(Tanks.fills_first, every="period")
    def rings_first(self, t, s):
        return s.replace(rings=s.rings + 1)

    @hy.edge(Tanks.fills_second, every="period")
    def rings_second(self, t, s):
        return s.replace(rings=s.rings + 1)


class Line(hy.Automaton):
    """Three particles on a line, and nothing else (McNamara and Young 1992)."""

    x = hy.state(shape=(3,))
    v = hy.state(shape=(3,))
    r: float = hy.parameter(0.05)

    @hy.mode
    def free(self, t, s):
        return s.v, jnp.zeros(3)

    left = hy.contact(free, gap=lambda self, t, s: s.x[1] - s.x[0], restitution="r")
    right = hy.contact(free, gap=lambda self, t, s: s.x[2] - s.x[1], restitution="r")


# ---------------------------------------------------------------------------------------
# the truth


POINTS, WEIGHTS = np.polynomial.legendre.leggauss(60)


def integral(f, end):
    """From 0 to ``end``, to rounding where ``f`` is smooth."""
    return float(0.5 * end * (WEIGHTS @ f(0.5 * end * (POINTS + 1.0))))


def swing(g, q, w):
    """How long ``q'' = g sin q`` takes from ``q < 0``, pushed up by ``w > 0``, back to ``q``."""
    way = 0.0  # to the highest angle, where cos is larger by w^2 / 2g: no digit is lost
    for _ in range(100):
        way = 2.0 * math.asin(w * w / (4.0 * g * math.sin(-q - 0.5 * way)))

    def slowness(phi):
        left = way * np.cos(phi) ** 2
        fast = 4.0 * g * np.sin(-q - way + 0.5 * left) * np.sin(0.5 * left)
        return 2.0 * way * np.cos(phi) * np.sin(phi) / np.sqrt(fast)

    return 2.0 * integral(slowness, 0.5 * math.pi)


def falls(g, w, up_to):
    """How long ``q'' = g sin q`` takes from 0 with ``w > 0`` to ``up_to``, and how fast it is."""

    def speed(angle):
        return np.sqrt(w * w + 4.0 * g * np.sin(0.5 * angle) ** 2)

    # in u with angle = w sinh(u), which takes away the slow beginning
    time = integral(lambda u: w * np.cosh(u) / speed(w * np.sinh(u)), math.asinh(up_to / w))
    return time, float(speed(up_to))


@cache
def stops(a, slope, g, w):
    """When the wheel, upright with a speed too small to go on, comes to stand on two spokes."""
    t, w = falls(g, w, slope + a)
    times, legs = [t], [slope - a, -(slope + a)]  # after a strike fore, and (mirrored) after back
    while w > 1e-20:
        w *= math.cos(2 * a)
        assert 0.5 * w * w + g * math.cos(legs[0]) < g  # it does not go over
        times.append(swing(g, legs[0], w))
        legs.reverse()
    return math.fsum(times)


def stop_of(model, w):
    """The same of a model."""
    return stops(*(float(v) for v in (model.a, getattr(model, "slope", 0.0), model.g)), w)


@cache
def stands(p, alpha, r, rate):
    """When the block, on its edge with a rate, comes to stand."""
    rates = rate * r ** np.arange(math.ceil(math.log(1e-20 / rate) / math.log(r)))
    return math.fsum(swing(p * p, -alpha, float(w)) for w in rates)


def collapses(r, x, v):
    """When three particles collapse, and where: their impacts one by one, in many digits."""
    with localcontext() as context:
        context.prec = 80
        x, v, r = [Decimal(c) for c in x], [Decimal(c) for c in v], Decimal(r)
        t, last = Decimal(0), None
        for _ in range(1000):
            pairs = [(i, (x[i + 1] - x[i]) / (v[i] - v[i + 1])) for i in (0, 1) if v[i] > v[i + 1]]
            pairs = [pair for pair in pairs if pair[0] != last]
            if not pairs:
                return None
            last, wait = min(pairs, key=lambda pair: pair[1])
            t, x = t + wait, [c + u * wait for c, u in zip(x, v, strict=True)]
            mean, half = (v[last] + v[last + 1]) / 2, (v[last] - v[last + 1]) / 2
            v[last], v[last + 1] = mean - r * half, mean + r * half
            if wait < Decimal("1e-30"):
                return float(t), float(x[0])
        return None


# ---------------------------------------------------------------------------------------
# resets that move the state


@pytest.mark.parametrize(
    "numbers",
    [
        {},
        {"a": 0.4, "slope": 0.0, "g": 1.0},
        {"a": 0.3, "slope": 0.01},
        {"a": 0.6, "slope": -0.1, "g": 1.6},
        STEEP,
    ],
)
def test_a_wheel_comes_to_stand_on_two_spokes(way, numbers):
    """The limit is a cycle of two states; its time is right within its error."""
    model = Wheel(**numbers)
    exact = stop_of(model, 0.3)
    result = way.run(model, {"q": 0.0, "w": 0.3}, (0.0, exact + 1.0), rtol=1e-9, atol=1e-11)
    (point,) = result.zeno
    assert set(point.edges) == {"fore", "back"}
    assert abs(point.t - exact) <= point.t_error < 1e-5
    if way.name != "LSODA":  # whose own error is larger than its last flights
        assert point.ratio == pytest.approx(math.cos(2 * model.a) ** 2, rel=1e-2)
    assert result.mode == "stands"
    (first, fore), (last, back) = point.limits
    assert (first, last) == ("fore", "back")  # the last is the one that limit_of names last
    assert fore.q == pytest.approx(float(model.slope - model.a), abs=1e-9)
    assert back.q == point.state.q == pytest.approx(float(model.slope + model.a), abs=1e-9)
    assert abs(fore.w) < 1e-6
    assert abs(back.w) < 1e-6


def test_a_run_that_nothing_follows_ends_at_the_limit(way):
    """One edge whose states come round after two jumps; the status says what to declare."""
    model = Counted(a=0.4, g=1.0, counts=0.0)
    exact = stops(0.4, 0.0, 1.0, 0.3)
    start = {"q": 0.0, "w": 0.3, "steps": 0.0}
    result = way.run(model, start, (0.0, 60.0), rtol=1e-9, atol=1e-11)
    (point,) = result.zeno
    assert result.status == "no_rest"
    assert "limit_of=" in result.said
    assert abs(point.t - exact) <= point.t_error < 1e-5
    assert result.t == point.t
    assert point.ratio == pytest.approx(math.cos(0.8), rel=1e-2)
    assert [edge for edge, _ in point.limits] == ["strike", "strike"]
    assert sorted(float(x.q) for _, x in point.limits) == pytest.approx([-0.4, 0.4], abs=1e-9)


def test_zeno_stop_and_raise_are_honoured(way):
    """As for every other accumulation."""
    model, start = Wheel(), {"q": 0.0, "w": 0.3}
    assert way.run(model, start, (0.0, 4.0), zeno="stop").status == "zeno_stopped"
    result = way.run(model, start, (0.0, 4.0), zeno="raise")
    assert result.status == "zeno_raised"
    assert "fore" in result.said
    assert "accumulate at t_inf = 2.65310" in result.said


@pytest.mark.parametrize("w", [0.3, 0.6])
def test_no_wheel_falls_through_the_floor(way, w):
    """Whatever else is said: a state outside the mode's domain is not passed over."""
    model = Wheel()
    result = way.run(model, {"q": 0.0, "w": w}, (0.0, 4.0))
    if result.status == "reached_end":
        assert abs(result.final.q - model.slope) <= model.a + 1e-8


def test_a_count_is_no_limit(way):
    """Jumps accumulate in time, but not in the state: no accumulation, and no silent end."""
    start = {"q": 0.0, "w": 0.3, "steps": 0.0}
    result = way.run(Counted(), start, (0.0, 4.0), max_jumps=1000)
    assert not result.zeno
    assert result.status in ("jump_loop", "refused")
    assert "strike" in result.said


# ---------------------------------------------------------------------------------------
# fast cycles and slow ones


@pytest.mark.parametrize(
    "w", [1.0 + 1e-9, 1.01, 1.3, 1.9, *later(1.0001, 1.1, 1.25, 1.4, 1.6, 1.95, 1.99)]
)
def test_two_tanks_run_down_at_every_inflow(way, w):
    """Between one leak and both: all is over when the two have lost what is above their marks."""
    exact = 4.0 / (2.0 - w)
    result = way.run(Tanks(w=w), {"x1": 8.0, "x2": 6.0}, (0.0, exact + 5.0))
    (point,) = result.zeno
    assert abs(point.t - exact) <= point.t_error < 1e-11 * exact / (2.0 - w)
    assert point.state.x1 == pytest.approx(5.0, abs=1e-9)
    assert point.state.x2 == pytest.approx(5.0, abs=1e-9)
    assert result.mode == "shares"


@pytest.mark.parametrize(
    ("w", "v1", "v2", "low"),
    [(1.5, 1.4, 0.9, 5.0), (2e-3, 1.9e-3, 1e-3, 0.0), (3.0, 2.9, 2.8, -4.0)],
)
def test_two_tanks_of_other_leaks_and_marks(way, w, v1, v2, low):
    """The total falls evenly; the ratio is the product of the two."""
    model = Tanks(w=w, v1=v1, v2=v2, low=low)
    exact = 4.0 / (v1 + v2 - w)
    result = way.run(model, {"x1": low + 3.0, "x2": low + 1.0}, (0.0, 1.2 * exact))
    (point,) = result.zeno
    assert abs(point.t - exact) <= point.t_error < 1e-10 * exact
    assert point.ratio == pytest.approx((w - v1) * (w - v2) / (v1 * v2), rel=1e-2)


def test_an_inflow_of_one_leak_runs_down_at_once(way):
    """The limit is reached after two jumps; the mode for it is entered where it is declared."""
    result = way.run(Tanks(w=1.0), {"x1": 8.0, "x2": 6.0}, (0.0, 10.0))
    (point,) = result.zeno
    assert abs(point.t - 4.0) <= point.t_error < 1e-11
    assert point.ratio == 0.0
    assert result.mode == "shares"


def test_too_little_inflow_is_refused(way):
    """Below one leak both tanks fall: the hose comes to a tank that is below its mark already."""
    result = way.run(Tanks(w=0.5), {"x1": 8.0, "x2": 6.0}, (0.0, 10.0))
    assert result.status == "refused"


@pytest.mark.parametrize("r", [0.2, 0.5, 0.8, 0.925])
def test_a_block_comes_to_stand(way, r):
    """Every swing is shorter than the one before, by the pendulum's own time."""
    model = Block(r=r)
    exact = stands(2.0, 0.25, r, 0.4)
    start = {"angle": 0.0, "rate": 0.4}
    result = way.run(model, start, (0.0, exact + 1.0), rtol=1e-9, atol=1e-11)
    (point,) = result.zeno
    assert abs(point.t - exact) <= point.t_error < 1e-4
    assert point.ratio == pytest.approx(r * r, rel=2e-2)
    assert result.mode == "stands"


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_the_twisting_controller_reaches_the_origin(way, scale):
    """Four switchings, from larger and smaller starts: half turns shrink by 1/3 in ``x``."""
    result = way.run(Twisting(), {"x": scale, "v": 0.0}, (0, 9))
    half = math.sqrt(scale) * (math.sqrt(2.0) + math.sqrt(2.0) / 3.0)
    (point,) = result.zeno
    assert abs(point.t - half / (1.0 - math.sqrt(1 / 3))) <= point.t_error < 1e-6
    assert point.ratio == pytest.approx(1 / 3, rel=1e-2)
    assert result.mode == "rests"


def fuller(beta):
    """Fuller's ratio, and the time from (1, 0) to the origin: parabola after parabola."""
    ratio = math.sqrt((0.5 - beta) / (0.5 + beta))
    return ratio, (1.0 + (1.0 + ratio) / (1.0 - ratio)) / math.sqrt(0.5 + beta)


@pytest.mark.parametrize("beta", [Fuller().beta, 0.49, 0.35])
def test_fullers_problem(way, beta):
    """Each switching comes 0.2421 of the time after the last that the last came after its own."""
    ratio, exact = fuller(float(beta))
    result = way.run(Fuller(beta=beta), {"x": 1.0, "v": 0.0}, (0.0, 9.0))
    (point,) = result.zeno
    assert abs(point.t - exact) <= point.t_error < 1e-6
    assert point.ratio == pytest.approx(ratio, rel=1e-2)
    assert point.edges == ("curve",)


def test_a_sign_that_changes_has_no_limit_but_two(way):
    """The control is 1 and -1 by turns, and never nought."""
    ratio, exact = fuller(float(Signed().beta))
    result = way.run(Signed(), {"x": 1.0, "v": 0.0, "u": -1.0}, (0.0, 9.0))
    (point,) = result.zeno
    assert abs(point.t - exact) <= point.t_error < 1e-6
    assert sorted(float(x.u) for _, x in point.limits) == pytest.approx([-1.0, 1.0], abs=1e-12)
    assert point.ratio == pytest.approx(ratio, rel=1e-2)


@pytest.mark.parametrize("r", [0.05, 0.06])
def test_three_particles_collapse(way, r):
    """Below r = 7 - 4 sqrt(3) the middle one strikes by turns for ever, in finite time."""
    x, v = [-1.0, 0.0, 1.0], [1.0, 0.2, -1.0]
    exact, place = collapses(r, x, v)
    result = way.run(Line(r=r), {"x": np.array(x), "v": np.array(v)}, (0.0, 3.0))
    (point,) = result.zeno
    assert abs(point.t - exact) <= point.t_error < 1e-6
    assert point.state.x == pytest.approx([place] * 3, abs=1e-7)
    assert result.mode == "free.rest(left, right)"
    assert result.final.v == pytest.approx([sum(v) / 3] * 3, abs=1e-7)


def test_three_particles_collapse_at_once(way):
    """Gaps drown in the rounding of the positions before the speeds have settled: the bound says
    how long the flights may be that are hidden in it."""
    x, v = [-1.0, 0.0, 1.0], [1.0, 0.2, -1.0]
    result = way.run(Line(r=0.03), {"x": np.array(x), "v": np.array(v)}, (0.0, 3.0))
    (point,) = result.zeno
    assert abs(point.t - collapses(0.03, x, v)[0]) <= point.t_error


def test_three_particles_go_on_together(way):
    """Listed or not, after the collapse they share their momentum."""
    x, v = [-1.0, 0.0, 1.0], [1.0, 0.2, -1.0]
    result = way.run(Line(r=0.03), {"x": np.array(x), "v": np.array(v)}, (0.0, 3.0))
    assert result.status == "reached_end"
    assert result.final.v == pytest.approx([sum(v) / 3] * 3, abs=1e-7)


def rows(n, r, mass=None, rests=True):
    """Particles in a row, of which each has its restitution with the one before it."""

    class Row(hy.Automaton):
        x = hy.state(shape=(n,))
        v = hy.state(shape=(n,))

        @hy.mode
        def free(self, t, s):
            return s.v, jnp.zeros(n)

        for i in range(1, n):
            vars()[f"c{i}"] = hy.contact(
                free,
                gap=lambda self, t, s, i=i: s.x[i] - s.x[i - 1],
                restitution=r,
                rests=rests,
                inverse_mass=None if mass is None else [1.0 / mass[i - 1], 1.0 / mass[i]],
            )
        del i

    return Row()


def column(n):
    """Beads above each other and a floor, each contact with the same restitution."""

    class Column(hy.Automaton):
        x = hy.state(shape=(n,))
        v = hy.state(shape=(n,))
        r = hy.parameter(0.5)

        @hy.mode
        def falls(self, t, s):
            return s.v, jnp.full(n, -9.81)

        c0 = hy.contact(falls, gap=lambda self, t, s: s.x[0], restitution="r")
        for i in range(1, n):
            vars()[f"c{i}"] = hy.contact(
                falls, gap=lambda self, t, s, i=i: s.x[i] - s.x[i - 1], restitution="r"
            )
        del i

    return Column


def thrown(way, model, n, speed=1.0, until=2.0):
    """A particle is thrown at others that touch and are at rest: it meets them at 1."""
    start = {"x": np.array([-speed] + [0.0] * (n - 1)), "v": np.array([speed] + [0.0] * (n - 1))}
    return way.run(model, start, (0.0, until))


def exact_row(n, r, most=10_000):
    """Speeds after the impacts at one instant, of which the first declared is the next; None where
    there are more than so many."""
    v, r = [Fraction(1)] + [Fraction(0)] * (n - 1), Fraction(r)
    for _ in range(most):
        i = next((i for i in range(n - 1) if v[i] > v[i + 1]), None)
        if i is None:
            return [float(c) for c in v]
        mean, half = (v[i] + v[i + 1]) / 2, (v[i] - v[i + 1]) / 2
        v[i], v[i + 1] = mean - r * half, mean + r * half
    return None


EDGE = 7.0 - 4.0 * math.sqrt(3.0)


@pytest.mark.parametrize("speed", [1.0, 1e-6, 1e6])
@pytest.mark.parametrize("r", [0.05, EDGE - 1e-3])
def test_touching_particles_that_strike_by_turns_for_ever_stay_together(way, r, speed):
    """At one instant: each turn of two impacts multiplies the gap speeds by one eigenvalue."""
    half = (1.0 + r) / 2.0  # an impact takes 1 + r of its own gap speed, and adds half to the other
    turn = np.array([[-r, 0.0], [half, 1.0]]) @ np.array([[1.0, half], [0.0, -r]])
    result = thrown(way, rows(3, r), 3, speed)
    (point,) = result.zeno
    assert abs(point.t - 1.0) <= point.t_error < 1e-9
    assert point.edges == ("c1", "c2")
    assert point.ratio == pytest.approx(max(np.linalg.eigvals(turn)), rel=1e-8)
    assert result.mode == "free.rest(c1, c2)"
    np.testing.assert_allclose(result.final.v, speed / 3.0, rtol=1e-12)


def test_touching_particles_that_strike_a_few_times_only_do_not_accumulate(way):
    """Just above the edge the last speeds are rounding, but there is a last impact."""
    result = thrown(way, rows(3, EDGE + 1e-3), 3)
    assert not result.zeno
    exact = exact_row(3, EDGE + 1e-3)
    np.testing.assert_allclose(result.final.v, exact, rtol=1e-12)
    assert len(result.times) < 40


@pytest.mark.parametrize(("n", "r"), [(3, 0.5), (4, 0.5), (8, 0.5), (8, 0.6), (9, 0.5)])
def test_touching_particles_part_after_their_last_impact(way, n, r):
    """As in rationals, impact by impact."""
    result = thrown(way, rows(n, r), n)
    assert not result.zeno
    np.testing.assert_allclose(result.final.v, exact_row(n, r), rtol=1e-11)


@pytest.mark.parametrize(("n", "r"), [(4, 0.1), (5, 0.2), *later((4, 0.15), (10, 0.5))])
def test_rows_whose_impacts_never_end_stay_together(way, n, r):
    """They share the momentum: every contact is struck again and again."""
    assert exact_row(n, r, 500) is None
    result = thrown(way, rows(n, r), n)
    (point,) = result.zeno
    assert abs(point.t - 1.0) <= point.t_error < 1e-9
    assert 0.0 < point.ratio < 1.0
    assert result.mode == f"free.rest({', '.join(f'c{i}' for i in range(1, n))})"
    np.testing.assert_allclose(result.final.v, 1.0 / n, rtol=1e-12)


@pytest.mark.parametrize(("n", "r"), [(5, 0.1), (11, 0.5), (12, 0.1)])
def test_after_infinitely_many_impacts_others_follow_at_the_same_instant(way, n, r):
    """Those behind are struck when the first have come to rest, which are struck anew: infinitely
    many times infinitely many impacts, of which all share the momentum."""
    result = thrown(way, rows(n, r), n)
    (point,) = result.zeno
    assert abs(point.t - 1.0) <= point.t_error < 1e-9
    assert len(point.edges) == n - 1
    np.testing.assert_allclose(result.final.v, 1.0 / n, rtol=1e-11)


@pytest.mark.parametrize(("n", "r"), [(4, 0.1), (5, 0.1), *later((12, 0.1))])
def test_a_column_that_falls_collapses_bead_by_bead(way, n, r):
    """The last bead strikes a heap at rest, and all impacts that follow happen as it lands: gaps
    are crossed in less time than can be told, each after infinitely many impacts below it."""
    start = {"x": 1.0 + 0.1 * np.arange(n), "v": np.zeros(n)}
    result = way.run(column(n)(r=r), start, (0.0, 2.0))
    assert result.status == "reached_end"
    point = result.zeno[-1]
    assert abs(point.t - math.sqrt(2.0 * start["x"][-1] / 9.81)) <= point.t_error < 1e-9
    assert len(point.edges) == n
    np.testing.assert_allclose(result.final.x, 0.0, atol=1e-9)
    np.testing.assert_allclose(result.final.v, 0.0, atol=1e-9)


@pytest.mark.parametrize(("mass", "r"), [([3.0, 1.0, 2.0], 0.1), ([1.0, 0.25, 2.0, 4.0], 0.3)])
def test_particles_of_other_masses_share_their_momentum(way, mass, r):
    """A light one between heavy ones is struck by turns for ever at larger restitutions, too."""
    result = thrown(way, rows(len(mass), r, mass), len(mass))
    assert result.zeno  # of four the last is struck anew and anew, after infinitely many impacts
    np.testing.assert_allclose(result.final.v, mass[0] / sum(mass), rtol=1e-11)


def test_three_particles_part(way):
    """Above that they strike a few times only."""
    x, v = [-1.0, 0.0, 1.0], [1.0, 0.2, -1.0]
    assert collapses(0.1, x, v) is None
    result = way.run(Line(r=0.1), {"x": np.array(x), "v": np.array(v)}, (0.0, 3.0))
    assert not result.zeno
    assert result.status == "reached_end"


class Closing(hy.Automaton):
    """A body between a wall and one that comes nearer, with no force."""

    x = hy.state()
    v = hy.state()

    u = hy.parameter(0.5)
    r = hy.parameter(0.9)

    @hy.mode
    def between(self, t, s):
        return s.v, 0.0

    still = hy.contact(
        between, gap=lambda self, t, s: s.x, restitution=lambda self, t, s, u: self.r
    )
    nears = hy.contact(
        between,
        gap=lambda self, t, s: 1.0 - self.u * t - s.x,
        restitution=lambda self, t, s, u: self.r,
    )


@pytest.mark.parametrize(("u", "r"), [(0.5, 0.9), (0.1, 0.5)])
def test_walls_that_close_on_a_body_leave_it_no_rest(way, u, r):
    """They meet at 1/u, and the run ends there."""
    result = way.run(Closing(u=u, r=r), {"x": 0.5, "v": 1.0}, (0.0, 3.0 / u))
    assert result.status == "no_rest"
    assert result.t == result.zeno[0].t
    assert abs(result.zeno[0].t - 1.0 / u) <= result.zeno[0].t_error < 1e-6


class Stairs(hy.Automaton):
    """A ball that steps down a stair, each a quarter of the one before, when it has come to rest
    and waited."""

    x = hy.state()
    v = hy.state()
    floor = hy.state()
    step = hy.state()
    waits = hy.state()

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -9.81, 0.0, 0.0, 0.0

    @hy.edge(flight, to=flight, guard=lambda self, t, s: s.x - s.floor)
    def hit(self, t, s):
        return s.replace(v=-0.5 * s.v)

    @hy.mode(limit_of=("hit",))
    def rest(self, t, s):
        return 0.0, 0.0, 0.0, 0.0, 1.0

    @hy.edge(rest, to=flight, guard=lambda self, t, s: s.step - s.waits)
    def down(self, t, s):
        return s.replace(floor=s.floor - s.step, step=0.25 * s.step, waits=0.0)


def test_accumulations_that_accumulate_in_turn_are_said_to(way):
    """About where they do: falls with their impacts sum to 9 sqrt(2 / g), waits to 4 / 3."""
    start = {"x": 1.0, "v": 0.0, "floor": 0.0, "step": 1.0, "waits": 0.0}
    result = way.run(Stairs(), start, (0.0, 8.0))
    exact = 9.0 * math.sqrt(2.0 / 9.81) + 4.0 / 3.0
    assert "the accumulations of hit accumulate in turn" in result.said
    said = float(result.said.partition("about at t = ")[2].partition(",")[0])
    assert said == pytest.approx(exact, abs=1e-6)  # waits shrink faster than falls do
    before = way.run(Stairs(), start, (0.0, 5.0))
    assert before.status == "reached_end"
    assert before.accumulations == 3


@pytest.mark.parametrize("period", [0.7, 1.5, 21.0])
def test_a_clock_that_rings_behind_the_limit_does_not_hide_it(way, period):
    """Rounding leads through a limit, and on in the modes of the cycle, where the clock rings."""
    run = way.run(Clocked(period=period), {"x1": 8.0, "x2": 6.0}, (0.0, 30.0))
    (point,) = run.zeno
    assert abs(point.t - 20.0) < 1e-9
    assert run.final.rings == math.floor(20.0 / period - 1e-9)


class Struck(hy.Automaton):
    """A body on a floor, which keeps nothing of an impact, and one that falls onto it elastically:
    a strike and the thud after it leave a share ``(m - 1) / (m + 1)`` of the speed."""

    x = hy.state()
    y = hy.state()
    u = hy.state()
    v = hy.state()
    m = hy.parameter(3.0, doc="mass of the lower body; that of the upper one is 1")

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.u, s.v, -10.0, -10.0

    def inverse(self, t, s):
        return jnp.array([1.0 / self.m, 1.0])

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.0)
    strike = hy.contact(
        flight, gap=lambda self, t, s: s.y - s.x, restitution=1.0, inverse_mass=inverse
    )


@pytest.mark.parametrize("m", [3.0, 1.5])
def test_an_elastic_contact_in_a_cycle_that_another_one_damps(way, m):
    """The upper body keeps (m - 1)/(m + 1) of its speed with each turn."""
    start = {"x": 0.0, "y": 1.0, "u": 0.0, "v": 0.0}
    result = way.run(Struck(m=m), start, (0.0, 3.0), mode="flight.rest(floor)")
    fall, left = math.sqrt(0.2), (m - 1.0) / (m + 1.0)
    (point,) = result.zeno
    assert abs(point.t - fall * (1.0 + 2.0 * left / (1.0 - left))) <= point.t_error < 1e-9
    assert result.run.mode == "flight.rest(floor, strike)"
