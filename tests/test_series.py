"""Taylor series at kinks and of systems of equations, and flows that have none."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import airy

import hybrid as hy
from hybrid.lowering import scene_of

TAYLOR = {"solver": "taylor", "rtol": 1e-11, "atol": 1e-12}


class Airy(hy.Automaton):
    """y'' = t y: two in three coefficients of the series vanish at the start."""

    y = hy.state()
    v = hy.state()

    @hy.mode
    def flow(self, t, s):
        return s.v, t * s.y

    low = hy.edge(flow, to=flow, guard=lambda self, t, s: s.y + 0.4, crossing=hy.EITHER)


class Dragged(hy.Automaton):
    """A kink at rest, where the run begins; one parameter is used by nobody."""

    unused: float = hy.parameter(1.0)
    x = hy.state()
    v = hy.state()

    @hy.mode
    def fall(self, t, s):
        return s.v, -9.81 - 0.5 * jnp.abs(s.v) * s.v

    impact = hy.contact(fall, gap=lambda self, t, s: s.x, restitution=0.7)


class Solved(hy.Automaton):
    """A flow that solves equations: they are written out."""

    x = hy.state(shape=(2,))

    @hy.mode
    def flow(self, t, s):
        return jnp.linalg.solve(jnp.array([[2.0, 1.0], [0.0, 2.0]]), -s.x)


class Library(hy.Automaton):
    """A flow that needs a library: the eigenvalues 1 - k and 1 + k, whose sum is 2."""

    x = hy.state(shape=(2,))

    @hy.mode
    def flow(self, t, s):
        k = 0.1 * s.x[0]
        one = jnp.ones_like(k)
        return -0.25 * jnp.sum(jnp.linalg.eigvalsh(jnp.array([[one, k], [k, one]]))) * s.x


def test_small_terms_alone_prove_nothing():
    """Airy's function from 0 on: the polynomial of a step is held against the flow."""
    ai, slope, _, _ = airy(0.0)
    run = hy.simulate(Airy(), {"y": ai, "v": slope}, (0.0, 2.0), **TAYLOR)
    assert run.final.y == pytest.approx(airy(2.0)[0], abs=1e-10)


def test_a_kink_is_passed_and_a_zero_state_needs_no_atol():
    """Drag |v| v from rest, with atol = 0: against the Taylor series that knows the kink."""
    start, until = {"x": 1.0, "v": 0.0}, (0.0, 1.2)
    exact = hy.simulate(Dragged(), start, until, solver="taylor")
    run = hy.simulate(Dragged(), start, until, **{**TAYLOR, "atol": 0.0})
    np.testing.assert_allclose(run.jumps.t, exact.jumps.t, rtol=1e-9)
    lanes = hy.ensemble(Dragged(), start, until, rtol=1e-11, atol=0.0)
    assert float(lanes.x[0]) == pytest.approx(exact.final.x, abs=1e-9)


def test_a_flow_that_needs_a_library_runs():
    """It has no series: x' = -x / 2."""
    assert scene_of(Library()).field("flow").jets is None
    start = np.array([[1.0, 0.0], [0.0, 2.0]])
    lanes = hy.ensemble(Library(), {"x": start}, (0.0, 1.0))
    np.testing.assert_allclose(lanes.x, np.exp(-0.5) * start, atol=1e-7)


def test_a_flow_that_solves_equations_has_series():
    """Of lanes, too: x' = -A^-1 x."""
    assert scene_of(Solved()).field("flow").jets is not None
    lanes = hy.ensemble(Solved(), {"x": np.array([[1.0, 0.0], [0.0, 2.0]])}, (0.0, 1.0))
    decay = np.exp(-0.5)
    np.testing.assert_allclose(lanes.x, [[decay, 0.0], [0.5 * decay, 2 * decay]], atol=1e-7)


class Cornered(hy.Automaton):
    """A floor with corners, which come up between impacts and at them."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def fall(self, t, s):
        return s.v, -9.8

    impact = hy.contact(
        fall, gap=lambda self, t, s: s.x - jnp.abs(jnp.sin(3.0 * t)), restitution=0.8, rests=False
    )


class Clipped(hy.Automaton):
    """A clipped force, which is so for less than a step on the way down."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def fall(self, t, s):
        return s.v, -9.8 + jnp.clip(15.0 - 30.0 * s.x - 2.0 * s.v, -15.0, 15.0)

    impact = hy.contact(fall, gap=lambda self, t, s: s.x, restitution=0.7)


class Thrust(hy.Automaton):
    """A force that acts for a fiftieth of a second, all at once."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def fall(self, t, s):
        return s.v, -9.8 + jnp.where((t > 0.61) & (t < 0.63), 300.0, 0.0)

    impact = hy.contact(fall, gap=lambda self, t, s: s.x, restitution=0.7)


@pytest.mark.parametrize("model", [Clipped(), Thrust(), Cornered()])
def test_kinks_within_a_step_are_seen(model):
    """Of the flow or of the guard: runs and lanes against solver="taylor", in few steps."""
    starts, until = np.array([5.0, 3.0, 2.1]), (0.0, 6.0)
    lanes = hy.ensemble(model, {"x": starts, "v": 1.0}, until, rtol=1e-11, atol=1e-12)
    for lane, x in enumerate(starts.tolist()):
        exact = hy.simulate(model, {"x": x, "v": 1.0}, until, solver="taylor")
        run = hy.simulate(model, {"x": x, "v": 1.0}, until, **TAYLOR)
        np.testing.assert_allclose(run.jumps.t, exact.jumps.t, rtol=1e-10)
        assert float(lanes.x[lane]) == pytest.approx(exact.final.x, abs=1e-9)
    assert np.all(lanes.steps < 20 * lanes.jumps + 100)
