"""Every fault a simulated drive can be given, against an axis of the gateway: is it stopped, told, and not started again?

Source: docs/translation.md "Losses". What has to hold in every case: nothing enters Operation Enabled again before the
PLC has given a new OFF and ON, and with these it does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import can

from pdgw.dsp402.drive.client import DriveStatus
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import State, state_of
from pdgw.gateway.axis.supervision.drive_events import POWERED
from pdgw.gateway.configuration.config import AxisConfig
from pdgw.gateway.objects.axis import Axis
from pdgw.peers.drive import DriveModel, SimulatedDriveNode
from pdgw.peers.drive.device import EDS_PATH
from pdgw.profidrive.signals import signal
from pdgw.workshop.conformance.bench import (
    CHANNEL,
    CONFIGURES,
    CYCLE_MS,
    ENCODER_DO,
    LOSSES,
    QUIET_CYCLES,
    Activity,
    Bench,
    Case,
    Device,
    Reaction,
    Result,
)

_NODE = 5
_NO_QUICK_STOP = signal("STW1").bit("NO_QUICK_STOP").mask
_OFF, _ON, _ACKNOWLEDGE, _START_HOMING = 0x047E, 0x047F, 0x80, 0x0800
_HOMING_HERE = 35
_HALF_SPEED = 0x2000
_TURNING_RPM = 500
_STANDING_CYCLES = 150
"""So long an axis stands before the fault goes: longer than what takes it for stopped."""

DRIVE_CASES: tuple[Case, ...] = (
    Case("slow-sdo", Reaction.GOES_ON, activity=Activity.START, values={"delay_ms": 10}),
    Case("sdo-timeout", Reaction.REFUSES, (121,), Activity.START, sdo_timeout_ms=100),
    Case("sdo-timeout", Reaction.GOES_ON),
    Case("sdo-toggle-error", Reaction.REFUSES, (121,), Activity.START),
    Case("wrong-identity", Reaction.REFUSES, (106,), Activity.START),
    Case("object-missing", Reaction.REFUSES, (106,), Activity.START),
    # Made for telegram 1, the mapping need not be written.
    Case("fixed-pdo-mapping", Reaction.GOES_ON, activity=Activity.START),
    Case("fixed-pdo-mapping", Reaction.REFUSES, (106,), Activity.START, telegram=9),
    Case("mapping-abort", Reaction.REFUSES, (106,), Activity.START, telegram=9),
    Case("two-pdos", Reaction.GOES_ON, activity=Activity.START, telegram=100),
    Case("lost-pdos", Reaction.GOES_ON),
    Case("lost-pdos", Reaction.STOPS, (101,), values={"every": 1}),
    Case("lost-pdos", Reaction.STOPS, (101,), values={"every": 1}, beside={"turns-in-pre-operational": {}}),
    Case("duplicated-pdos", Reaction.GOES_ON),
    Case("late-pdos", Reaction.GOES_ON),
    Case("heartbeat-stops", Reaction.REFUSES, (106,), Activity.START),
    Case("heartbeat-stops", Reaction.STOPS, (101,)),
    Case("emcy-burst", Reaction.GOES_ON, (10,)),
    Case("bus-off", Reaction.STOPS, (101,)),
    Case("error-passive", Reaction.GOES_ON, (12,)),
    Case("reboot", Reaction.STOPS, (105,)),
    Case("reboot", Reaction.STOPS, (105,), telegram=100),
    Case("no-homing-attained", Reaction.STANDS, (109,), Activity.HOMING, telegram=9),
    Case("late-status", Reaction.GOES_ON),
    Case("bouncing-status", Reaction.STOPS, (122,)),
    Case("bouncing-status", Reaction.STOPS, (122,), telegram=100),
    Case("unknown-state", Reaction.STOPS, (107,)),
    Case("unknown-state", Reaction.STOPS, (107,), telegram=100),
    Case("mode-display-stuck", Reaction.REFUSES, (106,), Activity.START),
    Case("mode-display-stuck", Reaction.STANDS, (110,), Activity.HOMING, telegram=9),
    Case("limit-switch", Reaction.STANDS, (112,)),
    Case("enable-input-dropped", Reaction.STOPS, (122,)),
    Case("enable-input-dropped", Reaction.STOPS, (122,), telegram=100),
    Case("drive-fault", Reaction.STOPS, (10,)),
    Case("under-voltage", Reaction.STOPS, (6,)),
    Case("reboot-in-motion", Reaction.STOPS, (105,)),
    Case("deaf", Reaction.STOPS, (125,), Activity.STOPPING),
    Case("stop-ramp-missing", Reaction.STOPS, (125,), Activity.STOPPING),
    Case("turns-in-pre-operational", Reaction.GOES_ON),
)
"""At least one for each fault of a drive (a test)."""


@dataclass
class _Trace:
    """Every state of the drive with its speed on entering it, seen from inside the drive."""

    states: list[tuple[State, float]] = field(default_factory=list)

    def __call__(self, model: DriveModel, now: int) -> None:
        if not self.states or self.states[-1][0] is not model.state:
            self.states.append((model.state, model.ramp.speed))

    def starts(self, since: int) -> int:
        """How often operation was entered from an index on."""
        return sum(state is State.OPERATION_ENABLED for state, _ in self.states[since:])

    def stopped_by(self, since: int, standing: bool) -> str:
        """How the drive stopped after an index, in words."""
        left = self.states[since:]
        if not left:
            return "by the drive, power on" if standing else "no need"
        for state, speed in left:
            if state is State.QUICK_STOP_ACTIVE:
                return "quick stop"
            if state is State.FAULT_REACTION_ACTIVE:
                return "fault reaction"
            if state not in POWERED and speed:
                return "coast"
        return "at standstill"


class DriveBench(Bench):
    """An axis of the gateway, a drive, and a PLC whose setpoints are ``values``."""

    def __init__(self, case: Case) -> None:
        super().__init__(case)
        config = AxisConfig(
            do_id=1,
            node_id=_NODE,
            telegram=case.telegram,
            eds=EDS_PATH,
            sdo_timeout_ms=case.sdo_timeout_ms,
            g1=ENCODER_DO if case.device is Device.SENSOR else None,
        )
        self.axis = Axis(config, self.network, CYCLE_MS)
        self.drive = self.world.drive(CHANNEL, _NODE, powered=False)
        self.objects.append(self.axis)
        self.devices.append(self.drive)
        self.values = dict.fromkeys(self.axis.telegram.setpoints.names, 0)
        self.word = self.axis.telegram.setpoints.names[0]
        self.trace = _Trace()
        self.model.disguises.append(self.trace)

    @property
    def model(self) -> DriveModel:
        return self.drive.model

    def setpoints(self) -> Sequence[Sequence[int]]:
        return [self.axis.telegram.setpoints.from_dict(self.values)]

    def command_of(self, message: can.Message) -> str:
        if message.arbitration_id != 0x200 + _NODE:
            return ""
        return f"CW {int.from_bytes(bytes(message.data)[-2:], 'little'):04X}h"

    # -- the PLC ------------------------------------------------------------------------------------------------------

    def shown(self) -> State | None:
        return state_of(self.axis.drive.feedback.statusword)

    def online(self) -> None:
        self.until(lambda: self.axis.drive.status is DriveStatus.ONLINE and self.axis.good, "drive online")

    def standing(self) -> bool:
        return self.model.ramp.speed == 0.0

    def off(self) -> None:
        self.values[self.word] = 0x06 if self.case.telegram == 100 else _OFF

    def on(self) -> None:
        """The ON of a PLC that has done everything before; telegram 100 carries the Controlword itself."""
        self.values[self.word] = 0x0F if self.case.telegram == 100 else _ON

    def enable(self) -> None:
        """Acknowledge if there is a fault, OFF, ON: operation."""
        self.online()
        off = 0x06 if self.case.telegram == 100 else _OFF
        self.values[self.word] = off
        self.cycles(3)
        if self.shown() is State.FAULT:
            self.values[self.word] = off | _ACKNOWLEDGE
            self.until(lambda: self.shown() is not State.FAULT, "fault acknowledged")
            self.values[self.word] = off
        self.until(lambda: self.shown() is State.READY_TO_SWITCH_ON, "ready to switch on")
        if self.case.telegram == 100:
            self.values[self.word] = 0x07
            self.until(lambda: self.shown() is State.SWITCHED_ON, "switched on")
        self.on()
        self.until(lambda: self.shown() is State.OPERATION_ENABLED, "operation")

    def turn(self) -> None:
        """Half of the reference speed."""
        if self.case.telegram == 100:
            self.values |= {"Modes of Operation": Mode.VELOCITY, "Target Velocity": 3000}
            self.values |= {"Profile Acceleration": 1000, "Profile Deceleration": 1000}
        elif "NSOLL_B" in self.values:
            self.values["NSOLL_B"] = _HALF_SPEED << 16
        else:
            self.values["NSOLL_A"] = _HALF_SPEED
        self.until(lambda: abs(self.model.ramp.speed) > _TURNING_RPM, "turning")


def run_drive_case(case: Case, result: Result) -> None:
    """Run one case into its result."""
    bench = DriveBench(case)
    with bench.running(result):
        if case.reaction is Reaction.REFUSES:
            _refused(bench, result)
        else:
            _in_operation(bench, result)


def _refused(bench: DriveBench, result: Result) -> None:
    """OFF and ON have no effect while the fault stands; without it the standing ON has none either."""
    case = bench.case
    bench.off()
    bench.until(lambda: bench.told(case.numbers), f"fault {case.numbers}")
    bench.cycles(3)
    bench.on()
    bench.cycles(QUIET_CYCLES)
    _note(bench, result, 0)
    if bench.axis.good:
        result.failures.append("values are shown as good")
    if not result.reason:
        result.failures.append("no reason is shown")
    result.stopped = "never moved"
    _no_restart(bench, result, 0)
    bench.enable()


def _in_operation(bench: DriveBench, result: Result) -> None:
    case = bench.case
    bench.online()
    bench.enable()
    if case.activity is not Activity.HOMING:
        bench.turn()
    mark = len(bench.trace.states)
    bench.sent.clear()
    _set_in(bench)
    if case.reaction is Reaction.STOPS:
        bench.until(lambda: bench.standing() and bench.model.state not in POWERED, "drive stopped")
    elif case.reaction is Reaction.STANDS:
        bench.until(bench.standing, "drive stands")
    if case.numbers:
        bench.until(lambda: bench.told(case.numbers), f"fault {case.numbers}")
    if LOSSES.intersection(case.numbers):
        bench.until(lambda: CONFIGURES in bench.sent, "configured again")
    bench.cycles(_STANDING_CYCLES if case.reaction is Reaction.STANDS else QUIET_CYCLES)
    _note(bench, result, mark)
    result.stopped = bench.trace.stopped_by(mark, case.reaction is Reaction.STANDS)
    if case.reaction is Reaction.GOES_ON:
        _goes_on(bench, result, mark)
    elif case.reaction is Reaction.STANDS:
        if not bench.standing():
            result.failures.append("the axis moves again")
        if bench.axis.reason is None:
            result.failures.append("no reason is shown")
        bench.drive.do(lambda node: node.behave())
        bench.cycles(QUIET_CYCLES)
        if not bench.standing():
            result.restarted = True
            result.failures.append("moves on by itself")
        bench.values[bench.word] = _OFF
        bench.until(lambda: bench.model.state not in POWERED, "OFF obeyed")
    else:
        if bench.axis.reason is None:
            result.failures.append("no reason is shown")
        bench.on()
        _no_restart(bench, result, mark)
    bench.enable()


def _set_in(bench: DriveBench) -> None:
    case = bench.case
    if case.activity is not Activity.START:
        bench.misbehave()
    if case.activity is Activity.STOPPING:
        bench.values[bench.word] &= ~_NO_QUICK_STOP
    if case.activity is Activity.HOMING:
        bench.values["SATZANW"] = _HOMING_HERE
        bench.values["MDI_VELOCITY"] = 0x1000
        bench.values[bench.word] |= _START_HOMING


def _goes_on(bench: DriveBench, result: Result, mark: int) -> None:
    if bench.trace.states[mark:]:
        names = ", ".join(state.value for state, _ in bench.trace.states[mark:])
        result.failures.append(f"operation was left: {names}")
    if abs(bench.model.ramp.speed) < _TURNING_RPM:
        result.failures.append("the drive does not turn any more")
    if result.numbers and not bench.case.numbers:
        result.failures.append(f"told without need: {result.numbers}")
    bench.off()
    bench.until(lambda: bench.standing() and bench.model.state not in POWERED, "OFF obeyed")
    bench.drive.do(lambda node: node.behave())


def _note(bench: DriveBench, result: Result, mark: int) -> None:
    """What was sent, told and shown while the fault stood."""
    result.sent = list(bench.sent)
    result.numbers = bench.numbers()
    result.reason = bench.axis.reason.value if bench.axis.reason else ""
    if bench.case.reaction is not Reaction.GOES_ON and bench.trace.starts(mark):
        result.restarted = True


def _no_restart(bench: DriveBench, result: Result, mark: int) -> None:
    """The device behaves again and boots if it was refused; the ON that stands all the time starts nothing."""

    def mend(node: SimulatedDriveNode) -> None:
        node.behave()
        if bench.case.reaction is Reaction.REFUSES:
            node.restart()

    bench.drive.do(mend)
    bench.online()
    bench.cycles(QUIET_CYCLES)
    if bench.trace.starts(mark):
        result.restarted = True
        result.failures.append("started by itself")
