"""Situations that a technician finds at night: the first guess is wrong, and the line has to name what is true."""

from __future__ import annotations

from dataclasses import dataclass

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.port import PortBusyError
from pdgw.ds301.communication import SDO_REQUEST
from pdgw.ds301.node.node import NodeStatus
from pdgw.dsp402.objects import MAX_PROFILE_VELOCITY
from pdgw.dsp402.states import STATUS_OF, State, StatusBit
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.drive.model.model import DriveModel
from pdgw.peers.node.behaviour import Behaviour
from pdgw.tools.output.status_text import Health
from tests.support.documents.device_situations import MDI, POSITIONER, right_node_id, set_node_id
from tests.support.documents.origin_situations import find, miss
from tests.support.documents.situations import Situation, Step, acknowledge, both, online, run_out, words
from tests.support.gateways.daemon import OFF, ON, Plc, axis, drive_of, encoder_of, switch_off, world_of

_AGAIN = words((OFF, {}), (ON, {}))


def _wait(seconds: int) -> Step:
    return lambda plc, _: run_out(plc, seconds * SECOND)


def _darken(_: Plc, daemon: Daemon) -> None:
    """No device of the bus has power: nobody acknowledges."""
    for item in daemon.objects:
        drive_of(daemon, item.node_id).node.power_off()


def _light(plc: Plc, daemon: Daemon) -> None:
    for item in daemon.objects:
        drive_of(daemon, item.node_id).node.restart()
    online(plc, daemon)


def _start_dark(daemon: Daemon) -> None:
    drive_of(daemon).node.power_off()


def _short(restart_ns: int | None) -> Step:
    """A short circuit for half a second; ``restart_ns`` as of a ``Member``."""

    def step(plc: Plc, daemon: Daemon) -> None:
        world_of(daemon).gateway_port("world").restart_ns = restart_ns
        world_of(daemon).bus("world").short(True)
        run_out(plc, SECOND // 2)
        world_of(daemon).bus("world").short(False)

    return step


def _trip_consumer(plc: Plc, daemon: Daemon) -> None:
    """A short circuit, in which the heartbeat consumer of the drive trips; it stays in error until the drive restarts."""
    world_of(daemon).bus("world").short(True)
    run_out(plc, SECOND // 4)
    drive_of(daemon).inject("CANopen")
    run_out(plc, SECOND // 4)
    world_of(daemon).bus("world").short(False)
    find(plc, daemon)


def _restart_drive(plc: Plc, daemon: Daemon) -> None:
    """P972, then an acknowledge."""
    drive_of(daemon).clear()
    daemon.objects[0].reset_node()
    miss(plc, daemon)
    acknowledge(plc, daemon)


@dataclass(kw_only=True, eq=False)
class _OldMapping(Behaviour):
    """The drive processes no RPDO until it restarts, and reports each by EMCY 8210h, 100 ms apart."""

    name = "old mapping"
    announced: int = 0

    def incoming(self, can_id: int, data: bytes) -> bool:
        if not self.node.is_pdo(can_id):
            return True
        if self.node.now - self.announced > 100 * MS:
            self.announced = self.node.now
            self.node.send_emcy(0x8210, 0x11)
        return False


def _ignore_rpdos(daemon: Daemon) -> None:
    drive_of(daemon).node.start_fault("deaf")


def _reject_rpdos(daemon: Daemon) -> None:
    behaviour = _OldMapping()
    behaviour.node = node = drive_of(daemon).node
    node.behaviours[behaviour.name] = behaviour


def _hear(plc: Plc, daemon: Daemon) -> None:
    """The drive restarts with the new mapping."""
    drive_of(daemon).node.end_fault()
    daemon.objects[0].reset_node()
    miss(plc, daemon)
    online(plc, daemon)


def _limit_speed(plc: Plc, daemon: Daemon) -> None:
    """Another tool has set the greatest speed of the drive below the setpoint of the PLC."""
    node = drive_of(daemon).node
    node.values[MAX_PROFILE_VELOCITY, 0] = 100

    def limits(model: DriveModel, _: int) -> None:
        model.velocity_actual = min(model.velocity_actual, 100)

    drive_of(daemon).model.disguises.append(limits)
    words((ON, {"NSOLL_A": 0x1000}))(plc, daemon)


def _raise_limit(plc: Plc, daemon: Daemon) -> None:
    drive_of(daemon).node.values[MAX_PROFILE_VELOCITY, 0] = 6000
    _release(plc, daemon)


def _block(plc: Plc, daemon: Daemon) -> None:
    """The brake is closed."""

    def blocks(model: DriveModel, _: int) -> None:
        model.velocity_actual = model.position_actual = 0

    drive_of(daemon).model.disguises.append(blocks)
    words((ON, {"NSOLL_A": 0x1000}))(plc, daemon)


def _release(plc: Plc, daemon: Daemon) -> None:
    model = drive_of(daemon).model
    model.disguises.clear()
    model._update()


def _start_local(daemon: Daemon) -> None:
    """From power-on the drive is in local mode, and has not shown remote mode yet."""

    def shows(model: DriveModel, _: int) -> None:
        model.statusword = STATUS_OF[State.SWITCH_ON_DISABLED] | StatusBit.VOLTAGE_ENABLED

    drive_of(daemon).model.disguises.append(shows)


def _flood(plc: Plc, daemon: Daemon) -> None:
    """A device sends frames without a pause: its identifier wins each arbitration."""
    sender = world_of(daemon).bus("world").join("flood")
    sender.droppable = True

    def send() -> None:
        while not sender.closed and len(sender.queue) < sender.places:
            sender.send(0x002, bytes(8))
        if not sender.closed:
            plc.loop.call_later(MS, send)

    send()


def _end_flood(plc: Plc, daemon: Daemon) -> None:
    (sender,) = [member for member in world_of(daemon).bus("world").members if member.name == "flood"]
    sender.drop()
    sender.close()
    online(plc, daemon)


def _lose_home(plc: Plc, daemon: Daemon) -> None:
    """The drive loses its 24 V for a moment after its homing, and the PLC sends an absolute task."""
    words((0x043E, MDI), (0x043F, {}), (0x0C3F, {}))(plc, daemon)
    plc.until(lambda: plc.value("ZSW1") & 1 << 11, "the home position")
    words((0x043F, {}))(plc, daemon)
    drive_of(daemon).node.start_fault("reboot")
    miss(plc, daemon)
    find(plc, daemon)
    words((0x043E, {}), (0x043F, MDI | {"MDI_TARPOS": 200_000, "MDI_VELOCITY": 1200}), (0x047F, {}))(plc, daemon)


def _change_node_id(_: Plc, daemon: Daemon) -> None:
    set_node_id(daemon, 2)


def _stop_sending(places: int) -> Step:
    """The CAN adapter receives, takes this number of frames to send and sends none."""

    def step(plc: Plc, daemon: Daemon) -> None:
        port, taken = world_of(daemon).gateway_port("world"), 0

        def send(_can_id: int, _data: bytes) -> None:
            nonlocal taken
            taken += 1
            if taken > places:
                raise PortBusyError

        port.send = send  # type: ignore[method-assign]
        run_out(plc)

    return step


def _restart_interface(plc: Plc, daemon: Daemon) -> None:
    world_of(daemon).unplug("world")
    run_out(plc, SECOND // 10)
    world_of(daemon).unplug("world", False)
    online(plc, daemon)


def _pause(plc: Plc, daemon: Daemon) -> None:
    """The machine of the gateway is paused for 4 s."""
    world_of(daemon).loop.pause(4 * SECOND)
    plc.until(lambda: not daemon.axes[0].released, "the stop")
    find(plc, daemon)


def _second_device(plc: Plc, daemon: Daemon) -> None:
    """A spare drive with the same node-ID is plugged in, and out again."""
    spare = world_of(daemon).drive("world", 1)
    plc.until(lambda: daemon.axes[0].client.status is NodeStatus.REFUSED, "the proof")
    spare.node.power_off()
    run_out(plc, 10 * SECOND)
    find(plc, daemon)


def _write_from_elsewhere(plc: Plc, daemon: Daemon) -> None:
    """The software of the drive's maker writes the producer heartbeat time, 1017h."""
    request = bytes.fromhex("2b1710006400") + bytes(2)
    world_of(daemon).bus("world").join("another tool").send(SDO_REQUEST + 1, request)
    plc.until(lambda: not daemon.axes[0].good, "the check")
    find(plc, daemon)


def _hang(plc: Plc, daemon: Daemon) -> None:
    """The drive restarts, and its SDO server hangs afterwards."""
    drive_of(daemon).node.start_fault("sdo-timeout")
    drive_of(daemon).node.start_fault("reboot")
    miss(plc, daemon)
    run_out(plc, 2 * SECOND)


def _recover(plc: Plc, daemon: Daemon) -> None:
    """The drive is switched off and on."""
    drive_of(daemon).node.end_fault()
    drive_of(daemon).node.restart()
    online(plc, daemon)


def _swap_node_ids(plc: Plc, daemon: Daemon) -> None:
    """A technician has plugged drive and encoder at each other's place: each has the node-ID of the other one."""
    drive, encoder = drive_of(daemon).node, encoder_of(daemon).node
    world_of(daemon).bus("world").join("another device")
    for node, node_id in ((drive, encoder.node_id), (encoder, drive.node_id)):
        node.power_off()
        node.node_id = node_id
    run_out(plc, SECOND)
    drive.restart()
    encoder.restart()
    run_out(plc, 2 * SECOND)


def _swap_back(plc: Plc, daemon: Daemon) -> None:
    world = world_of(daemon).simulations["can"]
    drive, encoder = world.device(1).node, world.device(20).node
    drive.node_id, encoder.node_id = 1, 20
    drive.restart()
    encoder.restart()
    online(plc, daemon)


def _cut_switches(_: Plc, daemon: Daemon) -> None:
    """The limit switches are normally closed, and have lost their common 24 V."""

    def shows(model: DriveModel, _: int) -> None:
        model.digital_inputs |= 3

    drive_of(daemon).node.start_fault("limit-switch", positive=0)
    drive_of(daemon).model.disguises.append(shows)


def _supply_switches(plc: Plc, daemon: Daemon) -> None:
    drive_of(daemon).node.end_fault()
    drive_of(daemon).model.disguises.clear()
    drive_of(daemon).model.digital_inputs &= ~3
    words((0x043F, {"MDI_TARPOS": 2000}), (0x047F, {}))(plc, daemon)


_DARK = ("bus can: no device on the bus acknowledges a frame", "Check the supply of the devices, then the CAN cable")
NIGHT_SITUATIONS: dict[str, Situation] = {
    "all drives of the bus lose their supply": Situation(
        begin=_darken,
        tables=axis(1) + axis(2) + axis(3),
        says=("axes 1-3 Not on the bus: ", *_DARK),
        lacks=("bus-off", "interface"),
        cure=_light,
    ),
    "the gateway starts, and the only drive has no power": Situation(
        operates=False,
        spoil=_start_dark,
        says=("Not on the bus: ", *_DARK),
        lacks=("bus-off", "interface"),
        cure=_light,
    ),
    "a short circuit of the bus, and the interface does not restart": Situation(
        begin=both(_short(None), _wait(6)),
        says=("Not on the bus: bus can: bus-off, and the interface does not restart", "restart-ms 100"),
        lacks=("by itself again", "connects again"),
        cure=_restart_interface,
    ),
    "all drives lost their supply for a moment while the PLC keeps ON": Situation(
        begin=both(_darken, _wait(2), lambda _, daemon: drive_of(daemon).node.restart(), find),
        says=("Waits: ON ignored: ", "no device on the bus acknowledges a frame", "; then OFF and ON"),
        lacks=("bus-off", "interface", "adapter"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the drive ignores every RPDO, as with its old mapping": Situation(
        operates=False,
        spoil=_ignore_rpdos,
        begin=words((OFF, {}), (OFF, {}), (ON, {}), (ON, {})),
        says=(
            "Waits: the drive does not take the Controlword: 6040h is ",
            ", 0006h was sent",
            "Restart the node (P972",
            "1600h",
        ),
        lacks=("STO", "enable input"),
        health=Health.WARNING,
        cure=_hear,
    ),
    "the drive is in local mode from power-on": Situation(
        operates=False,
        spoil=_start_local,
        begin=words((OFF, {}), (OFF, {}), (ON, {})),
        says=(
            "Waits: the drive did not leave Switch On Disabled after ON: ",
            "safe torque off (STO), enable input or supply, or local mode (Statusword.9 = 0)",
            "Switch the drive to remote at its panel",
            "close STO",
        ),
        health=Health.WARNING,
        cure=both(_release, words((OFF, {}), (OFF, {}), (ON, {}))),
    ),
    "a device fills the bus with one identifier": Situation(
        begin=both(_flood, _wait(2)),
        says=(
            "Not on the bus: bus can: frames with COB-ID 002h fill the bus: more than ",
            "Find the device that sends COB-ID 002h",
        ),
        lacks=("silent", "power", "interface"),
        cure=_end_flood,
    ),
    "telegram 111: an absolute task after the drive has lost its home position": Situation(
        tables=POSITIONER,
        begin=_lose_home,
        says=(
            "In operation: the home position was lost with the drive at ",
            "an absolute task runs without it",
            "home the axis before an absolute task",
        ),
        health=Health.WARNING,
        cure=words((0x043F, {}), (0x0C3F, {}), (0x043F, {})),
    ),
    "the PLC marked the data of the axis as bad for a moment": Situation(
        begin=both(lambda plc, _: plc.endpoint.bad.add(0), _wait(1), lambda plc, _: plc.endpoint.bad.clear()),
        says=(
            "Waits: ON ignored: the PLC marked its data for this drive object as bad (IOPS) from ",
            " to ",
            "OFF and ON: the PLC's program must set STW1.0",
        ),
        lacks=("80h",),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "a technician sets another node-ID while the drive is lost": Situation(
        begin=both(lambda _, daemon: switch_off(daemon, drive_of(daemon)), _wait(2), _change_node_id),
        says=(
            "Not on the bus: node 1 on bus can: silent",
            "also heard on this bus and not in the configuration: node 2",
            "compare the node-ID of the device with the configuration",
        ),
        cure=right_node_id,
    ),
    "another tool has set the greatest speed of the drive below the setpoint": Situation(
        begin=both(_limit_speed, _wait(2)),
        says=(
            "In operation: does not follow its setpoint since ",
            "limited by 607Fh (max profile velocity) = 100",
            "Raise this limit",
        ),
        lacks=("brake", "mechanics", "6072h"),
        health=Health.WARNING,
        cure=_raise_limit,
    ),
    "the brake of the motor is closed in operation": Situation(
        begin=both(_block, _wait(2)),
        says=(
            "In operation: does not follow its setpoint since ",
            "limits of the drive: 6072h (max torque) = 3000, 607Fh",
            "Check brake, torque limit and mechanics",
        ),
        health=Health.WARNING,
        cure=_release,
    ),
    "the CAN adapter receives frames, and its queue of frames to send is stuck": Situation(
        begin=both(_stop_sending(16), _wait(2)),
        says=("Not on the bus: bus can: the interface receives frames and sends none", "Unplug the CAN adapter"),
        lacks=("STO", "cable", "bus-off"),
        cure=_restart_interface,
    ),
    "the CAN adapter takes frames and sends none when ON comes": Situation(
        begin=both(words((OFF, {})), _stop_sending(1 << 30), words((OFF, {}), (ON, {})), _wait(2)),
        says=(
            "the drive follows no Controlword and answers no SDO request, but its frames arrive",
            "Unplug the CAN adapter",
        ),
        lacks=("STO", "cable"),
        health=Health.WARNING,
        cure=_restart_interface,
    ),
    "the drive rejects every RPDO with EMCY 8210h": Situation(
        operates=False,
        spoil=_reject_rpdos,
        begin=words((OFF, {}), (OFF, {}), (ON, {})),
        says=(
            "Waits: the drive does not process the gateway's RPDOs: EMCY 8210h PDO not processed",
            "Restart the node (P972",
        ),
        lacks=("STO", "enable input"),
        health=Health.WARNING,
        cure=_hear,
    ),
    "after a short circuit of the bus the heartbeat consumer of the drive stays in error": Situation(
        begin=both(_trip_consumer, words((OFF, {}), (OFF | 0x80, {}))),
        says=("Fault: the heartbeat consumer of the drive (1016h) stays in error (8130h)", "Restart the node (P972"),
        lacks=("bus-off", "short circuit"),
        cure=_restart_drive,
    ),
    "a second device with the node-ID of the drive was plugged in, and out again, while the PLC keeps ON": Situation(
        begin=_second_device,
        says=("Waits: ON ignored: two devices had node-ID 1", "Disconnect the other", "; then OFF and ON"),
        lacks=("plug, cable", "1029h", "EMCY", "boot-up"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the software of the drive's maker writes 1017h in operation": Situation(
        begin=_write_from_elsewhere,
        says=("Waits: ON ignored: node lost: another tool writes 1017h/0", "Disconnect the other tool", "OFF and ON"),
        lacks=("plug, cable",),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the machine of the gateway is paused for some seconds in operation": Situation(
        begin=_pause,
        says=(
            "Waits: ON ignored: ",
            "the gateway did not run for ",
            " s (machine paused",
            "Find what pauses or overloads the machine",
            "; then OFF and ON",
        ),
        lacks=("TPDO", "cable", "no valid frame"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the drive restarts, and then answers no SDO request": Situation(
        begin=_hang,
        says=(
            "Not on the bus: node 1 on bus can: node 1 restarted, and has answered no SDO request since",
            "Check supply and plug of the device, then switch it off and on",
        ),
        lacks=("node-ID", "bit rate"),
        cure=_recover,
    ),
    "drive and encoder were plugged at each other's place": Situation(
        tables=axis(1) + "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\n",
        begin=_swap_node_ids,
        says=("Not on the bus: node 1 is rejected: node 1 device type 1000h", "expected a drive (profile 402)"),
        lacks=("power", "cable"),
        cure=_swap_back,
    ),
    "telegram 111: both limit switches have lost their supply": Situation(
        tables=POSITIONER,
        begin=both(words((0x043F, MDI | {"MDI_TARPOS": -200_000}), (0x047F, {})), _cut_switches),
        says=(
            "Waits: task stopped at a limit of the drive (Statusword.11): 60FDh.0 = 60FDh.1 = 1",
            "Both limit switches are active: check their supply, plug and cable",
        ),
        lacks=("is free",),
        health=Health.WARNING,
        cure=_supply_switches,
    ),
}
"""What a technician finds, over both links."""
