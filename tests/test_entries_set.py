"""Entries set and added in arrays, whole powers, signs, rates of determinants: as JAX has them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.automaton import trace
from hybrid.lowering.scene import scene_of

EDGES = np.linspace(-1.0, 1.0, 5)


def three(x, y):
    return jnp.stack([x, y, 0.3 + 0.0 * x])


def square(x, y):
    return jnp.outer(three(x, y), three(y, x)) + 2.0 * jnp.eye(3)


def place(x):
    return jnp.floor(1.5 + 1.4 * jnp.sin(5.0 * x)).astype(int)


#: Each of ``x`` and ``y``, a number.
KNOWN_PLACES = {
    "set": lambda x, y: three(x, y).at[1].set(2.0 * x) @ EDGES[:3],
    "add": lambda x, y: three(x, y).at[-1].add(x * y) @ EDGES[:3],
    "multiply": lambda x, y: three(x, y).at[0].multiply(y).at[1].divide(2.0 + x) @ EDGES[:3],
    "max, min": lambda x, y: three(x, y).at[0].max(y).at[2].min(x) @ EDGES[:3],
    "power": lambda x, y: three(x, y).at[1].power(3) @ EDGES[:3],
    "repeated": lambda x, y: (
        three(x, y).at[jnp.array([1, 1, 2, 1])].add(jnp.arange(4.0) * x) @ (EDGES[:3])
    ),
    "repeated product": lambda x, y: jnp.ones(3).at[np.array([2, 2])].mul(three(x, y)[:2])[2],
    "the last of two": lambda x, y: jnp.zeros(3).at[np.array([1, 1])].set(three(x, y)[:2])[1],
    "slices": lambda x, y: jnp.zeros(5).at[1:4].set(three(x, y)).at[::2].add(y) @ EDGES,
    "mask": lambda x, y: three(x, y).at[np.array([True, False, True])].set(y) @ EDGES[:3],
    "rows": lambda x, y: (
        jnp.zeros((3, 3)).at[1].set(three(x, y)).at[:, 2].add(three(y, x)).sum(0) @ (EDGES[:3])
    ),
    "entries of a matrix": lambda x, y: jnp.linalg.solve(
        jnp.eye(3).at[0, 1].set(x).at[np.arange(3), np.arange(3)].add(2.0 + y * y), three(x, y)
    )[0],
    "beyond the end": lambda x, y: three(x, y).at[7].set(5.0).sum(),
    "insert": lambda x, y: jnp.insert(three(x, y), 1, 2.0 * x) @ EDGES[:4],
    "sums of parts": lambda x, y: jax.ops.segment_sum(three(x, y), np.array([0, 1, 0]), 2)[0],
    "counts": lambda x, y: jnp.bincount(jnp.array([0, 1, 1]), weights=three(x, y), length=2)[1],
    "in a loop": lambda x, y: (
        jax.lax.fori_loop(0, 3, lambda i, c: c.at[i].set(x * i + y), jnp.zeros(3)) @ EDGES[:3]
    ),
}

MOVING_PLACES = {
    "set": lambda x, y: three(x, y).at[place(x)].set(2.0 * y) @ EDGES[:3],
    "add": lambda x, y: three(x, y).at[place(x)].add(2.0 * y) @ EDGES[:3],
    "two, one after the other": lambda x, y: (
        three(x, y).at[jnp.stack([place(x), place(y)])].add(x) @ (EDGES[:3])
    ),
    "max": lambda x, y: three(x, y).at[place(x)].max(y) @ EDGES[:3],
    "a row": lambda x, y: (
        jnp.zeros((3, 3)).at[jnp.argmax(three(x, y))].set(three(y, x)).sum(0) @ (EDGES[:3])
    ),
    "beyond the end": lambda x, y: three(x, y).at[place(x) + 2].set(5.0).sum(),
    "from the end": lambda x, y: three(x, y).at[-1 - place(x)].set(5.0) @ EDGES[:3],
    "histogram": lambda x, y: jnp.histogram(three(x, y), bins=EDGES)[0] @ EDGES[1:],
    "nonzero": lambda x, y: jnp.nonzero(three(x, y) > 0.2, size=3)[0] @ EDGES[:3],
    "unique": lambda x, y: jnp.unique(jnp.round(three(x, y)), size=3) @ EDGES[:3],
}

OTHERS = {
    "whole powers": lambda x, y: (
        jnp.power(x, 2.0) + y ** jnp.array(3.0) + jnp.vander(three(x, y))[1, 0]
    ),
    "copysign": lambda x, y: jnp.copysign(y, x),
    "largest": lambda x, y: (
        jax.scipy.special.logsumexp(three(x, y)) + jax.nn.softmax(three(x, y))[0]
    ),
    "rate of det": lambda x, y: jax.jvp(
        lambda x: jnp.linalg.det(square(x, y) @ square(y, x)), (x,), (1.0 + 0.0 * x,)
    )[1],
    "rate of det 4": lambda x, y: jax.jvp(
        lambda x: jnp.linalg.det(jnp.eye(4) * x + jnp.outer(jnp.arange(4.0), EDGES[:4] + x)),
        (x,),
        (1.0 + 0.0 * x,),
    )[1],
    "rate of slogdet": lambda x, y: jax.jvp(
        lambda x: jnp.linalg.slogdet(square(x, y))[1], (x,), (1.0 + 0.0 * x,)
    )[1],
}

ALL = {
    **{f"known: {name}": force for name, force in KNOWN_PLACES.items()},
    **{f"moving: {name}": force for name, force in MOVING_PLACES.items()},
    **OTHERS,
}


def model(force):
    class Pulled(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def flow(self, t, s):
            return s.v, -s.x + 0.3 * force(s.x, s.v)

    return Pulled()


@pytest.fixture
def wide():
    """64 bits also on the thread on which JAX calls back."""
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


@pytest.mark.parametrize("name", ALL)
def test_values_are_those_of_jax_and_series_begin_with_them(name):
    """At random points, to rounding: sums may be in another order."""
    made = model(ALL[name])
    field, flow = scene_of(made).field("flow"), trace.again(type(made).traces["flow", "flow"])
    assert field.refused == ""
    draw = np.random.default_rng(1)
    for _ in range(12):
        x = draw.uniform(-1.0, 1.0, 2)
        with trace.wide():
            expected = np.asarray(flow((), np.float64(0.5), x))
        np.testing.assert_allclose(field.rhs(0.5, x.tolist()), expected, rtol=1e-12, atol=1e-13)
        states, _, _ = field.expand(0.5, x.tolist(), [0] * field.kinks)
        np.testing.assert_allclose([c[1] for c in states], expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", ["moving: add", "moving: histogram", "largest", "known: repeated"])
def test_solvers_agree(name):
    """To a hundred times the tolerance: their steps end where a formula changes."""
    start = {"x": -0.9, "v": 1.1}
    runs = [
        hy.simulate(model(ALL[name]), start, (0.0, 2.0), solver=solver, rtol=1e-9, atol=1e-9)
        for solver in ("taylor", "scipy", "diffrax")
    ]
    for run in runs[1:]:
        np.testing.assert_allclose([*run.final], [*runs[0].final], rtol=0, atol=1e-7)


def test_a_whole_power_goes_through_zero():
    """x = t - 1, y' = x^2 by an exponent that is a float: y = 2/3 where x has come to 1."""

    class Squared(hy.Automaton):
        x = hy.state()
        y = hy.state()

        @hy.mode
        def flow(self, t, s):
            return 1.0, jnp.power(s.x, jnp.array(2.0))

    run = hy.simulate(Squared(), [-1.0, 0.0], (0.0, 2.0), solver="taylor")
    assert run.final.y == pytest.approx(2.0 / 3.0, rel=1e-14)


@pytest.mark.parametrize("name", ["known: add", "moving: set", "whole powers", "copysign"])
def test_guards_resets_and_derivatives_have_them_too(name, wide):
    """Slopes by the start are differences of runs, whose error is 1e-9."""
    force = ALL[name]

    class Pushed(hy.Automaton):
        x = hy.state()
        y = hy.state()

        @hy.mode
        def flow(self, t, s):
            return 1.0 + 0.0 * s.x, 0.3

        @hy.edge(flow, guard=lambda self, t, s: 0.1 * force(s.x, s.y) + 0.6 - s.x)
        def push(self, t, s):
            return -0.9, s.y + 0.1 * force(s.x, s.y)

    final = hy.as_function(Pushed(), t=(0.0, 1.2), max_jumps=4)
    end = lambda x: final(Pushed(), {"x": x, "y": 0.25}).final["y"]  # noqa: E731
    slope, change = float(jax.jacfwd(end)(0.1)), float(end(0.1 + 1e-5) - end(0.1 - 1e-5)) / 2e-5
    assert slope == pytest.approx(change, abs=1e-8)
    finals = [
        hy.simulate(Pushed(), [0.1, 0.25], (0.0, 1.2), solver=solver, rtol=1e-10).final
        for solver in ("taylor", "scipy", "diffrax")
    ]
    np.testing.assert_allclose(finals[1:], [finals[0]] * 2, atol=1e-8)


@pytest.mark.parametrize("what", ["flow", "guard", "reset"])
def test_a_function_that_is_applied_in_place_is_refused(what):
    """JAX hands it over inside of an operation, and has no derivative of that."""
    wrong = lambda s: s.x.at[1].apply(jnp.sin)  # noqa: E731
    with pytest.raises(hy.DeclarationError, match=r"test_entries_set.py:\d+.*x\[i\]") as told:

        class Applied(hy.Automaton):
            x = hy.state(shape=(2,))

            @hy.mode
            def flow(self, t, s):
                return wrong(s) if what == "flow" else s.x

            @hy.edge(flow, guard=lambda self, t, s: wrong(s)[0] if what == "guard" else s.x[0])
            def push(self, t, s):
                return wrong(s) if what == "reset" else s.x

    assert len(told.value.faults) == 1


def test_a_function_without_derivative_is_refused_in_a_guard_with_its_line():
    with pytest.raises(hy.DeclarationError, match=r"guard: the logarithm .*test_entries_set.py:"):

        class Gamma(hy.Automaton):
            x = hy.state()

            @hy.mode
            def flow(self, t, s):
                return 1.0

            @hy.edge(flow, guard=lambda self, t, s: jax.scipy.special.gammaln(s.x) - 1.0)
            def push(self, t, s):
                return s.x
