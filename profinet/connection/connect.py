"""A Connect request, decoded and checked: the sender, the places of all data, the differences from the project.

Source: IEC 61158-6-10 (Connect service, PNIOStatus). Each refusal names block and field. A refused request changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

from pdgw.base.durations import MS, SECOND
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.blocks.connect_blocks import (
    AR_INFO_SHIFT,
    BEST_EFFORT,
    CYCLIC_FRAME_IDS,
    DEVICE_ACCESS,
    FRAME_ID_BY_DEVICE,
    HOLD_MAX_NS,
    IDENT_SHIFT,
    IGNORED_BLOCKS,
    REFUSED_BLOCKS,
    REQUESTS,
    SUBMODULE_STATE,
    TICK_NS,
    AlarmCrBlockReq,
    ArBlockReq,
    ArInfo,
    ArType,
    DiffApi,
    DiffModule,
    DiffSubmodule,
    ExpectedSlot,
    ExpectedSubmodule,
    ExpectedSubmoduleBlockReq,
    IdentInfo,
    IocrApi,
    IocrBlockReq,
    IocrType,
    ModuleDiffBlock,
    ModuleState,
    Place,
    SubmoduleDirection,
)
from pdgw.profinet.model import DeviceModel, Subslot
from pdgw.profinet.rpc.records import CMRPC, PNIO, CallError, PnioStatus
from pdgw.profinet.wire import FIRST_FIELD, Block, BlockLengthError, WireError, number_of, split

CONNECT_ERROR = 0xDB
ARGS_LENGTH, UNKNOWN_BLOCK, IOCR_MISSING, BLOCK_COUNT, NO_AR_FREE, AR_UNKNOWN, WRONG_STATE = CallError
IOPS_SIZE = 1
_IOCR_COUNT = 2
Requested = TypeVar("Requested", bound=Block)


class ConnectRefused(ProfidriveError):  # noqa: N818 (an answer, not a fault of the program)
    """A Connect that is refused, with its PNIO status."""

    def __init__(self, code1: int, code2: int, field: str, value: object, allowed: str) -> None:
        self.status = PnioStatus(CONNECT_ERROR, PNIO, code1, code2)
        super().__init__(field, value, allowed)


def refuse(block: type[Block], path: str, value: object, allowed: str) -> ConnectRefused:
    """The refusal of a field of a block."""
    return ConnectRefused(block.ERROR_CODE1, number_of(block, path), f"{block.__name__}.{path}", value, allowed)


def refuse_call(code2: int, field: str, value: object, allowed: str) -> ConnectRefused:
    """The refusal of the call as a whole."""
    return ConnectRefused(CMRPC, code2, field, value, allowed)


@dataclass(frozen=True, slots=True)
class DataObject:
    """Data of a submodule in the C_SDU; its IOPS follows the data."""

    offset: int
    length: int

    @property
    def iops(self) -> int:
        return self.offset + self.length


@dataclass(frozen=True, slots=True)
class CyclicPlan:
    """One cyclic relationship: offsets count from the first byte of the C_SDU."""

    block: IocrBlockReq
    frame_id: int
    data: Mapping[Subslot, DataObject]
    iocs: Mapping[Subslot, int]


@dataclass(frozen=True, slots=True)
class ConnectPlan:
    """A Connect that can be granted. ``inputs`` and ``outputs`` are None of a device access AR."""

    ar: ArBlockReq
    inputs: CyclicPlan | None
    outputs: CyclicPlan | None
    alarm: AlarmCrBlockReq | None
    expected: tuple[ExpectedSlot, ...]
    proper: frozenset[Subslot]
    """Submodules that are as the project has them."""
    diff: ModuleDiffBlock | None


def plan(arguments: bytes, model: DeviceModel) -> ConnectPlan:
    """Read and check a request; ConnectRefused with the status to answer."""
    blocks = _decode(arguments)
    ar = _only(ArBlockReq, blocks)
    if ar.properties & DEVICE_ACCESS and ar.ar_type != ArType.DEVICE_ACCESS:
        raise refuse(ArBlockReq, "properties", f"{ar.properties:08X}h", "device access requires ARType 6")
    if ar.ar_type == ArType.DEVICE_ACCESS:
        if len(blocks) > 1:
            raise refuse_call(BLOCK_COUNT, "blocks of a device access AR", len(blocks), "the AR block alone")
        return ConnectPlan(ar, None, None, None, (), frozenset(), None)
    relations = [block for block in blocks if isinstance(block, IocrBlockReq)]
    by_type = {block.iocr_type: block for block in relations}
    if len(by_type) < _IOCR_COUNT:
        raise refuse_call(IOCR_MISSING, "IOCRs", sorted(by_type), "an input and an output")
    if len(relations) > _IOCR_COUNT:
        raise refuse_call(BLOCK_COUNT, "IOCRs", len(relations), "one input and one output")
    alarm = _only(AlarmCrBlockReq, blocks)
    slots = tuple(slot for block in blocks if isinstance(block, ExpectedSubmoduleBlockReq) for slot in block.slots)
    if not slots:
        raise refuse_call(BLOCK_COUNT, "expected submodule blocks", 0, "at least one")
    expected = _check_expected(slots)
    inputs = _cyclic(by_type[IocrType.INPUT], expected, model)
    outputs = _cyclic(by_type[IocrType.OUTPUT], expected, model)
    _check_complete(expected, inputs, outputs)
    diff, proper = compare(slots, model)
    return ConnectPlan(ar, inputs, outputs, alarm, slots, proper, diff)


def _decode(arguments: bytes) -> list[Block]:
    parts: list[tuple[int, bytes]] = []
    broken: ConnectRefused | None = None
    try:
        parts.extend(split(arguments))
    except WireError as error:
        # Reported only if the blocks before it are right: after a block that is too short all offsets are wrong.
        broken = _refuse_length(error)
    blocks: list[Block] = []
    # Check the AR block first: an unsupported type of relationship is rejected for its type, not for its further blocks.
    for kind, data in sorted(parts, key=lambda part: part[0] != ArBlockReq.TYPE):
        if kind in REFUSED_BLOCKS:
            raise ConnectRefused(REFUSED_BLOCKS[kind], FIRST_FIELD, "block", f"{kind:04X}h", "no such relationship")
        if kind in IGNORED_BLOCKS:
            continue
        block = REQUESTS.get(kind)
        if block is None:
            raise refuse_call(UNKNOWN_BLOCK, "BlockType", f"{kind:04X}h", "a block of the Connect service")
        try:
            blocks.append(block.decode(data))
        except WireError as error:
            code1 = block.ERROR_CODE1
            raise ConnectRefused(code1, error.number, error.field, error.value, error.allowed) from error
    if broken is not None:
        raise broken
    return blocks


def _refuse_length(error: WireError) -> ConnectRefused:
    known = REQUESTS.get(error.kind) if isinstance(error, BlockLengthError) else None
    if known is None:
        return refuse_call(ARGS_LENGTH, error.field, error.value, error.allowed)
    return ConnectRefused(known.ERROR_CODE1, error.number, error.field, error.value, error.allowed)


def _only(kind: type[Requested], blocks: list[Block]) -> Requested:
    found = [block for block in blocks if isinstance(block, kind)]
    if len(found) != 1:
        raise refuse_call(BLOCK_COUNT, kind.__name__, len(found), "exactly one")
    return found[0]


# -- expected submodules ----------------------------------------------------------------------------------------------

_Expected = dict[Subslot, tuple[int, ExpectedSubmodule]]
"""API and submodule by slot and subslot."""
_DIRECTIONS = {
    SubmoduleDirection.NO_IO: [IocrType.INPUT],
    SubmoduleDirection.INPUT: [IocrType.INPUT],
    SubmoduleDirection.OUTPUT: [IocrType.OUTPUT],
    SubmoduleDirection.INPUT_OUTPUT: [IocrType.INPUT, IocrType.OUTPUT],
}
_PROVIDES = {
    IocrType.INPUT: {SubmoduleDirection.NO_IO, SubmoduleDirection.INPUT, SubmoduleDirection.INPUT_OUTPUT},
    IocrType.OUTPUT: {SubmoduleDirection.OUTPUT, SubmoduleDirection.INPUT_OUTPUT},
}
"""Whose data a relationship carries; it carries the IOCS of the others' data."""
_OPPOSITE = {IocrType.INPUT: IocrType.OUTPUT, IocrType.OUTPUT: IocrType.INPUT}


def _check_expected(slots: Iterable[ExpectedSlot]) -> _Expected:
    block = ExpectedSubmoduleBlockReq
    expected: _Expected = {}
    seen: dict[int, int] = {}
    for slot in slots:
        if seen.setdefault(slot.slot, slot.api) != slot.api:
            raise refuse(block, "slots.slot", slot.slot, "a slot in one API only")
        for submodule in slot.submodules:
            place = (slot.slot, submodule.subslot)
            if place in expected:
                raise refuse(block, "slots.submodules.subslot", submodule.subslot, "each subslot once")
            directions = [item.direction for item in submodule.descriptions]
            if sorted(directions) != [int(item) for item in _DIRECTIONS[submodule.direction]]:
                path = "slots.submodules.descriptions.direction"
                raise refuse(block, path, directions, f"what {submodule.direction.name} says")
            if submodule.direction is SubmoduleDirection.NO_IO and submodule.descriptions[0].length:
                path = "slots.submodules.descriptions.length"
                raise refuse(block, path, submodule.descriptions[0].length, "0 of a submodule without data")
            if submodule.without_status and submodule.direction is not SubmoduleDirection.NO_IO:
                path = "slots.submodules.properties"
                raise refuse(block, path, f"{submodule.properties:04X}h", "DiscardIOXS only without data")
            expected[place] = (slot.api, submodule)
    return expected


def _check_complete(expected: _Expected, inputs: CyclicPlan, outputs: CyclicPlan) -> None:
    plans = {IocrType.INPUT: inputs, IocrType.OUTPUT: outputs}
    for place, (_, submodule) in expected.items():
        # PC Worx omits some submodules without data from its relationships, and devices accept that (captures).
        no_data = submodule.direction is SubmoduleDirection.NO_IO
        if no_data and place not in inputs.data and place not in outputs.iocs:
            continue
        for direction in _DIRECTIONS[submodule.direction]:
            if place not in plans[direction].data or place not in plans[_OPPOSITE[direction]].iocs:
                path = "slots.submodules.subslot"
                raise refuse(ExpectedSubmoduleBlockReq, path, place, "a submodule with data and IOCS in the IOCRs")


# -- cyclic relationships ---------------------------------------------------------------------------------------------


def _cyclic(block: IocrBlockReq, expected: _Expected, model: DeviceModel) -> CyclicPlan:
    cls = IocrBlockReq
    ids = CYCLIC_FRAME_IDS[block.properties]
    frame_id = block.frame_id
    # The inputs may use the same FrameID: the destination of a frame distinguishes them (as in captures).
    if frame_id == FRAME_ID_BY_DEVICE and block.iocr_type == IocrType.OUTPUT:
        frame_id = ids.start
    if frame_id not in ids:
        raise refuse(cls, "frame_id", f"{frame_id:04X}h", f"{ids.start:04X}h..{ids.stop - 1:04X}h")
    if block.send_clock * block.reduction_ratio < model.min_device_interval:
        allowed = f"at least {model.min_device_interval * TICK_NS / MS:g} ms"
        raise refuse(cls, "reduction_ratio", f"update time {block.cycle_ns / MS:g} ms", allowed)
    if not 1 <= block.phase <= block.reduction_ratio:
        raise refuse(cls, "phase", block.phase, f"1..{block.reduction_ratio}")
    if block.frame_send_offset != BEST_EFFORT and block.frame_send_offset >= block.send_clock * TICK_NS:
        allowed = f"less than the send clock of {block.send_clock * TICK_NS} ns, or FFFFFFFFh"
        raise refuse(cls, "frame_send_offset", f"{block.frame_send_offset} ns", allowed)
    if block.hold_ns > HOLD_MAX_NS:
        value = (
            f"{block.hold_ns / SECOND:g} s, which is {block.data_hold} x the update time of {block.cycle_ns / MS:g} ms"
        )
        raise refuse(cls, "data_hold", value, f"at most {HOLD_MAX_NS / SECOND:g} s")
    used = bytearray(block.data_length)
    data: dict[Subslot, DataObject] = {}
    iocs: dict[Subslot, int] = {}
    direction = IocrType(block.iocr_type)
    for api in block.apis:
        if all(api.api != known for known, _ in expected.values()):
            raise refuse(cls, "apis.api", api.api, "an API of the expected submodules")
        if not api.data and not api.iocs:
            raise refuse(cls, "apis.data", 0, "data or IOCS in each API")
        for place, item, submodule in _places(api, "data", expected, data, _PROVIDES[direction]):
            length = submodule.length(direction)
            _occupy(used, "data", item, length + IOPS_SIZE)
            data[place] = DataObject(item.offset, length)
        for place, item, _ in _places(api, "iocs", expected, iocs, _PROVIDES[_OPPOSITE[direction]]):
            _occupy(used, "iocs", item, 1)
            iocs[place] = item.offset
    return CyclicPlan(block, frame_id, data, iocs)


def _places(
    api: IocrApi, which: str, expected: _Expected, seen: Mapping[Subslot, object], allowed: set[SubmoduleDirection]
) -> Iterator[tuple[Subslot, Place, ExpectedSubmodule]]:
    items: tuple[Place, ...] = getattr(api, which)
    for item in items:
        place = (item.slot, item.subslot)
        if all(item.slot != slot or api.api != known for (slot, _), (known, _) in expected.items()):
            raise refuse(IocrBlockReq, f"apis.{which}.slot", item.slot, "a slot of the expected submodules")
        if place not in expected or place in seen or expected[place][1].direction not in allowed:
            path = f"apis.{which}.subslot"
            raise refuse(IocrBlockReq, path, place, "an expected submodule of this direction, once")
        submodule = expected[place][1]
        if not submodule.without_status:
            yield place, item, submodule


def _occupy(used: bytearray, which: str, item: Place, length: int) -> None:
    end = item.offset + length
    if end > len(used) or any(used[item.offset : end]):
        allowed = f"{length} free bytes within the {len(used)} of the frame"
        raise refuse(IocrBlockReq, f"apis.{which}.offset", item.offset, allowed)
    used[item.offset : end] = b"\1" * length


# -- plugged modules --------------------------------------------------------------------------------------------------


def compare(slots: Iterable[ExpectedSlot], model: DeviceModel) -> tuple[ModuleDiffBlock | None, frozenset[Subslot]]:
    """The differences from the project (None: none), and the submodules that match."""
    proper: set[Subslot] = set()
    apis: dict[int, list[DiffModule]] = {}
    for slot in slots:
        module = model.modules.get(slot.slot)
        if module is None or module.api != slot.api:
            entry = DiffModule(slot=slot.slot, ident=0, state=ModuleState.NO_MODULE, submodules=())
            apis.setdefault(slot.api, []).append(entry)
            continue
        right = module.ident == slot.ident
        different = []
        for item in slot.submodules:
            real = module.submodules.get(item.subslot)
            lengths = (item.length(IocrType.INPUT), item.length(IocrType.OUTPUT))
            if real is None:
                info, ident = IdentInfo.NO_SUBMODULE, 0
            elif not right or real.ident != item.ident or (real.inputs, real.outputs) != lengths:
                info, ident = IdentInfo.WRONG, real.ident
            else:
                proper.add((slot.slot, item.subslot))
                continue
            state = SUBMODULE_STATE | info << IDENT_SHIFT | ArInfo.OWN << AR_INFO_SHIFT
            different.append(DiffSubmodule(subslot=item.subslot, ident=ident, state=state))
        if different or not right:
            state = ModuleState.PROPER if right else ModuleState.WRONG
            entry = DiffModule(slot=slot.slot, ident=module.ident, state=state, submodules=tuple(different))
            apis.setdefault(slot.api, []).append(entry)
    if not apis:
        return None, frozenset(proper)
    entries = tuple(DiffApi(api=api, modules=tuple(modules)) for api, modules in apis.items())
    return ModuleDiffBlock(apis=entries), frozenset(proper)
