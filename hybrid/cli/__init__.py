"""The command line."""

from . import maps
from .commands import app

__all__ = ["app", "maps"]
