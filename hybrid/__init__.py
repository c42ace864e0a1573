"""hybrid: declare a hybrid automaton once, simulate it with any solver, through Zeno points.

>>> import hybrid as hy
>>> run = hy.simulate(model, start={"x": 1.0, "v": 0.0}, t=(0.0, 3.0))

See :func:`simulate` for the options and :class:`Automaton` for how a model is written.
Importing this package loads neither JAX nor matplotlib: the first model defined loads JAX.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .automaton import (
    EITHER,
    FALLING,
    RISING,
    TERMINATE,
    Automaton,
    contact,
    discrete,
    edge,
    mode,
    output,
    parameter,
    picture,
    signal,
    state,
    switching,
)
from .errors import (
    DeclarationError,
    DomainError,
    FlowError,
    HybridError,
    JumpLoopError,
    OptionError,
    OrbitError,
    ParameterError,
    StartError,
    StoreError,
    TraceError,
    ZenoError,
)

if TYPE_CHECKING:
    from .benchmark import Bench, bench
    from .certificates import Certificate, certify
    from .ensembles import ensemble
    from .functions import as_function
    from .maps import Basins, Bifurcation, Region, basins, bifurcation, region, sweep
    from .orbits import lyapunov, periodic_orbit, return_map
    from .result import Trajectory, load
    from .simulation import simulate
    from .trajectory import Status
    from .trajectory.stats import Stats

__version__ = "0.1.0"

#: Names that load SciPy or xarray when first used.
_LAZY = {
    "Bench": "benchmark",
    "bench": "benchmark",
    "Certificate": "certificates",
    "as_function": "functions",
    "certify": "certificates",
    "lyapunov": "orbits",
    "periodic_orbit": "orbits",
    "return_map": "orbits",
    "ensemble": "ensembles",
    "Basins": "maps",
    "Bifurcation": "maps",
    "Region": "maps",
    "basins": "maps",
    "bifurcation": "maps",
    "region": "maps",
    "sweep": "maps",
    "simulate": "simulation",
    "load": "result",
    "Stats": "trajectory.stats",
    "Status": "trajectory",
    "Trajectory": "result",
}

#: Names that users knew, and where they went.
_MOVED = {
    "study": "the paper's section 2, paper/transient.py of a checkout "
    "(from paper.transient import transient)",
    "function": "hybrid.functions (from hybrid.functions import REASONS)",
}


def __getattr__(name: str) -> Any:
    if name in _MOVED:
        raise AttributeError(f"hybrid.{name} has moved: it is {_MOVED[name]}")
    if name not in _LAZY:
        raise AttributeError(f"module 'hybrid' has no attribute {name!r}")
    value = getattr(import_module(f".{_LAZY[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


__all__ = [
    "EITHER",
    "FALLING",
    "RISING",
    "TERMINATE",
    "Automaton",
    "Basins",
    "Bench",
    "Bifurcation",
    "Certificate",
    "DeclarationError",
    "DomainError",
    "FlowError",
    "HybridError",
    "JumpLoopError",
    "OptionError",
    "OrbitError",
    "ParameterError",
    "Region",
    "StartError",
    "Stats",
    "Status",
    "StoreError",
    "TraceError",
    "Trajectory",
    "ZenoError",
    "as_function",
    "basins",
    "bench",
    "bifurcation",
    "certify",
    "contact",
    "discrete",
    "edge",
    "ensemble",
    "load",
    "lyapunov",
    "mode",
    "output",
    "parameter",
    "periodic_orbit",
    "picture",
    "region",
    "return_map",
    "signal",
    "simulate",
    "state",
    "sweep",
    "switching",
]
