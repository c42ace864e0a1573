"""The question put to a certificate: checked options, and functions read from the trace."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import attrs

from ..automaton import trace
from ..automaton.base import require_model
from ..automaton.spec import ContactSpec, EdgeSpec, Spec
from ..bounds.exact import FixedGraph, hides_derivatives
from ..bounds.extrema import Bounds, ScalarFunction
from ..bounds.interval import IntervalProgram
from ..errors import DeclarationError, OptionError, TraceError
from ..lowering import scene_of
from ..lowering.contact import ContactLaws
from ..lowering.jaxpr import read
from ..lowering.lowered import Lowered
from ..lowering.taylor import flat
from .result import Certificate

#: Names of the coordinates relative to a contact.
GAP_NAME, SPEED_NAME, TIME_NAME = "gap", "speed", "t"

Traced = Callable[..., Any]


@attrs.frozen(eq=False)
class Question:
    """A contact of a model with parameter values, and a box.

    Attributes
    ----------
    box : dict
        Bounds by the names under which they were given.
    relative : bool
        Whether the box is in coordinates relative to the contact.
    position, velocity : int
        Indices in the state vector of the gap's position and its velocity; the first pair if the
        gap depends on several.
    """

    spec: Spec
    code: Lowered
    values: tuple[float, ...]
    contact: ContactSpec
    box: dict[str, Bounds]
    relative: bool

    @property
    def laws(self) -> ContactLaws:
        return self.code.laws(self.contact.name)

    @property
    def position(self) -> int:
        return self.laws.pairing.positions[0]

    @property
    def velocity(self) -> int:
        return self.laws.pairing.velocities[0]

    @property
    def labels(self) -> dict[str, str]:
        """Maps the inputs of the functions (``x0``, ``t``) to the names in the box."""
        names = {f"x{i}": name for i, name in enumerate(self.spec.element_names)}
        if self.relative:
            names |= {f"x{self.position}": GAP_NAME, f"x{self.velocity}": SPEED_NAME}
        return {**names, TIME_NAME: TIME_NAME}

    def bounds(self, *functions: ScalarFunction) -> dict[str, Bounds]:
        """Bounds of the inputs of the given functions.

        Raises
        ------
        OptionError
            If the box has no bounds for one of them.
        """
        inputs = sorted(set().union(*(f.inputs for f in functions)))
        labels = self.labels
        for name in inputs:
            if labels[name] not in self.box:
                self.refuse(
                    f"box has no bounds for {labels[name]!r}, on which the proof depends; "
                    f"add {labels[name]!r}: (low, high)"
                )
        return {name: self.box[labels[name]] for name in inputs}

    def refuse(self, sentence: str) -> None:
        raise OptionError(f"{self.spec.model}, contact {self.contact.name}: {sentence}")

    def answer(
        self, statement: str, verdict: str, reason: str, repair: str = "", **found: Any
    ) -> Certificate:
        """The certificate that answers the question."""
        return Certificate(
            model=self.spec.model,
            contact=self.contact.name,
            box=self.box,
            statement=statement,
            verdict=verdict,
            reason=reason,
            repair=repair,
            **found,
        )

    def named(self, point: Mapping[str, Any]) -> dict[str, Any]:
        """A point under the names of the box."""
        return {self.labels[name]: value for name, value in point.items()}

    def function(self, call: Traced) -> ScalarFunction:
        """An expression of ``(parameters, t, x)``, with its gradient if there is one."""

        def slopes(parameters: Any, *point: Any) -> Any:
            import jax
            import jax.numpy as jnp

            places = tuple(range(1, 1 + len(point)))
            parts = jax.jacfwd(call, argnums=places)(parameters, *point)
            return jnp.concatenate([jnp.ravel(part) for part in parts])

        value = self._program(lambda *given: call(*given)[None], exact=True)
        names = [TIME_NAME, *(f"x{i}" for i in range(self.spec.dimension))]
        kept = [i for i, name in enumerate(names) if name in value.inputs]
        try:
            gradient = self._program(slopes, exact=False, kept=kept)
        except (TraceError, NotImplementedError):
            return ScalarFunction(value)
        if not gradient.inputs <= value.inputs:
            return ScalarFunction(value)
        return ScalarFunction(value, gradient, [names[i] for i in kept])

    def rates(self, flow: Traced) -> IntervalProgram:
        """The rates of all elements of the state."""
        return self._program(flow, exact=True, kept=range(self.spec.dimension))

    def _program(self, call: Traced, exact: bool, kept: Sequence[int] = (0,)) -> IntervalProgram:
        """Some results of an expression, with the parameter values inserted."""
        shapes = self.code.shapes
        closed = trace.trace(self.spec, call, 0, shapes)
        graph = FixedGraph(exact)
        inputs = self.code.inputs(graph)[len(shapes) :]
        (roots,) = read(graph, closed, [*graph.arguments(shapes, self.values), *inputs])
        try:
            return IntervalProgram(graph, [roots[i] for i in kept])
        except TraceError as fault:
            raise TraceError(f"{self.spec.model}: {fault}") from None

    def law(self, place: Traced, speed: Traced) -> ScalarFunction:
        """The restitution; ``place`` gives the state at an impact, ``speed`` the gap speed."""
        law = trace.again(self.code.closed("restitution", self.contact.name))
        return self.function(lambda p, t, z: law(p, t, place(p, t, z), speed(p, t, z)))

    def on_contact(self, parameters: Any, t: Any, x: Any) -> Any:
        """A state with its position moved to zero gap; for affine gaps."""
        return solved(self.laws.gap, self.position, parameters, t, x, 0.0)

    def other_guards(self, place: Callable[[Traced], Traced]) -> dict[str, ScalarFunction]:
        """The guards of the mode's other edges; ``place`` converts them to the proof's coordinates.

        Raises
        ------
        OptionError
            If one of the edges is urgent.
        """
        edges = [e for e in self.spec.leaving(self.contact.source) if e is not self.contact]
        urgent = [e.name for e in edges if isinstance(e, EdgeSpec) and e.urgent]
        if urgent:
            self.refuse(
                f"edge {urgent[0]} is urgent, and may fire behind any impact: simulate the model, "
                "and ask the accumulations of the run for their proofs"
            )
        guards = {e.name: trace.again(self.code.guard_closed(e)) for e in edges}
        return {name: self.function(place(guard)) for name, guard in guards.items()}


def solved(h: Traced, k: int, parameters: Any, t: Any, x: Any, value: Any) -> Any:
    """The state with element ``k`` such that ``h`` has the given value; ``h`` is affine in it."""
    import jax
    import jax.numpy as jnp

    base = x.at[k].set(0.0)
    along = jnp.zeros_like(x).at[k].set(1.0)
    start, slope = jax.jvp(lambda x: h(parameters, t, x), (base,), (along,))
    return base.at[k].set((value - start) / slope)


def ask(model: Any, box: Any, mode: str | None, contact: str | None) -> Question:
    """Check a question."""
    require_model(model)
    scene = scene_of(model, by="hy.certify")
    chosen = _contact(scene.spec, mode, contact)
    try:
        scene.code.pairing(chosen.name)
    except DeclarationError as fault:
        raise OptionError(
            f"{scene.spec.model}: a certificate needs a contact of second order; "
            + "; ".join(fault.faults)
        ) from None
    _require_own_derivatives(scene.code, chosen)
    values = tuple(flat(model.parameters))
    checked = _box(scene.spec, box)
    relative = any(
        name in checked and name not in scene.spec.names for name in (GAP_NAME, SPEED_NAME)
    )
    return Question(scene.spec, scene.code, values, chosen, checked, relative)


def _require_own_derivatives(code: Lowered, contact: ContactSpec) -> None:
    """Refuse ``stop_gradient``, which falsifies the derivatives on which the proofs rest."""
    for kind, name in (("flow", contact.source), ("gap", contact.name)):
        if hides_derivatives(code.closed(kind, name)):
            raise OptionError(
                f"{code.spec.model}, {kind} {name}: stop_gradient hides a derivative that the "
                "proof needs; remove it"
            )


def _contact(spec: Spec, mode: str | None, contact: str | None) -> ContactSpec:
    modes = [m.name for m in spec.modes]
    if mode is not None and mode not in modes:
        raise OptionError(f"{spec.model}: mode={mode!r}; there are {', '.join(modes)}")
    contacts = [e for e in spec.transitions if isinstance(e, ContactSpec)]
    if not contacts:
        raise OptionError(
            f"{spec.model}: there is no contact to certify; declare one with hy.contact"
        )
    found = [e for e in contacts if mode in (None, e.source) and contact in (None, e.name)]
    if len(found) == 1:
        return found[0]
    names = ", ".join(f"{e.name} (mode {e.source})" for e in contacts)
    given = f"contact={contact!r}, mode={mode!r}"
    if not found:
        raise OptionError(f"{spec.model}: {given}: no such contact; there are {names}")
    raise OptionError(f"{spec.model}: {given}: several contacts, {names}; name one: contact=...")


def _box(spec: Spec, box: Any) -> dict[str, Bounds]:
    known = [*spec.element_names, GAP_NAME, SPEED_NAME, TIME_NAME]
    if not isinstance(box, Mapping) or not box:
        raise OptionError(f"{spec.model}: box={box!r}; give bounds by name: {{'x': (a, b), ...}}")
    checked = {}
    for name, bounds in box.items():
        if name not in known:
            raise OptionError(
                f"{spec.model}: box has {name!r}, which is no state; there are "
                f"{', '.join(spec.element_names)}, and the relative coordinates gap, speed, t"
            )
        try:
            low, high = (float(bound) for bound in bounds)
        except (TypeError, ValueError):
            raise OptionError(f"{spec.model}: box {name}={bounds!r}; give (low, high)") from None
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise OptionError(
                f"{spec.model}: box {name}=({low}, {high}); two finite bounds, the lower first"
            )
        checked[name] = (low, high)
    return checked
