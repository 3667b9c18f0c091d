"""The RPDOs of a drive: what is sent of each command, in which order, and what is written by SDO instead.

The data RPDOs go before the Controlword. A setpoint starts nothing before its data is in the drive (docs/translation.md "PDO
layouts"). Nothing here waits; ``work`` is called in the node's task.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Container
from typing import Final

from pdgw.base.durations import MS
from pdgw.ds301.aborts import SdoAbortedError, SdoCommunicationError
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.node.node import Notice
from pdgw.ds301.node.operation import Part
from pdgw.ds301.node.plan import Pace, PdoPlan
from pdgw.ds301.objects import Entry, ObjectAddress
from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.drive.images import DriveCommand, DriveFeedback
from pdgw.dsp402.drive.mode_check import ModeCheck
from pdgw.dsp402.objects import CONTROL_ATTRIBUTE
from pdgw.dsp402.states import ControlBit, FaultReset, operates

_RETRY_VALUE_NS: Final = 1000 * MS
"""Time after which a failed SDO write is repeated."""
_NEW_SETPOINT: Final = ControlBit.NEW_SETPOINT


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
        self.control = _Sender(control, control.cob_id(node_id))
        self.written: list[_Values] = []
        """Objects without RPDO."""
        self._refresh_ns = 0
        self.fault_reset: FaultReset | None = None
        self.set_point_refused = False
        """A new setpoint (Controlword.4) does not reach the drive, because its data could not be written; until it falls."""
        self.motion_asked = False
        """The last command was to move the drive."""
        self.command: DriveCommand | None = None
        """The command that was sent last or that waits for room on the bus; None: nothing is sent."""
        self.has_turn = False
        self.all_sent = True
        self.sent_ns = 0
        """When the newest command was sent as it is; 0 while something of it waits or is withheld."""
        self._data_senders: list[_Sender] = []
        self._paused: list[_Sender] = []
        """All of them during a pause."""
        self._starts_early = False
        """The Controlword is not the last object of its RPDO: the drive may process it before the data after it."""
        self._positions_by_sync = False
        """The drive gets a position for each SYNC, no setpoint of its own."""
        self._data_by_sync = False
        """The Controlword acts at once, data of it with the next SYNC, which follows the RPDOs of a cycle."""
        self._set_point_sent = False
        self._held_since = -1
        self._hold_limit_ns = 0
        self._may_send = True
        """The interface has accepted every frame of this command, and no other sender waits."""
        self._commanded_at = 0
        """When the command was given that is sent now, or waits for its turn."""

    def use_plan(self, plan: PdoPlan, sdo_timeout_ns: int, refresh_ns: int) -> None:
        """Send by another plan: nothing of it has been sent yet. After ``refresh_ns`` an RPDO is sent again; 0 by SYNC: with
        each one the drive expects a new setpoint.
        """
        self._refresh_ns = refresh_ns
        *data, control = plan.rpdos
        self.control = _Sender(control.pdo, control.cob_id)
        self._data_senders = [_Sender(item.pdo, item.cob_id) for item in data]
        self.written = [_Values(entry) for entry in plan.written]
        self._starts_early = control.pdo.attributes[-1] != CONTROL_ATTRIBUTE
        self._data_by_sync = control.pace is not Pace.SYNC and any(item.pace is Pace.SYNC for item in data)
        self._positions_by_sync = not refresh_ns and all(entry.attribute != "target_velocity" for entry in self.entries)
        self._set_point_sent = self.set_point_refused = False
        self._held_since = -1
        # Each object takes one timeout at most, and so does the worker's previous job.
        self._hold_limit_ns = (1 + len(self.written_entries)) * sdo_timeout_ns

    def pause(self, addresses: Container[ObjectAddress]) -> bool:
        """Until ``repeat``, send no RPDO with one of these objects. False if the one with the Controlword has one."""
        carrying = [
            sender
            for sender in (*self._data_senders, self.control)
            if any(entry.address in addresses for entry in sender.pdo.entries)
        ]
        self._paused = self._data_senders
        self._data_senders = [sender for sender in self._data_senders if sender not in carrying]
        return self.control not in carrying

    def repeat(self) -> None:
        """Objects of the drive have been overwritten: send and write everything again."""
        self._data_senders, self._paused = self._paused or self._data_senders, []
        self.send_again()
        for values in self.written:
            values.written = None

    def send_again(self) -> None:
        """Frames were dropped before they were sent: send each RPDO with the next command."""
        for sender in (*self._data_senders, self.control):
            sender.last = b""

    @property
    def written_entries(self) -> list[Entry]:
        """The objects without RPDO."""
        return [values.entry for values in self.written]

    @property
    def entries(self) -> list[Entry]:
        """All objects of the command."""
        sent = [entry for sender in (*self._data_senders, self.control) for entry in sender.pdo.entries]
        return [*sent, *self.written_entries]

    @property
    def operates(self) -> bool:
        """The drive is commanded to be in operation."""
        return self.command is not None and operates(self.command.controlword)

    @property
    def moves(self) -> bool:
        """The drive is commanded to move: by a setpoint, or by a position for each SYNC while it is in operation."""
        return self.motion_asked or (self._positions_by_sync and self.operates)

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
        speed, asked = command.target_velocity, command.controlword
        if self.fault_reset is not None:
            command.controlword = self.fault_reset.step(asked, self._feedback.statusword, now)
        if self._mode.awaited is not None:
            command.target_velocity = 0
        for values in self.written:
            values.newest = values.pack(getattr(command, values.entry.attribute))
        complete = True
        for sender in self._data_senders:
            complete = self._put(sender, sender.pdo.pack(command), now) and complete
        word = command.controlword
        withheld = False
        if not word & _NEW_SETPOINT:
            self._set_point_sent = self.set_point_refused = False
            self._held_since = -1
        elif not self._set_point_sent:
            command.controlword = word & ~_NEW_SETPOINT
            if self._starts_early and self.control.pdo.pack(command) != self.control.last:
                complete = False  # the data is sent one cycle before the edge
            if self._awaits_sync(now):
                complete = False
            if self._may_start(complete, now):
                command.controlword = word
        elif not (self.control.last or stop) and self._awaits_sync(now):
            withheld = True  # dropped: the drive may have this edge, or start with it before its data acts
        sent = not withheld and self._put(self.control, self.control.pdo.pack(command), now)
        if sent and command.controlword & _NEW_SETPOINT:
            self._set_point_sent = True
        self.sent_ns = now if sent and self.all_sent and not self._paused else 0
        if command.controlword != asked or command.target_velocity != speed:
            self.sent_ns = 0
            command.controlword, command.target_velocity = asked, speed
        self.motion_asked = speed != 0 or self._set_point_sent
        return self.all_sent

    def _awaits_sync(self, now: int) -> bool:
        """The SYNC of the data of this command was not sent yet, or may wait itself."""
        return self._data_by_sync and (
            self._network.waiting or any(sender.changed == now for sender in self._data_senders)
        )

    def _put(self, sender: _Sender, data: bytes, now: int) -> bool:
        """Send an RPDO if it changed or is due; True if this data was sent, now or before.

        Nothing is sent after a refused frame: the Controlword must not overtake its data.
        """
        due = now - sender.time >= self._refresh_ns
        if self.has_turn and sender.time >= self._commanded_at:
            due = False  # sent for this command: the next free slot is for the rest
        if data != sender.last or due:
            if self._may_send and self._network.put(sender.cob_id, data):
                if data != sender.last:
                    sender.changed = now
                sender.last = data
                sender.time = now
            else:
                self._may_send = self.all_sent = False
        return data == sender.last

    def _may_start(self, sent: bool, now: int) -> bool:
        """Whether the data of a new setpoint is in the drive: all ``sent`` by RPDO and written by SDO."""
        if self.set_point_refused:
            return False
        missing = [values for values in self.written if values.written != values.newest]
        if not missing:
            return sent
        if self._held_since < 0:
            self._held_since = now
            for values in missing:
                values.refused = None  # a new setpoint allows a new attempt
            self._wake()
            return False
        refused = [values.error for values in missing if values.refused == values.newest]
        if refused or now - self._held_since > self._hold_limit_ns:
            self.set_point_refused = True
            cause = refused[0] if refused else f"data not written within {self._hold_limit_ns // MS} ms"
            self._notify(Notice.SET_POINT_REFUSED, f"not started: {cause}")
        return False

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
