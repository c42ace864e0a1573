"""Series of impacts of one contact, which may be summed."""

from __future__ import annotations

import attrs


@attrs.define
class Watch:
    """A series of impacts of one contact, with no other jump between.

    ``carried``: the contact of a series, long enough to be summed, that jumps have ended which left
    its gap and gap speed alone.
    """

    contact: str | None = None
    count: int = 0
    tried: float = float("inf")
    carried: str | None = None

    def saw(self, edge: str) -> None:
        """Count an impact; start anew where it is another contact's."""
        if edge != self.contact:
            self.contact, self.count, self.tried = edge, 0, float("inf")
            self.carried = edge if edge == self.carried else None
        self.count += 1

    def long(self, patience: float) -> str | None:
        """The contact of a series that is long enough to be summed, be it carried."""
        return self.contact if self.contact and self.count >= patience else self.carried

    def reset(self, carried: str | None = None) -> None:
        """Another jump came between, which has left the contact ``carried`` alone."""
        self.contact, self.carried = None, carried
