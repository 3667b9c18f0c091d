"""Everything the web process knows of its gateway: newest status, events, fault counts, loads of the buses."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter

from pdgw.base.durations import MS_PER_SECOND
from pdgw.ds301.bus.load import DEFAULT_BITRATE, bus_load, frame_bits
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.service.status_client import fetch, fetch_events, fetch_explanation, fetch_faults
from pdgw.tools.web.status.events import EventLog
from pdgw.tools.web.status.feed import ANSWER_WITHIN_S, Document, Feed

log = logging.getLogger("gateway")

_LOAD_OVER_S = 1.0
"""Minimum time for the mean of a measured load."""


def counter(document: Document, part: str, name: str) -> int | None:
    """A counter of the gateway; None where that part has no such counter."""
    for item in document["counters"]:
        if item["part"] == part and item["name"] == name:
            return int(item["value"])
    return None


class BusLoads:
    """Planned load of each bus, in the worst case, and the measured one: frames counted by the gateway, times their mean bits."""

    def __init__(self, config: GatewayConfig) -> None:
        self._bitrates = {bus.name: bus.bitrate or DEFAULT_BITRATE for bus in config.can}
        self._bits: dict[str, float] = {}
        self.planned: dict[str, float] = {}
        for bus in config.can:
            frames = config.frames_of(bus)
            self.planned[bus.name] = bus_load(frames, self._bitrates[bus.name])
            rate = sum(frame.per_second for frame in frames)
            bits = sum(frame_bits(frame.size, worst=False) * frame.per_second for frame in frames)
            self._bits[bus.name] = bits / rate if rate else frame_bits(8, worst=False)
        self.measured: dict[str, float] = {}
        self._since: tuple[float, dict[str, int]] | None = None

    def take(self, document: Document) -> None:
        """The next status."""
        uptime = document["uptime_s"]
        counts = {
            name: (counter(document, f"bus {name}", "sent") or 0) + (counter(document, f"bus {name}", "received") or 0)
            for name in self._bits
        }
        if self._since is not None:
            begin, before = self._since
            if 0 <= uptime - begin < _LOAD_OVER_S:
                return
            if uptime > begin:
                self.measured = {
                    name: max(0, counts[name] - before[name]) * bits / (uptime - begin) / self._bitrates[name]
                    for name, bits in self._bits.items()
                }
        self._since = (uptime, counts)


class StatusPort:
    """A gateway on this machine, by its status port. Requests run on a thread; GatewayError when it does not answer."""

    def __init__(self, port: int) -> None:
        self._port = port

    def status(self) -> Document:
        """``gateway.service.status.snapshot``."""
        return fetch(self._port, ANSWER_WITHIN_S)

    def events(self, number: int) -> list[Document]:
        """Its events after this number, the oldest first."""
        return fetch_events(self._port, number, ANSWER_WITHIN_S)

    def faults(self, do_id: int) -> list[Document]:
        """All its faults of a drive object."""
        return fetch_faults(self._port, do_id, ANSWER_WITHIN_S)

    def explanation(self, do_id: int | None) -> list[Document]:
        """The lines around the last fault or stop, of a drive object or of all."""
        return fetch_explanation(self._port, do_id, ANSWER_WITHIN_S)


class Watch:
    """One gateway."""

    def __init__(self, config: GatewayConfig, gateway: StatusPort) -> None:
        self.config = config
        self.log = EventLog(int(time.time() * MS_PER_SECOND))
        self.loads = BusLoads(config)
        self.fault_counts: Counter[tuple[int, int]] = Counter()
        """Faults by DO-ID and number, of the events since this process began and of those that the gateway had then."""
        self._last_event = 0
        self._gateway = gateway
        self.feed = Feed(lambda: asyncio.to_thread(gateway.status), self._take)

    async def _take(self, document: Document) -> None:
        if document["last_event"] != self._last_event:
            # Also those after the status, which the next one finds entered.
            for event in await asyncio.to_thread(self._gateway.events, self._last_event):
                self._last_event = event["number"]
                self.log.add(event["time"], event["kind"], event["do_id"], event["text"])
                if event["kind"] == "fault":
                    self.fault_counts[event["do_id"], event["fault"]] += 1
        self.loads.take(document)
        for bus in document["buses"]:
            bus["load_planned"] = self.loads.planned.get(bus["name"])
            bus["load_measured"] = self.loads.measured.get(bus["name"])

    async def faults(self, do_id: int) -> list[Document]:
        """The history of a drive object, newest first; GatewayError when the gateway does not answer."""
        return await asyncio.to_thread(self._gateway.faults, do_id)

    async def explanation(self, do_id: int | None) -> list[Document]:
        """The lines around the last fault or stop; GatewayError when the gateway does not answer."""
        return await asyncio.to_thread(self._gateway.explanation, do_id)

    @property
    def document(self) -> Document | None:
        """The status, unless it is old."""
        return None if self.feed.stale else self.feed.document

    @property
    def ready(self) -> bool:
        """All nodes are online, a PLC is connected."""
        document = self.document
        if document is None:
            return False
        objects = (*document["axes"], *document["encoders"])
        return bool(document["plc"]["connected"]) and all(item["drive"] == "online" for item in objects)
