"""The options, the record and the result of a run, as data."""

from .trajectory import Solution, Status

__all__ = ["Solution", "Status"]
