"""Cyclic data of a submodule as records: what the device last sent and received.

Source: IEC 61158-6-10 (RecordInputDataObjectElement, RecordOutputDataObjectElement, SubstituteValue), as tshark reads them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pdgw.profinet.wire import Block, rest, u8, u16

if TYPE_CHECKING:
    from pdgw.profinet.connection.application_relation import ApplicationRelation
    from pdgw.profinet.model import Subslot

_SUBSTITUTE_ZERO = 0


@dataclass(frozen=True, kw_only=True)
class InputData(Block):
    """Input data with the controller's consumer status and the device's provider status."""

    TYPE: ClassVar[int] = 0x0015
    length_iocs: int = u8(default=1)
    iocs: int = u8()
    length_iops: int = u8(default=1)
    iops: int = u8()
    length: int = u16()
    data: bytes = rest()


@dataclass(frozen=True, kw_only=True)
class SubstituteValue(Block):
    """What the device uses in place of output data that does not count; ``content``: IOCS, data, IOPS."""

    TYPE: ClassVar[int] = 0x0014
    mode: int = u16(default=_SUBSTITUTE_ZERO)
    content: bytes = rest()


@dataclass(frozen=True, kw_only=True)
class OutputData(Block):
    """Output data; ``content``: IOCS, data, IOPS, then a ``SubstituteValue``. ``substitute``: 1 while the data does not count."""

    TYPE: ClassVar[int] = 0x0016
    substitute: int = u16()
    length_iocs: int = u8(default=1)
    length_iops: int = u8(default=1)
    length: int = u16()
    content: bytes = rest()


def input_data(relation: ApplicationRelation, place: Subslot) -> bytes | None:
    """The record 8028h; None of a submodule without input data in this relationship."""
    provider, consumer = relation.provider, relation.consumer
    if provider is None or consumer is None:
        return None
    where, iocs = provider.place(place), consumer.iocs(place)
    if where is None or iocs is None:
        return None
    offset, iops = where
    data = bytes(provider.frame[offset:iops])
    return InputData(iocs=iocs, iops=provider.frame[iops], length=len(data), data=data).encode()


def output_data(relation: ApplicationRelation, place: Subslot) -> bytes | None:
    """The record 8029h; None of a submodule without output data in this relationship."""
    provider, consumer = relation.provider, relation.consumer
    if provider is None or consumer is None:
        return None
    where, iocs = consumer.place(place), provider.iocs(place)
    if where is None or iocs is None:
        return None
    offset, iops = where
    data, status = consumer.payload[offset:iops], consumer.payload[iops : iops + 1]
    substitute = SubstituteValue(content=bytes((iocs,)) + bytes(len(data)) + status).encode()
    return OutputData(
        substitute=int(consumer.output(place) is None),
        length=len(data),
        content=bytes((iocs,)) + data + status + substitute,
    ).encode()
