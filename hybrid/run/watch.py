"""Series of impacts, which may be summed."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import attrs

if TYPE_CHECKING:
    from ..automaton.shapes import StateVector
    from ..lowering import Field


@attrs.define
class Watch:
    """The impacts of a run.

    Attributes
    ----------
    contact, count : str, int
        The contact of the last jump, and its impacts with no other jump between; none if the last
        jump was no impact.
    tried : float
        The gap speed at which a sum of these was tried last.
    impacts : dict
        Of each contact, the impacts since it was at rest, or another jump has changed its gap or
        gap speed.
    """

    contact: str | None = None
    count: int = 0
    tried: float = float("inf")
    impacts: dict[str, int] = attrs.Factory(dict)

    def saw(self, edge: str) -> None:
        """Count an impact; a series begins where it is another contact's."""
        if edge != self.contact:
            self.contact, self.count, self.tried = edge, 0, float("inf")
        self.count += 1
        self.impacts[edge] = self.impacts.get(edge, 0) + 1

    def over(self, contacts: Collection[str]) -> None:
        """Some contacts have come to rest."""
        if self.contact in contacts:
            self.contact = None
        for name in contacts:
            self.impacts.pop(name, None)

    def carried(self, name: str) -> bool:
        """Whether other jumps came between the impacts of a contact, and left it alone."""
        return self.contact != name or self.impacts[name] > self.count

    def interrupted(
        self,
        edge: str,
        here: Field,
        there: Field,
        t: float,
        before: StateVector,
        after: StateVector,
    ) -> None:
        """Forget the impacts of other contacts whose gap or gap speed a jump, which leads from one
        field to another, has changed."""
        others = self.impacts.keys() - {edge}
        if not others:
            return
        was, is_ = (
            {g.edge: g.lie(t, x.tolist())[:2] for g in field.guards if g.edge in others}
            for field, x in ((here, before), (there, after))
        )
        for name in others:
            if name not in was or was[name] != is_.get(name):
                del self.impacts[name]
