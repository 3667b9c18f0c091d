"""The wire fails, is busy, or carries what is none of the gateway's: the axis stops, says why, and never starts by itself."""

from __future__ import annotations

import subprocess
import threading

import can
import pytest

from pdgw.ds301.bus.interfaces import open_bus
from pdgw.ds301.communication import EMCY
from pdgw.ds301.loop.readiness import EpollReadiness
from pdgw.ds301.pdo import PdoDirection
from tests.can import interfaces
from tests.can.interfaces import Wire
from tests.can.plant import INHIBITED, OFF, ON, OPERATION, Plant, axis_table, can_table
from tests.support.buses import PATIENCE_S

TPDO_1 = PdoDirection.TPDO.cob_id(1, 1)
FLOOD = 0x00A


def test_a_drive_turns_and_its_frames_are_read_by_the_socket_without_a_thread(line: Wire) -> None:
    plant = Plant(can_table(line.near), axis_table(1, line.near))
    plant.drive(line.far)

    def sequence() -> None:
        plant.turn()
        assert isinstance(plant.loop._readiness.system, EpollReadiness)  # type: ignore[attr-defined]
        assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("CAN")]
        plant.command(OFF)
        plant.until(lambda: plant.state() in {1, 3} and plant.plc.value("NIST_A") == 0, "standstill")

    plant.run_steps(sequence)


def test_link_down_stops_the_drive_and_link_up_does_not_start_it(line: Wire) -> None:
    plant = Plant(can_table(line.near), axis_table(1, line.near))
    drive = plant.drive(line.far)

    def sequence() -> None:
        plant.turn()
        plant.outside(lambda: interfaces.ip("set", line.near, "down"))
        plant.until(lambda: plant.plc.value("ZSW1") == -1, "IOPS BAD")
        plant.until(lambda: drive.model.velocity_actual == 0, "the drive stops by itself: no heartbeat")
        assert not plant.daemon.networks[line.near].healthy
        plant.outside(lambda: interfaces.up(line.near))
        plant.until(lambda: plant.state() == INHIBITED, "the drive is back, inhibited")
        plant.stays(
            lambda: plant.state() == INHIBITED and drive.model.velocity_actual == 0,
            "the ON that is still 1 starts nothing",
        )
        plant.turn()

    plant.run_steps(sequence)


def test_unplugged_adapter_is_used_again_after_plugging_it_in(line: Wire) -> None:
    plant = Plant(can_table(line.near), axis_table(1, line.near))
    drive = plant.drive(line.far)

    def sequence() -> None:
        plant.turn()
        plant.outside(line.unplug)
        plant.until(lambda: plant.plc.value("ZSW1") == -1, "IOPS BAD")
        plant.until(lambda: drive.model.velocity_actual == 0, "the drive stops by itself: no heartbeat")
        again = drive if plant.outside(line.plug) else plant.drive(line.far)
        plant.until(lambda: plant.state() == INHIBITED, "the drive is back, inhibited")
        plant.stays(
            lambda: plant.state() == INHIBITED and again.model.velocity_actual == 0,
            "the ON that is still 1 starts nothing",
        )
        plant.turn()

    plant.run_steps(sequence)


FOREIGN = {
    "remote frames": [can.Message(arbitration_id=TPDO_1, is_extended_id=False, is_remote_frame=True, dlc=4)],
    "extended frames": [
        can.Message(arbitration_id=identifier, is_extended_id=True, data=bytes(8))
        for identifier in (0, TPDO_1, 0x1FFF_FFFF)
    ],
    "extended remote frames": [can.Message(arbitration_id=TPDO_1, is_extended_id=True, is_remote_frame=True, dlc=8)],
    "short process data": [
        can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
        for identifier in (TPDO_1, EMCY + 1, 0x581, 0x701)
        for data in (b"", b"\x27")
    ],
    "long process data": [can.Message(arbitration_id=0x481, is_extended_id=False, data=bytes(8))],
    "frames of nobody": [can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b"\xff" * 8)],
}


def test_foreign_frames_do_not_disturb_a_turning_drive(virtual: str) -> None:
    # Not between the emulated controllers: QEMU's receive buffer is out of step after frames with another header.
    plant = Plant(can_table(virtual), axis_table(1, virtual))
    plant.drive(virtual)

    def sequence() -> None:
        with open_bus("socketcan", virtual) as unknown_sender:
            plant.turn()
            for what, messages in FOREIGN.items():
                for message in messages:
                    unknown_sender.send(message)
                plant.stays(plant.turns, what, 0.3)
        assert plant.counter(f"node 1 on {virtual}", "length_errors") == 2

    plant.run_steps(sequence)


def test_can_fd_frames_are_ignored_on_a_can_fd_interface(virtual: str) -> None:
    plant = Plant(can_table(virtual, "fd = true\n"), axis_table(1, virtual))
    plant.drive(virtual)

    def sequence() -> None:
        with open_bus("socketcan", virtual, fd=True) as unknown_sender:
            plant.turn()
            for size in (0, 8, 64):
                # Statusword 0 in what would be TPDO 1, NMT state Stopped in what would be a heartbeat.
                for identifier, byte in ((TPDO_1, 0), (0x701, 4)):
                    data = bytes((byte,)) * size
                    unknown_sender.send(
                        can.Message(arbitration_id=identifier, is_extended_id=False, is_fd=True, data=data)
                    )
            plant.stays(plant.turns, "turns on", 0.5)
        assert plant.counter(f"node 1 on {virtual}", "length_errors") == 0

    plant.run_steps(sequence)


def test_controller_errors_are_counted_and_bus_off_stops_until_off_and_on(virtual: str) -> None:
    plant = Plant(can_table(virtual), axis_table(1, virtual))
    drive = plant.drive(virtual)
    bus_off, restarted, controller = 0x40, 0x100, 0x04
    passive = bytes((0, 0x30, 0, 0, 0, 0, 0, 0))
    part = f"bus {virtual}"

    def sequence() -> None:
        with open_bus("socketcan", virtual) as kernel:

            def report(bits: int, data: bytes = bytes(8)) -> None:
                kernel.send(can.Message(arbitration_id=bits, is_error_frame=True, is_extended_id=False, data=data))

            plant.turn()
            report(controller, passive)
            plant.until(lambda: plant.counter(part, "error_passive") == 1, "error-passive")
            plant.stays(plant.turns, "turns on", 0.3)
            report(bus_off)
            plant.until(lambda: plant.counter(part, "bus_off") == 1, "bus-off")
            report(restarted)
            plant.until(lambda: plant.counter(part, "error_frames") == 3, "three messages")
            plant.until(lambda: drive.model.velocity_actual == 0, "standstill")
            plant.until(lambda: plant.daemon.networks[virtual].healthy, "a frame of the drive")
            plant.stays(lambda: plant.state() != OPERATION, "the ON that is still 1 starts nothing")
            plant.turn()

    plant.run_steps(sequence)


@pytest.mark.parametrize("length", ["0", "4"])
def test_flood_of_the_highest_priority_leaves_the_axis_controllable(line: Wire, length: str) -> None:
    plant = Plant(can_table(line.near), axis_table(1, line.near))
    drive = plant.drive(line.far)
    flood = ["cangen", line.far, "-g", "1", "-n", "3000", "-I", f"{FLOOD:03X}", "-L", length, "-p", "100"]
    heard: list[int] = []
    plant.daemon.networks[line.near].listeners.append(lambda frame: heard.append(frame.arbitration_id))

    def sequence() -> None:
        plant.turn()
        plant.outside(lambda: subprocess.run(flood, check=True, timeout=PATIENCE_S))
        # How much of it: where the machine is too slow, the kernel or the controller has no room for the rest.
        plant.until(lambda: FLOOD in heard, "the flood is read")
        if plant.state() != OPERATION:  # a machine that was too slow for it: stopped, and it stays so
            plant.stays(lambda: plant.state() != OPERATION, "the ON that is still 1 starts nothing")
            plant.turn()
        plant.command(OFF)
        plant.until(lambda: drive.model.velocity_actual == 0, "standstill")

    plant.run_steps(sequence)


def test_full_queue_of_the_interface_is_reported_and_stops_the_drive(line: Wire) -> None:
    interfaces.ip("set", line.near, "txqueuelen", "2")
    plant = Plant(can_table(line.near), axis_table(1, line.near))
    drive = plant.drive(line.far)
    stuck = ["tc", "qdisc", "replace", "dev", line.near, "root", "netem", "delay", "200s", "limit", "1"]
    free = ["tc", "qdisc", "del", "dev", line.near, "root"]

    def sequence() -> None:
        plant.turn()
        plant.outside(lambda: subprocess.run(stuck, check=True, timeout=PATIENCE_S))
        plant.until(lambda: plant.counter("bus can0", "waits"), "frames are not taken")
        plant.until(lambda: plant.daemon.networks[line.near].health.failures, "the bus failed")
        plant.until(lambda: drive.model.velocity_actual == 0, "the drive stops by itself: no heartbeat")
        plant.outside(lambda: subprocess.run(free, check=True, timeout=PATIENCE_S))
        plant.until(lambda: plant.plc.value("ZSW1") != -1, "the drive is back")
        plant.stays(
            lambda: plant.state() != OPERATION and drive.model.velocity_actual == 0,
            "the ON that is still 1 starts nothing",
        )
        plant.turn()

    plant.run_steps(sequence)


def test_two_nodes_with_one_number_never_turn_unsupervised(line: Wire) -> None:
    plant = Plant(can_table(line.near), axis_table(1, line.near))
    drive = plant.drive(line.far)

    def sequence() -> None:
        plant.turn()
        twin = plant.drive(line.far)
        plant.until(lambda: plant.state() != OPERATION, "the boot-up of a node that turns is no restart one may trust")
        plant.until(lambda: drive.model.velocity_actual == 0, "standstill")
        plant.stays(
            lambda: drive.model.velocity_actual == 0 == twin.model.velocity_actual,
            "the ON that is still 1 starts nothing",
        )
        twin.stop()
        plant.until(lambda: plant.state() == INHIBITED, "one of them again")
        plant.turn()

    plant.run_steps(sequence)


def test_a_controller_with_automatic_restart_is_used_like_any_other(line: Wire) -> None:
    if not interfaces.is_controller(line.near):
        pytest.skip("restart-ms is of controllers, there is none")
    interfaces.ip("set", line.near, "down")
    interfaces.up(line.near, bitrate=500_000, more=("restart-ms", "100"))
    plant = Plant(can_table(line.near), axis_table(1, line.near))
    plant.drive(line.far)
    plant.run_steps(plant.turn)


def test_axes_on_several_buses_turn_and_the_loss_of_one_bus_stops_its_axis_alone(line: Wire, virtual: str) -> None:
    plant = Plant(can_table(line.near), can_table(virtual), axis_table(1, line.near), axis_table(2, virtual))
    plant.drive(line.far, 1)
    other = plant.drive(virtual, 2)

    def sequence() -> None:
        for axis in (0, 1):
            plant.turn(axis)
        plant.outside(lambda: interfaces.ip("set", line.near, "down"))
        plant.until(lambda: plant.plc.value("ZSW1") == -1, "IOPS BAD of the axis whose bus is down")
        plant.stays(lambda: plant.turns(1), "the other one turns on")
        plant.command(ON, 0, 1)
        plant.until(lambda: other.model.velocity_actual == 0, "and obeys")

    plant.run_steps(sequence)
