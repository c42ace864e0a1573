"""Flows with roots and powers of what becomes zero: where it does they have no Taylor series."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

from .contract.ways import SOLVERS, WAYS

G = 9.81

#: When a ball that is dropped from a height of 1 leaves a Hertzian floor of stiffness 1000, and
#: when it meets the floor for the tenth time: quadrature of the energy's equation with 28 digits.
LEAVES, TENTH = 0.608305847453521950815, 9.989989036939006601846

#: Limits of the impacts of the dragged ball below, dropped from a height of 1 with restitution 0.8,
#: by power and factor of the drag: the flights by quadrature over the speed, with 22 digits.
LIMITS = {
    (1.5, 0.3): 3.252148710758580054793,
    (2.5, 0.1): 3.401271522646369513628,
    (0.5, 0.3): 3.542997783505795098560,
}

#: What an arc of a solver with tolerances of 1e-8 may be off, and one that is exact to rounding:
#: some hundred steps lead to a power's zero and away from it.
TOLERANCE = {"taylor": 1e-13}

#: A contact force by the law of Hertz, written in different ways: some have no value beyond zero.
HERTZ = {
    "power": lambda depth: depth**1.5,
    "root": lambda depth: depth * jnp.sqrt(depth),
    "size": lambda depth: jnp.abs(depth) ** 1.5,
    "positive part": lambda depth: jnp.maximum(depth, 0.0) ** 1.5,
}


def hertz(law):
    class Hertz(hy.Automaton):
        """A ball on an elastic floor, with a mode for the contact."""

        x = hy.state()
        v = hy.state()

        @hy.mode(initial=True)
        def flight(self, t, s):
            return s.v, -G

        @hy.mode
        def contact(self, t, s):
            return s.v, -G + 1e3 * HERTZ[law](-s.x)

        meets = hy.edge(flight, to=contact, guard=lambda self, t, s: s.x)
        leaves = hy.edge(contact, to=flight, guard=lambda self, t, s: s.x, crossing=hy.RISING)

    return Hertz()


@pytest.mark.parametrize("way", ["taylor", "DOP853", "Radau", "Dopri8"])
@pytest.mark.parametrize("law", HERTZ)
def test_a_contact_by_the_law_of_hertz_is_met_and_left(law, way):
    """The mode begins and ends where the force has no series, and beyond which some have no value.
    Energy is conserved: the ball leaves with the speed with which it comes."""
    run = hy.simulate(hertz(law), [1.0, 0.0], (0, 1.0), **SOLVERS[way])
    assert [jump.edge for jump in run.jumps] == ["meets", "leaves"]
    off = TOLERANCE.get(way, 1e-7)
    np.testing.assert_allclose(run.jumps[1].t, LEAVES, rtol=off)
    np.testing.assert_allclose(run.jumps[1].after, [0.0, np.sqrt(2 * G)], rtol=off, atol=off)


@pytest.mark.parametrize("law", HERTZ)
def test_many_contacts_lose_nothing(law):
    run = hy.simulate(hertz(law), [1.0, 0.0], (0, 10), solver="taylor")
    assert len(run.jumps) == 19
    np.testing.assert_allclose(run.jumps[-1].t, TENTH, rtol=1e-13)
    lanes = hy.ensemble(hertz(law), {"x": [1.0, 1.0], "v": 0.0}, (0, 10), solver="taylor")
    assert lanes.x.values.tolist() == [run.final.x.item()] * 2


class Dragged(hy.Automaton):
    """A ball that air slows down by a power of its speed."""

    x = hy.state()
    v = hy.state()
    power = hy.parameter(1.5)
    factor = hy.parameter(0.3)

    @hy.mode
    def flight(self, t, s):
        return s.v, -G - self.factor * jnp.sign(s.v) * jnp.abs(s.v) ** self.power

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.8)


@pytest.mark.parametrize("way", ["taylor", "DOP853", "Dopri8"])
@pytest.mark.parametrize(("power", "factor"), LIMITS)
def test_impacts_with_a_drag_that_has_no_series_at_rest_accumulate(power, factor, way):
    """At the top of each flight the power is of zero. The impacts have no sum, as the flow has no
    bounds at the limit: they are flown until it is reached."""
    model = Dragged(power=power, factor=factor)
    run = hy.simulate(model, [1.0, 0.0], (0, 5), **SOLVERS[way])
    (point,) = run.zeno
    np.testing.assert_allclose(point.t, LIMITS[power, factor], rtol=TOLERANCE.get(way, 1e-7))
    assert point.verdict == "estimated"
    assert len(run.jumps) < 250
    assert run.mode == "flight.rest(impact)"
    np.testing.assert_allclose(run.final, [0.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("way", ["DOP853", "Dopri8"])
def test_the_lowest_flights_keep_their_energy(way):
    """The top of each flight is a kink. In flights of 30 roundings of the time, the way past it is
    a good part of the flight: gone along a straight line it made them rise higher each time."""
    run = hy.simulate(Dragged(), [1.0, 0.0], (0, 5), max_jumps=144, **SOLVERS[way])
    speeds = np.abs([jump.before.v for jump in run.jumps][-40:])
    np.testing.assert_allclose(speeds[1:] / speeds[:-1], 0.8, rtol=1e-12)


@pytest.mark.long
def test_the_limit_of_impacts_without_a_sum_says_how_far_it_may_be_off():
    point = hy.simulate(Dragged(), [1.0, 0.0], (0, 5), solver="taylor").zeno[0]
    assert abs(point.t - LIMITS[1.5, 0.3]) <= point.t_error < 1e-11


class Valve(hy.Automaton):
    """Two tanks joined by an orifice, through which water flows to both sides."""

    a = hy.state()
    b = hy.state()

    def flow(self, s):
        return jnp.sign(s.a - s.b) * jnp.sqrt(jnp.abs(s.a - s.b))

    @hy.mode
    def tanks(self, t, s):
        pumped = jnp.cos(3.0 * t)
        return pumped - self.flow(s), self.flow(s) - 0.3 * s.b


def test_an_orifice_is_flown_through_to_both_sides():
    exact = hy.simulate(Valve(), [1.0, 0.2], (0, 6), solver="taylor")
    other = hy.simulate(Valve(), [1.0, 0.2], (0, 6), rtol=1e-11, atol=1e-13)
    turns = np.diff(np.sign(exact(np.linspace(0, 6, 400)).a - exact(np.linspace(0, 6, 400)).b))
    assert np.count_nonzero(turns) >= 4
    np.testing.assert_allclose(exact.final, other.final, rtol=1e-8)


class Standing(hy.Automaton):
    """A drag by a root of the speed, and a spring: the speed is zero where the body turns."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def moves(self, t, s):
        return s.v, -s.x - 0.3 * jnp.sign(s.v) * jnp.sqrt(jnp.abs(s.v))


def test_a_run_may_start_where_a_power_is_of_zero():
    run = hy.simulate(Standing(), [1.0, 0.0], (0, 3), solver="taylor")
    other = hy.simulate(Standing(), [1.0, 0.0], (0, 3), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(run.final, other.final, rtol=1e-9)


def two_sided(t, x, v):
    """Hertzian stops on both sides of a gap, with damping."""
    beyond = jnp.maximum(x - 0.5, 0.0) ** 1.5 - jnp.maximum(-x - 0.5, 0.0) ** 1.5
    return -15.0 * beyond * (1.0 + 0.3 * v)


#: Forces that act on an oscillator, of which some are zero for a while.
FORCES = {
    "stops": two_sided,
    "half wave": lambda t, x, v: jnp.sqrt(jnp.maximum(jnp.sin(t), 0.0)),
    "wave": lambda t, x, v: 0.7 * jnp.abs(jnp.cos(2.0 * t)) ** 0.4,
    "cube root": lambda t, x, v: -0.4 * jnp.cbrt(v),
    "stops and drag": lambda t, x, v: two_sided(t, x, v) - 0.3 * jnp.sign(v) * jnp.abs(v) ** 0.7,
}


@pytest.mark.parametrize("name", FORCES)
def test_forces_with_roots_are_flown_over_to_rounding(name):
    """Against DOP853 at its finest, whose own errors are some 1e-12 there."""
    force = FORCES[name]

    class Driven(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def moves(self, t, s):
            return s.v, -s.x + 1.3 * jnp.cos(1.1 * t) + force(t, s.x, s.v)

    run = hy.simulate(Driven(), [0.2, 0.0], (0, 9), solver="taylor")
    fine = hy.simulate(Driven(), [0.2, 0.0], (0, 9), rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(run.final, fine.final, rtol=1e-10, atol=1e-10)


class Pressed(hy.Automaton):
    """A force that is zero up to where the run begins, and a power of the depth beyond."""

    x = hy.state()
    z = hy.state()
    power = hy.parameter(1.5)

    @hy.mode
    def moves(self, t, s):
        return s.z - 1.15 * jnp.maximum(s.x, 0.0) ** self.power, -1.866


#: When a body is back that sets out at ``z = 0.72``, by the power: with a root it is
#: ``0.72 (1 + q) / 1.866``, where ``q`` is the share of ``z`` that is left, by the flow in the time
#: ``s`` of ``dt = 2 sqrt(x) ds``, in which it is linear; the other by a series in that time, with
#: 25 digits.
BACK = {0.5: 0.530743655848440556931, 1.5: 0.7388123861941236306553}


@pytest.mark.parametrize("way", ["taylor", "DOP853", "ensemble"])
@pytest.mark.parametrize("power", BACK)
def test_a_power_that_sets_in_where_the_run_begins_acts(power, way):
    """A step beyond the time at which the body would be back without the force, 0.772, saw nothing
    of it. What is beyond zero is a parabola."""
    for t in (0.8, 1.0, 1.9, 9.0, 100.0):
        result = WAYS[way].run(Pressed(power=power), {"x": 0.0, "z": 0.72}, (0.0, t))
        later = t - BACK[power]
        exact = (0.72 - 1.866 * BACK[power]) * later - 0.933 * later**2
        assert result.final.x == pytest.approx(exact, rel=1e-7 if way == "DOP853" else 1e-13)


class SuperTwisting(hy.Automaton):
    """``x' = -a sqrt|x| sign x + z``, ``z' = -b sign x`` (Levant 1993), each sign a mode."""

    x = hy.state()
    z = hy.state()
    a = hy.parameter(1.5)
    b = hy.parameter(1.1)

    @hy.mode(initial=True)
    def right(self, t, s):
        return -self.a * jnp.sqrt(jnp.maximum(s.x, 0.0)) + s.z, -self.b

    @hy.mode
    def left(self, t, s):
        return self.a * jnp.sqrt(jnp.maximum(-s.x, 0.0)) + s.z, self.b

    @hy.mode(limit_of=("leaves", "returns"))
    def origin(self, t, s):
        return 0.0, 0.0

    leaves = hy.edge(right, to=left, guard=lambda self, t, s: s.x)
    returns = hy.edge(left, to=right, guard=lambda self, t, s: s.x, crossing=hy.RISING)


@pytest.mark.parametrize("way", ["taylor", "ensemble"])
def test_super_twisting_reaches_the_origin(way):
    """In the time ``s`` of ``dt = 2 sqrt|x| ds`` the flow is linear: each turn leaves the same
    share of ``z``. A turn's first step passed over the root where the turn before had led a
    rounding beyond zero, and the turns went on and on."""
    for a, b, z in np.random.default_rng(3).uniform([0.5, 1.0, 0.3], [1.5, 3.0, 1.0], (4, 3)):
        share = np.exp(-a * np.pi / np.sqrt(8.0 * b - a * a))
        limit = z / b * (1.0 + share) / (1.0 - share)
        model, start = SuperTwisting(a=a, b=b), {"x": 0.0, "z": z}
        result = WAYS[way].run(model, start, (0.0, 2.0 * limit))
        assert result.t_inf == pytest.approx(limit, rel=1e-13)
        assert result.mode == "origin"


@pytest.mark.parametrize("way", ["DOP853", "RK45", "BDF", "LSODA", "Tsit5"])
def test_steps_are_held_to_the_flights_of_a_cycle(way):
    """The flights fall below the absolute tolerance before the limit is known: the turns that
    followed were noise, and went on up to ``max_jumps``. What steps had lost by then is left, some
    1e-5 of the time."""
    given = {"solver": "diffrax" if way == "Tsit5" else "scipy", "method": way, "max_jumps": 100}
    for a, b, z in np.random.default_rng(3).uniform([0.5, 1.0, 0.3], [1.5, 3.0, 1.0], (4, 3)):
        share = np.exp(-a * np.pi / np.sqrt(8.0 * b - a * a))
        limit = z / b * (1.0 + share) / (1.0 - share)
        run = hy.simulate(SuperTwisting(a=a, b=b), {"x": 0.0, "z": z}, (0.0, 2 * limit), **given)
        assert [point.t for point in run.zeno] == pytest.approx([limit], rel=1e-4)
        assert run.mode == "origin"
        assert run.options["atol"] == 1e-10


def test_a_method_that_is_misled_by_an_infinite_slope_says_so():
    """Next to the root's zero Radau's Newton iteration takes steps for solved that do not move:
    ``x`` stayed at 4e-8 for good, with ``z`` at -3.7."""
    model = SuperTwisting(a=0.5856, b=1.4736)

    def ends(z):
        try:
            return hy.simulate(model, {"x": 0.0, "z": z}, (0.0, 4.4), method="Radau").mode
        except hy.FlowError as fault:
            return str(fault)

    for z in 0.8608921256444777 * (1.0 + 1e-3 * np.arange(8)):
        end = ends(z)
        assert end == "origin" or "does not follow the flow" in end
