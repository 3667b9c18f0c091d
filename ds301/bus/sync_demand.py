"""Whether SYNC is sent on a bus: nodes that need it, and nodes for whose sake it is withheld."""

from __future__ import annotations

from collections.abc import Callable


class SyncDemand:
    """Of the nodes of one bus."""

    def __init__(self) -> None:
        self._needed_by: set[int] = set()
        self.withheld_for: set[int] = set()
        """Nodes for whose sake no SYNC is sent."""
        self.required = False
        """A node on this bus sends or takes PDOs on SYNC."""
        self.changed: Callable[[], None] | None = None
        """Called when that changes."""

    def require(self, node_id: int, *, required: bool) -> None:
        """Whether a node needs SYNC."""
        (self._needed_by.add if required else self._needed_by.discard)(node_id)
        if self.required != bool(self._needed_by):
            self.required = bool(self._needed_by)
            if self.changed is not None:
                self.changed()

    def withhold(self, node_id: int, *, withheld: bool) -> None:
        """Whether SYNC is withheld for the sake of a node that nothing else stops."""
        (self.withheld_for.add if withheld else self.withheld_for.discard)(node_id)
