"""What each step of a gateway had, read from its machines in each cycle, to compare with its recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pdgw.gateway.axis.values import Inputs
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.trace.pcapng import TracedObject
from pdgw.gateway.trace.reader import Cycle, Parser
from pdgw.gateway.trace.step_reader import Step
from pdgw.gateway.trace.steps import NO_SPEED

Values = dict[str, dict[str, Any]]
"""By group and name."""
_NAMES: dict[type, list[str]] = {}


class SeenSteps:
    """Listens to the cycles of a daemon."""

    def __init__(self, daemon: Daemon) -> None:
        self._daemon = daemon
        self._seen: list[list[Values]] = []
        daemon.watch.listeners.append(self)

    def cycle(self, _now: int, _accepted: bool, _answered: int) -> None:
        """CycleListener."""
        self._seen.append([_values(item) for item in self._daemon.objects])

    def compare(self, file: str) -> int:
        """Assert that the recording has all that was seen; the number of steps that are two bytes."""
        parser = Parser(file)
        by_frames = cycles = 0
        for item in parser.feed(Path(file).read_bytes()):
            if isinstance(item, Cycle):
                assert parser.description is not None
                cycles += 1
                for traced, step, seen in zip(
                    parser.description.objects, item.steps, self._seen[item.number - 1], strict=True
                ):
                    by_frames += step.by_frames
                    different = list(_different(traced, step, seen))
                    assert not different, f"cycle {item.number}, {traced.kind} {traced.do_id}: {different}"
        assert cycles == len(self._seen)
        return by_frames


def _different(traced: TracedObject, step: Step, seen: Values) -> Iterator[tuple[str, object, object]]:
    for name, shown, recorded in step.contradictions:
        yield name, shown, recorded
    setpoints = None if step.setpoints is None else list(step.setpoints)
    # A gateway that stops uses none.
    if setpoints != seen["setpoints"]["all"] and not seen["flags"].get("gateway_stops"):
        yield "setpoints", setpoints, seen["setpoints"]["all"]
    for group in ("flags", "numbers", "feedback", "sensors", "decided", "command"):
        if group == "command" and not step.is_sent:
            continue
        for name, value in zip(traced.groups[group], getattr(step, group), strict=True):
            if value != seen[group][name]:
                yield name, value, seen[group][name]


def _values(item: Any) -> Values:
    inputs, outputs = item.machine.inputs, item.machine.outputs
    given = _numbers(inputs)
    if isinstance(inputs, Inputs):
        feedback, command = _numbers(inputs.feedback), _numbers(outputs.command)
        sources, ok = inputs.encoders, inputs.encoders_ok
    else:
        feedback, command = {}, {}
        sources, ok = [inputs.source], [inputs.ok]
    sensors = {
        f"{place}.{name}": value
        for place, source in enumerate(sources)
        if source is not None
        for name, value in (
            _numbers(source) | {"speed": NO_SPEED if source.speed is None else source.speed, "ok": ok[place]}
        ).items()
    }
    decided = _numbers(outputs) | {
        "reason": 0 if outputs.reason is None else outputs.reason.code,
        "faults": item.fault_log.count,
    }
    setpoints = None if inputs.setpoints is None else list(inputs.setpoints)
    return {
        "setpoints": {"all": setpoints},
        "flags": given,
        "numbers": given,
        "feedback": feedback,
        "sensors": sensors,
        "decided": decided,
        "command": command,
    }


def _numbers(item: object) -> dict[str, int]:
    names = _NAMES.get(type(item))
    if names is None:
        names = [name for name in dir(item) if name.islower() and not name.startswith("_")]
        names = _NAMES[type(item)] = [name for name in names if isinstance(getattr(item, name), int)]
    return {name: getattr(item, name) for name in names}
