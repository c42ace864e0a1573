"""Taylor series as a method of compiled runs: the solution's own polynomial, a step at a time.

The recurrences are those of :mod:`hybrid.scene.taylor`, written for JAX. A step is as long as
the last two terms stay within the tolerances (Jorba & Zou, *A software package for the numerical
integration of ODEs by means of high-order Taylor methods*, Experimental Mathematics 14, 2005);
it is kept if the polynomial has the flow's direction along it. Its dense output is as accurate as
the step, so that a guard's zero needs no second step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import attrs
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jax.scipy.special import gammaln

from ..arrays import when
from ..errors import TraceError
from ..events import EPS, bernstein_from_powers
from ..scene.lowered import Lowered
from ..scene.taylor import TaylorProgram
from ..segment import apply, nodes

#: The method's name, and the order of the series.
TAYLOR, ORDER = "Taylor", 12

#: By how much a step may end off the flow's direction, as a multiple of the tolerances.
MISSED = 10.0

#: What a guard's series may be off, as a share of the guard, where it stays this many times as far
#: from zero.
ROUGH, AWAY = 1e-3, 20.0

#: Shares of a step at which its polynomials are held against the flow and the guards, where these
#: are smooth and where they have kinks.
SMOOTH, KINKED = np.array([0.55, 1.0]), np.array([0.27, 0.55, 0.8, 1.0])


def _powers_of(shares: np.ndarray) -> np.ndarray:
    return shares[:, None] ** np.arange(ORDER + 1)


#: Powers of the share at the nodes.
_AT_NODES = _powers_of(nodes(ORDER))

#: A step this short against the time in the arc cannot be made; one this short only where its terms
#: fall: else a singularity is nearer than its end, however little that is beside the tolerances.
SHORTEST, SHORT = 1e-14, 1e-10

#: The operations of a graph on JAX's numbers.
OPERATIONS: dict[str, Callable[..., Any]] = {
    "mul": jnp.multiply,
    "add": jnp.add,
    "sub": jnp.subtract,
    "div": jnp.divide,
    "neg": jnp.negative,
    "pow": jnp.power,
    "rem": jnp.fmod,
    "gt": jnp.greater,
    "ge": jnp.greater_equal,
    "lt": jnp.less,
    "le": jnp.less_equal,
    "eq": jnp.equal,
    "ne": jnp.not_equal,
    "and": jnp.logical_and,
    "or": jnp.logical_or,
    "xor": jnp.logical_xor,
    "not": jnp.logical_not,
    "select": jnp.where,
    "sign": jnp.sign,
    "max": jnp.maximum,
    "min": jnp.minimum,
    "trunc": jnp.trunc,
    "real": lambda x: jnp.asarray(x, float),
    "round": jnp.round,
    "away": lambda x: jnp.copysign(jnp.floor(jnp.abs(x) + 0.5), x),
    "is_finite": jnp.isfinite,
    "logistic": jax.nn.sigmoid,
    "erf": jax.lax.erf,
    "erfc": jax.lax.erfc,
    "lgamma": gammaln,
    "atan2": jnp.arctan2,
    **{
        name: getattr(jnp, name)
        for name in (
            *("abs", "floor", "ceil", "sqrt", "cbrt", "exp", "exp2", "expm1", "log", "log1p"),
            *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
            *("asinh", "acosh", "atanh"),
        )
    },
    "barrier": jax.lax.optimization_barrier,
}


@attrs.frozen
class Expansion:
    """The series of a flow, and of guards along it."""

    program: TaylorProgram

    @property
    def size(self) -> int:
        """Length of the recurrences, written out: what they take to compile grows with it."""
        return len(self.program.source)

    def __call__(self, parameters: Any, t: Any, x: Any, *extra: Any) -> tuple[Any, Any]:
        """Coefficients of the powers of time, shapes ``(ORDER + 1, n)``, ``(ORDER + 1, slots)``."""
        flat = [v for p in parameters for v in jnp.ravel(jnp.asarray(p))]
        jets = self.program.bind([*flat, *extra])
        states, guards, _ = jets(t, [x[i] for i in range(len(x))], [])
        return _columns(states), _columns(guards)


def expansion(
    code: Lowered, key: Any, flow: Callable[[], Any], guards: Any, extra: int = 0
) -> Expansion:
    """The series of a flow, and of guards along it.

    Parameters
    ----------
    key
        Under which it is kept.
    flow : callable
        Makes the flow's jaxpr.
    guards : callable ``(parameters, t, x, *extra)``
        A vector, to be traced.

    Raises
    ------
    TraceError
        Where there is none.
    """
    if code.spec.lags:
        raise TraceError("the past is kept as fitted polynomials, whose series lose their digits")

    def make() -> TaylorProgram:
        return code.array_series(flow(), code.trace(guards, extra), ORDER, OPERATIONS, extra)

    return Expansion(code.once(("array series", key), make))


def _columns(series: list[list[Any]]) -> Any:
    """Lists of coefficients as the columns of one array, put there once."""
    flat = [jnp.asarray(c, float).reshape(1) for row in zip(*series, strict=True) for c in row]
    barrier = jax.lax.optimization_barrier
    return barrier(jnp.concatenate(barrier(flat))).reshape(-1, len(series))


class Ahead(NamedTuple):
    """What is known of the flow from a point on.

    Attributes
    ----------
    states, guards : array, shapes (ORDER + 1, n), (ORDER + 1, slots)
        Their series.
    t
        The time here.
    open : array, shape (slots,)
        What the tolerances leave open of each guard.
    values : callable ``(tau, x)``, or None
        The guards themselves; None where they are no more than sums of states.
    kinked : bool
        Whether the series may be left behind.
    """

    states: Any
    guards: Any
    t: Any
    open: Any
    values: Callable[[Any, Any], Any] | None
    kinked: bool


class Powers(NamedTuple):
    """A step as polynomials of its share: coefficients of powers.

    Attributes
    ----------
    states : array, shape (ORDER + 1, n)
    guards : array, shape (ORDER + 1, slots)
    """

    states: Any
    guards: Any

    def at(self, share: Any) -> Any:
        """The state there."""
        value = self.states[-1]
        for row in self.states[-2::-1]:
            value = value * share + row
        return value

    def values(self) -> Any:
        """The states at the nodes."""
        return apply(_AT_NODES, self.states)


@attrs.frozen
class Series:
    """Taylor's method, with the face of :class:`hybrid.solvers.diffrax_backend.Method`."""

    name: str = TAYLOR
    degree: int = ORDER
    order: int = ORDER
    dense: bool = True
    implicit: bool = False

    def attempt(
        self, flow: Any, tau: Any, h: Any, x: Any, rtol: Any, atol: Any, expand: Any
    ) -> tuple[Any, Any, Any, Any, Any]:
        """One step from local time ``tau``, of length ``h`` at most.

        Parameters
        ----------
        flow : callable ``(tau, x)``
        expand : callable ``(tau, x)``
            Gives an :class:`Ahead`.
        """
        ahead = expand(tau, x)
        rounding = EPS * jnp.max(jnp.abs(x)) + 1e-300  # a state may be zero, and atol
        allowed = jnp.maximum(atol + rtol * jnp.abs(x), rounding)
        of_guards = jnp.maximum(ahead.open, jnp.min(allowed))
        h, powers, of_guards = _length(
            h, jax.tree.map(stop_gradient, ahead[:2]), allowed, of_guards
        )
        path = Powers(powers[:, None] * ahead.states, powers[:, None] * ahead.guards)
        end = path.states.sum(axis=0)
        good = _follows(path, flow, ahead, tau, h, allowed, of_guards)
        sizes = jnp.abs(path.states)
        falls = jnp.max(sizes[-2:]) <= 0.1 * jnp.max(sizes[1:-2])
        kept = good & (h > SHORTEST * tau) & (falls | (h > SHORT * tau)) & (h > 1e-300)
        new = jnp.where(kept, jnp.inf, jnp.where(good, 0.0, 0.5 * h))
        return end, kept, h, new, path


def _powers(h: Any) -> Any:
    """The powers of a number, each made of two about half as high."""
    powers = [jnp.ones_like(h), h]
    while len(powers) <= ORDER:
        powers.append(powers[len(powers) // 2] * powers[(len(powers) + 1) // 2])
    return jax.lax.optimization_barrier(jnp.stack(powers))


def _length(h: Any, series: Any, of_states: Any, of_guards: Any) -> tuple[Any, Any, Any]:
    """The length of a step, its powers, and what each guard's series may be off in it.

    A guard that stays away from zero need not be known well.
    """
    states, guards = series
    sizes = jnp.max(jnp.abs(states[-2:]) / of_states, axis=1)
    last = jnp.abs(guards[-2:])
    rough = jnp.maximum(of_guards, ROUGH * jnp.abs(guards[0]))
    h, powers = _within(h, jnp.maximum(sizes, jnp.max(last / rough, axis=1)))
    fine = jnp.max(last / of_guards, axis=1)

    def nearer() -> tuple[Any, Any, Any]:
        b = apply(bernstein_from_powers(ORDER), stop_gradient(powers)[:, None] * guards)
        away = (b * jnp.sign(b[0]) > AWAY * rough).all(axis=0)
        off = jnp.where(away, rough, of_guards)
        return *_within(h, jnp.maximum(sizes, jnp.max(last / off, axis=1))), off

    return when((fine * powers[-2:] > 1.0).any(), nearer, (h, powers, of_guards))


def _follows(
    path: Powers, flow: Any, ahead: Ahead, tau: Any, h: Any, of_states: Any, of_guards: Any
) -> Any:
    """Whether a step's polynomials have the flow's direction and are the guards, at a few places.

    A series does not see a kink ahead, and small terms alone prove nothing. What changes faster
    than time can tell is not looked at more closely than that.
    """
    h, path = stop_gradient(h), jax.tree.map(stop_gradient, path)
    spacing = 64 * EPS * jnp.abs(stop_gradient(ahead.t)) / h
    shares = KINKED if ahead.kinked else SMOOTH
    to_values = _powers_of(shares)
    to_slopes = np.arange(ORDER + 1) * to_values / shares[:, None]

    def near(true: Any, series: Any, early: Any, off: Any) -> Any:
        change = jnp.abs(series - early[0]).max(axis=0) + jnp.abs(early[1])
        return (jnp.abs(true - series) <= MISSED * off + spacing * change).all()

    times, states = tau + h * shares, apply(to_values, path.states)
    rates, slopes = h * jax.vmap(flow)(times, states), apply(to_slopes, path.states)
    good = near(rates, slopes, path.states[1:], of_states)
    if ahead.values is None:
        return good
    guards, series = jax.vmap(ahead.values)(times, states), apply(to_values, path.guards)
    seen = near(guards, series, path.guards, of_guards)
    return good & (seen | (h <= SHORT * tau))


def _within(h: Any, sizes: Any) -> tuple[Any, Any]:
    """A length, with its powers, at which the last two terms are at most 1: ``sizes`` at 1."""
    powers = _powers(h)
    short = (sizes * powers[-2:] <= 1.0).all()

    def shorter() -> tuple[Any, Any]:
        less = jnp.minimum(h, jnp.min(sizes ** (-1.0 / np.array([ORDER - 1.0, ORDER]))))
        return less, _powers(less)

    return when(~short, shorter, (h, powers))
