"""Second derivatives of runs: the arcs and jumps of a run flown again by JAX."""

import runpy
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.functions import function
from hybrid.functions.function import OUTPUTS, runs_of
from hybrid.lowering import jit
from hybrid.replay.function import Replay
from models.bouncing_ball import BouncingBall
from tests import gradients
from tests.contract.ways import later, spread

neural = SimpleNamespace(**runpy.run_path("docs/examples/neural_force.py"))


#: Settings of XLA in these tests.
OPTIONS = {**jit._options(), "xla_backend_optimization_level": 0}


@pytest.fixture(autouse=True)
def _wide(monkeypatch):
    """The user's own setting, for these tests only: of all threads, as a long program calls the
    run back from another. XLA tries less hard: it keeps no program that calls back, and compiling
    them is most of what these tests take."""
    monkeypatch.setattr(jit, "_options", lambda: OPTIONS)
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def fall(t1=1.5, **options):
    """A ball that is dropped, by restitution, gravity and height."""
    run = hy.as_function(BouncingBall(), t=(0.0, t1), max_jumps=8, max_steps=64, **options)
    return lambda p: run(BouncingBall(r=p[0], g=p[1]), {"x": p[2], "v": 0.0})


def height(p):
    """The same after one impact, at 1.5."""
    r, g, h = p
    drop = jnp.sqrt(2 * h / g)
    return r * g * drop * (1.5 - drop) - g * (1.5 - drop) ** 2 / 2


AT = np.array([0.7, 9.81, 3.0])


#: The other two orders are met by sums of runs and by a scan, below.
MODES = [jax.jacfwd, jax.jacrev]


@pytest.mark.parametrize(("outer", "inner"), spread(MODES, MODES, of=2))
def test_second_derivatives_of_a_state_in_flight(outer, inner):
    """The closed form, in either order of modes, compiled and mapped over starts."""
    end = lambda p: fall()(p).final["x"]  # noqa: E731
    rows = np.array([AT, 1.01 * AT])
    found = jit.jit(jax.vmap(outer(inner(end))))(rows)
    np.testing.assert_allclose(found, jax.jit(jax.vmap(jax.hessian(height)))(rows), atol=1e-13)


def test_second_derivatives_of_a_jump():
    """Its time, and the speed before it; what is not asked for is not there."""
    table = lambda p: fall(outputs=("jumps",))(p).jumps  # noqa: E731
    first = lambda p: (table(p).t[0], table(p).before["v"][0])  # noqa: E731
    by_time, by_speed = jit.jit(jax.hessian(first))(AT)
    exact = jax.hessian(lambda p: jnp.sqrt(2 * p[2] / p[1]))(AT)
    np.testing.assert_allclose(by_time, exact, atol=1e-14)
    exact = jax.hessian(lambda p: -jnp.sqrt(2 * p[2] * p[1]))(AT)
    np.testing.assert_allclose(by_speed, exact, atol=1e-14)


#: Differences of fourth order of first derivatives, a step of 1e-4: they err by the fourth power of
#: the step times a fifth derivative, and by the rounding of first ones, 1e-12, over the step.
OFF = 1e-7


def compared(name, seed, **options):
    """Second derivatives of all that a scene's run gives against differences of first ones: the
    largest distance against the largest of a number's, and how many numbers were compared."""
    _, row = gradients.drawn(name, seed)
    runs = runs_of(_, OUTPUTS, max_jumps=16, max_steps=256, **options)
    numbers, ints, slopes = runs.slopes(row)
    ask = lambda row: runs.plan(np.asarray(row))  # noqa: E731
    replay = Replay(runs.cls, runs.shapes, runs.layout.shapes, 16, 256, ask)

    @jit.jit
    def both(row):
        slope = jax.jacfwd(partial(replay.fly, replay.plan(row)[1]))
        return jax.jacfwd(lambda row: (slope(row),) * 2, has_aux=True)(row)

    second, first = both(row)
    known = np.isfinite(numbers) & np.isfinite(slopes).all(axis=1)
    np.testing.assert_allclose(first[known], slopes[known], rtol=1e-9, atol=1e-9)
    off, judged = 0.0, 0
    for column in range(len(row)):
        step = 1e-4 * max(1.0, abs(row[column]))
        change = _difference(runs, row, column, step, ints)
        if change is not None:
            sizes = np.maximum(np.abs(change[known]).max(axis=1), 1.0)
            far = np.abs(second[known, :, column] - change[known]).max(axis=1) / sizes
            off, judged = max(off, far.max()), judged + far.size
    return off, judged


def _difference(runs, row, column, step, ints):
    ends = []
    for k in (-2, -1, 1, 2):
        moved = row.copy()
        moved[column] += k * step
        _, other, slopes = runs.slopes(moved)
        if not np.array_equal(other, ints):
            return None
        ends.append(slopes)
    return (8 * (ends[2] - ends[1]) - (ends[3] - ends[0])) / (12 * step)


@pytest.mark.parametrize("name", ["kicked", "relay", *later("belt", "forced", "heavy")])
def test_second_derivatives_against_differences(name):
    """Impacts, edges with resets by time, state and parameters, a mass that is a matrix;
    sliding, from where it begins to where it ends."""
    off, judged = compared(name, 0, zeno="ignore")
    assert off < OFF
    assert judged > 50


class Lifted(hy.Automaton):
    """A body that a force which grows lifts off a floor that moves; what lands there stays."""

    x = hy.state()
    v = hy.state()
    lift = hy.parameter(4.0)
    g = hy.parameter(9.0)
    rise = hy.parameter(0.5)

    @hy.mode
    def fly(self, t, s):
        return s.v, self.lift * t - self.g

    floor = hy.contact(fly, gap=lambda self, t, s: s.x - self.rise * t**2, restitution=0.0)


@pytest.mark.long
@pytest.mark.parametrize("start", [0.0, 1.0])
def test_second_derivatives_through_rest_and_release(start):
    """At rest from the start on, or once it has landed: it lifts off at (g + 2 rise) / lift."""
    run = hy.as_function(Lifted(), t=(0.0, 4.0), max_jumps=4, max_steps=64)

    def end(p):
        return run(Lifted(lift=p[0], g=p[1], rise=p[2]), {"x": p[3], "v": 0.0}).final["x"]

    def exact(p):
        lift, g, rise, _ = p
        off = (g + 2.0 * rise) / lift
        away = 4.0 - off
        return rise * off**2 + 2.0 * rise * off * away + rise * away**2 + lift * away**3 / 6.0

    at = np.array([4.0, 9.0, 0.5, start])
    if not start:  # on the floor: a start above it would be another run
        end, exact = (partial(lambda f, p: f(jnp.append(p, 0.0)), f) for f in (end, exact))
        at = at[:3]
    assert float(end(at)) == pytest.approx(float(exact(at)), rel=1e-13)
    found = jit.jit(jax.jacfwd(jax.grad(end)))(at)
    np.testing.assert_allclose(found, jax.jit(jax.hessian(exact))(at), atol=1e-12)


def test_second_derivatives_inside_a_scan():
    """Of forward mode, three runs one behind the other: each has a closed form, after an impact."""
    run = hy.as_function(BouncingBall(), t=(0.0, 0.8), max_jumps=8, max_steps=64)

    def flown(r, h):
        return run(BouncingBall(r=r), {"x": h, "v": 0.1}).final["x"]

    def exact(r, h, g=9.81):
        speed = jnp.sqrt(0.1**2 + 2 * g * h)
        left = 0.8 - (0.1 + speed) / g
        return r * speed * left - g * left**2 / 2

    def fold(end, p):
        step = lambda x, _: (end(p[0], 2.0 + 0.3 * x), None)  # noqa: E731
        return jax.lax.scan(step, p[1], None, length=3)[0]

    at = np.array([0.7, 0.5])
    found = [jit.jit(jax.jacrev(jax.jacfwd(partial(fold, end))))(at) for end in (flown, exact)]
    np.testing.assert_allclose(*found, rtol=1e-12)


@pytest.mark.long
def test_second_derivatives_of_many_runs_at_once():
    """Forward and reverse over the gradient of a sum of runs: the sum of what each has."""
    rows = np.array([AT, 1.01 * AT])
    run = lambda p: fall()(p).final["x"]  # noqa: E731
    shifted = lambda p: jax.vmap(lambda row: run(p * row))(rows).sum()  # noqa: E731
    exact = jax.hessian(lambda p: jax.vmap(lambda row: height(p * row))(rows).sum())(np.ones(3))
    for outer in (jax.jacfwd, jax.jacrev):
        found = jit.jit(outer(jax.grad(shifted)))(np.ones(3))
        np.testing.assert_allclose(found, exact, atol=1e-11)


# ---------------------------------------------------------------------------------------
# many parameters


@pytest.mark.long
def test_gradients_by_many_weights_are_those_of_the_first_variation(monkeypatch):
    """Values to the last bit, gradients to rounding: of a network's weights, of runs at once."""
    cls, weights = neural.learner(3)
    losses = []
    for many in (0, len(weights)):
        monkeypatch.setattr(function, "MANY_PARAMETERS", many)
        losses.append(jit.jit(jax.value_and_grad(neural.loss_of(cls)))(weights))
    (value, slopes), (same, others) = losses
    assert float(value) == float(same)
    np.testing.assert_allclose(slopes, others, rtol=1e-9, atol=1e-12)


def test_a_network_learns_a_force_from_impacts():
    """The example, with few weights and steps: both what is seen and the force come nearer."""
    (loss, off), (less, nearer) = neural.main(width=4, iterations=30)
    assert less < 1e-2 * loss
    assert nearer < 0.5 * off


@pytest.mark.long
def test_with_many_parameters_accumulations_have_first_derivatives(monkeypatch):
    """One of three runs accumulates: its gradient is that of the first variation."""
    rows, found = np.array([AT, 1.01 * AT, [0.3, 9.81, 1.0]]), []
    for many in (0, 3):
        monkeypatch.setattr(function, "MANY_PARAMETERS", many)
        run = fall()
        slope = jax.grad(lambda p, run=run: run(p).final["x"] + run(p).jumps.t[0])
        found.append(jit.jit(jax.vmap(slope))(rows))
    np.testing.assert_allclose(*found, atol=1e-13)


# ---------------------------------------------------------------------------------------
# where there are none


@pytest.mark.long
def test_through_an_accumulation_there_are_none():
    """A sentence says so, and they are NaN; the first ones are there, and the second ones of
    another lane, and of what is before."""
    end = lambda p: fall(t1=3.0)(p).zeno.t  # noqa: E731
    low = np.array([0.3, 9.81, 1.0])
    assert np.all(np.isfinite(jit.jit(jax.grad(end))(low)))
    with pytest.warns(UserWarning, match=r"first derivatives only.*second derivatives .* NaN"):
        found = np.asarray(jit.jit(jax.jacrev(jax.jacfwd(end)))(low))
    assert np.all(np.isnan(found))
    high = lambda p: fall()(p).final["x"]  # noqa: E731
    with pytest.warns(UserWarning, match="first derivatives only"):
        lanes = jit.jit(jax.vmap(jax.hessian(high)))(np.array([AT, low]))
    np.testing.assert_allclose(lanes[0], jax.hessian(height)(AT), atol=1e-13)
    assert np.isnan(lanes[1]).any()


def test_a_third_derivative_is_refused():
    """When it is asked for, before anything runs."""
    end = lambda p: fall()(p).final["x"]  # noqa: E731
    with pytest.raises(hy.OptionError, match="a third one was asked for"):
        jax.jacfwd(jax.hessian(end))(AT)


def test_a_run_that_was_cut_has_none():
    """The sentence is that of its status."""
    run = hy.as_function(BouncingBall(), t=(0.0, 1.5), max_jumps=8, max_steps=1)
    end = lambda h: run(BouncingBall(), {"x": h, "v": 0.0}).final["x"]  # noqa: E731
    with pytest.warns(UserWarning, match="max_steps was reached; raise it"):
        assert np.isnan(jit.jit(jax.hessian(end))(3.0))
