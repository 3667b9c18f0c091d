"""Status of a running daemon as one JSON document."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from datetime import datetime
from typing import Any

from pdgw.base.durations import MS, SECOND
from pdgw.base.version import package_version
from pdgw.ds301.loop.loop import Loop
from pdgw.dsp402.states import state_of
from pdgw.gateway.base.finding_text import clock, finding_line, wall_time
from pdgw.gateway.base.identity import interpreter, kind
from pdgw.gateway.base.reasons import Finding
from pdgw.gateway.base.step_text import remedy_text
from pdgw.gateway.base.store import units_text
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.axis_chain import activity, notes
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.objects.enable_chain import device_warning
from pdgw.gateway.objects.encoder import EncoderObject
from pdgw.gateway.objects.fault_buffer import ReportedFault
from pdgw.gateway.objects.happenings import LINES, around_the_last_stop
from pdgw.gateway.objects.lag import speed_setpoint_rpm
from pdgw.gateway.objects.protections import protections
from pdgw.gateway.objects.totals import FLAPS
from pdgw.gateway.service.causes import causes, who
from pdgw.gateway.service.running import RunningGateway
from pdgw.profidrive.signal_text import Rated, scale, texts
from pdgw.profidrive.signals import SignalQuantity
from pdgw.profidrive.telegrams import ApplicationMode

SCHEMA = 2
"""Version of the document. It rises when a key changes its meaning or is removed; readers ignore unknown keys."""


def clock_time(seconds: float) -> str:
    """A time of the machine's clock as ISO text, in its time zone."""
    return datetime.fromtimestamp(seconds).astimezone().isoformat(timespec="milliseconds")


def _shown_time(loop: Loop, time_ns: int) -> str:
    """``clock_time`` of a monotonic time."""
    return clock_time(wall_time(time_ns, loop))


def fault_status(item: DriveObject, newest: int | None = None) -> list[dict[str, Any]]:
    """Faults and warnings of a drive object, newest first; ``newest``: maximum number."""
    return [_fault(item, reported) for reported in item.fault_log.reported(present=item.outputs.warning, newest=newest)]


def _fault(item: DriveObject, reported: ReportedFault) -> dict[str, Any]:
    loop, record = item.client.loop, reported.record
    return {
        "id": reported.id,
        "active": reported.active,
        "number": int(record.number),
        "code": record.code,
        "text": record.line,
        "is_warning": record.is_warning,
        "time": _shown_time(loop, record.time_ns),
        "age_s": round((loop.now() - record.time_ns) / SECOND, 3),
    }


def _counted(loop: Loop, found: Finding) -> dict[str, Any]:
    """How often a fault came, and when; an origin without a fault has its begin alone."""
    first, last = found.period
    return {"count": found.times, "first": _shown_time(loop, first), "last": _shown_time(loop, last)}


def _origin(item: DriveObject) -> dict[str, Any] | None:
    """What began the stop of a drive object; None while it follows the PLC."""
    loop, origin = item.client.loop, item.origins.present
    if origin is None:
        return None
    return {
        "by": origin.by.value,
        "number": int(origin.number),
        "text": origin.evidence,
        "ended": origin.ended,
        "before": origin.before,
        "remedy": remedy_text(origin.remedy),
    } | _counted(loop, origin)


def _object_status(item: Axis | EncoderObject) -> dict[str, Any]:
    """The common status of axes and encoders."""
    loop, enable_status, cause = item.client.loop, item.enable_status, item.cause
    item.log_state(enable_status)
    raw, chosen = item.last_setpoints, item.telegram
    setpoints, actuals = None if raw is None else chosen.setpoints.as_dict(raw), chosen.actuals.as_dict(item.actuals)
    rated = rated_speed(item)
    broken = enable_status.broken
    received_ns = item.client.received_ns
    return {
        "do_id": item.do_id,
        "name": item.config.name or "",
        "label": item.label,
        "node_id": item.node_id,
        "bus": item.network.name,
        "telegram": item.telegram.number,
        "state": enable_status.state.value,
        "state_id": enable_status.state.name,
        "sentence": enable_status.sentence,
        "reason": broken.evidence if broken else "",
        "reason_id": broken.reason.name if broken and broken.reason else "",
        "remedy": broken.todo if broken else "",
        "chain": [
            {
                "id": link.enable.name,
                "text": link.enable.value,
                "ok": link.ok,
                "evidence": link.evidence,
                "todo": link.todo,
            }
            for link in enable_status.chain
        ],
        "drive": item.client.status.value,
        "drive_text": item.client.status_text,
        "setpoints": setpoints,
        "actuals": actuals,
        "setpoint_texts": {} if setpoints is None else texts(chosen.setpoints, setpoints, rated),
        "actual_texts": texts(chosen.actuals, actuals, rated),
        "rated_speed": None if rated is None else rated.speed,
        "rated_speed_unit": "rpm" if rated is None else rated.unit,
        "iops_good": item.good,
        "heard_age_ms": round((loop.now() - received_ns) / MS, 1) if received_ns else None,
        "saturations": item.outputs.saturations,
        "cause": None if cause is None else _fault(item, cause),
        "origin": _origin(item),
        "faults": fault_status(item, 1),
        "totals": [{"name": total.evidence} | _counted(loop, total) for total in item.totals.present(loop.now())],
        "warning": device_warning(item),
        "fault_count": len(item.faults),
        "active_faults": sorted({int(record.number) for record in item.fault_log.unacknowledged()}),
    }


def rated_speed(item: Axis | EncoderObject) -> Rated | None:
    """100 % of the speeds of its telegram; None if unknown."""
    if isinstance(item, EncoderObject):
        return Rated(float(item.config.reference_speed), item.config.speed_unit)
    rpm = item.scaling.rated_speed_rpm
    return Rated(float(rpm), "rpm") if rpm else None


def _present(item: DriveObject, values: dict[str, float | str | None]) -> dict[str, Any]:
    """The values while the device sends them. Otherwise each value is None, and ``last`` has the last known ones."""
    if item.good:
        return values | {"last": None}
    return dict.fromkeys(values) | {"last": values if item.client.received_ns else None}


def axis_status(axis: Axis) -> dict[str, Any]:
    """One axis as plain data. A value is None if no PDO of the telegram contains it or its unit is unknown, or while the drive
    sends none: ``last`` has the last ones."""
    feedback, drive_type = axis.drive.feedback, axis.drive.drive_type
    state = state_of(feedback.statusword)
    plan = axis.drive.plan
    mapped = set(plan.shown) if plan is not None else set()
    scaling = drive_type.scaling if drive_type else None
    velocity = feedback.velocity_actual if "velocity_actual" in mapped else None
    position, position_unit = _position(axis) or (
        feedback.position_actual if "position_actual" in mapped else None,
        scaling.position_unit if scaling else None,
    )
    per_rpm = axis.scaling.velocity_per_rpm
    rpm = round(float(velocity / per_rpm), 3) if velocity is not None and per_rpm else None
    values = {
        "velocity": velocity,
        "speed_rpm": rpm,
        "speed_text": _speed_text(rpm, "rpm", velocity, axis),
        "position": position,
    }
    return (
        _object_status(axis)
        | _present(axis, values)
        | {
            "drive_state": state.value if state and axis.good else "unknown",
            "notes": notes(axis),
            "activity": activity(axis),
            "statusword": feedback.statusword,
            "controlword": axis.outputs.command.controlword,
            "position_unit": position_unit,
            "velocity_per_rpm": float(per_rpm) if per_rpm else None,
            "scaling": list(scaling.lines) if scaling else [],
            "units_witnessed": units_text(axis.units_witnessed, axis.drive.serial_number, scaling) if scaling else "",
            "pdos": list(plan.lines) if plan is not None else [],
            "left_to_the_drive": list(axis.drive.left_to_the_drive),
            "guarding": axis.drive.guarding.text if axis.drive.guarding is not None else "",
            "protections": [
                {"name": item.name, "active": item.active, "text": item.text} for item in protections(axis)
            ],
        }
    )


def _speed_text(speed: float | None, unit: str, velocity: int | None, axis: Axis | None = None) -> str:
    """The speed for people, beside the setpoint that an axis on the bus has; empty if unknown."""
    if speed is None:
        return "" if velocity is None else f"{velocity} velocity units"
    setpoint = speed_setpoint_rpm(axis) if axis is not None and axis.good else None
    if axis is None or setpoint is None:
        return f"{speed:g} {unit}"
    return f"{speed:g} of {setpoint:.5g} {unit}{', does not follow' if axis.machine.lags_since else ''}"


def _encoder_speed(encoder: EncoderObject) -> float | None:
    """The speed that the PLC gets (NIST_A or NIST_B) in the unit of the configuration: 6030h ends at 16 bits."""
    for item, raw in zip(encoder.telegram.actuals.signals, encoder.actuals, strict=True):
        if item.quantity is SignalQuantity.SPEED:
            return round(raw * scale(item, rated_speed(encoder)).factor, 3)
    return None


def _position(axis: Axis) -> tuple[float | None, str | None] | None:
    """Position and unit of a telegram that has them in units of length; None of one in fractions or the drive's own units."""
    half = axis.telegram.actuals
    if half.mode is ApplicationMode.POSITIONING:
        for item, raw in zip(half.signals, axis.actuals, strict=True):
            if item.quantity is SignalQuantity.POSITION and item.percent(raw) is None:
                return round(item.value_of(raw), 4), item.unit
    return None


def encoder_status(encoder: EncoderObject) -> dict[str, Any]:
    """One encoder channel as plain data."""
    source, speed, unit = encoder.input, _encoder_speed(encoder), encoder.config.speed_unit
    values = {
        "velocity": source.speed,
        "speed": speed,
        "speed_text": _speed_text(speed, unit, source.speed),
        "position": source.position if source.valid else None,
    }
    return (
        _object_status(encoder)
        | _present(encoder, values)
        | {
            "channel": encoder.config.channel,
            "sensor_state": encoder.machine.channel.sensor.state.value,
            "speed_unit": unit,
            "alarms": source.alarms,
            "warnings": source.warnings,
        }
    )


def _head(daemon: RunningGateway) -> dict[str, Any]:
    """Everything but the drive objects."""
    loop, config = daemon.loop, daemon.config
    received_ns, finding = daemon.link.received_ns, daemon.link.finding()
    return {
        "schema": SCHEMA,
        "name": daemon.name,
        "version": package_version(),
        "build": kind(),
        "python": interpreter(),
        "simulated": any(item.simulate for item in config.objects),
        "time": clock_time(loop.wall()),
        "started": _shown_time(loop, daemon.started_ns),
        "uptime_s": round((loop.now() - daemon.started_ns) / SECOND, 3),
        "plc": {
            "type": config.transport.type,
            "cycle_ms": config.transport.cycle_time_ms,
            "heard_age_ms": None if received_ns is None else round((loop.now() - received_ns) / MS, 1),
            "refused": "" if finding is None else finding_line(finding, loop),
            "refused_id": "" if finding is None else finding.reason.name,
        }
        | daemon.link.status(),
        "file": daemon.file[0] if daemon.file else "",
        "file_modified": daemon.file[1] if daemon.file else None,
        "store": str(daemon.store.path) if daemon.store.path is not None else "",
        "notes": daemon.notes,
        "trace": str(daemon.recorder.path) if daemon.recorder is not None else "",
        "buses": [
            {
                "name": bus.name,
                "interface": bus.interface,
                "channel": bus.channel,
                "bitrate": bus.bitrate,
                "healthy": (disturbance := daemon.networks[bus.name].disturbance) is None,
                "outage": "" if disturbance is None else disturbance.text,
                "unconfigured": daemon.networks[bus.name].unconfigured(),
                "sync": producer.status() if (producer := daemon.sync_producers.get(bus.name)) else None,
            }
            for bus in config.can
        ],
        "cycle_times": daemon.watch.periods.status(),
        "response_times": daemon.watch.responses.status(),
        "age_times": daemon.watch.ages.status(),
        "counters": loop.counters.values(),
    }


def snapshot(daemon: RunningGateway) -> dict[str, Any]:
    """The daemon as plain data."""
    document: dict[str, Any] = json.loads(b"".join(encoded(daemon)))
    return document


def encoded(daemon: RunningGateway) -> Iterator[bytes]:
    """The snapshot as one line of JSON, one drive object at a time: the exchange continues between two parts."""
    yield json.dumps(_head(daemon))[:-1].encode()
    for name, items in (("axes", map(axis_status, daemon.axes)), ("encoders", map(encoder_status, daemon.encoders))):
        yield f', "{name}": ['.encode()
        for number, item in enumerate(items):
            yield (b", " if number else b"") + json.dumps(item).encode()
        yield b"]"
    yield f', "last_event": {daemon.events.newest}, "causes": {json.dumps(causes([*daemon.axes, *daemon.encoders]))}}}\n'.encode()


def explanation(daemon: RunningGateway, items: Sequence[DriveObject]) -> list[dict[str, Any]]:
    """Events around the last fault or stop of drive objects, in at most ten lines. One that flaps has a line, not all of them."""
    loop = daemon.loop
    often = {item: total for item in items if (total := _flapping(item)) is not None}
    calm = [item for item in items if item not in often]
    room = max(0, LINES - len(often))
    for chosen in (calm, items):  # all, if none other has stopped
        found = around_the_last_stop((happening for item in chosen for happening in item.happenings), room)
        if found:
            break
    shown = [(line.time_ns, who([item for item in items if item.do_id in line.objects]), line.shown) for line in found]
    for item, total in often.items():
        first, last = total.period
        text = f"{total.evidence}: {total.times} times since {clock(first, loop)}, last {clock(last, loop)}"
        shown.append((last, item.label, text))
    shown.sort(key=lambda line: line[0])
    return [{"time": _shown_time(loop, time_ns), "who": label, "text": text} for time_ns, label, text in shown[-LINES:]]


def _flapping(item: DriveObject) -> Finding | None:
    """The fault that came most often in the last day, if it came very often."""
    often = [total for total in item.totals.present(item.client.loop.now()) if total.times >= FLAPS]
    return max(often, key=lambda total: total.times, default=None)


def events_after(daemon: RunningGateway, number: int) -> Iterator[dict[str, Any]]:
    """The events with a higher number, the oldest first."""
    for event in daemon.events.after(number):
        yield event._asdict() | {"time": clock_time(event.time)}
