"""What a run is asked for, what it keeps as it goes on, and what it has found: data."""

from .trajectory import Solution, Status

__all__ = ["Solution", "Status"]
