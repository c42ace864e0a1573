"""What a run is asked for, what it keeps as it goes on, and what it returns."""

from .trajectory import Status, Trajectory

__all__ = ["Status", "Trajectory"]
