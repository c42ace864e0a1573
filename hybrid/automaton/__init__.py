"""The declaration layer: markers in a class body become one frozen, checked spec."""

from .base import Automaton
from .discrete import discrete
from .markers import (
    EITHER,
    FALLING,
    RISING,
    TERMINATE,
    Crossing,
    contact,
    edge,
    mode,
    parameter,
    state,
    switching,
)
from .outputs import output
from .picture import picture
from .record import Record
from .signals import signal
from .spec import ContactSpec, EdgeSpec, ModeSpec, SideSpec, Spec, SwitchingSpec

__all__ = [
    "EITHER",
    "FALLING",
    "RISING",
    "TERMINATE",
    "Automaton",
    "ContactSpec",
    "Crossing",
    "EdgeSpec",
    "ModeSpec",
    "Record",
    "SideSpec",
    "Spec",
    "SwitchingSpec",
    "contact",
    "discrete",
    "edge",
    "mode",
    "output",
    "parameter",
    "picture",
    "signal",
    "state",
    "switching",
]
