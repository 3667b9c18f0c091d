"""The drive client on a virtual bus: what it sends, what it notices, what its task survives."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from random import Random

import pytest
from canopen.objectdictionary import ODVariable

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import Abort, CanopenError, SdoAbortedError, SdoCommunicationError
from pdgw.ds301.bus.interfaces import open_bus
from pdgw.ds301.bus.port import PortBusyError
from pdgw.ds301.communication import NMT, STORE_PARAMETERS, NmtCommand
from pdgw.ds301.loop.loop import Event
from pdgw.ds301.node.node import Notice
from pdgw.ds301.objects import CanType, Entry
from pdgw.ds301.pdo import COB_ID_INVALID, PdoDirection
from pdgw.dsp402.drive.client import DriveClient, DriveStatus, load_eds
from pdgw.dsp402.drive.images import DriveCommand
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.peers.drive import SimulatedDriveNode
from pdgw.peers.drive.objects import EDS_PATH
from pdgw.peers.node.node import Value
from tests.support.axis.mapping import pdo_steps
from tests.support.drives.drive_types import engel
from tests.support.drives.plant import NODE, Plant, eds_without
from tests.support.gateways import site


def test_pdo_steps_are_in_the_order_cia_301_demands() -> None:
    layout = LAYOUTS[Operation.POSITIONING]
    available = [d.communication_index + n for d in PdoDirection for n in range(5)]
    steps = pdo_steps(layout, NODE, available, sync=False, event_ms=50, inhibit_us=4000)
    for pdo in (*layout.rpdos, *layout.tpdos):
        mine = [s for s in steps if s.index in {pdo.communication_index, pdo.mapping_index}]
        order = [(s.index - pdo.communication_index, s.subindex) for s in mine]
        assert order[0] == (0, 1)
        assert mine[0].value & COB_ID_INVALID
        assert order[1] == (0x200, 0)
        assert mine[1].value == 0
        assert [s.value for s in mine[2 : 2 + len(pdo.entries)]] == [entry.mapping for entry in pdo.entries]
        assert mine[2 + len(pdo.entries)].value == len(pdo.entries)
        assert order[-1] == (0, 1)
        assert mine[-1].value == pdo.cob_id(NODE)
    unused = [s for s in steps if s.index == 0x1403]
    assert [s.value for s in unused] == [0x8000_0500 + NODE]


def test_start_up_maps_guards_and_reads_the_references(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connected()
    node = drive.node
    assert node.read(0x1016, 1) == 127 << 16 | 300
    assert node.read(0x1017) == 100
    assert node.read(0x6007) == 3
    assert node.read(0x6061) == Mode.VELOCITY
    assert client.drive_type is not None
    assert client.drive_type.scaling == engel().scaling
    assert client.drive_type.modes == engel().modes
    assert client.homing_method == 35


@pytest.mark.parametrize("operation", list(Operation))
def test_every_layout_carries_commands_and_feedback(plant: Plant, operation: Operation) -> None:
    plant.connected(operation, initial_mode=None)
    plant.hear(modes_of_operation=Mode.VELOCITY)


def test_a_drive_with_four_pdos_gets_the_rest_by_sdo(plant: Plant, tmp_path: Path) -> None:
    drive = plant.power_on(pdos=4)
    eds = eds_without(tmp_path, ("1404", "1604", "1804", "1A04"))
    client = plant.connected(Operation.TRANSPARENT, initial_mode=None, eds=eds)
    command = DriveCommand()
    command.digital_outputs = 0x0005_0000
    client.send(command, 1)
    site.wait_for(lambda: drive.model.digital_outputs == 0x0005_0000, "outputs written by SDO")


def test_pdos_are_sent_on_change_data_first_controlword_last_and_refreshed(plant: Plant) -> None:
    client = plant.connected(Operation.POSITIONING, initial_mode=None)
    sent: list[int] = []
    plant.network.listeners.append(
        lambda m: sent.append(m.arbitration_id) if not m.is_rx and 0x200 <= m.arbitration_id < 0x580 else None
    )
    command = DriveCommand()
    client.send(command, 1)
    assert sent == [0x404, 0x304, 0x204]
    sent.clear()
    client.send(command, 2)
    assert sent == []
    command.target_position = 5
    command.profile_velocity = 9
    client.send(command, 3)
    assert sent == [0x304, 0x204]
    sent.clear()
    client.send(command, 101 * MS)
    assert sent == [0x404, 0x304, 0x204]


def test_command_that_was_dropped_with_those_of_a_lost_node_is_sent_again(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connected()
    command = DriveCommand()
    port = site.gateway_port()
    port.droppable = True
    port.connect(False)
    command.controlword = 0x06
    client.send(command, site.now())
    plant.network.drop_waiting()
    port.connect(True)
    client.send(command, site.now())
    site.pass_time(2 * MS)
    assert drive.model.controlword == 0x06


def test_nothing_is_sent_before_the_drive_is_online(plant: Plant) -> None:
    client = plant.connect()
    sent: list[int] = []
    plant.network.listeners.append(lambda message: sent.append(message.arbitration_id))
    for now in range(3):
        client.send(DriveCommand(), now)
    assert not [can_id for can_id in sent if 0x200 <= can_id < 0x580]


def test_missing_node_is_reported_and_found_later(plant: Plant) -> None:
    client = plant.connect()
    site.wait_for(lambda: "no answer from node 4" in client.status_text, "told")
    assert client.status is DriveStatus.OFFLINE
    with pytest.raises(Dsp402Error, match="offline"):
        site.result(client.submit(lambda drive: drive.sdo.read(0x1000)))
    plant.power_on()
    plant.online()


@pytest.mark.parametrize(
    ("address", "value", "message"),
    [
        ((0x1000, 0), 0x0002_0196, "profile 406.*a drive"),
        ((0x1018, 1), 0x1234, "vendor-ID 1018h/1.*00001234h.*as in the EDS"),
        ((0x1018, 2), 0x99, "product code 1018h/2"),
    ],
)
def test_a_node_of_another_type_is_refused_by_name(
    plant: Plant, address: tuple[int, int], value: int, message: str
) -> None:
    plant.power_on(values={address: value})
    plant.connect(eds=EDS_PATH)
    text = plant.refused()
    assert re.search(message, text), text
    assert plant.events[-1].notice is Notice.REFUSED


def test_drive_without_a_product_code_is_online_with_its_data_sheet(plant: Plant) -> None:
    plant.power_on(misbehaves="identity-of-vendor-only")
    plant.connect(eds=EDS_PATH)
    plant.online()


class _Stubborn(SimulatedDriveNode):
    """Refuses to guard the gateway."""

    def on_written(self, entry: Entry, value: Value) -> None:
        if entry.index == 0x6007:
            raise SdoAbortedError(Abort.READ_ONLY)
        super().on_written(entry, value)


@pytest.mark.parametrize("allowed", [False, True])
def test_a_drive_that_refuses_6007h_is_not_operated_unless_configured(plant: Plant, allowed: bool) -> None:
    plant.power_on(_Stubborn)
    client = plant.connect(allow_unguarded=allowed)
    if allowed:
        plant.online()
        assert any("not guarded" in event.text for event in plant.events)
    else:
        site.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
        assert "allow_unguarded" in client.status_text
        assert "read-only" in client.status_text


def test_a_silent_drive_is_lost_and_brought_back_without_a_start(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connected()
    drive.do(lambda node: node.power_off())
    site.wait_for(lambda: client.status is DriveStatus.LOST, "lost")
    assert "heartbeat" in client.status_text or "TPDO1" in client.status_text
    assert client.refresh(site.now()) is False
    drive.do(lambda node: node.start(node.now))
    plant.online(2)


def test_a_restart_of_the_drive_is_noticed_and_configured_again(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connected()
    drive.do(lambda node: node.receive(0, bytes((0x81, NODE)), node.now))
    plant.online(2)
    assert Notice.BOOT in [event.notice for event in plant.events]
    assert drive.node.read(0x1016, 1) == 127 << 16 | 300
    assert client.drive_type is not None
    assert client.drive_type.scaling == engel().scaling


def test_unexpected_error_in_a_drives_task_sets_it_offline(plant: Plant) -> None:
    client = plant.connected()
    assert client.refresh(site.now())
    nowhere = replace(DRIVE_OBJECTS.attribute("position_actual"), attribute="of_no_image")
    client.polling.begin([nowhere], site.now())
    client.operation.parts = list(client.parts)
    site.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
    assert client.refresh(site.now()) is False
    assert plant.events[-1].notice is Notice.REFUSED


def test_last_sign_of_a_drive_includes_heartbeats(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connected()
    drive.do(lambda node: node.receive(NMT, bytes((NmtCommand.STOP, NODE)), node.now))
    site.wait_for(lambda: client.heartbeat.stopped, "a heartbeat, and no TPDO any more")
    assert client.received_ns > max(slot.time for slot in client.operation.slots)


def test_emergencies_are_passed_on_with_their_code(plant: Plant) -> None:
    drive = plant.power_on()
    plant.connected()
    drive.inject(4)
    site.wait_for(lambda: any(event.notice is Notice.EMERGENCY for event in plant.events), "EMCY")
    event = next(event for event in plant.events if event.notice is Notice.EMERGENCY)
    assert (event.code, event.register) == (0x3210, 0x05)


def test_jobs_run_beside_the_exchange_and_report_their_own_errors(plant: Plant) -> None:
    client = plant.connected()
    assert site.result(client.submit(lambda drive: drive.sdo.read(0x1008))) == b"ENGEL HBI"
    with pytest.raises(Exception, match="0602"):
        site.result(client.submit(lambda drive: drive.sdo.read(0x5000)))
    blocked = Event(client.loop)
    slow = client.submit(lambda drive: blocked.wait(5000 * MS))
    assert client.refresh(site.now())
    blocked.set()
    assert site.result(slow)


def test_a_short_tpdo_is_counted_and_ignored(plant: Plant) -> None:
    client = plant.connected()
    client.refresh(0)
    before = client.feedback.statusword
    slot = client.operation.slots[0]
    slot.receive(b"\x37", 1)
    client.refresh(0)
    assert client.feedback.statusword == before
    assert client.length_errors == 1


def test_telegram_change_maps_the_pdos_again(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connected()
    client.reconfigure(LAYOUTS[Operation.POSITIONING], DriveSettings(NODE, sdo_timeout_ms=200))
    plant.online(2)
    assert drive.node.read(0x1600, 0) == 3
    assert drive.node.read(0x1601, 1) == 0x6081_0020


def test_telegram_change_restores_ramps_that_rpdos_replaced(plant: Plant) -> None:
    """Else a speed telegram ramps, and stops, with what a task of the positioner had asked for last."""
    drive = plant.power_on()
    drive.node.write(drive.node.entry(0x6083, 0), 250)
    client = plant.connected()
    client.reconfigure(LAYOUTS[Operation.POSITIONING], DriveSettings(NODE, sdo_timeout_ms=200))
    plant.online(2)
    command = DriveCommand()
    command.profile_acceleration = 7
    client.send(command, client.loop.now())
    site.wait_for(lambda: drive.node.read(0x6083) == 7, "RPDO")
    client.reconfigure(LAYOUTS[Operation.VELOCITY], DriveSettings(NODE, sdo_timeout_ms=200))
    plant.online(3)
    assert drive.node.read(0x6083) == 250


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "1000h"), ("[6040]\nParameterName=x", "EDS"), ("garbage", "EDS"), ("[FileInfo\n", "EDS")],
)
def test_a_wrong_eds_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "wrong.eds"
    path.write_text(text)
    with pytest.raises(Dsp402Error, match=message) as error:
        load_eds(path, NODE)
    assert "wrong.eds" in str(error.value)


def test_a_missing_eds_is_named(tmp_path: Path) -> None:
    with pytest.raises(Dsp402Error, match=r"none\.eds.*No such file"):
        load_eds(tmp_path / "none.eds", NODE)


@pytest.mark.parametrize("interface", ["socketcan", "no-such-interface", "remote"])
def test_an_unreachable_can_interface_is_named(interface: str) -> None:
    with pytest.raises(CanopenError, match=f"CAN interface: '{interface} channel ws://127.0.0.1:1/'"):
        open_bus(interface, "ws://127.0.0.1:1/")


def test_any_exception_of_a_driver_names_the_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(**_: object) -> None:
        raise KeyError

    monkeypatch.setattr("can.Bus", broken)
    with pytest.raises(CanopenError, match=r"CAN interface: 'virtual channel ttyACM0' cannot be opened: KeyError"):
        open_bus("virtual", "ttyACM0")


# -- what a node's task must not do permanently -----------------------------------------------------------------------------


def test_unreadable_values_are_a_loss(plant: Plant) -> None:
    """With two TPDOs most of telegram 100 is read by SDO: old values must not be shown as good."""
    drive = plant.power_on(misbehaves="two-pdos")
    client = plant.connected(Operation.TRANSPARENT, initial_mode=None, sdo_timeout_ms=50)
    drive.do(lambda node: node.start_fault("sdo-timeout"))
    site.wait_for(lambda: client.status is not DriveStatus.ONLINE, "lost")
    assert any("objects without PDO could not be read 3 times" in event.text for event in plant.events)
    drive.do(lambda node: node.end_fault("sdo-timeout"))
    plant.online(2)


def test_values_that_are_not_read_during_a_long_job_are_a_loss(plant: Plant) -> None:
    """Also for the cyclic side, while the job runs."""
    plant.power_on(misbehaves="two-pdos")
    client = plant.connected(Operation.TRANSPARENT, initial_mode=None, sdo_timeout_ms=50)
    release = Event(client.loop)
    client.submit(lambda _: release.wait())
    site.pass_time(400 * MS)
    assert client.refresh(site.now())
    site.pass_time(100 * MS)
    assert not client.refresh(site.now())
    release.set()
    site.wait_for(lambda: client.status is not DriveStatus.ONLINE, "lost")
    assert any("objects without PDO were not read for 450 ms" in event.text for event in plant.events)
    plant.online(2)


@pytest.mark.parametrize("misbehaviour", ["two-pdos", ""])
def test_long_object_is_read_unless_other_objects_go_by_sdo(
    plant: Plant, monkeypatch: pytest.MonkeyPatch, misbehaviour: str
) -> None:
    drive = plant.power_on(misbehaves=misbehaviour)
    client = plant.connected(Operation.TRANSPARENT, initial_mode=None, sdo_timeout_ms=50)
    monkeypatch.setattr(drive.node, "get_data", lambda *_, **__: bytes(4000))
    job = client.submit(lambda drive: drive.sdo.read(0x1008))
    if not misbehaviour:
        assert len(site.result(job)) == 4000
        return
    with pytest.raises(SdoCommunicationError, match="1008h/0 is too long to be read"):
        site.result(job)


def test_no_rpdo_is_sent_after_own_values_are_written_back_even_if_a_client_stores(plant: Plant) -> None:
    client = plant.connected(Operation.POSITIONING, initial_mode=None)
    command = DriveCommand()
    client.send(command, site.now())
    site.result(client.submit(DriveClient.write_back))
    site.result(client.submit(lambda drive: drive.write_for_client(STORE_PARAMETERS, 1, b"save")))
    before = plant.network.sent
    client.send(command, site.now() + SECOND)
    assert plant.network.sent == before


def test_domain_of_the_drive_is_read_by_blocks(plant: Plant) -> None:
    drive = plant.power_on()
    drive.node.entries[0x2100, 0] = Entry(0x2100, 0, "Trace", CanType.DOMAIN)
    drive.node.values[0x2100, 0] = bytes(range(200))
    client = plant.connected()
    variable = ODVariable("Trace", 0x2100, 0)
    variable.data_type = CanType.DOMAIN.code
    client.sdo.dictionary.add_object(variable)
    frames: list[bytes] = []
    plant.network.listeners.append(
        lambda message: frames.append(bytes(message.data)) if message.arbitration_id == 0x600 + NODE else None
    )
    assert site.result(client.submit(lambda drive: drive.sdo.read(0x2100))) == bytes(range(200))
    assert [frame[0] & 0xE0 for frame in frames[-4:]] == [0xA0] * 4


def test_number_has_the_length_of_the_eds(plant: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = plant.power_on()
    client = plant.connected()
    send = drive.node.send
    # Without a size in the answer a number comes with all four bytes of the frame.
    sizeless = b"\x42\x17\x10\0\x64\0\xff\xff"
    monkeypatch.setattr(
        drive.node, "send", lambda can_id, data: send(can_id, sizeless if data[1:4] == sizeless[1:4] else data)
    )
    assert site.result(client.submit(lambda drive: drive.sdo.read(0x1017))) == b"\x64\0"


@pytest.mark.parametrize("pdos", [1, 4])
def test_any_frame_under_the_identifiers_of_the_node_is_survived(plant: Plant, pdos: int) -> None:
    drive = plant.power_on()
    drive.node.start_fault("two-pdos", pdos=pdos)
    client = plant.connected(Operation.TRANSPARENT, initial_mode=None, sdo_timeout_ms=20)
    bus = site.other()
    random = Random(pdos)
    command = DriveCommand()
    for _ in range(2000):
        can_id = random.choice([0x80, 0x180, 0x280, 0x380, 0x480, 0x1C0, 0x580, 0x580, 0x700]) + NODE
        data = random.randbytes(random.choice([0, 1, 2, 3, 4, 7, 8, 8, 8]))
        with suppress(PortBusyError):  # the SDO frames of a bring-up have priority
            bus.send(can_id, data)
        command.digital_outputs = command.target_position = random.getrandbits(16)
        client.send(command, site.now())
        client.refresh(site.now())
        site.pass_time(MS)

    # What is still on its way may spoil an answer, or have the node lost and brought up again.
    def answers() -> bool:
        job = client.submit(lambda drive: drive.sdo.read_number(0x1000))
        site.wait_for(job.done, "an answer or an error")
        return job.exception(0) is None

    site.wait_for(answers, "answers", 30)
    site.wait_for(lambda: client.refresh(site.now()), "online and fresh", 30)
    assert client.loop.task_errors == 0
