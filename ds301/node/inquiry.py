"""Identify a node by SDO uploads only: for commissioning, while no gateway runs on its bus.

Source: CiA 301 (SDO upload). Every object is one SDO upload; no NMT command, no PDO.
"""

from __future__ import annotations

from typing import Self

import canopen

from pdgw.ds301.aborts import NOT_THERE
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.node.sdo import SdoAccess
from pdgw.ds301.sdo_transfer import SdoAbortedError
from pdgw.durations import SECOND


class Inquiry(SdoAccess):
    """Queries a node until the end of the ``with`` block, inside a task. ``timeout_s``: for each answer."""

    def __init__(self, network: CanNetwork, node_id: int, timeout_s: float) -> None:
        super().__init__(network, node_id, canopen.ObjectDictionary())
        self.node_id = node_id
        self.set_timeout(int(timeout_s * SECOND), slow=False)

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def fetch(self, index: int, subindex: int = 0) -> bytes | None:
        """What an object holds: None where the node does not have it, nothing where it cannot be read now.

        Raises SdoCommunicationError when the node does not answer.
        """
        try:
            return self.read(index, subindex)
        except SdoAbortedError as error:
            return None if error.code in NOT_THERE else b""

    def number(self, index: int, subindex: int = 0) -> int | None:
        """An unsigned number; None where there is none."""
        data = self.fetch(index, subindex)
        return int.from_bytes(data, "little") if data else None

    def text(self, index: int) -> str:
        """A visible string; empty where there is none."""
        return (self.fetch(index) or b"").decode("latin-1").rstrip("\0 ").strip()
