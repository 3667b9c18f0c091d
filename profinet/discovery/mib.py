"""What the SNMP agent shows: MIB-II, LLDP-MIB, LLDP-EXT-DOT3-MIB and LLDP-EXT-PNO-MIB, as engineering tools read a topology.

Source: RFC 1213, IEEE 802.1AB (LLDP-MIB), IEC 61158-6-10 (LLDP-EXT-PNO-MIB). One row is one object; the port is number 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from pdgw.profinet.discovery import lldp
from pdgw.profinet.discovery.snmp import Kind, Oid, Variable
from pdgw.profinet.station import Neighbour, Station

_SYSTEM: Final[Oid] = (1, 3, 6, 1, 2, 1, 1)
_INTERFACES: Final[Oid] = (1, 3, 6, 1, 2, 1, 2)
_LLDP: Final[Oid] = (1, 0, 8802, 1, 1, 2, 1)
_DOT3: Final[Oid] = (*_LLDP, 5, 4623, 1)
_PNO: Final[Oid] = (*_LLDP, 5, 3791, 1)
_ZERO_DOT_ZERO: Final[Oid] = (0, 0)
_PORT: Final = 1
_PORT_FIRST: Final = b"\x80"
"""BITS: port 1."""
_END_HOST = 72
"""sysServices: end-to-end and application."""
_ETHERNET = 6
_MTU = 1500
_IPV4 = 1
_IF_INDEX = 2
_LOCALLY_ASSIGNED = 7
_TRUE, _FALSE = 1, 2
_MBIT: Final = 1_000_000
_SPEEDS: Final = {10: 10, 11: 10, 15: 100, 16: 100, 29: 1000, 30: 1000}
"""Mbit/s by MAU type; a faster one is shown as the largest number."""
_FASTEST: Final = 0xFFFFFFFF
_TICK_NS: Final = 10_000_000


SYS_CONTACT: Final[Oid] = (*_SYSTEM, 4, 0)
SYS_NAME: Final[Oid] = (*_SYSTEM, 5, 0)
SYS_LOCATION: Final[Oid] = (*_SYSTEM, 6, 0)


def objects(station: Station, octets: Sequence[int], system: Mapping[Oid, str], uptime_ns: int) -> list[Variable]:
    """Everything that can be read, sorted. ``octets``: received and sent; ``system``: texts of the system group."""
    rows = [*_system(station, system, uptime_ns), *_interface(station, octets), *_local(station)]
    if station.neighbour is not None:
        rows += _remote(station.neighbour)
    return sorted(Variable(oid, kind, value) for oid, kind, value in rows)


Row = tuple[Oid, Kind, int | bytes | Oid]


def _text(text: str) -> bytes:
    return text.encode("latin-1", "replace")[:255]


def _system(station: Station, system: Mapping[Oid, str], uptime_ns: int) -> list[Row]:
    return [
        ((*_SYSTEM, 1, 0), Kind.OCTETS, _text(station.identity.chassis)),
        ((*_SYSTEM, 2, 0), Kind.OID, _ZERO_DOT_ZERO),
        ((*_SYSTEM, 3, 0), Kind.TIME_TICKS, uptime_ns // _TICK_NS & 0xFFFFFFFF),
        (SYS_CONTACT, Kind.OCTETS, _text(system.get(SYS_CONTACT, ""))),
        (SYS_NAME, Kind.OCTETS, _text(system.get(SYS_NAME) or station.name)),
        (SYS_LOCATION, Kind.OCTETS, _text(system.get(SYS_LOCATION, ""))),
        ((*_SYSTEM, 7, 0), Kind.INTEGER, _END_HOST),
    ]


def _interface(station: Station, octets: Sequence[int]) -> list[Row]:
    mbit = _SPEEDS.get(station.medium.mau_type)
    speed = (_FASTEST if mbit is None and station.medium.mau_type else (mbit or 0) * _MBIT) if station.link_up else 0
    up = 1 if station.link_up else 2
    received, sent = (count & 0xFFFFFFFF for count in octets)
    columns: list[tuple[int, Kind, int | bytes]] = [
        (1, Kind.INTEGER, _PORT),
        (2, Kind.OCTETS, _text(station.port)),
        (3, Kind.INTEGER, _ETHERNET),
        (4, Kind.INTEGER, _MTU),
        (5, Kind.GAUGE, speed),
        (6, Kind.OCTETS, station.identity.mac),
        (7, Kind.INTEGER, 1),
        (8, Kind.INTEGER, up),
        (10, Kind.COUNTER, received),
        (16, Kind.COUNTER, sent),
    ]
    table = (*_INTERFACES, 2, 1)
    return [
        ((*_INTERFACES, 1, 0), Kind.INTEGER, 1),
        *(((*table, column, _PORT), kind, value) for column, kind, value in columns),
    ]


def _local(station: Station) -> list[Row]:
    subtype, chassis = _LOCALLY_ASSIGNED, _text(lldp.chassis_id(station))
    address = (_IPV4, 4, *station.ip.address.packed)
    medium, local, manage = station.medium, (*_LLDP, 3), (*_LLDP, 3, 8, 1)
    dot3, pno = (*_DOT3, 2, 1, 1), (*_PNO, 2, 1, 1)
    return [
        ((*_LLDP, 1, 7, 1, 1, *address), Kind.OCTETS, _PORT_FIRST),
        ((*local, 1, 0), Kind.INTEGER, subtype),
        ((*local, 2, 0), Kind.OCTETS, chassis),
        ((*local, 3, 0), Kind.OCTETS, _text(station.name)),
        ((*local, 4, 0), Kind.OCTETS, _text(station.identity.chassis)),
        ((*local, 7, 1, 2, _PORT), Kind.INTEGER, _LOCALLY_ASSIGNED),
        ((*local, 7, 1, 3, _PORT), Kind.OCTETS, _text(lldp.port_id(station))),
        ((*local, 7, 1, 4, _PORT), Kind.OCTETS, _text(station.port)),
        ((*manage, 3, *address), Kind.INTEGER, len(address) - 1),
        ((*manage, 4, *address), Kind.INTEGER, _IF_INDEX),
        ((*manage, 5, *address), Kind.INTEGER, station.interface_index),
        ((*manage, 6, *address), Kind.OID, _ZERO_DOT_ZERO),
        ((*dot3, 1, _PORT), Kind.INTEGER, _TRUE if medium.autonegotiation & 1 else _FALSE),
        ((*dot3, 2, _PORT), Kind.INTEGER, _TRUE if medium.autonegotiation & 2 else _FALSE),
        ((*dot3, 3, _PORT), Kind.OCTETS, medium.advertised.to_bytes(2, "big")),
        ((*dot3, 4, _PORT), Kind.INTEGER, medium.mau_type),
        *(((*pno, delay, _PORT), Kind.GAUGE, 0) for delay in (1, 2, 3)),
        *(((*pno, status, _PORT), Kind.INTEGER, 0) for status in (4, 5)),
        ((*pno, 6, _PORT), Kind.OCTETS, _text(station.name)),
    ]


def _remote(neighbour: Neighbour) -> list[Row]:
    """Index of a row: time mark, local port, number of the neighbour."""
    row, table, manage, pno = (0, _PORT, 1), (*_LLDP, 4, 1, 1), (*_LLDP, 4, 2, 1), (*_PNO, 3, 1, 1)
    rows: list[Row] = [
        ((*table, 4, *row), Kind.INTEGER, neighbour.chassis[0]),
        ((*table, 5, *row), Kind.OCTETS, neighbour.chassis[1:256]),
        ((*table, 6, *row), Kind.INTEGER, neighbour.port[0]),
        ((*table, 7, *row), Kind.OCTETS, neighbour.port[1:256]),
        ((*pno, 6, *row), Kind.OCTETS, _text(neighbour.alias.partition(".")[2])),
    ]
    if neighbour.management:
        address = (*row, _IPV4, 4, *neighbour.management[:4])
        rows += [
            ((*manage, 3, *address), Kind.INTEGER, neighbour.management[4]),
            ((*manage, 4, *address), Kind.INTEGER, int.from_bytes(neighbour.management[5:], "big")),
            ((*manage, 5, *address), Kind.OID, _ZERO_DOT_ZERO),
        ]
    return rows
