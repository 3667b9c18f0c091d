"""The start-up of a drive: its order on the bus, what is missing and refused, heartbeats."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import can
import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.communication import SYNC_COUNTER, SYNC_PERIOD, NmtCommand, NmtState
from pdgw.ds301.loop.loop import Event
from pdgw.ds301.node.node import Notice
from pdgw.ds301.objects import Access, CanType, Entry
from pdgw.ds301.sdo_frames import ABORT
from pdgw.dsp402.drive.client import DriveClient, DriveStatus
from pdgw.dsp402.drive.images import DriveCommand
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.drive_type import Dsp402Error, Quantity
from pdgw.dsp402.identification.overlay import Families, overlay
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.dsp402.units.mechanics import UnitKeys
from pdgw.peers.drive import SimulatedDrive, SimulatedDriveNode, shape
from pdgw.peers.drive.objects import EDS_PATH
from pdgw.peers.node.node import Value
from tests.support.drives.drive_types import engel
from tests.support.drives.plant import NODE, Plant, eds_without, observe
from tests.support.gateways import site


def test_the_order_of_the_start_up_on_the_bus(plant: Plant) -> None:
    plant.power_on().node.values[0x1600, 2] = 0x6071_0010
    seen = observe(plant)
    plant.connected(Operation.VELOCITY)
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


def test_an_ignored_setpoint_range_is_reported_once_in_a_bring_up(plant: Plant, tmp_path: Path) -> None:
    plant.power_on()
    text = EDS_PATH.read_text(encoding="ascii")
    eds = tmp_path / "forbids-0.eds"
    before, section, after = text.partition("[60FF]")
    eds.write_text(before + section + after.replace("LowLimit=-32767", "LowLimit=100", 1), encoding="ascii")
    plant.connected(Operation.VELOCITY, eds=eds)
    assert [event.text for event in plant.events if "forbids" in event.text] == [
        "60FFh: the range 100..32767 in the data sheet forbids the setpoint 0: ignored, the range of the data type is used"
    ]


def test_no_rpdo_is_sent_in_any_cycle_before_the_configuration(plant: Plant) -> None:
    plant.power_on()
    client = plant.connect(Operation.VELOCITY)
    statuses: list[DriveStatus] = []

    def listen(message: can.Message) -> None:
        if not message.is_rx and message.arbitration_id == 0x200 + NODE:
            statuses.append(client.status)

    def cycle() -> bool:
        client.send(DriveCommand(), site.now())
        return bool(statuses)

    plant.network.listeners.append(listen)
    site.wait_for(cycle, "the first RPDO")
    assert statuses == [DriveStatus.ONLINE]


def test_four_pdos_are_found_even_if_the_eds_has_five(plant: Plant) -> None:
    drive = plant.power_on(pdos=4)
    client = plant.connected(Operation.TRANSPARENT, initial_mode=None)
    command = DriveCommand()
    command.digital_outputs = 0x0003_0000
    client.send(command, 1)
    site.wait_for(lambda: drive.model.digital_outputs == 0x0003_0000, "outputs written by SDO")


class _Lacking(SimulatedDriveNode):
    """Says of one object that it does not exist, or refuses to write it."""

    read_lacks = 0
    write_lacks = 0
    abort = Abort.NO_SUCH_OBJECT
    aborts = 1 << 30
    """Number of its reads that fail."""

    def entry(self, index: int, subindex: int) -> Entry:
        if index == self.read_lacks and self.aborts:
            self.aborts -= 1
            raise SdoAbortedError(self.abort)
        return super().entry(index, subindex)

    def on_written(self, entry: Entry, value: Value) -> None:
        if entry.index == self.write_lacks:
            raise SdoAbortedError(Abort.READ_ONLY)
        super().on_written(entry, value)


def _lacking(plant: Plant, *, read: int = 0, write: int = 0) -> SimulatedDrive:
    drive = plant.power_on(_Lacking)
    assert isinstance(drive.node, _Lacking)
    drive.node.read_lacks, drive.node.write_lacks = read, write
    return drive


def test_an_optional_object_the_eds_promises_and_the_drive_lacks_is_not_used(plant: Plant) -> None:
    _lacking(plant, read=0x6084)
    client = plant.connect(Operation.POSITIONING)
    site.wait_for(lambda: client.generation, "online")
    assert client.plan is not None
    assert "profile_deceleration" not in {entry.attribute for entry in client.plan.commanded}
    assert any("6084h not available" in line for line in client.plan.lines)


def test_an_optional_object_that_cannot_be_read_now_is_not_missing(plant: Plant) -> None:
    drive = _lacking(plant, read=0x6084)
    assert isinstance(drive.node, _Lacking)
    drive.node.abort, drive.node.aborts = Abort.CANNOT_STORE_DEVICE_STATE, 1
    client = plant.connect(Operation.POSITIONING)
    site.wait_for(lambda: client.generation, "online")
    assert client.plan is not None
    assert "profile_deceleration" in {entry.attribute for entry in client.plan.commanded}


@pytest.mark.parametrize("index", [0x6094, 0x607B])
def test_unit_that_cannot_be_read_now_is_not_missing(plant: Plant, index: int) -> None:
    drive = _lacking(plant, read=index)
    assert isinstance(drive.node, _Lacking)
    drive.node.abort, drive.node.aborts = Abort.CANNOT_STORE_DEVICE_STATE, 1
    client = plant.connect()
    assert f"object {index:04X}h/" in plant.refused()
    plant.online()
    assert client.drive_type is not None
    assert client.drive_type.scaling == engel().scaling


@pytest.mark.parametrize("index", [0x1018, 0x6098])
def test_an_object_the_eds_promises_and_the_drive_lacks_is_named(plant: Plant, index: int) -> None:
    _lacking(plant, read=index)
    plant.connect()
    text = plant.refused()
    assert f"{index:04X}h/" in text
    assert "object does not exist" in text


def test_unknown_scaling_is_rejected_with_the_key_to_set(plant: Plant, tmp_path: Path) -> None:
    _lacking(plant, read=0x6094)
    client = plant.connect(eds=eds_without(tmp_path, ("6094",)))
    plant.online()
    assert client.drive_type is not None
    assert "set velocity_unit" in client.drive_type.scaling.refusal(Quantity.SPEED)
    assert client.drive_type.scaling.refusal(Quantity.ACCELERATION, Quantity.DECELERATION, Quantity.POSITION) == ""


def test_unknown_vendor_needs_no_eds_and_missing_scaling_is_named(plant: Plant) -> None:
    plant.power_on().node.values[0x1018, 1] = 0x1234
    client = plant.connected()
    assert client.drive_type is not None
    assert (client.drive_type.name, client.drive_type.family) == ("ENGEL HBI", "")
    assert {*client.drive_type.modes} == {Mode.POSITION, Mode.VELOCITY, Mode.TORQUE, Mode.HOMING}
    assert "6094h alone does not define the unit" in client.drive_type.scaling.refusal(Quantity.SPEED)
    assert 0x2003 not in client.sdo.dictionary


def test_a_drive_that_was_exchanged_for_another_one_is_refused(plant: Plant) -> None:
    drive = plant.power_on()
    plant.connected()
    drive.do(lambda node: node.values.__setitem__((0x1018, 2), 0x77))
    drive.do(lambda node: node.start(site.now()))
    text = plant.refused()
    assert "00000400h, 00000077h" in text
    assert "as at the first start" in text


def test_references_of_another_drive_are_not_used(plant: Plant) -> None:
    """A write to a reference reads them again: of a drive that shows another identity they stay as they were."""
    drive = plant.power_on()
    client = plant.connected()
    before = client.drive_type
    drive.do(lambda node: node.start_fault("wrong-identity"))
    with pytest.raises(Dsp402Error, match="as at the first start"):
        site.result(client.submit(lambda client: client.learn()))
    assert client.drive_type is before


@pytest.mark.parametrize(
    "more", [{"families": Families(named=overlay("engel"))}, {"units": UnitKeys(velocity_unit="0.5 rpm")}]
)
def test_configuration_defines_the_scaling_of_an_unknown_drive(plant: Plant, more: dict[str, object]) -> None:
    plant.power_on().node.values[0x1018, 1] = 0x1234
    client = plant.connected(**more)
    assert client.drive_type is not None
    assert client.drive_type.scaling.reference(Quantity.SPEED) == 6000


OPTION = (0x60F2, 0)


def _with_option(plant: Plant, value: int, *, access: Access = Access.RW) -> SimulatedDriveNode:
    node = plant.power_on().node
    node.entries = {**node.entries, OPTION: Entry(*OPTION, "Positioning option code", CanType.U16, access)}
    node.values[OPTION] = value
    return node


@pytest.mark.parametrize("value", [0x0000, 0x00C6, 0x0001])
def test_relative_tasks_begin_where_the_drive_is_and_not_at_an_old_target(plant: Plant, value: int) -> None:
    """60F2h.0-1 = 0 would begin at the last target, also after a reject or a jog."""
    node = _with_option(plant, value)
    client = plant.connect(Operation.POSITIONER, tasks=True)
    site.wait_for(lambda: client.generation, "online")
    assert node.values[OPTION] == value & ~3 | 1, "the other bits stay"


def test_other_telegrams_leave_the_positioning_option_to_the_drive(plant: Plant) -> None:
    node = _with_option(plant, 0)
    plant.connected(Operation.TRANSPARENT)
    assert node.values[OPTION] == 0


def test_positioning_option_that_the_drive_keeps_is_named(plant: Plant) -> None:
    _with_option(plant, 0, access=Access.RO)
    client = plant.connect(Operation.POSITIONER, tasks=True)
    site.wait_for(lambda: client.generation, "online")
    assert any("60F2h = 0" in event.text for event in plant.events)


@pytest.mark.parametrize("allowed", [False, True])
def test_rejected_guarding_rejects_the_drive(plant: Plant, allowed: bool) -> None:
    _lacking(plant, write=0x1016)
    client = plant.connect(allow_unguarded=allowed, heartbeat_ms=10)
    if allowed:
        plant.online()
        return
    text = plant.refused()
    assert "1016h: " in text
    assert "1016h" in text
    assert client.refresh(site.now()) is False


def test_drive_without_heartbeat_is_life_guarded_and_supervised_by_tpdos(plant: Plant) -> None:
    _lacking(plant, write=0x1017)
    client = plant.connected(heartbeat_ms=10)
    assert client.guarding is not None
    assert "monitors the node by its TPDOs only" in client.guarding.text
    seen = plant.network.received
    site.wait_for(lambda: plant.network.received > seen + 10, "TPDOs for many heartbeat times")
    assert (client.status, client.generation) == (DriveStatus.ONLINE, 1)


def test_rejected_mode_is_named(plant: Plant) -> None:
    _lacking(plant, write=0x6060)
    plant.connect()
    assert "6060h/" in plant.refused()


def test_pdo_with_a_fixed_mapping_is_replaced_by_another(plant: Plant) -> None:
    drive = _lacking(plant, write=0x1600)
    drive.node.values |= {(0x1600, 0): 1, (0x1600, 1): 0x60FE_0120}
    client = plant.connected()
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


def test_broken_sdo_answer_is_rejected_and_the_task_continues(plant: Plant) -> None:
    bus = site.other()
    plant.connect()
    plant.network.listeners.append(
        lambda m: bus.send(0x580 + NODE, b"") if m.arbitration_id == 0x600 + NODE and plant.drive is None else None
    )
    assert "cannot be decoded" in plant.refused()
    plant.power_on()
    plant.online()


def _lose_answers(plant: Plant, every: int) -> list[int]:
    """The drive's SDO answers with this distance are lost; returns the number of answers so far."""
    drive, answers = plant.power_on(), [0]
    send = drive.node.send

    def lossy(can_id: int, data: bytes) -> None:
        if can_id == 0x580 + NODE:
            answers[0] += 1
            if answers[0] % every == 0:
                return
        send(can_id, data)

    drive.node.send = lossy
    return answers


def test_a_lost_sdo_answer_does_not_end_the_bring_up(plant: Plant) -> None:
    answers = _lose_answers(plant, 10)
    begin = site.now()
    client = plant.connected()
    assert site.now() - begin < answers[0] // 10 * 3 * client.settings.sdo_timeout_ms * MS
    assert [event.text for event in plant.events if "no answer" in event.text] == []


def test_a_drive_that_ends_to_answer_is_asked_a_limited_time(plant: Plant) -> None:
    """Three requests, and the time for a late answer after each."""
    drive = plant.power_on()
    asked: list[int] = []

    def observe_request(message: can.Message) -> None:
        if (
            message.arbitration_id == 0x600 + NODE
            and message.data[0] != ABORT
            and bytes(message.data[1:3]) == b"\x16\x10"
        ):
            asked.append(site.now())

    plant.network.listeners.append(observe_request)
    send = drive.node.send
    drive.node.send = lambda can_id, data: None if asked and can_id == 0x580 + NODE else send(can_id, data)
    client = plant.connect()
    site.wait_for(lambda: client.status is DriveStatus.OFFLINE and asked, "no answer")
    assert len(asked) == 3
    assert site.now() - asked[0] < 6 * client.settings.sdo_timeout_ms * MS


def test_progress_of_the_configuration_names_object_and_number(plant: Plant) -> None:
    plant.power_on()
    client = plant.connect()
    seen: list[str] = []
    plant.network.listeners.append(lambda message: seen.append(client.progress))
    plant.online()
    assert client.progress == ""
    shown = [re.fullmatch(r"object ([0-9A-F]{4})h, (\d+) of about (\d+)", text) for text in seen if text]
    numbers = [(int(match[2]), int(match[3])) for match in shown if match]
    assert len(numbers) == len(shown) > 50
    assert numbers == sorted(numbers)
    assert all(done <= total for done, total in numbers)
    last, total = numbers[-1]
    assert 2 * last > total, "the estimate of the first start is not far off"
    assert {match[1] for match in shown if match} > {"1018", "1A00", "1017"}


def test_a_short_tpdo_is_not_a_sign_of_life(plant: Plant) -> None:
    client = plant.connected()
    slot = client.operation.slots[0]
    seen = slot.time
    slot.receive(b"\x37", seen + 1000 * MS)
    assert slot.time < seen + 1000 * MS


def test_a_waiting_job_fails_when_the_drive_is_lost(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connected()
    running, release = Event(client.loop), Event(client.loop)

    def hold(_drive: DriveClient) -> None:
        running.set()
        release.wait()

    client.submit(hold)
    site.wait_for(running.is_set, "held")
    waiting = [client.submit(lambda drive: drive.sdo.read(0x1000)) for _ in range(3)]
    drive.do(lambda node: node.power_off())
    site.wait_for(lambda: not client.refresh(site.now()), "overdue, seen although the task is busy")
    release.set()
    for job in waiting:
        # The first one may still be sent and time out; none waits permanently.
        site.wait_for(job.done, "answered")
        assert job.exception(0) is not None


def test_stopped_client_releases_the_bus_for_the_next_one(plant: Plant) -> None:
    first = plant.connected()
    blocked = Event(first.loop)
    first.submit(lambda drive: blocked.wait(200 * MS))
    waiting = first.submit(lambda drive: drive.sdo.read(0x1000))
    first.stop()
    first.stop()
    assert waiting.done()
    plant.connected(Operation.POSITIONING, initial_mode=None)
    assert first.generation == 1
    assert first.status is DriveStatus.OFFLINE


def test_missing_node_does_not_delay_the_other_drive(plant: Plant) -> None:
    plant.power_on()
    dead = DriveClient(
        plant.network, DriveSettings(9, sdo_timeout_ms=500), LAYOUTS[Operation.VELOCITY], plant.events.append
    )
    dead.start()
    client = plant.connected()
    assert site.result(client.submit(lambda drive: drive.sdo.read_number(0x1000))) == 0x0002_0192
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
    client = plant.connected(sync=True)
    assert drive.node.read(0x1800, 2) == 1
    cycling = False
    site.wait_for(lambda: client.status is DriveStatus.LOST, "lost without SYNC")
    assert "TPDO1" in client.status_text


def _count_sync(plant: Plant, period_us: int, **fault: int) -> None:
    """Bring up a drive that expects a counter in each SYNC; it still has the period of an earlier start."""
    plant.drive = drive = site.drive(NODE, shape=shape("synchronous"))
    drive.node.start_fault("sync-counter", **fault)
    drive.start()
    drive.node.values[SYNC_PERIOD, 0] = 2000

    def send_sync() -> None:
        plant.network.send_sync()
        plant.network.loop.call_later(4 * MS, send_sync)

    send_sync()
    plant.connect(Operation.CYCLIC_VELOCITY, sync=True, sync_period_us=period_us, initial_mode=Mode.CYCLIC_VELOCITY)


@pytest.mark.parametrize("period_us", [0, 4000])
def test_sync_counter_of_a_drive_is_switched_off_with_period_0(plant: Plant, period_us: int) -> None:
    _count_sync(plant, period_us)
    plant.online()
    assert plant.drive is not None
    assert plant.drive.node.read(SYNC_COUNTER) == 0
    assert plant.drive.node.read(SYNC_PERIOD) == (period_us or 2000)


def test_sync_counter_that_a_drive_keeps_is_named(plant: Plant) -> None:
    _count_sync(plant, 4000, read_only=1)
    text = plant.refused()
    assert "1019h/0 := 0h" in text
    assert "attempt to write a read-only object" in text


def test_sync_counter_of_a_drive_without_sync_is_not_written(plant: Plant) -> None:
    drive = plant.power_on(misbehaves="sync-counter")
    plant.connected()
    assert drive.node.read(SYNC_COUNTER) == 10


# -- a node whose heartbeat is dead ------------------------------------------------------------------------------------


def test_a_drive_without_heartbeat_never_becomes_online(plant: Plant) -> None:
    drive = plant.power_on()
    drive.do(lambda node: node.start_fault("heartbeat-stops"))
    client = plant.connect()
    text = plant.refused()
    assert re.search("heartbeat of node 4: 'none'.* 1 s of NMT start", text)
    assert client.generation == 0
    site.wait_for(lambda: drive.node.state is NmtState.PRE_OPERATIONAL, "obeys and sends no PDOs")


def test_stopped_heartbeat_is_distinguished_from_a_cut_cable(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connected()
    drive.do(lambda node: node.write(node.entry(0x1017, 0), 0))
    site.wait_for(lambda: client.status is DriveStatus.LOST, "lost")
    assert client.status_text.startswith("no heartbeat for 300 ms while its TPDOs arrive; check the firmware")


def test_loss_of_the_heartbeat_is_reported_once(plant: Plant) -> None:
    drive = plant.power_on()
    plant.connected(heartbeat_ms=20, heartbeat_factor=5)
    starts = _starts(plant)
    drive.do(lambda node: node.start_fault("heartbeat-stops"))
    site.wait_for(lambda: starts() >= 3, "brought up again and again", 60)
    assert [event.text for event in plant.events if "online" in event.text] == ["online: operational, configuration 1"]
    assert len([event for event in plant.events if event.notice is Notice.LOST]) == 1
    assert len({event.text for event in plant.events if event.notice is Notice.REFUSED}) == 1, "one text is one fault"
    drive.do(lambda node: node.end_fault())
    plant.online(2)


def _starts(plant: Plant) -> Callable[[], int]:
    """How often NMT start was sent since."""
    seen = observe(plant)
    return lambda: seen.count((0, 0, bytes((NmtCommand.START, NODE))))


def test_heartbeat_from_before_nmt_start_does_not_count(plant: Plant) -> None:
    """The node answers all requests, but its heartbeat still reports pre-operational."""
    drive = plant.power_on()
    stuck = bytes((NmtState.PRE_OPERATIONAL,))
    send = drive.node.send
    drive.node.send = lambda can_id, data: send(can_id, stuck if can_id == 0x700 + NODE and data != b"\0" else data)
    plant.connect()
    assert "NMT state of node 4 after NMT start: 'Pre-operational' is not allowed" in plant.refused()
