"""One run: the loop, an arc, an entry into a mode, and what is recorded."""

from ..trajectory.plan import Plan
from .driver import Driver

__all__ = ["Driver", "Plan"]
