"""The first variation of a run: how it changes with its start, its parameters and its times."""

from .derivatives import Derivatives
from .walk import Course, Factor, Moment, Walk, factors

__all__ = ["Course", "Derivatives", "Factor", "Moment", "Walk", "factors"]
