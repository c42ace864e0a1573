"""Linear algebra and tables in a flow are arithmetic on the elements, with Taylor series."""

import jax
import jax.numpy as jnp
import jax.scipy.linalg as linalg
import mpmath as mp
import numpy as np
import pytest

import hybrid as hy
from hybrid.automaton import trace
from hybrid.bounds.exact import hides_derivatives
from hybrid.errors import FlowError
from hybrid.lowering.lowered import ORDER
from hybrid.lowering.scene import scene_of

from .test_readers import automaton


def _matrix(t, x, y):
    """No pivot on its diagonal may be taken as it is."""
    return jnp.array(
        [[0.0, 1.0, x, 0.3], [x, y * y, 1.0, 0.0], [1.0, 0.2, 0.0, 2.0], [0.1, 3.0, 0.3, t]]
    )


def _definite(t, x, y):
    a = _matrix(t, x, y)
    return a @ a.T + jnp.eye(4)


def _right(t, x, y):
    return jnp.array([x, y, t, 1.0])


TABLE = np.sin(np.arange(40.0))

WRITTEN = {
    "solve 2": lambda t, x, y: jnp.linalg.solve(_matrix(t, x, y)[:2, :2], _right(t, x, y)[:2])[1],
    "solve 3": lambda *p: jnp.linalg.solve(_matrix(*p)[:3, :3], _right(*p)[:3])[1],
    "solve 4": lambda *p: jnp.linalg.solve(_matrix(*p), _right(*p))[2],
    "solve columns": lambda *p: jnp.linalg.solve(_matrix(*p), _matrix(*p).T).sum(),
    "inv 2": lambda *p: jnp.linalg.inv(_matrix(*p)[:2, :2])[0, 1],
    "inv 4": lambda *p: jnp.linalg.inv(_matrix(*p))[2, 1],
    "det 3": lambda *p: jnp.linalg.det(_matrix(*p)[:3, :3]),
    "many": lambda *p: jax.vmap(jnp.linalg.solve)(
        jnp.stack([_matrix(*p), _definite(*p)]), jnp.stack([_right(*p), _right(*p)])
    ).sum(),
    "cholesky": lambda *p: jnp.linalg.cholesky(_definite(*p)).sum(),
    "cho_solve": lambda *p: linalg.cho_solve(linalg.cho_factor(_definite(*p)), _right(*p))[1],
    "definite": lambda *p: linalg.solve(_definite(*p), _right(*p), assume_a="pos")[1],
    "triangular": lambda *p: linalg.solve_triangular(_definite(*p), _right(*p), trans=1)[2],
    "table": lambda t, x, y: jnp.interp(x, jnp.linspace(-2.0, 2.0, 40), jnp.array(TABLE)),
    "places": lambda t, x, y: y * jnp.searchsorted(jnp.linspace(-1.0, 1.0, 9), x),
    "quotients": lambda t, x, y: jax.lax.fori_loop(
        0, 5, lambda i, c: c + (i // 2) * x + jax.lax.div(-i, 2) * y + (-i) % 3, 0.0
    ),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_a_flow_is_the_trace_s_and_has_series(name):
    """Within the rounding of a matrix of condition 100; the slope of the series is the flow's."""
    cls = automaton(WRITTEN[name])
    field, closed = scene_of(cls()).field("flow"), trace.again(cls.traces["flow", "flow"])
    assert field.refused == ""
    draw = np.random.default_rng(1)
    for _ in range(5):
        t, x = float(draw.uniform(0.2, 1)), draw.uniform(0.3, 1, 2)
        with trace.wide():
            expected = np.asarray(closed((np.float64(cls().p),), np.float64(t), x))
        np.testing.assert_allclose(field.rhs(t, x.tolist()), expected, rtol=1e-12, atol=1e-13)
        states, _, _ = field.expand(t, x.tolist(), [0] * field.kinks)
        np.testing.assert_allclose([c[1] for c in states], expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("size", [2, 4])
def test_equations_agree_with_mpmath_to_every_order(size):
    """``y' = A(t)^{-1} b(t)`` has the coefficients that 50 digits give, to 1e-11 of the largest."""

    def rate(t, x, y):
        return jnp.linalg.solve(_matrix(t, 0.4, 0.7)[:size, :size], _right(t, 0.4, 0.7)[:size])[1]

    field = scene_of(automaton(rate)()).field("flow")
    states, _, _ = field.expand(0.5, [0.4, 0.7], [0] * field.kinks)
    with mp.workdps(50):

        def exact(t):
            x, y = mp.mpf(0.4), mp.mpf(0.7)
            rows = [
                [mp.mpf(0), mp.mpf(1), x, mp.mpf(0.3)],
                [x, y * y, mp.mpf(1), mp.mpf(0)],
                [mp.mpf(1), mp.mpf(0.2), mp.mpf(0), mp.mpf(2)],
                [mp.mpf(0.1), mp.mpf(3), mp.mpf(0.3), t],
            ]
            a = mp.matrix([row[:size] for row in rows[:size]])
            return mp.lu_solve(a, mp.matrix([x, y, t, mp.mpf(1)][:size]))[1] * mp.mpf(0.7)

        rates = mp.taylor(exact, mp.mpf(0.5), ORDER - 1)
        expected = [float(c / (k + 1)) for k, c in enumerate(rates)]
    np.testing.assert_allclose(
        states[0][1:], expected, rtol=0, atol=1e-11 * max(map(abs, expected))
    )


def _pendulum(solved):
    """A double pendulum of unit masses and lengths before a wall on its right."""

    class Pendulum(hy.Automaton):
        a = hy.state()
        b = hy.state()
        p = hy.state()
        q = hy.state()

        @hy.mode
        def swing(self, t, s):
            c, d = jnp.cos(s.a - s.b), jnp.sin(s.a - s.b)
            right = jnp.array(
                [
                    -d * s.q**2 - 2 * 9.81 * jnp.sin(s.a),
                    d * s.p**2 - 9.81 * jnp.sin(s.b),
                ]
            )
            if solved:
                p, q = jnp.linalg.solve(jnp.array([[2.0, c], [c, 1.0]]), right)
            else:
                p, q = right[0] - c * right[1], 2.0 * right[1] - c * right[0]
                p, q = p / (2.0 - c * c), q / (2.0 - c * c)
            return s.p, s.q, p, q

        wall = hy.contact(
            swing,
            gap=lambda self, t, s: 0.6 - jnp.sin(s.a) - jnp.sin(s.b),
            restitution=0.6,
            rests=False,
        )

    return Pendulum()


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_double_pendulum_hits_a_wall(solver):
    """The mass matrix by ``jnp.linalg.solve`` and inverted by hand: the same impacts to 1e-9."""
    start = {"a": -0.5, "b": -0.9, "p": 0.0, "q": 0.0}
    runs = [
        hy.simulate(_pendulum(solved), start, (0.0, 4.0), solver=solver, rtol=1e-12, atol=1e-12)
        for solved in (True, False)
    ]
    first, second = (run.jumps.t for run in runs)
    assert len(first) == len(second) >= 2
    np.testing.assert_allclose(first, second, rtol=0, atol=1e-9)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_singular_matrix_is_said(solver):
    """With model, mode, time and state."""
    cls = automaton(lambda t, x, y: jnp.linalg.solve(jnp.ones((2, 2)) * x, jnp.array([x, y]))[0])
    with pytest.raises(FlowError, match=r"Model, mode flow, t = 0\.0, .*the flow is not finite"):
        hy.simulate(cls(), [1.0, 1.0], (0.0, 1.0), solver=solver)


class Linked(hy.Automaton):
    """Two masses that feel each other, one of them above a floor."""

    q = hy.state(shape=(2,))
    v = hy.state(shape=(2,))

    @hy.mode
    def fall(self, t, s):
        c = jnp.cos(s.q)
        return s.v, jnp.linalg.solve(2.0 * jnp.eye(2) + 0.1 * jnp.outer(c, c), -9.81 - s.q)

    floor = hy.contact(fall, gap=lambda self, t, s: s.q[0], restitution=0.5)


def test_an_accumulation_is_proved():
    """Equations are arithmetic to proofs as well."""
    run = hy.simulate(Linked(), {"q": [1.0, 1.0], "v": [0.0, 0.0]}, (0.0, 2.0), solver="taylor")
    assert [found.verdict for found in run.zeno] == ["certified"]


@pytest.mark.parametrize("hidden", [False, True])
def test_a_derivative_held_back_is_seen(hidden):
    """That of a matrix on its way to the factors which solve equations is not held back."""

    def solved(a, b):
        if hidden:
            return linalg.lu_solve(linalg.lu_factor(jax.lax.stop_gradient(a)), b)
        return jnp.linalg.solve(a, b) + linalg.solve(a @ a.T, b, assume_a="pos")

    closed = jax.make_jaxpr(solved)(jnp.eye(2), jnp.ones(2))
    assert hides_derivatives(closed) is hidden
