"""Byte map: the place of every value in the frames of a configuration, for the PLC programmer.

Source: docs/plc.md "Frames over UDP"; the offsets are those of ``profidrive.frame.CSduLayout``, which the gateway uses. On
PROFINET each axis is a submodule: ``in_object`` counts from its first byte.
"""

from __future__ import annotations

from dataclasses import dataclass

from pdgw.base.durations import MS
from pdgw.dsp402.drive_type import Quantity
from pdgw.gateway.axis.settings import quantity_of
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.devices import EncoderConfig
from pdgw.profidrive.datatypes import N2_100_PERCENT, N4_100_PERCENT, DataType
from pdgw.profidrive.frame import COUNTER_UNIT_NS, HEADER, IOPS_GOOD, STATUS_NORMAL, TICK, CSduLayout
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import Direction, TelegramHalf

_FULL = {DataType.N2: f"{N2_100_PERCENT:X}h", DataType.N4: f"{N4_100_PERCENT:X}h"}
_GOOD = f"{IOPS_GOOD:02X}h good"


@dataclass(frozen=True, slots=True)
class Place:
    """One value in a frame. Offsets in bytes: ``in_frame`` from the FrameID, ``in_object`` from the axis' first byte.

    ``axis`` is the DO-ID, 0 for a value of the frame; ``signal`` is None for a value that is not a signal.
    """

    in_frame: int
    length: int
    name: str
    type: str
    axis: int = 0
    in_object: int | None = None
    unit: str = ""
    full: str = ""
    """Value of 100 %, or the allowed values."""
    description: str = ""
    signal: Signal | None = None


@dataclass(frozen=True, slots=True)
class AxisMap:
    """The bytes of one axis in one direction."""

    do_id: int
    name: str | None
    half: TelegramHalf
    offset: int
    iops: int
    iocs: int
    places: tuple[Place, ...]


@dataclass(frozen=True, slots=True)
class FrameMap:
    """One direction of the exchange: ``size`` bytes of UDP payload."""

    direction: Direction
    size: int
    trailer: int
    axes: tuple[AxisMap, ...]
    places: tuple[Place, ...]
    """Every value in the order of the frame."""


def counter_step(config: GatewayConfig) -> int:
    """Increment of the cycle counter from frame to frame of the PLC."""
    return max(1, int(config.transport.cycle_time_ms * MS) // COUNTER_UNIT_NS)


def frame_maps(config: GatewayConfig) -> tuple[FrameMap, FrameMap]:
    """Setpoints (PLC to gateway) and actual values."""
    return _frame_map(config, Direction.SETPOINT), _frame_map(config, Direction.ACTUAL)


def _frame_map(config: GatewayConfig, direction: Direction) -> FrameMap:
    layout = CSduLayout([item.chosen for item in config.objects], direction)
    own, other = ("setpoints", "actual values") if direction is Direction.SETPOINT else ("actual values", "setpoints")
    axes = []
    for position, item in enumerate(config.objects):
        half, offset = layout.halves[position], layout.offsets[position]
        iops, iocs = layout.iops[position], layout.iocs[position]
        states = (
            (iops, "IOPS", f"the {own} of the axis are valid"),
            (iocs, "IOCS", f"the {other} of the axis are used"),
        )
        places = _signals(item, half, offset)
        places += [Place(at, 1, name, "BYTE", item.do_id, full=_GOOD, description=text) for at, name, text in states]
        axes.append(AxisMap(item.do_id, item.name, half, offset, iops, iocs, tuple(places)))
    copied = "the PLC copies it to its frame" if direction is Direction.ACTUAL else "copy of the gateway's newest frame"
    of_frame = [
        Place(0, HEADER.size, "FrameID", "WORD", description="constant"),
        Place(layout.tick, TICK.size, "Tick", "DWORD", description=copied),
        Place(layout.trailer, 2, "CycleCounter", "WORD", full=f"step {counter_step(config)}", description="31.25 us"),
        Place(layout.trailer + 2, 1, "DataStatus", "BYTE", full=f"{STATUS_NORMAL:02X}h running"),
        Place(layout.trailer + 3, 1, "TransferStatus", "BYTE", full="0"),
    ]
    places = sorted([*of_frame, *(place for axis in axes for place in axis.places)], key=lambda place: place.in_frame)
    return FrameMap(direction, layout.frame_size, layout.trailer, tuple(axes), tuple(places))


def _signals(item: AxisConfig | EncoderConfig, half: TelegramHalf, begin: int) -> list[Place]:
    offset = 0
    places = []
    for signal in half.signals:
        size = signal.type.size
        places.append(
            Place(
                begin + offset,
                size,
                signal.name,
                plc_type(signal),
                item.do_id,
                offset,
                signal.unit,
                _full(item, signal),
                signal.description,
                signal,
            )
        )
        offset += size
    return places


def _full(item: AxisConfig | EncoderConfig, signal: Signal) -> str:
    raw = _FULL.get(signal.type)
    if raw is None:
        return ""
    if isinstance(item, EncoderConfig):
        return f"{raw} = {item.reference_speed:g} {item.speed_unit}"
    quantity = quantity_of(signal)
    rated = item.units.rated_speed_rpm
    if rated is not None and quantity is Quantity.SPEED:
        return f"{raw} = {float(rated):g} rpm"
    return f"{raw} = 100 %" + (f" of the {quantity.value}" if quantity is not None else "")


_TYPES = {"b": "SINT", "B": "USINT", "h": "INT", "H": "UINT", "i": "DINT", "I": "UDINT", "Q": "ULINT", "f": "REAL"}
_WORDS = {1: "BYTE", 2: "WORD", 4: "DWORD"}


def plc_type(signal: Signal) -> str:
    """The elementary type of IEC 61131-3 for a signal: a bit string for a word of bits, else a number."""
    if signal.bits or signal.type in {DataType.V2, DataType.BYTE, DataType.WORD, DataType.DOUBLE_WORD}:
        return _WORDS[signal.type.size]
    # In one dialect REAL_TO_DWORD converts the value, in another it copies the bits. So the bits are declared as a DWORD.
    return _WORDS[signal.type.size] if signal.is_float else _TYPES[signal.type.char]
