"""What an author writes in a class body: states, parameters, modes, edges, contacts.

Each call leaves a marker; :class:`hybrid.Automaton` collects the markers when the class
is defined and turns them into one frozen :class:`~hybrid.automaton.spec.Spec`.
"""

from __future__ import annotations

import enum
import math
import sys
from collections.abc import Callable
from typing import Any

import attrs


class Crossing(enum.Enum):
    """The direction in which a guard must reach zero for its edge to fire."""

    FALLING = "falling"
    RISING = "rising"
    EITHER = "either"


FALLING = Crossing.FALLING
"""The edge fires where its guard falls to zero (the default): the guard is positive inside."""

RISING = Crossing.RISING
"""The edge fires where its guard rises to zero: the guard is negative inside."""

EITHER = Crossing.EITHER
"""The edge fires where its guard reaches zero from either side."""

TERMINATE = "hy.TERMINATE"
"""The target of an edge that ends the run: ``to=hy.TERMINATE``."""


class _Named:
    """A marker that learns its name from the class body."""

    name: str = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name


@attrs.define(slots=False, eq=False)
class State(_Named):
    """Marker of a coordinate; made by :func:`state`."""

    unit: str = ""
    doc: str = ""
    shape: Any = ()


@attrs.define(slots=False, eq=False)
class Mode(_Named):
    """Marker of a mode and its flow; made by :func:`mode`."""

    flow: Callable[..., Any]
    initial: bool = False
    limit_of: tuple[str, ...] = ()

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        return self if instance is None else self.flow.__get__(instance, owner)

    def __call__(self, model: Any, *args: Any) -> Any:
        return self.flow(model, *args)


@attrs.frozen(eq=False)
class Times:
    """Firing times of a clock: the list ``at``, or every ``every`` from ``offset``."""

    at: Any
    every: Any
    offset: Any


@attrs.define(slots=False, eq=False)
class EdgeMarker(_Named):
    """Marker of an edge and its reset; made by :func:`edge`."""

    reset: Callable[..., Any]
    source: Mode | str
    to: Mode | str
    guard: Callable[..., Any] | None
    crossing: Crossing
    times: Times | None = None
    when: Callable[..., Any] | None = None
    urgent: bool = False

    def __call__(self, reset: Callable[..., Any]) -> EdgeMarker:
        return attrs.evolve(self, reset=reset)

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        return self if instance is None else self.reset.__get__(instance, owner)


@attrs.define(slots=False, eq=False)
class ContactMarker(_Named):
    """Marker of a unilateral contact; made by :func:`contact`."""

    mode: Mode | str
    gap: Callable[..., Any]
    restitution: str | float | Callable[..., Any]
    rests: bool
    inverse_mass: Any


@attrs.define(slots=False, eq=False)
class Switching(_Named):
    """Marker of a switching between two modes; made by :func:`switching`."""

    positive: Mode | str
    negative: Mode | str
    surface: Callable[..., Any]
    slides: bool


def state(unit: str = "", doc: str = "", shape: tuple[int, ...] = ()) -> Any:
    """Declare a coordinate of the state. The order of declaration is the order in the state vector.

    The order of declaration is the order in the state vector. A state has no default: its value at
    the start is given to :func:`hybrid.simulate`.

    Parameters
    ----------
    unit, doc : str
        Physical unit and a short description; used in tables, pictures and saved files. Units are
        labels: nothing is converted.
    shape : tuple of int
        Shape of an array, ``()`` for a number.

    Raises
    ------
    DeclarationError
        When the class is defined, if the unit is not text or the shape is none.

    Examples
    --------
    >>> class Ball(hy.Automaton):
    ...     x = hy.state(unit="m", doc="height")
    """
    return State(unit, doc, (shape,) if isinstance(shape, int) else shape)


def parameter(
    default: Any,
    unit: str = "",
    doc: str = "",
    positive: bool = False,
    between: tuple[float, float] | None = None,
) -> Any:
    """Declare a parameter: a number or an array that is constant during a run.

    Parameters
    ----------
    default : float or array
        The value if ``Model()`` is given none. Other values must have the same shape.
    unit, doc : str
        Physical unit and a short description; used in tables, pictures and saved files.
    positive : bool
        Refuse values that are not greater than zero.
    between : (low, high), optional
        Refuse values outside this closed interval.

    Raises
    ------
    ParameterError
        When a model is made with a value outside these bounds; the message has the
        name, the value and the bound.

    Examples
    --------
    >>> r: float = hy.parameter(0.7, between=(0, 1), doc="coefficient of restitution")
    """
    metadata = {"hybrid": "parameter", "unit": unit, "doc": doc}
    return attrs.field(
        default=default, validator=_bounds(positive, between), metadata=metadata, kw_only=True
    )


def _bounds(positive: bool, between: tuple[float, float] | None) -> Callable[..., None]:
    from ..errors import ParameterError
    from .reals import reals, short

    def check(model: Any, field: Any, value: Any) -> None:
        if _is_traced(value):
            return
        given = f"{type(model).__name__}.{field.name} = {short(value)}"
        try:
            numbers = reals(value).ravel().tolist()
        except ValueError:
            raise ParameterError(f"{given}: a number or an array of numbers") from None
        if not all(map(math.isfinite, numbers)):
            raise ParameterError(f"{given}: must be finite")
        if positive and not all(number > 0 for number in numbers):
            raise ParameterError(f"{given}: must be positive")
        if between is not None and not all(between[0] <= n <= between[1] for n in numbers):
            raise ParameterError(f"{given}: must lie in [{between[0]}, {between[1]}]")

    return check


def _is_traced(value: Any) -> bool:
    """Whether a value is a JAX tracer, whose number cannot be checked."""
    jax = None if isinstance(value, float | int) else sys.modules.get("jax")
    return jax is not None and isinstance(value, jax.core.Tracer)


def mode(
    flow: Callable[..., Any] | None = None,
    *,
    initial: bool = False,
    limit_of: str | tuple[str, ...] = (),
) -> Any:
    """Declare a mode: ``@hy.mode`` or ``@hy.mode(initial=True)`` over its flow.

    Parameters
    ----------
    initial : bool
        Whether runs begin in this mode. Needed for one mode if there are several.
    limit_of : str or tuple of str
        Names of the edges of a cycle, or of its only one. Where jumps of this cycle accumulate,
        this mode follows.

    Raises
    ------
    DeclarationError
        When the class is defined, if the flow cannot be traced or its result does not fit the
        states.

    Notes
    -----
    The flow is ``def name(self, t, s)``, or ``(self, t, s, past)`` with delays. It returns the time
    derivatives of the states: a tuple in declared order, a record ``s.replace(...)``, or a dict by
    name. It is written with ``jax.numpy``, and read once, when the class is defined.
    """
    cycle = (limit_of,) if isinstance(limit_of, str) else tuple(limit_of)
    if flow is None:
        return lambda function: Mode(function, initial, cycle)
    return Mode(flow, initial, cycle)


def edge(
    source: Any,
    *,
    to: Any = None,
    guard: Callable[..., Any] | None = None,
    crossing: Crossing = Crossing.FALLING,
    when: Callable[..., Any] | None = None,
    urgent: bool = False,
    at: Any = None,
    every: Any = None,
    offset: Any = 0.0,
) -> Any:
    """Declare an edge, ``@hy.edge(source, to=mode, guard=...)``, or a clock.

    Without a reset, ``name = hy.edge(source, to=mode, guard=...)``, the state does not change.

    Parameters
    ----------
    source, to : mode or str
        A mode defined above, or its name. ``to`` is the source if omitted.
        ``to=hy.TERMINATE`` ends the run after the jump, with ``Status.TERMINATED``.
    guard : callable ``(self, t, s)``
        A scalar function, positive inside the domain of the source mode (with ``RISING``,
        negative). The edge fires where it reaches zero.
    crossing : FALLING, RISING or EITHER
        The direction in which the guard must reach zero.
    when : callable ``(self, t, s)``, optional
        A condition, true or positive where the edge may fire. It is evaluated at a zero of the
        guard, or at a time of a clock, before the jump; if it is false there, the edge does not
        fire. It fires nothing by itself, and the guard then does not bound the domain of the mode.
    urgent : bool
        Whether the edge also fires if its guard is already beyond zero when the mode is entered.
    at : number, name of a parameter, or sequence of these
        Increasing times at which the edge fires, instead of a guard; a parameter may be an array of
        times.
    every, offset : number or name of a parameter
        The edge fires at ``k * every + offset`` for all integers k. It does not fire at the first
        time of a run, but does at the last.

    Raises
    ------
    DeclarationError
        When the class is defined, if a mode does not exist, or the guard or reset cannot be traced.

    Notes
    -----
    The reset is ``def name(self, t, s)``; it returns the state after the jump:
    ``s.replace(v=...)``, a tuple in declared order, or a dict. With an argument named ``draw`` it
    may use random numbers (``docs/chance.md``). The rules are in ``docs/semantics.md``.
    """
    clock = not (at is None and every is None)
    times = Times(at, every, offset) if clock else None
    to = source if to is None else to
    return EdgeMarker(_unchanged, source, to, guard, crossing, times, when, urgent)


def _unchanged(self: Any, t: Any, s: Any) -> Any:
    """The reset of an edge declared without one."""
    return s


def contact(
    mode: Any,
    *,
    gap: Callable[..., Any],
    restitution: Any,
    rests: bool = True,
    inverse_mass: Any = None,
) -> Any:
    """Declare a unilateral contact with Newton's law of impact.

    Parameters
    ----------
    mode : mode or str
        The mode in which the gap is watched.
    gap : callable ``(self, t, s)``
        Distance to the obstacle, positive when the contact is open. It may depend on ``t`` (a
        moving obstacle). An array declares one contact for each element, ``name[0]``, ``name[1]``,
        ...
    restitution : str, float or callable ``(self, t, s, u)``
        Name of a parameter, a number, or a function of the speed ``u < 0`` of the gap before
        the impact that returns the speed after it, divided by ``abs(u)``. For an array of contacts,
        a parameter or function may give an array, one number for each contact. With an argument
        named ``draw`` it may use random numbers (``docs/chance.md``).
    rests : bool
        Whether the run continues in a resting mode after impacts have accumulated.
    inverse_mass : float, sequence or callable ``(self, t, s)``, optional
        Inverse mass matrix of the positions that the gap depends on, in the order of the
        state vector: a number, the diagonal, or the matrix. Unit masses if omitted. For an array of
        contacts, a number, or the diagonal for the positions that they depend on together.

    Raises
    ------
    DeclarationError
        When the class is defined, if the mode or the parameter does not exist or a function cannot
        be traced; at the first run, if the gap depends on no position whose derivative is a
        velocity of the state.

    Notes
    -----
    The impulse changes the velocities along ``W grad_q(gap)``, where ``q`` are the positions in the
    gap and ``W`` the inverse mass matrix. The gap speed is ``u = d(gap)/dt`` along the flow, the
    motion of the obstacle included; the impact maps ``u`` to ``-r u``.
    """
    return ContactMarker(mode, gap, restitution, rests, inverse_mass)


def switching(
    positive: Any, negative: Any, *, surface: Callable[..., Any], slides: bool = True
) -> Any:
    """Declare two modes on the two sides of a surface (Filippov).

    Parameters
    ----------
    positive, negative : mode or str
        The modes where ``surface`` is positive and negative: defined above, or their names.
    surface : callable ``(self, t, s)``
        A scalar; it may depend on ``t`` (a moving surface).
    slides : bool
        Whether the state slides where both flows point to the surface; if False, that is an error.

    Raises
    ------
    DeclarationError
        When the class is defined, if a mode does not exist, both are the same, or one of them has a
        contact.

    Notes
    -----
    Where one flow points to the surface and the other away from it, the run crosses the surface by
    a jump that has the name of the switching and changes only the mode. Where both point to it, the
    state slides in the arc mode ``"slide(<name>)"`` with the convex combination of the two flows
    that stays on the surface, until one of them points away: a jump ``"<name>.positive"`` or
    ``"<name>.negative"``. Source: Filippov, *Differential Equations with Discontinuous Righthand
    Sides* (1988).
    """
    return Switching(positive, negative, surface, slides)


def is_parameter(value: Any) -> bool:
    """Whether ``value`` is the marker of a parameter."""
    return getattr(value, "metadata", {}).get("hybrid") == "parameter"


def name_of(mode: Any) -> Any:
    """The name of a mode, given as a marker or a name."""
    return mode.name if isinstance(mode, Mode) else mode


def is_number(value: Any) -> bool:
    """Whether ``value`` is a finite real number and not a bool."""
    if isinstance(value, bool):
        return False
    try:
        return math.isfinite(float(value))
    except (TypeError, ValueError, OverflowError):
        return False
