"""What a caller gives, as the arrays that compiled runs take."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from ..automaton.base import require_model
from ..automaton.markers import name_of
from ..errors import OptionError
from ..scene.lowered import Lowered, lowered
from ..scene.scene import parted
from ..solvers.base import method_of
from ..solvers.diffrax_backend import DEGREES, compiled_method, without_series
from ..solvers.series import TAYLOR
from .past import Past
from .system import System, system_of


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
    name = code.spec.initial if mode is None else name_of(mode)
    if not isinstance(name, str):
        raise OptionError(f"{code.spec.model}: mode={mode!r}: a mode, or its name")
    base, held = parted(name)
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


def past_of(
    system: System, method: Any, segments: int, history: Any, memory: str
) -> tuple[Past | None, Any]:
    """The delays of a system, and the constants in its history by state; None without delays.

    Raises
    ------
    OptionError
        If the options cannot be used, or a lag is not constant along a run.
    """
    spec, code = system.spec, system.code
    if memory not in ("keep", "restart"):
        raise OptionError(f"memory={memory!r}: 'keep' or 'restart'")
    if not spec.lags:
        if history is not None:
            raise OptionError(f"{spec.model}: history was given, but no flow looks into the past")
        return None, None
    if any(code.moving):
        name = spec.lags[code.moving.index(True)].name
        raise OptionError(
            f"{spec.model}: the lag {name} depends on time or state; compiled runs of many lanes "
            "know constant lags only: use hy.simulate"
        )
    if not (isinstance(segments, int | np.integer) and segments > 1):
        raise OptionError(f"segments={segments!r}: a whole number greater than 1")
    constants, function = _history(spec, history)
    return Past(system, method, int(segments), memory == "restart", function), constants


def _history(spec: Any, history: Any) -> tuple[dict[str, Any], Any]:
    """Constants by state, and the function ``(first, t)`` of a history that is one."""
    if history is None:
        return {}, None
    if callable(history):
        return {}, lambda first, t: _flat(spec, history(t))
    given = {name: history[name] for name in getattr(history, "keys", lambda: ())()}
    unknown = [name for name in given if name not in spec.names]
    if not given or unknown:
        known = ", ".join(spec.names)
        raise OptionError(
            f"{spec.model}: history={history!r}: give states by name (there are {known}), or one "
            "function of time; compiled runs take no trajectory"
        )
    functions = {name: value for name, value in given.items() if callable(value)}
    constants = {name: value for name, value in given.items() if not callable(value)}
    if not functions:
        return constants, None

    def function(first: Any, t: Any) -> Any:
        record = spec.record(first)
        return _flat(
            spec, {n: functions[n](t) if n in functions else record[n] for n in spec.names}
        )

    return constants, function


def _flat(spec: Any, values: Any) -> Any:
    return jnp.concatenate([jnp.asarray(v, float).reshape(-1) for v in spec.values(values)])


def check_zeno(zeno: str) -> None:
    """Refuse what a compiled run cannot do about accumulations."""
    if zeno not in ("rest", "stop", "ignore"):
        raise OptionError(
            f"zeno={zeno!r}: compiled runs know 'rest', 'stop' and 'ignore' (impacts one by "
            "one); for 'truncate' and 'raise' use hy.simulate"
        )


def method_for(system: System, solver: str, method: str | None, scan: str | None = None) -> Any:
    """The method of a compiled run.

    Raises
    ------
    OptionError
        If it cannot be used.
    """
    if solver != "diffrax":
        raise OptionError(f"solver={solver!r}: compiled runs need solver='diffrax'")
    name = method_of(solver, method, DEGREES)
    require_series(system, name)
    return compiled_method(name, scan)


def require_series(system: System, method: str) -> None:
    """Refuse Taylor series where there are none."""
    if method == TAYLOR and system.no_series is not None:
        raise without_series(system.spec.model, system.no_series)
