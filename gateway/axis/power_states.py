"""States of the power stage, and commands: the vocabulary of the power table and its users.

Source: docs/translation.md "States".
"""

from __future__ import annotations

import enum
from typing import Final

from pdgw.dsp402.states import ControlBit, State


class Phase(enum.IntEnum):
    """State of the power stage, as the gateway commands it."""

    LOCKED = 0
    """Power is off; only an OFF is accepted."""
    UNCONFIRMED = 1
    """As LOCKED, but the drive may be in operation: Quick Stop until it shows that it is off."""
    FOLLOW = 2
    """The drive follows the PLC, one transition at a time."""
    PASS = 3
    """The Controlword of the telegram passes."""
    RAMP_STOP = 4
    """OFF1, or loss of the PLC: ramp to standstill with power on."""
    SHUTDOWN = 5
    """After the ramp: power off."""
    QUICK_STOP = 6
    """Quick Stop until the drive has left Quick Stop Active."""
    COAST = 7
    """OFF2: Disable Voltage until the drive shows no power. Only an OFF ends it."""
    INHIBITED = 8
    """As LOCKED, but the drive did not follow an ON in time (STO, supply): Shutdown, so that it shows when that ends."""


class Drive(enum.IntEnum):
    """State of the drive; the last twelve need more than its Statusword."""

    NOT_READY = 0
    DISABLED = 1
    READY = 2
    SWITCHED_ON = 3
    OPERATING = 4
    """Operation enabled, as the last Controlword commanded."""
    QUICK_STOPPING = 5
    FAULT = 6
    UNKNOWN = 7
    """The Statusword matches no state."""
    STANDING = 8
    """As ``OPERATING``, inside the standstill window."""
    QUICK_STOPPED = 9
    """Quick Stop Active at standstill, and the drive stays in it (option codes 5-8)."""
    FELL_BACK = 10
    """Left operation without a command."""
    FELL_OFF = 11
    """Fell back to Switch On Disabled."""
    LOST = 12
    """Not online, or silent."""
    NO_REFERENCES = 13
    """Its reference objects are missing or invalid, so its speed is unknown."""
    POWERED_UNREAD = 14
    """As NO_REFERENCES, and it may have power: by its Statusword, or because the last Controlword was Enable Operation."""
    RESTARTED = 15
    """It booted or was configured again. This has priority over its Statusword."""
    LEAVING = 16
    """Operation enabled, but the last Controlword was another one: the Statusword is old, or the drive ramps down by Disable
    Operation. It may be off already, so Enable Operation could switch it on."""
    ENTERING = 17
    """Switched on, but the last Controlword was Enable Operation: the drive may be in operation already."""
    INHIBITED = 18
    """It has not followed Shutdown or an ON in time: STO, the supply or an enable is missing, or it tests itself; or it is in
    local mode below Switched On."""
    LOCAL = 19
    """Switched on, in local mode: it takes no command, and may have taken the last one."""


class Action(enum.IntEnum):
    """Command to the drive."""

    DISABLE_VOLTAGE = 0
    QUICK_STOP = 1
    SHUTDOWN = 2
    SWITCH_ON = 3
    """In operation, this word is Disable Operation."""
    ENABLE_OPERATION = 4
    RAMP = 5
    """Enable Operation, while the executor ramps the axis to standstill."""
    RAMP_END = 6
    """Shutdown at the end of a ramp."""
    PASS = 7
    """The Controlword of the telegram."""


_SHUTDOWN = ControlBit.ENABLE_VOLTAGE | ControlBit.QUICK_STOP
_SWITCH_ON = _SHUTDOWN | ControlBit.SWITCH_ON
_ENABLE_OPERATION = _SWITCH_ON | ControlBit.ENABLE_OPERATION
CONTROLWORDS: Final = (
    0,
    ControlBit.ENABLE_VOLTAGE,
    _SHUTDOWN,
    _SWITCH_ON,
    _ENABLE_OPERATION,
    _ENABLE_OPERATION,
    _SHUTDOWN,
    0,
)
"""Controlword bits 0-3 by ``Action``; of PASS they are the telegram's."""

DRIVE_OF_STATE: Final = {
    State.NOT_READY_TO_SWITCH_ON: Drive.NOT_READY,
    State.SWITCH_ON_DISABLED: Drive.DISABLED,
    State.READY_TO_SWITCH_ON: Drive.READY,
    State.SWITCHED_ON: Drive.SWITCHED_ON,
    State.OPERATION_ENABLED: Drive.OPERATING,
    State.QUICK_STOP_ACTIVE: Drive.QUICK_STOPPING,
    State.FAULT_REACTION_ACTIVE: Drive.FAULT,
    State.FAULT: Drive.FAULT,
    None: Drive.UNKNOWN,
}
