"""The scalar code of the trace agrees with JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.automaton import trace
from hybrid.lowering.lowered import Lowered
from hybrid.lowering.scene import scene_of
from hybrid.lowering.taylor import flat

#: Flows of (x, y) that use what the models of this field use, and what jax.numpy makes of it.
EXPRESSIONS = {
    "trigonometric": lambda t, x, y: jnp.sin(x) * jnp.cos(y) + jnp.tan(0.3 * x) - jnp.sinc(y),
    "inverse": lambda t, x, y: jnp.arcsin(0.2 * x) + jnp.arccos(0.1 * y) + jnp.arctan(x),
    "hyperbolic": lambda t, x, y: jnp.sinh(x) + jnp.cosh(y) - jnp.tanh(x * y),
    "inverse hyperbolic": lambda t, x, y: (
        jnp.arcsinh(x) + jnp.arctanh(0.2 * y) + jnp.arccosh(y + 4)
    ),
    "exponential": lambda t, x, y: jnp.exp(-x) + jnp.log(3 + y) + jnp.log1p(x * x) + jnp.expm1(y),
    "bases": lambda t, x, y: jnp.exp2(x) + jnp.log2(4 + y) + jnp.log10(5 + x),
    "powers": lambda t, x, y: x**3 + (y + 3) ** 1.5 + (x + 3) ** -2 + jnp.sqrt(5 + x) + 2.0**y,
    "roots": lambda t, x, y: jnp.cbrt(x + 4) + 1 / jnp.sqrt(y + 4) + jax.lax.rsqrt(x + 3),
    "moving power": lambda t, x, y: jnp.exp(y * jnp.log(x + 4)),
    "division": lambda t, x, y: x / (4 + y) - 1 / (5 + x * y) + (x + 1) // 1e9,
    "piecewise": lambda t, x, y: jnp.abs(x) * y + jnp.where(x > y, x, -y) + jnp.maximum(x, y),
    "clipping": lambda t, x, y: jnp.clip(x, -0.5, 0.5) + jnp.minimum(x, 0.2) + jnp.sign(y),
    "logic": lambda t, x, y: jnp.where((x > 0) & ~(y > 0) | (x >= y), x, y),
    "special": lambda t, x, y: jax.scipy.special.erf(x) + jax.nn.sigmoid(y) + jax.nn.softplus(x),
    "time": lambda t, x, y: jnp.cos(3 * t) * x + t * y + jnp.exp(-t),
    "vectors": lambda t, x, y: (
        jnp.linalg.norm(jnp.stack([x, y, 1.0])) + jnp.dot(jnp.array([1.0, 2.0]), jnp.array([x, y]))
    ),
    "derivatives": lambda t, x, y: jax.grad(lambda x: jnp.sum(jnp.stack([x, y, x * y]) ** 2))(x),
    "matrices": lambda t, x, y: (
        (jnp.array([[1.0, 2.0], [3.0, 4.0]]) @ jnp.array([x, y]))[1]
        + jnp.einsum("i,ij,j->", jnp.array([x, y]), jnp.eye(2), jnp.array([y, x]))
    ),
    "reductions": lambda t, x, y: (
        jnp.sum(jnp.array([x, y]) ** 2)
        + jnp.prod(jnp.array([x, y]))
        + jnp.max(jnp.array([x, y]))
        + jnp.cumsum(jnp.array([x, y]))[1]
    ),
    "polynomial": lambda t, x, y: jnp.polyval(jnp.array([1.0, -2.0, 0.5]), x) + y,
    "indexing": lambda t, x, y: jnp.zeros(3).at[1].set(x)[1] + jnp.ones(2).at[0].add(y)[0],
    "loops": lambda t, x, y: jax.lax.fori_loop(0, 4, lambda i, s: s * x + i, y),
    "angles": lambda t, x, y: jnp.arctan2(x, y + 3) + jnp.hypot(x, y) + jnp.deg2rad(x),
}


#: Flows of whole numbers ``n`` and ``k``, and of flags.
WHOLE = {
    "and": lambda n, k: n & 3,
    "or": lambda n, k: n | 2,
    "exclusive or": lambda n, k: n ^ k,
    "complement": lambda n, k: ~n,
    "shift": lambda n, k: n >> 1,
    "remainder": lambda n, k: n % 3 + n // 4 - jax.lax.rem(n, 3),
    "few bits": lambda n, k: (40 * n).astype(jnp.int8) + k.astype(jnp.uint8),
    "no sign": lambda n, k: (n.astype(jnp.uint32) - k.astype(jnp.uint32)) // 3,
    "no sign, turned": lambda n, k: (-n.astype(jnp.uint32)).astype(float) / 7.0,
    "arithmetic in few bits": lambda n, k: (n.astype(jnp.int8) * 50 + 7).astype(int),
    "largest flag": lambda n, k: jnp.maximum(n > 0, k > 0) + jnp.minimum(n > 2, k > 2),
    "products of flags": lambda n, k: (n > 0) * (k > 0) * n + ((n > 0) | (k > 0)),
}


def automaton(expression):
    class Model(hy.Automaton):
        x = hy.state()
        y = hy.state()
        p = hy.parameter(0.7)

        @hy.mode
        def flow(self, t, s):
            return self.p * expression(t, s.x, s.y), s.x - 0.5 * s.y

    return Model


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_generated_code_equals_the_trace_on_random_inputs(name):
    """Within rounding: the order of operations may differ."""
    cls = automaton(EXPRESSIONS[name])
    code = Lowered(cls, ((),))
    rhs = code.flow("flow").bind([0.7])
    closed = trace.again(cls.traces["flow", "flow"])
    draw = np.random.default_rng(0)
    for _ in range(50):
        t, x = float(draw.uniform(-1, 1)), draw.uniform(-1, 1, 2)
        with trace.wide():
            expected = np.asarray(closed((np.float64(0.7),), np.float64(t), x))
        np.testing.assert_allclose(rhs(t, x.tolist()), expected, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("name", WHOLE)
def test_whole_numbers_and_flags_are_those_of_jax(name):
    """Bit by bit, wrapping round, and as series too: where these are refused, they say so."""

    def expression(t, x, y):
        return WHOLE[name](jnp.floor(3 * x).astype(int), jnp.floor(3 * y).astype(int)).astype(float)

    field = scene_of(automaton(expression)(p=1.0)).field("flow")
    with jax.enable_x64(True):
        for x, y in np.random.default_rng(0).uniform(-4.0, 4.0, size=(20, 2)):
            exact = float(expression(0.0, jnp.asarray(x), jnp.asarray(y)))
            assert field.rhs(0.0, [x, y])[0] == exact
            if field.jets is not None:
                sides = [0] * len(field.jets.watched)
                assert field.jets(0.0, [x, y], sides, 1)[0][0][1] == exact


def test_ieee_values_where_python_would_raise():
    """inf and nan as XLA gives them, also in the branch of a where that is not taken."""
    cls = automaton(lambda t, x, y: jnp.where(x > 0, jnp.log(x), 0.0) + jnp.exp(1000 * y))
    rhs = Lowered(cls, ((),)).flow("flow").bind([1.0])
    assert rhs(0.0, [-1.0, -1.0])[0] == 0.0
    assert rhs(0.0, [-1.0, 1.0])[0] == np.inf
    assert rhs(0.0, [0.0, -1.0])[0] == 0.0


def test_array_parameters_and_shared_subexpressions():
    """An array parameter is unrolled; what depends on parameters alone is computed once."""

    class Chain(hy.Automaton):
        q = hy.state(shape=(3,))
        k = hy.parameter(np.array([1.0, 2.0, 3.0]))

        @hy.mode
        def flow(self, t, s):
            return (-jnp.exp(self.k) * s.q,)

    code = Lowered(Chain, ((3,),))
    rhs = code.flow("flow").bind(flat([np.array([0.0, 1.0, 2.0])]))
    np.testing.assert_allclose(rhs(0.0, [1.0, 1.0, 1.0]), -np.exp([0.0, 1.0, 2.0]))
    body = code.flow("flow").source.split("def function")[1]
    assert "exp" not in body
