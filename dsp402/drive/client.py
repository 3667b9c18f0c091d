"""The drive client: brings one CiA 402 drive into operation on a bus and keeps watching it.

The cyclic side (``refresh``, ``send``) never blocks; what every node needs is in ``ds301.node.client``, this adds the RPDOs, the
guarding of the gateway by the drive, mode of operation and references. A setpoint starts nothing before its data is in the
drive (docs/translation.md "PDO layouts"), which takes SDO writes where the drive has too few RPDOs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import canopen
from canopen.sdo import SdoAbortedError

from pdgw.ds301.aborts import NOT_THERE, abort_text
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import (
    DEVICE_TYPE,
    IDENTITY_PRODUCT,
    IDENTITY_SERIAL,
    IDENTITY_VENDOR,
    RESTORE_PARAMETERS,
    SYNC_PERIOD,
    profile_of,
)
from pdgw.ds301.configuration import SdoStep
from pdgw.ds301.eds.data_sheet import load_dictionary
from pdgw.ds301.node.client import NodeClient
from pdgw.ds301.node.node import NodeEvent, NodeStatus, TpdoSlot
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.objects import CanType
from pdgw.ds301.pdo import Pdo, PdoLayout
from pdgw.dsp402.drive.configuration import interpolation_steps
from pdgw.dsp402.drive.guarding import Guarding, guard
from pdgw.dsp402.drive.images import DriveCommand, DriveFeedback
from pdgw.dsp402.drive.own_values import OwnValueKeeper
from pdgw.dsp402.drive.rpdos import RpdoSender
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.errors import Dsp402Error
from pdgw.dsp402.identification.describe import OPTIONAL_OBJECTS, describe, questions, signed
from pdgw.dsp402.identification.generic import dictionary_of, generic_dictionary
from pdgw.dsp402.indices import INTERPOLATION_TIME, POSITION_ACTUAL
from pdgw.dsp402.modes import MODE_CONFIRM_NS, Mode
from pdgw.dsp402.objects import (
    CONTROLWORD,
    DRIVE_PROFILE,
    HOMING_METHOD,
    MAX_TORQUE,
    MODE,
    MODE_DISPLAY,
    STATUSWORD,
)
from pdgw.dsp402.pdo.layouts import interpolated
from pdgw.dsp402.pdo.mapping import DriveMapping
from pdgw.dsp402.pdo.value_check import PdoValueCheck
from pdgw.dsp402.states import Command, ControlBit, FaultReset, State, state_of
from pdgw.dsp402.units.unit_watch import UnitWatch
from pdgw.durations import MS, SECOND, US_PER_MS

DriveStatus = NodeStatus
DriveEvent = NodeEvent
_SPEED_MODES: Final = (Mode.VELOCITY, Mode.CYCLIC_VELOCITY, Mode.VL_VELOCITY)
_NO_MODE: Final = 0
_LIMITS_AND_RAMPS: Final = frozenset(
    {
        "dynamic_speed_limit",
        "dynamic_torque_limit",
        "max_torque",
        "profile_acceleration",
        "profile_deceleration",
        "profile_velocity",
        "velocity_offset",
    }
)
"""Objects that also act on a drive whose RPDOs do not carry them."""
_VALUE_CHECK_NS: Final = SECOND
"""So often is a TPDO that does not change compared with its objects."""
_INTERPOLATED: Final = (
    "traversing tasks: no profile position mode (6502h); the gateway calculates a position for each SYNC (mode 8)"
)
_SDO_STEP: Final = 5
"""A step between two positions by SDO is at least this factor longer than an answer takes. The moment of the reading within
that time is unknown.
"""
_RETRY_VALUE_NS: Final = 1000 * MS
"""Time after which a failed SDO write is repeated."""
_NEW_SETPOINT: Final = ControlBit.NEW_SETPOINT
_OFF: Final = (State.NOT_READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.FAULT)
"""States of a drive that has no power, and gets none without two commands."""


def load_eds(path: Path, node_id: int) -> canopen.ObjectDictionary:
    """The object dictionary of a user's EDS/DCF; Dsp402Error names the file and what is wrong with it."""
    return load_dictionary(path, node_id, (DEVICE_TYPE, CONTROLWORD[0], STATUSWORD[0]), "a drive", Dsp402Error)


class DriveClient(NodeClient[DriveSettings]):
    """One drive. ``on_event`` is called whenever something happens to it that the owner must know."""

    device = "drive"
    a_device = "a drive"
    profile = DRIVE_PROFILE
    error_type = Dsp402Error

    def __init__(
        self,
        network: CanNetwork,
        settings: DriveSettings,
        layout: PdoLayout,
        on_event: Callable[[DriveEvent], None],
    ) -> None:
        self.feedback = DriveFeedback()
        self.drive_type: DriveType | None = None
        """The type of the drive, made again at each start and after a write to an object it depends on."""
        self.homing_method = 0
        self.guarding: Guarding | None = None
        """What stops this drive when the gateway dies; None before its first start."""
        self.serial_number = 0
        """1018h/4; 0 for a drive without one."""
        self._identity: tuple[int, int] | None = None
        """Vendor-ID and product code of the device whose objects were found out,"""
        self._device = (0, 0)
        """and of the one that is there."""
        node_id = settings.node_id
        self.rpdos = RpdoSender(network, layout.rpdos[0], node_id, self.feedback, self._wake_up, self._tell)
        """What is sent of each command."""
        self._mapping = DriveMapping(self.read_number)
        self._mode_wrong = ""
        self._operating_since = -1
        self._value_check = PdoValueCheck(())
        self._value_check_due = 0
        self._dropped = ""
        self._units = UnitWatch({})
        self.own_values = OwnValueKeeper(self._read_if_present, self.write, self._tell)
        """The drive's values of limits and ramps that the gateway overwrites."""
        self._is_off = False
        """The drive was without power when it was found."""
        self._position_slot: TpdoSlot | None = None
        """The TPDO with the position."""
        dictionary = load_eds(settings.eds, node_id) if settings.eds else generic_dictionary()
        super().__init__(network, settings, layout, dictionary, on_event)

    def _wake_up(self) -> None:
        self._wake.set()

    def reconfigure(self, layout: PdoLayout, settings: DriveSettings) -> None:
        """Another layout: map the PDOs again; the drive must not be in operation."""
        self._change(layout, settings)

    @property
    def position_ns(self) -> int:
        """When the newest position came, monotonic nanoseconds; 0 never."""
        slot = self._position_slot
        return self._units.read_ns if slot is None else slot.time

    @property
    def _velocity_ns(self) -> int:
        """When the newest 606Ch came."""
        shown = (slot.time for slot in self._slots if "velocity_actual" in slot.pdo.attributes)
        return max(shown, default=self._acyclic_read)

    # -- cyclic -------------------------------------------------------------------------------------------------------

    def send(self, command: DriveCommand, now: int, *, stop: bool = False) -> None:
        """Cyclic: send the RPDOs that changed or are due for refresh: data first, the one with the Controlword last.

        If the interface has no room, the newest values are sent when it is this drive's turn. A ``stop`` is sent before all
        senders without a stop. While data of the command is not in the drive, a rising bit 4 (new setpoint) is delayed; the
        other bits are sent.
        """
        if self._sending and not self.rpdos.send(command, now, stop=stop):
            self.network.wait(self, stop=stop)

    def send_waiting(self) -> bool:
        """Its turn on the bus: send the newest command; False when the interface has no room."""
        rpdos = self.rpdos
        command = rpdos.command
        if command is None or not self._sending:
            return True
        rpdos.has_turn = True
        self.send(command, self.loop.now())
        rpdos.has_turn = False
        return rpdos.all_sent

    def withhold(self) -> None:
        """Send no RPDO until the next ``send``."""
        self.rpdos.command = None

    # -- the node's task ------------------------------------------------------------------------------------------------

    def learn(self) -> DriveType:
        """Read the type of the drive again (in its task) and store it in ``drive_type``."""
        answers: dict[tuple[int, int], int] = {}
        for address in questions(self.dictionary):
            if address == MAX_TORQUE and (own := self.own_values.value(address)) is not None:
                answers[address] = own  # the drive reports what the gateway wrote
                continue
            try:
                answers[address] = self.read_number(*address, signed=signed(self.dictionary, address))
            except SdoAbortedError as error:
                if address == IDENTITY_VENDOR:
                    raise Dsp402Error(
                        f"node {self.settings.node_id} object {address[0]:04X}h/{address[1]}",
                        abort_text(error.code),
                        "an object that can be read (every device has it)",
                    ) from error
                if address in OPTIONAL_OBJECTS and error.code not in NOT_THERE:
                    answers[address] = 0  # the drive has the object, and keeps its own value unless it is written
        self._device = answers.get(IDENTITY_VENDOR, 0), answers.get(IDENTITY_PRODUCT, 0)
        self._compare_identity(self._device)
        self.drive_type = describe(self.dictionary, answers, self.settings.units, self.settings.family)
        self._units = UnitWatch(answers)
        return self.drive_type

    def _apply_times(self) -> None:
        super()._apply_times()
        # With SYNC the drive expects a new setpoint each time.
        self.rpdos.refresh_ns = 0 if self._sync_period_us else self.settings.rpdo_refresh_ms * MS

    @property
    def _interpolates(self) -> bool:
        """The owner makes the positions of traversing tasks."""
        return self.drive_type is not None and self.settings.interpolates(self.drive_type)

    @property
    def _sync_period_us(self) -> int:
        return (
            self.settings.sync_period_us if self.drive_type is None else self.settings.sync_period_of(self.drive_type)
        )

    def _image(self, pdo: Pdo) -> object:
        return self.feedback

    def _check_identity(self, device_type: int) -> None:
        if self.settings.eds is None and profile_of(device_type) == self.profile:
            identity = self._fetch(*IDENTITY_VENDOR), self._fetch(*IDENTITY_PRODUCT)
            if self._identity is None:
                self.dictionary = dictionary_of(
                    self.settings.node_id, self._read_if_present, *identity, self.settings.family
                )
                self._identity = identity
            self._compare_identity(identity)
        super()._check_identity(device_type)

    def _compare_identity(self, identity: tuple[int, int]) -> None:
        if self._identity is not None and identity != self._identity:
            raise Dsp402Error(
                f"node {self.settings.node_id} vendor-ID and product code 1018h",
                "{:08X}h, {:08X}h".format(*identity),
                "{:08X}h, {:08X}h as at the first start".format(*self._identity),
            )

    def _make_safe(self, device_type: int) -> None:
        """A drive that still has power is stopped by SDO: it takes no RPDO, and need not stop in pre-operational (6007h).

        Quick Stop, as the owner sends it to a drive that is lost. One that refuses is stopped by its RPDOs after the bring-up.
        """
        if profile_of(device_type) != self.profile:
            return
        state = state_of(self.read_urgently(*STATUSWORD))
        shown = "an unknown state" if state is None else state.value
        self._is_off = state in _OFF
        if self._is_off:
            self._tell("off", shown)
            return
        stop = SdoStep(*CONTROLWORD, CanType.U16, Command.QUICK_STOP.word, "Quick Stop")
        try:
            self.write_urgently(stop.index, stop.subindex, stop.data)
        except SdoAbortedError as error:
            self._tell("status", f"in {shown}, and rejects {stop.meaning} by SDO: {error}")
        else:
            self._tell("status", f"in {shown}: {stop.meaning} by SDO before it is configured")

    def _read_if_present(self, index: int, subindex: int) -> bytes | None:
        try:
            return self.read(index, subindex)
        except SdoAbortedError as error:
            return None if error.code in NOT_THERE else b""

    def _make_plan(self, found: Mapping[int, int]) -> PdoPlan:
        if self.own_values:
            identity = self._fetch(*IDENTITY_VENDOR), self._fetch(*IDENTITY_PRODUCT)
            self.own_values.identify((*identity, self._read_serial()))
            carried = {entry.address for pdo in self.layout.rpdos for entry in pdo.entries}
            self.own_values.carry(carried, off=self._is_off)
        self._mapping.survey(self.learn(), found)
        return self._planned()

    def _plan_without(self, plan: PdoPlan, step: SdoStep, error: SdoAbortedError) -> PdoPlan | None:
        # A plan must include an unused PDO that cannot be disabled.
        return self._planned() if plan.uses(step.index) and self._mapping.learn(step, error) else None

    def _planned(self) -> PdoPlan:
        assert self.drive_type is not None
        settings, made = self.settings, self._interpolates
        plan = self._mapping.plan(
            interpolated(self.layout) if made else self.layout,
            self.drive_type,
            settings.node_id,
            sync=settings.sync or made,
            sync_rpdos=self._sync_period_us > 0,
        )
        return replace(plan, notes=(*plan.notes, _INTERPOLATED)) if made else plan

    def _take_plan(self, plan: PdoPlan) -> None:
        super()._take_plan(plan)
        self._position_slot = next((slot for slot in self._slots if "position_actual" in slot.pdo.attributes), None)
        self.rpdos.take_plan(plan, self._sdo_timeout_ns)
        self.rpdos.refresh_ns = 0 if self._sync_period_us else self.settings.rpdo_refresh_ms * MS
        self._value_check = PdoValueCheck(item.pdo for item in plan.tpdos)
        self._value_check_due = self.loop.now() + _VALUE_CHECK_NS
        self._dropped = ""

    def _configure(self) -> None:
        if period := self._sync_period_us:
            self._do(SdoStep(SYNC_PERIOD, 0, CanType.U32, period, "SYNC period", optional=True))
        self._configure_guarding()
        mode, drive, period_us = self.settings.initial_mode, self.drive_type, self._sync_period_us
        assert drive is not None
        edges = drive.quirks.fault_reset_edges
        self.rpdos.fault_reset = FaultReset(edges) if edges > 1 else None
        if (wanted := drive.mode_for(mode)) is not None:
            self._set_mode(wanted)
            if mode is Mode.VELOCITY and wanted == Mode.CYCLIC_VELOCITY:
                period_us = self.settings.cycle_ms * US_PER_MS
        if period_us and INTERPOLATION_TIME in self.dictionary:
            for step in interpolation_steps(period_us):
                self._do(step)
        if HOMING_METHOD[0] in self.dictionary:
            self.homing_method = self._fetch(*HOMING_METHOD, signed=True)
        for entry in self.rpdos.written_entries:
            if entry.address not in self.own_values:
                self._fetch(*entry.address)
        self.serial_number = self._read_serial()
        self.own_values.identify((*self._device, self.serial_number))
        for entry in self.rpdos.entries:
            if entry.attribute in _LIMITS_AND_RAMPS:
                self.own_values.overwrite(entry.address)
        self.own_values.commit()

    def _read_serial(self) -> int:
        return int.from_bytes(self._read_if_present(*IDENTITY_SERIAL) or b"", "little")

    def command(self, index: int, subindex: int, data: bytes) -> None:
        self.own_values.write((index, subindex), data)

    def store(self, index: int, subindex: int, data: bytes) -> None:
        """The drive stores its own values, not those of the RPDOs, which are not sent meanwhile. What it restores is its own."""
        restores = index == RESTORE_PARAMETERS
        self._sending = False
        try:
            self.own_values.show()
            self.write(index, subindex, data)
            if restores:
                self.own_values.trust()
        finally:
            # Without RPDOs until the next start, which follows a restore: it reads what the drive has then.
            self._sending = not (self._reconfigure or restores)
            self.rpdos.repeat()

    def write_back(self) -> None:
        """In a job, before the end: send no RPDO any more, and write back what they have overwritten of a drive without power.

        What fails is kept for the next process.
        """
        self._sending = False
        if state_of(self.read_number(*STATUSWORD)) in _OFF:
            self.own_values.write_back()
            self.own_values.commit()

    def _configure_guarding(self) -> None:
        settings, drive = self.settings, self.drive_type
        assert drive is not None
        wanted = settings.guarding_of(drive, self.rpdos.control.pdo.communication_index)
        guarding = guard(wanted, self._write_checked, self.read_number)
        if guarding.refusal and not settings.allow_unguarded:
            raise Dsp402Error(
                "guarding of the gateway by the drive",
                guarding.refusal,
                (
                    "1016h, 100Ch and 100Dh, or 1400h/5 with 6007h, writable; or a family that stops without SYNC; "
                    "or allow_unguarded = true"
                ),
            )
        if guarding.refusal:
            self._tell("status", f"not guarded: {guarding.refusal}")
        elif guarding != self.guarding:
            self._tell("status", f"if the gateway dies, this drive is stopped by {guarding.text}")
        self.guarding = guarding
        self._guarded_by_requests = guarding.life_guarding
        self._heartbeat_expected = guarding.heartbeat or guarding.life_guarding

    def _set_mode(self, mode: int) -> None:
        self.rpdos.mode_awaited, self._mode_wrong, self._operating_since = None, "", -1
        self._do(SdoStep(*MODE, CanType.I8, mode, "mode of operation"))
        deadline = self.loop.now() + MODE_CONFIRM_NS
        late = self.drive_type is not None and self.drive_type.quirks.mode_shown_in_operation_only
        while (shown := self._fetch(*MODE_DISPLAY, signed=True)) != mode:
            if mode in _SPEED_MODES and (late or (shown == _NO_MODE and self.loop.now() > deadline)):
                # Some drives show a mode in operation only. No speed is sent before it is shown.
                self.rpdos.mode_awaited = mode
                self._tell("status", f"6061h shows {shown}: mode {mode} is checked again when the operation is enabled")
                return
            if self.loop.now() > deadline:
                raise Dsp402Error("6061h", shown, f"{mode} within {MODE_CONFIRM_NS / SECOND:g} s of 6060h")
            self.loop.sleep(10 * MS)

    def _look_for_mode(self, mode: int, now: int) -> None:
        """In operation 6061h has to show the mode."""
        if state_of(self.feedback.statusword) is not State.OPERATION_ENABLED:
            self._operating_since = -1
            return
        if self._operating_since < 0:
            self._operating_since = now
        shown = self.read_number(*MODE_DISPLAY, signed=True)
        if shown == mode:
            self.rpdos.mode_awaited = None
        elif now - self._operating_since > MODE_CONFIRM_NS:
            self._mode_wrong = f"6061h shows {shown} for {MODE_CONFIRM_NS / SECOND:g} s in operation, not {mode}"

    def _has_work(self, now: int) -> bool:
        if (
            self.rpdos.written
            or self.rpdos.mode_awaited is not None
            or (self.rpdos.motion_asked and self._value_check.doubtful)
        ):
            return True
        if self._units.is_due(now, moves=self.rpdos.motion_asked):
            return True
        return super()._has_work(now)

    def _lost(self, now: int) -> str:
        return super()._lost(now) or self._mode_wrong or self._dropped

    def _look_for_dropped_objects(self, now: int) -> None:
        """Once a second while the drive is to move; where a TPDO showed something else than its object, after its time-out.

        A TPDO that is later than that is a lost drive.
        """
        for slot in self._slots:
            if slot.data is not None:
                self._value_check.see(slot.pdo, slot.data, slot.time)
        if now < self._value_check_due:
            return
        for doubt in self._value_check.doubts:
            entry = doubt.entry
            try:
                held = self.read(*entry.address)
            except SdoAbortedError:
                self._value_check.trust(doubt)
                continue
            if self._value_check.compare(doubt, held, now):
                self._mapping.drop(entry.address)
                shown, there = (int.from_bytes(data, "little") for data in (doubt.first, held))
                self._dropped = (
                    f"{doubt.pdo} accepts {entry} but does not send it: it shows {shown}, the object contains {there}"
                )
        self._value_check_due = now + (self._timeout_ns if self._value_check.contradicted else _VALUE_CHECK_NS)

    def _exchange_acyclic(self, now: int) -> None:
        """Objects for which the drive has no PDO: written when they change, read every 100 ms."""
        self.rpdos.write(self.write, now)
        if self.rpdos.mode_awaited is not None:
            self._look_for_mode(self.rpdos.mode_awaited, now)
        super()._exchange_acyclic(now)
        if self._units.is_due(now, moves=self.rpdos.motion_asked):
            self._watch_units(now)
        if self.rpdos.motion_asked and self._units.asked is None:
            # Not earlier: while waiting for an answer, a loss of the drive would be reported late.
            self._look_for_dropped_objects(now)

    def _watch_units(self, now: int) -> None:
        """Process the answer and send the next request, without waiting, while the drive moves."""
        units = self._units
        if (address := units.asked) is not None:
            is_position = address == (POSITION_ACTUAL, 0)
            try:
                value = self.answered(*address, signed=is_position or signed(self.dictionary, address))
            except SdoAbortedError:
                units.forget(address)
            else:
                if value is None and not units.give_up(now):
                    return
                if value is not None:
                    self._take_unit(address, value, now)
        if self._position_slot is not None:
            units.position_missing = True
        if (
            units.asked is None
            and units.is_due(now, moves=True)
            and not self._jobs
            and (following := units.next_object(now)) is not None
        ):
            self.ask(*following)

    def _take_unit(self, address: tuple[int, int], value: int, now: int) -> None:
        units = self._units
        units.asked = None
        if address not in units.told:
            # A drive that has left Operational still answers SDOs, but its last TPDO, with 606Ch, is outdated.
            since = units.asked_ns - units.read_ns
            if (now - units.asked_ns) * _SDO_STEP <= since and self._velocity_ns > units.read_ns:
                self.feedback.position_actual, units.read_ns = value, units.asked_ns
            return
        if value != (told := units.told[address]):
            name = f"{address[0]:04X}h" + (f"/{address[1]}" if address[1] else "")
            self._tell("units", f"{name} was {told:X}h and is {value:X}h now: another tool has changed the units")
            self.learn()
            self._tell("references", "reads its units again")
