"""Taylor series as a method of compiled runs: the solution's own polynomial, a step at a time.

The recurrences are those of :mod:`hybrid.scene.taylor`. A step is as long as
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
from ..roots import counted, falling, horner
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

#: Shares of a step at which its polynomials are held against the flow and the guards; where there
#: may be a kink at the end, just before it as well.
LOOKS, BEFORE = np.array([0.55, 1.0]), np.array([0.998])


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


class Jets(NamedTuple):
    """Coefficients of the powers of time, order by order.

    Attributes
    ----------
    states, guards : array, shapes (ORDER + 1, n), (ORDER + 1, slots)
    kinks : array, shape (ORDER + 1, kinks)
        Of functions at whose zeros the series end.
    """

    states: Any
    guards: Any
    kinks: Any

    def padded(self, count: int) -> Jets:
        """With so many kinks; those added never come."""
        more = np.zeros((ORDER + 1, count - self.kinks.shape[1]))
        more[0] = 1.0
        return self._replace(kinks=jnp.concatenate([self.kinks, more], axis=1))


@attrs.frozen
class Expansion:
    """The series of a flow, and of guards along it."""

    program: TaylorProgram

    @property
    def size(self) -> int:
        """Length of the recurrences, written out: what they take to compile grows with it."""
        return len(self.program.source)

    def __call__(self, parameters: Any, t: Any, x: Any, *extra: Any) -> Jets:
        """The series at a time and state."""
        flat = [v for p in parameters for v in jnp.ravel(jnp.asarray(p))]
        jets = self.program.bind([*flat, *extra])
        return Jets(*map(_columns, jets(t, [x[i] for i in range(len(x))])))


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
    if not series:
        return jnp.zeros((ORDER + 1, 0))
    flat = [jnp.asarray(c, float).reshape(1) for row in zip(*series, strict=True) for c in row]
    barrier = jax.lax.optimization_barrier
    return barrier(jnp.concatenate(barrier(flat))).reshape(-1, len(series))


class Ahead(NamedTuple):
    """What is known of the flow from a point on.

    Attributes
    ----------
    series : Jets
    t
        The time here.
    open : array, shape (slots,)
        What the tolerances leave open of each guard.
    values : callable ``(tau, x)``, or None
        The guards themselves; None where they are no more than sums of states.
    """

    series: Jets
    t: Any
    open: Any
    values: Callable[[Any, Any], Any] | None


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
        series, size = ahead.series, jnp.max(jnp.abs(x))
        allowed = jnp.maximum(atol + rtol * jnp.abs(x), EPS * size + 1e-300)  # all may be zero
        of_guards = jnp.maximum(ahead.open, jnp.min(allowed))
        h, powers, of_guards = _length(h, series, allowed, of_guards)
        h, powers, clear, cut = _up_to_kink(h, powers, series.kinks, stop_gradient(size))
        path = Powers(powers[:, None] * series.states, powers[:, None] * series.guards)
        end = path.states.sum(axis=0)
        good = clear & _follows(path, flow, ahead, tau, h, cut, allowed, of_guards)
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
    slots, kinks = series.guards.shape[1], series.kinks.shape[1]
    guards = stop_gradient(jnp.concatenate([series.guards, series.kinks], axis=1))
    off = jnp.concatenate([of_guards, jnp.full(kinks, jnp.max(of_states))])
    sizes = jnp.max(jnp.abs(stop_gradient(series.states[-2:])) / of_states, axis=1)
    last = jnp.abs(guards[-2:])
    rough = jnp.maximum(off, ROUGH * jnp.abs(guards[0]))
    h, powers = _within(h, jnp.maximum(sizes, jnp.max(last / rough, axis=1)))
    fine = jnp.max(last / off, axis=1)

    def nearer() -> tuple[Any, Any, Any]:
        b = apply(bernstein_from_powers(ORDER), stop_gradient(powers)[:, None] * guards)
        away = (b * jnp.sign(b[0]) > AWAY * rough).all(axis=0)
        known = jnp.where(away, rough, off)
        return *_within(h, jnp.maximum(sizes, jnp.max(last / known, axis=1))), known

    h, powers, off = when((fine * powers[-2:] > 1.0).any(), nearer, (h, powers, off))
    return h, powers, off[:slots]


def _up_to_kink(h: Any, powers: Any, kinks: Any, size: Any) -> tuple[Any, Any, Any, Any]:
    """The step cut just beyond the first kink in it; whether that can be told, and whether it is.

    By more than rounding, so that the next step is on the other side: ``size`` is the state's. The
    length carries the derivative of the kink's time, for a force may begin there.
    """
    if not kinks.shape[1]:
        return h, powers, jnp.array(True), None
    p = powers[:, None] * kinks
    p = jnp.where(p[0] < 0, -p, p)
    fixed = stop_gradient(p)
    b = apply(bernstein_from_powers(ORDER), fixed)
    noise = 64 * EPS * (size + jnp.abs(fixed).sum(axis=0))
    crosses = b.min(axis=0) < -noise

    def cut() -> tuple[Any, Any, Any, Any]:
        found = counted(b)
        root = falling(found, fixed)
        here = jnp.where(found.once, root, 0.5)
        rate = horner(fixed, here)[1]
        moved = -horner(p, here)[0] / jnp.where(rate == 0, jnp.inf, rate)
        moved = moved + jnp.clip(noise / jnp.abs(rate), 1e-13, 1e-3)
        beyond = jnp.maximum(root + moved, 1e-9)
        less = h * jnp.min(jnp.where(crosses, beyond, 1.0), initial=1.0)
        return less, _powers(less), ~(crosses & found.unclear).any(), less < h

    return when(crosses.any(), cut, (h, powers, jnp.array(True), jnp.array(False)))


def _follows(
    path: Powers,
    flow: Any,
    ahead: Ahead,
    tau: Any,
    h: Any,
    cut: Any,
    of_states: Any,
    of_guards: Any,
) -> Any:
    """Whether a step's polynomials have the flow's direction and are the guards, at a few places.

    Small terms alone prove nothing. What changes faster than time can tell is not looked at more
    closely than that. ``cut``: whether the step ends at a kink (None: there are none).
    """
    looks = LOOKS if cut is None else np.concatenate([LOOKS, BEFORE])
    counts = np.ones((len(looks), 1), dtype=bool)
    counts = counts if cut is None else jnp.asarray(counts).at[1].set(~cut)
    to_values = _powers_of(looks)
    to_slopes = np.arange(ORDER + 1) * to_values / looks[:, None]
    h, path = stop_gradient(h), jax.tree.map(stop_gradient, path)
    spacing = 64 * EPS * jnp.abs(stop_gradient(ahead.t)) / h

    def near(true: Any, series: Any, early: Any, off: Any, counts: Any) -> Any:
        change = jnp.abs(series - early[0]).max(axis=0) + jnp.abs(early[1])
        near = jnp.abs(true - series) <= MISSED * off + spacing * change
        return (near | ~counts).all()

    times, states = tau + h * looks, apply(to_values, path.states)
    rates, slopes = h * jax.vmap(flow)(times, states), apply(to_slopes, path.states)
    good = near(rates, slopes, path.states[1:], of_states, counts)
    if ahead.values is None:
        return good
    guards, series = (
        jax.vmap(ahead.values)(times[1:], states[1:]),
        apply(to_values[1:], path.guards),
    )
    seen = near(guards, series, path.guards, of_guards, counts[1:])
    return good & (seen | (h <= SHORT * tau))


def _within(h: Any, sizes: Any) -> tuple[Any, Any]:
    """A length, with its powers, at which the last two terms are at most 1: ``sizes`` at 1."""
    powers = _powers(h)
    short = (sizes * powers[-2:] <= 1.0).all()

    def shorter() -> tuple[Any, Any]:
        less = jnp.minimum(h, jnp.min(sizes ** (-1.0 / np.array([ORDER - 1.0, ORDER]))))
        return less, _powers(less)

    return when(~short, shorter, (h, powers))
