"""PROFINET frames beside the cyclic ones: DCP, alarms, LLDP.

Source: IEC 61158-6-10 (DCP-PDU, RTA-PDU), IEEE 802.1AB, by the declarations of ``profinet``. Names of stations are kept for
other parts. PTCP and fragments are only named.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.alarms.apmx import ALARM_FRAME_IDS, PDU, PduType
from pdgw.profinet.blocks.alarm import NOTIFICATIONS, AlarmType, Priority
from pdgw.profinet.connection.cmdev import ABORT_TEXTS, AbortCode
from pdgw.profinet.discovery import dcp, lldp
from pdgw.profinet.discovery.dcp import Option, Service, ServiceType, SetError
from pdgw.profinet.rpc.records import PnioStatus
from pdgw.profinet.station import IpSuite
from pdgw.profinet.wire import HEADER
from pdgw.tools.decoder.frames.fields import BoundedDict, Document, name_in
from pdgw.tools.decoder.frames.profinet.blocks import DIAGNOSES, diagnoses, documents, place_text
from pdgw.tools.decoder.frames.profinet.connect import AlarmRecord, Connection, DcpRecord, LldpRecord, StationNames
from pdgw.tools.decoder.frames.records import Base, OtherRecord, Record

_HELLO: Final = 0xFEFC
_DCP_IDS: Final = frozenset({_HELLO, dcp.FRAME_ID_GET_SET, dcp.FRAME_ID_IDENTIFY, dcp.FRAME_ID_IDENTIFY_RESPONSE})
_PRIORITIES: Final = {frame_id: priority for priority, frame_id in ALARM_FRAME_IDS.items()}
FRAME_IDS: Final = _DCP_IDS | _PRIORITIES.keys()
"""FrameIDs read here."""
_NAMES: Final = {
    **dict.fromkeys((0x0020, 0x0021, 0x0080, 0x0081), "PTCP, synchronisation"),
    **dict.fromkeys(range(0x0100, 0x1000), "a cyclic frame of RT class 3 (IRT), not decoded"),
    **dict.fromkeys((0xFF00, 0xFF01), "PTCP, announcement"),
    **dict.fromkeys((0xFF20, 0xFF21), "PTCP, follow-up of a synchronisation"),
    **dict.fromkeys(range(0xFF40, 0xFF44), "PTCP, measurement of a line's delay"),
    **dict.fromkeys(range(0xFF80, 0xFF90), "a fragment of a larger frame"),
}
"""Names of other frames by FrameID."""
_OPTIONS: Final = {option.value: option for option in Option}
_MACS_SIZE: Final = 12
_U16: Final = 2
_IP_SUITE_SIZE: Final = len(IpSuite().encode())
_PDU_TYPE_MASK: Final = 0x0F
_NOTIFICATION_TYPES: Final = frozenset(cls.TYPE for cls in NOTIFICATIONS.values())


def named_frame(frame_id: int) -> str:
    """Name of a frame that is neither cyclic nor decoded here."""
    return _NAMES.get(frame_id, "not a cyclic frame")


class FrameDecoder:
    """All such frames of a capture. ``between`` finds the relationship of frames with a destination and source."""

    def __init__(self, names: StationNames, between: Callable[[bytes], Connection | None]) -> None:
        self._names = names
        self._between = between
        self._asked: BoundedDict[tuple[bytes, int], int] = BoundedDict()
        self._sent: BoundedDict[tuple[Priority, bytes, int], int] = BoundedDict()

    def real_time(self, base: Base, frame_id: int, addresses: bytes) -> Record:
        """A frame from its FrameID on, one of ``FRAME_IDS``. ``addresses``: destination and source, empty where not known."""
        try:
            if frame_id in _PRIORITIES:
                return self._alarm(base, _PRIORITIES[frame_id], addresses)
            return self._dcp(base, frame_id, addresses)
        except ProfidriveError as error:
            return OtherRecord(*base, text=f"damaged PROFINET frame, FrameID {frame_id:04X}h: {error}")

    # -- DCP ----------------------------------------------------------------------------------------------------------

    def _dcp(self, base: Base, frame_id: int, addresses: bytes) -> Record:
        _, time_ns, _, data = base
        if len(data) < dcp.HEADER.size:
            raise ProfidriveError("DCP frame", f"{len(data)} bytes", f"at least {dcp.HEADER.size}")
        _, service, kind, xid, _, length = dcp.HEADER.unpack_from(data)
        content = data[dcp.HEADER.size : dcp.HEADER.size + length]
        if len(content) < length:
            raise ProfidriveError("DCPDataLength", length, f"at most {len(content)}")
        request = kind == ServiceType.REQUEST
        name = "hello" if frame_id == _HELLO else name_in(Service, service, f"service {service}")
        answered = "request" if request else "response" if kind == ServiceType.SUCCESS else "not supported"
        if request and service == Service.GET:
            parts: list[Document] = [_asked(content[at : at + _U16]) for at in range(0, length - 1, _U16)]
        else:
            # Blocks of an Identify request have no BlockInfo; all others start with one word of it.
            bare = request and service == Service.IDENTIFY and frame_id != _HELLO
            parts = [self._option(code, value, bare=bare) for code, value in dcp.split(content)]
        if addresses and (not request or frame_id == _HELLO):
            announced = next(
                (part["value"] for part in parts if part["option"] == Option.NAME.name and "value" in part), None
            )
            if announced is not None:
                self._names.learn(addresses[6:], announced)
        fields = self._head(addresses) | {
            "frame_id": frame_id,
            "service": name,
            "packet": answered,
            "xid": xid,
            "blocks": parts,
        }
        latency = None
        if request:
            self._asked.put((addresses[6:], xid), time_ns)
        else:
            asked = self._asked.get((addresses[:6], xid))
            latency = None if asked is None else max(0, time_ns - asked)
        said = ", ".join(part["text"] for part in parts)
        text = f"{name} {answered}" if frame_id != _HELLO else name
        return DcpRecord(*base, f"{self._from(addresses)}DCP {text}" + (f": {said}" if said else ""), fields, latency)

    def _option(self, code: tuple[int, int], content: bytes, *, bare: bool) -> Document:
        option = _OPTIONS.get(code)
        label = _label(code)
        if len(content) < _U16 and not bare:
            raise ProfidriveError("DCPBlockLength", len(content), f"at least {_U16}")
        if option is Option.RESPONSE:
            of, error = (content[0], content[1]), content[2] if len(content) > _U16 else None
            done = name_in(SetError, error, f"error {error}")
            return {"option": label, "of": _label(of), "error": error, "text": f"{_label(of).lower()} {done}"}
        document: Document = {"option": label}
        value = content
        if not bare:
            document["info"] = int.from_bytes(content[:_U16], "big")  # BlockInfo or BlockQualifier
            value = content[_U16:]
        shown = _value(option, value)
        document["value"] = shown
        return document | {"text": f"{label.lower().replace('_', ' ')} {shown}".rstrip()}

    # -- alarms -------------------------------------------------------------------------------------------------------

    def _alarm(self, base: Base, priority: Priority, addresses: bytes) -> Record:
        _, time_ns, _, data = base
        if len(data) < PDU.size:
            raise ProfidriveError("alarm PDU", f"{len(data)} bytes", f"at least {PDU.size}")
        frame_id, destination, source, kind, flags, sequence, ack, length = PDU.unpack_from(data)
        content = data[PDU.size : PDU.size + length]
        if len(content) < length:
            raise ProfidriveError("VarPartLen", length, f"at most {len(content)}")
        kind &= _PDU_TYPE_MASK
        name = PduType(kind).name if kind in set(PduType) else f"type {kind}"
        fields = self._head(addresses) | {
            "frame_id": frame_id,
            "priority": priority.value,
            "pdu": name.lower(),
            "destination_reference": destination,
            "source_reference": source,
            "flags": flags,
            "send_sequence": sequence,
            "ack_sequence": ack,
        }
        text, latency, slot = f"{self._from(addresses)}alarm {priority.value} {name}", None, 0
        ended, is_notification = None, False
        if kind == PduType.DATA:
            self._sent.put((priority, addresses, sequence), time_ns)
            fields["blocks"] = blocks = _notification(content)
            text += f": {'; '.join(_block_text(block) for block in blocks)}"
            slot = blocks[0].get("slot", 0) if blocks else 0
            is_notification = any(block.get("type") in _NOTIFICATION_TYPES for block in blocks)
        elif kind == PduType.ERR:
            status = PnioStatus.of(int.from_bytes(content[:4], "big"))
            fields["status"] = {"raw": status.value, "text": _abort_text(status)}
            text += f": ends the relationship, {_abort_text(status)}"
            ended = self._between(addresses)
        else:
            asked = self._sent.get((priority, addresses[6:] + addresses[:6], ack))
            latency = None if asked is None else max(0, time_ns - asked)
        return AlarmRecord(*base, text, fields, latency, slot=slot, is_notification=is_notification, ended=ended)

    # -- LLDP ---------------------------------------------------------------------------------------------------------

    def lldp(self, base: Base, addresses: bytes) -> Record:
        """A frame after EtherType 88CCh."""
        number, time_ns, channel, data = base
        try:
            # The codec of the device reads whole Ethernet frames.
            found = lldp.decode(addresses.ljust(_MACS_SIZE, b"\0") + data, _MACS_SIZE, time_ns)
        except ProfidriveError as error:
            return OtherRecord(number, time_ns, channel, data, text=f"damaged LLDP frame: {error}")
        fields = self._head(addresses) | {
            "chassis_id": found.chassis_id,
            "port_id": found.port_id,
            "lifetime_s": found.lifetime_ns // SECOND,
        }
        return LldpRecord(*base, f"{self._from(addresses)}LLDP port {found.port_id} of {found.chassis_id}", fields)

    # -- sender -------------------------------------------------------------------------------------------------------

    def _head(self, addresses: bytes) -> Document:
        if not addresses:
            return {}
        return {"source": addresses[6:].hex(":"), "destination": addresses[:6].hex(":")}

    def _from(self, addresses: bytes) -> str:
        return f"{self._names.shown(addresses[6:])}: " if addresses else ""


def _label(code: tuple[int, int]) -> str:
    option = _OPTIONS.get(code)
    return f"{code[0]}/{code[1]}" if option is None else option.name


def _asked(code: bytes) -> Document:
    label = _label((code[0], code[1]))
    return {"option": label, "text": label.lower().replace("_", " ")}


def _value(option: Option | None, value: bytes) -> str:
    """The content of a DCP block as text."""
    match option:
        case Option.NAME | Option.VENDOR | Option.ALIAS:
            return value.decode("latin-1")
        case Option.MAC:
            return value.hex(":")
        case Option.IP if len(value) >= _IP_SUITE_SIZE:
            suite = IpSuite.decode(value)
            return f"{suite.address} mask {suite.mask} gateway {suite.gateway}"
        case Option.OPTIONS:
            return " ".join(_label((value[at], value[at + 1])) for at in range(0, len(value) - 1, _U16))
        case Option.DEVICE_ID:
            return f"vendor {value[:_U16].hex().upper()}h device {value[_U16:].hex().upper()}h"
    return value.hex()


def _notification(content: bytes) -> list[Document]:
    """The blocks of a DATA PDU; a notification with its channel diagnosis."""
    blocks = documents(content)
    for block in blocks:
        if block.get("type") in _NOTIFICATION_TYPES and "payload" in block:
            payload = content[HEADER.size :][-len(block["payload"]) // 2 :] if block["payload"] else b""
            usi, entries = int.from_bytes(payload[:_U16], "big"), payload[_U16:]
            if usi in DIAGNOSES:
                block["diagnoses"] = diagnoses(entries, usi)
    return blocks


def _block_text(block: Document) -> str:
    """One block of an alarm in words."""
    if "alarm_type" not in block:
        return str(block.get("name", block.get("error", "")))
    kind = block["alarm_type"]
    what = name_in(AlarmType, kind, f"alarm type {kind:04X}h")
    text = f"{what}, {place_text(block['slot'], block['subslot'])}"
    if "status" in block:
        status = PnioStatus.of(block["status"])
        return f"acknowledged: {text}" + (f", {status.text}" if status.value else "")
    return ", ".join([text, *(item["text"] for item in block.get("diagnoses", ()))])


def _abort_text(status: PnioStatus) -> str:
    if (status.code, status.decode, status.code1) == _ABORT and 0 < status.code2 <= len(ABORT_TEXTS):
        return f"{ABORT_TEXTS[status.code2 - 1]} ({status.codes})"
    return status.text


_ABORT: Final = (AbortCode.REQUESTED.status.code, AbortCode.REQUESTED.status.decode, AbortCode.REQUESTED.status.code1)
