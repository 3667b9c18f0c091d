"""A client and a simulated encoder on one bus."""

from __future__ import annotations

from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.node.node import NodeNotice, NodeStatus
from pdgw.dsp406.encoder import EncoderClient
from pdgw.dsp406.kinds import ROTARY, EncoderDevice
from pdgw.dsp406.settings import EncoderSettings
from pdgw.peers.encoder import Motion, SimulatedEncoder
from tests.support.gateways import site

NODE = 9
DAY = 86_400_000_000_000


class Plant:
    """A client and a simulated encoder on one bus."""

    def __init__(self, network: CanNetwork) -> None:
        self.network = network
        self.events: list[NodeNotice] = []
        self.encoder: SimulatedEncoder | None = None
        self.client: EncoderClient | None = None

    def power_on(self, *motions: Motion, device: EncoderDevice = ROTARY) -> SimulatedEncoder:
        self.encoder = site.encoder(NODE, device=device, motions=motions)
        return self.encoder

    def connect(self, **settings: object) -> EncoderClient:
        values: dict[str, object] = {"node_id": NODE, "sdo_timeout_ms": 200, "tpdo_event_ms": 10, **settings}
        # Nothing here is about being late: a busy machine must not lose the encoder.
        values.setdefault("tpdo_timeout_factor", 100)
        values.setdefault("heartbeat_factor", 50)
        self.client = EncoderClient(self.network, EncoderSettings(**values), self.events.append)  # type: ignore[arg-type]
        self.client.start()
        return self.client

    def online(self, generation: int = 1) -> EncoderClient:
        client = self.client
        assert client is not None
        site.wait_for(
            lambda: client.status is NodeStatus.ONLINE and client.generation == generation,
            f"online ({client.status_text})",
        )
        return client

    def close(self) -> None:
        if self.client is not None:
            self.client.stop()
        if self.encoder is not None:
            self.encoder.stop()


def fresh(client: EncoderClient) -> EncoderClient:
    """With the newest values in the feedback."""
    client.refresh(DAY)
    return client
