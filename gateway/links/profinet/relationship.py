"""What the PROFINET link takes of one relationship: its data, the orders in them, its limits; dropped with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from pdgw.base.durations import MS
from pdgw.gateway.configuration.environment import TransportConfig
from pdgw.gateway.links.cyclic import control_mask
from pdgw.gateway.links.profinet.ethernet import EthernetPort
from pdgw.gateway.links.profinet.pairing import LONGEST_NS, Pairing
from pdgw.profidrive.telegrams import Telegram
from pdgw.profinet.connection.application_relation import ApplicationRelation
from pdgw.profinet.connection.cpm import Consumer
from pdgw.profinet.connection.ppm import Provider
from pdgw.profinet.model import TELEGRAM_SUBSLOT

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
    ) -> None:
        self.consumer = consumer
        """Data of the controller."""
        self.differences: dict[int, str] = {}
        """Of the controller's project, by slot."""
        self.outputs: list[tuple[int, Callable[[bytes, int], tuple[int, ...]], int, int]] = []
        """Drive objects with output data: number, codec, places of data and IOPS in the consumer's frame."""
        for index, telegram in enumerate(telegrams):
            place = (index + 1, TELEGRAM_SUBSLOT)
            where = consumer.place(place) if place in relation.plan.proper else None
            if where is not None:
                self.outputs.append((index, telegram.setpoints.struct.unpack_from, *where))
        self.order_mask = _order_mask(consumer, telegrams)
        self.ordered = int.from_bytes(consumer.payload, "big") & self.order_mask
        """All bits of a frame that are orders, and the orders of the newest one."""
        short = consumer.cycle_ns == provider.cycle_ns <= LONGEST_NS
        self.pairing = Pairing(port, provider) if short else None
        """None: two cycles, or a long one."""
        self.limit_ns = transport.watchdog_factor * consumer.cycle_ns
        cycles = max(transport.watchdog_factor, _SHORTEST_WATCHDOG)
        self.held_up_ns = cycles * max(int(transport.cycle_time_ms * MS), consumer.cycle_ns)
        """If the port was not read for longer, the frames in it are not used, and the PLC is lost."""
