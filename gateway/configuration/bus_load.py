"""Worst-case load of a configuration on a bus: every value changes in every cycle. Also the latest time at which each frame is
sent.

An axis whose drive was read counts with its PDO plan, another one with the PDOs of its telegram.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pdgw.base.durations import MS, MS_PER_SECOND, SECOND, US
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.load import GATEWAY, CyclicFrames, bus_load, response_times, sdo_gap_ns
from pdgw.ds301.communication import ERROR_CONTROL, SDO_REQUEST, SDO_RESPONSE, SYNC
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.node.planner import found_in_data_sheet, plan_pdos
from pdgw.ds301.pdo import PdoCapabilities, PdoDirection
from pdgw.dsp402.objects import CONTROL_ATTRIBUTE, STATUS_ATTRIBUTE

if TYPE_CHECKING:
    from pdgw.gateway.configuration.axis_config import AxisConfig
    from pdgw.gateway.configuration.devices import EncoderConfig

_DRIVE_CYCLE_US = 1000
"""A drive updates its values once a millisecond."""
_POSITION_SIZE = 6
"""Bytes of an encoder's TPDO with position and speed."""
_TPDOS = 4
"""TPDOs with a COB-ID of the pre-defined connection set."""
_SDO_SIZE = 8
_ANY_NODE = -1
"""Sender of the SDO answers: one node at a time."""
HEARTBEATS: Final = 2
"""Heartbeats of the gateway in the shortest heartbeat time of its nodes."""


def required_plan(axis: AxisConfig, cycle_time_ms: float) -> PdoPlan:
    """PDOs of an axis with a drive that supports everything in its telegram."""
    layout = axis.drive_layout(axis.telegram)
    settings = axis.drive_settings(axis.telegram, cycle_time_ms)
    on_sync, device = settings.sync_period_us > 0, PdoCapabilities.of(layout)
    found = found_in_data_sheet(device)
    return plan_pdos(layout, device, axis.node_id, found, sync=settings.sync, sync_rpdos=on_sync)


def cyclic_frames(
    axes: Iterable[AxisConfig],
    encoders: Mapping[int, Sequence[EncoderConfig]],
    cycle_time_ms: float,
    gateway_node_id: int,
    plans: Mapping[int, PdoPlan] | None = None,
) -> list[CyclicFrames]:
    """The frames of the nodes of one bus. ``encoders`` and ``plans`` of axes: by node-ID."""
    cycle_rate = MS_PER_SECOND / cycle_time_ms
    frames: list[CyclicFrames] = []
    heartbeats: list[int] = []
    sync = False
    for axis in axes:
        plan = (plans or {}).get(axis.node_id) or required_plan(axis, cycle_time_ms)
        tpdo_rate = SECOND / (max(axis.inhibit_us(cycle_time_ms), _DRIVE_CYCLE_US) * US)
        frames += plan.frames(axis.node_id, cycle_rate, tpdo_rate, (CONTROL_ATTRIBUTE, STATUS_ATTRIBUTE))
        frames.append(_heartbeat(axis.node_id, axis.heartbeat_ms, axis.node_id))
        heartbeats.append(axis.heartbeat_ms)
        sync |= plan.needs_sync
    for node_id, channels in encoders.items():
        first = channels[0]
        rate = cycle_rate if first.sync else MS_PER_SECOND / first.event_ms(cycle_time_ms)
        for number, item in enumerate(channels, 1):
            cob_id = PdoDirection.TPDO.cob_id(min(number, _TPDOS), node_id)
            frames.append(CyclicFrames(f"position {node_id}/{item.channel}", _POSITION_SIZE, rate, cob_id, node_id))
        frames.append(_heartbeat(node_id, first.heartbeat_ms, node_id))
        heartbeats.append(first.heartbeat_ms)
        sync |= first.sync
    if heartbeats:
        frames.append(_heartbeat(gateway_node_id, min(heartbeats) / HEARTBEATS, GATEWAY))
    if sync:
        frames.append(CyclicFrames("SYNC", 0, cycle_rate, SYNC, GATEWAY))
    return frames


def _heartbeat(node_id: int, period_ms: float, sender: int) -> CyclicFrames:
    return CyclicFrames(f"heartbeat {node_id}", 1, MS_PER_SECOND / period_ms, ERROR_CONTROL + node_id, sender)


@dataclass(frozen=True, slots=True)
class Latest:
    """When a frame is sent at the latest after it is due, and when it has to be; nanoseconds. None: there is no bound."""

    frame: CyclicFrames
    response: int | None
    deadline: int

    @property
    def is_late(self) -> bool:
        return self.response is None or self.response > self.deadline

    def __str__(self) -> str:
        shown = "no bound" if self.response is None else f"{self.response / MS:.2f} ms"
        return f"{self.frame.name} ({self.frame.cob_id:03X}h): {shown} of {self.deadline / MS:g} ms"


def latest(frames: Sequence[CyclicFrames], bitrate: int, cycle_time_ms: float) -> list[Latest]:
    """Response times with the parameter channel in use; a frame has to be sent before it is due again, or within the cycle."""
    rate = SECOND / sdo_gap_ns(bus_load(frames, bitrate), bitrate)
    sdo = (
        CyclicFrames("SDO request", _SDO_SIZE, rate, SDO_REQUEST + 1, GATEWAY),
        CyclicFrames("SDO answer", _SDO_SIZE, rate, SDO_RESPONSE + 1, _ANY_NODE),
    )
    responses = response_times([*frames, *sdo], bitrate)
    return [
        Latest(frame, responses[frame], int(max(cycle_time_ms * MS, SECOND / frame.per_second))) for frame in frames
    ]


def check_cycle(name: str, found: Sequence[Latest]) -> None:
    """CanopenError with the frame that is the latest when the bus ``name`` cannot hold the cycle."""
    late = [item for item in found if item.is_late]
    if late:
        worst = max(late, key=lambda item: math.inf if item.response is None else item.response / item.deadline)
        raise CanopenError(
            f"bus {name}: worst-case response time of {len(late)} of {len(found)} frames is too long; "
            f"{worst.frame.name} is the latest",
            "no bound" if worst.response is None else f"{worst.response / MS:.2f} ms",
            f"at most {worst.deadline / MS:g} ms: raise cycle_time_ms or bitrate, or use fewer axes per bus",
        )
