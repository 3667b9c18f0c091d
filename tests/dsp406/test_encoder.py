"""The encoder client against simulated encoders on a virtual bus."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.communication import SYNC_COUNTER, NmtCommand, NmtState
from pdgw.ds301.eds.writer import write_eds
from pdgw.ds301.loop.loop import Event
from pdgw.ds301.node.node import NodeStatus, Notice
from pdgw.ds301.objects import Entry
from pdgw.dsp406.device import device_info, eds_path, encoder_objects
from pdgw.dsp406.encoder import EncoderClient, load_eds
from pdgw.dsp406.kinds import LINEAR, MULTI_SENSOR, ROTARY, Dsp406Error, EncoderDevice, multi_sensor
from pdgw.dsp406.objects import PRESET
from pdgw.dsp406.settings import EncoderSettings
from pdgw.peers.drive.objects import EDS_PATH as DRIVE_EDS
from pdgw.peers.encoder import SimulatedEncoderNode
from pdgw.peers.encoder.motion import constant_speed, still
from pdgw.peers.node.node import Value
from tests.dsp406.plant import DAY, NODE, Plant, fresh
from tests.support.gateways import site


def test_start_up_maps_the_pdos_sets_the_timer_and_reads_the_parameters(plant: Plant) -> None:
    encoder = plant.power_on(still(1.5))
    encoder.start()
    client = plant.connect()
    plant.online()
    node = encoder.node
    assert node.state is NmtState.OPERATIONAL
    assert [node.read(0x1A00, n) for n in range(3)] == [2, 0x6004_0020, 0x6030_0110]
    assert [node.read(0x1800, n) for n in (1, 2)] == [0x180 + NODE, 254]
    assert node.read(0x1802, 1) == 0x8000_0380 + NODE
    assert (node.read(0x6200), node.read(0x1017)) == (10, 100)
    assert client.parameters is not None
    assert client.parameters.total_range == 4096 * 4096
    assert client.parameters.units_per_turn == 4096
    assert fresh(client).feedback.channel(1).position == 6144
    assert client.has_speed(1)


def test_position_and_speed_follow_the_motion(plant: Plant) -> None:
    plant.power_on(constant_speed(-1.0)).start()
    client = plant.connect()
    plant.online()
    site.wait_for(lambda: fresh(client).feedback.channel(1).speed == -4096, "speed")
    before = client.feedback.channel(1).position
    site.wait_for(lambda: fresh(client).feedback.channel(1).position != before, "motion")


@pytest.mark.parametrize(("device", "eds"), [(LINEAR, None), (MULTI_SENSOR, eds_path(MULTI_SENSOR))])
def test_the_other_devices_are_operated_the_same(plant: Plant, device: EncoderDevice, eds: Path | None) -> None:
    plant.power_on(still(2.0), device=device).start()
    client = plant.connect(device=device, eds=eds)
    plant.online()
    assert fresh(client).feedback.channel(1).position == 2 * device.steps_per_unit
    assert client.parameters is not None
    assert client.parameters.total_range == device.steps


def test_channels_travel_in_tpdos_and_by_sdo_where_there_are_none(plant: Plant, tmp_path: Path) -> None:
    device = multi_sensor(6)
    eds = tmp_path / "six.eds"
    eds.write_text(write_eds(device_info(device), encoder_objects(device)), encoding="ascii")
    plant.power_on(*(still(n / 4) for n in range(6)), device=device).start()
    client = plant.connect(eds=eds, channels=(1, 2, 3, 4, 5, 6))
    plant.online()
    fresh(client)
    assert [client.feedback.channel(n).position for n in range(1, 7)] == [n * 1024 for n in range(6)]
    plant.encoder.set_motion(still(10.0), 6)  # type: ignore[union-attr]
    site.wait_for(lambda: client.feedback.channel(6).position == 40960, "channel 6 by SDO")
    with pytest.raises(Dsp406Error, match=r"channel: 7"):
        client.feedback.channel(7)


@pytest.mark.parametrize("channels", [(), (1, 1), (3,), (0,)])
def test_impossible_channels_are_refused(plant: Plant, channels: tuple[int, ...]) -> None:
    with pytest.raises(Dsp406Error, match="channel"):
        EncoderClient(plant.network, EncoderSettings(NODE, device=MULTI_SENSOR, channels=channels), print)


def _on_sync(plant: Plant, client: EncoderClient) -> None:
    """Send SYNC until the client is online."""

    def cycle() -> bool:
        plant.network.send_sync()
        return client.status is NodeStatus.ONLINE

    site.wait_for(cycle, "online by SYNC")


def test_sync_uses_the_second_transmit_pdo(plant: Plant) -> None:
    encoder = plant.power_on(still(0.5))
    encoder.start()
    client = plant.connect(sync=True)
    _on_sync(plant, client)
    assert encoder.node.read(0x1802, 2) == 1
    assert encoder.node.read(0x1800, 1) == 0x8000_0180 + NODE
    assert encoder.node.read(0x6200) == 0
    assert fresh(client).feedback.channel(1).position == 2048


def test_sync_counter_of_an_encoder_is_switched_off(plant: Plant) -> None:
    _with(plant, "sync-counter")
    client = plant.connect(sync=True)
    _on_sync(plant, client)
    assert plant.encoder is not None
    assert plant.encoder.node.read(SYNC_COUNTER) == 0


def test_sync_counter_that_an_encoder_keeps_is_named(plant: Plant) -> None:
    _with(plant, "sync-counter", read_only=1)
    client = plant.connect(sync=True)
    site.wait_for(lambda: client.status is NodeStatus.REFUSED, "refusal")
    assert "1019h/0 := 0h" in client.status_text


def test_parameters_are_read_again_by_a_job(plant: Plant) -> None:
    plant.power_on(still(3.0)).start()
    client = plant.connect()
    plant.online()
    site.result(client.submit(lambda encoder: encoder.sdo.write(PRESET, 0, (1000).to_bytes(4, "little"))))
    site.wait_for(lambda: fresh(client).feedback.channel(1).position == 1000, "preset")
    parameters = site.result(client.submit(lambda encoder: encoder.read_parameters()))
    assert parameters.offset == 1000 - 3 * 4096


def test_emergencies_alarms_and_warnings_arrive(plant: Plant) -> None:
    encoder = plant.power_on()
    encoder.start()
    client = plant.connect(diagnosis_ms=60_000)
    plant.online()
    encoder.inject("battery")  # a warning has no EMCY: it waits for the next one, or for its time
    encoder.inject("position-error")
    feedback = client.feedback
    site.wait_for(lambda: (feedback.alarms, feedback.warnings) == (1, 1 << 4), "diagnostics")
    assert feedback.error_register == 0x21
    encoder.inject("input-voltage")
    site.wait_for(lambda: len([event for event in plant.events if event.notice is Notice.EMERGENCY]) == 2, "EMCY")
    texts = [event.text for event in plant.events if event.notice is Notice.EMERGENCY]
    assert texts == ["EMCY 1000h generic error", "EMCY 3110h input voltage out of range"]
    encoder.clear()
    site.wait_for(lambda: client.feedback.alarms == 0 and client.feedback.error_register == 0, "cleared")


def test_emcy_shows_the_error_register_of_a_device_without_sdo(plant: Plant) -> None:
    encoder = plant.power_on()
    encoder.start()
    client = plant.connect()
    plant.online()
    encoder.do(lambda node: node.start_fault("sdo-timeout"))
    encoder.inject("input-voltage")
    site.wait_for(lambda: client.feedback.error_register == 0x05, "error register")
    encoder.clear()
    site.wait_for(lambda: client.feedback.error_register == 0, "no error")


def test_an_encoder_whose_position_cannot_be_read_by_sdo_any_more_is_lost(plant: Plant) -> None:
    encoder = plant.power_on(constant_speed(1.0))
    encoder.do(lambda node: node.start_fault("two-pdos", pdos=0))
    encoder.start()
    client = plant.connect()
    plant.online()
    assert client.refresh(site.now())
    first = client.position_time(1)
    site.wait_for(lambda: client.position_time(1) > first, "read again")
    encoder.do(lambda node: node.start_fault("sdo-timeout"))
    site.wait_for(lambda: client.status is NodeStatus.LOST, "loss")
    encoder.do(lambda node: node.end_fault("sdo-timeout"))
    plant.online(2)


def test_a_position_by_sdo_is_overdue_while_the_task_is_busy_with_something_else(plant: Plant) -> None:
    encoder = plant.power_on()
    encoder.do(lambda node: node.start_fault("two-pdos", pdos=0))
    encoder.start()
    client = plant.connect()
    plant.online()
    release = Event(client.loop)
    job = client.submit(lambda _: release.wait())
    site.wait_for(lambda: not client.refresh(site.now()), "overdue")
    assert client.status is NodeStatus.ONLINE
    release.set()
    assert site.result(job)
    site.wait_for(lambda: client.refresh(site.now()), "read again")


def test_a_drive_is_refused_by_name(plant: Plant) -> None:
    with site.drive(NODE):
        client = plant.connect()
        site.wait_for(lambda: client.status is NodeStatus.REFUSED, "refusal")
        assert "profile 402" in client.status_text
        assert "an encoder (profile 406)" in client.status_text


def test_another_encoder_than_the_eds_says_is_refused(plant: Plant) -> None:
    plant.power_on(device=LINEAR).start()
    client = plant.connect()
    site.wait_for(lambda: client.status is NodeStatus.REFUSED, "refusal")
    assert "product code 1018h/2" in client.status_text
    with pytest.raises(Dsp406Error, match="encoder 9: 'refused'"):
        site.result(client.submit(lambda encoder: encoder.sdo.read(0x6004)))


def test_encoder_without_a_product_code_is_online(plant: Plant) -> None:
    _with(plant, "identity-of-vendor-only")
    plant.connect()
    plant.online()


def test_a_restart_is_noticed_and_configured_again(plant: Plant) -> None:
    encoder = plant.power_on()
    encoder.start()
    plant.connect()
    plant.online()
    encoder.do(lambda node: node.receive(0, bytes((NmtCommand.RESET_NODE, NODE)), node.now))
    plant.online(2)
    assert encoder.node.read(0x6200) == 10


def test_a_silent_encoder_is_lost_and_comes_back(plant: Plant) -> None:
    encoder = plant.power_on()
    encoder.start()
    client = plant.connect(heartbeat_factor=3, tpdo_timeout_factor=10)
    plant.online()
    encoder.do(lambda node: node.power_off())
    site.wait_for(lambda: client.status is NodeStatus.LOST, "loss")
    assert not client.refresh(DAY)
    encoder.do(lambda node: node.start(node.now))
    site.wait_for(lambda: client.status is NodeStatus.ONLINE, "back")


class _WithoutReaction(SimulatedEncoderNode):
    """Has no heartbeat."""

    def on_written(self, entry: Entry, value: Value) -> None:
        if entry.index == 0x1017:
            raise SdoAbortedError(Abort.NO_SUCH_OBJECT)
        super().on_written(entry, value)


def test_an_encoder_without_heartbeat_is_watched_by_its_tpdos(plant: Plant) -> None:
    encoder = plant.power_on()
    encoder.node = _WithoutReaction(NODE, encoder._send)
    encoder.start()
    client = plant.connect(heartbeat_factor=1, heartbeat_ms=1)
    plant.online()
    assert any("no heartbeat" in event.text for event in plant.events)
    assert site.result(client.submit(lambda encoder: encoder.sdo.read_number(0x6004))) == 0
    assert client.generation == 1


@pytest.mark.parametrize(("step_ms", "expected"), [(7, True), (1000, False)])
def test_an_encoder_that_rounds_the_time_of_its_heartbeat_is_monitored_by_it(
    plant: Plant, step_ms: int, expected: bool
) -> None:
    plant.encoder = site.encoder(NODE, habits={"times-rounded": {"step_ms": step_ms}})
    plant.encoder.start()
    client = plant.connect()
    plant.online()
    assert client.heartbeat.expected is expected
    assert any("no heartbeat" in event.text for event in plant.events) is not expected


def test_data_sheet_of_another_device_is_named(tmp_path: Path) -> None:
    with pytest.raises(Dsp406Error, match="6004h or 6020h"):
        load_eds(DRIVE_EDS, NODE)
    with pytest.raises(Dsp406Error, match="a usable EDS or DCF"):
        load_eds(tmp_path / "none.eds", NODE)


def _with(plant: Plant, fault: str, **values: int) -> None:
    encoder = plant.power_on(still(1.0))
    encoder.node.start_fault(fault, **values)
    encoder.start()


@pytest.mark.parametrize(
    ("fault", "values", "text"),
    [
        ("wrong-identity", {}, "1018h"),
        ("object-missing", {"index": 0x6501}, "object 6501h/0.*does not exist"),
        ("object-missing", {"index": 0x6200}, "cyclic timer .*does not exist"),
    ],
)
def test_an_encoder_that_cannot_be_operated_is_refused_with_the_reason(
    plant: Plant, fault: str, values: dict[str, int], text: str
) -> None:
    _with(plant, fault, **values)
    client = plant.connect()
    site.wait_for(lambda: client.status is NodeStatus.REFUSED, "refusal")
    assert re.search(text, client.status_text), client.status_text


def test_fixed_mapping_that_matches_is_used(plant: Plant, tmp_path: Path) -> None:
    """The data sheet of such a device has nothing but the position to map."""
    eds = tmp_path / "fixed.eds"
    text = eds_path(ROTARY).read_text(encoding="ascii")
    position, others = text[: text.index("[6030]")], text[text.index("[6030]") :]
    eds.write_text(position + others.replace("PDOMapping=1", "PDOMapping=0"), encoding="ascii")
    _with(plant, "fixed-pdo-mapping")
    client = plant.connect(eds=eds)
    plant.online()
    assert fresh(client).feedback.channel(1).position == 4096
    assert not client.has_speed(1)


@pytest.mark.parametrize(
    ("fault", "line"),
    [
        ("fixed-pdo-mapping", "TPDO1 189h: Position value 6004h; on change and by event timer; its own mapping"),
        ("mapping-abort", "read by SDO every 100 ms: Position value 6004h"),
    ],
)
def test_encoder_whose_mapping_cannot_be_written_shows_its_position(plant: Plant, fault: str, line: str) -> None:
    _with(plant, fault)
    client = plant.connect()
    plant.online()
    assert client.plan is not None
    assert client.plan.lines[0] == line
    assert fresh(client).feedback.channel(1).position == 4096
    assert not client.has_speed(1)


def test_an_encoder_with_one_pdo_sends_it_on_sync(plant: Plant) -> None:
    _with(plant, "two-pdos", pdos=1)
    client = plant.connect(sync=True)
    _on_sync(plant, client)
    assert plant.encoder is not None
    assert plant.encoder.node.read(0x1800, 2) == 1
    assert fresh(client).feedback.channel(1).position == 4096


def test_a_slow_encoder_comes_online(plant: Plant) -> None:
    _with(plant, "slow-sdo", delay_ms=5)
    client = plant.connect()
    plant.online()
    assert client.generation == 1


def test_emcy_burst_is_passed_on_without_a_loss(plant: Plant) -> None:
    encoder = plant.power_on(still(1.0))
    encoder.start()
    client = plant.connect()
    plant.online()
    encoder.do(lambda node: node.start_fault("emcy-burst"))
    site.wait_for(lambda: [event for event in plant.events if event.notice is Notice.EMERGENCY], "EMCY")
    assert site.result(client.submit(lambda encoder: encoder.sdo.read_number(0x6004))) == 4096
    assert client.generation == 1
