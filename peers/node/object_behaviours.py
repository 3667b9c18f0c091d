"""The behaviours of any simulated CANopen node in its object dictionary.

Source: CiA DS 301. ``peers/habits.toml`` has the habits that are made of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from pdgw.ds301 import communication as com
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.objects import CanType, Entry
from pdgw.ds301.pdo import PDO_PARAMETERS, PDOS_MAX, is_mapping_parameter
from pdgw.peers.node.behaviour import Behaviour
from pdgw.peers.node.device import Device, Value


def _value(node: Device, entry: Entry) -> Value:
    """The present value of an object."""
    value: Value = getattr(node.image, entry.attribute) if entry.attribute else node.values[entry.address]
    return value


class ObjectMissing(Behaviour):
    """Objects do not exist in the device (abort 06020000h). ``subindex``: the first one that is missing."""

    index = 0
    last = 0
    subindex = 0

    def _lacks(self, entry: Entry) -> bool:
        return self.index <= entry.index <= max(self.index, self.last) and entry.subindex >= self.subindex

    def reading(self, entry: Entry, data: bytes) -> bytes:
        return self.writing(entry, data)

    def writing(self, entry: Entry, data: bytes) -> bytes:
        if self._lacks(entry):
            raise SdoAbortedError(Abort.NO_SUCH_SUBINDEX if self.subindex else Abort.NO_SUCH_OBJECT)
        return data


class FewPdos(ObjectMissing):
    """The parameters of further PDOs do not exist."""

    pdos = 0

    def _lacks(self, entry: Entry) -> bool:
        return entry.index in PDO_PARAMETERS and entry.index % PDOS_MAX >= self.pdos


class MappingRefused(Behaviour):
    """Writes of mapping parameters are aborted. ``number_only``: only those of a number of mapped objects."""

    abort = Abort.READ_ONLY
    number_only = False

    def writing(self, entry: Entry, data: bytes) -> bytes:
        counts = entry.subindex == 0 and any(data)
        if is_mapping_parameter(entry.index) and (counts or not self.number_only):
            raise SdoAbortedError(self.abort)
        return data


class ObjectValue(Behaviour):
    """Objects have other values after power-on. ``read_only``: which cannot be written.

    ``type``: of objects that the device has besides its own. Without it, an object that the device lacks stays missing.
    """

    index = 0
    subindexes: Sequence[int] = (0,)
    value = 0
    read_only = False
    type = ""

    def begin(self) -> None:
        node = self.node
        self._own: dict[Entry, Value] = {}
        self._added: list[tuple[int, int]] = []
        for address in ((self.index, sub) for sub in self.subindexes):
            entry = node.entries.get(address)
            if entry is not None:
                self._own[entry] = _value(node, entry)
            elif self.type:
                node.indices.add(self.index)
                self._added.append(address)
                entry = Entry(*address, self.habit.name, CanType[self.type])
            if entry is not None:
                self._put(replace(entry, default=self.value), self.value)
                if entry.attribute:
                    node.stored[address] = self.value

    def end(self) -> None:
        node = self.node
        for address in self._added:
            del node.entries[address], node.values[address]
            node.indices.discard(self.index)
        for entry, value in self._own.items():
            node.stored.pop(entry.address, None)
            self._put(entry, value)

    def _put(self, entry: Entry, value: Value) -> None:
        self.node.entries[entry.address] = entry
        if entry.attribute:
            setattr(self.node.image, entry.attribute, value)
        else:
            self.node.values[entry.address] = value

    def writing(self, entry: Entry, data: bytes) -> bytes:
        if self.read_only and entry.index == self.index and entry.subindex in self.subindexes:
            raise SdoAbortedError(Abort.READ_ONLY)
        return data


class WrongIdentity(ObjectValue):
    """The device has another vendor-ID."""

    vendor_id = 0

    def begin(self) -> None:
        self.value = self.vendor_id
        super().begin()


class RoundedTimes(Behaviour):
    """Times in milliseconds are rounded up to multiples of ``step_ms``."""

    step_ms = 1

    def writing(self, entry: Entry, data: bytes) -> bytes:
        time = (
            data
            if entry.unit == "ms"
            else data[:2]
            if (entry.index, entry.subindex) == (com.CONSUMER_HEARTBEAT, 1)
            else b""
        )
        rounded = -(-int.from_bytes(time, "little") // self.step_ms) * self.step_ms
        return rounded.to_bytes(len(time), "little") + data[len(time) :]


class WriteRefused(Behaviour):
    """Writes of an object are aborted, with ``abort``."""

    index = 0
    abort = Abort.VALUE_RANGE

    def writing(self, entry: Entry, data: bytes) -> bytes:
        if entry.index == self.index:
            raise SdoAbortedError(self.abort)
        return data


class RoundedValue(Behaviour):
    """Values of an object are rounded down to multiples of ``step``."""

    index = 0
    step = 1

    def writing(self, entry: Entry, data: bytes) -> bytes:
        if entry.index != self.index or not entry.type.char:
            return data
        signed = entry.type.char.islower()
        value = int.from_bytes(data, "little", signed=signed)
        return (value // self.step * self.step).to_bytes(len(data), "little", signed=signed)


class ActsAfterRestart(Behaviour):
    """Values of an object act after storing (1010h) and a restart. Until then the device shows new ones and acts by old ones."""

    index = 0

    def begin(self) -> None:
        self._shown: dict[Entry, bytes] = {}
        self._stored: dict[Entry, bytes] = {}

    def reading(self, entry: Entry, data: bytes) -> bytes:
        return self._shown.get(entry, data)

    def writing(self, entry: Entry, data: bytes) -> bytes:
        if entry.index == com.STORE_PARAMETERS:
            self._stored = dict(self._shown)
        if entry.index != self.index:
            return data
        self._shown[entry] = data
        return int(_value(self.node, entry)).to_bytes(len(data), "little", signed=entry.type.char.islower())

    def restarting(self, *, powered: bool) -> None:
        if powered:
            for entry, data in self._stored.items():
                signed = entry.type.char.islower()
                self.node.stored[entry.address] = int.from_bytes(data, "little", signed=signed)
            self._shown.clear()


class SyncCounter(ObjectValue):
    """The device has 1019h, and accepts a SYNC only with the counter that this object demands."""

    type = "U8"

    def incoming(self, can_id: int, data: bytes) -> bool:
        sync = can_id == self.node.values[com.SYNC_COB_ID, 0]
        return not sync or bool(data) is bool(self.node.values[self.index, 0])

    def writing(self, entry: Entry, data: bytes) -> bytes:
        if entry.index == self.index and self.node.values.get((com.SYNC_PERIOD, 0)):
            raise SdoAbortedError(Abort.CANNOT_STORE_DEVICE_STATE)
        return super().writing(entry, data)


OBJECT_BEHAVIOURS: Final = (
    ObjectMissing,
    FewPdos,
    MappingRefused,
    ObjectValue,
    WrongIdentity,
    RoundedTimes,
    WriteRefused,
    RoundedValue,
    ActsAfterRestart,
    SyncCounter,
)
