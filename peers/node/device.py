"""A CANopen device as its PDOs and its faults see it; ``SimulatedNode`` makes a node of it."""

from __future__ import annotations

from collections.abc import Sequence

from pdgw.ds301.nmt import NmtState
from pdgw.ds301.objects import Entry, ObjectSpec
from pdgw.ds301.pdo import Pdo

Value = int | float | bytes | str | bool


class Device:
    """Objects and values, the hooks of a device profile, and what the node offers."""

    def __init__(self, node_id: int, objects: Sequence[ObjectSpec], image: object) -> None:
        self.node_id = node_id
        self.image = image
        self.now = 0
        self.state = NmtState.BOOT_UP
        self.entries: dict[tuple[int, int], Entry] = {(e.index, e.subindex): e for s in objects for e in s.entries}
        self.indices = {spec.index for spec in objects}
        self.values: dict[tuple[int, int], Value] = {}

    # -- what the node offers ---------------------------------------------------------------------------------------

    @property
    def running(self) -> bool:
        """Powered and booted."""
        return self.state is not NmtState.BOOT_UP

    def receive(self, can_id: int, data: bytes, now: int, past: object = None) -> bool:
        """A frame from the bus; ``past`` is the fault that held it. Returns False when ``next_event`` is as before."""
        raise NotImplementedError

    def transmit(self, can_id: int, data: bytes, past: object = None) -> None:
        """Put a frame on the bus; ``past`` is the fault that held it."""
        raise NotImplementedError

    def send_emcy(self, code: int, register: int, data: bytes = b"") -> None:
        """An emergency message; entered in 1003h."""
        raise NotImplementedError

    def is_pdo(self, can_id: int) -> bool:
        """Whether a COB-ID is one of the node's valid PDOs."""
        raise NotImplementedError

    def power_off(self) -> None:
        """Silent until the node is started."""
        raise NotImplementedError

    def restart(self) -> None:
        """The firmware starts again: power-on values, boot-up message."""
        raise NotImplementedError

    # -- hooks of the device ----------------------------------------------------------------------------------------

    def event_timer(self, index: int) -> int:
        """Milliseconds between two transmissions of the TPDO with this communication parameter; 0 is none."""
        return int(self.values.get((index, 5), 0))

    def sent_on_change(self, transmission_type: int) -> bool:
        """Whether a changed value is an event of this event-driven transmission type (254 or 255)."""
        return True

    def storable(self, entry: Entry) -> bool:
        """Whether 1010h saves this writable object."""
        return not entry.attribute

    def on_poll(self, now: int) -> None:
        """Time passes: bring the image up to ``now``."""

    def next_change(self, now: int) -> int | None:
        """When the image may change by itself after ``now``, None: not before something is received or commanded."""
        return None

    def steady(self, pdo: Pdo, ticks: int) -> bool:
        """Whether no value of a TPDO changes by itself for so many milliseconds, although the image does."""
        return False

    def on_touched(self) -> None:
        """Something was received or commanded from outside; ``on_poll`` follows."""

    def on_written(self, entry: Entry, value: Value) -> None:
        """An object was written by SDO; raise ``SdoAbortedError`` to refuse it (nothing is stored then)."""

    def apply(self, pdo: Pdo, data: bytes) -> None:
        """Put the values of a received RPDO into the image; of a synchronous one, its SYNC came."""
        pdo.unpack_into(data, self.image)
        self.on_rpdo(pdo)

    def on_rpdo(self, pdo: Pdo) -> None:
        """The values of an RPDO are in the image."""

    def packed(self, pdo: Pdo) -> bytes:
        """What a TPDO is sent with."""
        return pdo.pack(self.image)

    def on_sync(self) -> None:
        """A SYNC in operation; the RPDOs that waited for it are in the image."""

    def on_nmt(self, state: NmtState) -> None:
        """The NMT state changed."""

    def on_consumer_expired(self, producer: int) -> None:
        """A guarded heartbeat stopped."""

    def on_foreign_frame(self, can_id: int, data: bytes) -> bool:
        """A frame that is meant for others; returns whether it changed something."""
        return False

    def on_reset(self) -> None:
        """Reset node: back to power-on values."""
