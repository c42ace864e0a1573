"""What a run returns: pictures, files, and whether it settles, on top of its data."""

from .trajectory import Trajectory, load

__all__ = ["Trajectory", "load"]
