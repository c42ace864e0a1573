"""What engineers write in flows has Taylor series, and is the same with every solver."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import gamma

import hybrid as hy
from hybrid.automaton import trace
from hybrid.lowering.scene import scene_of

KNOTS, VALUES = np.linspace(-2, 2, 9), np.array([0, 0.3, -0.2, 0.5, 0.1, -0.4, 0.2, 0.6, -0.1])
LONG = np.linspace(-2, 2, 10001)
UNEVEN = np.concatenate([[-2.0, -1.9, -1.9, -1.9], np.geomspace(0.001, 2.0, 90) - 1.0])


def masses(m, n, x, y):
    """A definite matrix that moves."""
    i = np.arange(n)
    c, d = m.cos(x * m.asarray(0.3 * i)), m.sin(y * m.asarray(0.2 * i))
    return np.exp(-0.3 * np.abs(i[:, None] - i)) + np.eye(n) + 0.5 * m.outer(c, c) + m.outer(d, d)


def forces(m, n, x, y):
    return m.stack([x * (k + 1) / n + y for k in range(n)])


def turning(m, x, y):
    """A matrix whose largest numbers of a column change on the way."""
    one = 1 + 0 * x
    rows = [x, one, 0.3 * y, 0.1 * one], [one, y, 0.2 * one, x], [0.3 * one, 0.1 + x, 2 + y * y, y]
    return m.stack([*map(m.stack, rows), m.stack([y, 0.3 * one, x, 1.5 * one])])


def three(m, x, y):
    return m.stack([x, y, 0.3 + 0 * x])


#: Each of ``m`` (numpy or jax.numpy), ``t``, ``x`` and ``y``.
SMOOTH = {
    **{
        f"solve {n}": lambda m, t, x, y, n=n: m.linalg.solve(
            masses(m, n, x, y), forces(m, n, x, y)
        ).sum()
        for n in (2, 3, 6, 8)
    },
    **{
        f"det {n}": lambda m, t, x, y, n=n: 0.05 * m.linalg.det(masses(m, n, x, y))
        for n in (3, 4, 8)
    },
    **{
        f"cholesky {n}": lambda m, t, x, y, n=n: m.linalg.cholesky(masses(m, n, x, y)).sum()
        for n in (3, 8)
    },
    "inv 8": lambda m, t, x, y: (m.linalg.inv(masses(m, 8, x, y)) @ forces(m, 8, x, y))[2],
    "solve, turning": lambda m, t, x, y: m.linalg.solve(turning(m, x, y), forces(m, 4, x, y))[1],
    "det, turning": lambda m, t, x, y: m.linalg.det(turning(m, x, y)),
    "slogdet": lambda m, t, x, y: m.prod(m.stack(m.linalg.slogdet(masses(m, 4, x, y)))),
    "norm": lambda m, t, x, y: m.linalg.norm(three(m, x, y)) + m.linalg.norm(masses(m, 3, x, y)),
    "cross": lambda m, t, x, y: m.cross(three(m, x, y), three(m, y, t + 0 * x)).sum(),
    "einsum": lambda m, t, x, y: m.einsum(
        "i,ij,j->", three(m, x, y), masses(m, 3, x, y), three(m, y, x)
    ),
    "outer": lambda m, t, x, y: m.trace(m.outer(three(m, x, y), three(m, y, x))),
    "sums": lambda m, t, x, y: (
        three(m, x, y).mean() + m.cumsum(three(m, x, y))[1] * m.cumprod(three(m, x, y))[2]
    ),
    "ranges": lambda m, t, x, y: (m.linspace(x, y, 5) * m.arange(5)).sum(),
    "moved": lambda m, t, x, y: (
        m.roll(three(m, x, y), 1) @ three(m, x, y) + m.diff(m.tile(three(m, x, y), 2))[3]
    ),
    "angles": lambda m, t, x, y: m.hypot(x, y) + m.arctan2(y, x + 4) + m.sinc(x) + m.deg2rad(y),
    "powers": lambda m, t, x, y: m.power(x * x + 1, y) + m.cbrt(x + 3) + m.float_power(2.0, x),
    "logarithms": lambda m, t, x, y: m.expm1(x) + m.log1p(y * y) + m.logaddexp(x, y),
}

#: Those that change their formula on the way.
PIECEWISE = {
    "interp": lambda m, t, x, y: m.interp(x, KNOTS, VALUES),
    "interp of the time": lambda m, t, x, y: m.interp(t, KNOTS + 1.5, VALUES),
    "interp, 10001 knots": lambda m, t, x, y: m.interp(x, LONG, np.abs(np.sin(3 * LONG))),
    "interp, uneven": lambda m, t, x, y: m.interp(x, UNEVEN, np.cos(UNEVEN)),
    "interp, period": lambda m, t, x, y: m.interp(
        x, np.array([0.0, 0.2, 0.5, 0.8]), np.array([0.0, 1.0, 0.5, 0.2]), period=1.0
    ),
    "searchsorted": lambda m, t, x, y: m.searchsorted(UNEVEN, x) * 0.1,
    "searchsorted, right": lambda m, t, x, y: m.searchsorted(UNEVEN, x, side="right") * 0.1,
    "digitize": lambda m, t, x, y: 0.1 * m.digitize(y, KNOTS),
    "table": lambda m, t, x, y: m.asarray(VALUES)[m.floor(4 + 3 * m.sin(x)).astype(int)],
    "table of the state": lambda m, t, x, y: three(m, x, y)[
        m.floor(1.5 + m.sin(3 * x)).astype(int)
    ],
    "table of two": lambda m, t, x, y: m.asarray(np.outer(VALUES, VALUES))[
        m.floor(4 + 2 * m.sin(x)).astype(int), m.floor(4 + 2 * m.sin(y)).astype(int)
    ],
    "rows of a table": lambda m, t, x, y: m.asarray(np.outer(VALUES, VALUES))[
        m.stack([m.floor(4 + 2 * m.sin(x)), m.floor(4 + 2 * m.sin(y))]).astype(int)
    ].sum(),
    "take": lambda m, t, x, y: m.take(m.asarray(VALUES), m.floor(4 + 2 * m.sin(x)).astype(int)),
    "select": lambda m, t, x, y: m.select([x < -0.5, x < 0.4], [x, y], 0.3),
    "argmax": lambda m, t, x, y: m.asarray(VALUES)[m.argmax(three(m, x, y))],
    "argmin": lambda m, t, x, y: 0.5 * m.argmin(three(m, x, y)),
    "sort": lambda m, t, x, y: m.sort(three(m, x, y)) @ np.array([1.0, 0.5, -0.3]),
    "argsort": lambda m, t, x, y: m.asarray(VALUES)[m.argsort(three(m, x, y))[1]],
    "median": lambda m, t, x, y: m.median(three(m, x, y)),
    "clip": lambda m, t, x, y: m.clip(x, -0.5, 0.5) + m.maximum(y, 0.1) - m.minimum(x, y),
    "extremes": lambda m, t, x, y: three(m, x, y).max() + three(m, x, y).min(),
    "steps": lambda m, t, x, y: m.sign(x) + 0.2 * m.floor(2 * x) + 0.1 * m.round(3 * y),
    "remainders": lambda m, t, x, y: m.mod(x, 0.7) + m.fmod(y, 0.4) + x // 0.5 * 0.1,
}


def special(t, x, y):
    return (
        jax.scipy.special.erf(x) + jax.nn.sigmoid(y) + jax.scipy.special.logsumexp(three(jnp, x, y))
    )


def lagrange(t, x, y):
    """``M q'' = dL/dq - (dL/dq')_q q'`` of two coordinates."""

    def energy(q, v):
        return 0.5 * v @ masses(jnp, 2, *q) @ v - jnp.cos(q[0]) * q[1] ** 2

    q, v = jnp.stack([x, 0.3 + 0 * x]), jnp.stack([y, 0.1 + 0 * y])
    inertia = jax.hessian(energy, 1)(q, v)
    moved = jax.jacfwd(jax.grad(energy, 1), 0)(q, v) @ v
    return jnp.linalg.solve(inertia, jax.grad(energy)(q, v) - moved)[1]


#: Those that numpy has not; held to what JAX gives.
OF_JAX = {
    "special": special,
    "lagrange": lagrange,
    "piecewise": lambda t, x, y: jnp.piecewise(
        x, [x < -0.5, x > 0.4], [lambda x: x * x, lambda x: -x, 0.3]
    ),
    "cond": lambda t, x, y: jax.lax.cond(x > 0.2, lambda: x * x, lambda: -y),
    "switch": lambda t, x, y: jax.lax.switch(
        jnp.int32(jnp.floor(x) + 1), [lambda: x * x, lambda: -y, lambda: 0.3 + 0 * x]
    ),
    "loop": lambda t, x, y: jax.lax.fori_loop(0, 4, lambda i, s: 0.5 * s * x + 0.1 * i, y),
    "scan": lambda t, x, y: jax.lax.scan(lambda c, a: (c * x + a, c), y, jnp.array(VALUES))[0],
    "vmap": lambda t, x, y: jax.vmap(lambda a: jnp.sin(a) * x)(three(jnp, x, y)).sum(),
    "slope of interp": lambda t, x, y: jax.grad(lambda a: jnp.interp(a, UNEVEN, UNEVEN**2))(x),
    "one hot": lambda t, x, y: jax.nn.one_hot(jnp.int32(jnp.floor(x) + 1), 3) @ three(jnp, x, y),
    "networks": lambda t, x, y: (
        jax.nn.relu(x) + jax.nn.silu(y) + jax.nn.gelu(x) + jax.nn.softmax(three(jnp, x, y))[0]
    ),
    "filled": lambda t, x, y: (
        jnp.array(VALUES)
        .at[jnp.array([jnp.int32(9 * jnp.sin(3 * x))])]
        .get(mode="fill", fill_value=2.0)[0]
    ),
}


def model(force):
    class Pulled(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def flow(self, t, s):
            return s.v, -s.x + 0.3 * force(t, s.x, s.v)

    return Pulled()


def written(name):
    """The force with ``jax.numpy``, and with numpy where that has it."""
    force = {**SMOOTH, **PIECEWISE}.get(name)
    return (OF_JAX[name], None) if force is None else (partial(force, jnp), partial(force, np))


START = {"x": -0.9, "v": 1.1}


@pytest.mark.parametrize("name", [*SMOOTH, *PIECEWISE, *OF_JAX])
def test_values_are_those_of_numpy_and_series_begin_with_them(name):
    """At random points, to the rounding of a matrix of condition 100; positive places, as numpy
    counts others from the end."""
    own, other = written(name)
    made = model(own)
    field, flow = scene_of(made).field("flow"), trace.again(type(made).traces["flow", "flow"])
    assert field.refused == ""
    draw = np.random.default_rng(1)
    for _ in range(8):
        t, x = float(draw.uniform(0.2, 1)), draw.uniform(-1.0, 1.0, 2)
        with trace.wide():
            expected = np.asarray(flow((), np.float64(t), x))
        if other is not None:
            force = -x[0] + 0.3 * other(t, *x)
            np.testing.assert_allclose(expected[1], force, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(field.rhs(t, x.tolist()), expected, rtol=1e-12, atol=1e-13)
        states, _, _ = field.expand(t, x.tolist(), [0] * field.kinks)
        np.testing.assert_allclose([c[1] for c in states], expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", SMOOTH)
def test_runs_are_those_of_solve_ivp(name):
    """To a hundred times the tolerance."""
    own, other = written(name)
    run = hy.simulate(model(own), START, (0.0, 0.7), solver="taylor")
    rates = lambda t, z: [z[1], -z[0] + 0.3 * other(t, *z)]  # noqa: E731
    exact = solve_ivp(rates, (0.0, 0.7), [-0.9, 1.1], method="DOP853", rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose([*run.final], exact.y[:, -1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("solver", ["scipy", "diffrax"])
@pytest.mark.parametrize(
    "name",
    ["solve 8", "det, turning", "interp", "interp, uneven", "table", "argmax", "sort"],
)
def test_solvers_agree(name, solver):
    """To a hundred times the tolerance: their steps end where a formula changes."""
    own, _ = written(name)
    run = hy.simulate(model(own), START, (0.0, 2.0), solver=solver, rtol=1e-9, atol=1e-9)
    exact = hy.simulate(model(own), START, (0.0, 2.0), solver="taylor")
    np.testing.assert_allclose([*run.final], [*exact.final], rtol=0, atol=1e-7)


def test_a_long_table_is_exact_between_its_knots():
    """``x' = 1`` through 10001 knots: the integral of the polygon is the sum of its trapezia."""

    class Read(hy.Automaton):
        x = hy.state()
        y = hy.state()

        @hy.mode
        def flow(self, t, s):
            return 1.0, jnp.interp(s.x, LONG, np.sin(3 * LONG))

    run = hy.simulate(Read(), [-2.0, 0.0], (0.0, 4.0), solver="taylor")
    exact = np.trapezoid(np.sin(3 * LONG), LONG)
    assert abs(run.final.y - exact) <= 1e-12  # ten thousand roundings of numbers of size 1


def test_a_long_table_is_read_by_halves():
    """Its operations are as many as those of a table of a hundredth of its length, and a few."""
    counts = []
    for knots in (LONG[::100], LONG):
        made = model(lambda t, x, y, knots=knots: jnp.interp(x, knots, knots**2))
        counts.append(len(scene_of(made).code.tape("flow", False).ops))
    assert counts[0] < counts[1] < counts[0] + 50


def test_a_table_of_parameters_is_read_and_has_derivatives():
    """The slope of the end by an entry is that of finite differences, to 1e-6."""

    class Tabled(hy.Automaton):
        x = hy.state()
        table = hy.parameter(np.sin(LONG[::100]))

        @hy.mode
        def flow(self, t, s):
            return 1.0 + jnp.interp(s.x, LONG[::100], self.table)

    values = np.sin(LONG[::100])
    with jax.enable_x64(True):
        end = hy.as_function(Tabled(), t=(0.0, 0.5), max_jumps=1)
        last = lambda v: end(Tabled(table=v), {"x": 0.01}).final["x"]  # noqa: E731
        moved = float(last(values + 1e-6 * np.eye(101)[55]) - last(values)) / 1e-6
        slope = float(jax.grad(last)(jnp.asarray(values))[55])
    assert abs(slope) > 1e-3
    assert abs(moved - slope) <= 1e-6


#: Knots of a short table, in which a search chooses one threshold after another.
SHORT = np.array([0.0, 0.3, 0.7, 1.1, 1.6, 2.2])


class Searched(hy.Automaton):
    x = hy.state()
    z = hy.state()
    p: float = hy.parameter(1.3)

    @hy.mode
    def run(self, t, s):
        return 1.0, 0.1 + 0.3 * jnp.searchsorted(SHORT, self.p * s.x)


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_a_search_whose_thresholds_jump_ends(solver):
    """What decides jumps where what was decided before it does: that is no zero of it."""
    run = hy.simulate(Searched(), [0.0, 0.0], (0.0, 1.5), solver=solver)
    passed = sum(max(1.5 - knot / 1.3, 0.0) for knot in SHORT.tolist())
    # the rates are constants between the knots: a step's tolerance of 1e-8 is the most that is left
    assert run.final.z == pytest.approx(0.15 + 0.3 * passed, abs=1e-8)


def test_gamma_changes_its_formula_at_whole_numbers_only():
    """JAX's takes the sign from a bit, and has NaN among its constants: it is no function that
    gives two answers, and steps end at whole numbers, not where bits change."""

    class Pushed(hy.Automaton):
        x = hy.state()

        @hy.mode
        def flow(self, t, s):
            return -jax.scipy.special.gamma(s.x + 2.0)

    exact = solve_ivp(lambda t, x: -gamma(x + 2.0), (0.0, 0.5), [1.5], rtol=1e-12, atol=1e-12)
    run = hy.simulate(Pushed(), {"x": 1.5}, (0.0, 0.5), rtol=1e-11)
    assert len(scene_of(Pushed()).field("flow").changes) == 2  # its sign, whole numbers
    assert run.stats.steps < 100
    assert run.final.x == pytest.approx(exact.y[0, -1], rel=1e-10)
