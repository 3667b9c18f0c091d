"""Common parts of the conformance tests for drives and encoders: the cases, their results, and the gateway in virtual time.

A ``Case`` states what the gateway must do with one fault of one simulated device, in a world of its own. A ``Bench`` has the
gateway's side of this world. Not included: the PLC's side (UDP), whose losses the tests of the gateway cover.
"""

from __future__ import annotations

import abc
import enum
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import can

from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.nmt import NmtCommand
from pdgw.ds301.node.node import GATEWAY_NODE_ID
from pdgw.durations import MS, SECOND
from pdgw.gateway.configuration.config import AxisConfig, GatewayConfig
from pdgw.gateway.configuration.tables.encoder import EncoderConfig
from pdgw.gateway.configuration.tables.environment import CanConfig, TransportConfig
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.reasons import FaultNumber
from pdgw.peers.node.node import SimulatedNode
from pdgw.peers.node.running import RunningNode
from pdgw.peers.world import World
from tests.long.conformance.tested import Tested

CYCLE_MS = 4
_HEARTBEAT_NS = 50 * MS
PATIENCE_S = 20.0
"""Longest time for one step, in seconds."""
CHANNEL = "conformance"
ENCODER_DO = 2
QUIET_CYCLES = 50
"""Number of cycles in which nothing may happen by itself."""
LOST, RESTARTED = FaultNumber.NODE_LOST, FaultNumber.NODE_RESTARTED
LOSSES = frozenset({LOST, RESTARTED, FaultNumber.STOP_IGNORED})
"""Fault numbers after which the device is lost. A drive that does not stop gets NMT Stop and is silent then."""
CONFIGURES = "NMT enter pre operational"
"""The gateway's first command of a configuration."""


class Device(enum.Enum):
    """The device of a drive object; the value is the text of the matrix."""

    DRIVE = "drive"
    ENCODER = "encoder"
    SENSOR = "encoder as G1 of a drive"


class Reaction(enum.Enum):
    """The required reaction; the value is the text of the matrix. The first four are of drives, the others of encoders."""

    STOPS = "power off at standstill, no restart"
    STANDS = "standstill, reason reported"
    GOES_ON = "stays in operation, OFF works"
    REFUSES = "never enabled"

    MEASURES = "position stays good"
    WARNS = "position stays good, warning while the cause is present"
    FAULT = "position stays good, fault until acknowledged"
    SENSOR_ERROR = "position invalid (G1_ZSW.15), fault until acknowledged"
    LOSES = "IOPS BAD, returns by itself, fault until acknowledged"
    NEVER_GOOD = "IOPS BAD until the fault is removed, then online by itself"
    G1_ERROR = "the drive stays in operation, G1 shows the error until acknowledged"
    G1_MISSING = "the drive stays in operation, G1 shows the error until the encoder is online"


class Activity(enum.Enum):
    """Activity of the device when the fault starts."""

    START = "from power-on"
    SPEED = "turning"
    HOMING = "homing"
    STOPPING = "turning, then OFF3"
    COMMISSIONING = "commissioning diagnostics"


@dataclass(frozen=True)
class Case:
    """One fault in one situation, and the required reaction."""

    fault: str
    reaction: Reaction
    numbers: tuple[int, ...] = ()
    """One of these fault numbers must be reported (P947, warnings P953). If empty, none may be reported."""
    activity: Activity = Activity.SPEED
    values: dict[str, int] = field(default_factory=dict)
    telegram: int = 1
    sdo_timeout_ms: int = 500
    device: Device = Device.DRIVE
    beside: dict[str, dict[str, int]] = field(default_factory=dict)
    """Further faults of the device from power-on, with their parameters."""

    @property
    def title(self) -> str:
        """The fault with its parameters that differ from the defaults."""
        chosen = "".join(f" {key}={value}" for key, value in self.values.items())
        beside = "".join(f" beside {name}{_plain(values)}" for name, values in self.beside.items())
        plain = 1 if self.device is Device.DRIVE else 3 if self.device is Device.SENSOR else 81
        return f"{self.fault}{chosen}{beside}" + (f", telegram {self.telegram}" if self.telegram != plain else "")


def _plain(values: dict[str, int]) -> str:
    return "".join(f" {key}={value}" for key, value in values.items())


@dataclass
class Result:
    """A row of the matrix."""

    case: Case
    sent: list[str] = field(default_factory=list)
    """Controlwords and NMT commands sent since the fault, without repetitions."""
    shown: list[str] = field(default_factory=list)
    """States of the encoder position shown since the fault, without repetitions."""
    numbers: list[int] = field(default_factory=list)
    reason: str = ""
    """Reason in ``pdgw status`` during the fault."""
    stopped: str = ""
    """How the drive stopped."""
    restarted: bool = False
    failures: list[str] = field(default_factory=list)
    """What is wrong; empty: passed."""
    tested: Tested | None = None

    @property
    def passed(self) -> bool:
        return not self.failures

    def require(self, holds: object, otherwise: str) -> None:
        """Store a failure unless a condition is true."""
        if not holds:
            self.failures.append(otherwise)

    def as_dict(self) -> dict[str, object]:
        """Plain data."""
        case = self.case
        return {
            "device": case.device.value,
            "fault": case.fault,
            "parameters": case.values,
            "beside": case.beside,
            "telegram": case.telegram,
            "activity": case.activity.value,
            "expected": case.reaction.value,
            "sent": self.sent,
            "shown": self.shown,
            "fault_numbers": self.numbers,
            "reason": self.reason,
            "stopped": self.stopped,
            "restarted": self.restarted,
            "passed": self.passed,
            "failures": self.failures,
        }


class StepError(Exception):
    """A step did not finish; the text names it."""


class Bench(abc.ABC):
    """The gateway's side of a world of its own, with its simulated devices."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.world = World()
        self.loop = self.world.loop
        self.can = CanConfig(interface="virtual", channel=CHANNEL)
        self.network = CanNetwork(self.loop, lambda: self.world.open_can(self.can))
        self.sent: list[str] = []
        self.objects: list[DriveObject] = []
        """In the order of processing; the first is that of the case."""
        self.devices: list[RunningNode[Any]] = []
        """The first has the fault of the case."""
        self.shown: list[str] = []
        """States of the encoder position shown to the PLC, without repetitions."""
        self.watchers: list[Callable[[int], None]] = []
        """Functions called after each cycle."""
        self._beat = 0
        self.network.listeners.append(self._listen)

    def power_on(self) -> None:
        """Start bus, devices with their faults from power-on, and clients."""
        case = self.case
        for name, values in case.beside.items():
            self.misbehave(name, values)
        if case.activity is Activity.START:
            self.misbehave()
        self.network.start()
        for device in self.devices:
            device.start()
        for item in self.objects:
            item.client.start()

    @contextmanager
    def running(self, result: Result) -> Iterator[None]:
        """Power on, and clean up at the end. A step that does not finish is a failure in the result."""
        result.tested = Tested.of(self.configuration, [device.node for device in self.devices])
        try:
            self.power_on()
            yield
        except StepError as error:
            result.failures.append(str(error))
        finally:
            if result.failures:
                result.numbers = self.numbers()
            self.close()

    def close(self) -> None:
        for item in self.objects:
            item.client.stop()
        for device in self.devices:
            device.stop()
        self.network.close()

    def misbehave(self, name: str | None = None, values: dict[str, int] | None = None) -> None:
        """Start the fault of the case, or another one."""
        fault = self.case.fault if name is None else name
        chosen = self.case.values if values is None else values
        self.devices[0].do(lambda node: node.misbehave(fault, **chosen))

    def behave(self, *, restart: bool = False) -> None:
        """End the fault, and restart a device that was rejected."""

        def mend(node: SimulatedNode) -> None:
            node.behave()
            if restart:
                node.restart()

        self.devices[0].do(mend)

    def note(self, result: Result) -> None:
        """Store what was sent, reported and shown during the fault."""
        result.sent, result.shown, result.numbers = list(self.sent), list(self.shown), self.numbers()
        result.reason = self.subject.reason.value if self.subject.reason else ""

    @property
    def configuration(self) -> GatewayConfig:
        """Configuration of a gateway with this bus and these drive objects."""
        configs = [item.config for item in self.objects]
        return GatewayConfig(
            can=(self.can,),
            transport=TransportConfig(cycle_time_ms=CYCLE_MS),
            axis=tuple(config for config in configs if isinstance(config, AxisConfig)),
            encoder=tuple(config for config in configs if isinstance(config, EncoderConfig)),
        )

    @property
    def subject(self) -> DriveObject:
        """The drive object of the case."""
        return self.objects[0]

    @abc.abstractmethod
    def setpoints(self) -> Sequence[Sequence[int]]:
        """The setpoints that the PLC sends to each object now."""

    def command_of(self, message: can.Message) -> str:
        """Describe a frame of the gateway, except NMT; empty for frames that do not matter."""
        return ""

    def _listen(self, message: can.Message) -> None:
        if message.is_rx:
            return
        data = bytes(message.data)
        if message.arbitration_id == 0 and len(data) == 2:
            text = f"NMT {NmtCommand(data[0]).name.lower().replace('_', ' ')}"
        else:
            text = self.command_of(message)
        if text and text not in self.sent[-1:]:
            self.sent.append(text)

    # -- time ---------------------------------------------------------------------------------------------------------

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.loop.run_for(CYCLE_MS * MS)
            now = self.loop.now()
            if now - self._beat >= _HEARTBEAT_NS:
                self._beat = now
                self.network.send_heartbeat(GATEWAY_NODE_ID)
            for item, values in zip(self.objects, self.setpoints(), strict=True):
                item.cycle(values, now)
            for watch in self.watchers:
                watch(now)

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Run cycles until a condition is true. StepError on timeout, or when the device is lost although its fault does not
        cause this.
        """
        deadline = self.loop.now() + int(PATIENCE_S * SECOND)
        while not condition():
            if self.lost:
                raise StepError(f"{what}: the device was lost meanwhile")
            if self.loop.now() > deadline:
                raise StepError(f"{what} not within {PATIENCE_S:g} s ({self.subject.client.status_text})")
            self.cycles(1)

    @property
    def lost(self) -> bool:
        """Whether the device was lost although its fault does not cause this."""
        return not LOSSES.intersection(self.case.numbers) and LOST in self.numbers()

    def has_reported(self, numbers: Iterable[int]) -> bool:
        """Whether the object has a record with one of the numbers; for a fault, also P947."""
        buffer = {entry.number for entry in self.subject.fault_log.entries()}
        return any(
            record.number in numbers and (record.is_warning or record.number in buffer)
            for record in self.subject.faults
        )

    def numbers(self) -> list[int]:
        """The numbers reported until now."""
        return list(dict.fromkeys(record.number for record in self.subject.faults))
