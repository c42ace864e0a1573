"""What a caller gives, as the arrays that compiled runs take."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..automaton.spec import Spec
from ..errors import OptionError
from ..scene.lowered import Lowered, lowered
from .system import System, system_of

#: No step can be held to less, relative to the state.
FINEST = 2.3e-14

#: What a lane's status means.
REASONS = {
    1: ("reached_end", "the last time was reached"),
    2: ("max_jumps", "max_jumps was reached; raise it"),
    3: ("zeno_stopped", "jumps accumulate (zeno='stop'); zeno='rest' goes on at rest"),
    4: ("no_rest", "jumps accumulate, and the contact declares rests=False"),
    7: ("max_steps", "max_steps was reached; raise it"),
    8: ("not_finite", "a flow, guard or reset is not finite, or the step became zero"),
    9: ("outside", "the start, or a reset, is outside the mode's domain"),
    10: ("undecided", "a guard is zero and two derivatives do not decide which way it goes"),
    11: ("jump_loop", "jumps follow each other with no time between them"),
}


def code_of(model: Any) -> Lowered:
    """The generated code of a model (its parameters may be tracers)."""
    cls: Any = type(model)
    if not hasattr(cls, "spec"):
        what = "write Model()" if hasattr(model, "spec") else repr(cls)
        raise OptionError(f"model must be an instance of a subclass of hy.Automaton: {what}")
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


def check_tolerances(spec: Spec, rtol: Any, atol: Any) -> tuple[np.ndarray, np.ndarray]:
    """Tolerances that a step can be held to; ``atol`` may have one for each element."""
    relative, absolute = (np.asarray(v, dtype=float) for v in (rtol, atol))
    if relative.shape != () or not 0 < relative < 1:
        raise OptionError(f"rtol={rtol!r}: a number between 0 and 1")
    if absolute.shape not in ((), (spec.dimension,)) or not np.all(absolute >= 0):
        raise OptionError(
            f"atol={atol!r}: a number, or one for each of the {spec.dimension} elements of the "
            "state"
        )
    return np.maximum(relative, FINEST), absolute


def check_zeno(zeno: str) -> None:
    """Refuse what a compiled run cannot do about accumulations."""
    if zeno not in ("rest", "stop", "ignore"):
        raise OptionError(
            f"zeno={zeno!r}: compiled runs know 'rest', 'stop' and 'ignore' (impacts one by "
            "one); for 'truncate' and 'raise' use hy.simulate"
        )


def check_method(solver: str, method: str | None) -> str:
    """The name of a Diffrax method."""
    from ..solvers.diffrax_backend import DEGREES

    if solver != "diffrax":
        raise OptionError(f"solver={solver!r}: compiled runs need solver='diffrax'")
    method = method or "Dopri8"
    if method not in DEGREES:
        raise OptionError(f"method={method!r}: solver 'diffrax' has {', '.join(DEGREES)}")
    return method
