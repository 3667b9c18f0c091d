"""What a configuration puts on a bus when every value changes in every cycle: the frames the load planner counts.

An axis whose drive was asked counts by its PDO plan, another one by the PDOs its telegram wants.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from pdgw.ds301.load import CyclicFrames
from pdgw.ds301.plan import PdoPlan, straight_plan
from pdgw.dsp402.objects import CONTROL_ATTRIBUTE, STATUS_ATTRIBUTE
from pdgw.durations import MS_PER_SECOND, SECOND, US

if TYPE_CHECKING:
    from pdgw.gateway.config import AxisConfig
    from pdgw.gateway.config_encoder import EncoderConfig

_DRIVE_CYCLE_US = 1000
"""A drive updates its values once a millisecond."""
_POSITION_SIZE = 8
"""Bytes of an encoder's TPDO with position, speed, area and cam state."""


def wanted_plan(axis: AxisConfig, cycle_time_ms: float) -> PdoPlan:
    """The PDOs of an axis with a drive that takes all that its telegram wants."""
    layout = axis.drive_layout(axis.telegram)
    available = {
        pdo.communication_index for pdo in (*layout.rpdos, *layout.tpdos) if axis.node_id <= 0x3F or pdo.number <= 4
    }
    settings = axis.drive_settings(axis.telegram, cycle_time_ms)
    on_sync = settings.sync_period_us > 0
    return straight_plan(layout, axis.node_id, available, sync=settings.sync, sync_rpdos=on_sync)


def cyclic_frames(
    axes: Iterable[AxisConfig],
    encoders: Mapping[int, Sequence[EncoderConfig]],
    cycle_time_ms: float,
    plans: Mapping[int, PdoPlan] | None = None,
) -> list[CyclicFrames]:
    """The frames of the nodes of one bus. ``encoders`` and ``plans`` of axes: by node-ID."""
    cycle_rate = MS_PER_SECOND / cycle_time_ms
    frames: list[CyclicFrames] = []
    sync = False
    for axis in axes:
        plan = (plans or {}).get(axis.node_id) or wanted_plan(axis, cycle_time_ms)
        tpdo_rate = SECOND / (max(axis.inhibit_us(cycle_time_ms), _DRIVE_CYCLE_US) * US)
        frames += plan.frames(axis.node_id, cycle_rate, tpdo_rate, (CONTROL_ATTRIBUTE, STATUS_ATTRIBUTE))
        frames.append(CyclicFrames(f"heartbeat {axis.node_id}", 1, MS_PER_SECOND / axis.heartbeat_ms))
        sync |= plan.needs_sync
    for node_id, channels in encoders.items():
        first = channels[0]
        rate = cycle_rate if first.sync else MS_PER_SECOND / first.event_ms(cycle_time_ms)
        frames += [CyclicFrames(f"position {node_id}/{item.channel}", _POSITION_SIZE, rate) for item in channels]
        frames.append(CyclicFrames(f"heartbeat {node_id}", 1, MS_PER_SECOND / first.heartbeat_ms))
        sync |= first.sync
    if sync:
        frames.append(CyclicFrames("SYNC", 0, cycle_rate))
    return frames
