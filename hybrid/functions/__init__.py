"""Runs as pure functions, with derivatives, for the user's own JAX programs."""

from .function import REASONS, JumpTable, Limit, Outcome, as_function

__all__ = ["REASONS", "JumpTable", "Limit", "Outcome", "as_function"]
