"""The drive's own values of objects that the gateway overwrites: limits, ramps and homing speeds.

A value is read and saved before it is overwritten, and is kept until it was written back to the drive. While it is kept, what
the drive shows for the object was written by the gateway and is not used, even after a restart of the drive, its
node or the gateway. No I/O of its own: ``OwnValueKeeper`` gets functions for SDO access.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Final

from pdgw.ds301.aborts import SdoAbortedError
from pdgw.ds301.node.node import Notice
from pdgw.ds301.objects import ObjectAddress
from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.objects import HOMING_SPEEDS, MAX_TORQUE

_COMMANDED_BY_SDO: Final = frozenset({MAX_TORQUE, (HOMING_SPEEDS, 1), (HOMING_SPEEDS, 2)})
"""Objects that the gateway commands by SDO in operation, and other telegrams leave to the drive."""
_MOST: Final = 16
"""Values kept as written by the gateway: the drive has one of the last two. The others save writes of the store."""


@dataclass(frozen=True, slots=True)
class OwnValue:
    """One object that the gateway overwrites; values are its raw bytes as an unsigned number."""

    index: int
    subindex: int
    size: int
    """In bytes."""
    value: int
    """The drive's own."""
    written: tuple[int, ...] | None = None
    """Values that the gateway has written by SDO, the newest last; None for an object in an RPDO, which may have any value."""

    @property
    def address(self) -> ObjectAddress:
        """Index and sub-index."""
        return self.index, self.subindex

    def replaced_by(self, shown: int) -> bool:
        """Whether the value that the drive shows is one that the gateway wrote."""
        return self.written is None or shown in self.written

    def text(self, value: int) -> str:
        """Object and value, for messages."""
        return f"{self.index:04X}h{f'/{self.subindex}' if self.subindex else ''} = {value}"


@dataclass(frozen=True, slots=True)
class OwnValues:
    """The stored values of one drive. ``identity``: vendor-ID, product code and serial number (1018h/1, 2 and 4)."""

    identity: tuple[int, int, int] = (0, 0, 0)
    values: tuple[OwnValue, ...] = ()


class OwnValueKeeper:
    """Keeps the own values of one drive, in its task.

    ``read`` returns the data of an object, None for one that is not there, and nothing for one that cannot be read now.
    ``write`` raises what an SDO write raises. ``notify`` is called with an event of the node and its text.
    """

    def __init__(
        self,
        read: Callable[[int, int], bytes | None],
        write: Callable[[int, int, bytes], None],
        notify: Callable[[Notice, str], None],
    ) -> None:
        self._read = read
        self._write = write
        self._notify = notify
        self.identity = (0, 0, 0)
        """Identity of the connected drive."""
        self.save: Callable[[OwnValues], bool] = lambda _: True
        """Saves for the next process; True when the values survive a crash."""
        self._saved = OwnValues()
        self._values: dict[ObjectAddress, OwnValue] = {}
        self._unproven = False
        """The values are of another process and of a drive without a serial number: it may have been exchanged."""

    def load(self, saved: OwnValues) -> None:
        """Continue with what another process had kept."""
        self._saved = saved
        self.identity = saved.identity
        self._values = {item.address: item for item in saved.values}
        self._unproven = saved.identity[2] == 0

    def __bool__(self) -> bool:
        return bool(self._values)

    def __contains__(self, address: object) -> bool:
        return address in self._values

    def value(self, address: ObjectAddress) -> int | None:
        """The drive's own value; None: what the drive shows is its own."""
        kept = self._values.get(address)
        return None if kept is None else kept.value

    def identify(self, identity: tuple[int, int, int]) -> None:
        """This drive is there. The values of another one are dropped."""
        if self._values and identity != self.identity:
            texts = ", ".join(item.text(item.value) for item in self._values.values())
            self._notify(
                Notice.PROGRESS, f"another drive (1018h): the kept own values of the last one are dropped: {texts}"
            )
            self._values.clear()
        if self._unproven:
            # The value may be another drive's and too high; what the drive shows can only be too low.
            dropped = [item for item in self._values.values() if item.written is None]
            for item in dropped:
                del self._values[item.address]
            if dropped:
                texts = ", ".join(item.text(item.value) for item in dropped)
                self._notify(
                    Notice.PROGRESS,
                    f"no serial number (1018h/4): own values of before are not used, check them: {texts}",
                )
            self._unproven = False
        self.identity = identity

    def show(self) -> None:
        """Write own values to the drive and keep them: the RPDOs overwrite them again."""
        for kept in self._values.values():
            self._write(*kept.address, kept.value.to_bytes(kept.size, "little"))

    def discard(self, address: ObjectAddress) -> None:
        """A parameter client wrote the object: its value is the drive's own."""
        if self._values.pop(address, None) is not None:
            self.commit()

    def trust(self) -> None:
        """The gateway's values are no longer in the drive, so the values of its next start are its own."""
        self._values = {address: replace(kept, written=()) for address, kept in self._values.items()}
        self.commit()

    def write_back(self, addresses: Collection[ObjectAddress] | None = None) -> None:
        """Write own values back where the drive shows what the gateway wrote, and keep them no longer; None: all."""
        for kept in list(self._values.values()):
            if addresses is not None and kept.address not in addresses:
                continue
            data = self._read(*kept.address)
            if data == b"":
                self._notify(Notice.PROGRESS, f"{kept.text(kept.value)} is not written back: it cannot be read now")
                continue
            shown = int.from_bytes(data or b"", "little")
            if data is None or shown == kept.value:
                text = ""  # the drive has its own value, or lacks the object now
            elif kept.replaced_by(shown):
                text = (
                    f"{kept.text(shown)} was written by the gateway: the drive's own value {kept.value} is written back"
                )
                try:
                    self._write(*kept.address, kept.value.to_bytes(kept.size, "little"))
                except SdoAbortedError as error:
                    self._notify(
                        Notice.PROGRESS, f"{kept.text(shown)}: the own value {kept.value} is not written back: {error}"
                    )
                    continue
            else:
                text = f"{kept.text(shown)} is the drive's own value now, {kept.value} before: another tool wrote it"
            del self._values[kept.address]
            if text:
                self._notify(Notice.PROGRESS, text)

    def carry(self, carried: Collection[ObjectAddress], *, off: bool) -> None:
        """At a start of the node, before it is asked for its limits: write back what the gateway does not overwrite from now on.

        ``carried``: objects of the RPDOs. Max Torque (6072h) is read again, so it is written back, too; not while the drive
        has power (``off``), because the PLC may ask for less.
        """
        left = (
            address
            for address, kept in self._values.items()
            if address not in carried or kept.written is not None or (off and address == MAX_TORQUE)
        )
        self.write_back(list(left))

    def overwrite(self, address: ObjectAddress) -> None:
        """RPDOs carry this object from now on; ``commit`` follows."""
        if address in self._values:
            return
        if data := self._read(*address):
            self._values[address] = OwnValue(*address, len(data), int.from_bytes(data, "little"))
        elif data is not None:
            self._notify(Notice.PROGRESS, f"{address[0]:04X}h cannot be read now: its own value is not kept")

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object by SDO in operation; its own value is saved before. Dsp402Error if it cannot be read."""
        address = index, subindex
        value, kept = int.from_bytes(data, "little"), self._values.get(address)
        if kept is None and address in _COMMANDED_BY_SDO and (own := self._read(*address)) is not None:
            if not own:
                raise Dsp402Error(
                    f"{index:04X}h/{subindex}", value, "an object that can be read, to keep the drive's own value"
                )
            kept = OwnValue(*address, len(own), int.from_bytes(own, "little"), ())
        if kept is None or kept.written is None or value == kept.value:
            self._write(*address, data)
            return
        others = [item for item in kept.written if item != value][1 - _MOST :]
        self._values[address] = replace(kept, written=(*others, value))
        if value not in kept.written:
            self.commit()
        try:
            self._write(*address, data)
        except SdoAbortedError:
            self._values[address] = replace(kept, written=(value, *others))  # the drive has the value of before
            raise

    def commit(self) -> None:
        """Save what has changed."""
        now = OwnValues(self.identity, tuple(self._values.values())) if self._values else OwnValues()
        if now != self._saved and self.save(now):
            self._saved = now
