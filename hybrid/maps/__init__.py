"""Maps over parameters and starts: sweeps in blocks, over workers, into a store; bifurcations."""

from .diagram import Bifurcation, bifurcation
from .grid import sweep

__all__ = ["Bifurcation", "bifurcation", "sweep"]
