"""``run.settles()``: what is not for ever, what is no orbit, and units that do not matter."""

import math

import jax.numpy as jnp
import pytest

import hybrid as hy


class Rising(hy.Automaton):
    """A body that its load leaves as it rises; ``p`` does nothing but be large."""

    x = hy.state(unit="m")
    v = hy.state()
    p = hy.state(unit="Pa")
    u: float = hy.parameter(5e-4)
    k: float = hy.parameter(10.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -9.81 + self.k * s.x, 0.0

    hit = hy.contact(flight, gap=lambda self, t, s: s.x - self.u * t, restitution=0.5)

    @hy.edge(flight, to=flight, guard=lambda self, t, s: 10.0 - s.x)
    def out(self, t, s):
        return s.replace(v=0.0)


@pytest.mark.parametrize("p", [1.0, 101325.0, 1e11])
@pytest.mark.parametrize("u", [5e-4, 9e-10, 5e-10, 9e-15])
def test_a_table_that_moves_is_no_rest_for_ever(u, p):
    """However slowly, and whatever other numbers the state has: it is released at 0.981 / u."""
    run = hy.simulate(Rising(u=u), {"x": 0.05, "v": 0.0, "p": p}, (0.0, 100.0))
    found = run.settles()
    assert not found.for_ever
    assert found.kind == "none" or "not known to be for ever: the gap of hit" in found.reason


@pytest.mark.parametrize("until", [1e3, 1e9])
def test_a_table_that_moves_towards_an_edge(until):
    """Without a load that changes: the edge at 10 is taken at t = 2e9."""
    model = Rising(u=5e-9, k=0.0)
    found = hy.simulate(model, {"x": 0.05, "v": 0.0, "p": 1e6}, (0.0, until)).settles()
    assert not found.for_ever


class Growing(hy.Automaton):
    """A load of ``10 - q`` while ``q' = a q``."""

    x = hy.state()
    v = hy.state()
    q = hy.state()
    a: float = hy.parameter(1.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -10.0 + s.q, self.a * s.q

    hit = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize(("a", "q"), [(1.0, 1e-200), (0.01, 1e-9), (1e-3, 1e-6), (0.3, -1e-30)])
def test_what_grows_below_the_tolerance_is_named(solver, a, q):
    """It may end the rest later, and the sentence says so."""
    run = hy.simulate(Growing(a=a), {"x": 1.0, "v": 0.0, "q": q}, (0.0, 100.0), solver=solver)
    found = run.settles()
    assert not found.for_ever
    assert "not known to be for ever: q still grows" in found.reason
    assert "does not change" not in found.reason


def test_what_falls_beside_a_rest_is_named():
    """The load tends to 10; that it is never less later is not looked at."""
    run = hy.simulate(Growing(a=-1.0), {"x": 1.0, "v": 0.0, "q": 1.0}, (0.0, 100.0))
    found = run.settles()
    assert (found.kind, found.for_ever) == ("rest", False)
    assert "not known to be for ever: q still changes" in found.reason


class Falling(hy.Automaton):
    """A ball in any units, under an edge far above it."""

    x = hy.state()
    v = hy.state()
    g: float = hy.parameter(9.81)
    top: float = hy.parameter(5.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -self.g

    hit = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

    @hy.edge(flight, to=flight, guard=lambda self, t, s: self.top - s.x)
    def out(self, t, s):
        return s.replace(v=0.0)


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1e6, 1e12])
def test_a_rest_for_ever_is_one_in_all_units(scale):
    """Of length, and of time."""
    small = Falling(g=9.81 * scale, top=5.0 * scale)
    assert hy.simulate(small, {"x": scale, "v": 0.0}, (0.0, 10.0)).settles().for_ever
    slow = Falling(g=9.81 / scale**2)
    assert hy.simulate(slow, {"x": 1.0, "v": 0.0}, (0.0, 10.0 * scale)).settles().for_ever


class Swinging(hy.Automaton):
    """An oscillator, with damping, and pushed a little from without."""

    x = hy.state()
    v = hy.state()
    d: float = hy.parameter(0.0)
    push: float = hy.parameter(0.0)
    w: float = hy.parameter(1.0)

    @hy.mode
    def flow(self, t, s):
        return s.v, -s.x - self.d * s.v + self.push * jnp.cos(self.w * t)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize(
    ("damping", "until", "kind"),
    [(0.0, 60.0, "periodic"), (0.4, 100.0, "rest"), (0.4, 900.0, "rest"), (0.4, 20.0, "none")],
)
def test_an_oscillator_settles_to_the_same_in_all_units(scale, damping, until, kind):
    """With a tolerance in the same units."""
    run = hy.simulate(Swinging(d=damping), [scale, 0.0], (0.0, until), atol=1e-10 * scale)
    found = run.settles()
    assert found.kind == kind
    assert "for ever" not in found.reason  # noise of the solver does not grow


def test_a_run_below_the_absolute_tolerance_is_not_at_rest():
    """An undamped oscillator of size 1e-12 moves, though ``atol`` is 1e-10."""
    assert hy.simulate(Swinging(), [1e-12, 0.0], (0.0, 60.0)).settles().kind != "rest"


class Logistic(hy.Automaton):
    """The logistic map, by a clock."""

    x = hy.state()
    c = hy.state()
    r: float = hy.parameter(3.8284)

    @hy.mode
    def wait(self, t, s):
        return 0.0, 1.0

    @hy.edge(wait, to=wait, guard=lambda self, t, s: 1.0 - s.c)
    def tick(self, t, s):
        return s.replace(x=self.r * s.x * (1.0 - s.x), c=0.0)


@pytest.mark.parametrize("r", [3.828, 3.8284, 3.82842, 3.828427])
def test_a_slow_passage_in_chaos_is_no_orbit(r):
    """Below 1 + sqrt(8) there is none of period 3, though runs linger where it will be."""
    for until in (100.5, 220.5, 300.5, 380.5, 460.5):
        run = hy.simulate(Logistic(r=r), {"x": 0.3, "c": 0.0}, (0.0, until))
        assert run.settles().kind == "none", until


def test_the_orbit_beyond_is_one():
    """At 3.83 it is there, and attracts by 0.33 a turn."""
    found = hy.simulate(Logistic(r=3.83), {"x": 0.3, "c": 0.0}, (0.0, 300.5)).settles()
    assert (found.kind, found.jumps, found.period) == ("periodic", 3, pytest.approx(3.0))


@pytest.mark.parametrize(("w", "until"), [(1.002, 1100.0), (1.002, 1500.0), (1.001, 2500.0)])
def test_beats_are_no_orbit(w, until):
    """Two frequencies, 0.001 apart: near the turning point of a beat nothing changes for long."""
    run = hy.simulate(Swinging(push=2e-6, w=w), [0.3, 0.0], (0.0, until))
    assert run.settles().kind == "none"


class Shaken(hy.Automaton):
    """A ball on a table whose amplitude changes slowly."""

    x = hy.state()
    v = hy.state()
    depth: float = hy.parameter(0.01)
    slow: float = hy.parameter(1e-3)

    @hy.mode
    def flight(self, t, s):
        return s.v, -1.0

    hit = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - 1.2 * (1 + self.depth * jnp.sin(self.slow * t)) * jnp.sin(t),
        restitution=0.5,
    )


@pytest.mark.parametrize(("depth", "slow"), [(0.01, 1e-3), (0.1, 1e-3), (0.01, 3e-4)])
def test_a_slow_modulation_is_no_orbit(depth, slow):
    """The turns change by less and less, but evenly they do not."""
    run = hy.simulate(Shaken(depth=depth, slow=slow), {"x": 4.5, "v": 0.0}, (0.0, 300.0))
    assert run.settles().kind == "none"


def test_a_period_has_the_digits_that_are_known():
    """Of an orbit that is still approached fewer than of one that is reached."""
    run = hy.simulate(Shaken(depth=0.0), {"x": 4.5, "v": 0.0}, (0.0, 100.0))
    found = run.settles()
    assert found.kind == "periodic"
    shown = found.reason.split("T = ")[1].split(" ")[0]
    assert abs(float(shown) - 2 * math.pi) <= 0.51 * 10.0 ** -len(shown.partition(".")[2])
