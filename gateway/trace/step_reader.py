"""The steps of a recording as the recorder has written them: recorded values, and those of the frames between them.

Each recorded step is compared with the frames, so that an error in the unpacking of PDOs here is found.
"""

from __future__ import annotations

import json
import struct
from typing import Any, Final, NamedTuple

from pdgw.gateway.trace import pcapng
from pdgw.gateway.trace.pcapng import GROUPS, Description, TracedObject, time_of

_RECORDED: Final = pcapng.SETPOINTS | pcapng.VALUES | pcapng.NO_SETPOINTS | pcapng.HAS_EVENTS
_FLAGS, _COMMAND = GROUPS.index("flags"), GROUPS.index("command")
_Place = tuple[int, int]
"""A value of a step: number of its group, place in the group."""
_Key = tuple[int, int]
"""Bus and COB-ID."""


class Step(NamedTuple):
    """A step of a drive object; ``TracedObject.groups`` has the names of the values. ``events``: plain data, see ``steps``."""

    setpoints: tuple[int, ...] | None
    flags: tuple[int, ...]
    numbers: tuple[int, ...]
    feedback: tuple[int, ...]
    sensors: tuple[int, ...]
    decided: tuple[int, ...]
    command: tuple[int, ...]
    events: dict[str, Any]
    is_sent: bool = True
    """``command`` is the command of this step; False: the newest one in the RPDOs, because they wait or are withheld."""
    by_frames: bool = False
    """The frames have its values, which were not recorded."""
    contradictions: tuple[tuple[str, object, object], ...] = ()
    """Values whose frames differ from this record: the value with the frame's name, in the frame, recorded."""


class _Pdo:
    """A PDO of a drive object's devices, and where its values belong in a step."""

    def __init__(self, item: TracedObject, layout: str, names: list[str]) -> None:
        self.packed = struct.Struct(layout)
        known = {name: (group, at) for group, of in enumerate(GROUPS) for at, name in enumerate(item.groups[of])}
        self.places: list[tuple[int, _Place]] = [(at, known[name]) for at, name in enumerate(names) if name in known]
        """Of its values, by their number."""
        self.times: list[_Place] = [known[time] for name in names if (time := time_of(name)) in known]
        """Where its time of arrival belongs."""
        self.is_rpdo = any(group == _COMMAND for _, (group, _) in self.places)


Routes = dict[_Key, dict["StepReader", _Pdo]]
"""Who takes the frames of a PDO."""


class StepReader:
    """The steps of one drive object; ``step``: the newest one. ``routes`` gets the PDOs of its devices."""

    def __init__(self, description: Description, place: int, routes: Routes) -> None:
        item = self._item = description.objects[place]
        self._buses = description.buses
        self._has_all = description.version == 1
        """A step has all that changed, and needs no frames."""
        self._structs = [
            item.chosen.setpoints.struct,
            *(struct.Struct(f">{len(item.groups[group])}q") for group in GROUPS[1:]),
        ]
        self._places = [(group, at) for group in range(1, len(GROUPS)) for at in range(len(item.groups[GROUPS[group]]))]
        """Of the values of a whole record, in their order, without the setpoints."""
        self._setpoints_at = description.places.setpoints[place]
        self._fresh_at = item.place("flags", "fresh")
        self._routes = routes
        self._noted: object = None
        self._pdos: dict[_Key, _Pdo] = {}
        """In the order in which the gateway takes their values."""
        self._arrived: dict[_Key, tuple[int, bytes]] = {}
        """The newest frame of each TPDO since the last step: when it came, and its data."""
        self._read: list[_Place] = []
        """The values that no PDO has."""
        self._of_rpdos: set[int] = set()
        """The places of RPDO values in the command; the others are written by SDO, and a change of them is recorded."""
        self._sent: dict[int, int] = {}
        """The values of the newest RPDOs by their places in the command."""
        self._was_online = False
        """The frames since the last step and its values give those of the next one."""
        self.step: Step | None = None

    def take(self, key: _Key, pdo: _Pdo, time_ns: int, data: bytes) -> None:
        """A frame of one of its PDOs since the last step."""
        if len(data) < pdo.packed.size:
            return
        if pdo.is_rpdo:
            values = pdo.packed.unpack_from(data)
            self._sent |= {at: values[value] for value, (_, at) in pdo.places}
        else:
            self._arrived[key] = time_ns, data

    def read(self, content: bytes, at: int, flags: int, received: bytes) -> int:
        """Read the next step, at ``at`` of a cycle's block; its end. ``flags``: of the cycle; ``received``: frame of the PLC."""
        (mask,) = pcapng.MASK.unpack_from(content, at)
        at += pcapng.MASK.size
        changes: list[tuple[_Place, int]] = []
        if mask & pcapng.READ:
            values = struct.unpack_from(f">{len(self._read)}q", content, at)
            at += 8 * len(values)
            changes += zip(self._read, values, strict=True)
        step = None if self.step is None else self._follow(self.step, mask, flags, received, changes)
        if mask & _RECORDED:
            groups: list[Any] = [None] * len(GROUPS) if step is None else list(step[: len(GROUPS)])
            if mask & pcapng.NO_SETPOINTS:
                groups[0] = None
            for group, packed in enumerate(self._structs):
                if mask & 1 << group:
                    groups[group] = packed.unpack_from(content, at)
                    at += packed.size
            events: dict[str, Any] = {}
            if mask & pcapng.HAS_EVENTS:
                (size,) = pcapng.LENGTH.unpack_from(content, at)
                at += pcapng.LENGTH.size + size
                events = json.loads(content[at - size : at])
            self._map(events.pop("pdos", self._noted))
            self._read = [self._places[at] for at in events.pop("read")] if "read" in events else self._read
            if step is not None or flags & pcapng.WHOLE:
                given = Step._make((*groups, events, True, False, ()))
                step = self._recorded(given, step, mask, flags, received)
        self.step = step
        self._arrived.clear()
        return at

    def _map(self, pdos: Any) -> None:
        """Take the frames of these PDOs from now on."""
        if pdos == self._noted:
            return
        for key in self._pdos:
            del self._routes[key][self]
        self._noted, self._sent, self._was_online = pdos, {}, False
        self._pdos = {
            (self._buses.index(bus), cob_id): _Pdo(self._item, layout, names) for bus, cob_id, layout, names in pdos
        }
        self._of_rpdos = {at for pdo in self._pdos.values() if pdo.is_rpdo for _, (_, at) in pdo.places}
        for key, pdo in self._pdos.items():
            self._routes.setdefault(key, {})[self] = pdo

    def _follow(self, last: Step, mask: int, flags: int, received: bytes, changes: list[tuple[_Place, int]]) -> Step:
        """The step that follows from the last one, the frames since then and the ``changes`` that no frame has."""
        if self._has_all:
            return last._replace(events={}) if last.events else last
        groups: list[Any] = list(last[: len(GROUPS)])
        fresh = int(bool(flags & pcapng.FRESH))
        if fresh and last.setpoints is not None and self._setpoints_at is not None:
            groups[0] = self._structs[0].unpack_from(received, self._setpoints_at)
        if self._fresh_at is not None:
            changes.append(((_FLAGS, self._fresh_at), fresh))
        is_sent, by_frames = last.is_sent, not mask & pcapng.AS_BEFORE
        if by_frames:
            for key, pdo in self._pdos.items():
                if key in self._arrived:
                    time_ns, data = self._arrived[key]
                    values = pdo.packed.unpack_from(data)
                    changes += [(place, values[value]) for value, place in pdo.places]
                    changes += [(place, time_ns) for place in pdo.times]
            changes += [((_COMMAND, at), value) for at, value in self._sent.items()]
            is_sent = bool(mask & pcapng.SENT) and self._of_rpdos <= self._sent.keys()
        return Step._make((*_changed(groups, changes), {}, is_sent, by_frames, ()))

    def _recorded(self, step: Step, frames: Step | None, mask: int, flags: int, received: bytes) -> Step:
        """A recorded step. ``frames``: as the frames have it."""
        found: list[tuple[str, object, object]] = []
        if flags & pcapng.FRESH and step.setpoints is not None and self._setpoints_at is not None:
            setpoints = self._structs[0].unpack_from(received, self._setpoints_at)
            if setpoints != step.setpoints:
                found.append(("setpoints in the frame of the PLC", setpoints, step.setpoints))
        were_online, self._was_online = self._was_online, bool(mask & pcapng.ONLINE)
        if frames is not None and were_online and self._was_online:
            for pdo in self._pdos.values():
                if not pdo.is_rpdo or (mask & pcapng.SENT and frames.is_sent):
                    for group, at in [place for _, place in pdo.places] + pdo.times:
                        of = GROUPS[group]
                        shown, recorded = getattr(frames, of)[at], getattr(step, of)[at]
                        if shown != recorded:
                            kind = "RPDO" if pdo.is_rpdo else "TPDO"
                            found.append((f"{self._item.groups[of][at]} in the {kind}", shown, recorded))
        if mask & pcapng.SENT:
            self._sent = {at: step.command[at] for at in self._of_rpdos}
        return step._replace(contradictions=tuple(found)) if found else step


def _changed(groups: list[Any], changes: list[tuple[_Place, int]]) -> list[Any]:
    """The groups with other values."""
    lists: dict[int, list[int]] = {}
    for (group, at), value in changes:
        if group not in lists:
            lists[group] = list(groups[group])
        lists[group][at] = value
    for group, values in lists.items():
        groups[group] = tuple(values)
    return groups
