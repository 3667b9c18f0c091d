"""Encoders on the gateway: from PLC frames and records to simulated CiA 406 devices and back."""

from __future__ import annotations

from contextlib import AbstractContextManager

import pytest

from pdgw.ds301.loop.loop import Event
from pdgw.gateway.axis.settings import SecondSensor
from pdgw.gateway.axis.telegrams import drive_layout
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.client.udp import ParameterClient
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import encoder_status, snapshot
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import Attribute, ParameterAddress, Values
from pdgw.profidrive.parameters.description import Description
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber as Number
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.output.status_text import status_lines
from tests.support.documents.profile_numbers import decode_sensor_format
from tests.support.gateways.daemon import (
    OFF,
    Plc,
    axis,
    configuration,
    drive_of,
    encoder_of,
    running,
    serving,
    switch_off,
    until,
)

CONTROL = signal("STW2_ENC").bit("CONTROL_BY_PLC").mask
G1 = {bit.name: bit.mask for bit in signal("G1_STW").bits}
STATUS = {bit.name: bit.mask for bit in signal("G1_ZSW").bits}


def encoder(number: int, telegram: int, node: int = 20, more: str = "") -> str:
    return (
        f"[[encoder]]\ndo_id = {number}\nnode_id = {node}\ntelegram = {telegram}\nsimulate = true\n"
        f"tpdo_event_ms = 5\n{more}\n"
    )


def has(plc: Plc, name: str, mask: int) -> bool:
    """A bit of a status word that is there: without good values there is none."""
    return plc.value(name) >= 0 and bool(plc.value(name) & mask)


def gateway(objects: str) -> AbstractContextManager[tuple[Daemon, ParameterClient]]:
    return serving(configuration(objects))


def test_telegram_83_shows_position_and_speed_of_a_turning_encoder() -> None:
    # One revolution (4096 steps) per second: 60 rpm, 2 % of 3000 rpm.
    with gateway(encoder(1, 83, more='motion = "speed=1"')) as (daemon, _):
        plc = Plc(daemon, [83])
        plc.endpoint.set(0, {"STW2_ENC": CONTROL, "G1_STW": G1["REQUEST_ABSOLUTE"]})
        plc.until(lambda: has(plc, "G1_ZSW", STATUS["ABSOLUTE_VALID"]), "absolute value")
        expected = (1 << 30) // 50
        plc.until(lambda: abs(plc.value("NIST_B") - expected) < expected // 10, "60 rpm")
        shown = encoder_status(daemon.encoders[0])
        assert shown["speed"] == pytest.approx(plc.value("NIST_B") / 2**30 * 3000, rel=0.05)
        assert shown["speed_unit"] == "rpm"
        assert any(line.startswith("encoder 1") and " rpm" in line for line in status_lines(snapshot(daemon), 200))
        first = plc.value("G1_XIST1")
        plc.until(lambda: (plc.value("G1_XIST1") - first) & 0xFFFFFFFF > 1000, "it turns")
        assert not has(plc, "ZSW2_ENC", 0x0008)
        assert plc.value("ZSW2_ENC") & 0x0200, "control requested"
        assert abs(plc.value("G1_XIST2") - daemon.encoders[0].input.position) < 4096


@pytest.mark.parametrize("number", [81, 82, 83, 84])
def test_every_encoder_telegram_has_the_position_and_takes_a_preset(number: int) -> None:
    with gateway(encoder(3, number, more='motion = "still=0.25"')) as (daemon, client):
        plc = Plc(daemon, [number])
        plc.endpoint.set(0, {"STW2_ENC": CONTROL, "G1_STW": G1["REQUEST_ABSOLUTE"]})
        plc.until(lambda: plc.value("G1_XIST2") == 1024, "position")
        (written,) = client.request([ParameterAddress(65000)], [Values(DataType.INTEGER32, (123456,))])
        assert not written.failed
        plc.endpoint.set(0, {"STW2_ENC": CONTROL, "G1_STW": G1["REQUEST_ABSOLUTE"] | G1["PRESET"]})
        plc.until(lambda: has(plc, "G1_ZSW", STATUS["PRESET_DONE"]), "preset done")
        plc.until(lambda: plc.value("G1_XIST2") == 123456, "preset seen")
        plc.endpoint.set(0, {"STW2_ENC": CONTROL, "G1_STW": G1["REQUEST_ABSOLUTE"]})
        plc.until(lambda: not has(plc, "G1_ZSW", STATUS["PRESET_DONE"]), "handshake ends")
        assert encoder_of(daemon).model.position_1 == 123456
        if number == 84:
            assert plc.value("G1_XIST3") == 123456


def test_a_preset_beyond_the_total_range_is_refused_and_changes_nothing() -> None:
    total = 1 << 24
    with gateway(encoder(3, 81)) as (daemon, client):
        for value, refused in ((1 - total, False), (-total, True), (total - 1, False), (total, True)):
            (answer,) = client.request([ParameterAddress(65000)], [Values(DataType.INTEGER32, (value,))])
            assert answer.failed is refused
            assert not refused or "low or high limit exceeded" in answer.text
        assert daemon.encoders[0].preset_value == total - 1
        (described,) = client.request([ParameterAddress(65000, 0, 0, Attribute.DESCRIPTION)])
        limits = Description.decode(bytes(described.values))  # type: ignore[arg-type]
        assert (limits.low, limits.high) == (1 - total, total - 1)


@pytest.mark.parametrize("as_g1", [False, True], ids=["encoder", "G1 of a drive"])
def test_preset_withdrawn_by_parking_is_not_sent_after_another_access(as_g1: bool) -> None:
    objects, numbers, words = encoder(2, 83, more='motion = "still=0.25"'), [83], {"STW2_ENC": CONTROL}
    if as_g1:
        objects = axis(1, telegram_number=3, more="simulate = true\ng1 = 2") + objects
        numbers, words = [3, 83], {"STW1": OFF}
    with gateway(objects) as (daemon, _):
        plc, client = Plc(daemon, numbers), daemon.encoders[0].client
        plc.endpoint.set(0, words | {"G1_STW": G1["REQUEST_ABSOLUTE"]})
        plc.until(lambda: plc.value("G1_XIST2") == 1024, "position")
        free = Event(daemon.loop)
        client.submit(lambda _: free.wait())
        plc.endpoint.set(0, words | {"G1_STW": G1["PRESET"]})
        plc.until(lambda: not has(plc, "G1_ZSW", STATUS["ABSOLUTE_VALID"]), "preset waits for the other access")
        plc.endpoint.set(0, words | {"G1_STW": G1["PARK"]})
        plc.until(lambda: has(plc, "G1_ZSW", STATUS["PARKED"]), "parked")
        plc.exchange()
        free.set()
        plc.until(client.submit(lambda _: None).done, "later accesses")
        assert encoder_of(daemon).model.position_1 == 1024


def test_two_channels_of_one_device_are_two_drive_objects_of_one_node() -> None:
    channels = "".join(
        encoder(number, 82, more=f'model = "multi-sensor"\nchannel = {number}\nmotion = "still={number / 8}"')
        for number in (1, 2)
    )
    with gateway(channels) as (daemon, client):
        assert len(daemon.clients) == 1
        plc = Plc(daemon, [82, 82])
        for index in (0, 1):
            plc.endpoint.set(index, {"STW2_ENC": CONTROL, "G1_STW": G1["REQUEST_ABSOLUTE"]})
        plc.until(lambda: (plc.value("G1_XIST2", 0), plc.value("G1_XIST2", 1)) == (512, 1024), "both positions")
        client.do_id = 2
        client.request([ParameterAddress(65000)], [Values(DataType.INTEGER32, (5,))])
        plc.endpoint.set(1, {"STW2_ENC": CONTROL, "G1_STW": G1["REQUEST_ABSOLUTE"] | G1["PRESET"]})
        plc.until(lambda: plc.value("G1_XIST2", 1) == 5, "channel 2 preset")
        assert plc.value("G1_XIST2", 0) == 512, "channel 1 is untouched"


def test_parameters_of_an_encoder_object() -> None:
    with gateway(encoder(7, 81)) as (_, client):

        def read(pnu: int, subindex: int = 0, elements: int = 0) -> Values:
            (answer,) = client.request([ParameterAddress(pnu, subindex, elements)])
            assert not answer.failed, answer.text
            return answer

        assert (read(965).format, read(965).values) == (DataType.OCTET_STRING, b"\x3d\x2a")
        assert read(975, 5, 3).values == (5, 0x4000, 7)
        (sensor,) = decode_sensor_format(tuple(int(value) for value in read(979, 0, 31).values))
        assert (sensor.resolution, sensor.turns, sensor.valid, sensor.linear) == (4096, 4096, True, False)
        assert read(979, 0, 1).values == (0x5112,)
        assert read(60000).values == (3000.0,)
        status = read(65001, 0, 12).values
        assert status[0] == 0x000C0101
        assert status[9:11] == (4096, 4096 * 4096)
        assert read(0x6501).values == (4096,)
        assert read(922).values == (81,)
        assert read(915, 0, 2).values == (80, 9)
        for pnu, number in ((930, Number.IMPERMISSIBLE_PNU), (967, Number.IMPERMISSIBLE_PNU)):
            (answer,) = client.request([ParameterAddress(pnu)])
            assert answer.values == (number,)
        (refused,) = client.request([ParameterAddress(0x6200)], [Values(DataType.UNSIGNED16, (1,))])
        assert refused.values == (Number.NO_OPERATION_PRIORITY,), "the cyclic timer is the gateway's"


def test_a_preset_written_to_the_object_itself_is_an_error_of_the_sensor_until_acknowledged() -> None:
    with gateway(encoder(1, 81, more='motion = "still=0.5"')) as (daemon, client):
        plc, absolute = Plc(daemon, [81]), G1["REQUEST_ABSOLUTE"]
        plc.endpoint.set(0, {"STW2_ENC": CONTROL, "G1_STW": absolute})
        plc.until(lambda: plc.value("G1_XIST2") == 2048, "position")
        (answer,) = client.request([ParameterAddress(0x6003)], [Values(DataType.UNSIGNED32, (5000,))])
        assert not answer.failed
        for _ in range(50):
            plc.exchange()
            assert plc.value("G1_XIST1") in (2048, -1), "a position controller must not see a jump as a movement"
        assert has(plc, "G1_ZSW", STATUS["ERROR"])
        plc.endpoint.set(0, {"STW2_ENC": CONTROL, "G1_STW": absolute | G1["ERROR_ACKNOWLEDGE"]})
        plc.until(lambda: has(plc, "G1_ZSW", STATUS["ERROR_ACKNOWLEDGED"]), "acknowledged")
        plc.endpoint.set(0, {"STW2_ENC": CONTROL, "G1_STW": absolute})
        plc.until(lambda: plc.value("G1_XIST2") == 5000, "new position")
        (answer,) = client.request([ParameterAddress(0x6001)], [Values(DataType.UNSIGNED32, (1000,))])
        assert not answer.failed, answer.text
        until(
            daemon,
            lambda: (
                daemon.encoders[0].client.parameters
                and daemon.encoders[0].client.parameters.units_per_revolution == 1000
            ),
            "read anew",
        )


def test_p922_changes_an_encoder_telegram_and_only_to_one_of_an_encoder() -> None:
    with gateway(encoder(1, 81, more='motion = "speed=1"')) as (daemon, client):
        (answer,) = client.request([ParameterAddress(922)], [Values(DataType.UNSIGNED16, (1,))])
        assert answer.values == (Number.VALUE_IMPERMISSIBLE,)
        (answer,) = client.request([ParameterAddress(922)], [Values(DataType.UNSIGNED16, (83,))])
        assert not answer.failed
        plc = Plc(daemon, [83])
        plc.endpoint.set(0, {"STW2_ENC": CONTROL})
        plc.until(lambda: plc.value("NIST_B") > 0, "speed")


def test_an_encoder_that_dies_is_a_fault_and_its_position_is_not_good() -> None:
    with gateway(encoder(1, 81) + axis(2).replace("node_id = 2", "node_id = 3")) as (daemon, client):
        plc = Plc(daemon, [1, 81])
        plc.endpoint.set(1, {"STW2_ENC": CONTROL})
        plc.until(lambda: plc.endpoint.actuals[1] is not None, "good")
        encoder_of(daemon).stop()
        plc.until(lambda: plc.endpoint.actuals[1] is None, "IOPS BAD")
        assert plc.endpoint.actuals[0] is not None, "the axis is"
        plc.until(lambda: [fault.number for fault in daemon.encoders[0].faults] == [101], "fault 101")
        client.do_id = 1
        (faults,) = client.request([ParameterAddress(947, 0, 1)])
        assert faults.values == (101,)


def test_a_lost_encoder_is_a_fault_until_it_is_back_and_acknowledged() -> None:
    with gateway(encoder(1, 81)) as (daemon, client):
        plc = Plc(daemon, [81])
        plc.endpoint.set(0, {"STW2_ENC": CONTROL, "G1_STW": G1["REQUEST_ABSOLUTE"]})
        plc.until(lambda: has(plc, "G1_ZSW", STATUS["ABSOLUTE_VALID"]), "absolute value")
        encoder_of(daemon).do(lambda node: node.start_fault("reboot"))
        plc.until(lambda: plc.endpoint.actuals[0] is None, "IOPS BAD")
        plc.until(lambda: has(plc, "ZSW2_ENC", 0x0008), "back, with a fault")
        plc.until(lambda: has(plc, "G1_ZSW", STATUS["ERROR"]), "and a sensor error")
        assert client.request([ParameterAddress(947, 0, 1)])[0].values != (0,)
        plc.endpoint.set(0, {"STW2_ENC": CONTROL | 0x80, "G1_STW": G1["ERROR_ACKNOWLEDGE"]})
        plc.until(lambda: not has(plc, "ZSW2_ENC", 0x0008), "acknowledged")
        plc.until(lambda: client.request([ParameterAddress(947, 0, 1)])[0].values == (0,), "in the buffer too")


def test_warnings_of_the_encoder_and_of_the_gateway_are_in_p953() -> None:
    with gateway(encoder(1, 81)) as (daemon, client):
        plc = Plc(daemon, [81])
        plc.endpoint.set(0, {"STW2_ENC": CONTROL})
        plc.until(lambda: plc.value("ZSW2_ENC") >= 0, "good")

        def warnings() -> int:
            return int(client.request([ParameterAddress(953)])[0].values[0])

        assert warnings() == 0
        simulated = encoder_of(daemon)
        simulated.inject("battery")
        plc.until(lambda: has(plc, "ZSW2_ENC", 0x0080), "warning")
        assert warnings() == 1 << 15
        simulated.clear("battery")
        plc.until(lambda: not has(plc, "ZSW2_ENC", 0x0080), "end of the warning")
        assert warnings() == 0
        simulated.do(lambda node: node.start_fault("object-missing", index=0x6003))
        plc.endpoint.set(0, {"STW2_ENC": CONTROL, "G1_STW": G1["PRESET"]})
        plc.until(lambda: plc.value("G1_XIST2") == 0x1001, "preset refused")
        assert warnings() == 1 << 118 - 108
        plc.endpoint.set(0, {"STW2_ENC": CONTROL, "G1_STW": G1["ERROR_ACKNOWLEDGE"]})
        plc.until(lambda: has(plc, "G1_ZSW", STATUS["ERROR_ACKNOWLEDGED"]), "acknowledged")
        plc.endpoint.set(0, {"STW2_ENC": CONTROL, "G1_STW": 0})
        plc.until(lambda: not has(plc, "G1_ZSW", STATUS["ERROR"]), "normal")
        assert warnings() == 0


def test_an_alarm_is_a_fault_until_it_is_gone_and_acknowledged() -> None:
    with gateway(encoder(1, 81)) as (daemon, client):
        plc = Plc(daemon, [81])
        plc.endpoint.set(0, {"STW2_ENC": CONTROL, "G1_STW": G1["REQUEST_ABSOLUTE"]})
        plc.until(lambda: has(plc, "G1_ZSW", STATUS["ABSOLUTE_VALID"]), "absolute value")
        encoder_of(daemon).inject("position-error")
        plc.until(lambda: has(plc, "ZSW2_ENC", 0x0008), "fault")
        plc.until(lambda: has(plc, "G1_ZSW", STATUS["ERROR"]), "sensor error")
        plc.until(lambda: plc.value("G1_XIST2") == 1, "error code")
        plc.until(lambda: daemon.encoders[0].faults, "in the buffer")
        encoder_of(daemon).clear("position-error")
        plc.until(lambda: not daemon.encoders[0].input.alarms and not daemon.encoders[0].input.error_register, "gone")
        assert has(plc, "ZSW2_ENC", 0x0008), "latched"
        plc.endpoint.set(0, {"STW2_ENC": CONTROL | 0x80, "G1_STW": G1["ERROR_ACKNOWLEDGE"]})
        plc.until(lambda: not has(plc, "ZSW2_ENC", 0x0008), "acknowledged")
        plc.endpoint.set(0, {"STW2_ENC": CONTROL, "G1_STW": G1["REQUEST_ABSOLUTE"]})
        plc.until(lambda: has(plc, "G1_ZSW", STATUS["ABSOLUTE_VALID"]), "measuring again")
        (counts,) = client.request([ParameterAddress(947, 8, 1)])
        assert counts.values != (0,), "moved to situation 1"


def test_telegram_3_shows_the_drive_s_own_position_as_g1() -> None:
    with gateway(axis(1, telegram_number=3)) as (daemon, client):
        plc = Plc(daemon, [3])
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_B": 1 << 27, "G1_STW": G1["REQUEST_ABSOLUTE"]})
        plc.until(lambda: plc.value("G1_XIST1") > 1000, "it counts")
        plc.endpoint.set(0, {"NSOLL_B": 0, "STW1": OFF})
        plc.until(lambda: plc.state() in (0x01, 0x40), "stopped")
        plc.until(
            lambda: plc.value("G1_XIST1") == daemon.axes[0].drive.feedback.position_actual & 0xFFFFFFFF, "same position"
        )
        assert plc.value("G1_XIST2") == plc.value("G1_XIST1")
        plc.endpoint.set(0, {"G1_STW": G1["PRESET"]})
        plc.until(lambda: has(plc, "G1_ZSW", STATUS["ERROR"]) and plc.value("G1_XIST2") == 0x0F01, "no preset")
        (sensor,) = client.request([ParameterAddress(979, 2, 1)])
        assert sensor.values == (4096,)


def test_telegram_3_with_another_node_s_encoder_as_g1() -> None:
    objects = axis(1, telegram_number=3, more="simulate = true\ng1 = 2") + encoder(2, 81, more='motion = "still=0.75"')
    with gateway(objects) as (daemon, client):
        plc = Plc(daemon, [3, 81])
        plc.endpoint.set(0, {"STW1": OFF, "G1_STW": G1["REQUEST_ABSOLUTE"]})
        plc.until(lambda: plc.value("G1_XIST2") == 3072, "the encoder's position")
        plc.endpoint.set(0, {"G1_STW": G1["REQUEST_ABSOLUTE"] | G1["PRESET"]})
        plc.until(lambda: plc.value("G1_XIST2") == 0 and has(plc, "G1_ZSW", STATUS["PRESET_DONE"]), "preset to 0")
        assert encoder_of(daemon).model.position_1 == 0
        assert client.request([ParameterAddress(978, 0, 2)])[0].values == (1, 2)


@pytest.mark.parametrize("number", [3, 4, 102])
def test_a_drive_whose_g1_is_an_encoder_needs_no_position_of_its_own(number: int) -> None:
    objects = axis(1, telegram_number=number, more="simulate = true\ng1 = 2") + encoder(2, 81)
    with gateway(objects) as (daemon, _):
        drive = drive_of(daemon)
        drive.node.entries.pop((0x6064, 0))
        drive.node.indices.discard(0x6064)
        plc = Plc(daemon, [number, 81])
        plc.enable()
        plan = daemon.axes[0].drive.plan
        assert plan is not None
        assert "position_actual" not in plan.shown
        plc.endpoint.set(0, {"NSOLL_B": 1 << 27})
        plc.until(lambda: drive.model.ramp.speed > 100, "it turns")
        assert snapshot(daemon)["axes"][0]["position"] is None


@pytest.mark.parametrize("number", [5, 6, 105, 106])
def test_dsc_needs_the_drives_position_whatever_g1_is(number: int) -> None:
    assert drive_layout(telegram(number), g1_is_encoder=True) == drive_layout(telegram(number))


def test_the_second_encoder_of_a_drive_stays_where_g1_is_another_nodes() -> None:
    tpdos = drive_layout(telegram(4), second=SecondSensor.DRIVE, g1_is_encoder=True).tpdos
    assert [item.attributes for item in tpdos] == [
        ("statusword", "velocity_actual"),
        ("velocity_demand",),
        ("second_position",),
    ]


def test_telegram_4_with_another_node_s_encoder_as_g2() -> None:
    objects = axis(1, telegram_number=4, more="simulate = true\ng2 = 2") + encoder(2, 81, more='motion = "still=0.75"')
    with gateway(objects) as (daemon, client):
        plc = Plc(daemon, [4, 81])
        plc.endpoint.set(0, {"STW1": OFF, "G2_STW": G1["REQUEST_ABSOLUTE"]})
        plc.until(lambda: plc.value("G2_XIST2") == 3072, "the encoder's position")
        assert (plc.value("G1_ZSW"), plc.value("G1_XIST2")) == (0, 0)
        plc.endpoint.set(0, {"G2_STW": G1["REQUEST_ABSOLUTE"] | G1["PRESET"]})
        plc.until(lambda: plc.value("G2_XIST2") == 0 and has(plc, "G2_ZSW", STATUS["PRESET_DONE"]), "preset to 0")
        assert encoder_of(daemon).model.position_1 == 0
        first, second = decode_sensor_format(tuple(map(int, client.request([ParameterAddress(979, 0, 31)])[0].values)))
        assert (first.resolution, second.resolution) == (4096, 4096)
        assert (first.turns, second.turns) == (0, 4096), "the drive's own counts from power-on"
        encoder_of(daemon).inject("position-error")
        plc.endpoint.set(0, {"G2_STW": 0})
        plc.until(lambda: has(plc, "G2_ZSW", STATUS["ERROR"]) and plc.value("G2_XIST2") == 1, "the encoder's error")
        assert plc.value("G1_ZSW") == 0


@pytest.mark.parametrize(
    ("objects", "message"),
    [
        (encoder(1, 3), "telegram = 3 is not supported, allowed: [81, 82, 83, 84]"),
        (encoder(1, 81, more="channel = 2"), "channel = 2"),
        (encoder(1, 81) + encoder(2, 81), "node_id and channel"),
        (encoder(1, 81) + encoder(1, 81, node=21), "do_id: 1 is used twice"),
        (encoder(1, 81, node=4) + axis(4), "node_id on bus can: 4 is used twice"),
        (axis(1, telegram_number=3, more="simulate = true\ng1 = 5"), "g1 = 5 is not the do_id of an [[encoder]]"),
        (
            encoder(1, 81, more='model = "multi-sensor"')
            + encoder(2, 81, more='model = "multi-sensor"\nchannel = 2\nsync = true'),
            "applies to the whole device",
        ),
        (encoder(1, 81, more="reference_speed = 0"), "reference_speed"),
        ("", "at least one"),
    ],
)
def test_impossible_configurations_are_rejected(objects: str, message: str) -> None:
    with pytest.raises(GatewayError) as caught:
        parse_config(f'[can]\ninterface = "virtual"\nchannel = "x"\n{objects}')
    assert message in str(caught.value)


def test_encoder_whose_alarms_cannot_be_read_is_lost() -> None:
    """Its position still comes by TPDO, but nobody knows whether it is one."""
    with running(configuration(encoder(1, 81))) as daemon:
        made = daemon.encoders[0]
        until(daemon, lambda: made.good, "online")
        encoder_of(daemon).do(lambda node: node.start_fault("sdo-timeout"))
        until(daemon, lambda: not made.good, "lost")
        assert "could not be read 3 times" in made.faults[0].text
        encoder_of(daemon).do(lambda node: node.end_fault())
        until(daemon, lambda: made.good, "online again")


def test_encoder_without_pdos_is_lost_when_its_alarms_alone_cannot_be_read() -> None:
    """Its position comes by SDO: that it can be read says nothing about the alarms."""

    def before(daemon: Daemon) -> None:
        encoder_of(daemon).do(lambda node: node.start_fault("two-pdos", pdos=0))

    with running(configuration(encoder(1, 81)), before) as daemon:
        made = daemon.encoders[0]
        until(daemon, lambda: made.good, "online")
        encoder_of(daemon).do(lambda node: node.start_fault("object-missing", index=0x6503))
        until(daemon, lambda: not made.good, "lost")
        assert "could not be read 3 times" in made.faults[0].text


def test_loss_of_an_encoder_is_a_note_of_its_axis_until_acknowledged() -> None:
    with gateway(axis(1, telegram_number=3, more="simulate = true\ng1 = 2") + encoder(2, 81)) as (
        daemon,
        _,
    ):
        plc = Plc(daemon, [3, 81])
        plc.enable()
        item = encoder_of(daemon)

        def note() -> str:
            plc.exchange(100)
            return " ".join(snapshot(daemon)["axes"][0]["notes"])

        assert note() == ""
        switch_off(daemon, item)
        lost = "silent: neither heartbeats nor TPDOs"
        assert note() == f"G1 has no position: encoder 2: Not on the bus: node 20 on bus can: {lost}"
        item.node.restart()
        plc.until(lambda: daemon.encoders[0].good, "found again")
        assert note().startswith("G1: sensor error 0001h, the position is wrong or missing: node lost: silent")
        assert note().endswith("check plug, cable and supply of the node; then acknowledge (G1_STW.15)")
        for word in (0x8000, 0):
            plc.endpoint.set(0, {"G1_STW": word})
            plc.exchange(2)
        assert note() == ""
