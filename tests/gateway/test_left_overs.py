"""What another master has left in the drive does not act: offsets are 0 before ON, bits against the telegram refuse the axis."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from pdgw.base.durations import SECOND
from pdgw.ds301.communication import SDO_REQUEST
from pdgw.ds301.objects import Access, CanType, Entry
from pdgw.dsp402.states import State, state_of
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.configuration.defaults import SIMULATED_KEYS
from pdgw.gateway.configuration.toml_file import toml_text
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import SimulatedDriveNode, shape
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import Values
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber
from pdgw.tools.output.status_text import object_lines
from tests.support.gateways.daemon import (
    OFF,
    SIMULATED_POSITIONER,
    Plc,
    axis,
    client,
    configuration,
    drive_of,
    exchanging,
    record_server,
    running,
    until,
    world_of,
)
from tests.support.gateways.parameters import write

BY_SPEED = 'simulate = true\nfollowing_window = 4096\ndsc = "speed"'
BY_POSITION = 'simulate = true\nfollowing_window = 4096\ndsc = "position"'
MODULO = "simulate = true\n[axis.positioner]\n" + toml_text(
    {key: value for key, value in SIMULATED_KEYS.items() if key != "software_limits"} | {"modulo_range": 4096}
)
POSITION_OFFSET, VELOCITY_OFFSET, TORQUE_OFFSET = (0x60B0, 0), (0x60B1, 0), (0x60B2, 0)
END_VELOCITY, HALT, OPTION = (0x6082, 0), (0x605D, 0), (0x60F2, 0)
TYPES = {
    POSITION_OFFSET: CanType.I32,
    VELOCITY_OFFSET: CanType.I32,
    TORQUE_OFFSET: CanType.I16,
    END_VELOCITY: CanType.U32,
    HALT: CanType.I16,
    OPTION: CanType.U16,
}
OFF2 = 0x047C


def leave(node: SimulatedDriveNode, address: tuple[int, int], value: int, access: Access = Access.RW) -> None:
    """The drive has this value of the object, from another master."""
    node.entries = {**node.entries, address: Entry(*address, "left over", TYPES[address], access)}
    node.values[address] = value


@contextmanager
def gateway(
    telegram: int, keys: str, address: tuple[int, int], value: int, access: Access = Access.RW
) -> Iterator[tuple[Daemon, SimulatedDriveNode]]:
    """A gateway that has configured a drive with this value; ``keys``: of its axis, empty for a drive with mode 9 alone."""
    nodes = []

    def before(daemon: Daemon) -> None:
        drive = drive_of(daemon) if keys else world_of(daemon).drive("world", 1, shape=shape("csv"))
        nodes.append(drive.node)
        leave(drive.node, address, value, access)

    with running(configuration(axis(1, telegram_number=telegram, more=keys)), before) as daemon:
        until(daemon, lambda: daemon.axes[0].drive.generation, "online")
        world_of(daemon).loop.run_for(SECOND // 10)
        yield daemon, nodes[0]


def refusal(daemon: Daemon) -> str:
    """The text of fault 104; empty without one."""
    return next((item.text for item in daemon.axes[0].faults if item.number == FaultNumber.REFERENCE), "")


@pytest.mark.parametrize(
    ("telegram", "keys", "address"),
    [
        *((number, BY_SPEED, VELOCITY_OFFSET) for number in (5, 6, 105, 106)),
        *((number, BY_POSITION, POSITION_OFFSET) for number in (5, 6, 105, 106)),
        *((number, "", VELOCITY_OFFSET) for number in (1, 2, 3, 4, 20)),
        *((number, SIMULATED_POSITIONER, END_VELOCITY) for number in (7, 110, 111)),
        (9, "simulate = true", END_VELOCITY),
    ],
)
@pytest.mark.parametrize("value", [200, 1])
def test_offset_of_the_mode_is_0_before_on(telegram: int, keys: str, address: tuple[int, int], value: int) -> None:
    with gateway(telegram, keys, address, value) as (daemon, node):
        assert not refusal(daemon)
        assert node.values[address] == 0


@pytest.mark.parametrize(
    ("telegram", "keys", "address"),
    [
        (105, BY_SPEED, POSITION_OFFSET),
        (105, BY_SPEED, TORQUE_OFFSET),
        (1, "simulate = true", VELOCITY_OFFSET),
        (100, "simulate = true", VELOCITY_OFFSET),
        (100, "simulate = true", END_VELOCITY),
    ],
)
def test_offset_is_left_where_the_mode_does_not_add_it_or_the_plc_chooses_the_mode(
    telegram: int, keys: str, address: tuple[int, int]
) -> None:
    with gateway(telegram, keys, address, 200) as (daemon, node):
        assert not refusal(daemon)
        assert node.values[address] == 200


def test_nothing_is_written_that_is_right_already() -> None:
    written: list[int] = []
    config = configuration(axis(1, telegram_number=105, more=BY_SPEED))

    def before(daemon: Daemon) -> None:
        leave(drive_of(daemon).node, VELOCITY_OFFSET, 0)
        world_of(daemon).bus("world").taps.append(
            lambda _now, _member, can_id, data: (
                written.append(int.from_bytes(data[1:3], "little"))
                if can_id == SDO_REQUEST + 1 and data[0] >> 5 == 1
                else None
            )
        )

    with running(config, before) as daemon:
        until(daemon, lambda: daemon.axes[0].good, "online")
    assert 0x6060 in written
    assert 0x60B1 not in written


@pytest.mark.parametrize(
    ("telegram", "keys"),
    [
        (9, "simulate = true"),
        *((number, SIMULATED_POSITIONER) for number in (7, 110, 111)),
        (100, 'simulate = true\non_plc_loss = "ramp"'),
    ],
)
def test_halt_that_would_switch_the_drive_off_refuses_the_axis_with_the_remedy(telegram: int, keys: str) -> None:
    with gateway(telegram, keys, HALT, 0) as (daemon, _):
        assert "605Dh: 0 is not allowed, expected 1 (pdgw param write 605Dh 1): with 0 each Halt" in refusal(daemon)
        assert not daemon.axes[0].machine.usable
        parameters = client(daemon, record_server(daemon).address, 1)
        assert not write(parameters, HALT[0], Values(DataType.INTEGER16, (1,))).failed
        until(daemon, lambda: daemon.axes[0].machine.usable, "usable after the remedy")


@pytest.mark.parametrize(
    ("telegram", "keys"), [(1, "simulate = true"), (3, "simulate = true"), (105, BY_SPEED), (100, "simulate = true")]
)
def test_halt_code_0_is_accepted_by_a_telegram_without_halt(telegram: int, keys: str) -> None:
    with gateway(telegram, keys, HALT, 0) as (daemon, node):
        assert daemon.axes[0].machine.usable
        assert node.values[HALT] == 0


@pytest.mark.parametrize("bits", [0x40, 0x80, 0xC0])
@pytest.mark.parametrize(("telegram", "keys"), [(9, "simulate = true"), (111, SIMULATED_POSITIONER)])
def test_direction_bits_refuse_an_axis_without_modulo_range(telegram: int, keys: str, bits: int) -> None:
    with gateway(telegram, keys, OPTION, bits) as (daemon, node):
        assert f"60F2h: {bits | 1} is not allowed, expected 1 (pdgw param write 60F2h 1)" in refusal(daemon)
        assert node.values[OPTION] == bits | 1
        parameters = client(daemon, record_server(daemon).address, 1)
        assert not write(parameters, OPTION[0], Values(DataType.UNSIGNED16, (1,))).failed
        until(daemon, lambda: daemon.axes[0].machine.usable, "usable after the remedy")


@pytest.mark.parametrize("bits", [0x40, 0x80, 0xC0])
def test_direction_bits_of_a_modulo_axis_are_cleared_and_the_others_stay(bits: int) -> None:
    with gateway(111, MODULO, OPTION, bits | 0x12) as (daemon, node):
        assert not refusal(daemon)
        assert node.values[OPTION] == 0x11


def test_direction_bits_that_the_drive_keeps_refuse_a_modulo_axis() -> None:
    with gateway(111, MODULO, OPTION, 0x41, Access.RO) as (daemon, _):
        assert "60F2h = 65: bits 6 and 7 change the direction" in refusal(daemon)


def test_offset_that_the_drive_keeps_refuses_the_axis() -> None:
    with gateway(105, BY_SPEED, VELOCITY_OFFSET, 200, Access.RO) as (daemon, _):
        assert "60B1h = 200: the drive adds it to Target Velocity; " in refusal(daemon)
        assert not daemon.axes[0].machine.usable


def test_an_offset_is_not_written_by_a_parameter_client_nor_by_another_tool() -> None:
    with gateway(105, BY_SPEED, VELOCITY_OFFSET, 0) as (daemon, node):
        parameters = client(daemon, record_server(daemon).address, 1)
        answer = write(parameters, VELOCITY_OFFSET[0], Values(DataType.INTEGER32, (200,)))
        assert answer.failed
        assert answer.values[0] == ParameterErrorNumber.NO_OPERATION_PRIORITY
        other = world_of(daemon).bus("world").join("another tool")
        other.send(SDO_REQUEST + 1, bytes((0x23, 0xB1, 0x60, 0, 200, 0, 0, 0)))
        until(daemon, lambda: daemon.axes[0].drive.generation == 2, "configured again")
        assert node.values[VELOCITY_OFFSET] == 0


@pytest.mark.parametrize("stays", [False, True], ids=["off after a quick stop", "stays in Quick Stop Active"])
def test_offset_of_a_drive_with_power_is_0_after_its_stop_and_before_on(stays: bool) -> None:
    """It is written without power only: a drive that stays in Quick Stop Active is refused until OFF2."""
    with gateway(105, BY_SPEED, VELOCITY_OFFSET, 0) as (daemon, node):
        item = daemon.axes[0]
        if stays:
            node.start_fault("quick-stop-stays", value=6)
        plc = Plc(daemon, [105])
        plc.enable()
        written: list[State | None] = []
        world_of(daemon).bus("world").taps.append(
            lambda _now, _member, can_id, data: (
                written.append(state_of(node.model.statusword))
                if can_id == SDO_REQUEST + 1 and data[:3] == bytes((0x23, 0xB1, 0x60)) and not any(data[4:])
                else None
            )
        )
        other = world_of(daemon).bus("world").join("another tool")
        with exchanging(plc):
            other.send(SDO_REQUEST + 1, bytes((0x23, 0xB1, 0x60, 0, 200, 0, 0, 0)))
            until(daemon, lambda: item.drive.generation == 2, "configured again")
            if stays:
                world_of(daemon).loop.run_for(2 * SECOND)
                assert node.values[VELOCITY_OFFSET] == 200
                assert "60B1h = 200: the drive adds it to Target Velocity; it is set to 0 when" in refusal(daemon)
                plc.endpoint.set(0, {"STW1": OFF2})
            until(daemon, lambda: item.machine.usable and not node.values[VELOCITY_OFFSET], "corrected")
        assert written
        assert set(written) <= {State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON}
        plc.endpoint.set(0, {"STW1": OFF | 0x80})
        plc.exchange(5)
        plc.enable()


def test_status_shows_what_is_left_to_the_drive() -> None:
    with gateway(1, "", TORQUE_OFFSET, -50) as (daemon, node):
        assert node.values[TORQUE_OFFSET] == -50
        lines = list(object_lines(snapshot(daemon), 1, 200))
    assert any("offsets of the drive: Torque offset 60B2h = -50" in line for line in lines)
    (limits,) = (line for line in lines if line.strip().startswith("limits of the drive"))
    assert "Max Torque 6072h = 3000" in limits
