"""The state as an author sees it: ``s.x``, unpacking, ``s.replace(v=...)``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any


class Record:
    """Named values in declared order.

    Fields are attributes. Iteration yields, and ``len`` counts, the first ``unpacked`` values: all
    except the discrete variables. ``changed`` names the fields that :meth:`replace` was given.
    """

    _fields: tuple[str, ...]
    _values: tuple[Any, ...]

    _unpacked: int | None
    changed: tuple[str, ...]

    def __init__(
        self,
        fields: tuple[str, ...],
        values: tuple[Any, ...],
        label: str = "state",
        unpacked: int | None = None,
        changed: tuple[str, ...] = (),
    ):
        object.__setattr__(self, "_unpacked", unpacked)
        object.__setattr__(self, "changed", changed)
        object.__setattr__(self, "_fields", fields)
        object.__setattr__(self, "_values", values)
        object.__setattr__(self, "_label", label)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        try:
            return self._values[self._fields.index(name)]
        except ValueError:
            known = ", ".join(self._fields)
            raise AttributeError(f"no {self._label} named {name!r}; there are: {known}") from None

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"a record does not change; use .replace({name}=...)")

    def __iter__(self) -> Iterator[Any]:
        return iter(self._values[: self._unpacked])

    def __len__(self) -> int:
        return len(self._values[: self._unpacked])

    def __getitem__(self, name: str) -> Any:
        if not isinstance(name, str):
            raise TypeError(
                f"[{name!r}]: a record is read by name, s.{self._fields[0]} or "
                f"s[{self._fields[0]!r}]; or unpacked in the order of its states"
            )
        try:
            return self._values[self._fields.index(name)]
        except ValueError:
            known = ", ".join(self._fields)
            raise KeyError(f"no {self._label} named {name!r}; there are: {known}") from None

    def keys(self) -> tuple[str, ...]:
        """Names of the fields, in declared order."""
        return self._fields

    def replace(self, **changes: Any) -> Record:
        """A copy with some fields changed."""
        unknown = [name for name in changes if name not in self._fields]
        if unknown:
            known = ", ".join(self._fields)
            raise AttributeError(f"no {self._label} named {unknown[0]!r}; there are: {known}")
        pairs = zip(self._fields, self._values, strict=True)
        values, changed = tuple(changes.get(n, v) for n, v in pairs), (*self.changed, *changes)
        return Record(self._fields, values, self._label, self._unpacked, changed)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Record | Mapping):
            return NotImplemented
        import numpy as np

        same = tuple(self.keys()) == tuple(other.keys())
        return same and all(np.array_equal(self[name], other[name]) for name in self.keys())

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        pairs = zip(self._fields, self._values, strict=True)
        return "(" + ", ".join(f"{name}={value}" for name, value in pairs) + ")"


def parts(record: Record) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """The values of a record, and what they are of: to JAX a record is a pytree."""
    return record._values, (record._fields, record._label, record._unpacked)


def whole(what: tuple[Any, ...], values: Any) -> Record:
    """The record of :func:`parts`."""
    fields, label, unpacked = what
    return Record(fields, tuple(values), label, unpacked)
