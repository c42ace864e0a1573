"""Maps over parameters and starts: sweeps in blocks, over workers, into a store; what they show."""

from .attraction import Attractor, Basins, basins
from .diagram import Bifurcation, bifurcation
from .grid import sweep
from .plane import Region, region

__all__ = [
    "Attractor",
    "Basins",
    "Bifurcation",
    "Region",
    "basins",
    "bifurcation",
    "region",
    "sweep",
]
