"""The decoder of whole captures: packets of both buses in, records out, without I/O.

    >>> decoder = Decoder(Settings(axes=given_axes([1])))
    >>> for packet in capture:
    ...     record = decoder.decode(packet)

One instance follows one capture: it remembers what was learned (telegrams, PDO mappings, transfers, states). Memory does not
grow with the capture.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from pdgw.ds301.bus.can_frame import STANDARD_ID
from pdgw.dsp402.identification.overlay import NO_CHOICE, Families
from pdgw.profidrive.frame import CYCLIC_PORT, ETHERTYPE
from pdgw.profidrive.telegrams import TELEGRAMS, Telegram
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.tools.decoder.frames.canopen.can_records import CanRecord
from pdgw.tools.decoder.frames.canopen.decoder import CanopenDecoder, Dictionary
from pdgw.tools.decoder.frames.link import UDP_PROTOCOL, CanFrame, Carried, socketcan, unwrap
from pdgw.tools.decoder.frames.profinet.acyclic import AcyclicDecoder, is_profinet_call
from pdgw.tools.decoder.frames.profinet.connect import StationNames
from pdgw.tools.decoder.frames.profinet.cyclic import CyclicDecoder
from pdgw.tools.decoder.frames.profinet.frame_telegrams import Axis, given_axes
from pdgw.tools.decoder.frames.profinet.frames import FRAME_IDS, FrameDecoder
from pdgw.tools.decoder.frames.records import LinkType, OtherRecord, Record

__all__ = ["Axis", "CanPacket", "Decoder", "Packet", "Settings", "given_axes"]


class Packet(NamedTuple):
    """A captured packet: ``link`` is the link type of ``data``, ``channel`` the name of the interface."""

    number: int
    time_ns: int
    link: int
    channel: str
    data: bytes


class CanPacket(NamedTuple):
    """A CAN frame of a CAN log."""

    number: int
    time_ns: int
    channel: str
    frame: CanFrame


@dataclass(frozen=True)
class Settings:
    """Known facts before decoding; everything has a default.

    ``axes``: the axes of the cyclic frames in their order, with node-IDs if known. ``origin``: source of this knowledge.
    ``station``: PROFINET station whose frames are decoded if several have telegrams; empty for the first one. ``dictionary``:
    EDS/DCF entries by node-ID. Ports: UDP ports of cyclic frames and RPC packets (PROFINET calls are recognised by their
    interface on every port).
    """

    axes: Sequence[Axis] = ()
    origin: str = "configuration"
    dictionary: Dictionary | None = None
    cyclic_ports: frozenset[int] = frozenset({CYCLIC_PORT})
    acyclic_ports: frozenset[int] = frozenset({ACYCLIC_PORT})
    station: str = ""
    telegrams: Mapping[int, Telegram] = field(default_factory=lambda: TELEGRAMS)
    """Those known by number, the user's own among them."""
    families: Families = NO_CHOICE
    """Those of drives, the user's own among them."""


@dataclass
class Decoder:
    """Stateful decoder of one capture."""

    settings: Settings = field(default_factory=Settings)
    notices: list[str] = field(default_factory=list)
    """Notes for the user (an inferred telegram); the owner removes them."""

    def __post_init__(self) -> None:
        names = StationNames()
        settings = self.settings
        self._cyclic = CyclicDecoder(
            settings.axes, self.notices.append, settings.station, settings.telegrams, settings.families
        )
        self._acyclic = AcyclicDecoder(self._cyclic, names)
        self._frames = FrameDecoder(names, self._acyclic.relations.between)
        self._buses: dict[str, CanopenDecoder] = {}

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The axes known at present."""
        return self._cyclic.axes

    @property
    def inferred(self) -> tuple[Axis, ...]:
        """The axes as the frames alone show them."""
        return self._cyclic.inferred

    @property
    def inference(self) -> str:
        """The source of ``inferred``, for the user; empty if it is not known."""
        return self._cyclic.inference

    @property
    def sure(self) -> bool:
        """Whether ``inferred`` is final because enough frames were checked."""
        return self._cyclic.sure

    def decode(self, packet: Packet | CanPacket) -> Record:
        """The record of a packet. Never raises for what a packet contains."""
        if isinstance(packet, CanPacket):
            return self.decode_can(*packet)
        return self.decode_packet(*packet)

    def decode_packet(self, number: int, time_ns: int, link: int, channel: str, data: bytes) -> Record:
        """As ``decode``, for a packet with a link layer."""
        if link == LinkType.ETHERNET and len(data) > _UDP_END:
            kind, version, fragment, protocol, sport, dport, length = _ETHERNET_UDP.unpack_from(data)
            if kind == _PLAIN_IPV4 and version == _PLAIN_HEADER and protocol == UDP_PROTOCOL and not fragment & 0x3FFF:
                ports = self.settings.cyclic_ports
                end = _UDP_BEGIN + length
                if (dport in ports or sport in ports) and _UDP_END < end <= len(data):
                    return self._cyclic.decode(number, time_ns, channel, data[_UDP_END:end])
            elif kind == ETHERTYPE:
                return self._real_time(number, time_ns, channel, data[_ETHERNET:], data[:_MACS])
        elif link == LinkType.CAN_SOCKETCAN:
            return self._socketcan(number, time_ns, channel, data)
        return self._general(number, time_ns, link, channel, data)

    def decode_can(self, number: int, time_ns: int, channel: str, frame: CanFrame) -> Record:
        """As ``decode``, for a CAN frame."""
        bus = self._buses.get(channel) or self._bus(channel)
        if frame.extended or frame.remote or frame.error:
            return bus.decode_special(number, time_ns, channel, frame)
        return bus.decode(number, time_ns, channel, frame.cob_id, frame.data)

    def _bus(self, channel: str) -> CanopenDecoder:
        settings = self.settings
        axes = [axis for axis in settings.axes if axis.bus in {"", channel}]
        bus = self._buses[channel] = CanopenDecoder(
            axes, settings.dictionary, settings.origin, settings.telegrams, settings.families
        )
        return bus

    def _socketcan(self, number: int, time_ns: int, channel: str, data: bytes) -> Record:
        if len(data) >= _SOCKETCAN.size:
            identifier, length = _SOCKETCAN.unpack_from(data)
            if identifier <= STANDARD_ID and _SOCKETCAN.size + length <= len(data):
                bus = self._buses.get(channel) or self._bus(channel)
                return bus.decode(number, time_ns, channel, identifier, data[8 : 8 + length])
        frame = socketcan(data)
        if isinstance(frame, str):
            return CanRecord(number, time_ns, channel, data, 0, 0, frame)
        return self.decode_can(number, time_ns, channel, frame)

    def _real_time(self, number: int, time_ns: int, channel: str, data: bytes, addresses: bytes) -> Record:
        frame_id = data[0] << 8 | data[1] if len(data) > 1 else 0
        if frame_id in FRAME_IDS:
            return self._frames.real_time((number, time_ns, channel, data), frame_id, addresses)
        return self._cyclic.decode(number, time_ns, channel, data, addresses)

    def _general(self, number: int, time_ns: int, link: int, channel: str, data: bytes) -> Record:
        payload = unwrap(link, data)
        addresses = data[:_MACS] if link == LinkType.ETHERNET else b""
        if payload.carried is Carried.RT:
            return self._real_time(number, time_ns, channel, payload.data, addresses)
        if payload.carried is Carried.LLDP:
            return self._frames.lldp((number, time_ns, channel, payload.data), addresses)
        if payload.carried is Carried.CAN:
            return self._socketcan(number, time_ns, channel, payload.data)
        if payload.carried is Carried.UDP:
            ports = {payload.source[1], payload.destination[1]}
            if ports & self.settings.cyclic_ports:
                return self._cyclic.decode(number, time_ns, channel, payload.data)
            peers = frozenset((payload.source[0], payload.destination[0]))
            if ports & self.settings.acyclic_ports or is_profinet_call(payload.data):
                return self._acyclic.decode(number, time_ns, channel, payload.data, peers)
            text = f"UDP port {payload.source[1]} -> {payload.destination[1]}, {len(payload.data)} bytes"
            return OtherRecord(number, time_ns, channel, payload.data, text=text)
        return OtherRecord(number, time_ns, channel, data, text=payload.text)


_ETHERNET_UDP = struct.Struct(">12xHBxxxxxHxB10xHHH")
"""EtherType, IP version and header length, fragment word, protocol, ports and UDP length of a plain packet."""
_PLAIN_IPV4 = 0x0800
_PLAIN_HEADER = 0x45
_UDP_BEGIN = 34
_UDP_END = 42
_ETHERNET = 14
_MACS = 12
"""Destination and source."""
_SOCKETCAN = struct.Struct(">IBxxx")
