"""A finished run flown again by JAX, arc for arc: its derivatives of any order, in both modes."""

from .plan import Plan, plan_of

__all__ = ["Plan", "plan_of"]
