"""Orbits: return maps, periodic orbits and their multipliers, Lyapunov exponents."""

from .exponents import Exponents, lyapunov
from .periodic import PeriodicOrbit, periodic_orbit
from .returns import ReturnMap, return_map

__all__ = [
    "Exponents",
    "PeriodicOrbit",
    "ReturnMap",
    "lyapunov",
    "periodic_orbit",
    "return_map",
]
