"""What a PLC's endpoint exchanges with a device over an IO controller: the data of telegrams, without UDP frames."""

from __future__ import annotations

from pdgw.peers.controller.controller import IoController
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.frame import STATUS_NORMAL, STATUS_STOP
from pdgw.profinet.model import TELEGRAM_SUBSLOT


class ControllerExchange:
    """Drive objects are in slots 1, 2 ... in the order of the endpoint's telegrams."""

    def __init__(self, endpoint: PlcEndpoint, controller: IoController) -> None:
        self.endpoint = endpoint
        self.controller = controller
        self._places = [(slot, TELEGRAM_SUBSLOT) for slot in range(1, len(endpoint.telegrams) + 1)]

    def take(self, now: int) -> None:
        """Give the endpoint the device's newest data."""
        actuals = [self._decoded(index, self.controller.input(place)) for index, place in enumerate(self._places)]
        self.endpoint.accept(actuals, [self.controller.uses(place) for place in self._places], now)

    def _decoded(self, index: int, data: bytes | None) -> tuple[int, ...] | None:
        """None for data that is not GOOD, or of another telegram."""
        half = self.endpoint.telegrams[index].actuals
        return None if data is None or len(data) != half.size else half.decode(data)

    def send(self) -> None:
        """Set what the controller sends from now on. Nothing without a connection."""
        endpoint, provider = self.endpoint, self.controller.provider
        if provider is None:
            return
        provider.data_status = STATUS_NORMAL if endpoint.run else STATUS_STOP
        endpoint.count_sign_of_life()
        for index, place in enumerate(self._places):
            data = endpoint.telegrams[index].setpoints.encode(tuple(endpoint.setpoints[index].values()))
            where = provider.place(place)
            if where is not None and where[1] - where[0] == len(data):  # not of another telegram
                provider.set(place, data, good=index not in endpoint.bad)
