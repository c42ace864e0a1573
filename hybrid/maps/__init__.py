"""Maps over parameters and starts: sweeps in blocks, over workers, into a store; bifurcations."""

from .grid import sweep

__all__ = ["sweep"]
