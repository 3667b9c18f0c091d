"""scapy layers for the cyclic frame with PROFIdrive telegrams: the readable reference beside the struct codec.

Source: IEC 61158-6-10 by way of ``scapy.contrib.pnio`` (frame, IOPS/IOCS), telegram content generated from
``profidrive.telegrams``. Not used on the cyclic path. A capture does not name its telegrams, so ``bind`` needs
them; it also replaces scapy's own cyclic layer on UDP, which needs an Ethernet header below it and rejects more than 12 bytes of
padding.

    >>> bind([1])
    >>> IP() / UDP(dport=34962) / cyclic_frame([1], Direction.SETPOINT, [{"STW1": 0x047F, "NSOLL_A": 0x2000}])
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from pdgw.base.extras import missing
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import (
    C_SDU_MIN,
    CYCLIC_PORT,
    ETHERTYPE,
    FRAME_ID_MAX,
    FRAME_ID_MIN,
    FRAME_ID_TO_CONTROLLER,
    FRAME_ID_TO_DEVICE,
    IOPS_GOOD,
    STATUS_NORMAL,
    TICK,
)
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import ApplicationMode, Direction, TelegramHalf, telegram

try:
    from scapy.contrib.pnio import PNIORealTime_IOxS, PNIORealTimeCyclicPDU, ProfinetIO
    from scapy.fields import (
        Field,
        FlagsField,
        IntField,
        LongField,
        ShortField,
        SignedIntField,
        SignedShortField,
        StrField,
    )
    from scapy.layers.inet import UDP
    from scapy.layers.l2 import Ether
    from scapy.packet import Packet, Padding, bind_layers, split_layers
except ModuleNotFoundError as error:
    raise ImportError(missing("scapy"), name=error.name) from error

_FIELD_OF_CHAR = {
    "h": SignedShortField,
    "H": ShortField,
    "i": SignedIntField,
    "I": IntField,
    "Q": LongField,
}


def field_name(signal_name: str) -> str:
    """The scapy field of a signal: its name, with what Python does not allow in a name replaced by ``_``."""
    return signal_name.replace(" ", "_").replace("-", "_")


def _field(signal: Signal, positioning: bool) -> Field[Any, Any]:
    name = field_name(signal.name)
    if not signal.bits:
        return _FIELD_OF_CHAR[signal.type.char](name, 0)
    width = 8 * signal.type.size
    names = [f"bit{position}" for position in range(width)]
    for bit in signal.fields(positioning=positioning):
        for offset in range(bit.width):
            names[bit.position + offset] = bit.name if bit.width == 1 else f"{bit.name}.{offset}"
    return FlagsField(name, 0, width, names)


class _InDataUnit(Packet):
    """A part of the C_SDU: what follows belongs to the next part, not to a payload."""

    def extract_padding(self, s: bytes) -> tuple[bytes, bytes]:
        return b"", s

    def guess_payload_class(self, payload: bytes) -> type[Packet]:
        return Padding


class CSduPadding(_InDataUnit):
    """The zero bytes that fill the C_SDU up to its minimum; the bytes of the tick and of the APDU status stay."""

    name = "C_SDU padding"
    fields_desc = [StrField("load", b"", remain=8)]  # noqa: RUF012 (scapy's own class protocol)


class Tick(_InDataUnit):
    """The last bytes of the C_SDU: the gateway's clock, which the PLC copies back. On Ethernet they are padding."""

    name = "Tick of the gateway"
    fields_desc = [IntField("tick", 0)]  # noqa: RUF012


@cache
def telegram_layer(number: int, direction: Direction) -> type[Packet]:
    """The scapy layer of one telegram direction; fields carry the signals' names, words their bit names."""
    half: TelegramHalf = telegram(number).half(direction)
    positioning = half.mode is ApplicationMode.POSITIONING
    title = f"PROFIdrive telegram {number} {'setpoints' if direction is Direction.SETPOINT else 'actual values'}"
    return type(
        f"Telegram{number}{direction.value.capitalize()}",
        (_InDataUnit,),
        {"name": title, "fields_desc": [_field(signal, positioning) for signal in half.signals]},
    )


def _layout(telegrams: Sequence[int], direction: Direction) -> list[type[Packet]]:
    layers: list[type[Packet]] = []
    for number in telegrams:
        layers += [telegram_layer(number, direction), PNIORealTime_IOxS]
    layers += [PNIORealTime_IOxS] * len(telegrams)
    return [*layers, CSduPadding, Tick]


class ProfidriveCyclic(PNIORealTimeCyclicPDU):
    """scapy's cyclic PDU with the data objects of the bound telegrams."""

    name = "PROFINET Real-Time (PROFIdrive)"
    match_subclass = True
    _layout: Any

    bound: Mapping[int, Sequence[int]] = {}
    """Telegram numbers of the axes by FrameID, set by ``bind``."""

    def get_padding_length(self) -> int:
        return 0  # the padding is the last data object

    def next_cls_cb(self, _lst: list[Packet], _p: Packet | None, remain: bytes) -> type[Packet] | None:
        if not hasattr(self, "_layout") or self._layout is None:
            frame_id = self.underlayer.frameID if self.underlayer is not None else 0
            direction = Direction.SETPOINT if frame_id == FRAME_ID_TO_DEVICE else Direction.ACTUAL
            telegrams = self.bound.get(frame_id)
            self._layout = [CSduPadding, Tick] if telegrams is None else _layout(telegrams, direction)
        if len(remain) <= 4 or not self._layout:
            return None
        following: type[Packet] = self._layout.pop(0)
        return following


class ProfidriveIO(ProfinetIO):
    """scapy's PROFINET IO dispatcher, sending cyclic frames to ``ProfidriveCyclic``."""

    name = "PROFINET IO"
    match_subclass = True

    def guess_payload_class(self, payload: bytes) -> type[Packet]:
        if FRAME_ID_MIN <= self.frameID <= FRAME_ID_MAX:
            return ProfidriveCyclic
        following: type[Packet] = super().guess_payload_class(payload)  # type: ignore[no-untyped-call]
        return following


def bind(
    telegrams: Sequence[int],
    setpoint_frame_id: int = FRAME_ID_TO_DEVICE,
    actual_frame_id: int = FRAME_ID_TO_CONTROLLER,
) -> None:
    """Make scapy dissect RT frames (UDP port 34962 either way, EtherType 8892h) as these axes' telegrams.

    Global, as all scapy bindings are; a later call replaces an earlier one. ProfidriveError for an unknown telegram.
    """
    for number in telegrams:
        telegram(number)
    ProfidriveCyclic.bound = {setpoint_frame_id: tuple(telegrams), actual_frame_id: tuple(telegrams)}
    for lower, upper_old, condition in (
        (UDP, ProfinetIO, {"dport": CYCLIC_PORT}),
        (Ether, ProfinetIO, {"type": ETHERTYPE}),
    ):
        split_layers(lower, upper_old, **condition)
        split_layers(lower, ProfidriveIO, **condition)
        bind_layers(lower, ProfidriveIO, **condition)
    split_layers(UDP, ProfidriveIO, sport=CYCLIC_PORT)
    bind_layers(UDP, ProfidriveIO, sport=CYCLIC_PORT)


def cyclic_frame(
    telegrams: Sequence[int],
    direction: Direction,
    values: Sequence[Mapping[str, int]],
    *,
    counter: int = 0,
    data_status: int = STATUS_NORMAL,
    iops: int = IOPS_GOOD,
    iocs: int = IOPS_GOOD,
    tick: int = 0,
) -> Packet:
    """Build a whole cyclic frame from signal values by name, one mapping for each axis."""
    if len(telegrams) != len(values):
        raise ProfidriveError("signal values", f"{len(values)} axes", f"{len(telegrams)} axes, as many as telegrams")
    parts: list[Packet] = []
    for number, signals in zip(telegrams, values, strict=True):
        telegram(number).half(direction).from_dict(dict(signals))
        fields: dict[str, Any] = {field_name(name): value for name, value in signals.items()}
        parts += [telegram_layer(number, direction)(**fields), PNIORealTime_IOxS(bytes([iops]))]
    parts += [PNIORealTime_IOxS(bytes([iocs])) for _ in telegrams]
    used = sum(len(bytes(part)) for part in parts)
    parts += [CSduPadding(load=bytes(max(0, C_SDU_MIN - TICK.size - used))), Tick(tick=tick)]
    frame_id = FRAME_ID_TO_DEVICE if direction is Direction.SETPOINT else FRAME_ID_TO_CONTROLLER
    pdu = ProfidriveCyclic(data=parts, cycleCounter=counter, dataStatus=data_status)
    return ProfidriveIO(frameID=frame_id) / pdu
