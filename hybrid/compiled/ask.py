"""What a caller gives, as the arrays that compiled runs take."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..automaton.base import require_model
from ..errors import OptionError
from ..scene.lowered import Lowered, lowered
from ..solvers.base import method_of
from ..solvers.diffrax_backend import DEGREES
from .lane import (
    END,
    LOOP,
    MAX_JUMPS,
    MAX_STEPS,
    NO_REST,
    NOT_FINITE,
    OUTSIDE,
    UNDECIDED,
    ZENO,
)
from .system import System, system_of

#: What a lane's status means.
REASONS = {
    END: ("reached_end", "the last time was reached"),
    MAX_JUMPS: ("max_jumps", "max_jumps was reached; raise it"),
    ZENO: ("zeno_stopped", "jumps accumulate (zeno='stop'); zeno='rest' goes on at rest"),
    NO_REST: ("no_rest", "jumps accumulate, and the contact declares rests=False"),
    MAX_STEPS: ("max_steps", "max_steps was reached; raise it"),
    NOT_FINITE: (
        "not_finite",
        "a flow, guard or reset is not finite, or the step became zero",
    ),
    OUTSIDE: ("outside", "the start, or a reset, is outside the mode's domain"),
    UNDECIDED: (
        "undecided",
        "a guard is zero and two derivatives do not decide which way it goes",
    ),
    LOOP: ("jump_loop", "jumps follow each other with no time between them"),
}


def code_of(model: Any) -> Lowered:
    """The generated code of a model (its parameters may be tracers).

    Raises
    ------
    OptionError
        If the model has a switching: whether it slides is judged in Python.
    """
    require_model(model)
    cls: Any = type(model)
    if cls.spec.switchings:
        raise OptionError(
            f"{cls.spec.model}: compiled lanes cannot judge the switching "
            f"{cls.spec.switchings[0].name} yet; use hy.simulate, once for each lane"
        )
    shapes = tuple(np.shape(getattr(model, p.name)) for p in cls.spec.parameters)
    return lowered(cls, shapes)


def place(code: Lowered, mode: str | None) -> tuple[System, int, np.ndarray]:
    """The system, the number of the mode at the start, and the contacts held there.

    Raises
    ------
    OptionError
        If there is no such mode.
    """
    system = system_of(code)
    name = code.spec.initial if mode is None else mode
    base, _, rest = name.partition(".rest(")
    held = rest.removesuffix(")").split(", ") if rest else []
    able = {
        m: [edge.name for edge, rests in zip(edges, row, strict=False) if rests]
        for (m, edges), row in zip(system.edges.items(), system.rests, strict=True)
    }
    if base not in able or any(contact not in able[base] for contact in held):
        rests = [f"{m}.rest({contact})" for m, contacts in able.items() for contact in contacts]
        known = ", ".join([*system.modes, *rests])
        raise OptionError(f"{code.spec.model}: mode={mode!r}; there are {known}")
    slots = [edge.name for edge in system.edges[base]]
    mask = np.array([name in held for name in slots] + [False] * (system.width - len(slots)))
    return system, system.modes.index(base), mask


def check_zeno(zeno: str) -> None:
    """Refuse what a compiled run cannot do about accumulations."""
    if zeno not in ("rest", "stop", "ignore"):
        raise OptionError(
            f"zeno={zeno!r}: compiled runs know 'rest', 'stop' and 'ignore' (impacts one by "
            "one); for 'truncate' and 'raise' use hy.simulate"
        )


def check_method(solver: str, method: str | None) -> str:
    """The name of a Diffrax method."""
    if solver != "diffrax":
        raise OptionError(f"solver={solver!r}: compiled runs need solver='diffrax'")
    return method_of(solver, method, DEGREES)
