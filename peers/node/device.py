"""The interface of a CANopen device for its PDOs and faults; ``SimulatedNode`` implements it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pdgw.ds301.communication import NmtState
from pdgw.ds301.objects import Entry, ObjectSpec
from pdgw.ds301.pdo import Pdo

Value = int | float | bytes | str | bool


class Device:
    """Objects and values, hooks of a device profile, and services of the node."""

    def __init__(self, node_id: int, objects: Sequence[ObjectSpec], image: object) -> None:
        self.node_id = node_id
        self.image = image
        self.now = 0
        self.bitrate_changed: Callable[[int], None] = lambda rate: None
        """Called with the bit rate that the device has from now on; 0: that of the bus."""
        self.state = NmtState.BOOT_UP
        self.entries: dict[tuple[int, int], Entry] = {(e.index, e.subindex): e for s in objects for e in s.entries}
        self.indices = {spec.index for spec in objects}
        self.values: dict[tuple[int, int], Value] = {}
        self.stored: dict[tuple[int, int], Value] = {}
        """Values after a reset that replace those of the entries."""
        self.boot_ms = 0
        """Time without answers after power-on and reset."""
        self.starts_itself = False
        """The node enters Operational by itself after its boot-up message."""
        self.changes_are_events = True
        """A changed value sends an event-driven TPDO, not its event timer alone."""
        self.changes_are_sent_twice = False
        """Each such TPDO comes twice."""
        self.inhibit_ms = 0
        """Shortest inhibit time of TPDOs."""

    # -- services of the node ---------------------------------------------------------------------------------------

    @property
    def running(self) -> bool:
        """Whether the device is powered and booted."""
        return self.state is not NmtState.BOOT_UP

    def receive(self, can_id: int, data: bytes, now: int, past: object = None) -> bool:
        """Process a frame from the bus; ``past`` is the behaviour that delayed it. False when ``next_event`` has not changed."""
        raise NotImplementedError

    def transmit(self, can_id: int, data: bytes, past: object = None) -> None:
        """Send a frame on the bus; ``past`` is the behaviour that delayed it."""
        raise NotImplementedError

    def send_heartbeat(self, past: object = None) -> None:
        """Send a heartbeat, if the device is a producer of heartbeats."""
        raise NotImplementedError

    def send_emcy(self, code: int, register: int, data: bytes = b"") -> None:
        """Send an emergency message and enter it in 1003h."""
        raise NotImplementedError

    def is_pdo(self, can_id: int) -> bool:
        """Whether a COB-ID is one of the node's valid PDOs."""
        raise NotImplementedError

    def power_off(self) -> None:
        """Switch off; no frames until the node is started."""
        raise NotImplementedError

    def renumber(self, node_id: int) -> None:
        """Reset communication, with this node-ID from now on."""
        raise NotImplementedError

    def restart(self) -> None:
        """Restart the firmware: power-on values, boot-up message."""
        raise NotImplementedError

    # -- hooks of the device ----------------------------------------------------------------------------------------

    def event_timer(self, index: int) -> int:
        """Milliseconds between two transmissions of the TPDO with this communication parameter; 0: no timer."""
        return int(self.values.get((index, 5), 0))

    def sent_on_change(self, transmission_type: int) -> bool:
        """Whether a changed value is an event of this event-driven transmission type (254 or 255)."""
        return self.changes_are_events

    def storable(self, entry: Entry) -> bool:
        """Whether 1010h saves this writable object."""
        return not entry.attribute

    def on_poll(self, now: int) -> None:
        """Update the image to ``now``."""

    def next_change(self, now: int) -> int | None:
        """Time of the next possible change of the image after ``now``; None: only after a frame or a command."""
        return None

    def steady(self, pdo: Pdo, ticks: int) -> bool:
        """Whether no value of a TPDO changes by itself for this number of milliseconds, although the image does."""
        return False

    def on_touched(self) -> None:
        """A frame or a command has arrived; ``on_poll`` follows."""

    def on_written(self, entry: Entry, value: Value) -> None:
        """An object was written by SDO; raise ``SdoAbortedError`` to reject it (then nothing is stored)."""

    def apply(self, pdo: Pdo, data: bytes) -> None:
        """Store the values of a received RPDO in the image; of a synchronous one, after its SYNC."""
        pdo.unpack_into(data, self.image)
        self.on_rpdo(pdo)

    def on_rpdo(self, pdo: Pdo) -> None:
        """The values of an RPDO are in the image."""

    def packed(self, pdo: Pdo) -> bytes:
        """The data of a TPDO to send."""
        return pdo.pack(self.image)

    def on_sync(self) -> None:
        """A SYNC arrived in operation. The RPDOs that waited for it are in the image."""

    def on_nmt(self, state: NmtState) -> None:
        """The NMT state changed."""

    def on_consumer_expired(self, producer: int) -> None:
        """A monitored heartbeat has stopped."""

    def on_foreign_frame(self, can_id: int, data: bytes) -> bool:
        """Process a frame for other nodes. Return whether it changed something."""
        return False

    def on_reset(self) -> None:
        """Reset node: return to power-on values."""
