"""Runs as pure functions inside the user's own JAX, with derivatives."""

from .function import REASONS, JumpTable, Limit, Outcome, as_function

__all__ = ["REASONS", "JumpTable", "Limit", "Outcome", "as_function"]
