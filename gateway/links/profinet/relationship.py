"""What the PROFINET link takes of one relationship: its data, the orders in them, its limits; dropped with it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from pdgw.base.durations import MS
from pdgw.gateway.base.reasons import Finding, Reason
from pdgw.gateway.configuration.environment import TransportConfig
from pdgw.gateway.links.cyclic import control_mask
from pdgw.gateway.links.profinet import findings
from pdgw.gateway.links.profinet.ethernet import EthernetPort
from pdgw.gateway.links.profinet.pairing import LONGEST_NS, Pairing
from pdgw.profidrive.telegrams import Telegram
from pdgw.profinet.connection.application_relation import ApplicationRelation
from pdgw.profinet.connection.cpm import Consumer
from pdgw.profinet.connection.ppm import Provider
from pdgw.profinet.model import TELEGRAM_SUBSLOT, Module

log = logging.getLogger("gateway")

_SHORTEST_WATCHDOG: Final = 2
"""Cycles: the gateway reads in each cycle, at a time that varies."""


class Places:
    """The place of input data and IOPS of each drive object in the frames of a relationship, and its IOPS."""

    def __init__(self, relation: ApplicationRelation, provider: Provider, telegrams: Sequence[Telegram]) -> None:
        self.relation = relation
        self._provider = provider
        self._telegrams = telegrams
        self.data = [provider.place((slot, TELEGRAM_SUBSLOT)) for slot in range(1, len(telegrams) + 1)]
        self.good: list[bool | None] = [None] * len(telegrams)

    def fill(self, actuals: Sequence[Sequence[int]], good: Sequence[bool]) -> None:
        """Set the input data of the drive objects, and their IOPS."""
        provider, statuses = self._provider, self.good
        for index, telegram in enumerate(self._telegrams):
            place = self.data[index]
            if place is not None:
                telegram.actuals.struct.pack_into(provider.frame, place[0], *actuals[index])
                if statuses[index] is not good[index]:
                    statuses[index] = good[index]
                    provider.set_status((index + 1, TELEGRAM_SUBSLOT), good=good[index])


class InputLayout:
    """The telegrams of the drive objects until others are set, and the input data in them."""

    def __init__(self, telegrams: Sequence[Telegram]) -> None:
        self.telegrams = list(telegrams)
        self.newest: tuple[Sequence[Sequence[int]], Sequence[bool]] | None = None
        """Actual values of the last step and whether they are valid: what a new relationship begins with."""
        self.places: Places | None = None
        """In the frames to the controller, while there is a relationship."""


class Reception:
    """Setpoints come: from the first ones until the axes have seen their loss."""

    def __init__(self) -> None:
        self.loss = ""
        """Why they are lost, while the axes have not seen it: until then no setpoints count. Empty: they are not."""


def _order_mask(consumer: Consumer, telegrams: Sequence[Telegram]) -> int:
    """The bits of a frame from its FrameID on that are orders: all but the cycle counter, setpoints and signs of life."""
    mask = bytearray([0xFF]) * consumer.size
    mask[consumer.trailer : consumer.trailer + 2] = bytes(2)
    for index, telegram in enumerate(telegrams):
        where = consumer.place((index + 1, TELEGRAM_SUBSLOT))
        orders = control_mask(telegram.setpoints)
        if where is not None and where[1] - where[0] == len(orders):
            mask[where[0] : where[1]] = orders
    return int.from_bytes(mask, "big")


class Relationship:
    """What the link takes of one relationship, from Connected to Disconnected."""

    def __init__(
        self,
        relation: ApplicationRelation,
        consumer: Consumer,
        provider: Provider,
        port: EthernetPort,
        transport: TransportConfig,
        telegrams: Sequence[Telegram],
        modules: Mapping[int, Module],
    ) -> None:
        cycle = provider.cycle_ns / MS
        self._cycle_ms = cycle
        self.text = f"controller {relation.plan.ar.station_name} {relation.source[0]} connected, cycle {cycle:g} ms"
        """For log and events."""
        self.consumer = consumer
        """Data of the controller."""
        self._differences = findings.differences(relation.plan.expected, modules)
        """Of the controller's project, by slot."""
        self.outputs: list[tuple[int, Callable[[bytes, int], tuple[int, ...]], int, int]] = []
        """Drive objects with output data: number, codec, places of data and IOPS in the consumer's frame."""
        for index, telegram in enumerate(telegrams):
            place = (index + 1, TELEGRAM_SUBSLOT)
            where = consumer.place(place) if place in relation.plan.proper else None
            if where is not None:
                self.outputs.append((index, telegram.setpoints.struct.unpack_from, *where))
        self._order_mask = _order_mask(consumer, telegrams)
        self.ordered = int.from_bytes(consumer.payload, "big") & self._order_mask
        """All bits of a frame that are orders, and the orders of the newest one."""
        short = consumer.cycle_ns == provider.cycle_ns <= LONGEST_NS
        self.pairing = Pairing(port, provider) if short else None
        """None: two cycles, or a long one."""
        self.limit_ns = transport.watchdog_factor * consumer.cycle_ns
        cycles = max(transport.watchdog_factor, _SHORTEST_WATCHDOG)
        self.held_up_ns = cycles * max(int(transport.cycle_time_ms * MS), consumer.cycle_ns)
        """If the port was not read for longer, the frames in it are not used, and the PLC is lost."""

    def warn(self, cycle_time_ms: float) -> None:
        """Log how the controller's project differs from the configuration; ``cycle_time_ms``: that of the configuration."""
        if self._cycle_ms < cycle_time_ms:
            log.warning("the controller's cycle time is shorter than cycle_time_ms = %g", cycle_time_ms)
        for text in self._differences.values():
            log.warning("%s", text)

    def is_changed(self, relation: ApplicationRelation | None) -> bool:
        """Whether orders of the newest frame differ from those of the frame before it, or it is one of another ``relation``."""
        consumer = self.consumer
        if relation is None or relation.consumer is not consumer:
            return True
        before = self.ordered
        self.ordered = int.from_bytes(consumer.payload, "big") & self._order_mask
        return self.ordered != before

    def finding(
        self, relation: ApplicationRelation, now: int, missing: int | None, *, receivable: bool
    ) -> Finding | None:
        """Why data of the controller does not count. ``missing``: a drive object without setpoints, counted from 0;
        ``receivable``: data has come since the last loss."""
        if not receivable:
            if (found := findings.of_frames(relation, now, self.limit_ns >> 1)) is not None:
                return found
        elif not self.consumer.running:
            return Finding.of(Reason.PLC_STOP)
        if missing is None:
            return None
        if all(missing != known for known, *_ in self.outputs):
            return findings.of_differences(self._differences, missing + 1)
        return Finding.of(Reason.PLC_BAD) if receivable else None
