"""Runs as pure functions inside the user's own JAX, with derivatives."""

from .function import as_function

__all__ = ["as_function"]
