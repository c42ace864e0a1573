"""Laws derived from a gap and a flow: impact, resting field and contact force.

For a gap ``g(t, x)`` and a flow ``f``, let ``q`` be the positions that the gap depends on, ``N =
dg/dq``, ``W`` the inverse mass, and ``D = W N`` placed at the velocities of ``q``:

* gap speed ``u = L_f g``, gap acceleration ``a = L_f u``;
* impact (Newton): ``v -> v + D (u_after - u) / (N.D)`` with ``u_after = r |u|``;
* resting field: ``f - D a / (N.D)``, along which the gap's acceleration is zero;
* load: ``-a``, the contact force over ``1 / (N.D)``; contact ends when it reaches zero;
* projection (drift removal): onto ``g = 0`` along ``N`` and onto ``u = 0`` along ``D``.

The forces of several held contacts solve one linear system.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.chance import DRAWS
from ..automaton.spec import ContactSpec, Spec
from ..automaton.trace import Traced, again, caller
from ..errors import DeclarationError
from .arithmetic import solve
from .matrices import BY_DETERMINANTS

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix


@attrs.frozen
class Pairing:
    """Indices in the state vector of the gap's positions and of their velocities."""

    positions: tuple[int, ...]
    velocities: tuple[int, ...]

    def at_positions(self, size: int) -> Matrix:
        """Matrix, shape ``(size, positions)``, that places a vector over positions in the state."""
        return np.eye(size)[:, list(self.positions)]

    def at_velocities(self, size: int) -> Matrix:
        """Matrix, shape ``(size, velocities)``, that places a vector over velocities."""
        return np.eye(size)[:, list(self.velocities)]


def lie(h: Traced, flow: Traced) -> Traced:
    """The Lie derivative of ``h(parameters, t, x)`` along the flow."""

    def derivative(parameters: Any, t: Any, x: Any) -> Any:
        import jax
        import jax.numpy as jnp

        tangent = (jnp.ones_like(t), flow(parameters, t, x))
        return jax.jvp(lambda t, x: h(parameters, t, x), (t, x), tangent)[1]

    return derivative


@attrs.frozen
class ContactLaws:
    """The derived functions of one contact, which JAX can trace."""

    gap: Traced
    speed: Traced
    acceleration: Traced
    flow: Traced
    law: Traced
    mass: Traced
    pairing: Pairing
    drawn: Any = 0.0  # what an impact adds to the state besides: 1 to the count of drawing jumps

    def normal(self, parameters: Any, t: Any, x: Any) -> tuple[Any, Any, Any]:
        """``N``, the impulse direction in the state space, and ``N . D``."""
        import jax

        gradient = jax.grad(lambda x: self.gap(parameters, t, x))(x)
        normal = self.pairing.at_positions(x.size).T @ gradient
        push = self.mass(parameters, t, x) @ normal
        return normal, self.pairing.at_velocities(x.size) @ push, normal @ push

    def impact(self, parameters: Any, t: Any, x: Any) -> Any:
        """The state after an impact, followed by the gap speed after it."""
        import jax.numpy as jnp

        _, direction, weight = self.normal(parameters, t, x)
        before = self.speed(parameters, t, x)
        after = self.law(parameters, t, x, before) * jnp.abs(before)
        return jnp.append(x + direction * ((after - before) / weight) + self.drawn, after)

    def push(self, parameters: Any, t: Any, x: Any) -> Any:
        """Change of the state that changes the gap speed by one."""
        _, direction, weight = self.normal(parameters, t, x)
        return direction / weight


@attrs.frozen
class Held:
    """Contacts held at the same time: the resting field and the load of each contact.

    With a boolean array ``mask``, only the selected contacts are held; compiled code then serves
    every set of contacts. ``groups`` are the places of contacts whose forces are coupled.
    """

    contacts: tuple[ContactLaws, ...]
    flow: Traced
    mask: Any = None
    groups: tuple[tuple[int, ...], ...] = ()

    def geometry(
        self, parameters: Any, t: Any, x: Any, group: Sequence[int] | None = None
    ) -> tuple[list[Any], list[Any], list[Any]]:
        """Per contact of a group, or all: gap gradient at positions, the same at velocities,
        impulse direction."""
        gradients, speeds, directions = [], [], []
        for contact in self.contacts if group is None else [self.contacts[i] for i in group]:
            normal, direction, _ = contact.normal(parameters, t, x)
            gradients.append(contact.pairing.at_positions(x.size) @ normal)
            speeds.append(contact.pairing.at_velocities(x.size) @ normal)
            directions.append(direction)
        return gradients, speeds, directions

    def forces(
        self, parameters: Any, t: Any, x: Any, group: Sequence[int]
    ) -> tuple[Any, list[Any], list[Any]]:
        """Of a group: multipliers that make the gap accelerations zero; weights ``N.D``;
        directions."""
        _, speeds, directions = self.geometry(parameters, t, x, group)
        matrix = self._products(speeds, directions)
        wanted = [-self.contacts[i].acceleration(parameters, t, x) for i in group]
        weights = [row[i] for i, row in enumerate(matrix)]
        return self._solve(matrix, wanted, group), weights, directions

    def _products(self, left: list[Any], right: list[Any]) -> Any:
        """The scalar products of each of some vectors with each of others."""
        if self.mask is None:
            return [[n @ d for d in right] for n in left]
        import jax.numpy as jnp

        return jnp.stack(left) @ jnp.stack(right).T

    def _sum(self, factors: Any, vectors: list[Any]) -> Any:
        """The sum of vectors, each with a factor."""
        if self.mask is None:
            return sum(f * v for f, v in zip(factors, vectors, strict=True))
        import jax.numpy as jnp

        return factors @ jnp.stack(vectors)

    def _solve(self, matrix: Any, right: list[Any], group: Sequence[int] | None = None) -> Any:
        """Solve the equations of the held contacts of a group, or of all; multipliers of the others
        are 0.

        With a mask JAX compiles them, and a library solves more than a few: written out, those of
        twenty contacts took it a minute.
        """
        if self.mask is None:
            return solve(matrix, right)
        import jax.numpy as jnp

        size = len(right)
        held = jnp.stack([jnp.asarray(self.mask[i]) for i in group or range(size)])
        rows = jnp.where(held[:, None] & held, matrix, jnp.eye(size))
        wanted = jnp.where(held, jnp.stack(right), 0.0)
        if size > BY_DETERMINANTS:
            return jnp.linalg.solve(rows, wanted)
        return jnp.stack(solve([list(row) for row in rows], list(wanted)))

    def rest(self, parameters: Any, t: Any, x: Any) -> Any:
        """The resting field."""
        field = self.flow(parameters, t, x)
        for group in self.groups or (range(len(self.contacts)),):
            multipliers, _, directions = self.forces(parameters, t, x, group)
            field += self._sum(multipliers, directions)
        return field

    def load(self, index: int) -> Traced:
        """The contact force over ``1 / (N.D)``: positive while the obstacle pushes."""

        def load(parameters: Any, t: Any, x: Any) -> Any:
            group = next((g for g in self.groups if index in g), range(len(self.contacts)))
            multipliers, weights, _ = self.forces(parameters, t, x, group)
            place = group.index(index)
            return multipliers[place] * weights[place]

        return load

    def project(self, parameters: Any, t: Any, x: Any) -> Any:
        """The state projected onto zero gaps (two Newton steps) and zero gap speeds."""
        for _ in range(2):
            gradients, _, _ = self.geometry(parameters, t, x)
            gaps = [c.gap(parameters, t, x) for c in self.contacts]
            x = x - self._sum(self._solve(self._products(gradients, gradients), gaps), gradients)
        _, speeds, directions = self.geometry(parameters, t, x)
        rates = [c.speed(parameters, t, x) for c in self.contacts]
        return x - self._sum(self._solve(self._products(speeds, directions), rates), directions)


def laws(
    cls: Any, spec: Spec, contact: ContactSpec, pairing: Pairing, together: Sequence[int]
) -> ContactLaws:
    """The derived functions of a contact, from the traces of its gap and flow.

    ``together``: positions of all contacts declared with it as one array of gaps.
    """
    gap = again(cls.traces["gap", contact.name])
    flow = again(cls.traces["flow", contact.source])
    speed = lie(gap, flow)
    law = again(cls.traces["restitution", contact.name])
    mass = _mass(cls, spec, contact, pairing.positions, together)
    draws = contact.name in spec.chances
    drawn = np.eye(spec.dimension)[spec.place(DRAWS)] if draws else 0.0
    return ContactLaws(gap, speed, lie(speed, flow), flow, law, mass, pairing, drawn)


def _mass(
    cls: Any, spec: Spec, contact: ContactSpec, positions: Sequence[int], together: Sequence[int]
) -> Traced:
    """The inverse mass matrix of the contact's positions, as a function.

    A diagonal given for an array of gaps covers the positions of all of them (``together``).
    """
    size, own = len(positions), [list(together).index(place) for place in positions]
    given = contact.inverse_mass
    if isinstance(given, str):
        name = given
        given = lambda self, t, s: getattr(self, name)  # noqa: E731
    call = (
        caller(cls, spec, given) if callable(given) else lambda *_: 1.0 if given is None else given
    )

    def matrix(parameters: Any, t: Any, x: Any) -> Any:
        import jax.numpy as jnp

        value = jnp.asarray(call(parameters, t, x), dtype=float)
        if value.ndim == 1 and value.size > 1:
            _require_diagonal(spec, contact, value.shape, len(together))
            value = value[np.array(own)]
        if value.ndim > 2 or (value.ndim == 2 and len(together) > size):
            _require_diagonal(spec, contact, value.shape, len(together))
        if value.ndim == 2 and value.shape != (size, size):
            _require_diagonal(spec, contact, value.shape, size)
        if value.ndim < 2:
            value = jnp.broadcast_to(value, (size,))
            return jnp.diag(value)
        return value

    return matrix


def _require_diagonal(spec: Spec, contact: ContactSpec, shape: tuple[int, ...], size: int) -> None:
    """Refuse an inverse mass without exactly one number per position."""
    if shape != (size,):
        due = f"({size},)" if contact.among else f"({size},) or ({size}, {size})"
        said = f"contact {contact.name}: inverse_mass of shape {shape} where {due} is due"
        if contact.among:
            said += f", for the positions of {contact.among[0]} to {contact.among[-1]} together"
        raise DeclarationError(spec.model, [said])


def pair(
    spec: Spec, contact: ContactSpec, gap: set[int], flows: list[set[int]], unit: Any
) -> Pairing:
    """Find the velocity of each position in a gap.

    Parameters
    ----------
    gap : set of int
        Elements of the state that the gap depends on.
    flows : list of set of int
        Elements that each component of the flow depends on.
    unit : callable ``(i, j)``
        Whether component ``i`` of the flow has slope one in element ``j``.

    Raises
    ------
    DeclarationError
        If the derivative of a position is not its velocity plus a function of time and positions.
    """
    names = spec.element_names
    positions, velocities = [], []
    for i in sorted(gap):
        others = flows[i] - gap
        if not others:
            continue
        if len(others) > 1 or not unit(i, next(iter(others))):
            found = ", ".join(names[j] for j in sorted(others))
            raise DeclarationError(
                spec.model,
                [
                    f"contact {contact.name}: the derivative of {names[i]} is not a velocity of "
                    f"the state (it depends on {found}); make that velocity a state, or write "
                    "the impact as an edge with a reset"
                ],
            )
        positions.append(i)
        velocities.append(next(iter(others)))
    if not positions or len(set(velocities)) < len(velocities):
        raise DeclarationError(
            spec.model,
            [
                f"contact {contact.name}: the gap must depend on positions whose derivatives are "
                f"velocities in the state (mode {contact.source}); for a first-order flow write "
                "an edge"
            ],
        )
    return Pairing(tuple(positions), tuple(velocities))
