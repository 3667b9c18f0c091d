"""Situations in which the device, or the way the PLC's program uses it, is the cause; each with its words and its cure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from pdgw.ds301.communication import CONSUMER_HEARTBEAT, EMCY, EMCY_COB_ID, ERROR_CONTROL, NmtCommand, NmtState
from pdgw.ds301.node.node import NodeStatus
from pdgw.dsp402.objects import QUICK_STOP_DECELERATION, VELOCITY_ENCODER_FACTOR
from pdgw.dsp402.states import STATUS_OF, State
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.drive.model.model import DriveModel
from pdgw.peers.node.behaviour import Behaviour
from pdgw.peers.node.node import SimulatedNode
from pdgw.profidrive.signals import signal
from pdgw.tools.output.status_text import Health
from tests.support.documents.situations import Situation, acknowledge, both, online, words
from tests.support.gateways.daemon import OFF, ON, SIMULATED_POSITIONER, Plc, axis, drive_of

Frame = tuple[int, bytes]
POSITIONER = axis(1, telegram_number=111, more=SIMULATED_POSITIONER)
_LIMITED = axis(1, telegram_number=111, more=SIMULATED_POSITIONER.replace("[-1000000, 1000000]", "[-400, 400]"))
MDI = {"POS_STW1": 0x8100, "OVERRIDE": 0x4000, "MDI_VELOCITY": 12_000, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000}
_BLOCK = '[[axis.block]]\nnumber = 3\nvelocity = 12_000\nmode = "endless-positive"\n'
_TASK = (
    (0x043E, {"SATZANW": 0x8000, "MDI_MOD": 1, "MDI_VELOCITY": 1 << 29, "MDI_ACC": 0x2000, "MDI_DEC": 0x2000}),
    (0x043F, {}),
)
_VALUE = axis(1, more='simulate = true\n[axis.objects]\n"6085h" = 1200\n')
_MOVED = 0xC1
"""COB-ID of an EMCY that another tool has moved."""
_OVERCURRENT = ("Fault: EMCY 2310h over-current", "then acknowledge (STW1.7)")


@dataclass(frozen=True, kw_only=True)
class DeviceSituation(Situation):
    """A situation whose cause is the device, or its use by the PLC's program."""

    lacks: tuple[str, ...] = ("check power", "being configured")


@dataclass(kw_only=True, eq=False)
class Frames(Behaviour):
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
        node.behaviours[fault.name] = fault

    return begin


def end_fault(plc: Plc, daemon: Daemon) -> None:
    """Another device, or its firmware: it sends what it should."""
    drive_of(daemon).node.end_fault()
    online(plc, daemon)


def _short(node: SimulatedNode, can_id: int, data: bytes) -> Frame:
    """A TPDO without its last byte."""
    return can_id, data[:-1] if node.is_pdo(can_id) else data


def _leaves_operational(node: SimulatedNode, can_id: int, data: bytes) -> Frame:
    """An EMCY instead of its first TPDO."""
    if not node.is_pdo(can_id):
        return can_id, data
    node.state = NmtState.PRE_OPERATIONAL
    node.on_nmt(node.state)
    return EMCY + 1, bytes(8)


def _ignores_start(can_id: int, data: bytes) -> bool:
    return can_id == 0 and data[0] == NmtCommand.START


def _limit_switch(_: Plc, daemon: Daemon, positive: int = 1) -> None:
    drive_of(daemon).node.start_fault("limit-switch", positive=positive)


def _slow_brake(_: Plc, daemon: Daemon) -> None:
    drive_of(daemon).node.start_fault("brake-opens", delay_ms=6000)


def _lose(plc: Plc, daemon: Daemon) -> None:
    drive_of(daemon).node.start_fault("bus-off", recovery_ms=1000)
    plc.until(lambda: not daemon.axes[0].good, "lost")
    plc.until(lambda: daemon.axes[0].good, "found again")


def _count_sign_of_life(plc: Plc, daemon: Daemon) -> None:
    daemon.objects[0].set_sign_of_life_tolerance(3)
    plc.endpoint.count(0, "STW2", signal("STW2").bit("SIGN_OF_LIFE"))
    plc.enable()


def _stop_sign_of_life(plc: Plc, daemon: Daemon) -> None:
    _count_sign_of_life(plc, daemon)
    plc.endpoint.count(0, "STW2", None)


def _keep_mode(daemon: Daemon) -> Daemon:
    """6061h stays as it is while the operation is enabled."""
    drive_of(daemon).node.start_fault("mode-display-stuck")
    return daemon


def _move_emcy(daemon: Daemon) -> None:
    spoil(sent=lambda _, can_id, data: (_MOVED if can_id == EMCY + 1 else can_id, data))(daemon)
    drive_of(daemon).node.entries[EMCY_COB_ID, 0] = replace(
        drive_of(daemon).node.entries[EMCY_COB_ID, 0], default=_MOVED - 1
    )
    drive_of(daemon).node.values[EMCY_COB_ID, 0] = _MOVED


def set_node_id(daemon: Daemon, node_id: int) -> None:
    node = drive_of(daemon).node
    node.node_id = node_id
    node.restart()


def _other_node_id(plc: Plc, daemon: Daemon) -> None:
    set_node_id(daemon, 2)
    plc.until(lambda: daemon.axes[0].client.status is NodeStatus.OFFLINE, "no answer")


def right_node_id(plc: Plc, daemon: Daemon) -> None:
    set_node_id(daemon, 1)
    online(plc, daemon)


def _short_emcy(_: SimulatedNode, can_id: int, data: bytes) -> Frame:
    return can_id, data[:3] if can_id == EMCY + 1 else data


def _long_heartbeat(_: SimulatedNode, can_id: int, data: bytes) -> Frame:
    return can_id, data + b"\x05" if can_id == ERROR_CONTROL + 1 and len(data) == 1 else data


def _overcurrent(_: Plc, daemon: Daemon) -> None:
    drive_of(daemon).inject(7)


def _show_fault(daemon: Daemon) -> None:
    """From power-on the Statusword shows a fault, and 603Fh is 0."""

    def shows(model: DriveModel, _: int) -> None:
        model.statusword = STATUS_OF[State.FAULT]

    drive_of(daemon).model.disguises.append(shows)


def _leave_fault(plc: Plc, daemon: Daemon) -> None:
    drive_of(daemon).model.disguises.clear()
    acknowledge(plc, daemon)


def _set_error_register(daemon: Daemon) -> None:
    spoil(ignored=_ignores_start)(daemon)
    drive_of(daemon).model.error_register = 0x11


def _take_factor(_plc: Plc, daemon: Daemon) -> None:
    """As ``pdgw device write`` does."""
    drive_of(daemon).node.values[VELOCITY_ENCODER_FACTOR, 1] = 4


def _without_node_id(daemon: Daemon) -> None:
    drive_of(daemon).node.start_fault("lss-without-node-id")


DEVICE_SITUATIONS: dict[str, DeviceSituation] = {
    "the drive does not execute NMT start": DeviceSituation(
        operates=False,
        spoil=_set_error_register,
        says=("rejected", "Pre-operational", "1001h = 11h (generic, communication)", "restart the node"),
        lacks=("TPDO", "check power", "being configured", "config check"),
        cure=end_fault,
    ),
    "the drive is Pre-operational after each EMCY, also at the end of its errors": DeviceSituation(
        operates=False,
        spoil=spoil(sent=_leaves_operational),
        says=("rejected", "Pre-operational after EMCY 0000h", "restart the node"),
        lacks=("TPDO", "check power", "being configured", "config check"),
        cure=end_fault,
    ),
    "the drive has no object 1016h for guarding the gateway": DeviceSituation(
        operates=False,
        spoil=lambda daemon: drive_of(daemon).node.start_fault("object-missing", index=CONSUMER_HEARTBEAT),
        says=("rejected", "guarding of the gateway", "1016h: 0602 0000h: object does not exist", "allow_unguarded"),
        cure=end_fault,
    ),
    "the drive rejects a value of its table of objects": DeviceSituation(
        operates=False,
        tables=_VALUE,
        spoil=lambda daemon: drive_of(daemon).node.start_fault("write-refused", index=QUICK_STOP_DECELERATION),
        says=(
            "rejected",
            "6085h = 1200 of [axis.objects]",
            "0609 0030h: value range of parameter exceeded",
            "correct it in",
        ),
        cure=end_fault,
    ),
    "the drive rounds a value of its table of objects": DeviceSituation(
        operates=False,
        tables=_VALUE,
        spoil=lambda daemon: drive_of(daemon).node.start_fault(
            "value-rounded", index=QUICK_STOP_DECELERATION, step=1000
        ),
        says=("rejected", "6085h = 1200 of [axis.objects]", "1000", "set what it has in [axis.objects]"),
        cure=end_fault,
    ),
    "the drive has another factor of units than its table of objects": DeviceSituation(
        operates=False,
        tables=axis(1, more='simulate = true\n[axis.objects]\n"6094h.1" = 4\n'),
        says=("rejected", "6094h.1 = 4 of [axis.objects]", "run pdgw device write --store", "off and on"),
        cure=both(_take_factor, end_fault),
    ),
    "the drive has no node-ID": DeviceSituation(
        operates=False,
        spoil=_without_node_id,
        says=("Not on the bus", "no answer from node 1", "node-ID of the drive"),
        lacks=("being configured",),
        cure=end_fault,
    ),
    "the drive sends a TPDO that is one byte shorter than its mapping": DeviceSituation(
        operates=False,
        spoil=spoil(sent=_short),
        says=("rejected", "TPDO1", "5 bytes", "6 bytes"),
        lacks=("none of", "being configured", "sync"),
        cure=end_fault,
    ),
    "the drive has another node-ID than the configuration": DeviceSituation(
        operates=False,
        begin=_other_node_id,
        says=("Not on the bus", "no answer from node 1", "not in the configuration: node 2", "pdgw bus scan"),
        lacks=("being configured",),
        cure=right_node_id,
    ),
    "the drive sends its EMCY with another COB-ID (1014h)": DeviceSituation(
        spoil=_move_emcy, begin=_overcurrent, says=_OVERCURRENT, cure=acknowledge
    ),
    "the drive sends an EMCY of three bytes": DeviceSituation(
        spoil=spoil(sent=_short_emcy), begin=_overcurrent, says=_OVERCURRENT, cure=acknowledge
    ),
    "the drive is in fault from power-on, without an EMCY or a code": DeviceSituation(
        operates=False,
        spoil=_show_fault,
        says=(
            "Fault: Statusword 0008h shows a fault (older than the connection). ",
            "read the fault at the display of the device",
        ),
        lacks=("this code",),
        cure=_leave_fault,
    ),
    "the drive sends heartbeats of two bytes, and has a fault": DeviceSituation(
        spoil=spoil(sent=_long_heartbeat), begin=_overcurrent, says=_OVERCURRENT, cure=acknowledge
    ),
    "telegram 9: STW1.6 rises while STW1.4 = 0": DeviceSituation(
        tables=axis(1, telegram_number=9),
        begin=words(*_TASK, (0x042F, {}), (0x046F, {}), (0x047F, {})),
        says=("Waits", "edge of STW1.6 started no task: STW1.4 = 0", "set STW1.6 to 0 and to 1, with STW1.4 = 1"),
        lacks=("STW1.5", "SATZANW"),
        health=Health.WARNING,
        cure=words((0x043F, {}), (0x047F, {})),
    ),
    "telegram 111: STW1.6 rises while STW1.5 = 0": DeviceSituation(
        tables=POSITIONER,
        begin=words((0x043F, MDI), (0x041F, {}), (0x045F, {}), (0x047F, {})),
        says=("Waits", "edge of STW1.6 started no task: STW1.5 = 0", "set STW1.6 to 0 and to 1, with STW1.5 = 1"),
        lacks=("In operation", "STW1.4"),
        health=Health.WARNING,
        cure=words((0x043F, {}), (0x047F, {})),
    ),
    "telegram 111: STW1.6 and STW1.8 rise while STW1.4 = 0": DeviceSituation(
        tables=POSITIONER,
        begin=words((0x043F, MDI), (0x042F, {}), (0x046F, {}), (0x056F, {}), (0x057F, {})),
        says=("Waits", "edge of STW1.6 started no task: STW1.4 = 0", "without effect: STW1.8 = 1", "set STW1.6 to 0"),
        lacks=("In operation",),
        health=Health.WARNING,
        cure=words((0x043F, {}), (0x047F, {})),
    ),
    "telegram 111: STW1.8 rises while STW1.4 = 0": DeviceSituation(
        tables=POSITIONER,
        begin=words((0x043F, MDI), (0x042F, {}), (0x052F, {})),
        says=("Waits: STW1.4 = 0", "without effect: STW1.8 = 1", "STW1.4 = 1, and then a new edge of STW1.8"),
        lacks=("STW1.6",),
        health=Health.WARNING,
        cure=words((0x043F, {}), (0x053F, {})),
    ),
    "telegram 111: STW1.6 is 1 before ON": DeviceSituation(
        tables=POSITIONER,
        begin=words((0x047E, MDI), (0x047F, {})),
        says=("Waits", "STW1.6 was 1 before operation"),
        health=Health.WARNING,
        cure=words((0x043F, {}), (0x047F, {})),
    ),
    "telegram 111: STW1.11 is 1 before ON": DeviceSituation(
        tables=POSITIONER,
        begin=words((0x0C3E, {}), (0x0C3F, {})),
        says=("Waits", "STW1.11 = 1 starts no homing: it was 1 before operation"),
        health=Health.WARNING,
        cure=words((0x043F, {}), (0x0C3F, {}), (0x043F, {})),
    ),
    "telegram 111: STW1.11 rises while STW1.4 = 0": DeviceSituation(
        tables=POSITIONER,
        begin=words((0x043F, MDI), (0x042F, {}), (0x0C2F, {}), (0x0C3F, {})),
        says=("Waits", "STW1.11 = 1 starts no homing: STW1.4 = 0", "set STW1.11 to 0 and to 1, with STW1.4 = 1"),
        lacks=("before operation", "another function"),
        health=Health.WARNING,
        cure=words((0x043F, {}), (0x0C3F, {}), (0x043F, {})),
    ),
    "telegram 111: STW1.11 rises without homing_method": DeviceSituation(
        tables=POSITIONER.replace("homing_method = 35\n", ""),
        begin=words((0x043F, MDI), (0x0C3F, {})),
        says=("Waits", "homing_method is not configured, allowed "),
        lacks=("None",),
        health=Health.WARNING,
        cure=words((0x043F, {}), (0x047F, {})),
    ),
    "telegram 111: STW1.8 and STW1.9 are both 1": DeviceSituation(
        tables=POSITIONER,
        begin=words((0x043F, MDI), (0x073F, {})),
        says=("Waits", "STW1.8 or STW1.9 = 1 starts no jog: both were 1", "then one of them to 1"),
        lacks=("STW1.4",),
        health=Health.WARNING,
        cure=words((0x043F, {})),
    ),
    "telegram 111: STW1.6 rises during homing": DeviceSituation(
        tables=POSITIONER,
        begin=words((0x043F, MDI), (0x0C3F, {}), (0x0C7F, {}), (0x047F, {})),
        says=("Waits", "edge of STW1.6 started no task: homing was active at its edge", "set STW1.6 to 0 and to 1"),
        lacks=("STW1.4", "another function"),
        health=Health.WARNING,
        cure=words((0x043F, {}), (0x047F, {})),
    ),
    "telegram 111: a reference point is set in motion": DeviceSituation(
        tables=POSITIONER,
        begin=words(
            (0x043F, MDI | {"MDI_TARPOS": 200_000}),
            (0x047F, {}),
            (0x047F, {"POS_STW2": 2}),
            (0x047F, {"POS_STW2": 0}),
            (0x043F, {}),
        ),
        says=("Waits", "the reference point was not set", "(at ", "new edge of POS_STW2.1"),
        lacks=("can be set",),
        health=Health.WARNING,
        cure=words((0x043F, {"POS_STW2": 2})),
    ),
    "telegram 111: the target of a task is beyond a software limit": DeviceSituation(
        tables=_LIMITED,
        begin=words((0x043F, MDI | {"POS_STW2": 2}), (0x043F, {"POS_STW2": 0x4000, "MDI_TARPOS": 2000}), (0x047F, {})),
        says=(
            "Waits",
            "target is beyond a software limit",
            "-400 to 400 LU",
            "give a target inside the software limits",
        ),
        lacks=("In operation", "jog"),
        health=Health.WARNING,
        cure=words((0x043F, {"MDI_TARPOS": 100}), (0x047F, {})),
    ),
    "telegram 111: a jog is held at a software limit": DeviceSituation(
        tables=_LIMITED,
        begin=words((0x043F, MDI | {"POS_STW2": 2}), (0x043F, {"POS_STW2": 0x4000}), (0x063F, {}), (0x063F, {})),
        says=("Waits", "at a software limit", "beyond it: -400 to 400 LU", "move in the other direction"),
        lacks=("In operation",),
        health=Health.WARNING,
        cure=words((0x043F, {}), (0x053F, {}), (0x043F, {})),
    ),
    "telegram 110: an endless block is at a software limit": DeviceSituation(
        tables=_LIMITED.replace("telegram = 111", "telegram = 110") + _BLOCK,
        begin=words((0x043F, {"SATZANW": 3, "OVERRIDE": 0x4000, "POS_STW": 2}), (0x047F, {}), (0x047F, {})),
        says=("Waits", "at a software limit", "endless block leads beyond it: -400 to 400 LU"),
        lacks=("In operation",),
        health=Health.WARNING,
        cure=words((0x043F, {}), (0x053F, {}), (0x043F, {})),
    ),
    'STW1.10 falls in operation, with control_lost = "hold"': DeviceSituation(
        tables=axis(1, more='simulate = true\ncontrol_lost = "hold"'),
        begin=words((ON, {"NSOLL_A": 0x1000}), (ON & ~0x400, {})),
        says=("In operation", "STW1.10 = 0", "continues with its last setpoint", "must set STW1.10 = 1"),
        lacks=("does not start", "Waits"),
        health=Health.WARNING,
        cure=words((ON, {})),
    ),
    "the PLC's program sends the bytes of each word swapped": DeviceSituation(
        begin=words((0x7E04, {}), (0x7F04, {})),
        says=("Waits", "STW1 = 7F04h: its two bytes are swapped (047Fh)", "swap the bytes"),
        lacks=("coast stop", "Off:"),
        health=Health.WARNING,
        cure=words((OFF, {}), (ON, {})),
    ),
    "a positive limit switch stops the axis at a speed setpoint": DeviceSituation(
        begin=both(words((ON, {"NSOLL_A": 0x1000})), _limit_switch),
        says=("Waits", "stopped at a limit of the drive", "in positive direction", "negative direction is free"),
        lacks=("send setpoint 0",),
        health=Health.WARNING,
        cure=words((ON, {"NSOLL_A": -0x1000})),
    ),
    "telegram 111: a negative limit switch stops a task": DeviceSituation(
        tables=POSITIONER,
        begin=both(
            words((0x043F, MDI | {"MDI_TARPOS": -200_000}), (0x047F, {})),
            lambda plc, daemon: _limit_switch(plc, daemon, positive=0),
        ),
        says=(
            "Waits",
            "task stopped at a limit",
            "in negative direction",
            "60FDh.0 = 1 (negative limit switch)",
        ),
        lacks=("an intermediate stop",),
        health=Health.WARNING,
        cure=words((0x043F, {"MDI_TARPOS": 2000}), (0x047F, {})),
    ),
    "the drive was lost for a second in operation": DeviceSituation(
        begin=_lose,
        says=("Waits: ON ignored: node lost: silent", ", since ", "Check plug, cable and supply", "; then OFF and ON"),
        lacks=("send an OFF first",),
        health=Health.WARNING,
        cure=words((OFF, {}), (ON, {})),
    ),
    "telegram 9: SATZANW.15 = 0": DeviceSituation(
        tables=axis(1, telegram_number=9),
        begin=words((0x043E, {}), (0x043F, {}), (0x047F, {})),
        says=("Waits: SATZANW.15 = 0: MDI is not selected", "Set SATZANW.15"),
        health=Health.WARNING,
        cure=words((0x043F, _TASK[0][1]), (0x047F, {})),
    ),
    "telegram 111: OVERRIDE is 0": DeviceSituation(
        tables=POSITIONER,
        begin=words((0x043F, MDI | {"OVERRIDE": 0, "MDI_TARPOS": 2000}), (0x047F, {})),
        says=("Waits: OVERRIDE is 0", "Raise OVERRIDE"),
        health=Health.WARNING,
        cure=words((0x047F, {"OVERRIDE": 0x4000})),
    ),
    "telegram 111: the traversing block does not exist": DeviceSituation(
        tables=POSITIONER,
        begin=words((0x043F, {"POS_STW1": 63, "OVERRIDE": 0x4000}), (0x047F, {})),
        says=(
            "Waits: the task selected a traversing block that does not exist",
            "configure it in [[axis.block]], and then a new edge",
        ),
        health=Health.WARNING,
        cure=words((0x043F, MDI), (0x047F, {})),
    ),
    "telegram 3: the sign of life of the PLC's program stops": DeviceSituation(
        tables=axis(1, telegram_number=3),
        begin=_stop_sign_of_life,
        says=("Waits: the PLC's sign of life (STW2.12-15) does not count", "raise P925"),
        lacks=("check the cable",),
        health=Health.WARNING,
        cure=_count_sign_of_life,
    ),
    "the drive waits in Switched On until its brake is open": DeviceSituation(
        begin=both(_slow_brake, words((OFF, {}), (ON, {}))),
        says=(
            "Starting: the drive opens its brake, or finds its commutation angle, since ",
            "wait; if it takes longer",
        ),
        lacks=("is commanded, but", "Waits"),
        health=Health.WARNING,
        cure=lambda *_: None,
    ),
    "the drive waits at standstill until its brake is closed": DeviceSituation(
        spoil=lambda daemon: drive_of(daemon).node.start_fault("brake-closes", delay_ms=3000),
        begin=words((OFF, {})),
        says=("Stopping: the drive is at standstill and has not left operation yet", "wait while its brake closes"),
        lacks=("does not stop", "Off:"),
        health=Health.WARNING,
        cure=words((OFF, {}), (ON, {})),
    ),
    "the drive accepts another mode only while it is off": DeviceSituation(
        tables=POSITIONER,
        begin=lambda plc, daemon: words((0x043F, {}), (0x053F, {}))(plc, _keep_mode(daemon)),
        says=("Waits", "does not change its mode of operation while it is in operation", "end the request"),
        lacks=("Use a drive",),
        health=Health.WARNING,
        cure=words((0x043F, {})),
    ),
}
"""What a technician finds, over both links."""
