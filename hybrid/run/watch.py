"""Series of impacts of one contact, which may be summed."""

from __future__ import annotations

import attrs


@attrs.define
class Watch:
    """A series of impacts of one contact, with no other jump between."""

    contact: str | None = None
    count: int = 0
    tried: float = float("inf")

    def saw(self, edge: str) -> None:
        """Count an impact; start anew where it is another contact's."""
        if edge != self.contact:
            self.contact, self.count, self.tried = edge, 0, float("inf")
        self.count += 1

    def reset(self) -> None:
        """Another jump came between."""
        self.contact = None
