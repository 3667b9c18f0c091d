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

from pdgw.base.durations import MS, US_PER_MS
from pdgw.ds301.aborts import NOT_THERE, SdoAbortedError, abort_text
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import (
    DEVICE_TYPE,
    IDENTITY_PRODUCT,
    IDENTITY_SERIAL,
    IDENTITY_VENDOR,
    RESTORE_PARAMETERS,
    STORE_PARAMETERS,
    SYNC_PERIOD,
    profile_of,
)
from pdgw.ds301.configuration import SdoStep
from pdgw.ds301.eds.importer import load_dictionary
from pdgw.ds301.node.bring_up import NodeSetup
from pdgw.ds301.node.client import NodeClient
from pdgw.ds301.node.configuring import DeviceKind
from pdgw.ds301.node.node import NodeNotice, NodeStatus, Notice
from pdgw.ds301.node.operation import Unconfirmed
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.node.planner import Findings
from pdgw.ds301.node.polling import PolledObject
from pdgw.ds301.objects import CanType, ObjectAddress
from pdgw.ds301.pdo import PdoCapabilities, PdoLayout
from pdgw.ds301.values import KnownDevice
from pdgw.dsp402.acting import KEPT, Treatment, acting_in, left_to_the_drive, read_acting, readable
from pdgw.dsp402.drive.guarding import Guarding, guard, write_interpolation
from pdgw.dsp402.drive.images import UNKNOWN, DriveCommand, DriveFeedback
from pdgw.dsp402.drive.left_overs import OFF, LeftOvers
from pdgw.dsp402.drive.mode_check import ModeCheck
from pdgw.dsp402.drive.own_values import OwnValueKeeper
from pdgw.dsp402.drive.power_off import PowerOff
from pdgw.dsp402.drive.rpdos import RpdoSender
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.drive.tpdo_check import TpdoCheck
from pdgw.dsp402.drive.unit_check import UnitCheck
from pdgw.dsp402.drive.value_writer import DriveValueWriter
from pdgw.dsp402.drive_type import DriveType, Dsp402Error
from pdgw.dsp402.identification.describe import OPTIONAL_OBJECTS, describe, questions, signed
from pdgw.dsp402.identification.generic import dictionary_of, generic_dictionary
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import (
    CONTROLWORD,
    DRIVE_PROFILE,
    HOMING_METHOD,
    INTERPOLATION_TIME,
    MAX_TORQUE,
    MODE,
    MODE_DISPLAY,
    STATUSWORD,
)
from pdgw.dsp402.pdo.planner import plan_pdos
from pdgw.dsp402.states import UNPOWERED, Command, FaultReset, state_of
from pdgw.dsp402.units.scaling import SCALING_OBJECTS
from pdgw.dsp402.units.unit_watch import UnitWatch

DriveStatus = NodeStatus
_KEPT: Final = KEPT | {"dynamic_speed_limit", "dynamic_torque_limit"}
"""Objects whose own value returns when no RPDO contains them; those of the profile, and of a family."""
_UNITS_AND_LIMITS: Final = frozenset(SCALING_OBJECTS)


def load_eds(path: Path, node_id: int) -> canopen.ObjectDictionary:
    """The object dictionary of a user's EDS/DCF; Dsp402Error names the file and what is wrong with it."""
    return load_dictionary(path, node_id, (DEVICE_TYPE, CONTROLWORD[0], STATUSWORD[0]), "a drive", Dsp402Error)


_GUARDS = "1016h, 100Ch and 100Dh, or 1400h/5 with 6007h, writable, or a family that stops without SYNC"


class DriveClient(NodeClient[DriveSettings]):
    """One drive. ``on_event`` is called whenever something happens to it that the owner must know."""

    kind = DeviceKind("drive", "a drive", DRIVE_PROFILE, Dsp402Error)
    unknown = UNKNOWN

    def __init__(
        self,
        network: CanNetwork,
        settings: DriveSettings,
        layout: PdoLayout,
        on_event: Callable[[NodeNotice], None],
    ) -> None:
        node_id = settings.node_id
        dictionary = load_eds(settings.eds, node_id) if settings.eds else generic_dictionary()
        self.feedback = feedback = DriveFeedback()
        super().__init__(NodeSetup(network, settings, layout, dictionary, feedback, on_event))
        sdo = self.sdo
        self.drive_type: DriveType | None = None
        """The type of the drive, made again at each start and after a write to an object it depends on."""
        self.homing_method = 0
        self.guarding: Guarding | None = None
        """The way in which this drive stops when the gateway fails; None before its first start."""
        self.serial_number = 0
        """1018h/4; 0 for a drive without one."""
        self._identity: tuple[int, int] | None = None
        """Vendor-ID and product code of the device whose objects were found out,"""
        self._device = (0, 0)
        """and of the one that is there."""
        self._mode = ModeCheck(sdo, feedback, self._notify)
        self.rpdos = RpdoSender(
            network, layout.rpdos[0], node_id, feedback, self._mode, sdo.write, self._wake.set, self._notify
        )
        """Sends the parts of each command."""
        network.on_drop.append(self.rpdos.send_again)
        self.units = UnitCheck(sdo, feedback, self.rpdos, self._velocity_asked, self._units_changed, self._read_units)
        """Reads its units, and its position if no TPDO contains it."""
        self.question = self.units.ask
        self.own_values = OwnValueKeeper(self._read_if_present, sdo.write, self._notify)
        """The drive's values of limits and ramps that the gateway overwrites."""
        self.command = self.own_values.write
        self.write_for_client = self._write_for_client
        self._value_writer = self._drive_values = DriveValueWriter(sdo, self.own_values)
        self._left_overs = LeftOvers(sdo, self._notify)
        power_off = PowerOff(self.configuration, self._left_overs, feedback, self._give_values, self._read_units)
        tpdos = TpdoCheck(sdo, self._mapper.device, self.rpdos)
        self.parts = (self.rpdos, self._mode, self._polled, power_off, self.units, tpdos)
        self.zeroed: frozenset[ObjectAddress] = frozenset()
        """Objects that stay 0, because the drive would add them to the setpoint."""
        self.polled_speed: PolledObject | None = None
        """The actual speed, if it is read by SDO,"""
        self.polled_position: PolledObject | None = None
        """and the position."""
        self.polls = False
        """One of them is."""
        self._is_off = False
        """The drive was without power when it was found."""
        self.needs_last_stop: Callable[[int], bool] = lambda velocity: False
        """Whether a drive that is found at this speed must get Disable Voltage: NMT stop has not stopped it."""

    # -- cyclic -------------------------------------------------------------------------------------------------------

    def send(self, command: DriveCommand, now: int, *, stop: bool = False) -> None:
        """Cyclic: send the RPDOs that changed or are due for refresh: data first, the one with the Controlword last.

        If the interface has no room, the newest values are sent when it is this drive's turn. A ``stop`` is sent before all
        senders without a stop. While data of the command is not in the drive, a rising bit 4 (new setpoint) is delayed; the
        other bits are sent.
        """
        if self.operation.sends and not self.rpdos.send(command, now, stop=stop):
            self.network.wait(self, stop=stop)

    def send_waiting(self) -> bool:
        """Send the newest command. False if the interface is full."""
        rpdos = self.rpdos
        command = rpdos.command
        if command is None or not self.operation.sends:
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
        self._read_device()
        self._compare_identity()
        return self._describe()

    def _describe(self) -> DriveType:
        answers = dict(zip((IDENTITY_VENDOR, IDENTITY_PRODUCT), self._device, strict=True))
        ignored = self.settings.units.ignored_unit_objects if self.settings.units is not None else ()
        for address in questions(self.sdo.dictionary):
            if address in answers:
                continue
            if address == MAX_TORQUE and (own := self.own_values.value(address)) is not None:
                answers[address] = own  # the drive reports what the gateway wrote
                continue
            try:
                answers[address] = self.sdo.read_number(*address, signed=signed(self.sdo.dictionary, address))
            except SdoAbortedError as error:
                if address in _UNITS_AND_LIMITS and address[0] not in ignored and error.code not in NOT_THERE:
                    raise Dsp402Error(
                        f"node {self.settings.node_id} object {address[0]:04X}h/{address[1]}",
                        abort_text(error.code),
                        "an object that can be read, because it defines units or 100 %",
                        "else list it in ignored_unit_objects",
                    ) from error
                if address in OPTIONAL_OBJECTS and error.code not in NOT_THERE:
                    answers[address] = 0  # the drive has the object, and keeps its own value unless it is written
        drive = describe(self.sdo.dictionary, answers, self.settings.units, self.settings.families)
        self.drive_type = drive = self._corrected(drive, answers)
        self.units.watch = UnitWatch(answers)
        return drive

    def _corrected(self, drive: DriveType, answers: Mapping[ObjectAddress, int]) -> DriveType:
        """The drive with what acts in its modes, as far as possible without the values of another master."""
        settings = self.settings
        rows = settings.corrected(drive)
        found = read_acting(acting_in(settings.modes(drive)), self.sdo.dictionary, self._read_if_present, answers)
        refusal = self._left_overs.correct(rows, found)
        self.zeroed = frozenset(row.address for row in rows if row.treatment is Treatment.ZERO)
        return replace(drive, acting=readable(found), uncorrected=refusal or self.configuration.waiting)

    @property
    def left_to_the_drive(self) -> tuple[str, ...]:
        """For the user: what acts in the modes of the telegram and is not commanded, with the values at the last start."""
        drive, plan = self.drive_type, self.plan
        if drive is None or plan is None:
            return ()
        return left_to_the_drive(drive.acting, self.settings.modes(drive), {entry.address for entry in plan.commanded})

    def _velocity_asked(self) -> int:
        return 0 if self.polled_speed is None else self.polled_speed.asked_ns

    def _units_changed(self, text: str) -> None:
        self._notify(Notice.UNITS_CHANGED, text)
        self._wake.set()

    def _read_units(self) -> None:
        """Another tool has changed the units, or what waited for the end of the drive's power is corrected."""
        self.units.watch.changed = False
        try:
            self.learn()
        except Exception:
            self.unhold(check=True)  # the bring-up reads them
            raise
        self._notify(Notice.UNITS_READ, "reads its units again")

    def _identify(self, device_type: int) -> None:
        if profile_of(device_type) == DRIVE_PROFILE:
            self._make_safe()
            self._read_device()
            if self.settings.eds is None:
                if self._identity is None:
                    self.sdo.dictionary = dictionary_of(
                        self.settings.node_id, self._read_if_present, *self._device, self.settings.families
                    )
                    self._identity = self._device
                self._compare_identity()
                return
        self.sdo.check_identity(device_type, self._device)

    def _read_device(self) -> None:
        self._device = self.sdo.require(*IDENTITY_VENDOR), self.sdo.read_optional(*IDENTITY_PRODUCT)

    def _compare_identity(self) -> None:
        if self._identity is not None and self._device != self._identity:
            raise Dsp402Error(
                f"node {self.settings.node_id} vendor-ID and product code 1018h",
                "{:08X}h, {:08X}h".format(*self._device),
                "{:08X}h, {:08X}h as at the first start".format(*self._identity),
            )

    def _make_safe(self) -> None:
        """A drive that still has power is stopped by SDO: it takes no RPDO, and need not stop in pre-operational (6007h).

        Quick Stop, as the owner sends it to a drive that is lost, or Disable Voltage. One that refuses is stopped by its RPDOs
        after the bring-up.
        """
        state = state_of(self.sdo.read_urgently(*STATUSWORD))
        shown = "an unknown state" if state is None else state.value
        self._is_off = state in OFF
        if self._is_off:
            self._notify(Notice.OFF, shown)
            return
        stop = SdoStep(*CONTROLWORD, CanType.U16, Command.QUICK_STOP.word, "Quick Stop")
        if self.needs_last_stop(self._read_speed()):
            stop = SdoStep(*CONTROLWORD, CanType.U16, Command.DISABLE_VOLTAGE.word, "Disable Voltage")
        try:
            self.sdo.write_urgently(stop.index, stop.subindex, stop.data)
        except SdoAbortedError as error:
            self._notify(Notice.PROGRESS, f"in {shown}, and rejects {stop.meaning} by SDO: {error}")
        else:
            self._notify(Notice.PROGRESS, f"in {shown}: {stop.meaning} by SDO before it is configured")

    def _read_speed(self) -> int:
        """The actual speed; 0 if it cannot be read."""
        if self.drive_type is None:
            return 0
        velocity = self.drive_type.entry("velocity_actual")
        try:
            value, half = self.sdo.read_urgently(*velocity.address), 1 << velocity.type.bits - 1
        except SdoAbortedError:
            return 0
        return (value + half) % (2 * half) - half

    def _read_if_present(self, index: int, subindex: int) -> bytes | None:
        try:
            return self.sdo.read(index, subindex)
        except SdoAbortedError as error:
            return None if error.code in NOT_THERE else b""

    def _read_known(self) -> KnownDevice:
        self.serial_number = self.sdo.read_optional(*IDENTITY_SERIAL)
        self.own_values.identify((*self._device, self.serial_number))
        name = self.sdo.dictionary.device_information.product_name or ""
        self._drive_values.family = self.settings.families.of(*self._device, name)
        return KnownDevice(*self._device, serial_number=self.serial_number)

    def _read_capabilities(self) -> PdoCapabilities:
        carried = {entry.address for pdo in self.layout.rpdos for entry in pdo.entries}
        self.own_values.carry(carried, off=self._is_off)
        drive = self._describe()
        for line in drive.ignored_ranges:
            self._notify(Notice.PROGRESS, line)
        if self.settings.tasks:
            drive.require_profile_position()
        return drive.pdos

    def _make_plan(self, findings: Findings) -> PdoPlan:
        assert self.drive_type is not None
        settings = self.settings
        return plan_pdos(
            self.layout,
            self.drive_type,
            settings.node_id,
            findings,
            sync=settings.sync,
            sync_rpdos=settings.sync_period_us > 0,
        )

    def _configure(self, plan: PdoPlan) -> None:
        drive, settings = self.drive_type, self.settings
        period_us = settings.sync_period_us
        assert drive is not None
        self.rpdos.use_plan(plan, self.sdo.timeout_ns, 0 if period_us else settings.rpdo_refresh_ms * MS)
        self.polled_speed = self.polling.find("velocity_actual")
        self.polled_position = self.polling.find("position_actual")
        self.polls = self.polled_speed is not None or self.polled_position is not None
        self.operation.position = ("position_actual", int(drive.scaling.counts_per_revolution or 0))
        if period_us:
            self.sdo.do(SdoStep(SYNC_PERIOD, 0, CanType.U32, period_us, "SYNC period", optional=True))
        self._configure_guarding(drive)
        mode = settings.initial_mode
        edges = drive.quirks.fault_reset_edges
        self.rpdos.fault_reset = FaultReset(edges) if edges > 1 else None
        if (code := drive.mode_for(mode)) is not None:
            self._mode.set(code, late=drive.quirks.mode_shown_in_operation_only, only=[*drive.modes] == [code])
            if mode is Mode.VELOCITY and code == Mode.CYCLIC_VELOCITY:
                period_us = settings.cycle_ms * US_PER_MS
        if period_us and INTERPOLATION_TIME in self.sdo.dictionary:
            held = self.sdo.read_number(INTERPOLATION_TIME, 2, signed=True)
            write_interpolation(period_us, self.sdo.write_checked, held)
        if HOMING_METHOD[0] in self.sdo.dictionary:
            self.homing_method = self.sdo.require(*HOMING_METHOD, signed=True)
        shown = (
            {MODE} if MODE_DISPLAY[0] in self.sdo.dictionary else set()
        )  # 6060h may be write-only: 6061h shows the mode
        for entry in self.rpdos.written_entries:
            if entry.address not in shown and entry.address not in self.own_values:
                self.sdo.require(*entry.address)
        for entry in self.rpdos.entries:
            if entry.attribute in _KEPT:
                self.own_values.overwrite(entry.address)
        self.own_values.commit()

    def _write_for_client(self, index: int, subindex: int, data: bytes) -> None:
        """The drive stores its own values (1010h), not those of the RPDOs: such an RPDO is not sent meanwhile. What it restores
        (1011h), and what a client writes, is its own.
        """
        if index not in {STORE_PARAMETERS, RESTORE_PARAMETERS}:
            self.sdo.write(index, subindex, data)
            self.own_values.discard((index, subindex))
            return
        restores, operation = index == RESTORE_PARAMETERS, self.operation
        sends = operation.sends
        operation.sends = sends and not restores and self.rpdos.pause(self.own_values)
        try:
            if restores:
                self.sdo.write(index, subindex, data)
                self.own_values.trust()
            else:
                self.own_values.show()
                self.sdo.write(index, subindex, data)
        finally:
            # Without RPDOs until the next start, which follows a restore: it reads what the drive has then.
            operation.sends = sends and not (self._reconfigure or restores)
            self.rpdos.repeat()

    def write_back(self) -> None:
        """In a job, before the end: send no RPDO any more, and write back what they have overwritten of a drive without torque.

        What fails is kept for the next process.
        """
        self.operation.sends = False
        state = state_of(self.sdo.read_number(*STATUSWORD))
        if state in UNPOWERED:
            self.own_values.write_back()
            self.own_values.commit()
        else:
            shown = "an unknown state" if state is None else state.value
            self._notify(
                Notice.PROGRESS, f"in {shown}: the drive's own values are not written back; the next start does it"
            )

    def _configure_guarding(self, drive: DriveType) -> None:
        settings = self.settings
        times = settings.guarding_of(drive, self.network.node_id, self.rpdos.control.pdo.communication_index)
        guarding = guard(times, self.sdo.write_checked, self.sdo.read_number)
        if guarding.refusal and not settings.allow_unguarded:
            raise Dsp402Error("guarding of the gateway by the drive", guarding.refusal, _GUARDS, guarding.remedy)
        if guarding.refusal:
            self._notify(Notice.PROGRESS, f"not guarded: {guarding.refusal}")
        elif guarding != self.guarding:
            self._notify(Notice.PROGRESS, f"if the gateway dies, this drive is stopped by {guarding.text}")
        self.guarding = guarding
        self.heartbeat.by_requests = guarding.life_guarding
        self.heartbeat.expected = guarding.heartbeat or guarding.life_guarding

    def _give_values(self) -> None:
        """The drive had power, and gets the values of its files now: it is brought up again."""
        self._unconfirmed = Unconfirmed("gets the values of its files", self.loop.now())
        self._wake.set()
