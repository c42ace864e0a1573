"""The body of a model's class: its markers, and names that are given twice."""

from __future__ import annotations

from abc import ABCMeta
from collections.abc import Mapping
from typing import Any

from .discrete import Discrete
from .markers import ContactMarker, EdgeMarker, Mode, State, Switching, is_parameter
from .outputs import Output
from .signals import is_signal

#: The kinds of declarations by their markers; the first that fits holds.
DECLARED_AS = {
    Discrete: "a discrete variable",
    State: "a state",
    Mode: "a mode",
    EdgeMarker: "an edge",
    ContactMarker: "a contact",
    Switching: "a switching",
    Output: "an output",
}

#: Where a class keeps what its body has given twice.
TWICE = "_hybrid_twice"


def kind_of(value: Any) -> str:
    """What a value of a class body declares; empty if it is no marker."""
    if is_parameter(value):
        return "a parameter"
    if is_signal(value):
        return "a signal"
    return next((said for kind, said in DECLARED_AS.items() if isinstance(value, kind)), "")


class Body(dict[str, Any]):
    """A class body that remembers which declarations were given another value."""

    def __init__(self) -> None:
        super().__init__()
        self[TWICE] = []

    def __setitem__(self, name: str, value: Any) -> None:
        first = kind_of(self.get(name))
        if first:
            then = kind_of(value) or "something else"
            self[TWICE].append(
                f"{name}: declared twice, as {first} and then as {then}, which would take its "
                "place; give each a name of its own"
            )
        elif kind_of(value):
            same = [other for other, known in self.items() if known is value]
            said = f"{name}: the same declaration as {', '.join(same)}; write one for each name"
            self[TWICE] += [said] if same else []
        super().__setitem__(name, value)


class AutomatonMeta(ABCMeta):
    """Makes the classes of models; their bodies are read by :class:`Body`."""

    @classmethod
    def __prepare__(mcls, name: str, bases: tuple[type, ...], /, **kwargs: Any) -> Body:
        return Body()


def given_twice(namespace: Mapping[str, Any]) -> list[str]:
    """The faults of a class whose body declares a name twice."""
    return list(namespace.get(TWICE, ()))
