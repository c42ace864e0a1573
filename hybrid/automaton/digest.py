"""A digest of a class of models, by which two processes recognise the same class."""

from __future__ import annotations

import re
from collections.abc import Iterator
from hashlib import sha256
from typing import Any

import numpy as np

#: Memory address in a repr.
PLACE = re.compile(r" at 0x[0-9a-fA-F]+")


def digest(cls: Any) -> str:
    """SHA-256 of what a class declares, its traces, and the values that its functions capture."""
    parts = list(_parts(cls))
    return sha256("\0".join(PLACE.sub("", part) for part in parts).encode()).hexdigest()


def _parts(cls: Any) -> Iterator[str]:
    yield repr(cls.spec)
    for key, closed in cls.traces.items():
        yield f"{key} {closed.jaxpr.pretty_print(use_color=False)}"  # str colours it on a terminal
        yield from map(_text, closed.consts)
    for label, found in cls._captured:
        yield f"{label} {found.name} {_text(found.value)}"


def _text(value: Any) -> str:
    """The full text of a value; repr would shorten a large array."""
    if isinstance(value, tuple):
        return f"({', '.join(map(_text, value))})"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key!r}: {_text(each)}' for key, each in value.items())}}}"
    if hasattr(value, "__array__"):
        array = np.asarray(value)
        return f"{array.dtype} {array.shape} {array.tolist()}"
    return repr(value)
