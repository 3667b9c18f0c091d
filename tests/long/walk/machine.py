"""The axis machine as a transducer: states, inputs and outputs have numbers; each transition is computed once and stored."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence

from pdgw.base.durations import SECOND
from pdgw.ds301.node.node import NodeNotice, Notice
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive_type import DriveType
from pdgw.gateway.axis.demand_report import Flag
from pdgw.gateway.axis.interlock import _limits
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.orders import Brake
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.values import Configured, SdoAnswer
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.profidrive.sign_of_life import following
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram
from tests.long.walk.checkpoint import Checkpoint, Checkpoints
from tests.long.walk.plc import HOMING_METHOD
from tests.long.walk.values import Answered, Life, Numbered, Output, Plc, Shown

_START = 1000 * SECOND
"""Time of the first step, late enough for every age."""
_LIFE = signal("STW2").bit("SIGN_OF_LIFE").position


class Transducer:
    """One axis with one drive. State 0 is a newly configured machine that has seen no PLC."""

    def __init__(
        self,
        number: int,
        settings: AxisSettings,
        drive: DriveType,
        tick_ns: int,
        inputs: Iterable[tuple[Plc, Shown]] = (),
        *,
        guarding: bool = False,
        on_ns: int = 0,
        polled: bool = False,
    ) -> None:
        """``on_ns``: the longest time of an ON, without that of a brake; 0: that of the settings. ``polled``: the speed is read
        by SDO."""
        self._machine = AxisMachine(telegram(number), settings, DriveFeedback())
        if on_ns:
            self._machine.interlock._commanded.limits = _limits(settings.latency_ns, on_ns)
        self._drive = drive
        self._tick = tick_ns
        self._checkpoints = Checkpoints(self._machine, any_counter=True, stops=guarding, data=False)
        self._guarding = guarding
        self._polled = polled
        self._fingerprints = Numbered[Hashable]()
        self._states: list[Checkpoint] = []
        self._rows: list[dict[int, tuple[int, int]]] = []
        self.inputs = Numbered[tuple[Plc, Shown]]()
        self.outputs = Numbered[Output]()
        for item in inputs:
            self.inputs.number(item)
        self._machine.inputs.now = _START
        self._step(Plc("", None), Shown("", 0, restarted=True))
        self._number()

    def __len__(self) -> int:
        return len(self._states)

    def step(self, state: int, number: int) -> tuple[int, int]:
        """One cycle from a state with an input: the next state, and the number of the output."""
        row = self._rows[state]
        found = row.get(number)
        if found is None:
            self._checkpoints.restore(self._states[state])
            output = self._step(*self.inputs[number])
            found = row[number] = self._number(), self.outputs.number(output)
        return found

    def _number(self) -> int:
        number = self._fingerprints.number(self._checkpoints.fingerprint())
        if number == len(self._states):
            self._states.append(self._checkpoints.save())
            self._rows.append({})
        return number

    def _setpoints(self, plc: Plc) -> Sequence[int] | None:
        """The setpoints with the next or an unchanged sign of life."""
        life = self._machine.life
        if plc.setpoints is None or plc.life is Life.NONE or life is None:
            return plc.setpoints
        last = life.counters.received
        counter = following(last) if plc.life is Life.COUNTS else last
        place = self._machine.telegram.setpoints.index("STW2")
        return *plc.setpoints[:place], plc.setpoints[place] | counter << _LIFE, *plc.setpoints[place + 1 :]

    def _step(self, plc: Plc, shown: Shown) -> Output:
        inputs = self._machine.inputs
        inputs.now += self._tick if shown.after_ns is None else shown.after_ns
        inputs.setpoints, inputs.fresh = self._setpoints(plc), plc.fresh
        inputs.drive_ok, inputs.node_stopped = shown.ok, shown.stopped
        feedback = inputs.feedback
        feedback.statusword, feedback.velocity_actual = shown.statusword, shown.velocity
        feedback.modes_of_operation_display, feedback.position_actual = shown.mode, shown.position
        if self._polled and shown.answered is not Answered.NONE:
            late = self._tick * 3 // 2
            asked = inputs.now - (late if shown.answered is Answered.LATE else 1)
            if asked > inputs.speed_asked_ns:
                inputs.speed_asked_ns, inputs.speed_until_ns = asked, asked + late
        if shown.restarted:
            inputs.news.append(Configured(self._drive, HOMING_METHOD))
        if shown.found_off:
            inputs.news.append(NodeNotice(Notice.OFF, "", inputs.now))
        writes = self._machine.outputs.writes
        if shown.answer is not None and writes is not None:
            inputs.news.append(SdoAnswer(writes, shown.answer or None))
        self._checkpoints.step()
        return self._output()

    def _output(self) -> Output:
        outputs = self._machine.outputs
        command = outputs.command
        return Output(
            command.controlword,
            command.target_velocity,
            command.modes_of_operation,
            outputs.actuals[0] & ~Flag.WITHIN_TOLERANCE,  # of which the supervision may remove it
            "" if outputs.reason is None else outputs.reason.name,
            any(
                fault.number == FaultNumber.ENABLE_UNASKED
                for fault in (outputs.events.faults if outputs.events is not None else ())
            ),
            outputs.brake if self._guarding else Brake.NONE,
        )
