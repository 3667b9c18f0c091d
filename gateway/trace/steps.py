"""Steps of drive objects as bytes.

The step of a drive object is what its machine was given and what it decided. The frames of the same cycle are in the same
recording. While they have all that has changed, a step is two bytes, and the reader gets setpoints, feedback and command from
the frames. Values that are read or written by SDO follow if they change. A step is recorded with all of its values if
something else has changed, if the frames do not have its values (device not online, RPDO waiting), and once a second.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, Final, cast

from pdgw.ds301.node.client import NodeClient
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive.rpdos import RpdoSender
from pdgw.gateway.axis.encoder_machine import EncoderInputs
from pdgw.gateway.axis.orders import Brake
from pdgw.gateway.axis.values import EncoderInput, Events, Inputs, Outputs, ProbeWish, SdoWrite
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.objects.encoder import ChannelInput, EncoderObject
from pdgw.gateway.trace.json_values import to_json
from pdgw.gateway.trace.pcapng import (
    AS_BEFORE,
    GROUPS,
    HAS_EVENTS,
    LENGTH,
    MASK,
    NO_SETPOINTS,
    ONLINE,
    READ,
    SENT,
    SETPOINTS,
    VALUES,
    TracedObject,
    time_of,
)

_SENSOR: Final = (
    "position",
    "position_time",
    "speed",
    "alarms",
    "warnings",
    "error_register",
    "error_code",
    "valid",
    "ok",
)
"""The values of an encoder, as ``EncoderInput`` has them, and whether it is online."""
NO_SPEED: Final = -(1 << 63)
"""Recorded speed of an encoder without a speed."""
_AGES: Final = {
    "velocity_actual": ("speed_asked_ns", "speed_until_ns"),
    "position_actual": ("position_asked_ns", "position_old"),
}
"""What belongs to a value of a drive that is read by SDO."""
_KNOWN: Final = {"now", "standstill", "standstill_unknown", "saturations"}
"""Values that need not be recorded: the cycle has the first, and the step sets the others itself."""
_BY_FRAMES: Final = MASK.pack(0)
_SENT: Final = MASK.pack(SENT)
_AS_BEFORE: Final = MASK.pack(AS_BEFORE)


EVENTS: Final = tuple(sorted(item.name for item in fields(Events)))
"""What a step reports in ``Outputs.events``."""


def _numbers(item: object) -> dict[str, type]:
    """The attributes with a number, by name; of a new object, because this makes all later accesses to its attributes slow."""
    kinds = ((name, type(getattr(item, name))) for name in dir(item) if name.islower() and not name.startswith("_"))
    return {name: kind for name, kind in kinds if issubclass(kind, int) and name not in _KNOWN}


def _given(item: object) -> dict[str, tuple[str, ...]]:
    """The names of flags and of numbers."""
    found = _numbers(item)
    flags = tuple(name for name, kind in found.items() if kind is bool)
    return {"flags": flags, "numbers": tuple(name for name in found if name not in flags)}


_AXIS: Final = _given(Inputs(DriveFeedback()))
_ENCODER: Final = _given(EncoderInputs(cast("EncoderInput", None)))
_DECIDED: Final = tuple(_numbers(Outputs(0, None)))


_Attribute = tuple[object, str]


class _Sensor:
    """A channel of an encoder that a machine is given."""

    def __init__(self, inputs: Inputs | EncoderInputs, place: int, source: ChannelInput) -> None:
        self.prefix = f"{place}."
        self.source = source
        self._inputs = inputs
        self._place = place

    @property
    def ok(self) -> bool:
        """It is configured, and its data is fresh."""
        inputs = self._inputs
        return inputs.encoders_ok[self._place] if isinstance(inputs, Inputs) else inputs.ok

    @property
    def speed(self) -> int:
        """As it is recorded."""
        speed = self.source.speed
        return NO_SPEED if speed is None else speed


class StepRecord:
    """Records one drive object until its telegram changes."""

    def __init__(
        self,
        item: DriveObject,
        inputs: Inputs | EncoderInputs,
        sources: Sequence[EncoderInput | None],
        names: Mapping[str, tuple[str, ...]],
        image: DriveFeedback | None = None,
    ) -> None:
        assert item.given is not None
        self._item = item
        self._given = item.given
        self._step = inputs
        outputs = self._outputs = item.outputs
        self._log = item.fault_log
        self._sensors = [
            _Sensor(inputs, place, source) for place, source in enumerate(sources) if isinstance(source, ChannelInput)
        ]
        setpoints = item.telegram.setpoints
        groups = {group: tuple(names.get(group, ())) for group in GROUPS}
        groups["setpoints"] = setpoints.names
        groups["sensors"] = tuple(each.prefix + name for each in self._sensors for name in _SENSOR)
        groups["decided"] = (*_DECIDED, "reason", "faults")
        chosen = item.telegram
        self.traced = TracedObject(
            item.do_id,
            item.kind,
            item.node_id,
            item.network.name,
            chosen.number,
            groups,
            chosen.like,
            chosen.actuals.names if chosen.like else (),
        )
        self._attributes: list[_Attribute] = [
            *((inputs, name) for name in (*groups["flags"], *groups["numbers"])),
            *((image, name) for name in groups["feedback"]),
            *((each if name in ("ok", "speed") else each.source, name) for each in self._sensors for name in _SENSOR),
            *((outputs, name) for name in _DECIDED),
            (self, "reason_code"),
            (item.fault_log, "count"),
            *((outputs.command, name) for name in groups["command"]),
        ]
        """Of all values but the setpoints, in the order of the groups."""
        self._pack_setpoints = setpoints.struct.pack
        self._pack = struct.Struct(f">{len(self._attributes)}q").pack
        self._devices: list[tuple[NodeClient[Any], dict[str, str]]] = [
            (each.source.client, {name: each.prefix + value for name, value in each.source.attributes.items()})
            for each in self._sensors
        ]
        """The devices, and the names of the values in the step by their image attributes."""
        self._rpdos: RpdoSender | None = None
        self._generations: list[int] = []
        """Those of the devices whose PDOs are described:"""
        self._described = ""
        """members of a JSON object, made once, because they take as long as a hundred steps;"""
        self._noted = False
        """the recording has them."""
        self._without_pdo: list[_Attribute] = []
        self._presets: list[SdoWrite | None] = []
        """Those of the last step; empty: the next step cannot follow from it."""
        self._was_online = False
        """The devices are online: the frames have the values of their PDOs."""
        self._others: list[_Attribute] = []
        """Further values that the frames do not have now,"""
        self._other_values: list[Any] = []
        """in the last step."""
        self._orders: tuple[Any, ...] = (None, None, None, None)

    @property
    def machine(self) -> object:
        """The machine whose steps are recorded."""
        return self._outputs

    @property
    def reason_code(self) -> int:
        """The reason as it is recorded."""
        reason = self._outputs.reason
        return 0 if reason is None else reason.code

    def forget(self) -> None:
        """The next step is recorded with all of its values."""
        self._presets, self._noted = [], False

    def _is_as_before(self) -> bool:
        """Whether what no frame has is as in the last step. It must be asked in each step."""
        raise NotImplementedError

    def _has_fresh_data(self) -> bool:
        """Whether the data of its devices is fresh."""
        return all(each.ok for each in self._sensors)

    def take(self, now: int) -> bytes:
        """The last step, of the cycle that began at ``now``; the recorder calls it in each cycle."""
        outputs = self._outputs
        sent = self._rpdos is None or self._rpdos.sent_ns == now
        if self._is_as_before() and outputs.events is None and not self._given and outputs.presets == self._presets:
            others = [getattr(item, name) for item, name in self._others]
            if others == self._other_values:
                return (_SENT if sent else _BY_FRAMES) if self._was_online else _AS_BEFORE
            if self._was_online and self._has_fresh_data():
                self._other_values = others
                return MASK.pack(READ | (SENT if sent else 0)) + struct.pack(f">{len(others)}q", *others)
        online = self._was_online = self._has_fresh_data()
        numbers, setpoints = _read(self._attributes), self._step.setpoints
        mask = VALUES | (ONLINE if online else 0) | (SENT if sent else 0)
        packed = self._pack(*numbers)
        if setpoints is None:
            mask |= NO_SETPOINTS
        else:
            mask |= SETPOINTS
            packed = self._pack_setpoints(*setpoints) + packed
        events = self._events()
        if events:
            mask |= HAS_EVENTS
            packed += LENGTH.pack(len(events)) + events
        self._presets = list(outputs.presets)
        self._others = self._without_pdo if online else self._attributes
        self._other_values = _read(self._others)
        return MASK.pack(mask) + packed

    def _events(self) -> bytes:
        outputs = self._outputs
        document: dict[str, Any] = {}
        if self._given:
            document["given"] = [[kind, to_json(value)] for kind, value in self._given]
            self._given.clear()
        if outputs.events is not None:
            document |= {name: to_json(value) for name in EVENTS if (value := getattr(outputs.events, name))}
        orders = outputs.writes, outputs.probe, *outputs.presets
        if orders != self._orders:
            document["orders"] = to_json(orders)
            self._orders = orders
        generations = [client.generation for client, _ in self._devices]
        if generations != self._generations:
            self._generations, self._noted = generations, False
            pdos = self._find_pdos()
            read = [self._attributes.index(item) for item in self._without_pdo]
            self._described = json.dumps({"pdos": pdos, "read": read})[1:-1]
        members = [json.dumps(document)[1:-1]] if document else []
        if not self._noted:
            self._noted = True
            members.append(self._described)
        return f"{{{', '.join(members)}}}".encode() if members else b""

    def _find_pdos(self) -> list[tuple[str, int, str, Sequence[str]]]:
        """The PDOs of the devices: bus, COB-ID, format, and the names of their values in the step."""
        groups = self.traced.groups
        missing = {*groups["feedback"], *groups["command"], *groups["sensors"], "position_ns"}
        for client, _ in self._devices:
            missing |= {name for item in client.polling.objects for name in _AGES.get(item.entry.attribute, ())}
        found: list[tuple[str, int, str, Sequence[str]]] = []
        for client, names_of in self._devices:
            bus = client.network.name
            for cob_id, layout, mapped in client.shown_values:
                found.append((bus, cob_id, layout, [names_of.get(name, "") for name in mapped]))
            for item in () if client.plan is None else client.plan.rpdos:
                found.append((bus, item.cob_id, item.pdo.struct.format, item.pdo.attributes))
        for *_, mapped_names in found:
            missing.difference_update(mapped_names, map(time_of, mapped_names))
        names = [name for group in GROUPS[1:] for name in groups[group]]
        self._without_pdo = [place for name, place in zip(names, self._attributes, strict=True) if name in missing]
        return found

    def begin(self) -> None:
        """The machine and its settings, before its first step."""
        item = self._item
        assert isinstance(item, Axis | EncoderObject)
        known = [("machine", item.machine.settings), ("tolerate", item.sign_of_life_tolerance)]
        self._given[:0] = known


_AxisValues = tuple[
    *tuple[bool, bool, bool, bool, bool, bool],
    *tuple[bool, bool, bool, bool, bool],
    *tuple[int, int, int, int, int, int],
    *tuple[Brake, Reason | None, tuple[SdoWrite, ...] | None, ProbeWish | None],
]
"""With fixed lengths, so that compiled code makes no objects of them."""


class AxisRecord(StepRecord):
    """Records an axis."""

    def __init__(self, item: Axis) -> None:
        machine, drive = item.machine, item.drive
        layout = drive.layout
        mapped = [name for pdo in layout.tpdos for name in pdo.attributes]
        names = _AXIS | {
            "feedback": tuple(dict.fromkeys((*mapped, "position_actual"))),
            "command": tuple(dict.fromkeys(name for pdo in layout.rpdos for name in pdo.attributes)),
        }
        super().__init__(item, machine.inputs, machine.inputs.encoders, names, drive.feedback)
        self._inputs = machine.inputs
        self._drive = drive
        self._rpdos = drive.rpdos
        self._devices.insert(0, (drive, {name: name for name in names["feedback"]}))
        self._last = self._read_values()

    def _is_as_before(self) -> bool:
        last = self._last
        self._last = values = self._read_values()
        return values == last

    def _read_values(self) -> _AxisValues:
        inputs, outputs = self._inputs, self._outputs
        return (
            inputs.setpoints is None,
            inputs.gateway_stops,
            inputs.drive_ok,
            inputs.node_stopped,
            inputs.set_point_refused,
            inputs.unacknowledged,
            outputs.good,
            outputs.released,
            outputs.known_off,
            outputs.motor_hot,
            outputs.stage_hot,
            inputs.fault_code,
            outputs.warning,
            outputs.warned,
            outputs.drive_error,
            self._log.count,
            self._drive.generation,
            outputs.brake,
            outputs.reason,
            outputs.writes,
            outputs.probe,
        )

    def _has_fresh_data(self) -> bool:
        return self._inputs.drive_ok and super()._has_fresh_data()


_EncoderValues = tuple[bool, bool, bool, int, int, int, int, Reason | None, tuple[SdoWrite, ...] | None]


class EncoderRecord(StepRecord):
    """Records a channel of an encoder with a telegram of its own."""

    def __init__(self, item: EncoderObject) -> None:
        inputs = item.machine.inputs
        super().__init__(item, inputs, [inputs.source], _ENCODER)
        self._inputs = inputs
        self._last = self._read_values()

    def _is_as_before(self) -> bool:
        last = self._last
        self._last = values = self._read_values()
        return values == last

    def _read_values(self) -> _EncoderValues:
        outputs = self._outputs
        return (
            self._inputs.setpoints is None,
            self._inputs.unacknowledged,
            outputs.good,
            outputs.warning,
            outputs.warned,
            self._log.count,
            self._devices[0][0].generation,
            outputs.reason,
            outputs.writes,
        )


def step_record(item: DriveObject) -> StepRecord:
    """The recorder of a drive object's steps."""
    if isinstance(item, Axis):
        return AxisRecord(item)
    assert isinstance(item, EncoderObject)
    return EncoderRecord(item)


def _read(attributes: list[_Attribute]) -> list[Any]:
    return [getattr(item, name) for item, name in attributes]
