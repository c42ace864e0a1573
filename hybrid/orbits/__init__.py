"""Orbits: return maps, periodic orbits and their multipliers, Lyapunov exponents."""

from .periodic import PeriodicOrbit, periodic_orbit
from .returns import ReturnMap, return_map

__all__ = ["PeriodicOrbit", "ReturnMap", "periodic_orbit", "return_map"]
