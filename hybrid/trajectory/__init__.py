"""What a run was asked for, what it records, and what it found: data only."""

from .trajectory import Solution, Status

__all__ = ["Solution", "Status"]
