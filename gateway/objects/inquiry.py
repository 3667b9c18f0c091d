"""What the gateway asks a drive that does not follow: the Controlword that it has, and the limits in force.

The questions are SDO reads beside the exchange, one series for each time that the drive does not follow.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import CanopenError, SdoAbortedError, SdoCommunicationError
from pdgw.ds301.bus.health import Outage
from pdgw.dsp402.drive.client import DriveClient
from pdgw.dsp402.objects import (
    MAX_MOTOR_SPEED,
    MAX_PROFILE_VELOCITY,
    MAX_TORQUE,
    MODE_DISPLAY,
    NEGATIVE_TORQUE_LIMIT,
    POSITIVE_TORQUE_LIMIT,
    PROFILE_ACCELERATION,
)
from pdgw.gateway.base.fault_numbers import By
from pdgw.gateway.base.reasons import Finding, Reason

Address = tuple[int, int]
UNFOLLOWED: Final = (Reason.INHIBITED, Reason.NOT_OPERATING)
"""ON is commanded, and the drive does not show that it follows."""
_AGAIN_NS: Final = 10 * SECOND
"""The limits of a drive are read so often at most."""
PATIENCE_NS: Final = 200 * MS
"""A drive shows within this time that it follows a Controlword; then it is asked which one it has."""


class LimitKind(enum.Enum):
    """What a limit bounds, and with which value it explains that the axis does not follow."""

    TORQUE = "0"
    RAMP = "0, in profile velocity mode"
    SPEED = "below the setpoint, in velocity units"
    MOTOR_SPEED = "below the setpoint, in rpm"


class Limit(NamedTuple):
    address: Address
    name: str
    kind: LimitKind


LIMITS: Final = (
    Limit(MAX_TORQUE, "max torque", LimitKind.TORQUE),
    Limit((POSITIVE_TORQUE_LIMIT, 0), "positive torque limit", LimitKind.TORQUE),
    Limit((NEGATIVE_TORQUE_LIMIT, 0), "negative torque limit", LimitKind.TORQUE),
    Limit((MAX_PROFILE_VELOCITY, 0), "max profile velocity", LimitKind.SPEED),
    Limit((MAX_MOTOR_SPEED, 0), "max motor speed", LimitKind.MOTOR_SPEED),
    Limit((PROFILE_ACCELERATION, 0), "profile acceleration", LimitKind.RAMP),
)
"""What keeps a drive from its setpoint, read when it does not follow."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What a drive has answered: its values by address, without those that it does not have."""

    values: dict[Address, int]
    silent: bool
    """A request was not answered at all."""

    def contradicts(self, address: Address, sent: int, mask: int) -> bool:
        """The drive has another value than was sent, in the bits of ``mask``, or it answers nothing. One without the object
        contradicts nothing."""
        has = self.values.get(address)
        return self.silent if has is None else (has ^ sent) & mask != 0


def ask(drive: DriveClient, addresses: Iterable[Address], then: Callable[[Answer], None]) -> None:
    """Read these objects beside the exchange, and call ``then``. Not called if the node is lost meanwhile."""

    def read(client: DriveClient) -> None:
        values: dict[Address, int] = {}
        silent = False
        for address in addresses:
            try:
                values[address] = client.sdo.read_number(*address)
            except SdoAbortedError:
                continue
            except SdoCommunicationError:
                silent = True
                break
            except CanopenError:
                return
        then(Answer(values, silent))

    drive.submit(read)


class LimitInquiry:
    """The limits of one drive, which are read when its axis begins to lag."""

    def __init__(self, drive: DriveClient) -> None:
        self.answer: Answer | None = None
        """None: none has come since the last question."""
        self._drive = drive
        self._asked = -_AGAIN_NS

    def ask(self, now: int) -> None:
        """Ask for them, unless that was done a moment ago."""
        if now - self._asked < _AGAIN_NS:
            return
        self._asked, self.answer = now, None

        def keep(answer: Answer) -> None:
            self.answer = answer

        ask(self._drive, [MODE_DISPLAY, *(limit.address for limit in LIMITS)], keep)


def untaken(sent: int, has: int | None) -> Finding:
    """The drive did not take the Controlword that was sent. ``has``: its 6040h; None: it answered no SDO request."""
    if has is None:
        return SENDS_NOTHING
    evidence = f"the drive does not take the Controlword: 6040h is {has:04X}h, {sent:04X}h was sent"
    return Finding(Reason.NOT_OPERATING, evidence, REMAP, by=By.DRIVE)


SENDS_NOTHING: Final = Finding(
    Reason.NOT_OPERATING,
    "the drive follows no Controlword and answers no SDO request, but its frames arrive: the interface may send nothing",
    (Outage.STUCK.remedy,),
    by=By.DRIVE,
)
REMAP: Final = (
    "restart the node (P972, or power off and on): some drives use a new PDO mapping only then; else compare its RPDO mapping "
    "(1600h and others) with pdgw status",
)
