"""Hexadecimal data as a packet for the decoder: telegram words, a C_SDU, a cyclic frame, a parameter request or response.

Source: docs/telegrams.md, docs/plc.md, docs/parameter-channel.md.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import (
    C_SDU_MIN,
    ETHERTYPE,
    FRAME_ID_TO_CONTROLLER,
    FRAME_ID_TO_DEVICE,
    HEADER,
    IOPS_BAD,
    IOPS_GOOD,
    STATUS_DATA_VALID,
    STATUS_PRIMARY,
    STATUS_RUN,
    TICK,
    CSduLayout,
    RtFrame,
)
from pdgw.profidrive.parameters.codec import Attribute, decode_request, decode_response, unswap
from pdgw.profidrive.telegrams import TELEGRAMS, Direction, likeliest, telegram
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT, PacketType, RpcHeader, encode_packet
from pdgw.profinet.rpc.records import (
    NIL,
    RECORD_GLOBAL,
    BlockType,
    Operation,
    RecordBlock,
    encode_arguments,
    encode_block,
)
from pdgw.tools.decoder.frames.engine import Decoder, Packet, Settings, given_axes
from pdgw.tools.decoder.frames.link import UDP_PROTOCOL
from pdgw.tools.decoder.frames.records import LinkType, Record

_SKIPPED = re.compile(r"0[xX]|[\s,:]+")
_FRAME_IDS = {Direction.SETPOINT: FRAME_ID_TO_DEVICE, Direction.ACTUAL: FRAME_ID_TO_CONTROLLER}
_USED_STATUS = STATUS_DATA_VALID | STATUS_RUN | STATUS_PRIMARY
_ALWAYS_SET = {"STW1": ("NO_COAST_STOP", "NO_QUICK_STOP", "CONTROL_BY_PLC"), "ZSW1": ("CONTROL_REQUESTED",)}
"""Bits that an axis in use has, in the first word of its telegram."""
_UDP = struct.Struct(">BxHxxxxxB10xHHHxx")
"""Headers of IPv4 and UDP."""


def parse_hex(text: str) -> bytes:
    """Hexadecimal text with spaces, line ends, commas, colons and 0x prefixes; ProfidriveError has the offset of bad text."""
    digits: list[str] = []
    offset = 0
    while offset < len(text):
        skipped = _SKIPPED.match(text, offset)
        if skipped:
            offset = skipped.end()
            continue
        if text[offset] not in "0123456789abcdefABCDEF":
            raise ProfidriveError(f"hex at offset {offset}", text[offset], "digits 0-9, A-F, spaces and 0x")
        digits.append(text[offset])
        offset += 1
    if not digits or len(digits) % 2:
        raise ProfidriveError("hex digits", len(digits), "an even number of at least 2")
    return bytes.fromhex("".join(digits))


def recognise(data: bytes, telegrams: Sequence[int] = (), direction: Direction | None = None) -> Record:
    """Decode data of unknown kind; see ``packet_of``."""
    packet, chosen = packet_of(data, telegrams, direction)
    return Decoder(Settings(given_axes(chosen))).decode(packet)


def packet_of(
    data: bytes, telegrams: Sequence[int] = (), direction: Direction | None = None
) -> tuple[Packet, Sequence[int]]:
    """The packet that carries the data, and the telegrams of its axes; ProfidriveError when the data fits nothing.

    ``telegrams``: those of the axes; without them the length of telegram words decides. ``direction``: setpoints or actual
    values where no FrameID says so; by default setpoints.
    """
    assumed = direction or Direction.SETPOINT
    unit = _c_sdu(data, telegrams, assumed) if telegrams else None
    if unit is not None:
        return _cyclic(assumed, unit), telegrams
    if _is_frame(data):
        return _ethernet(data), telegrams
    data = standard_request(data) or data
    if _is_request(data):
        return _acyclic(PacketType.REQUEST, Operation.WRITE, BlockType.WRITE_REQUEST, data), telegrams
    if _is_response(data):
        return _acyclic(PacketType.RESPONSE, Operation.READ, BlockType.READ_RESPONSE, data), telegrams
    fitting = [number for number, known in TELEGRAMS.items() if known.half(assumed).size == len(data)]
    if fitting and not telegrams:
        chosen = [likeliest(fitting)]
        return _cyclic(assumed, _c_sdu(data, chosen, assumed) or b""), chosen
    expected = "telegram words, a C_SDU, a cyclic frame, or a parameter request or response"
    for number in telegrams:
        expected += f" ({assumed.value}s of telegram {number} have {telegram(number).half(assumed).size} bytes)"
    raise ProfidriveError("data", f"{len(data)} bytes {data[:8].hex(' ')}", expected)


def standard_request(data: bytes) -> bytes | None:
    """The parameter request that is printed with swapped bytes, as in the manufacturer's guide; None for other data."""
    return None if _is_request(data) else unswap(data)


def swapped_words(data: bytes, number: int, direction: Direction) -> str:
    """A hint where the words of a telegram make sense only with their bytes swapped; "" elsewhere."""
    half = telegram(number).half(direction)
    if half.names[0] not in _ALWAYS_SET or len(data) != half.size:
        return ""
    mask = sum(half.signals[0].bit(name).mask for name in _ALWAYS_SET[half.names[0]])
    found, swapped = (int.from_bytes(data[:2], order) for order in ("big", "little"))
    if found & mask == mask or swapped & mask != mask:
        return ""
    return (
        f"{half.names[0]} {found:04X}h is {swapped:04X}h with its bytes swapped: check the byte order, "
        "PROFIdrive sends the high byte first"
    )


def _c_sdu(data: bytes, telegrams: Sequence[int], direction: Direction) -> bytes | None:
    """The C_SDU of the words of one axis, or of what is one already, with or without padding and tick; None for other data."""
    layout = CSduLayout([telegram(number) for number in telegrams], direction)
    if len(data) == layout.halves[0].size and len(telegrams) == 1:
        return data + bytes((IOPS_GOOD, IOPS_GOOD))
    status = [data[at - HEADER.size] for at in (*layout.iops, *layout.iocs)] if len(data) >= layout.used else [-1]
    padding = data[layout.used : -TICK.size] if len(data) >= C_SDU_MIN else data[layout.used :]
    return data if set(status) <= {IOPS_GOOD, IOPS_BAD} and not any(padding) else None


def _is_frame(data: bytes) -> bool:
    """With a FrameID of the relationship, a bad status is a finding and not a sign of other data."""
    try:
        frame = RtFrame.decode(data)
    except ProfidriveError:
        return False
    return frame.frame_id in _FRAME_IDS.values() or bool(not frame.transfer_status and frame.data_status & _USED_STATUS)


def _is_request(data: bytes) -> bool:
    try:
        return all(address.attribute in set(Attribute) for address in decode_request(data).addresses)
    except ProfidriveError:
        return False


def _is_response(data: bytes) -> bool:
    try:
        decode_response(data)
    except ProfidriveError:
        return False
    return True


def _cyclic(direction: Direction, c_sdu: bytes) -> Packet:
    return _ethernet(RtFrame(_FRAME_IDS[direction], c_sdu, 0).encode())


def _ethernet(frame: bytes) -> Packet:
    return Packet(1, 0, LinkType.ETHERNET, "", bytes(12) + ETHERTYPE.to_bytes(2, "big") + frame)


def _acyclic(kind: PacketType, operation: Operation, block: BlockType, data: bytes) -> Packet:
    """A call with the record of the parameter channel, in a datagram."""
    record = encode_block(RecordBlock(block, 0, NIL, 0, 0, 1, RECORD_GLOBAL, len(data))) + data
    arguments = encode_arguments(0, record, len(record), little=True)
    payload = encode_packet(RpcHeader(kind, NIL, NIL, 0, operation), arguments)
    size = _UDP.size + len(payload)
    head = _UDP.pack(0x45, size, UDP_PROTOCOL, ACYCLIC_PORT, ACYCLIC_PORT, size - 20)
    return Packet(1, 0, LinkType.IPV4, "", head + payload)
