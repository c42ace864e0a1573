"""Comparisons of solvers on a user's model: agreement, and speed against error."""

from .precision import Bench, bench

__all__ = ["Bench", "bench"]
