"""The controller's project of a device (modules, cycle, start-up), and the Connect request made from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from uuid import UUID

from pdgw.profidrive.frame import C_SDU_MIN
from pdgw.profinet.blocks import connect_blocks
from pdgw.profinet.connection.connect import CyclicPlan, DataObject
from pdgw.profinet.model import Module, Submodule, Subslot
from pdgw.profinet.wire import Block

INPUT_FRAME_ID = 0x8001
INPUT_REFERENCE, OUTPUT_REFERENCE = 1, 2
ALARM_REFERENCE = 0x0042


@dataclass(frozen=True)
class Layout:
    """Offsets of data and IOCS in the C_SDU of one relationship."""

    length: int
    data: Mapping[Subslot, DataObject]
    iocs: Mapping[Subslot, int]


def _direction(submodule: Submodule) -> connect_blocks.SubmoduleDirection:
    return connect_blocks.SubmoduleDirection((1 if submodule.inputs else 0) | (2 if submodule.outputs else 0))


def provides(submodule: Submodule, kind: connect_blocks.IocrType) -> bool:
    """Whether a relationship has this submodule's data and IOPS. A submodule without data counts as an input."""
    direction = _direction(submodule)
    if kind is connect_blocks.IocrType.OUTPUT:
        return direction in {connect_blocks.SubmoduleDirection.OUTPUT, connect_blocks.SubmoduleDirection.INPUT_OUTPUT}
    return direction is not connect_blocks.SubmoduleDirection.OUTPUT


@dataclass(frozen=True)
class Project:
    """``send_clock`` in 31.25 us. The cycle is ``send_clock`` x ``reduction_ratio``. ``data_hold``: number of cycles."""

    station_name: str
    modules: Mapping[int, Module]
    send_clock: int = 32
    reduction_ratio: int = 4
    data_hold: int = 3
    advanced: bool = True
    rt_class: connect_blocks.RtClass = connect_blocks.RtClass.RT_CLASS_1
    activity_timeout: int = 200
    records: Sequence[tuple[int, int, int, int, bytes]] = field(default=())
    """Written before PrmEnd: API, slot, subslot, index, data."""

    @property
    def submodules(self) -> dict[Subslot, Submodule]:
        return {
            (slot, subslot): item
            for slot, module in self.modules.items()
            for subslot, item in module.submodules.items()
        }

    def layout(self, kind: connect_blocks.IocrType, order: Sequence[Subslot] | None = None, gap: int = 0) -> Layout:
        """Place the data objects in this order with ``gap`` unused bytes before each, then the IOCS."""
        submodules = self.submodules
        places = list(submodules) if order is None else list(order)
        offset = 0
        data: dict[Subslot, DataObject] = {}
        iocs: dict[Subslot, int] = {}
        for place in places:
            item = submodules[place]
            if provides(item, kind):
                offset += gap
                data[place] = DataObject(offset, item.inputs if kind is connect_blocks.IocrType.INPUT else item.outputs)
                offset = data[place].iops + 1
        other = (
            connect_blocks.IocrType.OUTPUT if kind is connect_blocks.IocrType.INPUT else connect_blocks.IocrType.INPUT
        )
        for place in places:
            if provides(submodules[place], other):
                iocs[place] = offset + gap
                offset += gap + 1
        return Layout(max(offset, C_SDU_MIN), data, iocs)

    def ar(self, ar_uuid: UUID, session: int, mac: bytes, initiator: UUID, name: str) -> connect_blocks.ArBlockReq:
        return connect_blocks.ArBlockReq(
            ar_type=connect_blocks.ArType.IO,
            ar_uuid=ar_uuid,
            session_key=session,
            initiator_mac=mac,
            initiator_object=initiator,
            properties=connect_blocks.ACTIVE_BY_INITIATOR | (connect_blocks.ADVANCED_STARTUP if self.advanced else 0),
            activity_timeout=self.activity_timeout,
            rt_port=connect_blocks.LT_RT,
            station_name=name,
        )

    def iocr(self, kind: connect_blocks.IocrType, layout: Layout) -> connect_blocks.IocrBlockReq:
        apis = sorted({module.api for module in self.modules.values()})

        def items(api: int, offsets: Mapping[Subslot, int]) -> tuple[connect_blocks.Place, ...]:
            return tuple(
                connect_blocks.Place(slot=slot, subslot=subslot, offset=offset)
                for (slot, subslot), offset in offsets.items()
                if self.modules[slot].api == api
            )

        data = {place: item.offset for place, item in layout.data.items()}
        used = tuple(
            connect_blocks.IocrApi(api=api, data=items(api, data), iocs=items(api, layout.iocs)) for api in apis
        )
        first = INPUT_FRAME_ID if self.rt_class is connect_blocks.RtClass.RT_CLASS_1 else 0xC001
        return connect_blocks.IocrBlockReq(
            iocr_type=kind,
            reference=INPUT_REFERENCE if kind is connect_blocks.IocrType.INPUT else OUTPUT_REFERENCE,
            lt=connect_blocks.LT_RT,
            properties=self.rt_class,
            data_length=layout.length,
            frame_id=first if kind is connect_blocks.IocrType.INPUT else connect_blocks.FRAME_ID_BY_DEVICE,
            send_clock=self.send_clock,
            reduction_ratio=self.reduction_ratio,
            phase=1,
            sequence=0,
            frame_send_offset=connect_blocks.BEST_EFFORT,
            watchdog=self.data_hold,
            data_hold=self.data_hold,
            tag=connect_blocks.TAG_RT,
            multicast_mac=bytes(6),
            apis=tuple(item for item in used if item.data or item.iocs),
        )

    def expected(self) -> list[connect_blocks.ExpectedSubmoduleBlockReq]:
        """One block for each slot, as real controllers do."""
        return [
            connect_blocks.ExpectedSubmoduleBlockReq(
                slots=(
                    connect_blocks.ExpectedSlot(
                        api=module.api,
                        slot=slot,
                        ident=module.ident,
                        properties=0,
                        submodules=tuple(
                            _expected(subslot, submodule) for subslot, submodule in module.submodules.items()
                        ),
                    ),
                )
            )
            for slot, module in self.modules.items()
        ]

    def alarm(self) -> connect_blocks.AlarmCrBlockReq:
        return connect_blocks.AlarmCrBlockReq(
            cr_type=1,
            lt=connect_blocks.LT_RT,
            properties=0,
            rta_timeout=1,
            rta_retries=3,
            reference=ALARM_REFERENCE,
            max_length=200,
            tag_high=connect_blocks.TAG_HIGH,
            tag_low=connect_blocks.TAG_LOW,
        )

    def blocks(self, ar: connect_blocks.ArBlockReq) -> list[Block]:
        """The blocks of a Connect request."""
        return [
            ar,
            self.iocr(connect_blocks.IocrType.INPUT, self.layout(connect_blocks.IocrType.INPUT)),
            self.iocr(connect_blocks.IocrType.OUTPUT, self.layout(connect_blocks.IocrType.OUTPUT)),
            *self.expected(),
            self.alarm(),
        ]

    def plan(self, kind: connect_blocks.IocrType, frame_id: int) -> CyclicPlan:
        """The cyclic plan of the controller's own protocol machines."""
        layout = self.layout(kind)
        return CyclicPlan(self.iocr(kind, layout), frame_id, layout.data, layout.iocs)


def _expected(subslot: int, submodule: Submodule) -> connect_blocks.ExpectedSubmodule:
    direction = _direction(submodule)
    lengths = []
    if direction is not connect_blocks.SubmoduleDirection.OUTPUT:
        lengths.append((connect_blocks.IocrType.INPUT, submodule.inputs))
    if submodule.outputs:
        lengths.append((connect_blocks.IocrType.OUTPUT, submodule.outputs))
    return connect_blocks.ExpectedSubmodule(
        subslot=subslot,
        ident=submodule.ident,
        properties=direction,
        descriptions=tuple(
            connect_blocks.DataDescription(direction=kind, length=length, length_iocs=1, length_iops=1)
            for kind, length in lengths
        ),
    )
