"""CANopen: every frame of one bus to a record.

Source: CiA DS 301 V4.02 chapters 7.2 and 7.3.3 (pre-defined connection set), docs/translation.md (PDO layouts). The mapping of
a PDO is taken from SDO transfers seen on the bus, else from the gateway's configuration, else from the EDS/DCF of the node.
Left out: MPDOs, LSS beyond its name, servers other than the default SDO, heartbeats on other COB-IDs.
"""

from __future__ import annotations

import datetime
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from pdgw.base.durations import MS
from pdgw.ds301.aborts import abort_text
from pdgw.ds301.bus.can_frame import STANDARD_ID
from pdgw.ds301.communication import (
    DEVICE_NAME,
    DEVICE_TYPE,
    ERROR_CONTROL,
    HEARTBEAT_STATE,
    IDENTITY_PRODUCT,
    IDENTITY_VENDOR,
    LSS_REQUEST,
    LSS_RESPONSE,
    NMT,
    SDO_REQUEST,
    SDO_RESPONSE,
    SYNC,
    TIME,
    NmtCommand,
    NmtState,
)
from pdgw.ds301.emcy import emcy_text, error_register_text
from pdgw.ds301.objects import Entry
from pdgw.ds301.pdo import COB_ID_INVALID, PDO_PARAMETERS, PDOS_MAX, PdoDirection, is_mapping_parameter, pdo_of
from pdgw.ds301.sdo_frames import FRAME_SIZE
from pdgw.dsp402.identification.overlay import NO_CHOICE, Families, Overlay, entries_of
from pdgw.dsp402.pdo.layouts import with_objects
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode, Telegram, telegram
from pdgw.tools.decoder.frames.canopen.can_records import (
    CanRecord,
    EmcyRecord,
    HeartbeatRecord,
    NmtRecord,
    PdoLayout,
    PdoRecord,
    SdoRecord,
    SyncRecord,
    TimeRecord,
)
from pdgw.tools.decoder.frames.canopen.objects import (
    Mapped,
    ObjectNames,
    any_drive,
    encoder_catalogue,
    pdo_layout,
    profile_catalogue,
)
from pdgw.tools.decoder.frames.canopen.sdo import SdoChannel, Step
from pdgw.tools.decoder.frames.fields import Raw
from pdgw.tools.decoder.frames.link import CanFrame
from pdgw.tools.decoder.frames.profinet.frame_telegrams import Axis
from pdgw.tools.decoder.frames.records import Record

Dictionary = Callable[[int], Sequence[Entry] | None]
"""The EDS/DCF entries of a node-ID, None if none was given; defaults contain the node's own COB-IDs."""

LSS: Final = {LSS_RESPONSE: "LSS response", LSS_REQUEST: "LSS request"}
_NODE = 0x7F
_SDO_HEAD: Final = 4
"""Command byte, index and subindex."""
_MAX_MAPPED = 64
_OBSERVED = "observed"
_DAY_ZERO = datetime.date(1984, 1, 1)
_EMCY = struct.Struct("<HB")
_TIME = struct.Struct("<IH")
_ERROR_CLASSES = {
    0x01: "transmit timeout",
    0x02: "lost arbitration",
    0x04: "controller problem",
    0x08: "protocol violation",
    0x10: "transceiver status",
    0x20: "no acknowledge",
    0x40: "bus-off",
    0x80: "bus error",
    0x100: "controller restarted",
}
"""Bits of a SocketCAN error frame's identifier (linux/can/error.h)."""


_FAMILY_OBJECTS: Final = (IDENTITY_VENDOR, IDENTITY_PRODUCT, (DEVICE_NAME, 0))
"""Vendor-ID, product code and name of a device."""


@dataclass(slots=True)
class _Node:
    """Known facts of one node."""

    known: Families
    names: ObjectNames
    axis: int = 0
    has_dictionary: bool = False
    sdo: SdoChannel = field(default_factory=SdoChannel)
    state: int | None = None
    parameters: dict[tuple[int, int], int] = field(default_factory=dict)
    """PDO parameters as seen in SDO transfers or given by the EDS."""
    origins: dict[int, str] = field(default_factory=dict)
    """Source of the mapping, by mapping parameter index."""
    cob_ids: dict[int, int] = field(default_factory=dict)
    """COB-ID in force by communication parameter index."""
    vendor_id: int | None = None
    product_code: int = 0
    name: str = ""

    @property
    def families(self) -> tuple[Overlay, ...]:
        """The families of drives it may be of."""
        return self.known.possible(self.vendor_id, self.product_code, self.name)

    def identify(self, index: int, subindex: int, value: int | float | bytes | str | None) -> None:
        """A value that identifies the family."""
        if index == DEVICE_NAME:
            self.name = value if isinstance(value, str) else ""
        elif isinstance(value, int) and subindex == 1:
            self.vendor_id = value
        elif isinstance(value, int):
            self.product_code = value
        self.names = self.names.of(self.families)


class CanopenDecoder:
    """The nodes of one bus. ``axes`` with a node-ID have the gateway's PDO layouts; ``origin`` says who gave them."""

    def __init__(
        self,
        axes: Sequence[Axis] = (),
        dictionary: Dictionary | None = None,
        origin: str = "configuration",
        telegrams: Mapping[int, Telegram] = TELEGRAMS,
        families: Families = NO_CHOICE,
    ) -> None:
        self._dictionary = dictionary
        self._families = families
        self._telegrams = telegrams
        self._nodes: dict[int, _Node] = {}
        self._pdos: dict[int, PdoLayout] = {}
        self._axes = {axis.node: axis for axis in axes if axis.node}
        self._origin = origin
        for node_id in self._axes:
            self._node(node_id)

    def _node(self, node_id: int) -> _Node:
        """The node, made when it is first seen."""
        known = self._nodes.get(node_id)
        if known is not None:
            return known
        node = self._nodes[node_id] = _Node(self._families, any_drive(self._families))
        entries = self._dictionary(node_id) if self._dictionary else None
        if entries is not None:
            node.names, node.has_dictionary = ObjectNames(entries, self._families.known), True
            for entry in entries:
                if (entry.index, entry.subindex) in _FAMILY_OBJECTS:
                    node.identify(entry.index, entry.subindex, entry.default)
            self._use_dictionary(node_id, node, entries)
        axis = self._axes.get(node_id)
        if axis is not None:
            node.axis = axis.do_id
            chosen = telegram(axis.telegram, self._telegrams)
            if chosen.mode is not ApplicationMode.ENCODER:
                self._use_layouts(node_id, node, chosen)
            elif not node.has_dictionary:
                node.names = encoder_catalogue()
        return node

    # -- one frame -------------------------------------------------------------------------------------------------

    def decode(self, number: int, time_ns: int, channel: str, cob_id: int, data: bytes) -> Record:
        """The record of a standard data frame."""
        layout = self._pdos.get(cob_id)
        if layout is not None:
            if len(data) >= layout.size:
                return PdoRecord(number, time_ns, channel, data, cob_id, layout.node, layout=layout)
            text = f"{layout.name} of {len(data)} bytes is shorter than its mapping, {layout.size} bytes"
            return CanRecord(number, time_ns, channel, data, cob_id, layout.node, text)
        return self._service(number, time_ns, channel, cob_id, data)

    def decode_special(self, number: int, time_ns: int, channel: str, frame: CanFrame) -> Record:
        """The record of an extended, remote or error frame."""
        if frame.error:
            classes = [text for bit, text in _ERROR_CLASSES.items() if frame.cob_id & bit]
            text = f"error frame: {', '.join(classes) or 'unknown'}"
            return CanRecord(number, time_ns, channel, frame.data, frame.cob_id, 0, text)
        if frame.extended:
            text = f"extended identifier {frame.cob_id:08X}h: not CANopen"
            return CanRecord(number, time_ns, channel, frame.data, frame.cob_id, 0, text)
        node_id = frame.cob_id & _NODE
        what = "node guarding request" if frame.cob_id & ~_NODE == ERROR_CONTROL else "remote request"
        return CanRecord(number, time_ns, channel, frame.data, frame.cob_id, node_id, what)

    def _service(self, number: int, time_ns: int, channel: str, cob_id: int, data: bytes) -> Record:
        node_id, function = cob_id & _NODE, cob_id & ~_NODE
        base = (number, time_ns, channel, data, cob_id)
        if cob_id == NMT:
            return _nmt(base, data)
        if cob_id == SYNC:
            return SyncRecord(*base, text=f"counter {data[0]}" if data else "", counter=data[0] if data else None)
        if cob_id == TIME:
            return _time(base, data)
        if cob_id in LSS:
            return CanRecord(*base, 0, LSS[cob_id])
        if not node_id:
            return CanRecord(*base)
        if function == SYNC:
            return _emcy(base, node_id, data, self._node(node_id).names)
        if function == ERROR_CONTROL:
            return self._heartbeat(base, node_id, data)
        if function in {SDO_REQUEST, SDO_RESPONSE}:
            return self._sdo(base, node_id, function == SDO_REQUEST, data)
        name = _predefined_pdo(function)
        if not name:
            return CanRecord(*base)
        if node_id not in self._nodes:
            self._node(node_id)
            if cob_id in self._pdos:
                return self.decode(*base[:3], cob_id, data)
        return CanRecord(*base, node_id, f"{name}, mapping unknown")

    # -- services --------------------------------------------------------------------------------------------------

    def _heartbeat(self, base: _Base, node_id: int, data: bytes) -> Record:
        if len(data) != 1:
            return CanRecord(*base, node_id, f"heartbeat of {len(data)} bytes")
        node = self._node(node_id)
        state = data[0] & HEARTBEAT_STATE
        previous, node.state = node.state, state
        text = _state_name(state)
        if previous is not None and previous != state:
            text = f"{_state_name(previous)} -> {text}"
        if state == NmtState.BOOT_UP:
            node.sdo = SdoChannel()
        return HeartbeatRecord(*base, node_id, text, state=state, previous=previous)

    def _sdo(self, base: _Base, node_id: int, from_client: bool, data: bytes) -> Record:
        wrong = "" if len(data) == FRAME_SIZE else f"SDO frame of {len(data)} bytes, expected {FRAME_SIZE}"
        # A shortened request typed by hand (cansend 601#2B4060000600): most drives accept it, so show its content.
        if wrong and not (from_client and _SDO_HEAD <= len(data) < FRAME_SIZE):
            return CanRecord(*base, node_id, wrong)
        node = self._node(node_id)
        step = node.sdo.feed(from_client, data.ljust(FRAME_SIZE, b"\0"), base[1])
        index, subindex = step.index, step.subindex
        decoded = None
        name = ""
        if index is not None and subindex is not None:
            name = node.names.name(index, subindex)
            if step.value is not None:
                decoded = node.names.decode(index, subindex, step.value)
                if step.completes:
                    self._learn(node_id, node, index, subindex, step.value, decoded)
        return SdoRecord(
            *base,
            node_id,
            _sdo_text(step, name, node.names) + (f" ({wrong})" if wrong else ""),
            step=step.name,
            from_client=from_client,
            index=index,
            subindex=subindex,
            name=name,
            value=step.value,
            decoded=decoded,
            abort=step.abort,
            latency_ns=step.latency_ns,
        )

    # -- PDO mappings ----------------------------------------------------------------------------------------------

    def _use_layouts(self, node_id: int, node: _Node, chosen: Telegram) -> None:
        """The gateway's own layouts for a telegram of drives."""
        from pdgw.gateway.axis.telegrams import drive_layout  # noqa: PLC0415 (loads canopen, for given axes only)

        layouts = with_objects(drive_layout(chosen), {e.attribute: e for e in entries_of(node.families).values()})
        for pdo in (*layouts.rpdos, *layouts.tpdos):
            if pdo.number <= 4 or node_id <= 0x3F:
                node.parameters[pdo.communication_index, 1] = pdo.cob_id(node_id)
                node.parameters[pdo.mapping_index, 0] = len(pdo.entries)
                for subindex, entry in enumerate(pdo.entries, 1):
                    node.parameters[pdo.mapping_index, subindex] = entry.mapping
                node.origins[pdo.mapping_index] = self._origin
                self._rebuild(node_id, node, pdo.mapping_index)

    def _use_dictionary(self, node_id: int, node: _Node, entries: Sequence[Entry]) -> None:
        for entry in entries:
            if entry.index in PDO_PARAMETERS and isinstance(entry.default, int):
                node.parameters[entry.index, entry.subindex] = entry.default
                node.origins[entry.index] = "EDS"
        for mapping in {entry.index for entry in entries if entry.subindex == 0}:
            if is_mapping_parameter(mapping):
                self._rebuild(node_id, node, mapping)

    def _learn(self, node_id: int, node: _Node, index: int, subindex: int, value: bytes, decoded: Raw | str) -> None:
        """Learn from an object that was read or written: profile from the device type, family from the identity, mapping
        from PDO parameters."""
        if (index, subindex) == (DEVICE_TYPE, 0) and not node.has_dictionary:
            node.names = profile_catalogue(int.from_bytes(value, "little"), node.families) or node.names
        if (index, subindex) in _FAMILY_OBJECTS:
            before = node.names
            node.identify(index, subindex, decoded)
            if node.names is not before:
                for mapping in tuple(node.origins):
                    self._rebuild(node_id, node, mapping)
        if index not in PDO_PARAMETERS or len(value) not in {1, 2, 4}:
            return
        node.parameters[index, subindex] = int.from_bytes(value, "little")
        mapping = index if is_mapping_parameter(index) else index + PDOS_MAX
        if index == mapping:
            node.origins[mapping] = _OBSERVED
        if (index == mapping and subindex == 0) or (index != mapping and subindex == 1):
            self._rebuild(node_id, node, mapping)

    def _rebuild(self, node_id: int, node: _Node, mapping: int) -> None:
        """Update one PDO's layout from its known parameters."""
        direction, number = pdo_of(mapping)
        communication = mapping - PDOS_MAX
        before = node.cob_ids.pop(communication, None)
        if before is not None:
            self._pdos.pop(before, None)
        default = direction.bases[number - 1] + node_id if number <= 4 else COB_ID_INVALID
        cob_id = node.parameters.get((communication, 1), default if before is None else before)
        count = node.parameters.get((mapping, 0), 0)
        objects = [node.parameters.get((mapping, sub)) for sub in range(1, min(count, _MAX_MAPPED) + 1)]
        mapped = [Mapped.from_parameter(value) for value in objects if value is not None]
        if cob_id & COB_ID_INVALID or not count or len(mapped) != count:
            return
        name = f"{direction.name}{number}"
        layout = pdo_layout(name, node_id, node.axis, mapped, node.names, node.origins.get(mapping, _OBSERVED))
        if layout is not None:
            identifier = cob_id & STANDARD_ID
            node.cob_ids[communication] = identifier
            self._pdos[identifier] = layout


_Base = tuple[int, int, str, bytes, int]


def _predefined_pdo(function: int) -> str:
    for direction in PdoDirection:
        if function in direction.bases[:4]:
            return f"{direction.name}{direction.bases.index(function) + 1}"
    return ""


def _state_name(state: int) -> str:
    return NmtState(state).name.replace("_", "-").lower() if state in set(NmtState) else f"state {state:02X}h"


def _nmt(base: _Base, data: bytes) -> Record:
    if len(data) != 2:
        return CanRecord(*base, 0, f"NMT command of {len(data)} bytes, expected 2")
    command, node_id = data
    known = command in set(NmtCommand)
    text = NmtCommand(command).name.replace("_", " ").lower() if known else f"unknown command {command:02X}h"
    return NmtRecord(*base, node_id, f"{text}, {f'node {node_id}' if node_id else 'all nodes'}", command=command)


def _time(base: _Base, data: bytes) -> Record:
    if len(data) != _TIME.size:
        return CanRecord(*base, 0, f"TIME of {len(data)} bytes, expected {_TIME.size}")
    milliseconds, days = _TIME.unpack(data)
    milliseconds &= 0x0FFFFFFF
    moment = datetime.datetime.combine(_DAY_ZERO, datetime.time()) + datetime.timedelta(days, milliseconds=milliseconds)
    return TimeRecord(*base, 0, moment.isoformat(" ", "milliseconds"), milliseconds=milliseconds, days=days)


def _emcy(base: _Base, node_id: int, data: bytes, names: ObjectNames) -> Record:
    if len(data) != 8:
        return CanRecord(*base, node_id, f"EMCY of {len(data)} bytes, expected 8")
    code, register = _EMCY.unpack_from(data)
    fault = names.emcy_text(code)
    text = f"{code:04X}h {emcy_text(code)}" + (f" (drive: {fault})" if fault else "")
    text += f", register {register:02X}h: {error_register_text(register)}"
    if any(data[3:]):
        text += f", {data[3:].hex(' ')}"
    return EmcyRecord(*base, node_id, text, code=code, register=register, manufacturer=data[3:])


def _sdo_text(step: Step, name: str, names: ObjectNames) -> str:
    parts = [step.name]
    if step.index is not None and step.subindex is not None:
        parts.append(f"{step.index:04X}h.{step.subindex}" + (f" {name}" if name else ""))
        if step.value is not None:
            parts.append(f"= {names.text(step.index, step.subindex, step.value)}")
    if step.abort is not None:
        parts.append(abort_text(step.abort))
    if step.note:
        parts.append(f"({step.note})")
    if step.latency_ns is not None:
        parts.append(f"after {step.latency_ns / MS:.3f} ms")
    return " ".join(parts)
