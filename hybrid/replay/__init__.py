"""A finished run flown again by JAX, arc for arc, for its derivatives."""

from .laws import laws_of
from .plan import Plan, blank, plan_of

__all__ = ["Plan", "blank", "laws_of", "plan_of"]
