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
        "a guard is zero and the derivatives looked at do not decide which way it goes, "
        "or a switching forbids to slide or meets another; hy.simulate says which",
    ),
    LOOP: ("jump_loop", "jumps follow each other with no time between them"),
}


def code_of(model: Any) -> Lowered:
    """The generated code of a model (its parameters may be tracers)."""
    require_model(model)
    cls: Any = type(model)
    shapes = tuple(np.shape(getattr(model, p.name)) for p in cls.spec.parameters)
    return lowered(cls, shapes)


def place(code: Lowered, mode: str | None) -> tuple[System, int, np.ndarray]:
    """The system, the number of the mode at the start, and the contacts held there.

    Raises
    ------
    OptionError
        If there is no such mode.
    """
    system = system_of(code, slides=True)
    name = code.spec.initial if mode is None else mode
    base, _, rest = name.partition(".rest(")
    held = rest.removesuffix(")").split(", ") if rest else []
    able = {
        m: [edge.name for edge, rests in zip(edges, row, strict=False) if rests]
        for (m, edges), row in zip(system.edges.items(), system.rests, strict=True)
        if code.spec.sliding(m) is None
    }
    if base not in able or any(contact not in able[base] for contact in held):
        rests = [f"{m}.rest({contact})" for m, contacts in able.items() for contact in contacts]
        known = ", ".join([*able, *rests])
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
