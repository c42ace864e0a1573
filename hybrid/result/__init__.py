"""The result of a run: its data, with plots, files and the analysis of its long-term behaviour."""

from .trajectory import Trajectory, load

__all__ = ["Trajectory", "load"]
