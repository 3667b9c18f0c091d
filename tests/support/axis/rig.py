"""A stepper and a simulated drive joined by real PDO bytes, in virtual time: deterministic and fast."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pdgw.base.durations import MS
from pdgw.ds301.communication import NmtCommand
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.pdo.layouts import with_objects
from pdgw.dsp402.states import State
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.telegrams import Kind, drive_layout, drive_telegram, initial_mode
from pdgw.gateway.motion.dsc_setpoint import DscForm
from pdgw.peers.drive import ENGEL, LINEAR_AXIS, Machine, SimulatedDriveNode
from pdgw.peers.drive.model.latency import NO_LATENCY, Latency
from pdgw.peers.drive.model.shapes import SYNCHRONOUS, Shape
from pdgw.peers.drive.objects import FAMILY
from pdgw.profidrive.telegrams import telegram
from tests.support.axis.mapping import pdo_steps
from tests.support.axis.stepper import Stepper
from tests.support.drives.drive_types import References

NODE = 5
CYCLE_MS = 4


class Rig:
    """``step`` runs PLC cycles of 4 ms; the drive runs every millisecond in between."""

    def __init__(
        self,
        number: int,
        machine: Machine | None = None,
        shape: Shape | None = None,
        latency: Latency = NO_LATENCY,
        **settings: object,
    ) -> None:
        self.stepper = Stepper(number, AxisSettings(**{"cycle_ns": CYCLE_MS * MS, **settings}))  # type: ignore[arg-type]
        dsc = self.stepper.settings.dsc
        self._form = DscForm.SPEED if dsc is None else dsc.form
        kind = SYNCHRONOUS if drive_telegram(telegram(number)).kind is Kind.DSC else ENGEL
        needs = drive_layout(telegram(number), self._form, self.stepper.settings.second_sensor)
        self.layout = with_objects(needs, FAMILY.entries)
        self.node = SimulatedDriveNode(
            NODE, self._transmitted, machine=machine or LINEAR_AXIS, shape=shape or kind, latency=latency
        )
        self.feedback = DriveFeedback()
        self.now = 0
        self.connected_drive = True
        self.values: dict[str, int] = dict.fromkeys(self.stepper.telegram.setpoints.names, 0)
        self.actuals: dict[str, int] = {}
        self.controlwords: list[int] = []
        """Every Controlword the drive was sent, in order, repetitions left out."""
        self.seen_statusword = 0
        """The Statusword the last translation was made from."""
        self.sdo_delay = 1
        self.sdo_error: str | None = None
        self._sdo_age = 0
        self._setpoints: Sequence[int] | None = None
        self._tpdos = {pdo.cob_id(NODE): pdo for pdo in self.layout.tpdos}
        self._sent: dict[int, bytes] = {}
        self.node.start(self.now)
        self._configure(initial_mode(telegram(number), self._form))
        self.stepper.set_references(References(), homing_method=35)

    @property
    def late_cycles(self) -> int:
        """Cycles between a command and its Statusword that the latency of the drive takes."""
        latency = self.node.model.latency
        return (latency.command_ms + latency.status_ms) // CYCLE_MS

    @property
    def model(self) -> object:
        return self.node.model

    @property
    def state(self) -> State:
        return self.node.model.state

    def _configure(self, mode: Mode | None) -> None:
        settings = DriveSettings(NODE)
        available = [i for i in self.node.indices if 0x1400 <= i < 0x1A00]
        for step in pdo_steps(
            self.layout, NODE, available, sync=False, event_ms=settings.tpdo_event_ms, inhibit_us=1000
        ):
            self.node.set_data(step.index, step.subindex, step.data, check_writable=True)
        if mode is not None:
            self.node.set_data(0x6060, 0, mode.to_bytes(1, "little", signed=True), check_writable=True)
        self._advance(2)
        self.node.receive(0, bytes((NmtCommand.START, NODE)), self.now)
        self._advance(2)

    def _transmitted(self, can_id: int, data: bytes) -> None:
        pdo = self._tpdos.get(can_id)
        if pdo is not None:
            pdo.unpack_into(data, self.feedback)

    def _advance(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.now += MS
            self.node.poll(self.now)

    def restart_drive(self) -> None:
        """Power cycle of the drive, and what the gateway does about it."""
        self.node.receive(0, bytes((NmtCommand.RESET_NODE, NODE)), self.now)
        self._sent.clear()
        self._configure(initial_mode(self.stepper.telegram, self._form))
        self.stepper.drive_restarted()
        self.stepper.set_references(References())

    def step(self, cycles: int = 1, *, plc: bool = True) -> dict[str, int]:
        """Run PLC cycles with the present setpoints; returns the actual values by name."""
        half = self.stepper.telegram.setpoints
        for _ in range(cycles):
            self._cycle(half.from_dict(self.values) if plc else None)
        return self.actuals

    def silent(self, cycles: int) -> dict[str, int]:
        """As ``step``, without new frames of the PLC: its watchdog has not expired."""
        for _ in range(cycles):
            self._cycle(self._setpoints, fresh=False)
        return self.actuals

    def _cycle(self, setpoints: Sequence[int] | None, *, fresh: bool = True) -> None:
        self._setpoints = setpoints
        self._advance(CYCLE_MS)
        self.seen_statusword = self.feedback.statusword
        actuals = self.stepper.step(setpoints, self.feedback, self.connected_drive, self.now, fresh=fresh)
        self.actuals = self.stepper.telegram.actuals.as_dict(actuals)
        self._send()
        self._serve_sdo()

    def _send(self) -> None:
        command = self.stepper.command
        if not self.controlwords or self.controlwords[-1] != command.controlword:
            self.controlwords.append(command.controlword)
        for pdo in sorted(self.layout.rpdos, key=lambda item: -item.number):
            data = pdo.pack(command)
            if self._sent.get(pdo.number) != data:
                self._sent[pdo.number] = data
                self.node.receive(pdo.cob_id(NODE), data, self.now)

    def _serve_sdo(self) -> None:
        request = self.stepper.sdo_request
        if request is None:
            self._sdo_age = 0
            return
        self._sdo_age += 1
        if self._sdo_age < self.sdo_delay:
            return
        if self.sdo_error is None:
            for item in request:
                entry = DRIVE_OBJECTS.entry(item.index, item.subindex)
                size = entry.type.bits // 8
                data = item.value.to_bytes(size, "little", signed=entry.type.char.islower())
                self.node.set_data(item.index, item.subindex, data, check_writable=True)
        self.stepper.sdo_done(self.sdo_error)

    def until(self, condition: Callable[[dict[str, int]], bool], cycles: int = 5000) -> int:
        """Step until the actual values meet a condition; returns the cycles, fails when it never does."""
        for cycle in range(cycles):
            if condition(self.step()):
                return cycle
        raise AssertionError(f"not met in {cycles} cycles: {self.actuals}, {self.stepper.reason}")

    def enable(self, off: int = 0x043E) -> None:
        """OFF, then ON."""
        word = self.stepper.telegram.setpoints.names[0]
        self.values[word] = off
        late = self.late_cycles
        self.step(4 + 2 * late)
        self.values[word] = off | 1
        self.until(lambda _: self.state is State.OPERATION_ENABLED, 20 + 3 * late)
        self.step(2 + late)
