"""The RPDOs of a drive: what is sent of each command, in which order, and what is written by SDO instead.

The data RPDOs go before the Controlword. A setpoint starts nothing before its data is in the drive (docs/translation.md "PDO
layouts"). Nothing here waits; ``work`` is called in the node's task.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Container, Sequence
from typing import Final

from pdgw.base.durations import MS
from pdgw.ds301.aborts import SdoAbortedError, SdoCommunicationError
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.node.node import Notice
from pdgw.ds301.node.operation import Part
from pdgw.ds301.node.plan import Pace, PdoPlan, PlannedPdo
from pdgw.ds301.objects import Entry, ObjectAddress
from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.drive.images import DriveCommand, DriveFeedback, attributes
from pdgw.dsp402.drive.mode_check import ModeCheck
from pdgw.dsp402.objects import CONTROL_ATTRIBUTE
from pdgw.dsp402.states import ControlBit, FaultReset, operates

_RETRY_VALUE_NS: Final = 1000 * MS
"""Time after which a failed SDO write is repeated."""
_NEW_SETPOINT: Final = ControlBit.NEW_SETPOINT
_VALUES: Final = attributes(DriveCommand())


def _changed(command: DriveCommand, controlword: int, target_velocity: int) -> DriveCommand:
    """The command with this Controlword and velocity; itself if it has them."""
    if controlword == command.controlword and target_velocity == command.target_velocity:
        return command
    changed = DriveCommand()
    for name in _VALUES:
        setattr(changed, name, getattr(command, name))
    changed.controlword, changed.target_velocity = controlword, target_velocity
    return changed


class _Sender:
    """One RPDO, and the data and time of its last transmission."""

    def __init__(self, pdo: Pdo, cob_id: int) -> None:
        self.pdo = pdo
        self.cob_id = cob_id
        self.last = b""
        self.time = 0
        self.changed = 0
        """When it was sent last with other data than before."""


class _Values:
    """The values of an object without an RPDO: set in the cycle, written by SDO in the node's task."""

    def __init__(self, entry: Entry) -> None:
        self.entry = entry
        self.pack = struct.Struct("<" + entry.type.char).pack
        self.newest = b""
        self.written: bytes | None = b""
        """The confirmed value in the drive; None during a write or after a failed one."""
        self.refused: bytes | None = None
        self.retry_at = 0
        self.error = ""


class SetPoint:
    """A new setpoint (Controlword.4), from the rise of the bit to its fall."""

    def __init__(self) -> None:
        self.sent = False
        """The edge was sent."""
        self.held_since = -1
        """Since when it waits for data that is written by SDO; -1: it does not."""
        self.refused = False
        """It does not reach the drive, because its data could not be written."""


class _Rpdos:
    """What is sent by one plan, until the next one."""

    def __init__(
        self, rpdos: Sequence[PlannedPdo], written: Sequence[Entry], sdo_timeout_ns: int, refresh_ns: int
    ) -> None:
        *data, control = rpdos
        self.control = _Sender(control.pdo, control.cob_id)
        """The one with the Controlword."""
        self.data = [_Sender(item.pdo, item.cob_id) for item in data]
        """The others; during a pause only those that are sent in it."""
        self.paused: list[_Sender] = []
        """All of ``data`` during a pause."""
        self.written = [_Values(entry) for entry in written]
        """Objects without RPDO."""
        self.refresh_ns = refresh_ns
        self.starts_early = control.pdo.attributes[-1] != CONTROL_ATTRIBUTE
        """The Controlword is not the last object of its RPDO: the drive may process it before the data after it."""
        entries = [*(entry for item in rpdos for entry in item.pdo.entries), *written]
        self.positions_by_sync = not refresh_ns and all(entry.attribute != "target_velocity" for entry in entries)
        """The drive gets a position for each SYNC, no setpoint of its own."""
        self.data_by_sync = control.pace is not Pace.SYNC and any(item.pace is Pace.SYNC for item in data)
        """The Controlword acts at once, data of it with the next SYNC, which follows the RPDOs of a cycle."""
        # Each object takes one timeout at most, and so does the worker's previous job.
        self.hold_limit_ns = (1 + len(written)) * sdo_timeout_ns


class RpdoSender(Part):
    """The RPDOs of one drive. ``control``: the one with the Controlword; ``write`` writes an object by SDO in the node's task,
    and ``wake`` wakes it."""

    def __init__(
        self,
        network: CanNetwork,
        control: Pdo,
        node_id: int,
        feedback: DriveFeedback,
        mode: ModeCheck,
        write: Callable[[int, int, bytes], None],
        wake: Callable[[], None],
        notify: Callable[[Notice, str], None],
    ) -> None:
        self._network = network
        self._feedback = feedback
        self._mode = mode
        self._write = write
        self._wake = wake
        self._notify = notify
        self._rpdos = _Rpdos([PlannedPdo(control, control.cob_id(node_id), Pace.AT_ONCE)], (), 0, 0)
        self.fault_reset: FaultReset | None = None
        self.set_point: SetPoint | None = None
        """None while Controlword.4 is 0."""
        self.motion_asked = False
        """The last command was to move the drive."""
        self.command: DriveCommand | None = None
        """The command that was sent last or that waits for room on the bus; None: nothing is sent."""
        self.has_turn = False
        self.all_sent = True
        self.sent_ns = 0
        """When the newest command was sent as it is; 0 while something of it waits or is withheld."""
        self._may_send = True
        """The interface has accepted every frame of this command, and no other sender waits."""
        self._commanded_at = 0
        """When the command was given that is sent now, or waits for its turn."""

    def use_plan(self, plan: PdoPlan, sdo_timeout_ns: int, refresh_ns: int) -> None:
        """Send by another plan: nothing of it has been sent yet. After ``refresh_ns`` an RPDO is sent again; 0 by SYNC: with
        each one the drive expects a new setpoint.
        """
        self._rpdos = _Rpdos(plan.rpdos, plan.written, sdo_timeout_ns, refresh_ns)
        self.set_point = None

    def pause(self, addresses: Container[ObjectAddress]) -> bool:
        """Until ``repeat``, send no RPDO with one of these objects. False if the one with the Controlword has one."""
        rpdos = self._rpdos
        carrying = [
            sender
            for sender in (*rpdos.data, rpdos.control)
            if any(entry.address in addresses for entry in sender.pdo.entries)
        ]
        rpdos.paused = rpdos.data
        rpdos.data = [sender for sender in rpdos.data if sender not in carrying]
        return rpdos.control not in carrying

    def repeat(self) -> None:
        """Objects of the drive have been overwritten: send and write everything again."""
        rpdos = self._rpdos
        rpdos.data, rpdos.paused = rpdos.paused or rpdos.data, []
        self.send_again()
        for values in rpdos.written:
            values.written = None

    def send_again(self) -> None:
        """Frames were dropped before they were sent: send each RPDO with the next command."""
        for sender in (*self._rpdos.data, self._rpdos.control):
            sender.last = b""

    @property
    def control(self) -> _Sender:
        """The RPDO with the Controlword."""
        return self._rpdos.control

    @property
    def written(self) -> list[_Values]:
        """Objects without RPDO."""
        return self._rpdos.written

    @property
    def written_entries(self) -> list[Entry]:
        """The objects without RPDO."""
        return [values.entry for values in self.written]

    @property
    def entries(self) -> list[Entry]:
        """All objects of the command."""
        sent = [entry for sender in (*self._rpdos.data, self._rpdos.control) for entry in sender.pdo.entries]
        return [*sent, *self.written_entries]

    @property
    def operates(self) -> bool:
        """The drive is commanded to be in operation."""
        return self.command is not None and operates(self.command.controlword)

    @property
    def moves(self) -> bool:
        """The drive is commanded to move: by a setpoint, or by a position for each SYNC while it is in operation."""
        return self.motion_asked or (self._rpdos.positions_by_sync and self.operates)

    @property
    def set_point_refused(self) -> bool:
        """A new setpoint (Controlword.4) does not reach the drive, because its data could not be written; until it falls."""
        return self.set_point is not None and self.set_point.refused

    # -- cyclic -------------------------------------------------------------------------------------------------------

    def send(self, command: DriveCommand, now: int, *, stop: bool) -> bool:
        """Send what changed or is due for refresh; False when the interface had no room for all of it.

        While data of the command is not in the drive, a rising bit 4 (new setpoint) is delayed and the other bits are sent.
        """
        if not self.has_turn:
            self._commanded_at = now
        self.command = command
        self._may_send = stop or self.has_turn or not self._network.waiting
        self.all_sent = True
        rpdos = self._rpdos
        allowed = command
        if self.fault_reset is not None or self._mode.awaited is not None:
            allowed = self._allowed(command, now)
        for values in rpdos.written:
            values.newest = values.pack(getattr(allowed, values.entry.attribute))
        complete = True
        for sender in rpdos.data:
            complete = self._put(sender, sender.pdo.pack(allowed), now) and complete
        started: DriveCommand | None = allowed
        set_point: SetPoint | None = None
        if allowed.controlword & _NEW_SETPOINT:
            set_point = self.set_point or SetPoint()
            missing = [] if set_point.sent else [values for values in rpdos.written if values.written != values.newest]
            if missing and not set_point.refused:
                self._hold(set_point, missing, now)
            ready = complete and not missing and not set_point.refused
            started = self._started(allowed, set_point, now, ready=ready, stop=stop)
        self.set_point = set_point
        sent = started is not None and self._put(rpdos.control, rpdos.control.pdo.pack(started), now)
        if sent and set_point is not None and started is allowed:
            set_point.sent = True
        self.sent_ns = now if sent and started is command and self.all_sent and not rpdos.paused else 0
        self.motion_asked = command.target_velocity != 0 or (set_point is not None and set_point.sent)
        return self.all_sent

    def _allowed(self, command: DriveCommand, now: int) -> DriveCommand:
        """The command with as many edges of a fault reset as the drive needs, and without a speed until its mode is shown."""
        word, velocity = command.controlword, command.target_velocity
        if self.fault_reset is not None:
            word = self.fault_reset.step(word, self._feedback.statusword, now)
        return _changed(command, word, velocity if self._mode.awaited is None else 0)

    def _started(
        self, command: DriveCommand, set_point: SetPoint, now: int, *, ready: bool, stop: bool
    ) -> DriveCommand | None:
        """The command, or the one without its new setpoint while data of it is missing; None: the Controlword waits, too.

        ``ready``: all data of the setpoint in other RPDOs is sent, and all that has no RPDO is written.
        """
        rpdos = self._rpdos
        if set_point.sent:
            # Dropped: the drive may have this edge, or start with it before its data acts.
            return command if rpdos.control.last or stop or not self._awaits_sync(now) else None
        without = _changed(command, command.controlword & ~_NEW_SETPOINT, command.target_velocity)
        # The data in the same RPDO is sent one cycle before the edge.
        early = rpdos.starts_early and rpdos.control.pdo.pack(without) != rpdos.control.last
        return command if ready and not early and not self._awaits_sync(now) else without

    def _awaits_sync(self, now: int) -> bool:
        """The SYNC of the data of this command was not sent yet, or may wait itself."""
        rpdos = self._rpdos
        return rpdos.data_by_sync and (self._network.waiting or any(sender.changed == now for sender in rpdos.data))

    def _put(self, sender: _Sender, data: bytes, now: int) -> bool:
        """Send an RPDO if it changed or is due; True if this data was sent, now or before.

        Nothing is sent after a refused frame: the Controlword must not overtake its data.
        """
        due = now - sender.time >= self._rpdos.refresh_ns
        if self.has_turn and sender.time >= self._commanded_at:
            due = False  # sent for this command: the next free slot is for the rest
        changed = data != sender.last
        if changed or due:
            if not self._may_send or not self._network.put(sender.cob_id, data):
                self._may_send = self.all_sent = False
                return not changed
            if changed:
                sender.changed = now
                sender.last = data
            sender.time = now
        return True

    def _hold(self, set_point: SetPoint, missing: list[_Values], now: int) -> None:
        """Wait for data of a new setpoint that is written by SDO, and refuse the setpoint if the drive does not get it."""
        if set_point.held_since < 0:
            set_point.held_since = now
            for values in missing:
                values.refused = None  # a new setpoint allows a new attempt
            self._wake()
            return
        refused = [values.error for values in missing if values.refused == values.newest]
        limit_ns = self._rpdos.hold_limit_ns
        if refused or now - set_point.held_since > limit_ns:
            set_point.refused = True
            cause = refused[0] if refused else f"data not written within {limit_ns // MS} ms"
            self._notify(Notice.SET_POINT_REFUSED, f"not started: {cause}")

    @property
    def _held_since(self) -> int:
        """Since when a new setpoint waits for data that is written by SDO; -1: none waits."""
        return -1 if self.set_point is None else self.set_point.held_since

    # -- in the node's task: objects outside the RPDOs -----------------------------------------------------------------

    @property
    def has_work(self) -> bool:
        return bool(self.written)

    def due(self, now: int) -> bool:
        return True

    def work(self, now: int) -> None:
        """Write by SDO what has changed of the objects without RPDO; a refused value is tried again after a second."""
        for values in self.written:
            newest = values.newest
            if values.written != newest and (values.refused != newest or now >= values.retry_at):
                self._write_values(values, now)

    def _write_values(self, values: _Values, now: int) -> None:
        # Not confirmed while it is being written; the cycles continue meanwhile.
        values.written = None
        data, held_since = values.newest, self._held_since
        try:
            self._write(*values.entry.address, data)
        except (SdoAbortedError, SdoCommunicationError, struct.error, ValueError) as error:
            text = f"{values.entry}: {error}"
            if text != values.error:  # log it once until it changes
                values.error = text
                self._notify(Notice.PROGRESS, f"object without PDO: {text}")
            values.retry_at = now + _RETRY_VALUE_NS
            # A setpoint that started meanwhile allows a new attempt.
            values.refused = data if held_since == self._held_since else None
        else:
            values.error = ""
            values.refused = None
            values.written = data
