"""One run: the loop, an arc, an entry into a mode, and what is recorded."""

from .driver import Driver
from .plan import Plan

__all__ = ["Driver", "Plan"]
