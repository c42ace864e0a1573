"""Replay of a finished run in JAX, arc by arc, for its second derivatives."""

from .itinerary import Itinerary, blank, plan_of
from .laws import laws_of

__all__ = ["Itinerary", "blank", "laws_of", "plan_of"]
