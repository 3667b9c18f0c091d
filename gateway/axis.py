"""One axis: a translator, a drive, and what watches both.

The axis owns the drive's images. Source: docs/translation.md "Loss and doubt".
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from concurrent.futures import Future
from types import MappingProxyType
from typing import Any

from canopen.sdo import SdoAbortedError
from pdgw.ds301.client import NodeClient
from pdgw.ds301.network import CanNetwork
from pdgw.dsp402.configuration import ABORT_OPTION
from pdgw.dsp402.drive import DriveClient, DriveStatus
from pdgw.dsp402.faults import DRIVE_FAULTS
from pdgw.dsp402.images import REFERENCE_OBJECTS
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.pdo import LAYOUTS
from pdgw.dsp402.states import STATE_OF_STATUS, Command, State, StatusBit, state_of
from pdgw.gateway.config import AxisConfig
from pdgw.gateway.drive_object import INTERNAL_FAULT, OWNED, DriveObject
from pdgw.gateway.encoder import DriveSensor, EncoderObject, SensorWords, has_sensor
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.faults import FaultRecord
from pdgw.gateway.reasons import Reason
from pdgw.gateway.translator.base import SdoWrite, Translator
from pdgw.gateway.translator.factory import DRIVE_TELEGRAM_NUMBERS, make_translator, pdo_operation
from pdgw.profidrive.sensor_format import SensorFormat
from pdgw.profidrive.telegrams import telegram

log = logging.getLogger("gateway")

_OWNED = OWNED | {ABORT_OPTION, (0x6040, 0), (0x6060, 0)}
_HOMING_METHOD = (0x6098, 0)
_REFERENCES = {(index, subindex) for _, index, subindex in REFERENCE_OBJECTS} | {_HOMING_METHOD}
_OWN_FORMAT = SensorFormat(resolution=0x1000, turns=0, xist1_absolute=False)
"""The drive's own position: 1000h increments per revolution, counted from power-on."""
_EMCY_PATIENCE_NS = 200_000_000
"""An EMCY may come so long before or after the Statusword that shows its fault."""
_FAULTY = (State.FAULT, State.FAULT_REACTION_ACTIVE)
_WATCHED = 0x7F | StatusBit.INTERNAL_LIMIT
_DISABLED = (State.SWITCHED_ON, State.READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED)
_POWERED = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)


class Axis(DriveObject):
    """A drive object (DO) with a drive behind it."""

    kind = "axis"
    fault_of_emcy = MappingProxyType({fault.error_code: fault.number for fault in DRIVE_FAULTS.values()})

    telegram_numbers = DRIVE_TELEGRAM_NUMBERS

    def __init__(
        self, config: AxisConfig, network: CanNetwork, cycle_time_ms: float, number: int | None = None
    ) -> None:
        number = config.telegram if number is None else number
        super().__init__(config.do_id, network, telegram(number))
        self.config: AxisConfig = config
        self._cycle_time_ms = cycle_time_ms
        self.translator = make_translator(number, config.translator_settings)
        self.drive = DriveClient(
            network,
            config.drive_settings(number, cycle_time_ms),
            LAYOUTS[pdo_operation(number)],
            self.on_node_event,
        )
        self._shown = 0
        self._fault_since = 0
        self._encoder: EncoderObject | None = None
        self._make_sensor()

    def connect_sensor(self, encoder: EncoderObject) -> None:
        """G1 is this encoder's channel instead of the drive's own position."""
        self._encoder = encoder
        self._make_sensor()

    def _make_sensor(self) -> None:
        self._sensor = SensorWords(self.telegram) if has_sensor(self.telegram) else None
        self._own_sensor = DriveSensor(self.drive)
        self._sensor_parameters: object = None
        if self._sensor is not None and self._encoder is None:
            self._sensor.channel.set_references(DriveSensor.references)

    @property
    def client(self) -> DriveClient:
        return self.drive

    @property
    def _translator(self) -> Translator:
        return self.translator

    # -- cyclic -------------------------------------------------------------------------------------------------------

    def step(self, setpoints: Sequence[int] | None, now: int) -> None:
        drive = self.drive
        translator = self.translator
        drive_ok = drive.refresh(now)
        if drive.generation != self._generation:
            self._generation = drive.generation
            translator.drive_restarted()
            translator.set_references(drive.references, drive.homing_method)
        elif self._references_changed:
            self._references_changed = False
            translator.set_references(drive.references, drive.homing_method)
        if setpoints is not None:
            self._take_setpoints(setpoints, now)
        commanded = translator.command.controlword
        self.actuals = translator.step(setpoints, drive.feedback, drive_ok, now)
        if self._sensor is not None:
            self._step_sensor(self._sensor, setpoints, drive_ok, now)
        drive.send(translator.command, now)
        shown = drive.feedback.statusword & _WATCHED if drive_ok else 0
        if shown != self._shown:
            self._status_changed(shown, commanded, now)
        if self._fault_since and now - self._fault_since >= _EMCY_PATIENCE_NS:
            self._fault_without_emcy()
        self._after_step(translator, drive_ok, now)

    def _step_sensor(self, sensor: SensorWords, setpoints: Sequence[int] | None, drive_ok: bool, now: int) -> None:
        encoder = self._encoder
        if encoder is None:
            values = sensor.step(setpoints, self._own_sensor, drive_ok, now, self._no_preset)
        else:
            if encoder.client.parameters is not self._sensor_parameters:
                self._sensor_parameters = encoder.client.parameters
                sensor.channel.set_references(encoder.references)
            ok = encoder.client.refresh(now)
            values = sensor.step(setpoints, encoder.input, ok, now, encoder.submit_write)
        actuals = list(self.actuals)
        actuals[sensor.first : sensor.first + len(values)] = values
        self.actuals = actuals

    @staticmethod
    def _no_preset(_: SdoWrite) -> Future[None]:
        raise GatewayError("the position of a drive has no preset")

    def _status_changed(self, shown: int, commanded: int, now: int) -> None:
        """Tell what the drive does of its own accord.

        ``shown``: the Statusword bits that are watched, 0 without a drive; ``commanded``: the Controlword it had.
        """
        old, self._shown = self._shown, shown
        self._reason_may_differ = True
        state, previous = STATE_OF_STATUS[shown & 0x7F], STATE_OF_STATUS[old & 0x7F]
        if state in _FAULTY and previous not in _FAULTY:
            self._fault_since = now
        if state is None and previous is not None:
            self._tell(107, f"Statusword {self.drive.feedback.statusword:04X}h", now)
        elif (
            previous is State.OPERATION_ENABLED
            and state in _DISABLED
            and Command.ENABLE_OPERATION.matches(commanded)
            and self.translator.reason is Reason.NEEDS_OFF
        ):
            self._tell(122, f"{state.value}, no command of the gateway", now)
        if state is State.OPERATION_ENABLED and shown & ~old & StatusBit.INTERNAL_LIMIT:
            self._tell(112, "limit switch, position or speed limit", now)

    def _fault_without_emcy(self) -> None:
        """The Statusword shows a fault that no EMCY told: its number and code are read from the drive."""
        since, self._fault_since = self._fault_since, 0
        if self._last_emergency < since - _EMCY_PATIENCE_NS:
            self.drive.submit(self._read_fault)

    def _read_fault(self, drive: DriveClient) -> None:
        numbers = []
        for index in (0x200C, 0x603F):
            try:
                numbers.append(drive.read_number(index))
            except SdoAbortedError:
                numbers.append(0)
        number, code = numbers
        text = f"Statusword {drive.feedback.statusword:04X}h shows a fault without an EMCY"
        self._record(FaultRecord(number or INTERNAL_FAULT, code, 0, text, drive.loop.now()))

    # -- beside the cycle -----------------------------------------------------------------------------------------------

    @property
    def powered(self) -> bool:
        """The power stage may be on."""
        return self.drive.status is DriveStatus.ONLINE and state_of(self.drive.feedback.statusword) in _POWERED

    @property
    def released(self) -> bool:
        return self.translator.released

    @property
    def faulty(self) -> bool:
        return state_of(self.drive.feedback.statusword) in _FAULTY

    @property
    def reason(self) -> Reason | None:
        reason = self.translator.reason
        if reason is None and self.drive.set_point_refused:
            return Reason.SET_POINT_REFUSED
        return Reason.INTERNAL_LIMIT if reason is None and self._shown & StatusBit.INTERNAL_LIMIT else reason

    @property
    def warning(self) -> bool:
        limited = bool(self._shown & StatusBit.INTERNAL_LIMIT)
        return self.translator.warning or limited or self.drive.set_point_refused

    def owns(self, index: int, subindex: int) -> bool:
        address = (index, subindex)
        if address in _OWNED:
            return True
        # The exchange with the drive runs whenever it is online, with or without a PLC: a value would not last.
        return any(address == (entry.index, entry.subindex) for pdo in self.drive.layout.rpdos for entry in pdo.entries)

    def is_reference(self, index: int, subindex: int) -> bool:
        return (index, subindex) in _REFERENCES

    def read_references(self, client: NodeClient[Any]) -> None:
        self.drive.read_references()
        self.drive.homing_method = self.drive.read_number(*_HOMING_METHOD, signed=True)

    @property
    def sensor_format(self) -> SensorFormat:
        """P979: what G1 is."""
        return self._encoder.sensor_format if self._encoder is not None else _OWN_FORMAT

    def set_sign_of_life_tolerance(self, failures: int) -> None:
        """The sign of life in STW2 of a drive is not supervised: there is nothing to set."""

    def entry_size(self, index: int, subindex: int) -> tuple[int, bool]:
        entry = DRIVE_OBJECTS.entry(index, subindex)
        return entry.type.bits // 8, entry.type.char.islower()

    def change_telegram(self, number: int) -> None:
        if self.powered:
            raise GatewayError(
                f"axis {self.do_id}: telegram {number} cannot be selected while the axis is in operation"
            )
        translator = make_translator(number, self.config.translator_settings)
        layout = LAYOUTS[pdo_operation(number)]
        self.translator = translator
        self.drive.reconfigure(layout, self.config.drive_settings(number, self._cycle_time_ms))
        self._telegram_changed(telegram(number))
        self._make_sensor()
