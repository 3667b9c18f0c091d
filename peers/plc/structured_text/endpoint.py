"""The endpoint of a PLC whose Structured Text program writes and reads the frames."""

from __future__ import annotations

from pdgw.peers.plc.exchange.endpoint import Exchange
from pdgw.peers.plc.structured_text.controller import Controller


class ProgramEndpoint(Exchange):
    """Runs the program once for each frame to send. It uses no telegram definition."""

    def __init__(self, controller: Controller) -> None:
        super().__init__(())
        self.controller = controller
        self._newest: bytes | None = None

    def build(self, now: int | None = None) -> bytearray:
        self.counters["sent"] += 1
        frame, self._newest = self.controller.cycle(now or 0, self._newest), None
        return bytearray(frame)

    def poll(self, now: int) -> bool:
        """The program itself handles the loss of the gateway."""
        return False

    def receive(self, data: bytes, now: int = 0) -> bool:
        self.counters["received"] += 1
        self._newest = data
        return True
