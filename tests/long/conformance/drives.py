"""Every fault of a simulated drive on an axis of the gateway: is it stopped and reported, and not started again?

Source: docs/translation.md "Losses". Rule of all cases: no drive enters Operation Enabled again before the PLC has sent a
new OFF and ON. With these it does.
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
from pdgw.peers.drive import DriveModel
from pdgw.peers.drive.device import EDS_PATH
from pdgw.profidrive.signals import signal
from tests.long.conformance import bench as rig

_NODE = 5
_NO_QUICK_STOP = signal("STW1").bit("NO_QUICK_STOP").mask
_OFF, _ON, _ACKNOWLEDGE, _START_HOMING = 0x047E, 0x047F, 0x80, 0x0800
_HOMING_HERE = 35
_HALF_SPEED = 0x2000
_TURNING_RPM = 500
_STANDING_CYCLES = 150
"""Cycles at standstill before the fault ends: longer than the detection of standstill."""

DRIVE_CASES: tuple[rig.Case, ...] = (
    rig.Case("slow-sdo", rig.Reaction.GOES_ON, activity=rig.Activity.START, values={"delay_ms": 10}),
    rig.Case("sdo-timeout", rig.Reaction.REFUSES, (121,), rig.Activity.START, sdo_timeout_ms=100),
    rig.Case("sdo-timeout", rig.Reaction.GOES_ON),
    rig.Case("sdo-toggle-error", rig.Reaction.REFUSES, (121,), rig.Activity.START),
    rig.Case("wrong-identity", rig.Reaction.REFUSES, (106,), rig.Activity.START),
    rig.Case("object-missing", rig.Reaction.REFUSES, (106,), rig.Activity.START),
    # The drive is built for telegram 1, so its mapping need not be written.
    rig.Case("fixed-pdo-mapping", rig.Reaction.GOES_ON, activity=rig.Activity.START),
    rig.Case("fixed-pdo-mapping", rig.Reaction.REFUSES, (106,), rig.Activity.START, telegram=9),
    rig.Case("mapping-abort", rig.Reaction.REFUSES, (106,), rig.Activity.START, telegram=9),
    rig.Case("two-pdos", rig.Reaction.GOES_ON, activity=rig.Activity.START, telegram=100),
    rig.Case("lost-pdos", rig.Reaction.GOES_ON),
    rig.Case("lost-pdos", rig.Reaction.STOPS, (101,), values={"every": 1}),
    rig.Case("lost-pdos", rig.Reaction.STOPS, (101,), values={"every": 1}, beside={"turns-in-pre-operational": {}}),
    rig.Case("duplicated-pdos", rig.Reaction.GOES_ON),
    rig.Case("late-pdos", rig.Reaction.GOES_ON),
    rig.Case("heartbeat-stops", rig.Reaction.REFUSES, (106,), rig.Activity.START),
    rig.Case("heartbeat-stops", rig.Reaction.STOPS, (101,)),
    rig.Case("emcy-burst", rig.Reaction.GOES_ON, (10,)),
    rig.Case("bus-off", rig.Reaction.STOPS, (101,)),
    rig.Case("error-passive", rig.Reaction.GOES_ON, (12,)),
    rig.Case("reboot", rig.Reaction.STOPS, (105,)),
    rig.Case("reboot", rig.Reaction.STOPS, (105,), telegram=100),
    rig.Case("no-homing-attained", rig.Reaction.STANDS, (109,), rig.Activity.HOMING, telegram=9),
    rig.Case("late-status", rig.Reaction.GOES_ON),
    rig.Case("bouncing-status", rig.Reaction.STOPS, (122,)),
    rig.Case("bouncing-status", rig.Reaction.STOPS, (122,), telegram=100),
    rig.Case("unknown-state", rig.Reaction.STOPS, (107,)),
    rig.Case("unknown-state", rig.Reaction.STOPS, (107,), telegram=100),
    rig.Case("mode-display-stuck", rig.Reaction.REFUSES, (106,), rig.Activity.START),
    rig.Case("mode-display-stuck", rig.Reaction.STANDS, (110,), rig.Activity.HOMING, telegram=9),
    rig.Case("limit-switch", rig.Reaction.STANDS, (112,)),
    rig.Case("enable-input-dropped", rig.Reaction.STOPS, (122,)),
    rig.Case("enable-input-dropped", rig.Reaction.STOPS, (122,), telegram=100),
    rig.Case("drive-fault", rig.Reaction.STOPS, (10,)),
    rig.Case("under-voltage", rig.Reaction.STOPS, (6,)),
    rig.Case("reboot-in-motion", rig.Reaction.STOPS, (105,)),
    rig.Case("deaf", rig.Reaction.STOPS, (125,), rig.Activity.STOPPING),
    rig.Case("stop-ramp-missing", rig.Reaction.STOPS, (125,), rig.Activity.STOPPING),
    rig.Case("turns-in-pre-operational", rig.Reaction.GOES_ON),
)
"""At least one case for each fault of a drive (checked by a test)."""


@dataclass
class _Trace:
    """Every state of the drive with its speed at entry, recorded in the drive."""

    states: list[tuple[State, float]] = field(default_factory=list)

    def __call__(self, model: DriveModel, now: int) -> None:
        if not self.states or self.states[-1][0] is not model.state:
            self.states.append((model.state, model.ramp.speed))

    def starts(self, since: int) -> int:
        """Number of entries to operation since an index."""
        return sum(state is State.OPERATION_ENABLED for state, _ in self.states[since:])

    def stopped_by(self, since: int, standing: bool) -> str:
        """Describe how the drive stopped after an index."""
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


class DriveBench(rig.Bench):
    """An axis of the gateway, a drive, and a PLC that sends ``values``."""

    def __init__(self, case: rig.Case) -> None:
        super().__init__(case)
        config = AxisConfig(
            do_id=1,
            node_id=_NODE,
            telegram=case.telegram,
            eds=EDS_PATH,
            sdo_timeout_ms=case.sdo_timeout_ms,
            g1=rig.ENCODER_DO if case.device is rig.Device.SENSOR else None,
        )
        self.axis = Axis(config, self.network, rig.CYCLE_MS)
        self.drive = self.world.drive(rig.CHANNEL, _NODE, powered=False)
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

    def state(self) -> State | None:
        return state_of(self.axis.drive.feedback.statusword)

    def online(self) -> None:
        self.until(lambda: self.axis.drive.status is DriveStatus.ONLINE and self.axis.good, "drive online")

    def standing(self) -> bool:
        return self.model.ramp.speed == 0.0

    def off(self) -> None:
        self.values[self.word] = 0x06 if self.case.telegram == 100 else _OFF

    def on(self) -> None:
        """Set the ON of a PLC whose OFF is done. Telegram 100 carries the Controlword itself."""
        self.values[self.word] = 0x0F if self.case.telegram == 100 else _ON

    def enable(self) -> None:
        """Acknowledge if there is a fault, then OFF, then ON until operation."""
        self.online()
        off = 0x06 if self.case.telegram == 100 else _OFF
        self.values[self.word] = off
        self.cycles(3)
        if self.state() is State.FAULT:
            self.values[self.word] = off | _ACKNOWLEDGE
            self.until(lambda: self.state() is not State.FAULT, "fault acknowledged")
            self.values[self.word] = off
        self.until(lambda: self.state() is State.READY_TO_SWITCH_ON, "ready to switch on")
        if self.case.telegram == 100:
            self.values[self.word] = 0x07
            self.until(lambda: self.state() is State.SWITCHED_ON, "switched on")
        self.on()
        self.until(lambda: self.state() is State.OPERATION_ENABLED, "operation")

    def turn(self) -> None:
        """Set half of the reference speed."""
        if self.case.telegram == 100:
            self.values |= {"Modes of Operation": Mode.VELOCITY, "Target Velocity": 3000}
            self.values |= {"Profile Acceleration": 1000, "Profile Deceleration": 1000}
        elif "NSOLL_B" in self.values:
            self.values["NSOLL_B"] = _HALF_SPEED << 16
        else:
            self.values["NSOLL_A"] = _HALF_SPEED
        self.until(lambda: abs(self.model.ramp.speed) > _TURNING_RPM, "turning")


def run_drive_case(case: rig.Case, result: rig.Result) -> None:
    """Run one case and store its result."""
    bench = DriveBench(case)
    with bench.running(result):
        if case.reaction is rig.Reaction.REFUSES:
            _refused(bench, result)
        else:
            _in_operation(bench, result)


def _refused(bench: DriveBench, result: rig.Result) -> None:
    """OFF and ON have no effect during the fault. After the fault, the still active ON has none either."""
    case = bench.case
    bench.off()
    bench.until(lambda: bench.has_reported(case.numbers), f"fault {case.numbers}")
    bench.cycles(3)
    bench.on()
    bench.cycles(rig.QUIET_CYCLES)
    bench.note(result)
    result.require(not bench.axis.good, "values are shown as good")
    result.require(result.reason, "no reason is shown")
    result.restarted = bench.trace.starts(0) > 0
    result.stopped = "never moved"
    _no_restart(bench, result, 0)
    bench.enable()


def _in_operation(bench: DriveBench, result: rig.Result) -> None:
    case = bench.case
    bench.online()
    bench.enable()
    if case.activity is not rig.Activity.HOMING:
        bench.turn()
    mark = len(bench.trace.states)
    bench.sent.clear()
    _set_in(bench)
    if case.reaction is rig.Reaction.STOPS:
        bench.until(lambda: bench.standing() and bench.model.state not in POWERED, "drive stopped")
    elif case.reaction is rig.Reaction.STANDS:
        bench.until(bench.standing, "drive stands")
    if case.numbers:
        bench.until(lambda: bench.has_reported(case.numbers), f"fault {case.numbers}")
    if rig.LOSSES.intersection(case.numbers):
        bench.until(lambda: rig.CONFIGURES in bench.sent, "configured again")
    bench.cycles(_STANDING_CYCLES if case.reaction is rig.Reaction.STANDS else rig.QUIET_CYCLES)
    bench.note(result)
    result.restarted = case.reaction is not rig.Reaction.GOES_ON and bench.trace.starts(mark) > 0
    result.stopped = bench.trace.stopped_by(mark, case.reaction is rig.Reaction.STANDS)
    if case.reaction is rig.Reaction.GOES_ON:
        _goes_on(bench, result, mark)
    elif case.reaction is rig.Reaction.STANDS:
        result.require(bench.standing(), "the axis moves again")
        result.require(bench.axis.reason is not None, "no reason is shown")
        bench.behave()
        bench.cycles(rig.QUIET_CYCLES)
        if not bench.standing():
            result.restarted = True
            result.failures.append("moves on by itself")
        bench.values[bench.word] = _OFF
        bench.until(lambda: bench.model.state not in POWERED, "OFF obeyed")
    else:
        result.require(bench.axis.reason is not None, "no reason is shown")
        bench.on()
        _no_restart(bench, result, mark)
    bench.enable()


def _set_in(bench: DriveBench) -> None:
    case = bench.case
    if case.activity is not rig.Activity.START:
        bench.misbehave()
    if case.activity is rig.Activity.STOPPING:
        bench.values[bench.word] &= ~_NO_QUICK_STOP
    if case.activity is rig.Activity.HOMING:
        bench.values["SATZANW"] = _HOMING_HERE
        bench.values["MDI_VELOCITY"] = 0x1000
        bench.values[bench.word] |= _START_HOMING


def _goes_on(bench: DriveBench, result: rig.Result, mark: int) -> None:
    if bench.trace.states[mark:]:
        names = ", ".join(state.value for state, _ in bench.trace.states[mark:])
        result.failures.append(f"operation was left: {names}")
    result.require(abs(bench.model.ramp.speed) >= _TURNING_RPM, "the drive does not turn any more")
    result.require(bench.case.numbers or not result.numbers, f"unexpected fault numbers: {result.numbers}")
    bench.off()
    bench.until(lambda: bench.standing() and bench.model.state not in POWERED, "OFF obeyed")
    bench.behave()


def _no_restart(bench: DriveBench, result: rig.Result, mark: int) -> None:
    """End the fault, and restart the device if it was rejected. The ON that stays active must not start it."""
    bench.behave(restart=bench.case.reaction is rig.Reaction.REFUSES)
    bench.online()
    bench.cycles(rig.QUIET_CYCLES)
    if bench.trace.starts(mark):
        result.restarted = True
        result.failures.append("started by itself")
