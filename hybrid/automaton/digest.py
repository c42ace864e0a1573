"""A digest of all that a class of models says: two processes know by it that they have the same."""

from __future__ import annotations

import re
from collections.abc import Iterator
from hashlib import sha256
from typing import Any

import numpy as np

#: Where in memory something is, in its text.
PLACE = re.compile(r" at 0x[0-9a-fA-F]+")


def digest(cls: Any) -> str:
    """What a class declares, what was traced, and what its functions see besides."""
    parts = list(_parts(cls))
    return sha256("\0".join(PLACE.sub("", part) for part in parts).encode()).hexdigest()


def _parts(cls: Any) -> Iterator[str]:
    yield repr(cls.spec)
    for key, closed in cls.traces.items():
        yield f"{key} {closed.jaxpr}"
        yield from map(_text, closed.consts)
    for label, found in cls._captured:
        yield f"{label} {found.name} {_text(found.value)}"


def _text(value: Any) -> str:
    """All of a value; a large array's own text is shortened."""
    if isinstance(value, tuple):
        return f"({', '.join(map(_text, value))})"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key!r}: {_text(each)}' for key, each in value.items())}}}"
    if hasattr(value, "__array__"):
        array = np.asarray(value)
        return f"{array.dtype} {array.shape} {array.tolist()}"
    return repr(value)
