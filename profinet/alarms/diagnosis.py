"""Diagnosis of the device: faults of submodules, as alarms and as records.

Source: IEC 61158-6-10 (ChannelDiagnosis), PROFIdrive (message classes). One entry per class and submodule: a repeated fault is
present once. The store has the present faults. Each relationship reports the changes to its controller, so a fault that
flickers while an alarm is unacknowledged cannot fill a queue.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from pdgw.profinet.blocks.alarm import (
    AR_DIAGNOSIS,
    CHANNEL_DIAGNOSIS,
    DIRECTION_BOTH,
    DIRECTION_SHIFT,
    NOTIFICATIONS,
    SEQUENCE_MASK,
    SEVERITY_SHIFT,
    SPECIFIER_SHIFT,
    SUBMODULE_DIAGNOSIS,
    USI_CHANNEL_DIAGNOSIS,
    USI_EXTENDED_DIAGNOSIS,
    AlarmNotification,
    AlarmType,
    ChannelDiagnosis,
    DiagnosisBlock,
    ExtendedDiagnosis,
    Priority,
    Severity,
    Specifier,
)
from pdgw.profinet.model import DeviceModel, Subslot

ErrorType = tuple[int, int]
"""ChannelErrorType and ExtChannelErrorType; 0: one without subtypes."""
NO_SUBTYPE: Final = 0


def _entry(error: ErrorType, severity: Severity, specifier: Specifier) -> bytes:
    properties = DIRECTION_BOTH << DIRECTION_SHIFT | specifier << SPECIFIER_SHIFT | severity << SEVERITY_SHIFT
    error_type, subtype = error
    out = bytearray()
    if subtype == NO_SUBTYPE:
        ChannelDiagnosis(properties=properties, error_type=error_type).write(out)
    else:
        ExtendedDiagnosis(properties=properties, error_type=error_type, ext_error_type=subtype).write(out)
    return bytes(out)


def _usi(error: ErrorType) -> int:
    return USI_CHANNEL_DIAGNOSIS if error[1] == NO_SUBTYPE else USI_EXTENDED_DIAGNOSIS


class Diagnosis:
    """The present diagnosis, by submodule and error type."""

    def __init__(self) -> None:
        self._present: dict[Subslot, dict[ErrorType, Severity]] = {}
        self.changes = 0
        """Number of changes."""

    def set(
        self, place: Subslot, error_type: int, severity: Severity = Severity.FAULT, subtype: int = NO_SUBTYPE
    ) -> None:
        """Add an entry or change its severity."""
        self._present.setdefault(place, {})[error_type, subtype] = severity
        self.changes += 1

    def clear(self, place: Subslot, error_type: int | None = None, subtype: int = NO_SUBTYPE) -> None:
        """Remove an entry; None: all of the submodule."""
        self.changes += 1
        if error_type is None:
            self._present.pop(place, None)
            return
        entries = self._present.get(place, {})
        entries.pop((error_type, subtype), None)
        if not entries:
            self._present.pop(place, None)

    def of(self, place: Subslot) -> Mapping[ErrorType, Severity]:
        """The present diagnosis of a submodule."""
        return self._present.get(place, {})

    def all(self) -> Iterator[tuple[Subslot, ErrorType, Severity]]:
        """Everything that is present."""
        for place, entries in sorted(self._present.items()):
            for error, severity in sorted(entries.items()):
                yield place, error, severity

    @property
    def has_fault(self) -> bool:
        """A fault (no maintenance alone) is present."""
        return any(severity is Severity.FAULT for _, _, severity in self.all())

    def record(self, model: DeviceModel, places: list[Subslot], severities: Collection[Severity]) -> bytes:
        """Diagnosis records of these submodules with these severities; empty without diagnosis."""
        blocks: dict[tuple[Subslot, int], bytes] = {}
        for place in places:
            for error, severity in sorted(self.of(place).items()):
                if severity in severities:
                    key = place, _usi(error)
                    blocks[key] = blocks.get(key, b"") + _entry(error, severity, Specifier.APPEARS)
        out = bytearray()
        for (place, usi), entries in blocks.items():
            out += bytes(-len(out) % 4)
            block = DiagnosisBlock(
                api=model.modules[place[0]].api, slot=place[0], subslot=place[1], usi=usi, entries=entries
            )
            out += block.encode()
        return bytes(out)


@dataclass(frozen=True, slots=True)
class Notification:
    """An alarm ready to be sent."""

    priority: Priority
    block: AlarmNotification


class AlarmSource:
    """Pending reports of one relationship: differences between ``Diagnosis`` and its last reports, and submodules that
    returned."""

    def __init__(self, diagnosis: Diagnosis, model: DeviceModel, places: frozenset[Subslot]) -> None:
        self._diagnosis = diagnosis
        self._model = model
        self._places = places
        self._reported: dict[tuple[Subslot, ErrorType], Severity] = {}
        self._returned: list[Subslot] = []
        self._sequence = 0
        self._seen = -1

    @property
    def pending(self) -> bool:
        """Whether ``next`` may have an alarm. Called in each cycle, so nothing is compared without a change."""
        return bool(self._returned) or self._seen != self._diagnosis.changes

    def returned(self, place: Subslot) -> None:
        """A submodule's data is valid again."""
        if place in self._places and place not in self._returned:
            self._returned.append(place)

    def next(self) -> Notification | None:
        """The next alarm; it counts as reported from now on."""
        present = {
            (place, error): severity for place, error, severity in self._diagnosis.all() if place in self._places
        }
        for key in list(self._reported):
            if key not in present or present[key] is not self._reported[key]:
                severity = self._reported.pop(key)
                others = any(place == key[0] for place, _ in self._reported)
                specifier = Specifier.OTHERS_REMAIN if others else Specifier.DISAPPEARS
                return self._diagnosis_alarm(AlarmType.DIAGNOSIS_DISAPPEARS, key, severity, specifier)
        for key, severity in present.items():
            if key not in self._reported:
                self._reported[key] = severity
                return self._diagnosis_alarm(AlarmType.DIAGNOSIS, key, severity, Specifier.APPEARS)
        if self._returned:
            return self._notification(AlarmType.RETURN_OF_SUBMODULE, self._returned.pop(0), 0, b"")
        self._seen = self._diagnosis.changes
        return None

    def _diagnosis_alarm(
        self, kind: AlarmType, key: tuple[Subslot, ErrorType], severity: Severity, specifier: Specifier
    ) -> Notification:
        place, error = key
        payload = _usi(error).to_bytes(2, "big") + _entry(error, severity, specifier)
        return self._notification(kind, place, CHANNEL_DIAGNOSIS, payload)

    def _notification(self, kind: AlarmType, place: Subslot, bits: int, payload: bytes) -> Notification:
        if any(known == place for known, _ in self._reported):
            bits |= SUBMODULE_DIAGNOSIS
        if self._reported:
            bits |= AR_DIAGNOSIS
        module = self._model.modules[place[0]]
        block = NOTIFICATIONS[Priority.LOW](
            alarm_type=kind,
            api=module.api,
            slot=place[0],
            subslot=place[1],
            module_ident=module.ident,
            submodule_ident=module.submodules[place[1]].ident,
            specifier=bits | self._sequence,
            payload=payload,
        )
        self._sequence = (self._sequence + 1) & SEQUENCE_MASK
        return Notification(Priority.LOW, block)
