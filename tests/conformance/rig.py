"""A gateway with simulated devices in a world of its own, and a PLC that sees only frames: what the tests have in common."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from typing import Any

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.communication import NmtCommand
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import State, state_of
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.configuration.file import config_text
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import DriveModel, SimulatedDrive
from pdgw.peers.drive.model.ramps import INCREMENTS_PER_REVOLUTION
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.peers.encoder.motion import Motion
from pdgw.peers.node.node import SimulatedNode
from pdgw.peers.node.running import RunningNode
from pdgw.peers.world import Member, Plc
from tests.conformance.fault_cases import LOSSES, Activity, Case
from tests.support.gateways.daemon import world_of
from tests.support.gateways.fault_display import FaultDisplay

COMPLETE = "PDGW_CONFORMANCE" in os.environ
"""All combinations (``make conformance``)."""
_CHANNEL = "world"
_NODE = 1
ENCODER_NODE = 20
QUIET_CYCLES = 50
"""Number of cycles in which nothing may happen by itself."""
PATIENCE_S = 20
"""Longest time for one step, in seconds."""
RPM = 750
"""A quarter of the rated speed."""
TURNS = 10 * INCREMENTS_PER_REVOLUTION
"""The end of a task of telegram 9."""
_TRANSIENT_NS = 100 * MS
_OFF, _ON, _FAULT_RESET = 0x047E, 0x047F, 0x80
_QUARTER = 0x1000
_FREE_RANGE = 1 << 30
"""100 % of a position without a range limit, in its units."""
_LIMITED_RANGE = 500_000


class Rig:
    """The gateway's first drive object is the subject; ``device`` is its simulated device, powered off."""

    def __init__(self, daemon: Daemon, device: RunningNode[Any]) -> None:
        self.daemon = daemon
        self.world = world_of(daemon)
        self.loop = self.world.loop
        self.plc = Plc(self.world, daemon)
        self.subject = daemon.objects[0]
        self.device = device
        self.sent: list[str] = []
        """Controlwords and NMT commands since the last ``clear``, without repetitions."""
        self.watchers: list[Callable[[], None]] = [self._look_for_reports, FaultDisplay(daemon, self.subject)]
        """Functions called after each cycle."""
        self.begun = 0
        """When the habit started."""
        self.reported: dict[int, int] = {}
        """When a fault number was reported first since then."""
        self.world.bus(str(daemon.config.can[0].channel)).taps.append(self._tap)
        print(config_text(daemon.config))

    def power_on(self, case: Case) -> None:
        """Power on the device with the faults that it has from power-on."""
        for name, values in case.beside.items():
            self.start_fault(name, values)
        if case.activity is Activity.START:
            self.start_fault(case.fault, case.values)
        self.device.start()

    def _look_for_reports(self) -> None:
        for record in self.subject.faults:
            self.reported.setdefault(record.number, self.loop.now())

    def start_fault(self, name: str, values: dict[str, int]) -> None:
        """Start a habit."""
        self.begun = self.loop.now()
        self.reported.clear()
        self.device.do(lambda node: node.start_fault(name, **values))

    def end_fault(self, *, restart: bool = False) -> None:
        """End the faults, and restart a device that was rejected."""

        def mend(node: SimulatedNode) -> None:
            node.end_fault()
            if restart:
                node.restart()

        self.device.do(mend)

    def command_of(self, can_id: int, data: bytes) -> str:
        """Describe a PDO of the gateway."""
        return f"CW {int.from_bytes(data[-2:], 'little'):04X}h" if can_id == 0x200 + _NODE else ""

    def _tap(self, _now: int, sender: Member, can_id: int, data: bytes) -> None:
        if sender.name != "gateway":
            return
        nmt = can_id == 0 and len(data) == 2
        text = f"NMT {NmtCommand(data[0]).name.lower().replace('_', ' ')}" if nmt else self.command_of(can_id, data)
        if text and text not in self.sent[-1:]:
            self.sent.append(text)

    # -- time ---------------------------------------------------------------------------------------------------------

    def cycles(self, count: int) -> None:
        """Exchange frames."""
        for _ in range(count):
            self.plc.exchange(0)
            for watch in self.watchers:
                watch()

    def run_out(self) -> None:
        """Let commands pass that may be as late as the latency of a drive."""
        self.cycles(_TRANSIENT_NS // self.daemon.cycle_ns)

    def reaches(self, condition: Callable[[], object]) -> bool:
        """Exchange frames until a condition is true; False on timeout."""
        deadline = self.loop.now() + PATIENCE_S * SECOND
        while not condition():
            if self.loop.now() > deadline:
                return False
            self.cycles(1)
        return True

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Exchange frames until a condition is true; AssertionError on timeout."""
        assert self.reaches(condition), f"{what} not within {PATIENCE_S} s ({self.subject.client.status_text})"

    # -- what the gateway reports -------------------------------------------------------------------------------------

    @property
    def numbers(self) -> list[int]:
        """The fault numbers reported until now."""
        return list(dict.fromkeys(record.number for record in self.subject.faults))

    def has_reported(self, numbers: Iterable[int]) -> bool:
        """Whether the subject has a record with one of the numbers; for a fault, also P947."""
        buffer = {entry.number for entry in self.subject.fault_log.entries()}
        return any(
            record.number in numbers and (record.is_warning or record.number in buffer)
            for record in self.subject.faults
        )

    def check_reports(self, case: Case) -> None:
        """During the fault: its number and its commands, and no loss of a device that answers."""
        if case.numbers:
            self.until(lambda: self.has_reported(case.numbers), f"fault {case.numbers}")
            texts = [record.text for record in self.subject.faults if record.number in case.numbers]
            assert any(case.says in text for text in texts), texts
            took = min(self.reported[number] for number in case.numbers if number in self.reported) - self.begun
            assert took <= case.within_ms * MS, f"reported after {took / MS} ms"
        assert LOSSES.intersection(case.numbers) or not LOSSES.intersection(self.numbers), "the device was lost"
        print(f"sent: {', '.join(self.sent)}; reported: {self.numbers}; reason: {self.reason}")
        sent = iter(self.sent)
        assert all(command in sent for command in case.sent), self.sent

    @property
    def reason(self) -> str:
        """The reason of the subject that ``pdgw status`` shows; empty if there is none."""
        shown = snapshot(self.daemon)
        items = (*shown["axes"], *shown["encoders"])
        return str(next(item["reason"] for item in items if item["do_id"] == self.subject.do_id) or "")


def drive(daemon: Daemon, **options: Any) -> SimulatedDrive:
    """A drive on the gateway's bus, powered off."""
    return world_of(daemon).drive(_CHANNEL, _NODE, powered=False, **options)


def encoder(daemon: Daemon, motion: Motion) -> SimulatedEncoder:
    """An encoder on the gateway's bus, powered off."""
    return world_of(daemon).encoder(_CHANNEL, ENCODER_NODE, powered=False, motions=[motion])


class DriveRig(Rig):
    """A drive on the first axis; the PLC acknowledges, switches off and on, and moves it."""

    def __init__(self, daemon: Daemon, drive: SimulatedDrive) -> None:
        super().__init__(daemon, drive)
        self.model = drive.model
        self.axis = daemon.axes[0]
        self.number = self.axis.telegram.number
        self.raw = self.number == 100
        """The PLC sends Controlwords."""
        self.word = self.axis.telegram.setpoints.names[0]
        self.states: list[tuple[State, float]] = []
        """Every state of the drive with its speed at entry, recorded in the drive."""
        self.model.disguises.append(self._record)

    def _record(self, model: DriveModel, _now: int) -> None:
        if not self.states or self.states[-1][0] is not model.state:
            self.states.append((model.state, model.speed))

    @property
    def state(self) -> State | None:
        """The state of the drive as the gateway sees it."""
        return state_of(self.axis.drive.feedback.statusword)

    @property
    def starts(self) -> int:
        """How often the drive entered operation."""
        return sum(state is State.OPERATION_ENABLED for state, _ in self.states)

    def standing(self) -> bool:
        return self.model.speed == 0.0

    def command(self, word: int) -> None:
        """Set the control word."""
        self.plc.set(0, {self.word: word})

    def off(self) -> None:
        self.command(0x06 if self.raw else _OFF)

    def on(self) -> None:
        """Send the ON of a PLC whose OFF is done."""
        self.command(0x0F if self.raw else _ON)

    def online(self) -> None:
        """Wait until the PLC sees valid actual values."""
        self.until(lambda: self.plc.actuals[0] is not None, "drive online")

    def enable(self) -> None:
        """Acknowledge until no fault is shown, then OFF and ON."""
        self.online()
        self.off()
        self.run_out()
        for _ in range(3):
            if self.state is State.FAULT or FaultNumber.VELOCITY in self.numbers:
                self.command(self.plc.endpoint.setpoints[0][self.word] | _FAULT_RESET)
                self.run_out()
                self.off()
                self.run_out()
        self.until(lambda: self.state is State.READY_TO_SWITCH_ON, "ready to switch on")
        if self.raw:
            self.command(0x07)
            self.until(lambda: self.state is State.SWITCHED_ON, "switched on")
        self.on()
        self.until(lambda: self.state is State.OPERATION_ENABLED, "operation")

    def move(self) -> None:
        """Set a quarter of the rated speed, or start a task over ten revolutions."""
        if self.number == 9:
            limits = self.axis.drive.drive_type
            free = limits is None or limits.scaling.position_range is None
            target = (TURNS << 30) // (_FREE_RANGE if free else _LIMITED_RANGE)
            task = {"SATZANW": 0x8000, "MDI_MOD": 1, "MDI_TARPOS": target, "MDI_VELOCITY": 1 << 29}
            self.plc.set(0, {**task, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000, "STW1": 0x043F})
            self.run_out()
            self.command(_ON)
        elif self.raw:
            ramps = {"Profile Velocity": 6000, "Profile Acceleration": 300, "Profile Deceleration": 300}
            self.plc.set(0, {"Modes of Operation": Mode.VELOCITY, "Target Velocity": 2 * RPM, **ramps})
        elif self.number == 3:
            self.plc.set(0, {"NSOLL_B": _QUARTER << 16})
        else:
            self.plc.set(0, {"NSOLL_A": _QUARTER})

    def turning(self) -> bool:
        return abs(self.model.speed) > RPM / 2

    def moved(self) -> bool:
        """Whether the shaft does what ``move`` commands, and the PLC sees it."""
        actuals = self.plc.actuals[0]
        if self.number == 9:
            return abs(self.model.position_actual - TURNS) <= 1
        if actuals is None or abs(self.model.speed - RPM) >= 1:
            return False
        if self.raw:
            return abs(actuals["Velocity Actual Value"] - 2 * RPM) <= 2
        shown = actuals["NIST_B"] >> 16 if self.number == 3 else actuals["NIST_A"]
        return abs(shown - _QUARTER) <= _QUARTER // 1000
