"""The drive client on a virtual bus: start-up order, what it refuses, what it notices."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from canopen.sdo import SdoAbortedError

from ds301.aborts import Abort
from ds301.bus import open_bus
from ds301.errors import CanopenError
from ds301.network import CanNetwork
from ds301.objects import Entry
from ds301.pdo import COB_ID_INVALID, PdoDirection
from ds301.simulator import Value
from dsp402.configuration import pdo_steps
from dsp402.device import EDS_PATH
from dsp402.drive import DriveClient, DriveEvent, DriveSettings, DriveStatus, load_eds
from dsp402.errors import Dsp402Error
from dsp402.images import DriveCommand, References
from dsp402.modes import Mode
from dsp402.pdo import LAYOUTS, Operation
from dsp402.simulator import SimulatedDrive, SimulatedDriveNode
from tests.support import buses

NODE = 4
MS = 1_000_000


class Plant:
    """A client and a simulated drive on one bus; ``prepare`` changes the drive before it is switched on."""

    def __init__(self, network: CanNetwork, name: str) -> None:
        self.network = network
        self.name = name
        self.events: list[DriveEvent] = []
        self.drive: SimulatedDrive | None = None
        self.client: DriveClient | None = None

    def power_on(self, pdos: int = 5) -> SimulatedDrive:
        self.drive = SimulatedDrive(buses.bus(self.name), NODE, pdos=pdos)
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
        buses.wait_for(
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
    name = buses.channel()
    with buses.guarded_network(name) as network:
        plant = Plant(network, name)
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
    assert client.references == References()
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
    buses.wait_for(lambda: client.refresh(0) is not None and client.feedback.statusword & 0x6F == 0x21, "ready")
    assert drive.model.controlword == 0x06


def test_a_drive_with_four_pdos_gets_the_rest_by_sdo(plant: Plant, tmp_path: Path) -> None:
    drive = plant.power_on(pdos=4)
    eds = _eds_without(tmp_path, ("1404", "1604", "1804", "1A04"))
    client = plant.connect(Operation.TRANSPARENT, initial_mode=None, eds=eds)
    plant.online()
    command = DriveCommand()
    command.digital_outputs = 0x0005_0000
    client.send(command, 1)
    buses.wait_for(lambda: drive.model.digital_outputs == 0x0005_0000, "outputs written by SDO")


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
    buses.wait_for(lambda: "no answer from node 4" in client.status_text, "told")
    assert client.status is DriveStatus.OFFLINE
    with pytest.raises(Dsp402Error, match="offline"):
        client.submit(lambda drive: drive.read(0x1000)).result(1)
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
    drive = SimulatedDrive(buses.bus(plant.name), NODE)
    drive.node.values[address] = value
    plant.drive = drive
    drive.start()
    client = plant.connect()
    buses.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
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
    drive = SimulatedDrive(buses.bus(plant.name), NODE)
    drive.node = _Stubborn(NODE, drive._send)
    plant.drive = drive
    drive.start()
    client = plant.connect(allow_unguarded=allowed)
    if allowed:
        plant.online()
        assert any("not guarded" in event.text for event in plant.events)
    else:
        buses.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
        assert "allow_unguarded" in client.status_text
        assert "read-only" in client.status_text


def test_a_silent_drive_is_lost_and_brought_back_without_a_start(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connect()
    plant.online()
    drive.do(lambda node: node.power_off())
    buses.wait_for(lambda: client.status is DriveStatus.LOST, "lost")
    assert "heartbeat" in client.status_text or "TPDO1" in client.status_text
    assert client.refresh(time.monotonic_ns()) is False
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
    assert client.references == References()


def test_emergencies_are_passed_on_with_their_code(plant: Plant) -> None:
    drive = plant.power_on()
    plant.connect()
    plant.online()
    drive.inject(4)
    buses.wait_for(lambda: any(event.kind == "emcy" for event in plant.events), "EMCY")
    event = next(event for event in plant.events if event.kind == "emcy")
    assert (event.code, event.register) == (0x3210, 0x05)


def test_jobs_run_beside_the_exchange_and_report_their_own_errors(plant: Plant) -> None:
    plant.power_on()
    client = plant.connect()
    plant.online()
    assert client.submit(lambda drive: drive.read(0x1008)).result(2) == b"ENGEL HBI"
    with pytest.raises(Exception, match="0602"):
        client.submit(lambda drive: drive.read(0x5000)).result(2)
    blocked = threading.Event()
    slow = client.submit(lambda drive: blocked.wait(5))
    assert client.refresh(time.monotonic_ns())
    blocked.set()
    assert slow.result(2)


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


class _FailingBus(can.BusABC):
    """A bus that is off."""

    def __init__(self) -> None:
        self.off = False
        super().__init__("failing")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.off:
            raise can.CanOperationError("bus-off")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        threading.Event().wait(0.001)
        return None, False


def test_a_bus_off_is_counted_and_turns_the_network_unhealthy() -> None:
    bus = _FailingBus()
    network = CanNetwork(bus)
    assert network.send(0x201, b"\0")
    bus.off = True
    assert not network.send(0x201, b"\0")
    assert (network.sent, network.send_errors, network.healthy) == (1, 1, False)
    network.close()
