"""Flows, gaps and floors from tables, and formulas that are smooth but written with choices."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import hybrid as hy

from .contract.ways import SOLVERS

G = 9.8

#: Knots of the drag below: at rest, and at each half metre a second.
KNOTS = np.linspace(-6.0, 6.0, 25)
DRAG = np.sin(KNOTS) + 0.1 * KNOTS


class Dragged(hy.Automaton):
    """A ball whose drag is a table of its speed."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.7)

    @hy.mode
    def flight(self, t, s):
        return s.v, -G - jnp.interp(s.v, KNOTS, DRAG)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")


def flights(count, x=1.0, v=0.0, r=0.7):
    """Times of the first impacts: while the speed falls, time and height are integrals over it."""
    acceleration = lambda u: -G - np.interp(u, KNOTS, DRAG)  # noqa: E731
    times, t = [], 0.0
    for _ in range(count):

        def since(u, power, v=v):
            inner = [k for k in KNOTS if u < k < v]
            ends = [v, *inner[::-1], u]
            parts = pairwise(ends)
            f = lambda w: w**power / acceleration(w)  # noqa: E731
            return sum(quad(f, a, b, epsabs=1e-14, epsrel=1e-13)[0] for a, b in parts)

        last = brentq(lambda u, x=x, v=v: x + since(u, 1, v), -6.0, min(v, 0.0) - 1e-9, xtol=1e-15)
        t += since(last, 0)
        x, v = 0.0, -r * last
        times.append(t)
    return times


@pytest.mark.parametrize("way", ["taylor", "DOP853"])
@pytest.mark.parametrize("t1", [3.0, 6.0])
def test_a_drag_from_a_table_is_flown_from_knot_to_knot(way, t1):
    """Tests of a table are nested: each that turns makes the next ask for another knot. The run
    begins on one, and each flight passes one at its top, with both formulas, down to rest."""
    run = hy.simulate(Dragged(), {"x": 1.0, "v": 0.0}, (0.0, t1), **SOLVERS[way])
    # the tolerance of DOP853, and what the flights before have lost
    np.testing.assert_allclose([j.t for j in list(run.jumps)[:8]], flights(8), rtol=0, atol=1e-8)
    assert len(run.zeno) == 1
    assert len(run.jumps) < 200


@pytest.mark.parametrize("seed", range(12))
def test_flows_from_random_tables_are_those_of_steps_from_knot_to_knot(seed):
    """Knots at any distance, and starts on them, with Taylor series and with DOP853."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 40))
    knots = np.sort(rng.uniform(-3.0, 3.0, count))
    force = 0.7 * rng.normal(size=count)

    class Tabled(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def only(self, t, s):
            return s.v, -s.x - jnp.interp((s.v, s.x)[seed % 2], knots, force)

    start = {"x": float(knots[count // 2]), "v": float(rng.uniform(-2.0, 2.0))}
    run, other = (
        hy.simulate(Tabled(), start, (0.0, 6.0), solver=solver, rtol=1e-11)
        for solver in ("taylor", "scipy")
    )
    np.testing.assert_allclose([*run.final], [*other.final], rtol=0, atol=1e-8)


@pytest.mark.parametrize("way", ["DOP853", "RK45", "Dopri8"])
def test_a_body_leaves_a_knot_at_rest(way):
    """It is beyond the knot by the square of the time alone, which a straight line never is."""

    class Falls(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def only(self, t, s):
            return s.v, -G + jnp.interp(s.x, jnp.array([0.0, 1.0, 2.0]), jnp.array([0.0, 1.0, 1.5]))

    run = hy.simulate(Falls(), {"x": 1.0, "v": 0.0}, (0.0, 0.4), **SOLVERS[way])
    # below the knot the force is x - G
    np.testing.assert_allclose(run.final.x, G + (1.0 - G) * np.cosh(0.4), rtol=0, atol=1e-7)


#: Corners of a floor, a second apart, and its slopes between them.
SLOPES = np.array([0.0, 0.5, 0.2, 0.2, -0.3, 0.1, -0.4, 0.0])


def floor(kind):
    """The height of the floor: from a short table, a long one, or by counting whole seconds."""
    corners = np.arange(len(SLOPES) + 1.0)
    heights = np.concatenate([[0.0], np.cumsum(SLOPES)])
    if kind == "whole seconds":

        def height(t):
            k = jnp.floor(t)
            passed = [
                jnp.where(k > i, s, jnp.where(k == i, s * (t - i), 0.0))
                for i, s in enumerate(SLOPES.tolist())
            ]
            return sum(passed)

        return height
    if kind == "long table":
        fine = np.linspace(0.0, corners[-1], 8 * 16 + 1)
        corners, heights = fine, np.interp(fine, corners, heights)
    return lambda t: jnp.interp(t, corners, heights)


@pytest.mark.parametrize("kind", ["table", "long table", "whole seconds"])
@pytest.mark.parametrize("way", ["taylor", "DOP853"])
def test_each_corner_of_a_floor_throws_the_body_off_or_strikes_it(way, kind):
    """Where the slope falls by ``d`` the body leaves with that speed, and rests again after
    ``2 d / g / (1 - r)``; where it rises, after ``r`` times that."""
    height, r = floor(kind), 0.6

    class Lifted(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def flight(self, t, s):
            return s.v, -G

        impact = hy.contact(flight, gap=lambda self, t, s: s.x - height(t), restitution=r)

    end = len(SLOPES) - 0.5
    run = hy.simulate(Lifted(), {"x": 0.01, "v": 0.0}, (0.0, end), **SOLVERS[way])
    turns = np.diff(SLOPES)
    rests = [
        k + 2.0 * abs(d) / G / (1.0 - r) * (r if d > 0 else 1.0)
        for k, d in enumerate(turns, start=1)
        if d
    ]
    # each rest begins after a corner, which is known to the rounding of the time
    np.testing.assert_allclose([z.t for z in run.zeno][1:], rests, rtol=0, atol=1e-9)
    assert {z.verdict for z in run.zeno} == {"certified"}


ALIKE = {
    "max": lambda f: jnp.maximum(f, f - 1.0),
    "clip": lambda f: jnp.clip(f, -1e3, 1e3),
    "table": lambda f: jnp.interp(f, jnp.array([-1e3, 5e2, 1e3]), jnp.array([-1e3, 5e2, 1e3])),
    "long table": lambda f: jnp.interp(f, jnp.linspace(-1e3, 1e3, 99), jnp.linspace(-1e3, 1e3, 99)),
}


@pytest.mark.parametrize(
    ("place", "kind"),
    [*(("gap", kind) for kind in ("max", "clip", "table")), *(("flow", kind) for kind in ALIKE)],
)
def test_a_formula_that_changes_nothing_is_summed_and_certified_as_without(place, kind):
    """``max(f, f - 1)`` is ``f``: nothing of the run may depend on how it is written."""

    def ball(gap, flow):
        class Ball(hy.Automaton):
            x = hy.state()
            v = hy.state()

            @hy.mode
            def flight(self, t, s):
                return s.v, flow(-G - 0.1 * s.v)

            impact = hy.contact(flight, gap=lambda self, t, s: gap(s.x + 0.0 * t), restitution=0.7)

        return hy.simulate(Ball(), {"x": 1.0, "v": 0.0}, (0.0, 4.0), solver="taylor")

    same = lambda f: f  # noqa: E731
    plain = ball(same, same)
    other = ball(ALIKE[kind], same) if place == "gap" else ball(same, ALIKE[kind])
    # impacts are counted until a flight is rounding of the time, which decides on the last
    assert abs(len(other.jumps) - len(plain.jumps)) <= 2
    assert other.zeno[0].verdict == "certified"
    # an entry of a table between knots is rounded at their size, 1e3, at which a fall is 1e-13
    assert abs(other.zeno[0].t - plain.zeno[0].t) < 1e-11


@pytest.mark.parametrize("sharp", [40.0, 400.0])
def test_the_slope_of_a_softplus_is_a_logistic_function(sharp):
    """JAX writes it as ``exp(z - logaddexp(z, 0))``, which is made of large numbers and is next to
    zero: the argument of ``exp`` is known to its rounding, not to its own digits."""

    def flown(push):
        class Pushed(hy.Automaton):
            x = hy.state()
            v = hy.state()

            @hy.mode
            def only(self, t, s):
                return s.v, -s.x - 5.0 * push(s.x)

        return hy.simulate(Pushed(), {"x": 1.0, "v": 0.5}, (0.0, 4.0), solver="taylor").final

    slope = jax.grad(lambda y: jax.nn.softplus(sharp * (y - 0.3)) / sharp)
    given, known = flown(slope), flown(lambda x: jax.nn.sigmoid(sharp * (x - 0.3)))
    # the difference of numbers up to 280 has 3e-14 of rounding, and a swing amplifies it little
    np.testing.assert_allclose([*given], [*known], rtol=0, atol=1e-10)


@pytest.mark.parametrize("share", [0.99999, 1.0 - 1e-7])
def test_a_switch_near_the_top_of_a_wave_is_passed_by_taylor_series(share):
    """There the wave itself is rounded, which moving the time does not show."""

    class Switched(hy.Automaton):
        v = hy.state()

        @hy.mode
        def only(self, t, s):
            return jnp.where(2.5 * jnp.sin(3.0 * t) > 2.5 * share, 1.0, 0.0)

    run = hy.simulate(Switched(), {"v": 0.0}, (0.0, 2.0), solver="taylor")
    # of a switch at an angle a the time is known to rounding / cos(a), 2e-12 for the last
    assert abs(run.final.v - 2.0 * np.arccos(share) / 3.0) < 1e-11
    assert run.stats.steps < 40


ON, READ = np.array([-1.0, 0.0, 1.0, 2.0, 3.0]), np.array([-0.5, 0.0, 1.0, 1.5, 1.2])


class OnAKnot(hy.Automaton):
    """``p`` comes to rest on the knot 1 of a table, and ``q`` moves along with its knot 0; below 1,
    and at 0, the table is its argument. An alarm rings as ``z`` reaches 10 and what ``p`` shows."""

    p = hy.state()
    q = hy.state()
    z = hy.state()
    rings = hy.discrete(0)

    @hy.mode
    def runs(self, t, s):
        slides = jnp.interp(s.q - t, ON, READ)
        return 4.0 * (1.0 - s.p), 1.0 - slides, jnp.interp(s.p, ON, READ)

    @hy.edge(runs, guard=lambda self, t, s: 10.0 + jnp.interp(s.p, ON, READ) - s.z)
    def alarm(self, t, s):
        return s.replace(rings=s.rings + 1, z=0.0)


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_an_argument_of_a_table_may_rest_on_a_knot_or_move_along_with_it(solver):
    """Its signs there are rounding, and end no step. ``p`` is ``1 - exp(-4 t)`` and ``z`` its
    integral, so the alarm rings at 11.25; a hundred steps at 1e-9 each are off by 1e-7."""
    run = hy.simulate(OnAKnot(), {"p": 0.0, "q": 0.0, "z": 0.0}, (0.0, 20.0), solver=solver)
    assert run.jumps.t == pytest.approx([11.25], rel=0, abs=1e-7)
    assert [*run.final][:3] == pytest.approx([1.0, 20.0, 8.75], rel=0, abs=1e-7)
    assert run.stats.steps < 2000
