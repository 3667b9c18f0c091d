"""The part of docs/tables.md with what the gateway watches of a device."""

from __future__ import annotations

from collections.abc import Iterator

from pdgw.ds301.node.node import NodeSettings
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.commissioning.supervisions import SUPERVISIONS, Supervision
from pdgw.peers.habits import HABITS, Habit
from pdgw.tools.commissioning.device_times import time_text
from tests.support.documents.parts import table

NEAREST = {
    "heartbeat": "heartbeat-jitter",
    "TPDO": "tpdo-jitter",
    "SDO answer": "slow-sdo",
    "number of devices": "heartbeat-burst",
    "restart": "boot-up-repeated",
    "Statusword": "manufacturer-bits",
    "EMCY": "emcy-of-a-warning",
    "following ON": "power-stage-charges",
    "entering operation": "brake-opens",
    "reaction to a command": "status-latency",
    "leaving operation at standstill": "brake-closes",
    "ramp from 100 % speed": "limited-jerk",
    "speed without power": "quick-stop-coasts",
    "change of the mode": "mode-display-late",
    "acknowledge of a setpoint": "acknowledge-late",
    "acknowledge of a fault": "fault-reset-late",
    "internal limit": "limit-bit-at-standstill",
    "internal limit of the speed": "limit-bit-in-operation",
    "speed and position": "position-noise",
    "standstill before the target": "target-reached-late",
    "motion without a task": "velocity-noise",
}
"""The legal habit of a device next to each supervision."""


def _time(item: Supervision) -> str:
    if item.limit is None:
        return ""
    limit = item.limit(NodeSettings(1), AxisSettings())
    return f"{time_text(limit)} (`{item.key}`)" if item.key else time_text(limit)


def _habit(habit: Habit) -> str:
    ranges = (f"{habit.parameters[key].text(high)}" for key, (_, high) in habit.legal.items())
    return ", ".join([f"`{habit.name}`", *ranges])


def generate() -> Iterator[str]:
    """Each supervision with its limit for the default settings, and the legal habit next to it."""
    yield "## Supervisions\n"
    yield (
        "What the gateway watches of a device. What healthy devices show too only asks or informs; a proof stops. "
        "`pdgw axis test` prints the times of a drive beside these limits.\n"
    )
    yield table(
        ("of", "healthy devices show too", "proof", "longer than", "reaction", "fault", "legal habit next to it"),
        (
            (
                item.name,
                item.sign,
                item.proof,
                _time(item),
                item.reaction,
                "" if item.fault is None else int(item.fault),
                _habit(HABITS[NEAREST[item.name]]),
            )
            for item in SUPERVISIONS
        ),
    )
