"""Give a device the values of its files at each bring-up: read them all, write those that differ, read them back.

Source: CiA 302-3 (configuration of devices by a master), CiA 301 (1020h). In the node's task. Nothing is stored in the device.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from pdgw.base.phrases import counted
from pdgw.ds301.aborts import NOT_THERE, Abort, CanopenError, SdoAbortedError, abort_text
from pdgw.ds301.communication import IDENTITY_REVISION, VERIFY_CONFIGURATION
from pdgw.ds301.node.configuring import ConfiguringAccess
from pdgw.ds301.objects import ObjectAddress
from pdgw.ds301.values import DeviceValue, DeviceValues, KnownDevice

_STAMP: Final = ((VERIFY_CONFIGURATION, 1), (VERIFY_CONFIGURATION, 2))
_WITH_POWER: Final = "the values of its files are compared without power"
NO_FILE: Final = (
    "it has its own parameters; save those of a sound device for the next time (pdgw device save) and set dcf"
)


class ValueWriter:
    """The values of one device. A device profile overrides what is special about its devices."""

    def __init__(self, sdo: ConfiguringAccess) -> None:
        self._sdo = sdo

    # -- the device profile's part ------------------------------------------------------------------------------------

    def acts_after_restart(self, index: int) -> bool:
        """Whether a new value of an object may not act before it was stored and the device has restarted."""
        return False

    def obstacle(self) -> str:
        """Why nothing may be written now; empty: it may."""
        return ""

    def urgent(self) -> bool:
        """Whether the device must be stopped before anything else: the comparison takes time."""
        return False

    def own_value(self, address: ObjectAddress) -> int | None:
        """The device's own value of an object that the gateway overwrites in operation; None: what the device shows."""
        return None

    def written(self, address: ObjectAddress) -> None:
        """An object has the value of a file now."""

    # -- values -------------------------------------------------------------------------------------------------------

    def revision(self) -> int:
        """1018h/3; 0 if the device has none."""
        return self._sdo.read_optional(*IDENTITY_REVISION)

    def check_identity(self, values: DeviceValues, device: KnownDevice) -> None:
        """CanopenError if the values are those of another device."""
        found = device.vendor_id, device.product_code
        for what, expected, number in zip(
            ("vendor-ID 1018h/1", "product code 1018h/2"), values.identity, found, strict=True
        ):
            if expected and number and expected != number:
                raise self._sdo.error_type(what, f"{number:08X}h", f"{expected:08X}h, as in {values.source}")

    def differing(self, values: Sequence[DeviceValue]) -> list[tuple[DeviceValue, bytes | None]]:
        """The values that the device does not have, each with what it holds; those that act after a restart first.

        None: it cannot be read. CanopenError for an object that it lacks.
        """
        ordered = sorted(values, key=lambda item: not self.acts_after_restart(item.index))
        held = ((item, self._read(item)) for item in ordered)
        return [(item, data) for item, data in held if data is None or not item.is_held_by(data)]

    def _read(self, item: DeviceValue) -> bytes | None:
        try:
            data = self._sdo.read(*item.address)
        except SdoAbortedError as error:
            if error.code == Abort.WRITE_ONLY:
                return None
            if error.code == Abort.NO_DATA:
                return b""  # a text without letters
            hint = f"; remove it from {item.source}" if error.code in NOT_THERE else ""
            raise self.wrong(item, abort_text(error.code), f"an object that the device has and shows{hint}") from error
        own = self.own_value(item.address)
        return data if own is None else own.to_bytes(len(data), "little")

    def wrong(self, item: DeviceValue, found: object, allowed: str) -> CanopenError:
        """The package's error about one value."""
        return self._sdo.error_type(f"{item.name} = {item.text()} of {item.source}", found, allowed)

    def write(self, values: Sequence[tuple[DeviceValue, bytes | None]]) -> None:
        """Write values and read them back. What is refused or changed by the device is tried once more after all others.

        CanopenError for a value that the device does not take.
        """
        again = [(item, held) for item, held in values if self._write(item, held) is not None]
        for item, held in again:
            if (error := self._write(item, held)) is not None:
                raise error

    def _write(self, item: DeviceValue, held: bytes | None) -> CanopenError | None:
        try:
            self._sdo.write_repeatedly(*item.address, item.encoded(len(held or b"")))
        except SdoAbortedError as error:
            return self.wrong(
                item, abort_text(error.code), f"a value that the device takes; correct it in {item.source}"
            )
        if held is not None:
            found = self._sdo.read(*item.address)
            if not item.is_held_by(found):
                remedy = f"the same value when read back: the device changes it; set what it has in {item.source}"
                return self.wrong(item, item.text(found), remedy)
        self.written(item.address)
        return None

    def stamp(self) -> tuple[int, int] | None:
        """1020h; None if the device has none."""
        try:
            days, milliseconds = (self._sdo.read_number(*address) for address in _STAMP)
        except SdoAbortedError:
            return None
        return days, milliseconds

    def clear_stamp(self) -> None:
        """1020h := 0: the device has other values than those it was stored with."""
        if any(self.stamp() or ()):
            for address in _STAMP:
                self._sdo.write_repeatedly(*address, bytes(4))


class DeviceConfiguration:
    """What the bring-ups of one node do with the values of its files, and what is known of its device.

    ``notify`` is called with one line for the log.
    """

    def __init__(self, notify: Callable[[str], None]) -> None:
        self._notify = notify
        self.known = KnownDevice()
        """The device of the last bring-up, also of another process."""
        self.save: Callable[[KnownDevice], object] | None = None
        """Keeps ``known`` for the next process; None: there is no store."""
        self.on_replaced: Callable[[str], object] = lambda _: None
        """Called with one line when the node is another device than before."""
        self.waiting = ""
        """Why a device with power does not have its values yet; it must not be started before the next bring-up without power."""
        self._replaced = ""
        self._values: dict[ObjectAddress, DeviceValue] = {}
        self._changed: dict[ObjectAddress, str] = {}
        """Values that were written by others since the last bring-up."""

    @property
    def notes(self) -> list[str]:
        """For the user: that the device was replaced, and each value that may be another one now."""
        return [*([self._replaced] if self._replaced else ()), *self._changed.values()]

    def bring_up(self, values: DeviceValues, device: KnownDevice, writer: ValueWriter) -> None:
        """Give the device that is there its values. CanopenError names one that it does not take, and what to do.

        The revision of ``device`` is read here where it is kept.
        """
        if self.save is not None:
            device = replace(device, revision=writer.revision())
        self._values = {item.address: item for item in values.items}
        written = verified = 0
        self.waiting = _WITH_POWER if values and writer.urgent() else ""
        if values and not self.waiting:
            writer.check_identity(values, device)
            if values.date != (0, 0) and writer.stamp() == values.date:
                verified = values.checksum
            same = self.known == replace(device, verified=verified) and device.serial_number != 0
            if verified and same and not self._changed:
                self._notify(f"{values.source}: not compared, 1020h of the device is that of the file")
            elif written := self._give(values, writer):
                # What is written is not stored: without power the device has the old values, and their 1020h.
                verified = 0
        if self.waiting:
            return
        self._changed.clear()
        if replaced := self.known.replaced_by(device):
            self._replaced = f"{replaced}, {counted(written, 'value')} written" if values else f"{replaced}; {NO_FILE}"
            self._notify(self._replaced)
            self.on_replaced(self._replaced)
        if self.known != (known := replace(device, verified=verified)):
            self.known = known
            if self.save is not None:
                self.save(known)

    def _give(self, values: DeviceValues, writer: ValueWriter) -> int:
        """Compare all values and write those that differ; returns their number."""
        differing = writer.differing(values.items)
        if differing:
            item, held = differing[0]  # those that act after a restart are first
            shown = "not readable" if held is None else item.text(held)
            if writer.acts_after_restart(item.index):
                remedy = "run pdgw device write --store, then switch the device off and on: it acts after a restart"
                raise writer.wrong(item, shown, f"the value of the file; {remedy}")
            if obstacle := writer.obstacle():
                allowed = f"the value of the file, written without power; {obstacle}"
                self.waiting = str(writer.wrong(item, shown, allowed))
                return 0
            writer.clear_stamp()
            writer.write(differing)
        own = f", {values.skipped} others are the gateway's own" if values.skipped else ""
        compared = counted(len(values.items), "value")
        self._notify(f"{values.source}: {compared} compared, {len(differing)} written{own}")
        return len(differing)

    # -- writes of others ---------------------------------------------------------------------------------------------

    def has(self, index: int, subindex: int) -> bool:
        """Whether a file has a value of this object."""
        return (index, subindex) in self._values

    def client_wrote(self, index: int, subindex: int, data: bytes) -> None:
        """A parameter client has written an object."""
        item = self._values.get((index, subindex))
        if item is not None and item.is_held_by(data):
            self._changed.pop(item.address, None)
        elif item is not None:
            self._changed[item.address] = f"{item.name} differs from {item.source} until the next bring-up"

    def other_wrote(self, index: int, subindex: int) -> None:
        """Another tool writes an object."""
        if (item := self._values.get((index, subindex))) is not None:
            text = f"another tool has written {item.name}, which may differ from {item.source} until the next bring-up"
            self._changed[item.address] = text
