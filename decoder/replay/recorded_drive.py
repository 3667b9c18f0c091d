"""A drive as its gateway knew it, by the recorded frames of its node and to it: for replay and timeline. Without I/O."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

from pdgw.decoder.frames.canopen.pdo_mapping import recorded_rpdo
from pdgw.decoder.frames.canopen.records import PdoLayout, PdoRecord, SdoRecord
from pdgw.decoder.replay.recorded import UNKNOWN_TORQUE, SdoResult
from pdgw.ds301.aborts import abort_text
from pdgw.ds301.pdo import Pdo, PdoDirection
from pdgw.dsp402.identification.generic import recorded_answer, recorded_drive_type, recorded_families
from pdgw.dsp402.objects import CONTROLWORD, HOMING_METHOD, MAX_TORQUE, MODE, MODE_DISPLAY, STATUSWORD
from pdgw.dsp402.optional_objects import image_entry
from pdgw.dsp402.states import ControlBit, State, state_of
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.values import Configured
from pdgw.profidrive.signals import signal

_HOME_POSITION_SET: Final = signal("ZSW1").bit("HOME_POSITION_SET", positioning=True).mask
"""Inputs of a machine beside the actual values."""
_CONTROL_BY_PLC: Final = signal("STW1").bit("CONTROL_BY_PLC").mask
_OFF: Final = ControlBit.ENABLE_VOLTAGE | ControlBit.QUICK_STOP
_OFF_MASK: Final = _OFF | ControlBit.SWITCH_ON
_UNPOWERED: Final = (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)


class PdoParts(NamedTuple):
    """The used parts of a PDO. A position is -1 if the object is missing."""

    direction: PdoDirection
    number: int
    word: int
    """Controlword of an RPDO, Statusword of a TPDO."""
    mode: int
    attributes: tuple[tuple[str, int], ...]
    """Attributes of ``DriveFeedback`` in a TPDO, with their positions."""

    def feedback(self, values: tuple[Any, ...]) -> tuple[tuple[str, int], ...]:
        """The attributes with their values."""
        return tuple((name, values[place]) for name, place in self.attributes if isinstance(values[place], int))


@dataclass
class RecordedDrive:
    """Feed it the frames of one node in their order."""

    started: bool = True
    """Until an NMT command says otherwise: a recording may begin in operation."""
    homing_method: int = 0
    sent: dict[PdoLayout, bytes] = field(default_factory=dict)
    """The newest payload of each RPDO."""
    families: tuple[str, ...] = recorded_families({})
    """The families of drives that the answers allow."""
    _read: bool = False
    """It was configured in the recording, which contains everything that the gateway read."""
    _answers: dict[tuple[int, int], int] = field(default_factory=dict)
    _last: dict[int, bytes] = field(default_factory=dict)
    _parts: dict[PdoLayout, PdoParts] = field(default_factory=dict)

    def configured(self, *, restarted: bool) -> Configured:
        """The drive as the gateway has read it until now."""
        self._read |= restarted
        drive = recorded_drive_type(frozenset(self._answers.items()))
        if not self._read and MAX_TORQUE not in self._answers:
            drive = replace(drive, max_torque=UNKNOWN_TORQUE)
        return Configured(drive, self.homing_method, restarted)

    def stop(self) -> None:
        """The node has left Operational."""
        self.started = False
        self._last.clear()

    def is_new(self, record: PdoRecord) -> bool:
        """Whether a payload is another one than the last with its identifier."""
        if self._last.get(record.cob_id) == record.data:
            return False
        self._last[record.cob_id] = record.data
        return True

    def parts(self, layout: PdoLayout) -> PdoParts:
        """The places of the values in a PDO."""
        return self._parts.get(layout) or self._parts.setdefault(layout, _parts(layout, self.families))

    def learn(self, record: SdoRecord) -> tuple[int | None, int] | None:
        """The end of an upload: the value of a reference before and now; None where it was none."""
        if record.index is None or record.subindex is None or record.value is None:
            return None
        address = record.index, record.subindex
        if address == HOMING_METHOD:
            self.homing_method = int.from_bytes(record.value, "little", signed=True)
        value = recorded_answer(address, record.value)
        if value is None or (address == MAX_TORQUE and self.started):
            return None  # in operation, the drive may report a limit that the gateway wrote
        before = self._answers.get(address)
        if before != value:
            self._answers[address] = value
            self.families = recorded_families(self._answers)
            self._parts.clear()
        return before, value

    def rpdos(self) -> Iterator[tuple[Pdo, bytes]]:
        """The newest payload of each RPDO that carries setpoints of the drive."""
        for layout, data in self.sent.items():
            if (pdo := recorded_rpdo(layout, self.families)) is not None:
                yield pdo, data


def _parts(layout: PdoLayout, families: tuple[str, ...]) -> PdoParts:
    direction = next(item for item in PdoDirection if layout.name.startswith(item.label))
    places = {address: position for position, address in enumerate(layout.addresses)}
    receives = direction is PdoDirection.RPDO
    entries = [(image_entry(*address, families), position) for address, position in places.items()]
    return PdoParts(
        direction,
        int(layout.name.removeprefix(direction.label)),
        places.get(CONTROLWORD if receives else STATUSWORD, -1),
        places.get(MODE if receives else MODE_DISPLAY, -1),
        tuple((entry.attribute, position) for entry, position in entries if entry is not None and not receives),
    )


def sdo_result(record: SdoRecord) -> SdoResult | None:
    """The end of a download, or an abort; None of any other SDO frame."""
    if record.index is None or record.subindex is None:
        return None
    if record.abort is not None:
        return SdoResult(record.time_ns, record.index, record.subindex, b"", abort_text(record.abort))
    if record.from_client or record.value is None or "download" not in record.step:
        return None
    return SdoResult(record.time_ns, record.index, record.subindex, record.value)


def asks_for_off(word: int, statusword: int, *, transparent: bool) -> bool:
    """Whether STW1, or the Controlword of telegram 100, asks an unpowered drive for OFF: nothing of before matters then."""
    if not transparent and not word & _CONTROL_BY_PLC:
        return False
    return word & _OFF_MASK == _OFF and state_of(statusword) in _UNPOWERED


def recall(machine: AxisMachine, sent: Iterable[tuple[Pdo, bytes]], zsw1: int | None) -> None:
    """Give a machine at such an OFF what the recording shows: the RPDOs in force, and whether ZSW1 has Home Position Set."""
    for pdo, data in sent:
        pdo.unpack_into(data, machine.outputs.command)
    if zsw1 is not None:
        machine.executor.recall(home_set=bool(zsw1 & _HOME_POSITION_SET))
