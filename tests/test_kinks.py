"""Flows and guards that change their formula, with other solvers' steps in the loop and without."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hybrid as hy
from hybrid.run.driver import Driver
from hybrid.solvers.scipy_backend import SciPySolver

from .contract.ways import SOLVERS

EPS = float(np.finfo(float).eps)


class Bent(hy.Automaton):
    """An oscillator whose force bends, jumps in time, has poles beside the path and is flat far
    off, between walls and marks whose guards change their formula; ``q`` at 10 has none jump."""

    x = hy.state()
    v = hy.state()
    n = hy.state()
    a = hy.parameter(1.0)
    r = hy.parameter(0.9)
    w = hy.parameter(1.3)
    d = hy.parameter(0.2)
    q = hy.parameter(10.0)

    @hy.mode(initial=True)
    def swings(self, t, s):
        bent = -0.3 * jnp.abs(s.x - self.d) - jnp.where(s.x < -0.5, 4.0 * (s.x + 0.5), 0.0)
        pushed = jnp.where(jnp.sin(self.w * t) > 0.3, 0.4, -0.2) + 1.5 * jnp.maximum(
            jnp.cos(t), 0.1
        )
        rubs = -0.05 * jnp.tanh(3.0 * s.v) + 0.1 / (1.0 + s.x * s.x)
        return s.v, -s.x + bent + pushed + rubs, 0.0

    @hy.edge(swings, to=swings, guard=lambda self, t, s: self.a - jnp.abs(s.x))
    def wall(self, t, s):
        return s.replace(v=-self.r * s.v)

    @hy.edge(
        swings,
        to=swings,
        guard=lambda self, t, s: jnp.minimum(s.x - self.d, s.v + 0.1),
        crossing=hy.EITHER,
    )
    def low(self, t, s):
        return s.replace(n=s.n + 1.0)

    @hy.edge(
        swings,
        to=swings,
        guard=lambda self, t, s: jnp.where(s.v > self.q, s.x - 0.2, 0.5 * s.x + 0.3),
        crossing=hy.RISING,
    )
    def switches(self, t, s):
        return s.replace(n=s.n + 100.0)


def bent(seed, jumps):
    """Numbers by chance."""
    rng = np.random.default_rng(seed)
    ranges = {"a": (0.3, 0.9), "r": (0.7, 1.0), "w": (0.7, 2.5), "d": (-0.3, 0.3), "q": (-0.5, 0.9)}
    drawn = {name: rng.uniform(*ends) for name, ends in ranges.items()}
    drawn["q"] = drawn["q"] if jumps else 10.0
    return Bent(**drawn), {"x": 0.0, "v": rng.uniform(-1.0, 1.5), "n": 0.0}, (0.0, 12.0)


def same(run, other):
    """The same jumps, where two solutions to 1e-10, of a motion that may grow apart, have them."""
    assert list(run.jumps.edge) == list(other.jumps.edge)
    np.testing.assert_allclose(run.jumps.t, other.jumps.t, rtol=0, atol=1e-6)
    np.testing.assert_allclose([*run.final], [*other.final], rtol=0, atol=1e-5)


@pytest.mark.parametrize("jumps", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_kinked_runs_are_those_of_the_rules_one_by_one(seed, jumps, monkeypatch):
    """With the loop, by the driver alone, and with the loop's own steps, which end at kinks."""
    scene = bent(seed, jumps)
    run = hy.simulate(*scene, solver="scipy", rtol=1e-10)
    assert len(run.jumps) >= 7
    same(run, hy.simulate(*scene, solver="taylor"))
    monkeypatch.setattr(SciPySolver, "asked", False)
    same(run, hy.simulate(*scene, solver="scipy", rtol=1e-10))


@pytest.mark.long
def test_kinked_arcs_are_flown_in_the_loop(monkeypatch):
    """Where no guard jumps the driver flies but those in which one comes next to zero as it bends,
    or turns back there: of forty such models a quarter of the arcs."""
    flown, arcs, own = [], 0, Driver.flow_arc
    monkeypatch.setattr(Driver, "flow_arc", lambda self: (flown.append(self), own(self)))
    for seed in range(15):
        arcs += len(hy.simulate(*bent(seed, False), solver="scipy", rtol=1e-10).arcs)
    assert arcs > 150
    assert len(flown) < 0.3 * arcs


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("drift", [0.0, 1.0, 2.0])
def test_a_flow_that_leads_back_to_its_jump_is_refused(solver, drift):
    """From 0.057 the product ``x v`` falls to where the flow jumps, and rises beyond. With a drift
    it would fall again, without ever having been on the side of that formula."""

    class Back(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def only(self, t, s):
            push = jnp.where(s.x * s.v < 0.05697, 0.622, 0.0)
            return s.v, -0.64 + drift * (1.40354 - t) + push

    start = {"x": 0.45435775, "v": 0.12754117}
    with pytest.raises(hy.FlowError, match="leads back to the jump from both sides"):
        hy.simulate(Back(), start, (1.4, 1.5), solver=solver)


@pytest.mark.parametrize("way", ["taylor", "DOP853", "RK45"])
def test_a_run_ends_where_a_saw_leads_back_to_its_jump(way):
    """Below w = 0.1051 the saw is 1 and the flow rises, above it is 0 and the flow falls."""

    class Saw(hy.Automaton):
        w = hy.state()

        @hy.mode
        def only(self, t, s):
            return 0.4912 * jnp.mod(2.0 * (s.w + 0.8949), 1.0) - s.w

    with pytest.raises(hy.FlowError, match=r"t = 0\.0466.*leads back to the jump"):
        hy.simulate(Saw(), {"w": 0.11}, (0.0, 2.0), **SOLVERS[way])


def test_a_kink_of_a_product_is_passed_by_taylor_series():
    """Where the clipped product is next to its corner, its rounding is that of what it is made of:
    moved by a few roundings, position and speed must not make up for each other."""

    class Clipped(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def only(self, t, s):
            push = 3.0 * jnp.clip(s.x * s.v - 0.093557037, -0.2, 0.2)
            return s.v, -s.x - 0.1 * s.v + jnp.cos(1.3 * t) + push

    start = {"x": -0.9138835154416254, "v": 0.11642514681611123}
    run, other = (
        hy.simulate(Clipped(), start, (3.8963, 3.8964), solver=solver, rtol=1e-12)
        for solver in ("taylor", "scipy")
    )
    assert run.status is hy.Status.REACHED_END
    assert abs(run.final.v - other.final.v) < 1e-12


def test_a_saw_of_a_square_is_passed_by_taylor_series():
    """The saw is made of two steps, with opposite signs: while the way between their zeros is less
    than the time can tell, both are passed."""

    class Squared(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def only(self, t, s):
            push = 0.9243 * jnp.mod(2.0 * (s.x**2 - 0.37009938), 1.0)
            return s.v, -s.x - 0.1 * s.v + jnp.cos(1.3 * t) + push

    start = {"x": -0.6083642862633235, "v": 0.24731395563071673}
    run, other = (
        hy.simulate(Squared(), start, (0.559, 0.5595), solver=solver, rtol=1e-12)
        for solver in ("taylor", "scipy")
    )
    assert run.stats.steps < 20
    assert abs(run.final.v - other.final.v) < 1e-12


WAVES = {
    "square": lambda a, t: jnp.sign(a.height * jnp.sin(a.w * t + a.phase)),
    "ramps": lambda a, t: jnp.abs(jnp.sin(a.w * t + a.phase)),
    "saw": lambda a, t: jnp.mod(a.w * t + a.phase, 2.0 * jnp.pi) / jnp.pi,
    "halves": lambda a, t: jnp.where(jnp.mod(t + a.phase / a.w, 1.0) < 0.5, 1.0, -1.0),
}


@pytest.mark.parametrize("wave", list(WAVES))
@pytest.mark.parametrize("half", [-3, 1, 2, 11, 50])
def test_a_wave_may_begin_at_its_corner(wave, half):
    """At t = 0 a phase of half a period is rounded by far more than the time: the corner lies
    1e-17 to 1e-14 ahead or behind, and the wave itself changes there by rounding."""

    class Waved(hy.Automaton):
        x = hy.state()
        w = hy.parameter(2.0 * np.pi)
        phase = hy.parameter(0.0)
        height = hy.parameter(3.0)

        @hy.mode
        def only(self, t, s):
            return WAVES[wave](self, t)

    run = hy.simulate(Waved(phase=half * np.pi), {"x": 0.0}, (0.0, 2.25), solver="taylor")
    begun = 0.5 * (half % 2)  # in periods
    ahead = (2.25 + begun) % 1.0
    exact = {
        "square": 0.25 - begun,
        "halves": 0.25 - begun,
        "ramps": 4.5 / np.pi,
        "saw": 2.0 + ahead**2 - begun**2,
    }
    assert abs(run.final.x - exact[wave]) < 1e-13  # of phases to 160, whose rounding is 2e-14


OUTFLOWS = {
    "bare": lambda h: -jnp.sqrt(h),
    "held at zero": lambda h: -jnp.sqrt(jnp.maximum(h, 0.0)),
    "by cases": lambda h: jnp.where(h > 0.0, -jnp.sqrt(jnp.where(h > 0.0, h, 1.0)), 0.0),
}


@pytest.mark.parametrize("way", ["taylor", "DOP853", "RK45"])
@pytest.mark.parametrize("outflow", list(OUTFLOWS))
def test_a_tank_runs_empty_in_finite_time(outflow, way):
    """By Torricelli's law the level is (1 - t/2)^2 until t = 2 and zero from then on: it comes to
    the edge without a slope, and stays."""

    class Tank(hy.Automaton):
        h = hy.state()

        @hy.mode(initial=True)
        def drains(self, t, s):
            return OUTFLOWS[outflow](s.h)

        empty = hy.mode(lambda self, t, s: 0.0)
        out = hy.edge(drains, to=empty, guard=lambda self, t, s: s.h)

    run = hy.simulate(Tank(), {"h": 1.0}, (0.0, 3.0), **SOLVERS[way])
    # other solvers know the level to their tolerance, and the time to its root
    allowed = 16.0 * EPS if way == "taylor" else 2.0 * np.sqrt(1e-9)
    assert run.mode == "empty"
    assert abs(run.jumps[0].t - 2.0) < allowed


class Drained(hy.Automaton):
    """A tank that runs empty by a root of its level, beside one that goes on."""

    h = hy.state()
    y = hy.state()
    k: float = hy.parameter(1.0)

    @hy.mode(initial=True)
    def drains(self, t, s):
        return -self.k * jnp.sqrt(jnp.maximum(s.h, 0.0)), -s.y

    @hy.mode
    def empty(self, t, s):
        return 0.0, -s.y

    out = hy.edge(drains, to=empty, guard=lambda self, t, s: s.h)


@pytest.mark.parametrize("way", ["taylor", "DOP853", "Dopri8"])
def test_a_tank_runs_empty_beside_what_goes_on(way):
    """What is left of its level is rounding of the other state: the edge was missed, or fired
    seconds late. At its end the level falls like the square of the time left."""
    for k, h in np.random.default_rng(0).uniform([0.3, 0.1], [3.0, 3.0], (12, 2)).tolist():
        exact = 2.0 * np.sqrt(h) / k
        start = {"h": h, "y": 1.0}
        run = hy.simulate(Drained(k=k), start, (0.0, exact + 1.0), rtol=1e-9, **SOLVERS[way])
        allowed = 1e-9 if way == "taylor" else 1e-4 / k
        assert run.mode == "empty"
        assert abs(run.jumps[0].t - exact) < allowed
        assert not run.grazings


class Sieve(hy.Automaton):
    """A level that falls with a power of itself, beside a clock."""

    h = hy.state()
    clock = hy.state()
    k: float = hy.parameter(1.0)
    power: float = hy.parameter(0.3)

    @hy.mode(initial=True)
    def drains(self, t, s):
        return -self.k * jnp.maximum(s.h, 0.0) ** self.power, 1.0

    @hy.mode
    def empty(self, t, s):
        return 0.0, 1.0

    out = hy.edge(drains, to=empty, guard=lambda self, t, s: s.h)


@pytest.mark.parametrize("power", [0.1, 0.2, 0.3, 0.5, 0.7])
def test_a_level_that_falls_with_a_power_runs_empty(power):
    """A level of 1e-25, which no step of the time can tell from 0, falls at a rate of 1e-7: left
    before the corner, with the formula beyond it, it took steps of 2e-10 for ever."""
    for k, h in np.random.default_rng(3).uniform([0.5, 0.1], [3.0, 3.0], (12, 2)).tolist():
        exact = h ** (1.0 - power) / (1.0 - power) / k
        run = hy.simulate(
            Sieve(k=k, power=power),
            {"h": h, "clock": 1.0},
            (0.0, exact + 1.0),
            solver="taylor",
            rtol=1e-9,
        )
        assert run.mode == "empty"
        left = 1e-9 ** (1.0 - power) / (1.0 - power) / k  # for the last 1e-9 of the level
        assert abs(run.jumps[0].t - exact) < left


class Bare(hy.Automaton):
    """A tank whose flow has no value beyond empty."""

    h = hy.state()
    k: float = hy.parameter(1.0)

    @hy.mode(initial=True)
    def drains(self, t, s):
        return -self.k * jnp.sqrt(s.h)

    empty = hy.mode(lambda self, t, s: 0.0)
    out = hy.edge(drains, to=empty, guard=lambda self, t, s: s.h)


def test_a_flow_that_ends_at_empty_ends_there():
    """Where rounding puts the last step just beyond, no step follows: a third of these raised."""
    for k, h in np.random.default_rng(1).uniform([0.3, 0.1], [3.0, 3.0], (20, 2)).tolist():
        exact = 2.0 * np.sqrt(h) / k
        run = hy.simulate(Bare(k=k), {"h": h}, (0.0, exact + 1.0), solver="taylor", rtol=1e-9)
        assert run.mode == "empty"
        assert abs(run.jumps[0].t - exact) < 1e-9


class Decays(hy.Automaton):
    """A level that comes to zero never, or touches it and turns back."""

    h = hy.state()
    y = hy.state()

    @hy.mode(initial=True)
    def flow(self, t, s):
        return -s.h, 2.0 * (t - 1.0)

    @hy.mode
    def beyond(self, t, s):
        return 0.0, 0.0

    never = hy.edge(flow, to=beyond, guard=lambda self, t, s: s.h)
    touches = hy.edge(flow, to=beyond, guard=lambda self, t, s: s.y)


@pytest.mark.parametrize("way", ["taylor", "DOP853", "Dopri8"])
def test_what_fades_or_turns_back_does_not_run_empty(way):
    """exp(-t) to t = 60, far below rounding of 1; (t - 1)^2."""
    run = hy.simulate(Decays(), {"h": 1.0, "y": 1.0}, (0.0, 60.0), **SOLVERS[way])
    assert run.mode == "flow"
    assert not run.jumps


class Fading(hy.Automaton):
    """A damped swing that turns ever lower, and what follows the signs of it and of what fades."""

    x = hy.state()
    v = hy.state()
    low = hy.state()
    z = hy.state()

    @hy.mode
    def flow(self, t, s):
        drag = jnp.where(s.v > 0.0, 0.1, 0.3)
        return s.v, -s.x - drag * s.v, -s.low, jnp.sign(s.low)


@pytest.mark.parametrize("way", ["taylor", "DOP853", "Dopri8"])
def test_a_sign_is_known_however_small_what_has_it(way):
    """Far below ``atol`` it is that of the state itself: nothing cancels there."""
    start = {"x": 1.0, "v": 0.0, "low": 1.0, "z": 0.0}
    run = hy.simulate(Fading(), start, (0.0, 60.0), **SOLVERS[way])
    assert run.final.z == pytest.approx(60.0, rel=1e-9)
    assert 0.0 < run.final.low < 1e-24


@pytest.mark.parametrize("outflow", ["held at zero", "by cases"])
def test_an_empty_tank_stays_empty(outflow):
    """Without an edge the run goes on at rest; what flows in beside it does not end."""

    class Tanks(hy.Automaton):
        h = hy.state()
        below = hy.state()

        @hy.mode
        def only(self, t, s):
            return OUTFLOWS[outflow](s.h), -OUTFLOWS[outflow](s.h) - 0.5 * s.below

    run = hy.simulate(Tanks(), {"h": 1.0, "below": 0.0}, (0.0, 3.0), solver="taylor")
    # below' = 1 - t/2 - below/2 to t = 2, so below = 4 - t - 4 exp(-t/2); then it decays
    assert abs(run.final.h) < 1e-28
    assert abs(run.final.below - (2.0 - 4.0 * np.exp(-1.0)) * np.exp(-0.5)) < 1e-14


class Beside(hy.Automaton):
    """A body whose force has a corner at the speed 1, at which it is in balance for a moment."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flow(self, t, s):
        return s.v, 0.1 + 0.2 - s.x + jnp.abs(s.v - 1.0)


@pytest.mark.parametrize("way", SOLVERS)
def test_the_time_in_which_a_flow_leaves_its_corner_counts(way):
    """The speed 1 is kept to rounding (0.1 + 0.2 - 0.3) until the position has changed. Behind it
    the force is 1.3 - x - v, so that x is 0.3 + u with u'' = 1 - u' - u and u(0) = 0, u'(0) = 1."""
    run = hy.simulate(Beside(), {"x": 0.3, "v": 1.0}, (0.0, 3.0), **SOLVERS[way])
    w, t = np.sqrt(0.75), np.array([1e-6, 0.5, 3.0])
    exact = 1.3 - np.exp(-t / 2) * (np.cos(w * t) - 0.5 / w * np.sin(w * t))
    np.testing.assert_allclose(run(t).x, exact, rtol=0.0, atol=1e-6)  # at the solvers' tolerances


class Belt(hy.Automaton):
    """A body on a belt, with friction that falls with the slip (Stribeck)."""

    x = hy.state()
    v = hy.state()
    belt = hy.parameter(3.0)

    def friction(self, slip):
        return 0.1 * (0.4 + 0.6 * jnp.exp(-jnp.abs(slip) / 0.1)) + 0.1 * jnp.abs(slip)

    @hy.mode(initial=True)
    def slow(self, t, s):
        return s.v, -s.x - 0.05 * s.v + self.friction(s.v - self.belt)

    @hy.mode
    def fast(self, t, s):
        return s.v, -s.x - 0.05 * s.v - self.friction(s.v - self.belt)

    stick = hy.switching(fast, slow, surface=lambda self, t, s: s.v - self.belt)


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_a_body_leaves_the_belt_when_it_slips(solver):
    """At the release of a stick, force and friction balance: the slip begins at rest, on the corner
    of the friction."""
    for belt, begin in ((3.0, 0.0), (0.7, 0.3), (6.67, 100.0)):
        slips = 0.1 - 0.05 * belt  # the position at which it does
        start, t1 = {"x": slips - 0.1, "v": belt}, begin + 0.1 / belt + 1.0
        run = hy.simulate(Belt(belt=belt), start, (begin, t1), mode="slide(stick)", solver=solver)

        def flow(t, y, belt=belt):
            slip = abs(y[1] - belt)
            rubs = 0.1 * (0.4 + 0.6 * np.exp(-slip / 0.1)) + 0.1 * slip
            return [y[1], -y[0] - 0.05 * y[1] + rubs]

        options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13, "first_step": 1e-4}
        last = solve_ivp(flow, (0.0, 1.0), [slips, belt], **options).y[:, -1]
        assert len(run.jumps) == 1
        np.testing.assert_allclose([run.final.x, run.final.v], last, rtol=1e-6)


class Timed(hy.Automaton):
    """The integral of a step at the time 0."""

    x = hy.state()

    @hy.mode
    def flow(self, t, s):
        return jnp.where(t > 0.0, 1.0, -1.0)


@pytest.mark.parametrize("way", SOLVERS)
def test_a_flow_that_jumps_at_the_time_zero_is_passed(way):
    """Times are rounded there as those since the start of the arc are."""
    run = hy.simulate(Timed(), {"x": 0.0}, (-1.0, 2.0), **SOLVERS[way])
    assert run.final.x == pytest.approx(1.0, abs=1e-7)  # an implicit step is solved to 1e-8


class Stairs(hy.Automaton):
    """The integral of a floor."""

    x = hy.state()
    a = hy.parameter(1.0)

    @hy.mode
    def flow(self, t, s):
        return jnp.floor(self.a * t)


@pytest.mark.parametrize(("solver", "method"), [("scipy", "RK45"), ("diffrax", "Tsit5")])
def test_behind_a_jump_of_a_flow_the_method_has_the_new_formula(solver, method):
    """In its first stage, too, at a time that the flow rounds: its loose steps then lose nothing,
    as they are of a constant."""
    stairs = lambda u: np.floor(u) * (np.floor(u) - 1.0) / 2.0 + np.floor(u) * (u - np.floor(u))  # noqa: E731
    for a, begin in np.random.default_rng(5).uniform([-8.0, 0.05], [-0.5, 3.0], (60, 2)).tolist():
        run = hy.simulate(
            Stairs(a=a), {"x": 0.0}, (begin, begin + 2.0), solver=solver, method=method, rtol=1e-4
        )
        exact = (stairs(a * run.t1) - stairs(a * begin)) / a
        assert run.final.x == pytest.approx(exact, abs=1e-8)  # 1e-9 of a step is gone before a jump


class Table(hy.Automaton):
    """The integral of a table that falls from 1 to -1 at the place 0."""

    x = hy.state()
    y = hy.state()

    @hy.mode
    def flow(self, t, s):
        return 1.0, jnp.interp(s.x, jnp.array([-1.0, 0.0, 0.0, 1.0]), jnp.array([1.0, 1, -1, -1]))


@pytest.mark.parametrize(("solver", "method"), [("scipy", "DOP853"), ("diffrax", "Dopri8")])
def test_a_step_that_ends_at_a_jump_of_the_flow_is_of_one_formula(solver, method):
    """All along, not only at its ends."""
    times = np.linspace(0.0, 1.0, 41)
    for scale in np.linspace(1.0, 10.0, 40):
        start = {"x": -0.5, "y": 0.0}
        run = hy.simulate(
            Table(), start, (0.0, 1.0), solver=solver, method=method, first_step=0.05 * scale
        )
        np.testing.assert_allclose(run(times).y, np.minimum(times, 1.0 - times), atol=1e-9)


class Roots(hy.Automaton):
    """A flow with a formula on each side of 1 that has no value on the other."""

    x = hy.state()

    @hy.mode
    def flow(self, t, s):
        return 1.0 + jnp.where(s.x > 1.0, jnp.sqrt(s.x - 1.0), jnp.sqrt(1.0 - s.x))


@pytest.mark.parametrize("method", ["Radau", "BDF", "LSODA"])
def test_the_slope_of_a_branch_that_is_not_taken_does_not_count(method):
    """It is not a number. With u = sqrt|1 - x| the time from u = 1 to 0, and from there to the end,
    is 2 u - 2 log(1 + u)."""
    run = hy.simulate(Roots(), {"x": 0.0}, (0.0, 2.0), method=method, rtol=1e-9)
    for x, t in ((0.0, 0.0), (float(run.final.x), 2.0)):
        u = np.sqrt(abs(1.0 - x))
        spent = 2.0 * u - 2.0 * np.log(1.0 + u)
        half = 2.0 - 2.0 * np.log(2.0)
        assert (half - spent if x < 1.0 else half + spent) == pytest.approx(t, abs=1e-5)


class Capped(hy.Automaton):
    """The integral of 1/x where that is below 10, and of 10 else."""

    x = hy.state()
    y = hy.state()

    @hy.mode
    def flow(self, t, s):
        return 1.0, jnp.where(s.x < 0.1, 10.0, 1.0 / s.x)


@pytest.mark.parametrize("way", SOLVERS)
def test_a_pole_on_a_branch_that_is_not_taken_is_passed(way):
    """1/x at 0, and a start there."""
    for begin in (-1.0, 0.0):
        run = hy.simulate(Capped(), {"x": begin, "y": 0.0}, (begin, 2.0), **SOLVERS[way])
        exact = 10.0 * (0.1 - begin) + np.log(20.0)
        assert run.final.y == pytest.approx(exact, rel=1e-6)


class Rate(hy.Automaton):
    """The integral of z / (1 - exp(-z)), by its series where that is 0/0."""

    z = hy.state()
    y = hy.state()

    @hy.mode
    def flow(self, t, s):
        near = 1.0 + s.z * (1 / 2 + s.z * (1 / 12 - s.z**2 * (1 / 720 - s.z**2 / 30240)))
        return 1.0, jnp.where(jnp.abs(s.z) < 0.1, near, -s.z / jnp.expm1(-s.z))


def test_a_quotient_of_zeros_on_a_branch_that_is_not_taken_is_passed_by_taylor_series():
    """Of its own integral the even part is known: half of the rates at z and -z differ by z."""
    run = hy.simulate(Rate(), {"z": -2.0, "y": 0.0}, (-2.0, 2.0), solver="taylor")
    half = hy.simulate(Rate(), {"z": 0.0, "y": 0.0}, (0.0, 2.0), solver="taylor").final.y
    assert run.final.y == pytest.approx(2.0 * half - 2.0, abs=1e-12)  # f(-z) = f(z) - z


class Dragged(hy.Automaton):
    """A spring with drag by the square of the speed, and a weak second spring near the turn."""

    x = hy.state()
    v = hy.state()
    c = hy.parameter(0.5)
    k = hy.parameter(0.1)

    @hy.mode
    def flow(self, t, s):
        pushes = self.k * jnp.maximum(s.x - self.c, 0.0)
        return s.v, -s.x - 0.2 * s.v * jnp.abs(s.v) + pushes


@pytest.mark.parametrize(
    ("solver", "method", "rtol"),
    [("scipy", "DOP853", 1e-6), ("scipy", "RK45", 1e-4), ("diffrax", "Dopri8", 1e-6)],
)
def test_a_corner_behind_a_turn_is_come_to_by_steps(solver, method, rtol):
    """Where the speed is zero the place does not move for a moment: that says nothing of how soon
    it comes to the corner."""
    start, top = {"x": 0.0, "v": 1.0}, 0.8
    for below, k in np.random.default_rng(0).uniform([-4.0, -4.0], [-0.5, 0.0], (12, 2)).tolist():
        model = Dragged(c=top - 10**below, k=10**k)
        fine = hy.simulate(model, start, (0.0, 3.0), solver="taylor").final
        options = {"method": method, "rtol": rtol, "atol": 1e-2 * rtol}
        run = hy.simulate(model, start, (0.0, 3.0), solver=solver, **options)
        assert run.final.x == pytest.approx(fine.x, abs=50 * rtol)


class Signs(hy.Automaton):
    """The integral of ``|x| + 2 sign(x)``."""

    x = hy.state()
    z = hy.state()
    c = hy.parameter(1.0)

    @hy.mode
    def flow(self, t, s):
        return self.c * (1.0 + 0.0 * s.x), jnp.abs(s.x) + 2.0 * jnp.sign(s.x)


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_a_derivative_of_a_motion_that_begins_on_a_jump_comes_to_an_end(solver):
    """At the state 0 and the time 0, from which the first step is as short as numbers are; in a
    callback of JAX the shortest are zero."""
    with jax.enable_x64(True):
        fly = hy.as_function(Signs(), t=(0.0, 1.0), max_jumps=4, solver=solver)
        value, slope = jax.value_and_grad(lambda c: fly(Signs(c=c), {"x": 0.0, "z": 0.0}).final.z)(
            1.0
        )
    assert value == pytest.approx(2.5, abs=1e-6)
    assert slope == pytest.approx(0.5, abs=1e-6)


class Vessels(hy.Automaton):
    """Two communicating vessels, by a law of their levels' difference."""

    a = hy.state()
    b = hy.state()
    soft = hy.parameter(0.0)

    @hy.mode
    def levels(self, t, s):
        d = s.a - s.b
        law = jnp.where(self.soft > 0.0, 0.5 / jnp.sqrt(jnp.abs(d) + self.soft), 3.0 + jnp.abs(d))
        return -d * law, d * law


@pytest.mark.parametrize("method", ["DOP853", "RK45", "LSODA"])
@pytest.mark.parametrize(("soft", "b"), [(0.0, 0.3), (1e-6, 0.0)])
def test_a_state_settles_on_a_corner_of_the_flow(method, soft, b):
    """Rounding then has it on either side in turn: DOP853 met the corner in every step, and took
    that for a flow that jumps back and forth."""
    run = hy.simulate(Vessels(soft=soft), {"a": 1.0, "b": b}, (0.0, 60.0), method=method)
    level = 0.5 * (1.0 + b)
    assert [run.final.a, run.final.b] == pytest.approx([level, level], abs=1e-8)
