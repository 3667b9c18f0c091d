"""What an axis keeps over a change of its telegram, and what it takes over from writes to its drive."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.ds301.node.node import NodeNotice, Notice
from pdgw.dsp402.drive.client import DriveStatus
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.objects.axis import Axis
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import ParameterAddress, Values
from pdgw.profidrive.signals import signal
from tests.gateway.objects.test_encoders import G1, encoder
from tests.support import buses
from tests.support.documents.profile_numbers import decode_sensor_format
from tests.support.gateways.daemon import OFF, Plc, axis, configuration, exchanging, serving, until

HOME_SET = signal("ZSW1").bit("HOME_POSITION_SET", positioning=True).mask


@contextmanager
def made(number: int, **config: object) -> Iterator[Axis]:
    network = buses.network(VirtualLoop(), buses.bus(buses.channel()))
    yield Axis(AxisConfig(do_id=7, node_id=3, telegram=number, **config), network, 4)  # type: ignore[arg-type]
    network.close()


def tolerated(item: Axis) -> int:
    assert item.machine.life is not None
    return item.machine.life.counters.tolerated


def test_the_tolerance_of_the_sign_of_life_is_in_force_at_once_and_with_the_next_telegram() -> None:
    with made(2) as item:
        item.set_sign_of_life_tolerance(7)
        assert tolerated(item) == 7
        item.change_telegram(3)
        assert tolerated(item) == 7


def test_what_the_plc_sent_last_stays_after_its_loss() -> None:
    with made(1) as item:
        item.step((OFF, 5), 1)
        item.step(None, 2)
        assert item.last_setpoints == (OFF, 5)


def test_a_reported_refusal_is_not_repeated_because_the_telegram_changed() -> None:
    def refused(item: Axis) -> None:
        item.drive.status = DriveStatus.REFUSED
        item.on_node_event(NodeNotice(Notice.REFUSED, "wrong vendor", 1))
        item.step(None, 1)

    with made(1) as item:
        refused(item)
        item.change_telegram(2)
        refused(item)
        assert [fault.number for fault in item.faults] == [FaultNumber.NODE_REFUSED]


def test_a_drive_that_never_was_online_owns_what_guards_and_commands_it() -> None:
    with made(1) as item:
        guards = {(0x1016, 1), (0x1017, 0), (0x6007, 0), (0x100C, 0), (0x100D, 0), (0x6040, 0), (0x6060, 0)}
        assert {(index, sub) for index, _ in guards for sub in range(3) if item.owns(index, sub)} == guards
        assert not item.owns(0x607A, 0)
        assert item.is_reference(0x6098, 0)
        assert not item.is_reference(0x6081, 0)


def test_an_encoder_that_is_g1_stays_g1_with_another_telegram() -> None:
    objects = axis(1, telegram_number=3, more="simulate = true\ng1 = 2") + encoder(2, 81, more='motion = "still=0.75"')
    with serving(configuration(objects)) as (daemon, _):
        daemon.change_telegram(daemon.axes[0], 102)
        plc = Plc(daemon, [102, 81])
        plc.endpoint.set(0, {"STW1": OFF, "G1_STW": G1["REQUEST_ABSOLUTE"]})
        plc.until(lambda: plc.value("G1_XIST2") == 3072, "the encoder's position")


@pytest.mark.parametrize(("more", "turns"), [("", [0]), ("g1 = 2", [4096])], ids=["drive", "encoder"])
def test_p979_has_the_sensor_that_is_g1(more: str, turns: list[int]) -> None:
    objects = axis(1, telegram_number=3, more=f"simulate = true\n{more}") + encoder(2, 81)
    with serving(configuration(objects), do_id=1) as (_, client):
        (answer,) = client.request([ParameterAddress(979, 0, 31)])
        sensors = decode_sensor_format(tuple(int(value) for value in answer.values))
        assert [sensor.turns for sensor in sensors] == turns


def test_a_homing_method_that_is_written_is_shown_and_the_home_position_stays() -> None:
    with serving(configuration(axis(1, telegram_number=9))) as (daemon, client):
        plc = Plc(daemon, [9])
        plc.endpoint.set(0, {"SATZANW": 0x8000 | 35, "MDI_VELOCITY": 1 << 29})
        plc.endpoint.set(0, {"STW1": 0x043E})
        plc.until(lambda: plc.state() == 0x01, "ready")
        plc.endpoint.set(0, {"STW1": 0x043F})
        plc.until(lambda: plc.state() == 0x07, "operation")
        plc.endpoint.set(0, {"STW1": 0x043F | 0x800})
        plc.until(lambda: plc.value("ZSW1") & HOME_SET, "homed")
        plc.endpoint.set(0, {"STW1": 0x043E})
        plc.until(lambda: plc.state() == 0x01, "off")
        with exchanging(plc):
            (answer,) = client.request([ParameterAddress(0x6098)], [Values(DataType.INTEGER8, (-17,))])
            assert not answer.failed, answer.text
            until(daemon, lambda: plc.value("AKTSATZ") & 0xFF == -17 & 0xFF, "the new method")
        assert plc.value("ZSW1") & HOME_SET
