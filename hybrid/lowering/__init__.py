"""Lowering: a model's spec and traces become the code of the modes, guards and outputs a run
needs."""

from .lowered import window_ends
from .mode import Kind
from .scene import (
    Contact,
    Field,
    Guard,
    Kink,
    Scene,
    released,
    require_no_signal,
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
    "require_no_signal",
    "scene_of",
    "scene_with",
    "window_ends",
]
