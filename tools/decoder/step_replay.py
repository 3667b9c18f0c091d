"""Replay a recording of the gateway: give the machines of this version the recorded inputs, and compare what they decide.

The recorded frames are compared too: with the decisions the answers, and the RPDOs of a step that sends all of them; with the
recorded values the frames that an input is taken from (``step_reader``). A drive object is compared until its first difference.
Without I/O.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.gateway.axis.encoder_machine import EncoderMachine
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.values import Events, PresetAnswer, ProbeAnswer, SdoAnswer
from pdgw.gateway.base.errors import GatewayError, reading
from pdgw.gateway.trace import pcapng
from pdgw.gateway.trace.json_values import from_json, to_json
from pdgw.gateway.trace.pcapng import Description
from pdgw.gateway.trace.reader import Cycle, Frame
from pdgw.gateway.trace.step_reader import Step
from pdgw.gateway.trace.steps import EVENTS, NO_SPEED

_COUNT: Final = "faults"
"""Number of faults since the start, which the machine does not have."""
_MIDDLE: Final = "the recording begins in the middle of a run: a replay needs its start, as `pdgw run --record` has it"


class Difference(NamedTuple):
    """What this version decides otherwise. ``wall_ns``: since 1970."""

    wall_ns: int
    who: str
    field: str
    recorded: object
    now: object


@dataclass
class Replayed:
    """Result for one drive object."""

    who: str
    telegram: int
    steps: int = 0
    """Steps that were compared."""
    differences: list[Difference] = field(default_factory=list)
    """All fields of the first step that differs."""


class ReplayError(GatewayError):
    """The rest of a recording cannot be replayed. ``outcomes`` has the results up to there."""

    def __init__(self, text: str, outcomes: list[Replayed]) -> None:
        self.outcomes = outcomes
        super().__init__(text)


class _Sensor:
    """A recorded encoder, as ``EncoderInput``."""

    def __init__(self) -> None:
        self.position = self.position_time = self.alarms = self.warnings = self.error_register = self.error_code = 0
        self.speed: int | None = None
        self.valid = False


class _Object:
    """One drive object."""

    def __init__(self, description: Description, place: int, before: _Object | None) -> None:
        traced = description.objects[place]
        self._traced = traced
        self._place = place
        self._reason = description.reason
        self._actuals_at = description.places.actuals[place]
        self._telegram = traced.chosen
        self.result = Replayed(f"{traced.kind} {traced.do_id}", traced.telegram)
        self._machine: Any = None
        self._feedback = DriveFeedback()
        self._sensors = [_Sensor(), _Sensor()]
        self._orders: tuple[object, ...] = (None, None, None, None)
        self._last: Step | None = None
        self._setters: dict[str, list[tuple[int, Callable[[int], None]]]] = {}
        if before is not None:
            self._continue_after(before)

    def _continue_after(self, before: _Object) -> None:
        """Another section of the same run."""
        self.result = before.result
        self.result.telegram = self._traced.telegram
        self._machine, self._feedback, self._sensors = before._machine, before._feedback, before._sensors
        self._orders = before._orders
        if self._traced.groups == before._traced.groups:
            self._setters, self._last = before._setters, before._last

    @property
    def done(self) -> bool:
        """There is nothing more to compare."""
        return bool(self.result.differences)

    # -- what the machine was given -----------------------------------------------------------------------------------

    def _give(self, step: Step) -> None:
        for kind, value in step.events.get("given", ()):
            self._given(kind, from_json(value))
        machine = self._machine
        if machine is None:
            return
        inputs, last = machine.inputs, self._last
        inputs.setpoints = step.setpoints
        for group in ("flags", "numbers", "feedback", "sensors"):
            values = getattr(step, group)
            if last is None or values is not getattr(last, group):
                for place, put in self._setters[group]:
                    put(values[place])
        self._last = step

    def _given(self, kind: str, value: Any) -> None:
        machine = self._machine
        if kind == "machine":
            self._begin(value)
        elif machine is None or kind == "pdos":  # of version 1
            return
        elif kind == "tolerate":
            machine.tolerate(value)
        elif kind == "preset":
            machine.channel.sensor.preset_value = value
        elif kind == "references":
            place, references = value
            if isinstance(machine, EncoderMachine):
                machine.set_references(references)
            else:
                machine.set_references(place, references)
        else:
            machine.inputs.news.append(_present(value, machine.outputs) if kind == "answer" else value)

    def _begin(self, settings: Any) -> None:
        """A new machine, after the start or another telegram (P922)."""
        before, traced = self._machine, self._traced
        names = traced.groups["sensors"]
        machine: Any
        if traced.kind == "encoder":
            machine = EncoderMachine(traced.telegram, settings, self._sensors[0])
        else:
            machine = AxisMachine(traced.chosen, settings, self._feedback)
            for place in sorted({int(name.partition(".")[0]) for name in names}):
                machine.inputs.encoders[place] = self._sensors[place]
                machine.set_references(place, None)
        if before is not None:
            machine.adopt(before)
        self._machine, self._last = machine, None
        given = {
            "flags": [(machine.inputs, name) for name in traced.groups["flags"]],
            "numbers": [(machine.inputs, name) for name in traced.groups["numbers"]],
            "feedback": [(self._feedback, name) for name in traced.groups["feedback"]],
        }
        self._setters = {
            group: [(place, _setter(item, name)) for place, (item, name) in enumerate(pairs) if hasattr(item, name)]
            for group, pairs in given.items()
        }
        self._setters["sensors"] = [
            (place, setter) for place, name in enumerate(names) if (setter := self._sensor_setter(machine, name))
        ]

    def _sensor_setter(self, machine: Any, name: str) -> Callable[[int], None] | None:
        number, _, attribute = name.partition(".")
        if attribute == "ok":
            places: list[bool] = getattr(machine.inputs, "encoders_ok", [False])
            return lambda value: places.__setitem__(int(number), bool(value))
        sensor = self._sensors[int(number)]
        if attribute == "speed":
            return lambda value: setattr(sensor, "speed", None if value == NO_SPEED else value)
        return _setter(sensor, attribute)

    # -- what it decides ----------------------------------------------------------------------------------------------

    def step(self, cycle: Cycle) -> None:
        """Give the inputs of a cycle, make the step, and compare."""
        step = cycle.steps[self._place]
        self._give(step)
        machine = self._machine
        if machine is None:
            return
        machine.inputs.now = cycle.time_ns
        outputs = machine.step()
        found = [*step.contradictions, *self._compared(step, outputs), *self._compared_answer(cycle, outputs)]
        self.result.steps += 1
        self.result.differences.extend(Difference(cycle.wall_ns, self.result.who, *item) for item in found)

    def _compared(self, step: Step, outputs: Any) -> Iterator[tuple[str, object, object]]:
        """Fields that differ, with the recorded value and that of now."""
        groups = self._traced.groups
        for name, recorded in zip(groups["decided"], step.decided, strict=True):
            if name == "reason":
                now = outputs.reason.name if outputs.reason is not None else ""
                if now != (text := self._reason(recorded)):
                    yield name, text or "none", now or "none"
            elif name != _COUNT and hasattr(outputs, name) and getattr(outputs, name) != recorded:
                yield name, recorded, int(getattr(outputs, name))
        for name, recorded in zip(groups["command"], step.command, strict=True) if step.is_sent else ():
            if (now := getattr(outputs.command, name, recorded)) != recorded:
                yield f"{name} in the RPDO" if step.by_frames else name, recorded, now
        events = step.events
        orders = outputs.writes, outputs.probe, *outputs.presets
        if not events and outputs.events is None and orders == self._orders:
            return
        before, self._orders = self._orders, orders
        happened = outputs.events or Events()
        found = {name: getattr(happened, name) for name in EVENTS} | {"orders": orders if orders != before else []}
        for name, values in found.items():
            now = to_json(values) or []
            recorded = events.get(name, [])
            if now not in (recorded, to_json(from_json(recorded))):  # the second has this version's names of classes
                yield name, recorded, now

    def _compared_answer(self, cycle: Cycle, outputs: Any) -> Iterator[tuple[str, object, object]]:
        if cycle.flags & pcapng.ANSWERED and self._actuals_at is not None and cycle.sent:
            sent = self._telegram.actuals.struct.unpack_from(cycle.sent, self._actuals_at)
            for name, recorded, now in zip(self._telegram.actuals.names, sent, outputs.actuals, strict=True):
                if recorded != now:
                    yield name, recorded, now


def _setter(item: object, name: str) -> Callable[[int], None]:
    kind = type(getattr(item, name))
    return lambda value: setattr(item, name, kind(value))


def _present(item: object, outputs: Any) -> object:
    """An answer to the machine's own order: it compares some of them by identity."""
    if isinstance(item, SdoAnswer):
        return SdoAnswer(outputs.writes or item.writes, item.error)
    if isinstance(item, PresetAnswer):
        own = next((write for write in outputs.presets if write == item.write), item.write)
        return PresetAnswer(own, item.error)
    if isinstance(item, ProbeAnswer) and outputs.probe is not None:
        return ProbeAnswer(outputs.probe, item.positions, item.error, item.supported)
    return item


def replay(items: Iterable[Description | Frame | Cycle]) -> list[Replayed]:
    """The whole recording, in which gateways may follow each other. ReplayError if it begins in the middle of a run, has a gap or
    is damaged."""
    results: dict[int, Replayed] = {}
    try:
        _replay(items, results)
    except GatewayError as error:
        raise ReplayError(str(error), list(results.values())) from error
    return list(results.values())


def _replay(items: Iterable[Description | Frame | Cycle], results: dict[int, Replayed]) -> None:
    objects: list[_Object] = []
    number: int | None = None
    for item in items:
        if isinstance(item, Cycle):
            if number is None and item.number != 1:
                raise GatewayError(_MIDDLE)
            if number is not None and item.number != number + 1:
                raise GatewayError(f"the recording has a gap of {item.number - number - 1} cycles")
            number = item.number
            for each in objects:
                if not each.done:
                    with reading(f"cycle {number}, {each.result.who}"):
                        each.step(item)
        elif isinstance(item, Frame):
            continue
        elif item.first or objects:
            known = {} if item.first else {each.result.who: each for each in objects}
            number = None if item.first else number
            made = [_Object(item, place, None) for place in range(len(item.objects))]
            objects = [
                each if each.result.who not in known else _Object(item, place, known[each.result.who])
                for place, each in enumerate(made)
            ]
            results |= {id(each.result): each.result for each in objects}
        else:
            raise GatewayError(_MIDDLE)
    if not results:
        raise GatewayError("no steps of a gateway: only a recording of the gateway itself can be replayed")
