"""Machines stepped by hand: the words of a telegram and a drive's feedback in, actual values and a command out."""

from __future__ import annotations

from collections.abc import Sequence

from pdgw.ds301.node.node import NodeNotice, Notice
from pdgw.dsp402.drive.images import DriveCommand, DriveFeedback, attributes
from pdgw.dsp402.drive_type import DriveType
from pdgw.gateway.axis.adapters.adapter import POWER_BITS, WISHES
from pdgw.gateway.axis.demand_report import PowerWish
from pdgw.gateway.axis.encoder_machine import EncoderMachine
from pdgw.gateway.axis.executors.positions.telegram_9 import PositioningExecutor
from pdgw.gateway.axis.executors.sensor import DriveSensor, EncoderReferences
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.power_states import Drive
from pdgw.gateway.axis.settings import AxisSettings, SensorSettings
from pdgw.gateway.axis.values import Configured, EncoderInput, FaultRecord, SdoAnswer, SdoWrite
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.dsc_setpoint import DscChoices, DscForm
from pdgw.profidrive.telegrams import telegram
from tests.support.axis.positioner import CHOICES
from tests.support.drives.drive_types import References, engel

DSC = DscChoices(DscForm.SPEED, following_window=4096)

_FEEDBACK = attributes(DriveFeedback())


def wish_of(word: int) -> PowerWish:
    """What STW1 asks of the power stage."""
    return WISHES[word & POWER_BITS]


def step_interlock(
    interlock: Interlock, word: int, statusword: int, now: int, *, connected: bool = True, drive_ok: bool = True
) -> int:
    """One cycle of an interlock whose axis turns; returns the Controlword."""
    wish = wish_of(word) if connected else None
    acknowledge = bool(word & 0x80)
    interlock.step(wish, acknowledge, None if drive_ok else Drive.LOST, statusword, False, now)
    return interlock.controlword


class _Device:
    """What answers the SDO writes a machine asks for. ``events``: faults of all steps until now."""

    machine: AxisMachine | EncoderMachine
    events: list[FaultRecord]
    _answered: object = None

    @property
    def numbers(self) -> list[int]:
        """The numbers of these faults."""
        return [event.number for event in self.events]

    def sdo_done(self, error: str | None) -> None:
        """The writes asked for are taken, or not."""
        writes = self.machine.outputs.writes
        assert writes is not None
        self._answered = writes
        self.machine.inputs.news.append(SdoAnswer(writes, error))

    @property
    def sdo_request(self) -> tuple[SdoWrite, ...] | None:
        """What has not been answered yet."""
        writes = self.machine.outputs.writes
        return None if writes is self._answered else writes


class Stepper(_Device):
    """An axis machine. ``events``: faults of all steps until now."""

    machine: AxisMachine

    def __init__(self, number: int, settings: AxisSettings | None = None) -> None:
        self.feedback = DriveFeedback()
        self.machine = AxisMachine(
            telegram(number), settings or AxisSettings(cycle_ns=4_000_000, positioner=CHOICES, dsc=DSC), self.feedback
        )
        self.telegram = self.machine.telegram
        self.settings = self.machine.settings
        self.events: list[FaultRecord] = []
        self.drive_type: DriveType | None = None

    def set_references(self, references: References | None, homing_method: int = 0) -> None:
        """Read only the references of the ENGEL-like drive again."""
        self.set_drive(None if references is None else engel(references), homing_method)

    def set_drive(self, drive: DriveType | None, homing_method: int = 0) -> None:
        """Read only the description of the drive again."""
        self.drive_type = drive
        self.machine.inputs.news.append(Configured(drive, homing_method, restarted=False))

    def drive_restarted(self) -> None:
        self.machine.inputs.news.append(Configured(self.drive_type))

    def step(
        self,
        setpoints: Sequence[int] | None,
        feedback: DriveFeedback,
        drive_ok: bool,
        now: int,
        *,
        fresh: bool = True,
    ) -> Sequence[int]:
        inputs = self.machine.inputs
        inputs.fresh = fresh
        for name in _FEEDBACK:
            setattr(inputs.feedback, name, getattr(feedback, name))
        inputs.setpoints, inputs.drive_ok, inputs.now = setpoints, drive_ok, now
        outputs = self.machine.step()
        self.events += outputs.events.faults if outputs.events is not None else ()
        return tuple(outputs.actuals)

    @property
    def command(self) -> DriveCommand:
        return self.machine.outputs.command

    @property
    def reason(self) -> Reason | None:
        return self.machine.outputs.reason

    @property
    def warning(self) -> bool:
        """That of the executor; the drive's limit has its own."""
        return self.machine.outputs.warned != 0

    @property
    def saturations(self) -> int:
        return self.machine.outputs.saturations

    @property
    def power(self) -> Interlock:
        return self.machine.interlock

    @property
    def _positioning(self) -> PositioningExecutor:
        executor = self.machine.executor
        assert isinstance(executor, PositioningExecutor)
        return executor

    @property
    def home_position_set(self) -> bool:
        return self._positioning.positioner.home_set


class EncoderStepper(_Device):
    """An encoder machine. ``events``: faults of all steps until now."""

    machine: EncoderMachine

    def __init__(self, number: int, settings: SensorSettings) -> None:
        self.machine = EncoderMachine(number, settings, DriveSensor(DriveFeedback()))
        self.telegram = self.machine.telegram
        self.channel = self.machine.channel
        self.events: list[FaultRecord] = []

    def set_references(self, references: EncoderReferences | None) -> None:
        self.machine.set_references(references)

    def emergency(self, code: int, now: int) -> None:
        """An EMCY with an error came."""
        self.machine.inputs.news.append(NodeNotice(Notice.EMERGENCY, "EMCY", now, code, 1, bytes(5)))

    def step(self, setpoints: Sequence[int] | None, source: EncoderInput, ok: bool, now: int) -> Sequence[int]:
        inputs = self.machine.inputs
        inputs.source = source
        inputs.setpoints, inputs.ok, inputs.now = setpoints, ok, now
        outputs = self.machine.step()
        self.events += outputs.events.faults if outputs.events is not None else ()
        return tuple(outputs.actuals)

    @property
    def reason(self) -> Reason | None:
        return self.machine.outputs.reason

    @property
    def saturations(self) -> int:
        return self.machine.outputs.saturations
