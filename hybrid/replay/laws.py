"""The functions of a class that a replay uses, by number, as differentiable JAX functions.

They are the class's own traces and the derived laws of contacts and switchings
(:mod:`hybrid.lowering.contact`, :mod:`hybrid.lowering.sliding`); a mask says which contacts are
held.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax

from ..automaton.spec import ContactSpec, EdgeSpec
from ..automaton.trace import again
from ..lowering.contact import Held
from ..lowering.lowered import Lowered
from ..lowering.mode import RELEASE_SUFFIX

#: A function of ``(parameters, mask, t, x)``.
Law = Callable[..., Any]

#: Names of the conditions, other than guards, that end a step: it has a fixed length, or it ends at
#: the run's last time.
AT_LENGTH, AT_END = "length", "end"

#: Name of the reset or projection that does not change the state.
IDENTITY = "same"


class Laws:
    """The functions of a class by name; their order in each dict defines their numbers.

    Attributes
    ----------
    contacts : tuple of str
        Contacts that can be held, in the order of the mask.
    flows : dict
        Flows, by mode and whether contacts are held.
    guards : dict
        Guards, by edge; that of ``"<contact>.release"`` is the load on the contact.
    resets : dict
        Resets, by edge.
    onto : dict
        Projections onto the held contacts or the sliding surface, by mode.
    """

    def __init__(self, code: Lowered) -> None:
        self.code, self.spec = code, code.spec
        rests = [e for e in self.spec.transitions if isinstance(e, ContactSpec) and e.rests]
        self.contacts = tuple(edge.name for edge in rests)
        self.flows: dict[tuple[str, bool], Law] = {}
        self.guards: dict[str, Law] = {AT_LENGTH: _nothing, AT_END: _nothing}
        self.resets: dict[str, Law] = {IDENTITY: _same}
        self.onto: dict[str, Law] = {IDENTITY: _same}
        slides = [switching.mode for switching in self.spec.switchings if switching.slides]
        for mode in (*(mode.name for mode in self.spec.modes), *slides):
            self._add(mode)

    def _add(self, mode: str) -> None:
        self.flows[mode, False] = _unmasked(self.code.field_closed(mode, ()))
        for edge in (*self.spec.leaving(mode), *self.spec.ringing(mode)):
            self.guards[edge.name] = _unmasked(self.code.guard_closed(edge))
            if isinstance(edge, EdgeSpec):
                self.resets[edge.name] = _unmasked(self.code.closed("reset", edge.name))
            if isinstance(edge, ContactSpec):
                impact = self.code.laws(edge.name).impact
                self.resets[edge.name] = lambda p, m, t, x, impact=impact: impact(p, t, x)[:-1]
        switching = self.spec.sliding(mode)
        if switching is not None:
            project = self.code.sliding(switching.name).project
            self.onto[mode] = lambda p, m, t, x: project(p, t, x)
            return
        own = [e.name for e in self.spec.leaving(mode) if e.name in self.contacts]
        if own:
            held = self._held(mode, own)
            self.flows[mode, True] = lambda p, m, t, x: held(m).rest(p, t, x)
            self.onto[mode] = lambda p, m, t, x: held(m).project(p, t, x)
        for place, name in enumerate(own):
            self.guards[f"{name}{RELEASE_SUFFIX}"] = lambda p, m, t, x, place=place: held(m).load(
                place
            )(p, t, x)

    def _held(self, mode: str, names: Sequence[str]) -> Callable[[Any], Held]:
        """A function of the mask that returns the held contacts of a mode."""
        laws = tuple(self.code.laws(name) for name in names)
        flow = again(self.code.closed("flow", mode))
        places = [self.contacts.index(name) for name in names]
        return lambda mask: Held(laws, flow, [mask[place] > 0.5 for place in places])


def chosen(laws: dict[Any, Law], number: Any, *given: Any) -> Any:
    """The result of function ``number`` of ``laws``; the number may be traced."""
    branches = list(laws.values())
    return branches[0](*given) if len(branches) == 1 else jax.lax.switch(number, branches, *given)


def _unmasked(closed: Any) -> Law:
    call = again(closed)
    return lambda p, m, t, x: call(p, t, x)


def _same(p: Any, mask: Any, t: Any, x: Any) -> Any:
    return x


def _nothing(p: Any, mask: Any, t: Any, x: Any) -> Any:
    return 0.0 * t


def laws_of(code: Lowered) -> Laws:
    """The functions of a class, cached with its generated code."""
    made: Laws = code.once("replay", lambda: Laws(code))
    return made
