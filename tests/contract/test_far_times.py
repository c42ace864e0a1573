"""Far from t = 0, where floats lie apart, every method gives the same impacts."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

from .ways import later

pytestmark = pytest.mark.each_method

WAYS = ["DOP853", "Radau", "BDF", "LSODA", "Dopri8", "ensemble", "as_function"]

#: Walls: frequency, amplitude, restitution; chosen before anything was run.
WALLS = [(4.512, 0.49, 0.5), (1.0, 0.3, 0.8), (20.0, 0.02, 0.6), (9.0, 0.1, 0.9)]


class Shaken(hy.Automaton):
    """A body with drag over a wall that shakes."""

    x = hy.state()
    v = hy.state()
    w = hy.parameter(4.512)
    a = hy.parameter(0.49)
    r = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s):
        return s.v, -1.0 - 0.1 * s.v

    wall = hy.contact(
        flight, gap=lambda self, t, s: s.x + 0.4 - self.a * jnp.sin(self.w * t), restitution="r"
    )


@pytest.mark.parametrize(("w", "a", "r"), WALLS)
@pytest.mark.parametrize("t0", [0.0, 1e3, 1e6, *later(1e4, 1e5)])
def test_impacts_are_the_same_far_from_zero(way, t0, w, a, r):
    """As the Taylor series has them, whatever the spacing of floats: none is repeated."""
    model, start = Shaken(w=w, a=a, r=r), {"x": 1.5, "v": 0.0}
    exact = hy.simulate(model, start, (t0, t0 + 4.0), solver="taylor", max_jumps=200)
    result = way.run(model, start, (t0, t0 + 4.0), rtol=1e-9, max_jumps=200)
    assert result.status == exact.status.name.lower()
    if way.tells("accumulations"):
        assert result.accumulations == len(exact.zeno)
    # the first flights: each impact multiplies the error; of low order it is up to 1e-6
    count = min(3, len(exact.jumps))
    np.testing.assert_allclose(result.times[:count] - t0, exact.jumps.t[:count] - t0, atol=2e-6)
    speeds = exact.jumps.after.v[:count]
    np.testing.assert_allclose(result.after.v[:count], speeds, atol=2e-5)
    if not len(exact.zeno):
        assert result.jumps == len(exact.jumps)


class Table(hy.Automaton):
    """A body on a table whose phase is 0 at a time ``t0``."""

    x = hy.state()
    v = hy.state()
    t0 = hy.parameter(0.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -1.0

    hit = hy.contact(
        flight, gap=lambda self, t, s: s.x - 1.2 * jnp.sin(t - self.t0), restitution=0.5
    )


@pytest.mark.parametrize("t0", [1e6, 1e8, -1e8])
@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_errors_are_measured_where_forces_are_known_to_the_rounding_of_the_time(solver, t0):
    """By a run that asks for no more than that; the limits are those at 0, to 13 digits there."""
    exact = [
        point.t for point in hy.simulate(Table(), [2.0, 0.0], (0.0, 17.0), solver="taylor").zeno
    ]
    found = hy.simulate(Table(t0=t0), [2.0, 0.0], (t0, t0 + 17.0), solver=solver).zeno
    assert len(found) == len(exact) == 2
    for point, at in zip(found, exact, strict=True):
        # what a spacing of the time does to a series of fifty impacts, and not much more
        assert abs(point.t - t0 - at) <= point.t_error <= 1e-12 * abs(t0)


@pytest.mark.parametrize("t0", [2.0**16, 1e6, -1e7])
def test_a_body_at_rest_stays_on_a_table_whose_place_is_known_to_the_rounding_of_the_time(way, t0):
    """At tolerances smaller than what a spacing of the time moves the table: no corner is seen in
    that. The release is where the table falls as fast as bodies do, at a phase of arcsin(1 / 1.2);
    its time is rounded, as are the state and its force."""
    model, mode = Table(t0=t0), "flight.rest(hit)"
    start = {"x": 1.2 * np.sin(-2.0), "v": 1.2 * np.cos(-2.0)}
    result = way.run(model, start, (t0 - 2.0, t0 + 1.5), mode=mode, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(
        result.times[0] - t0, np.arcsin(1.0 / 1.2), atol=8 * np.spacing(abs(t0))
    )
