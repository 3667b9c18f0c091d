"""What a running daemon tells about itself, as one JSON document on a loopback TCP port."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from datetime import datetime
from typing import Any

from pdgw import __version__
from pdgw.ds301.loop import SECOND, Event, Task
from pdgw.dsp402.states import state_of
from pdgw.gateway.binding import Axis
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.drive_object import DriveObject
from pdgw.gateway.encoder import EncoderObject
from pdgw.gateway.errors import GatewayError

_CONNECTIONS = 8
"""Answered at the same time; more are closed."""
_PATIENCE_NS = 5 * SECOND


def clock_time(seconds: float) -> str:
    """A time of the machine's clock as ISO text, in its time zone."""
    return datetime.fromtimestamp(seconds).astimezone().isoformat(timespec="milliseconds")


def _object_status(item: DriveObject) -> dict[str, Any]:
    """What axes and encoders have in common."""
    setpoints = item.last_setpoints
    loop = item.client.loop
    now = loop.now()
    heard_ns = item.client.heard_ns
    return {
        "do_id": item.do_id,
        "node_id": item.node_id,
        "telegram": item.telegram.number,
        "drive": item.client.status.value,
        "drive_text": item.client.status_text,
        "reason": item.reason.value if item.reason else "",
        "setpoints": item.telegram.setpoints.as_dict(setpoints) if setpoints is not None else None,
        "actuals": item.telegram.actuals.as_dict(item.actuals),
        "iops_good": item.good,
        "heard_age_ms": round((now - heard_ns) / 1e6, 1) if heard_ns else None,
        "faults": [
            {
                "number": f.number,
                "code": f.code,
                "text": f.text,
                "is_warning": f.is_warning,
                "time": clock_time(loop.wall() - (now - f.time_ns) / SECOND),
                "age_s": round((now - f.time_ns) / SECOND, 3),
            }
            for f in tuple(item.faults)
        ],
    }


def axis_status(axis: Axis) -> dict[str, Any]:
    """One axis as plain data."""
    feedback = axis.drive.feedback
    state = state_of(feedback.statusword)
    return _object_status(axis) | {
        "state": state.value if state else "unknown",
        "statusword": feedback.statusword,
        "controlword": axis.outputs.command.controlword,
        "velocity": feedback.velocity_actual,
        "position": feedback.position_actual,
        "saturations": axis.outputs.saturations,
        "scaling": list(axis.drive.drive_type.scaling.lines) if axis.drive.drive_type else [],
    }


def encoder_status(encoder: EncoderObject) -> dict[str, Any]:
    """One encoder channel as plain data."""
    source = encoder.input
    return _object_status(encoder) | {
        "channel": encoder.config.channel,
        "state": encoder.machine.channel.sensor.state.value,
        "position": source.position,
        "alarms": source.alarms,
        "warnings": source.warnings,
        "saturations": encoder.outputs.saturations,
    }


def _head(daemon: Daemon) -> dict[str, Any]:
    """Everything but the drive objects."""
    return {
        "version": __version__,
        "time": clock_time(daemon.loop.wall()),
        "uptime_s": round((daemon.loop.now() - daemon.started_ns) / 1e9, 3),
        "plc": daemon.link.status(),
        "store": str(daemon.store.path) if daemon.store.path is not None else "",
        "buses": [
            {
                "name": network.name,
                "healthy": network.healthy,
            }
            for network in daemon.networks.values()
        ],
        "counters": daemon.loop.counters.values(),
    }


def snapshot(daemon: Daemon) -> dict[str, Any]:
    """The daemon as plain data."""
    return _head(daemon) | {
        "axes": [axis_status(axis) for axis in daemon.axes],
        "encoders": [encoder_status(encoder) for encoder in daemon.encoders],
    }


def encoded(daemon: Daemon) -> Iterator[bytes]:
    """The snapshot as one line of JSON, one drive object at a time: between two parts the exchange goes on."""
    yield json.dumps(_head(daemon))[:-1].encode()
    axes = (json.dumps(axis_status(axis)) for axis in daemon.axes)
    encoders = (json.dumps(encoder_status(encoder)) for encoder in daemon.encoders)
    for name, items in (("axes", axes), ("encoders", encoders)):
        yield f', "{name}": ['.encode()
        for number, item in enumerate(items):
            yield (b", " if number else b"") + item.encode()
        yield b"]"
    yield b"}\n"


class StatusServer:
    """Answers every connection on 127.0.0.1 with a snapshot and closes it."""

    def __init__(self, daemon: Daemon, port: int) -> None:
        self._daemon = daemon
        self._loop = daemon.loop
        self._tasks: set[Task] = set()
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind(("127.0.0.1", port))
            self._listener.listen(_CONNECTIONS)
        except OSError as error:
            self._listener.close()
            raise GatewayError(
                f"status port: 127.0.0.1 port {port} cannot be used ({error.strerror}); choose another, 0 for none"
            ) from error
        self._listener.setblocking(False)

    def start(self) -> None:
        self._loop.add_reader(self._listener.fileno(), self._accept)

    def stop(self) -> None:
        self._loop.remove_reader(self._listener.fileno())
        self._listener.close()
        for task in tuple(self._tasks):
            task.kill()

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:
            return  # who wanted to know has gone again
        connection.setblocking(False)
        if len(self._tasks) >= _CONNECTIONS:
            connection.close()
            return

        def answer() -> None:
            try:
                self._answer(connection)
            finally:
                self._loop.remove_writer(connection.fileno())
                connection.close()
                self._tasks.discard(task)

        task = self._loop.spawn(answer, "status")
        self._tasks.add(task)

    def _answer(self, connection: socket.socket) -> None:
        writable = Event(self._loop)
        deadline = self._loop.now() + _PATIENCE_NS
        for part in encoded(self._daemon):
            rest = memoryview(part)
            while rest:
                try:
                    rest = rest[connection.send(rest) :]
                except BlockingIOError:
                    writable.clear()
                    self._loop.add_writer(connection.fileno(), writable.set)
                    waited = writable.wait(max(0, deadline - self._loop.now()))
                    self._loop.remove_writer(connection.fileno())
                    if not waited:
                        return  # who does not read is not waited for
                except OSError:
                    return  # who went away before the end does not miss it
            self._loop.sleep(0)
