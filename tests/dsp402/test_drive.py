"""The drive client on a virtual bus: start-up order, what it refuses, what it notices."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from random import Random

import can
import pytest
from canopen.sdo import SdoAbortedError, SdoCommunicationError

from pdgw.ds301.aborts import Abort
from pdgw.ds301.bus import open_bus
from pdgw.ds301.errors import CanopenError
from pdgw.ds301.loop import MS, SECOND, Event
from pdgw.ds301.network import CanNetwork
from pdgw.ds301.nmt import NmtCommand, NmtState
from pdgw.ds301.objects import Entry
from pdgw.ds301.pdo import COB_ID_INVALID, Pdo, PdoDirection
from pdgw.ds301.port import PortBusyError
from pdgw.dsp402.drive import DriveClient, DriveEvent, DriveStatus, load_eds
from pdgw.dsp402.drive_type import Quantity
from pdgw.dsp402.errors import Dsp402Error
from pdgw.dsp402.images import DriveCommand
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.pdo import LAYOUTS, Operation
from pdgw.dsp402.scaling import UnitKeys
from pdgw.dsp402.settings import DriveSettings
from pdgw.dsp402.states import ControlBit
from pdgw.peers.drive import SimulatedDrive, SimulatedDriveNode
from pdgw.peers.drive.device import EDS_PATH
from pdgw.peers.node.node import Value
from tests.support import site
from tests.support.drive_types import engel
from tests.support.mapping import engel_layout, pdo_steps

NODE = 4


class Plant:
    """A client and a simulated drive on one bus; ``prepare`` changes the drive before it is switched on."""

    def __init__(self, network: CanNetwork) -> None:
        self.network = network
        self.events: list[DriveEvent] = []
        self.drive: SimulatedDrive | None = None
        self.client: DriveClient | None = None

    def power_on(self, pdos: int = 5) -> SimulatedDrive:
        self.drive = site.drive(NODE, pdos=pdos)
        self.drive.start()
        return self.drive

    def connect(self, operation: Operation = Operation.VELOCITY, **settings: object) -> DriveClient:
        values: dict[str, object] = {"node_id": NODE, "sdo_timeout_ms": 200, "initial_mode": Mode.VELOCITY, **settings}
        chosen = DriveSettings(**values)  # type: ignore[arg-type]
        self.client = DriveClient(self.network, chosen, LAYOUTS[operation], self.events.append)
        self.client.start()
        return self.client

    def online(self, generation: int = 1) -> None:
        client = self.client
        assert client is not None
        site.wait_for(
            lambda: client.status is DriveStatus.ONLINE and client.generation == generation,
            f"online ({client.status_text})",
        )

    def close(self) -> None:
        if self.client is not None:
            self.client.stop()
        if self.drive is not None:
            self.drive.stop()


@pytest.fixture
def plant() -> Iterator[Plant]:
    with site.guarded_network() as network:
        plant = Plant(network)
        yield plant
        plant.close()


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
    client = plant.connect()
    plant.online()
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
    drive = plant.power_on()
    client = plant.connect(operation, initial_mode=None)
    plant.online()
    command = DriveCommand()
    command.modes_of_operation = Mode.VELOCITY
    command.controlword = 0x06
    client.send(command, 1)
    site.wait_for(lambda: client.refresh(0) is not None and client.feedback.statusword & 0x6F == 0x21, "ready")
    assert drive.model.controlword == 0x06


def test_a_drive_with_four_pdos_gets_the_rest_by_sdo(plant: Plant, tmp_path: Path) -> None:
    drive = plant.power_on(pdos=4)
    eds = _eds_without(tmp_path, ("1404", "1604", "1804", "1A04"))
    client = plant.connect(Operation.TRANSPARENT, initial_mode=None, eds=eds)
    plant.online()
    command = DriveCommand()
    command.digital_outputs = 0x0005_0000
    client.send(command, 1)
    site.wait_for(lambda: drive.model.digital_outputs == 0x0005_0000, "outputs written by SDO")


def _eds_without(folder: Path, indices: tuple[str, ...]) -> Path:
    sections = []
    keep = True
    for line in EDS_PATH.read_text(encoding="ascii").splitlines():
        if line.startswith("["):
            keep = not line[1:].startswith(indices)
        if keep and not any(line.endswith(f"=0x{index}") for index in indices):
            sections.append(line)
    path = folder / "four.eds"
    path.write_text("\n".join(sections), encoding="ascii")
    return path


def test_pdos_are_sent_on_change_data_first_controlword_last_and_refreshed(plant: Plant) -> None:
    plant.power_on()
    client = plant.connect(Operation.POSITIONING, initial_mode=None)
    plant.online()
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


def test_nothing_is_sent_before_the_drive_is_online(plant: Plant) -> None:
    client = plant.connect()
    sent: list[int] = []
    plant.network.listeners.append(lambda message: sent.append(message.arbitration_id))
    for now in range(3):
        client.send(DriveCommand(), now)
    assert not [can_id for can_id in sent if 0x200 <= can_id < 0x580]


def test_a_node_that_does_not_answer_is_told_and_found_later(plant: Plant) -> None:
    client = plant.connect()
    site.wait_for(lambda: "no answer from node 4" in client.status_text, "told")
    assert client.status is DriveStatus.OFFLINE
    with pytest.raises(Dsp402Error, match="offline"):
        site.result(client.submit(lambda drive: drive.read(0x1000)))
    plant.power_on()
    plant.online()


@pytest.mark.parametrize(
    ("address", "value", "message"),
    [
        ((0x1000, 0), 0x0002_0196, "profile 406.*a drive"),
        ((0x1018, 1), 0x1234, "vendor-ID 1018h/1.*00001234h.*as the EDS says"),
        ((0x1018, 2), 0x99, "product code 1018h/2"),
    ],
)
def test_a_node_of_another_type_is_refused_by_name(
    plant: Plant, address: tuple[int, int], value: int, message: str
) -> None:
    drive = site.drive(NODE)
    drive.node.values[address] = value
    plant.drive = drive
    drive.start()
    client = plant.connect(eds=EDS_PATH)
    site.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
    assert re.search(message, client.status_text), client.status_text
    assert [event.kind for event in plant.events][-1] == "refused"


class _Stubborn(SimulatedDriveNode):
    """Refuses to guard the gateway."""

    def on_written(self, entry: Entry, value: Value) -> None:
        if entry.index == 0x6007:
            raise SdoAbortedError(Abort.READ_ONLY)
        super().on_written(entry, value)


@pytest.mark.parametrize("allowed", [False, True])
def test_a_drive_that_refuses_6007h_is_not_operated_unless_configured(plant: Plant, allowed: bool) -> None:
    drive = site.drive(NODE)
    drive.node = _Stubborn(NODE, drive._send)
    plant.drive = drive
    drive.start()
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
    client = plant.connect()
    plant.online()
    drive.do(lambda node: node.power_off())
    site.wait_for(lambda: client.status is DriveStatus.LOST, "lost")
    assert "heartbeat" in client.status_text or "TPDO1" in client.status_text
    assert client.refresh(site.now()) is False
    drive.do(lambda node: node.start(node.now))
    plant.online(2)


def test_a_restart_of_the_drive_is_noticed_and_configured_again(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connect()
    plant.online()
    drive.do(lambda node: node.receive(0, bytes((0x81, NODE)), node.now))
    plant.online(2)
    assert "boot" in [event.kind for event in plant.events]
    assert drive.node.read(0x1016, 1) == 127 << 16 | 300
    assert client.drive_type is not None
    assert client.drive_type.scaling == engel().scaling


def test_emergencies_are_passed_on_with_their_code(plant: Plant) -> None:
    drive = plant.power_on()
    plant.connect()
    plant.online()
    drive.inject(4)
    site.wait_for(lambda: any(event.kind == "emcy" for event in plant.events), "EMCY")
    event = next(event for event in plant.events if event.kind == "emcy")
    assert (event.code, event.register) == (0x3210, 0x05)


def test_jobs_run_beside_the_exchange_and_report_their_own_errors(plant: Plant) -> None:
    plant.power_on()
    client = plant.connect()
    plant.online()
    assert site.result(client.submit(lambda drive: drive.read(0x1008))) == b"ENGEL HBI"
    with pytest.raises(Exception, match="0602"):
        site.result(client.submit(lambda drive: drive.read(0x5000)))
    blocked = Event(client.loop)
    slow = client.submit(lambda drive: blocked.wait(5000 * MS))
    assert client.refresh(site.now())
    blocked.set()
    assert site.result(slow)


def test_a_short_tpdo_is_counted_and_ignored(plant: Plant) -> None:
    plant.power_on()
    client = plant.connect()
    plant.online()
    client.refresh(0)
    before = client.feedback.statusword
    slot = client._slots[0]
    slot.receive(b"\x37", 1)
    client.refresh(0)
    assert client.feedback.statusword == before
    assert client.length_errors == 1


def test_telegram_change_maps_the_pdos_anew(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connect()
    plant.online()
    client.reconfigure(LAYOUTS[Operation.POSITIONING], DriveSettings(NODE, sdo_timeout_ms=200))
    plant.online(2)
    assert drive.node.read(0x1600, 0) == 3
    assert drive.node.read(0x1601, 1) == 0x6081_0020


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


def _observe(plant: Plant) -> list[tuple[int, int, bytes]]:
    """SDO downloads (index, subindex, data) and NMT commands (0, 0, data) in the order they appear on the bus."""
    seen: list[tuple[int, int, bytes]] = []

    def record(message: can.Message) -> None:
        data = bytes(message.data)
        if message.is_rx:
            return
        if message.arbitration_id == 0:
            seen.append((0, 0, data))
        elif message.arbitration_id == 0x600 + NODE and data[0] >> 5 == 1:
            size = 4 - (data[0] >> 2 & 3)
            seen.append((int.from_bytes(data[1:3], "little"), data[3], data[4 : 4 + size]))

    plant.network.listeners.append(record)
    return seen


def test_the_order_of_the_start_up_on_the_bus(plant: Plant) -> None:
    plant.power_on().node.values[0x1600, 2] = 0x6071_0010
    seen = _observe(plant)
    plant.connect(Operation.VELOCITY)
    plant.online()
    assert seen[0] == (0, 0, bytes((0x80, NODE)))
    assert seen[-1] == (0, 0, bytes((0x01, NODE)))
    assert [step for step in seen if not step[0]] == [seen[0], seen[-1]]
    assert [(index, sub, data.hex()) for index, sub, data in seen if index in {0x1400, 0x1600}] == [
        (0x1400, 1, "04020080"),
        (0x1600, 0, "00"),
        (0x1600, 1, "2000ff60"),
        (0x1600, 2, "10004060"),
        (0x1600, 0, "02"),
        (0x1400, 2, "ff"),
        (0x1400, 1, "04020000"),
    ]
    assert [index for index, _, _ in seen][-5:] == [0x1016, 0x6007, 0x1017, 0x6060, 0]
    assert {index for index, sub, data in seen if sub == 1 and 0x1400 <= index < 0x1A00 and data[-1:] == b"\x80"} >= {
        0x1401, 0x1402, 0x1403, 0x1404, 0x1801, 0x1802, 0x1803, 0x1804,
    }  # fmt: skip


def test_four_pdos_are_found_even_if_the_eds_promises_five(plant: Plant) -> None:
    drive = plant.power_on(pdos=4)
    client = plant.connect(Operation.TRANSPARENT, initial_mode=None)
    plant.online()
    command = DriveCommand()
    command.digital_outputs = 0x0003_0000
    client.send(command, 1)
    site.wait_for(lambda: drive.model.digital_outputs == 0x0003_0000, "outputs written by SDO")


class _Lacking(SimulatedDriveNode):
    """Says of one object that it does not exist, or refuses to write it."""

    read_lacks = 0
    write_lacks = 0

    def entry(self, index: int, subindex: int) -> Entry:
        if index == self.read_lacks:
            raise SdoAbortedError(Abort.NO_SUCH_OBJECT)
        return super().entry(index, subindex)

    def on_written(self, entry: Entry, value: Value) -> None:
        if entry.index == self.write_lacks:
            raise SdoAbortedError(Abort.READ_ONLY)
        super().on_written(entry, value)


def _lacking(plant: Plant, *, read: int = 0, write: int = 0) -> SimulatedDrive:
    drive = site.drive(NODE)
    node = _Lacking(NODE, drive._send)
    node.read_lacks, node.write_lacks = read, write
    drive.node = node
    plant.drive = drive
    drive.start()
    return drive


@pytest.mark.parametrize("index", [0x1018, 0x6098])
def test_an_object_the_eds_promises_and_the_drive_lacks_is_named(plant: Plant, index: int) -> None:
    _lacking(plant, read=index)
    client = plant.connect()
    site.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
    assert f"{index:04X}h/" in client.status_text
    assert "object does not exist" in client.status_text


def test_a_scaling_the_drive_does_not_tell_is_refused_and_the_key_that_gives_it_named(
    plant: Plant, tmp_path: Path
) -> None:
    _lacking(plant, read=0x6094)
    client = plant.connect(eds=_eds_without(tmp_path, ("6094",)))
    plant.online()
    assert client.drive_type is not None
    assert "velocity_unit settles it" in client.drive_type.scaling.refusal(Quantity.SPEED)
    assert client.drive_type.scaling.refusal(Quantity.ACCELERATION, Quantity.DECELERATION, Quantity.POSITION) == ""


def test_a_drive_of_an_unknown_vendor_needs_no_eds_and_says_what_its_scaling_lacks(plant: Plant) -> None:
    plant.power_on().node.values[0x1018, 1] = 0x1234
    client = plant.connect()
    plant.online()
    assert client.drive_type is not None
    assert (client.drive_type.name, client.drive_type.family) == ("ENGEL HBI", "")
    assert {*client.drive_type.modes} == {Mode.POSITION, Mode.VELOCITY, Mode.TORQUE, Mode.HOMING}
    assert "6094h alone does not tell the unit" in client.drive_type.scaling.refusal(Quantity.SPEED)
    assert 0x2003 not in client.dictionary


def test_a_drive_that_was_exchanged_for_another_one_is_refused(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connect()
    plant.online()
    drive.do(lambda node: node.values.__setitem__((0x1018, 2), 0x77))
    drive.do(lambda node: node.start(site.now()))
    site.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
    assert "00000400h, 00000077h" in client.status_text
    assert "as at the first start" in client.status_text


@pytest.mark.parametrize("more", [{"family": "engel"}, {"units": UnitKeys(velocity_unit="0.5 rpm")}])
def test_the_configuration_settles_the_scaling_of_a_drive_of_an_unknown_vendor(
    plant: Plant, more: dict[str, object]
) -> None:
    plant.power_on().node.values[0x1018, 1] = 0x1234
    client = plant.connect(**more)
    plant.online()
    assert client.drive_type is not None
    assert client.drive_type.scaling.reference(Quantity.SPEED) == 6000


@pytest.mark.parametrize("allowed", [False, True])
def test_guarding_that_is_refused(plant: Plant, allowed: bool) -> None:
    _lacking(plant, write=0x1016)
    client = plant.connect(allow_unguarded=allowed, heartbeat_ms=10)
    if allowed:
        plant.online()
        return
    site.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
    assert "the drive guards the gateway" in client.status_text
    assert "1016h" in client.status_text
    assert client.refresh(site.now()) is False


def test_a_drive_without_a_heartbeat_of_its_own_is_guarded_and_watched_by_its_tpdos(plant: Plant) -> None:
    _lacking(plant, write=0x1017)
    client = plant.connect(heartbeat_ms=10)
    plant.online()
    assert client.guarding is not None
    assert "told by its TPDOs alone" in client.guarding.text
    seen = plant.network.received
    site.wait_for(lambda: plant.network.received > seen + 10, "TPDOs for many heartbeat times")
    assert (client.status, client.generation) == (DriveStatus.ONLINE, 1)


def test_a_mode_the_drive_does_not_take_is_named(plant: Plant) -> None:
    _lacking(plant, write=0x6060)
    client = plant.connect()
    site.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
    assert "6060h/" in client.status_text


def test_a_pdo_whose_mapping_cannot_be_written_is_left_for_another_one(plant: Plant) -> None:
    drive = _lacking(plant, write=0x1600)
    drive.node.values |= {(0x1600, 0): 1, (0x1600, 1): 0x60FE_0120}
    client = plant.connect()
    plant.online()
    assert client.plan is not None
    assert client.plan.lines[0] == "RPDO2 304h: Target Velocity 60FFh, Controlword 6040h"


def test_a_refused_drive_is_tried_at_once_with_another_telegram(plant: Plant) -> None:
    _lacking(plant, write=0x6060)
    client = plant.connect(Operation.VELOCITY)
    site.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
    begin = site.now()
    client.reconfigure(LAYOUTS[Operation.POSITIONING], DriveSettings(NODE, sdo_timeout_ms=200))
    plant.online()
    assert site.now() - begin < 2 * SECOND, "not with the next try, which is 5 s after the refusal"


def test_a_broken_sdo_answer_is_refused_and_the_task_lives(plant: Plant) -> None:
    bus = site.other()
    client = plant.connect()
    plant.network.listeners.append(
        lambda m: bus.send(0x580 + NODE, b"") if m.arbitration_id == 0x600 + NODE and plant.drive is None else None
    )
    site.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
    assert "cannot be decoded" in client.status_text
    plant.power_on()
    plant.online()


def test_a_short_tpdo_is_no_sign_of_life(plant: Plant) -> None:
    plant.power_on()
    client = plant.connect()
    plant.online()
    slot = client._slots[0]
    seen = slot.time
    slot.receive(b"\x37", seen + 1000 * MS)
    assert slot.time < seen + 1000 * MS


def test_a_waiting_job_fails_when_the_drive_is_lost(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connect()
    plant.online()
    running, release = Event(client.loop), Event(client.loop)

    def hold(_drive: DriveClient) -> None:
        running.set()
        release.wait()

    client.submit(hold)
    site.wait_for(running.is_set, "held")
    waiting = [client.submit(lambda drive: drive.read(0x1000)) for _ in range(3)]
    drive.do(lambda node: node.power_off())
    site.wait_for(lambda: not client.refresh(site.now()), "overdue, seen although the task is busy")
    release.set()
    for job in waiting:
        # The first may still be taken and time out; none waits for ever.
        site.wait_for(job.done, "answered")
        assert job.exception(0) is not None


def test_a_stopped_client_leaves_the_bus_to_its_successor(plant: Plant) -> None:
    plant.power_on()
    first = plant.connect()
    plant.online()
    blocked = Event(first.loop)
    first.submit(lambda drive: blocked.wait(200 * MS))
    waiting = first.submit(lambda drive: drive.read(0x1000))
    first.stop()
    first.stop()
    assert waiting.done()
    plant.connect(Operation.POSITIONING, initial_mode=None)
    plant.online()
    assert first.generation == 1
    assert first.status is DriveStatus.OFFLINE


def test_a_dead_node_does_not_hold_up_the_other_drive(plant: Plant) -> None:
    plant.power_on()
    dead = DriveClient(
        plant.network, DriveSettings(9, sdo_timeout_ms=500), LAYOUTS[Operation.VELOCITY], plant.events.append
    )
    dead.start()
    client = plant.connect()
    plant.online()
    assert site.result(client.submit(lambda drive: drive.read_number(0x1000))) == 0x0002_0192
    assert dead.status is DriveStatus.OFFLINE
    dead.stop()


def test_sync_lets_the_tpdos_wait_for_the_cycle(plant: Plant) -> None:
    drive = plant.power_on()
    loop, cycling = plant.network.loop, True

    def cycle() -> None:
        if cycling:
            plant.network.send_sync()
            loop.call_later(5 * MS, cycle)

    cycle()
    client = plant.connect(sync=True)
    plant.online()
    assert drive.node.read(0x1800, 2) == 1
    cycling = False
    site.wait_for(lambda: client.status is DriveStatus.LOST, "lost without SYNC")
    assert "TPDO1" in client.status_text


# -- a node whose heartbeat is dead ------------------------------------------------------------------------------------


def test_a_drive_without_heartbeat_never_becomes_online(plant: Plant) -> None:
    drive = plant.power_on()
    drive.do(lambda node: node.misbehave("heartbeat-stops"))
    client = plant.connect()
    site.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
    assert re.search("heartbeat of node 4.*says operational.*1 s of NMT start", client.status_text)
    assert client.generation == 0
    site.wait_for(lambda: drive.node.state is NmtState.PRE_OPERATIONAL, "obeys and sends no PDOs")


def test_a_drive_whose_heartbeat_dies_is_lost_once_and_told_once(plant: Plant) -> None:
    drive = plant.power_on()
    plant.connect(heartbeat_ms=20, heartbeat_factor=5)
    plant.online()
    starts = _starts(plant)
    drive.do(lambda node: node.misbehave("heartbeat-stops"))
    site.wait_for(lambda: starts() >= 3, "brought up again and again", 60)
    assert [event.text for event in plant.events if "online" in event.text] == ["online: operational, configuration 1"]
    assert len([event for event in plant.events if event.text.startswith("lost")]) == 1
    assert len({event.text for event in plant.events if event.kind == "refused"}) == 1, "one text is one fault"
    drive.do(lambda node: node.behave())
    plant.online(2)


def _starts(plant: Plant) -> Callable[[], int]:
    """How often NMT start was sent since."""
    seen = _observe(plant)
    return lambda: seen.count((0, 0, bytes((NmtCommand.START, NODE))))


def test_a_heartbeat_from_before_nmt_start_is_none(plant: Plant) -> None:
    """The node answers everything but does not go into operation as its heartbeat tells it."""
    drive = plant.power_on()
    stuck = bytes((NmtState.PRE_OPERATIONAL,))
    send = drive.node.send
    drive.node.send = lambda can_id, data: send(can_id, stuck if can_id == 0x700 + NODE and data != b"\0" else data)
    client = plant.connect()
    site.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
    assert "none that says operational" in client.status_text


# -- a drive whose PDOs are fixed --------------------------------------------------------------------------------------


class _Fixed(SimulatedDriveNode):
    """Its PDO parameters are the manufacturer's and read-only."""

    fixed: Collection[int] = range(0x1400, 0x1C00)

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        if index in self.fixed:
            raise SdoAbortedError(Abort.READ_ONLY)
        super().set_data(index, subindex, data, check_writable)


def _fixed(plant: Plant, operation: Operation, values: dict[tuple[int, int], int]) -> SimulatedDrive:
    """A drive whose PDOs are made for an operation, but for ``values``; its other PDOs cannot be switched off."""
    drive = site.drive(NODE)
    node = _Fixed(NODE, drive._send)
    layout = engel_layout(operation)
    available = [d.communication_index + n for d in PdoDirection for n in range(5)]
    for step in pdo_steps(layout, NODE, available, sync=False, event_ms=50, inhibit_us=0):
        node.values[step.index, step.subindex] = step.value
    node.values[0x1801, 1] = 0x284
    node.values |= values
    node.pdos.map()
    drive.node = node
    plant.drive = drive
    drive.start()
    return drive


@pytest.mark.parametrize("operation", list(Operation))
@pytest.mark.parametrize(
    "values",
    [{}, {(0x1800, 1): 0x4000_0184, (0x1400, 2): 254, (0x1800, 2): 254}],
    ids=["as wanted", "no remote request, type 254"],
)
def test_fixed_pdos_that_are_as_wanted_are_used(
    plant: Plant, operation: Operation, values: dict[tuple[int, int], int]
) -> None:
    drive = _fixed(plant, operation, values)
    client = plant.connect(operation, initial_mode=None)
    plant.online()
    command = DriveCommand()
    command.controlword = 0x06
    client.send(command, 1)
    site.wait_for(lambda: drive.model.controlword == 0x06, "RPDO 1 is heard")
    site.wait_for(lambda: client.refresh(0) is not None and client.feedback.statusword & 0x6F == 0x21, "ready")


@pytest.mark.parametrize(("mapped", "writes"), [(0x60FF_0020, 0), (0x6071_0010, 4)])
def test_a_mapping_the_drive_has_already_is_not_written_again(plant: Plant, mapped: int, writes: int) -> None:
    plant.power_on().node.values |= {(0x1600, 1): mapped, (0x1600, 2): 0x6040_0010}
    seen = _observe(plant)
    plant.connect(Operation.VELOCITY)
    plant.online()
    assert len([index for index, _, _ in seen if index == 0x1600]) == writes


@pytest.mark.parametrize(
    ("address", "value", "text"),
    [
        ((0x1600, 1), 0x6071_0010, "no RPDO for Controlword 6040h: fixed are 1600h with 6071h, 6040h"),
        ((0x1A00, 1), 0x6064_0020, "no TPDO for Statusword 6041h: fixed are 1A00h with 6064h, 606Ch"),
        ((0x1400, 1), 0x8000_0204, "no RPDO for Controlword 6040h"),
        ((0x1801, 1), 0x285, "TPDO2 unused (1801h/1 := 80000284h)"),
    ],
)
def test_fixed_pdos_that_do_not_carry_what_is_needed_are_named(
    plant: Plant, address: tuple[int, int], value: int, text: str
) -> None:
    _fixed(plant, Operation.VELOCITY, {address: value})
    client = plant.connect()
    site.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
    assert text in client.status_text


@pytest.mark.parametrize(
    ("address", "value", "line"),
    [
        ((0x1A00, 0), 1, "read by SDO every 100 ms: Velocity Actual Value 606Ch"),
        ((0x1400, 1), 0x244, "RPDO1 244h: Target Velocity 60FFh, Controlword 6040h; its own COB-ID"),
        (
            (0x1800, 5),
            500,
            "TPDO1 on change alone: neither event timer nor SYNC can be set; heartbeat and SDO watch it",
        ),
    ],
)
def test_fixed_pdos_that_carry_what_is_needed_are_adopted_as_they_are(
    plant: Plant, address: tuple[int, int], value: int, line: str
) -> None:
    drive = _fixed(plant, Operation.VELOCITY, {address: value})
    client = plant.connect()
    plant.online()
    assert client.plan is not None
    assert line in client.plan.lines
    command = DriveCommand()
    command.controlword = 0x06
    client.send(command, 1)
    site.wait_for(lambda: drive.model.controlword == 0x06, "the Controlword is heard")
    site.wait_for(lambda: client.refresh(0) is not None and client.feedback.statusword & 0x6F == 0x21, "ready")


# -- a drive with too few RPDOs: data by SDO first, then the set-point -------------------------------------------------


class TwoPdos:
    """A positioning drive with two RPDOs: 6083h and 6084h are written by SDO. Its set-points as the drive sees them."""

    def __init__(self, plant: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
        self.plant = plant
        self.drive = site.drive(NODE)
        self.drive.node.misbehave("two-pdos")
        plant.drive = self.drive
        self.drive.start()
        self.client = plant.connect(Operation.POSITIONING, initial_mode=None)
        plant.online()
        self.accelerations: list[int] = []
        """6083h at each rising edge of bit 4."""
        self.words: list[int] = []
        """The Controlwords sent."""
        self._bit = False
        self.command = DriveCommand()
        self.now = 0
        plant.network.listeners.append(self._listen)
        self.drive.do(lambda node: monkeypatch.setattr(node, "on_rpdo", self._on_rpdo))

    def _on_rpdo(self, pdo: Pdo) -> None:
        bit = bool(self.drive.model.controlword & ControlBit.NEW_SETPOINT)
        if bit and not self._bit:
            self.accelerations.append(self.drive.model.profile_acceleration)
        self._bit = bit

    def _listen(self, message: can.Message) -> None:
        if not message.is_rx and message.arbitration_id == 0x200 + NODE:
            self.words.append(int.from_bytes(message.data[-2:], "little"))

    def send(self, word: int, acceleration: int | None = None) -> None:
        self.command.controlword = word
        if acceleration is not None:
            self.command.profile_acceleration = acceleration
        self.now += 4 * MS
        self.client.send(self.command, self.now)

    def until(self, condition: Callable[[], object], what: str) -> None:
        def cycle() -> object:
            self.client.send(self.command, self.now)
            return condition()

        site.wait_for(cycle, what)

    @property
    def told(self) -> list[str]:
        return [event.text for event in self.plant.events if event.kind == "set-point"]


@pytest.fixture
def two_pdos(plant: Plant, monkeypatch: pytest.MonkeyPatch) -> TwoPdos:
    return TwoPdos(plant, monkeypatch)


START, ENABLED = 0x003F, 0x002F


def test_a_set_point_starts_with_its_own_data_although_that_goes_by_sdo(two_pdos: TwoPdos) -> None:
    two_pdos.drive.do(lambda node: node.misbehave("slow-sdo", delay_ms=20))
    for acceleration in (100, 200, 300, 200):
        two_pdos.send(ENABLED)
        two_pdos.send(START, acceleration)
        count = len(two_pdos.accelerations)
        two_pdos.until(lambda count=count: len(two_pdos.accelerations) > count, "set-point")
    assert two_pdos.accelerations == [100, 200, 300, 200]
    assert two_pdos.told == []


def test_a_set_point_that_is_held_back_lets_stop_halt_and_acknowledge_pass(two_pdos: TwoPdos) -> None:
    two_pdos.drive.do(lambda node: node.misbehave("sdo-timeout"))
    two_pdos.send(ENABLED)
    for word in (START, START | ControlBit.HALT, 0x003B, 0x003D, 0x00BF, 0x0010):
        two_pdos.send(word, 100)
        assert two_pdos.words[-1] == word & ~ControlBit.NEW_SETPOINT
        assert two_pdos.command.controlword == word, "the image stays the stepper's"


def test_a_set_point_without_new_data_starts_at_once(two_pdos: TwoPdos) -> None:
    two_pdos.send(START, 100)
    two_pdos.until(lambda: two_pdos.accelerations, "set-point")
    two_pdos.send(ENABLED)
    two_pdos.send(START)
    assert two_pdos.words[-2:] == [ENABLED, START]
    two_pdos.send(START, 200)
    two_pdos.send(START | ControlBit.HALT)
    assert two_pdos.words[-1] == START | ControlBit.HALT, "no new edge, nothing to hold back"


def test_data_that_changes_to_and_fro_is_not_taken_for_written(two_pdos: TwoPdos) -> None:
    """The old value comes back while another one is being written: the drive must have it again before the start."""
    two_pdos.send(ENABLED, 100)
    two_pdos.until(lambda: two_pdos.drive.model.profile_acceleration == 100, "written")
    two_pdos.drive.do(lambda node: node.misbehave("slow-sdo", delay_ms=50))
    writing = _observe(two_pdos.plant)
    two_pdos.send(ENABLED, 900)
    site.wait_for(lambda: writing, "900 being written")
    two_pdos.send(START, 100)
    two_pdos.until(lambda: two_pdos.accelerations, "set-point")
    assert two_pdos.accelerations == [100]


def test_a_set_point_whose_data_is_refused_does_not_start_and_needs_a_new_edge(two_pdos: TwoPdos) -> None:
    two_pdos.send(ENABLED)
    two_pdos.send(START, 0xFFFF_FFFF)
    two_pdos.until(lambda: two_pdos.client.set_point_refused, "refused")
    assert re.fullmatch("not started: .*6083h: .*value.*", two_pdos.told[0])
    two_pdos.send(START, 500)
    two_pdos.until(lambda: two_pdos.drive.model.profile_acceleration == 500, "good data taken")
    two_pdos.send(START)
    assert (two_pdos.accelerations, two_pdos.words[-1]) == ([], ENABLED)
    two_pdos.send(ENABLED)
    assert not two_pdos.client.set_point_refused
    two_pdos.send(START)
    two_pdos.until(lambda: two_pdos.accelerations == [500], "set-point")
    assert len(two_pdos.told) == 1


def test_a_refused_set_point_may_be_given_again_with_the_same_data(two_pdos: TwoPdos) -> None:
    two_pdos.drive.do(lambda node: node.misbehave("sdo-timeout"))
    two_pdos.send(START, 100)
    two_pdos.until(lambda: two_pdos.client.set_point_refused, "no answer")
    assert "6083h" in two_pdos.told[0]
    two_pdos.drive.do(lambda node: node.behave())
    two_pdos.send(ENABLED)
    two_pdos.send(START)
    two_pdos.until(lambda: two_pdos.accelerations == [100], "set-point")


def test_the_wait_for_the_data_of_a_set_point_is_bounded(two_pdos: TwoPdos) -> None:
    release, running = Event(two_pdos.client.loop), Event(two_pdos.client.loop)

    def hold(_: DriveClient) -> None:
        running.set()
        release.wait()

    two_pdos.client.submit(hold)
    site.wait_for(running.is_set, "held")
    two_pdos.send(START, 100)
    two_pdos.now += 596 * MS
    two_pdos.send(START)
    assert two_pdos.told == []
    two_pdos.send(START)
    assert two_pdos.told == ["not started: data not written within 600 ms"]
    release.set()
    two_pdos.until(lambda: two_pdos.drive.model.profile_acceleration == 100, "written at last")
    two_pdos.send(START)
    assert two_pdos.accelerations == [], "too late is not at all"


class _PartlyFull:
    """A port that may take no frame of one identifier."""

    def __init__(self, refused: int) -> None:
        self.refused = refused
        self.full = True
        self.sent: list[tuple[int, bytes]] = []

    def send(self, can_id: int, data: bytes) -> None:
        if self.full and can_id == self.refused:
            raise PortBusyError
        self.sent.append((can_id, data))

    def close(self) -> None:
        """Nothing to release."""


def test_a_set_point_waits_for_an_rpdo_that_the_bus_did_not_take(plant: Plant) -> None:
    plant.power_on()
    client = plant.connect(Operation.POSITIONING, initial_mode=None)
    plant.online()
    command = DriveCommand()
    command.controlword = ENABLED
    client.send(command, 1)
    before = plant.network._port
    plant.network._port = port = _PartlyFull(0x300 + NODE)  # type: ignore[assignment]
    command.controlword = START
    command.profile_velocity = 77
    client.send(command, 2)
    assert port.sent == []
    port.full = False
    client.send(command, 3)
    data, edge = port.sent
    assert (data[0], data[1][:2], edge[0], edge[1][-2:]) == (0x300 + NODE, b"\x4d\0", 0x200 + NODE, b"\x3f\0")
    port.full = True
    command.profile_velocity = 78
    port.sent.clear()
    client.send(command, 4)
    assert port.sent == [], "the edge was there: it is not taken back"
    plant.network._port = before


# -- what a node's task must not do for ever --------------------------------------------------------------------------------


def test_values_that_cannot_be_read_any_more_are_a_loss(plant: Plant) -> None:
    """With two TPDOs most of telegram 100 is read by SDO: old values must not be shown as good."""
    drive = site.drive(NODE)
    drive.node.misbehave("two-pdos")
    plant.drive = drive
    drive.start()
    client = plant.connect(Operation.TRANSPARENT, initial_mode=None, sdo_timeout_ms=50)
    plant.online()
    drive.do(lambda node: node.misbehave("sdo-timeout"))
    site.wait_for(lambda: client.status is not DriveStatus.ONLINE, "lost")
    assert any("lost: objects without PDO could not be read 3 times" in event.text for event in plant.events)
    drive.do(lambda node: node.behave("sdo-timeout"))
    plant.online(2)


def test_an_sdo_answer_that_does_not_end_does_not_hold_the_task(plant: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pdgw.ds301.sdo._LONGEST_UPLOAD", 100)
    drive = plant.power_on()
    client = plant.connect()
    plant.online()
    receive = drive.node.receive
    toggles = {0x60: b"\0", 0x70: b"\x10"}

    def segments(can_id: int, data: bytes, now: int) -> None:
        if can_id == 0x600 + NODE and data[0] in toggles:
            drive.node.send(0x580 + NODE, toggles[data[0]] + b"endless")
        else:
            receive(can_id, data, now)

    monkeypatch.setattr(drive.node, "receive", segments)
    with pytest.raises(SdoCommunicationError, match="1008h/0 does not end"):
        site.result(client.submit(lambda drive: drive.read(0x1008)))
    assert site.result(client.submit(lambda drive: drive.read_number(0x1000))) == 0x0002_0192


def test_a_number_is_as_long_as_the_eds_says(plant: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = plant.power_on()
    client = plant.connect()
    plant.online()
    send = drive.node.send
    # Without a size in the answer a number comes with all four bytes of the frame.
    sizeless = b"\x42\x17\x10\0\x64\0\xff\xff"
    monkeypatch.setattr(
        drive.node, "send", lambda can_id, data: send(can_id, sizeless if data[1:4] == sizeless[1:4] else data)
    )
    assert site.result(client.submit(lambda drive: drive.read(0x1017))) == b"\x64\0"


def test_the_late_answer_to_a_write_that_was_given_up_does_not_confirm_the_next(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = plant.power_on()
    client = plant.connect()
    plant.online()
    send = drive.node.send
    held: list[bytes] = []

    def late(can_id: int, data: bytes) -> None:
        """The first answer waits for the second."""
        if can_id != 0x580 + NODE:
            send(can_id, data)
        elif not held:
            held.append(data)
        else:
            send(can_id, held[0])
            send(can_id, data)

    monkeypatch.setattr(drive.node, "send", late)
    with pytest.raises(SdoCommunicationError):
        site.result(client.submit(lambda drive: drive.write(0x6083, 0, b"\x64\0\0\0")))
    with pytest.raises(SdoAbortedError):
        site.result(client.submit(lambda drive: drive.write(0x6084, 0, b"\xff\xff\xff\xff")))


@pytest.mark.parametrize("pdos", [1, 4])
def test_any_frame_under_the_identifiers_of_the_node_is_survived(plant: Plant, pdos: int) -> None:
    drive = site.drive(NODE)
    drive.node.misbehave("two-pdos", pdos=pdos)
    plant.drive = drive
    drive.start()
    client = plant.connect(Operation.TRANSPARENT, initial_mode=None, sdo_timeout_ms=20)
    plant.online()
    bus = site.other()
    random = Random(pdos)
    command = DriveCommand()
    for _ in range(2000):
        can_id = random.choice([0x80, 0x180, 0x280, 0x380, 0x480, 0x1C0, 0x580, 0x580, 0x700]) + NODE
        data = random.randbytes(random.choice([0, 1, 2, 3, 4, 7, 8, 8, 8]))
        bus.send(can_id, data)
        command.digital_outputs = command.target_position = random.getrandbits(16)
        client.send(command, site.now())
        client.refresh(site.now())
        site.play(MS)

    # What is still on its way may spoil an answer, or have the node lost and brought up again.
    def answers() -> bool:
        job = client.submit(lambda drive: drive.read_number(0x1000))
        site.wait_for(job.done, "an answer or an error")
        return job.exception(0) is None

    site.wait_for(answers, "answers", 30)
    site.wait_for(lambda: client.refresh(site.now()), "online and fresh", 30)
    assert client.loop.task_errors == 0
