"""Solvers side by side on a user's own model: whether they agree, and speed against error."""

from .precision import Bench, bench

__all__ = ["Bench", "bench"]
