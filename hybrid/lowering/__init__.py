"""Lowering: spec and traces become code for the modes, guards and outputs that a run needs."""

from .lowered import window_ends
from .mode import Kind
from .scene import (
    Contact,
    Field,
    Guard,
    Kink,
    Scene,
    released,
    scene_of,
    scene_with,
)

__all__ = [
    "Contact",
    "Field",
    "Guard",
    "Kind",
    "Kink",
    "Scene",
    "released",
    "scene_of",
    "scene_with",
    "window_ends",
]
