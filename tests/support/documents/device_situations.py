"""Situations in which the device, or the way the PLC's program uses it, is the cause; each with its words and its cure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from pdgw.ds301.communication import EMCY_COB_ID
from pdgw.ds301.connection_set import EMCY, ERROR_CONTROL
from pdgw.ds301.nmt import NmtCommand
from pdgw.dsp402.states import State
from pdgw.gateway.daemon import Daemon
from pdgw.peers.node.misbehaviour import Misbehaviour
from pdgw.peers.node.node import SimulatedNode
from pdgw.tools.output.status_check import Health
from tests.support.documents.situations import settle
from tests.support.gateways.daemon import (
    OFF,
    ON,
    SIMULATED_POSITIONER,
    Plc,
    axis,
    configuration,
    drive_of,
    encoder_of,
    running,
)

Step = Callable[[Plc, Daemon], None]
Frame = tuple[int, bytes]
_ENCODER = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\n"
_POSITIONER = axis(1, telegram_number=111, more=SIMULATED_POSITIONER)
_MDI = {"POS_STW1": 0x8100, "OVERRIDE": 0x4000, "MDI_VELOCITY": 12_000, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000}
_TASK = (
    (0x043E, {"SATZANW": 0x8000, "MDI_MOD": 1, "MDI_VELOCITY": 1 << 29, "MDI_ACC": 0x2000, "MDI_DEC": 0x2000}),
    (0x043F, {}),
)
_SOME_FRAMES = 100
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


def _words(*frames: tuple[int, dict[str, int]]) -> Step:
    """The PLC sends STW1 and other words for a time each."""

    def begin(plc: Plc, _: Daemon) -> None:
        for word, others in frames:
            plc.endpoint.set(0, {"STW1": word} | others)
            for _ in range(_SOME_FRAMES):
                plc.exchange()

    return begin


def _both(*steps: Step) -> Step:
    def begin(plc: Plc, daemon: Daemon) -> None:
        for step in steps:
            step(plc, daemon)

    return begin


def _limit_switch(_: Plc, daemon: Daemon, positive: int = 1) -> None:
    drive_of(daemon).node.misbehave("limit-switch", positive=positive)


def _lose(plc: Plc, daemon: Daemon) -> None:
    drive_of(daemon).node.misbehave("bus-off", recovery_ms=1000)
    plc.until(lambda: not daemon.axes[0].good, "lost")
    plc.until(lambda: daemon.axes[0].good, "found again")


def _sensor_error(plc: Plc, daemon: Daemon) -> None:
    _built_in_encoder(plc, daemon)
    plc.endpoint.set(0, {"STW2_ENC": 0x0400, "G1_STW": 0x0001 | 1 << 4})
    plc.exchange()


def _sound_sensor(plc: Plc, _: Daemon) -> None:
    for word in (0, 0x8000, 0):
        plc.endpoint.set(0, {"G1_STW": word})
        for _ in range(_SOME_FRAMES):
            plc.exchange()


def _keep_mode(daemon: Daemon) -> Daemon:
    """6061h stays as it is while the operation is enabled."""
    drive_of(daemon).node.misbehave("mode-display-stuck")
    return daemon


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
    "telegram 9: STW1.6 rises while STW1.4 = 0": DeviceSituation(
        tables=axis(1, telegram_number=9),
        telegram=9,
        begin=_words(*_TASK, (0x042F, {}), (0x046F, {}), (0x047F, {})),
        says=("Waits", "was 0 at the edge of STW1.6", "set STW1.6 to 0 and to 1"),
        lacks=("STW1.4 = 0:",),
        health=Health.WARNING,
        cure=_words((0x043F, {}), (0x047F, {})),
    ),
    "telegram 111: STW1.6 rises while STW1.5 = 0": DeviceSituation(
        tables=_POSITIONER,
        telegram=111,
        begin=_words((0x043F, _MDI), (0x041F, {}), (0x045F, {}), (0x047F, {})),
        says=("Waits", "was 0 at the edge of STW1.6", "set STW1.6 to 0 and to 1"),
        lacks=("In operation",),
        health=Health.WARNING,
        cure=_words((0x043F, {}), (0x047F, {})),
    ),
    "telegram 111: STW1.6 is 1 before ON": DeviceSituation(
        tables=_POSITIONER,
        telegram=111,
        begin=_words((0x047E, _MDI), (0x047F, {})),
        says=("Waits", "STW1.6 was 1 before operation"),
        health=Health.WARNING,
        cure=_words((0x043F, {}), (0x047F, {})),
    ),
    "telegram 111: STW1.11 is 1 before ON": DeviceSituation(
        tables=_POSITIONER,
        telegram=111,
        begin=_words((0x0C3E, {}), (0x0C3F, {})),
        says=("Waits", "STW1.11 was 1 before operation"),
        health=Health.WARNING,
        cure=_words((0x043F, {}), (0x0C3F, {}), (0x043F, {})),
    ),
    'STW1.10 falls in operation, with control_lost = "hold"': DeviceSituation(
        tables=axis(1, more='simulate = true\ncontrol_lost = "hold"'),
        begin=_words((ON, {"NSOLL_A": 0x1000}), (ON & ~0x400, {})),
        says=("Waits", "STW1.10 = 0", "continues with its last setpoint", "must set STW1.10 = 1"),
        lacks=("does not start",),
        health=Health.WARNING,
        cure=_words((ON, {})),
    ),
    "the PLC's program sends the bytes of each word swapped": DeviceSituation(
        begin=_words((0x7E04, {}), (0x7F04, {})),
        says=("Waits", "STW1 = 7F04h: its two bytes are swapped (047Fh)", "swap the bytes"),
        lacks=("coast stop", "Off:"),
        health=Health.WARNING,
        cure=_words((OFF, {}), (ON, {})),
    ),
    "a positive limit switch stops the axis at a speed setpoint": DeviceSituation(
        begin=_both(_words((ON, {"NSOLL_A": 0x1000})), _limit_switch),
        says=("Waits", "stopped at a limit of the drive", "in positive direction", "negative direction is free"),
        lacks=("send setpoint 0",),
        health=Health.WARNING,
        cure=_words((ON, {"NSOLL_A": -0x1000})),
    ),
    "telegram 111: a negative limit switch stops a task": DeviceSituation(
        tables=_POSITIONER,
        telegram=111,
        begin=_both(
            _words((0x043F, _MDI | {"MDI_TARPOS": -200_000}), (0x047F, {})),
            lambda plc, daemon: _limit_switch(plc, daemon, positive=0),
        ),
        says=(
            "Waits",
            "task stopped at a limit",
            "in negative direction",
            "the negative limit switch is active (60FDh)",
        ),
        lacks=("an intermediate stop",),
        health=Health.WARNING,
        cure=_words((0x043F, {"MDI_TARPOS": 2000}), (0x047F, {})),
    ),
    "the drive was lost for a second in operation": DeviceSituation(
        begin=_lose,
        says=("Waits", "ON ignored", "because of node lost", "no TPDO2 for 200 ms, since "),
        health=Health.WARNING,
        cure=_words((OFF, {}), (ON, {})),
    ),
    "the PLC's program sends a sensor command that the encoder does not have": DeviceSituation(
        tables=_ENCODER,
        telegram=81,
        is_refused=True,
        begin=_sensor_error,
        says=("Fault", "sensor error 0F01h, G1_STW has a command that the sensor does not have"),
        cure=_sound_sensor,
    ),
    "the drive accepts another mode only while it is off": DeviceSituation(
        tables=_POSITIONER,
        telegram=111,
        begin=lambda plc, daemon: _words((0x043F, {}), (0x053F, {}))(plc, _keep_mode(daemon)),
        says=("Waits", "does not change its mode of operation while it is in operation", "end the request"),
        lacks=("Use a drive",),
        health=Health.WARNING,
        cure=_words((0x043F, {})),
    ),
}
"""By what a technician finds."""


@contextmanager
def at_device_situation(situation: DeviceSituation) -> Iterator[tuple[Daemon, Plc]]:
    """A daemon and a PLC in a situation whose cause is the device."""
    with running(configuration(situation.tables), situation.spoil) as daemon:
        plc = Plc(daemon, [situation.telegram])
        if not situation.is_refused:
            plc.enable()
        situation.begin(plc, daemon)
        settle(plc)
        yield daemon, plc
