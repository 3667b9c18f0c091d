"""Situations in which the device, or the way the PLC's program uses it, is the cause; each with its words and its cure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from pdgw.ds301.communication import EMCY_COB_ID
from pdgw.ds301.connection_set import EMCY, ERROR_CONTROL
from pdgw.ds301.nmt import NmtCommand
from pdgw.dsp402.states import State
from pdgw.gateway.daemon import Daemon
from pdgw.peers.node.misbehaviour import Misbehaviour
from pdgw.peers.node.node import SimulatedNode
from pdgw.tools.output.status_check import Health
from tests.support.gateways.daemon import OFF, Plc, axis, drive_of, encoder_of

Step = Callable[[Plc, Daemon], None]
Frame = tuple[int, bytes]
_ENCODER = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\n"
_VENDOR = 0x406
"""Vendor-ID of the simulated encoder."""
_MOVED = 0xC1
"""COB-ID of an EMCY that another tool has moved."""
_OVERCURRENT = ("Fault: EMCY 2310h over-current", "then acknowledge (STW1.7)")


@dataclass(frozen=True, kw_only=True)
class DeviceSituation:
    """A situation, and how to get there from an axis in operation."""

    begin: Step = lambda _, __: None
    says: tuple[str, ...]
    """Words that the first line contains."""
    lacks: tuple[str, ...] = ("check power", "being configured")
    """Words that it does not contain."""
    health: Health = Health.CRITICAL
    cure: Step
    """Follow the remedy."""
    tables: str = axis(1)
    telegram: int = 1
    spoil: Callable[[Daemon], None] | None = None
    """Before the gateway starts."""
    is_refused: bool = False
    """The axis is not in operation before: the gateway rejects the device."""


@dataclass(kw_only=True, eq=False)
class Frames(Misbehaviour):
    """Send other frames than a good device, or ignore some."""

    name = "frames"
    sent: Callable[[SimulatedNode, int, bytes], Frame] = lambda _, can_id, data: (can_id, data)
    ignored: Callable[[int, bytes], bool] = lambda _, __: False

    def incoming(self, can_id: int, data: bytes) -> bool:
        return not self.ignored(can_id, data)

    def outgoing(self, can_id: int, data: bytes) -> bool:
        assert isinstance(self.node, SimulatedNode)
        frame = self.sent(self.node, can_id, data)
        if frame != (can_id, data):
            self.node.transmit(*frame, past=self)
        return frame == (can_id, data)


def spoil(**what: object) -> Callable[[Daemon], None]:
    """Give the drive other frames before the gateway starts."""

    def begin(daemon: Daemon) -> None:
        fault = Frames(**what)  # type: ignore[arg-type]
        fault.node = node = drive_of(daemon).node
        node.misbehaviours[fault.name] = fault

    return begin


def good(plc: Plc, daemon: Daemon) -> None:
    """Another device, or its firmware: it sends what it should. The PLC switches on again."""
    drive_of(daemon).node.behave()
    plc.until(lambda: daemon.axes[0].good, "online")
    plc.enable()


def _short(node: SimulatedNode, can_id: int, data: bytes) -> Frame:
    """A TPDO without its last byte."""
    return can_id, data[:-1] if node.is_pdo(can_id) else data


def _ignores_start(can_id: int, data: bytes) -> bool:
    return can_id == 0 and data[0] == NmtCommand.START


def _move_emcy(daemon: Daemon) -> None:
    spoil(sent=lambda _, can_id, data: (_MOVED if can_id == EMCY + 1 else can_id, data))(daemon)
    drive_of(daemon).node.entries[EMCY_COB_ID, 0] = replace(
        drive_of(daemon).node.entries[EMCY_COB_ID, 0], default=_MOVED - 1
    )
    drive_of(daemon).node.values[EMCY_COB_ID, 0] = _MOVED


def _short_emcy(_: SimulatedNode, can_id: int, data: bytes) -> Frame:
    return can_id, data[:3] if can_id == EMCY + 1 else data


def _long_heartbeat(_: SimulatedNode, can_id: int, data: bytes) -> Frame:
    return can_id, data + b"\x05" if can_id == ERROR_CONTROL + 1 and len(data) == 1 else data


def _overcurrent(_: Plc, daemon: Daemon) -> None:
    drive_of(daemon).inject(7)


def acknowledge(plc: Plc, daemon: Daemon) -> None:
    """Acknowledge the fault after its cause is gone, then OFF and ON."""
    drive_of(daemon).clear()
    plc.endpoint.set(0, {"STW1": OFF})
    plc.exchange()
    plc.endpoint.set(0, {"STW1": OFF | 0x80})
    plc.until(lambda: drive_of(daemon).model.state is not State.FAULT, "acknowledged")
    plc.enable()


def _set_vendor(daemon: Daemon, vendor: int) -> None:
    encoder_of(daemon).node.values[0x1018, 1] = vendor


def _built_in_encoder(plc: Plc, daemon: Daemon) -> None:
    """The data sheet is that of the device."""
    _set_vendor(daemon, _VENDOR)
    plc.endpoint.set(0, {"STW2_ENC": 0x0400})
    plc.until(lambda: daemon.encoders[0].good, "online")


def _set_error_register(daemon: Daemon) -> None:
    spoil(ignored=_ignores_start)(daemon)
    drive_of(daemon).model.error_register = 0x11


DEVICE_SITUATIONS: dict[str, DeviceSituation] = {
    "the drive does not execute NMT start": DeviceSituation(
        is_refused=True,
        spoil=_set_error_register,
        says=("rejected", "Pre-operational", "1001h = 11h (generic, communication)", "restart the node"),
        lacks=("TPDO", "check power", "being configured", "config check"),
        cure=good,
    ),
    "the drive sends a TPDO that is one byte shorter than its mapping": DeviceSituation(
        is_refused=True,
        spoil=spoil(sent=_short),
        says=("rejected", "TPDO1", "5 bytes", "6 bytes"),
        lacks=("none of", "being configured", "sync"),
        cure=good,
    ),
    "the encoder is of another manufacturer, and the configuration has no EDS": DeviceSituation(
        is_refused=True,
        tables=_ENCODER,
        telegram=81,
        spoil=lambda daemon: _set_vendor(daemon, 0xABCE),
        says=("rejected", "0000ABCEh", "as in the built-in data sheet", "set the key eds"),
        lacks=("as in the EDS", "check power", "config check"),
        cure=_built_in_encoder,
    ),
    "the drive sends its EMCY with another COB-ID (1014h)": DeviceSituation(
        spoil=_move_emcy, begin=_overcurrent, says=_OVERCURRENT, cure=acknowledge
    ),
    "the drive sends an EMCY of three bytes": DeviceSituation(
        spoil=spoil(sent=_short_emcy), begin=_overcurrent, says=_OVERCURRENT, cure=acknowledge
    ),
    "the drive sends heartbeats of two bytes, and has a fault": DeviceSituation(
        spoil=spoil(sent=_long_heartbeat), begin=_overcurrent, says=_OVERCURRENT, cure=acknowledge
    ),
}
"""By what a technician finds."""
