"""Guards that jump over zero, or have a corner there: the loop judges them, as the driver would."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.run.driver import Driver

from .systems import without_loop

#: Guards of a body at ``x`` and the direction in which each fires.
GUARDS = {
    "flag": (lambda self, t, s: jnp.where(s.x < self.p, 1.0, -self.q), hy.FALLING),
    "onto zero": (lambda self, t, s: jnp.where(s.x < self.p, self.q, 0.0), hy.FALLING),
    "sign": (lambda self, t, s: jnp.sign(s.x - self.p) - 0.5, hy.RISING),
    "floor": (lambda self, t, s: self.q + 0.5 - jnp.floor(s.x / self.p), hy.FALLING),
    "corner": (lambda self, t, s: jnp.abs(s.x - self.p), hy.FALLING),
    "bent": (lambda self, t, s: jnp.maximum(self.p - s.x, 0.2 * (self.p - s.x)), hy.FALLING),
    "saw": (lambda self, t, s: self.p - jnp.mod(s.x, self.p), hy.FALLING),
    "ramp": (lambda self, t, s: s.x - 3.0 * self.p * (t - jnp.floor(t)), hy.EITHER),
    "broken": (
        lambda self, t, s: self.p - s.x + jnp.where(s.x < self.p, self.q, -self.q),
        hy.FALLING,
    ),
}


@cache
def watching(name):
    """A driven oscillator, and a count of the times at which a guard fires."""

    guard, crossing = GUARDS[name]

    class Watched(hy.Automaton):
        x = hy.state()
        v = hy.state()
        n = hy.state()
        p = hy.parameter(0.8)
        q = hy.parameter(0.3)
        back = hy.parameter(0.0)

        @hy.mode(initial=True)
        def on(self, t, s):
            return s.v, jnp.cos(1.7 * t) - 0.6 * s.x, 0.0

        @hy.edge(on, to=on, guard=lambda self, t, s: guard(self, t, s), crossing=crossing)
        def fire(self, t, s):
            return s.replace(x=s.x - self.back, n=s.n + 1)

    return Watched


START, SPAN = {"x": -0.1, "v": 1.5, "n": 0.0}, (0.0, 8.9)  # a saw of time jumps at none of these


def model_of(name):
    """But where a guard jumps back by itself its reset leads back inside."""
    return watching(name)(back=0.0 if name in ("saw", "ramp") else 1.1)


def run_of(name, **options):
    return hy.simulate(model_of(name), START, SPAN, **options)


def refused(driver, *_):
    raise AssertionError(f"the driver is asked at {driver.t}")


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("name", GUARDS)
def test_the_driver_flies_no_arc_of_a_guard_that_jumps(name, solver, monkeypatch):
    """Nor judges its jumps; lanes are the run."""
    monkeypatch.setattr(Driver, "jump", refused)
    monkeypatch.setattr(Driver, "flow_arc", refused)
    run = run_of(name, solver=solver, rtol=1e-10)
    assert len(run.jumps) >= 3
    lanes = hy.ensemble(
        model_of(name), {k: np.full(2, v) for k, v in START.items()}, SPAN, rtol=1e-10
    )
    assert lanes.jumps.values.tolist() == 2 * [len(run.jumps)]
    assert lanes.x.values == pytest.approx(
        np.full(2, run.final.x), abs=1e-7
    )  # of another solver's run


@pytest.mark.parametrize("name", GUARDS)
def test_it_fires_where_the_rules_one_by_one_have_it(name, monkeypatch):
    """By Taylor's steps and by another solver's, jump by jump, with the states on either side."""
    run, other = run_of(name, solver="taylor"), run_of(name, solver="scipy", rtol=1e-11)
    without_loop(monkeypatch)
    slow = run_of(name, solver="taylor")
    for one, off in ((run, 1e-10), (other, 1e-8)):  # one by one a jump is met to 2e-11
        np.testing.assert_allclose(one.jumps.t, slow.jumps.t, rtol=0, atol=off)
        for side in ("before", "after"):
            x, y = (getattr(r.jumps.table, side) for r in (one, slow))
            np.testing.assert_allclose(x, y, rtol=0, atol=off)


@pytest.mark.long
@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_saw_fires_at_all_teeth_on_either_side_of_zero(solver):
    """Down to zero as it comes to one from below, and onto zero from above: once at each."""
    grid = np.linspace(*SPAN, 200_001)
    for p, v in np.random.default_rng(0).uniform([0.3, 0.5], [1.2, 3.0], (30, 2)):
        start, rtol = {"x": -2.5 * p, "v": v, "n": 0.0}, 1e-11
        run = hy.simulate(watching("saw")(p=p), start, SPAN, solver=solver, rtol=rtol)
        x = hy.simulate(watching("flag")(p=1e3), start, SPAN, solver="taylor")
        assert len(run.jumps) == np.count_nonzero(np.diff(np.floor(x(grid).x / p))) >= 2


class Two(hy.Automaton):
    """A flag that falls, where another guard is zero, too: the first declared fires."""

    x = hy.state()
    n = hy.state()

    @hy.mode(initial=True)
    def on(self, t, s):
        return 1.0, 0.0

    @hy.mode
    def first(self, t, s):
        return 1.0, 0.0

    @hy.mode
    def second(self, t, s):
        return 1.0, 0.0


class Flagged(Two):
    one = hy.edge("on", to="first", guard=lambda self, t, s: jnp.where(s.x < 0.7, 1.0, -1.0))
    other = hy.edge("on", to="second", guard=lambda self, t, s: 0.7 - s.x)


class Smooth(Two):
    one = hy.edge("on", to="first", guard=lambda self, t, s: 0.7 - s.x)
    other = hy.edge("on", to="second", guard=lambda self, t, s: jnp.where(s.x < 0.7, 1.0, -1.0))


class Flags(Two):
    one = hy.edge("on", to="first", guard=lambda self, t, s: jnp.where(s.x < 0.7, 2.0, -3.0))
    other = hy.edge("on", to="second", guard=lambda self, t, s: jnp.where(s.x < 0.7, 1.0, -1.0))


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("model", [Flagged, Smooth, Flags])
def test_of_guards_that_jump_at_one_time_the_first_declared_fires(model, solver):
    """Beside one that is zero there without a jump, and beside another that jumps."""
    for start in np.linspace(-0.9, 0.6, 12):
        run = hy.simulate(model(), {"x": start, "n": 0.0}, (0.0, 2.0), solver=solver)
        assert list(run.jumps.edge) == ["one"]
