"""What a running daemon tells about itself, as one JSON document on a loopback TCP port."""

from __future__ import annotations

import contextlib
import json
import socketserver
import threading
import time
from typing import Any

from pdgw.dsp402.states import state_of
from pdgw.gateway.axis import Axis
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.drive_object import DriveObject
from pdgw.gateway.encoder import EncoderObject
from pdgw.gateway.errors import GatewayError


def _object_status(item: DriveObject) -> dict[str, Any]:
    """What axes and encoders have in common."""
    setpoints = item.last_setpoints
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
        "faults": [
            {"number": f.number, "code": f.code, "text": f.text, "is_warning": f.is_warning} for f in tuple(item.faults)
        ],
    }


def axis_status(axis: Axis) -> dict[str, Any]:
    """One axis as plain data."""
    feedback = axis.drive.feedback
    state = state_of(feedback.statusword)
    return _object_status(axis) | {
        "state": state.value if state else "unknown",
        "statusword": feedback.statusword,
        "controlword": axis.translator.command.controlword,
        "velocity": feedback.velocity_actual,
        "position": feedback.position_actual,
        "saturations": axis.translator.saturations,
        "scaling": list(axis.drive.drive_type.scaling.lines) if axis.drive.drive_type else [],
    }


def encoder_status(encoder: EncoderObject) -> dict[str, Any]:
    """One encoder channel as plain data."""
    source = encoder.input
    return _object_status(encoder) | {
        "channel": encoder.config.channel,
        "state": encoder.translator.channel.sensor.state.value,
        "position": source.position,
        "alarms": source.alarms,
        "warnings": source.warnings,
        "saturations": encoder.translator.saturations,
    }


def snapshot(daemon: Daemon) -> dict[str, Any]:
    """The daemon as plain data."""
    endpoint = daemon.endpoint
    return {
        "uptime_s": round((time.monotonic_ns() - daemon.started_ns) / 1e9, 3),
        "plc": {
            "connected": endpoint.connected,
            "peer": list(endpoint.peer) if endpoint.peer else None,
            "frames": {verdict.value: count for verdict, count in endpoint.counters.items()},
            "watchdog_expiries": endpoint.watchdog_expiries,
            "iops_bad": endpoint.iops_bad,
            "sent": endpoint.sent,
            "skipped": daemon.skipped,
        },
        "cycles": daemon.cycles,
        "buses": [
            {
                "name": network.name,
                "healthy": network.healthy,
                "sent": network.sent,
                "received": network.received,
                "send_errors": network.send_errors,
            }
            for network in daemon.networks.values()
        ],
        "axes": [axis_status(axis) for axis in daemon.axes],
        "encoders": [encoder_status(encoder) for encoder in daemon.encoders],
    }


class StatusServer:
    """Answers every connection on 127.0.0.1 with a snapshot and closes it."""

    def __init__(self, daemon: Daemon, port: int) -> None:
        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                # Who went away before the answer does not miss it.
                with contextlib.suppress(OSError):
                    self.wfile.write(json.dumps(snapshot(daemon)).encode() + b"\n")

        try:
            self._server = socketserver.ThreadingTCPServer(("127.0.0.1", port), Handler, bind_and_activate=False)
            self._server.allow_reuse_address = True
            self._server.daemon_threads = True
            self._server.server_bind()
            self._server.server_activate()
        except OSError as error:
            self._server.server_close()
            raise GatewayError(
                f"status port: 127.0.0.1 port {port} cannot be used ({error.strerror}); choose another, 0 for none"
            ) from error
        self._thread = threading.Thread(target=self._server.serve_forever, name="status", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
