"""Situations in which the axis shows a latch or the gateway's own reaction, and the line names what began the stop."""

from __future__ import annotations

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.communication import DEFAULT_GATEWAY_NODE_ID, EMCY, ERROR_CONTROL, NMT, NmtCommand, NmtState
from pdgw.dsp402.states import STATUS_OF, State, StatusBit
from pdgw.gateway.base.reasons import Enable
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.drive.model.model import DriveModel
from pdgw.tools.output.status_text import Health
from tests.support.documents.situations import (
    BREAKERS,
    FAULTY,
    Situation,
    Step,
    acknowledge,
    both,
    good,
    online,
    run_out,
    supply,
    trip,
    words,
)
from tests.support.gateways.daemon import OFF, ON, Plc, drive_of, switch_off, world_of

OFF3 = ON & ~0x4
_TURN = words((ON, {"NSOLL_A": 0x1000}))
_AGAIN = words((OFF, {}), (ON, {}))


def start(name: str, **values: object) -> Step:
    """The drive begins to misbehave."""
    return lambda _, daemon: drive_of(daemon).node.start_fault(name, **values) and None


def lose(plc: Plc, daemon: Daemon, times: int = 1) -> None:
    """The drive is off the bus for a moment."""
    for _ in range(times):
        drive_of(daemon).node.start_fault("bus-off", recovery_ms=1000)
        miss(plc, daemon)
        find(plc, daemon)


def enable_itself(plc: Plc, daemon: Daemon) -> None:
    """The drive shows operation for a moment, while the PLC sends OFF."""

    def shows(model: DriveModel, _: int) -> None:
        model.statusword = STATUS_OF[State.OPERATION_ENABLED] | StatusBit.REMOTE | StatusBit.VOLTAGE_ENABLED

    plc.endpoint.set(0, {"STW1": OFF})
    run_out(plc)
    drive_of(daemon).model.disguises.append(shows)
    run_out(plc, 100 * MS)
    drive_of(daemon).model.disguises.clear()


def set_local(plc: Plc, daemon: Daemon) -> None:
    """Somebody switches the drive to local mode while it is off."""

    def shows(model: DriveModel, _: int) -> None:
        if model.state not in FAULTY:
            model.statusword = STATUS_OF[State.READY_TO_SWITCH_ON] | StatusBit.VOLTAGE_ENABLED

    plc.endpoint.set(0, {"STW1": OFF})
    run_out(plc)
    drive_of(daemon).model.disguises.append(shows)


def show_local(_: Plc, daemon: Daemon) -> None:
    """Statusword.9 falls while the drive follows the PLC."""

    def shows(model: DriveModel, _: int) -> None:
        model.statusword &= ~StatusBit.REMOTE

    drive_of(daemon).model.disguises.append(shows)


def open_sto(plc: Plc, daemon: Daemon) -> None:
    """The drive stays in Switch On Disabled during OFF, with its supply."""

    def shows(model: DriveModel, _: int) -> None:
        model.statusword = STATUS_OF[State.SWITCH_ON_DISABLED] | StatusBit.REMOTE | StatusBit.VOLTAGE_ENABLED

    plc.endpoint.set(0, {"STW1": OFF})
    run_out(plc)
    drive_of(daemon).model.disguises.append(shows)
    run_out(plc)


def wait_in_ready(plc: Plc, daemon: Daemon) -> None:
    """The drive stays in Ready To Switch On without supply, longer than an ON waits."""

    def shows(model: DriveModel, _: int) -> None:
        model.statusword = STATUS_OF[State.READY_TO_SWITCH_ON] | StatusBit.REMOTE

    plc.endpoint.set(0, {"STW1": OFF})
    run_out(plc)
    drive_of(daemon).model.disguises.append(shows)
    plc.endpoint.set(0, {"STW1": ON})
    run_out(plc, daemon.axes[0].config.enter_ms * MS + SECOND)  # a controller's ON comes some cycles later


def set_local_switched_on(plc: Plc, daemon: Daemon) -> None:
    """Somebody switches the drive to local mode while it is Switched On, and the PLC enables operation."""

    def shows(model: DriveModel, _: int) -> None:
        model.statusword = STATUS_OF[State.SWITCHED_ON] | StatusBit.VOLTAGE_ENABLED

    plc.endpoint.set(0, {"STW1": ON & ~0x8})
    run_out(plc)
    drive_of(daemon).model.disguises.append(shows)
    run_out(plc)
    plc.endpoint.set(0, {"STW1": ON})


def leave_operational(_: Plc, daemon: Daemon) -> None:
    """The node sends an EMCY and is Pre-operational."""
    node = drive_of(daemon).node
    node.transmit(EMCY + 1, b"\x01\xff\0\0\0\0\0\0")
    node.state = NmtState.PRE_OPERATIONAL
    node.on_nmt(node.state)


def command(command: NmtCommand) -> Step:
    """Another master on the bus sends an NMT command."""
    return lambda _, daemon: world_of(daemon).bus("world").join("another master").send(NMT, bytes((command, 1)))


def boot_same_node_id(_: Plc, daemon: Daemon) -> None:
    """A device boots whose heartbeat the drive monitors: that of the gateway."""
    world_of(daemon).bus("world").join("a new device").send(ERROR_CONTROL + DEFAULT_GATEWAY_NODE_ID, b"\0")
    drive_of(daemon).do(lambda node: node.on_consumer_expired(DEFAULT_GATEWAY_NODE_ID))


def time_passes(plc: Plc, _: Daemon) -> None:
    """Until what follows from the step before has happened."""
    run_out(plc)


def be_silent(plc: Plc, _: Daemon) -> None:
    """The PLC is lost."""
    plc.silent = True
    run_out(plc)


def speak(plc: Plc, _: Daemon) -> None:
    """The PLC sends again what it sent before."""
    plc.silent = False


def restart(plc: Plc, daemon: Daemon) -> None:
    """P972."""
    daemon.objects[0].reset_node()
    miss(plc, daemon)


def miss(plc: Plc, daemon: Daemon) -> None:
    """The drive is no longer on the bus."""
    plc.until(lambda: not daemon.axes[0].good, "lost")


def find(plc: Plc, daemon: Daemon) -> None:
    """The drive is on the bus again."""
    plc.until(lambda: daemon.axes[0].good, "found again")


def power_off(_: Plc, daemon: Daemon) -> None:
    """The drive has no power."""
    switch_off(daemon, drive_of(daemon))


def power_on(_: Plc, daemon: Daemon) -> None:
    """The drive has power."""
    drive_of(daemon).node.restart()


def plug(_: Plc, daemon: Daemon) -> None:
    """The CAN interface is in its computer again."""
    world_of(daemon).unplug("world", False)


def set_run(run: bool) -> Step:
    """Somebody turns the switch of the PLC."""
    return lambda plc, _: setattr(plc.endpoint, "run", run)


def end_faults(_: Plc, daemon: Daemon) -> None:
    """The device is repaired."""
    drive_of(daemon).node.end_fault()
    drive_of(daemon).model.disguises.clear()


ORIGIN_SITUATIONS: dict[str, Situation] = {
    "the drive ignores OFF3, and the gateway stops its node": Situation(
        begin=both(_TURN, start("deaf"), words((OFF3, {}))),
        says=(
            "Fault: drive does not stop: ",
            " rpm after ",
            "the gateway has stopped the node (NMT)",
            "brake resistor",
        ),
        lacks=("Check power", "keeps the drive off", "Not on the bus"),
        cure=both(end_faults, find, acknowledge),
    ),
    "STW1.5 = 0 freezes the ramp of a turning axis": Situation(
        begin=both(_TURN, words((ON & ~0x20, {"NSOLL_A": 0}))),
        says=("In operation: ramp frozen (STW1.5 = 0): holds 750 rpm, setpoint 0 rpm not followed", "must set STW1.5"),
        lacks=("Waits", "STW1.4", "STW1.6"),
        health=Health.WARNING,
        cure=words((ON, {})),
    ),
    "the drive enables itself during OFF": Situation(
        begin=enable_itself,
        says=(
            "Off: not acknowledged: drive acts without a command: entered operation, since ",
            "Switch off what enables",
        ),
        lacks=("No error",),
        health=Health.WARNING,
        cure=acknowledge,
    ),
    "a loose plug: the drive is lost three times while the PLC keeps ON": Situation(
        begin=lambda plc, daemon: lose(plc, daemon, 3),
        says=("Waits: ON ignored: node lost: silent", "(3 times)", "Check plug, cable and supply", "; then OFF and ON"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the light curtain opens STO while the PLC keeps ON": Situation(
        begin=both(start("enable-input-dropped"), time_passes, end_faults),
        says=(
            "Waits: ON ignored",
            "without a command: left operation, shows ",
            "Check safe torque off (STO), enable input and supply",
            "; then OFF and ON",
        ),
        lacks=("send an OFF first",),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the gateway starts while the PLC keeps ON": Situation(
        operates=False,
        begin=lambda plc, _: plc.endpoint.set(0, {"STW1": ON}),
        says=("Waits: ON ignored: the gateway has started", "set STW1.0 to 0 and then to 1"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the PLC takes its OFF3 back": Situation(
        begin=both(words((OFF3, {})), words((ON, {}))),
        says=("Waits: ON ignored: the PLC has sent OFF3 (STW1.2 = 0), since ",),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "another master sets the drive to Pre-operational": Situation(
        begin=both(command(NmtCommand.ENTER_PRE_OPERATIONAL), find),
        says=("Waits: ON ignored: node lost", "another master has sent NMT command 80h", "Switch the other master off"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the drive leaves Operational by itself after an EMCY": Situation(
        begin=both(leave_operational, find),
        says=("node lost", "left Operational by itself after EMCY FF01h"),
        lacks=("Check power", "no EMCY"),
        health=Health.WARNING,
        cure=both(online, acknowledge),
    ),
    "the drive is in local mode": Situation(
        begin=both(set_local, words((ON, {}))),
        says=(
            "Waits: the drive takes no commands from the bus: Statusword.9 = 0 (local mode)",
            "switch the drive to remote",
            "then OFF and ON",
        ),
        lacks=("safe torque off",),
        health=Health.WARNING,
        cure=both(end_faults, good),
    ),
    "the drive is in local mode in Switched On": Situation(
        begin=set_local_switched_on,
        says=(
            "Waits: the drive takes no commands from the bus: Statusword.9 = 0 (local mode)",
            "switch the drive to remote",
            "then OFF and ON",
        ),
        health=Health.WARNING,
        cure=both(end_faults, _AGAIN, good),
    ),
    "the drive was in local mode in Switched On while the PLC keeps ON": Situation(
        begin=both(set_local_switched_on, time_passes, end_faults),
        says=("Waits: ON ignored: ON came while the drive was in local mode (Statusword.9 = 0)", "OFF and ON"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the main contactor stays open while the PLC keeps ON": Situation(
        begin=wait_in_ready,
        says=("Waits: the drive reports no supply voltage (Statusword.4 = 0)", "main contactor", "; then OFF and ON"),
        health=Health.WARNING,
        cure=both(end_faults, _AGAIN),
    ),
    "the main contactor closes too late after ON": Situation(
        begin=both(wait_in_ready, end_faults),
        says=(
            "Waits: ON ignored: the drive did not leave Ready to Switch On for 10 s (enter_ms) after ON: "
            "no supply voltage (Statusword.4 = 0), since ",
            "main contactor",
            "; then OFF and ON",
        ),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "an enable of the drive is missing for longer than ON waits": Situation(
        begin=both(BREAKERS[Enable.OPERATION], lambda plc, daemon: run_out(plc, daemon.axes[0].config.enter_ms * MS)),
        says=(
            "Waits: ON ignored: the drive did not leave Ready to Switch On for 10 s (enter_ms) after ON: "
            "main contactor, DC link or enable input, since ",
            "close STO and the enable input",
            "; then OFF and ON",
        ),
        lacks=("OFF and ON; then",),
        health=Health.WARNING,
        cure=both(end_faults, _AGAIN),
    ),
    "safe torque off is open when ON comes": Situation(
        begin=both(open_sto, words((ON, {}))),
        says=(
            "Waits: the drive did not leave Switch On Disabled after ON: safe torque off (STO), enable input or supply",
            "close STO and the enable input",
            "then OFF and ON",
        ),
        lacks=("ON ignored",),
        health=Health.WARNING,
        cure=both(end_faults, _AGAIN),
    ),
    "the drive is remote again while the PLC keeps ON": Situation(
        begin=both(set_local, words((ON, {})), end_faults),
        says=("Waits: ON ignored: ON came while the drive was in local mode (Statusword.9 = 0)", "OFF and ON"),
        lacks=("safe torque off", "switch the drive"),
        health=Health.WARNING,
        cure=good,
    ),
    "Statusword.9 falls in operation, and returns": Situation(
        begin=show_local,
        says=(
            "Waits: the drive takes no commands from the bus: Statusword.9 = 0 (local mode)",
            "switch the drive to remote",
        ),
        lacks=("OFF and ON", "safe torque off"),
        health=Health.WARNING,
        cure=end_faults,
    ),
    "STW1.6 = 0 stops a turning axis": Situation(
        begin=both(_TURN, words((ON & ~0x40, {}))),
        says=("Waits: no setpoint: STW1.6 = 0 (the setpoint is 0)", "must set STW1.6 = 1"),
        lacks=("STW1.4", "STW1.5", "frozen"),
        health=Health.WARNING,
        cure=words((ON, {})),
    ),
    "the drive restarts in operation": Situation(
        begin=both(_TURN, start("reboot"), miss, find),
        says=(
            "Waits: ON ignored: node restarted during operation: boot-up message, since ",
            "Check plug, cable and supply",
        ),
        lacks=("silent", "send an OFF first"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "a device with the node-ID of the gateway boots, and the heartbeat consumer of the drive reacts": Situation(
        begin=both(_TURN, boot_same_node_id, time_passes),
        says=(
            "Waits: ON ignored: drive acts without a command: left operation",
            "follows the boot-up at ",
            "of a device with the node-ID of the gateway, 127",
            "give the device another node-ID, or set another [can] node_id",
        ),
        lacks=("safe torque off",),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "another master stops the node of the drive": Situation(
        begin=both(command(NmtCommand.STOP), miss, find),
        says=(
            "Waits: ON ignored: node lost: Stopped: another master has sent NMT command 02h",
            "Switch the other master off",
        ),
        lacks=("Check power", "the gateway has stopped"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "all PDOs of the drive end in operation, and its heartbeats arrive": Situation(
        begin=both(start("lost-pdos", every=1), time_passes),
        says=(
            "Not on the bus: node 1 is rejected",
            "none of TPDO1, TPDO2",
            "Check the TPDOs of the device, and who writes its communication objects",
        ),
        lacks=("sync",),
        cure=both(end_faults, online),
    ),
    "P972 restarts the drive, and the PLC sends ON before it is back": Situation(
        begin=both(words((OFF, {})), restart, words((ON, {})), find),
        says=(
            "Waits: ON ignored: a parameter request has restarted the node (P970, P972), since ",
            "set STW1.0 to 0 and then to 1",
        ),
        lacks=("node lost", "supply"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "another master resets the node of the drive": Situation(
        begin=both(command(NmtCommand.RESET_NODE), miss, find),
        says=(
            "Waits: ON ignored: node restarted during operation: another master has sent NMT command 81h",
            "Switch the other master off",
        ),
        lacks=("boot-up", "supply"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the CAN adapter is unplugged, then the PLC is silent; both return": Situation(
        begin=both(BREAKERS[Enable.BUS], time_passes, be_silent, plug, find, speak),
        says=(
            "Waits: ON ignored: CAN bus lost: bus can: its interface is lost",
            "check the CAN interface, its plug and its driver",
            "; then OFF and ON",
        ),
        lacks=("PLC lost", "node lost"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "a loose plug: the drive is lost for a second, then the PLC": Situation(
        begin=both(lose, be_silent, speak),
        says=("Waits: ON ignored: node lost: silent", "Check plug, cable and supply", "; then OFF and ON"),
        lacks=("PLC lost", "times)"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the light curtain opens STO, then the PLC is lost for a moment": Situation(
        begin=both(start("enable-input-dropped"), time_passes, end_faults, be_silent, speak),
        says=("Waits: ON ignored: drive acts without a command: left operation", "Check safe torque off (STO)"),
        lacks=("PLC lost",),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the supply of the power stage is cut, then the PLC is silent": Situation(
        begin=both(BREAKERS[Enable.SUPPLY], time_passes, be_silent),
        says=("Waits: the drive reports no supply voltage (Statusword.4 = 0)", "main contactor, emergency stop"),
        lacks=("PLC lost", "STW1"),
        cure=both(supply, good),
    ),
    "the PLC is lost, then the drive restarts": Situation(
        begin=both(be_silent, start("reboot"), time_passes, find, speak),
        says=("Waits: ON ignored: PLC lost: no valid frame", "Check the cable", "; then OFF and ON"),
        lacks=("restarted", "boot-up"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the drive has a fault, and is switched off and on": Situation(
        begin=both(trip, power_off, time_passes, power_on, find),
        says=("Waits: ON ignored: EMCY 2310h over-current, since ", "short circuit", "; then OFF and ON"),
        lacks=("node lost", "restarted"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the PLC is in STOP for a moment": Situation(
        begin=both(set_run(False), time_passes, set_run(True)),
        says=("Waits: ON ignored: the PLC was in STOP from ", " to ", "OFF and ON: the PLC's program must set STW1.0"),
        lacks=("check the cable", "PLC lost", "is in STOP", "set the PLC to RUN"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
    "the PLC's program takes its control away for a moment": Situation(
        begin=words((ON & ~0x400, {}), (ON, {})),
        says=(
            "Waits: ON ignored: control by PLC removed in operation, since ",
            "must set STW1.10 = 1; then OFF and ON",
        ),
        lacks=("STW1.10 = 0",),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
}
"""What a technician finds after the first event has passed, over both links."""
