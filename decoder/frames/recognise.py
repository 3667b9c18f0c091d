"""Recognise a piece of data: telegram words, a C_SDU, a cyclic frame, a parameter request or response.

Source: docs/telegrams.md, docs/transport.md, docs/parameter-channel.md. ``recognise`` states the reason of its decision.
"""

from __future__ import annotations

import re
from typing import Any

from pdgw.decoder.frames.profinet.cyclic import CyclicDecoder, unit_layout
from pdgw.decoder.frames.records import ProcessData
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import (
    C_SDU_MIN,
    FRAME_ID_TO_CONTROLLER,
    FRAME_ID_TO_DEVICE,
    IOPS_BAD,
    IOPS_GOOD,
    STATUS_DATA_VALID,
    STATUS_PRIMARY,
    STATUS_RUN,
    RtFrame,
)
from pdgw.profidrive.parameters.codec import (
    Attribute,
    Request,
    RequestId,
    Response,
    Values,
    decode_request,
    decode_response,
    unswap,
)
from pdgw.profidrive.telegrams import TELEGRAMS, Direction, Telegram, TelegramHalf, likeliest

Document = dict[str, Any]
_SKIPPED = re.compile(r"0[xX]|[\s,:]+")


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


def recognise(data: bytes, telegram: Telegram | None = None, direction: Direction | None = None) -> Document:
    """Decode data of unknown kind; ProfidriveError when it fits nothing.

    ``telegram``: what the data objects carry; without it, it is inferred from lengths. ``direction``: setpoints or actual
    values; by default by the FrameID, else setpoints.
    """
    if telegram is not None:
        half = telegram.half(direction or Direction.SETPOINT)
        if len(data) == half.size:
            return _telegram(
                half, data, f"{len(data)} bytes are the {direction_text(half)} of telegram {half.telegram}"
            )
    frame = _frame(data, telegram, direction)
    if frame is not None:
        return frame
    if telegram is not None:
        unit = _c_sdu(telegram.half(direction or Direction.SETPOINT), data)
        if unit is not None:
            return unit
    for attempt in (_swapped, _request, _response):
        document = attempt(data)
        if document is not None:
            return document
    if telegram is None:
        wanted = direction or Direction.SETPOINT
        fitting = [number for number, t in TELEGRAMS.items() if t.half(wanted).size == len(data)]
        if fitting:
            half = TELEGRAMS[likeliest(fitting)].half(wanted)
            numbers = ", ".join(map(str, [half.telegram, *(n for n in fitting if n != half.telegram)]))
            return _telegram(half, data, f"{len(data)} bytes fit the {direction_text(half)} of telegram {numbers}")
    expected = "telegram words, a C_SDU, a cyclic frame, or a parameter request or response"
    if telegram is not None:
        half = telegram.half(direction or Direction.SETPOINT)
        expected += f" ({direction_text(half)} of telegram {half.telegram} have {half.size} bytes)"
    raise ProfidriveError("data", f"{len(data)} bytes {data[:8].hex(' ')}", expected)


def direction_text(half: TelegramHalf) -> str:
    """For the reader."""
    return "setpoints" if half.direction is Direction.SETPOINT else "actual values"


def _telegram(half: TelegramHalf, data: bytes, why: str) -> Document:
    return {
        "kind": "telegram",
        "why": why,
        "telegram": half.telegram,
        "direction": half.direction.value,
        "signals": ProcessData(0, 0, unit_layout(half.telegram, half.direction), half.decode(data)).document()[
            "signals"
        ],
    }


def _c_sdu(half: TelegramHalf, data: bytes) -> Document | None:
    """Data object, IOPS and IOCS of one axis, with or without padding."""
    if len(data) < half.size + 2:
        return None
    iops, iocs = data[half.size], data[half.size + 1]
    padding = data[half.size + 2 :]
    good = (IOPS_GOOD, IOPS_BAD)
    if iops not in good or iocs not in good or any(padding) or (padding and len(data) < C_SDU_MIN):
        return None
    document = _telegram(half, data, f"telegram {half.telegram}, then IOPS {iops:02X}h, IOCS {iocs:02X}h and padding")
    return {**document, "kind": "c_sdu", "iops": iops, "iocs": iocs}


def _frame(data: bytes, telegram: Telegram | None, direction: Direction | None) -> Document | None:
    try:
        frame = RtFrame.decode(data)
    except ProfidriveError:
        return None
    known = frame.frame_id in {FRAME_ID_TO_CONTROLLER, FRAME_ID_TO_DEVICE}
    plausible = not frame.transfer_status and frame.data_status & (STATUS_DATA_VALID | STATUS_RUN | STATUS_PRIMARY)
    # With a FrameID of the relationship, a bad status is a finding and the data is still decoded as a frame.
    if not known and not plausible:
        return None
    if direction is None:
        direction = Direction.ACTUAL if frame.frame_id == FRAME_ID_TO_CONTROLLER else Direction.SETPOINT
    record = CyclicDecoder((), lambda _: None).decode(0, 0, "", data)
    document: Document = {
        "kind": "frame",
        "why": f"FrameID {frame.frame_id:04X}h and {len(data)} bytes of a cyclic frame",
        **record.details(),
        "direction": direction.value,
        "c_sdu": frame.c_sdu.hex(),
        "signals": {},
    }
    if telegram is not None:
        unit = _c_sdu(telegram.half(direction), frame.c_sdu)
        if unit is None:
            document["why"] += f"; its C_SDU is not one axis with telegram {telegram.number}"
        else:
            document |= {key: unit[key] for key in ("telegram", "signals", "iops", "iocs")}
    return document


def _swapped(data: bytes) -> Document | None:
    standard = unswap(data)
    if standard is None or _plausible_request(data) is not None:
        return None
    document = request_document(decode_request(standard))
    why = "a parameter request with the bytes of each word swapped, as the manufacturer's guide prints it"
    return {**document, "kind": "parameter-request-swapped", "why": why, "standard": standard.hex()}


def _plausible_request(data: bytes) -> Request | None:
    try:
        request = decode_request(data)
    except ProfidriveError:
        return None
    return request if all(address.attribute in set(Attribute) for address in request.addresses) else None


def _request(data: bytes) -> Document | None:
    request = _plausible_request(data)
    if request is None:
        return None
    return {
        **request_document(request),
        "kind": "parameter-request",
        "why": "header, addresses and lengths fit a request",
    }


def _response(data: bytes) -> Document | None:
    try:
        response = decode_response(data)
    except ProfidriveError:
        return None
    return {
        **response_document(response),
        "kind": "parameter-response",
        "why": "header, formats and lengths fit a response",
    }


def _values_document(item: Values) -> Document:
    values = item.values.hex() if isinstance(item.values, bytes) else list(item.values)
    return {"format": item.format.name, "values": values, "text": item.text, "failed": item.failed}


def request_document(request: Request) -> Document:
    """A request as plain data."""
    parameters = []
    for position, address in enumerate(request.addresses):
        entry: Document = {
            "pnu": address.pnu,
            "subindex": address.subindex,
            "elements": address.elements,
            "attribute": _attribute_name(address.attribute),
        }
        if request.values:
            entry |= _values_document(request.values[position])
        parameters.append(entry)
    return {
        "reference": request.reference,
        "service": _service_name(request.request_id),
        "do_id": request.do_id,
        "parameters": parameters,
        "signals": {},
    }


def response_document(response: Response) -> Document:
    """A response as plain data."""
    return {
        "reference": response.reference,
        "service": _service_name(response.request_id),
        "do_id": response.do_id,
        "negative": response.negative,
        "parameters": [_values_document(item) for item in response.values],
        "signals": {},
    }


def _service_name(request_id: RequestId) -> str:
    return "request parameter" if request_id is RequestId.REQUEST else "change parameter"


def _attribute_name(attribute: int) -> str:
    return Attribute(attribute).name.lower() if attribute in set(Attribute) else f"{attribute:02X}h"
