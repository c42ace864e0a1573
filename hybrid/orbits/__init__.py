"""Orbits: return maps, periodic orbits and their multipliers, Lyapunov exponents."""

from .returns import ReturnMap, return_map

__all__ = ["ReturnMap", "return_map"]
