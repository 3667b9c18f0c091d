"""Suspicion and proof of two devices with one node-ID: what healthy devices do that looks alike, and what two devices show."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from itertools import cycle, repeat

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.communication import ERROR_CONTROL, NMT, SDO_REQUEST, SDO_RESPONSE, NmtCommand, NmtState
from pdgw.ds301.node.node import NodeStatus
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.node.behaviour import Behaviour
from pdgw.peers.node.node import SimulatedNode
from pdgw.peers.world import Member
from tests.support.gateways.daemon import (
    Plc,
    axis,
    configuration,
    drive_of,
    encoder_of,
    operating,
    running,
    until,
    world_of,
)

OPERATIONAL, PRE_OPERATIONAL = bytes((NmtState.OPERATIONAL,)), bytes((NmtState.PRE_OPERATIONAL,))
SPEED = 0x1000
PROOF_NS = 200 * MS
"""From the suspicion to the stop."""
EXAMINED_NS = SECOND
"""So long a suspicion without an answer is examined."""
PERIOD_NS = 100 * MS


class _Heartbeats(Behaviour):
    """The heartbeats of the device come after these gaps, in milliseconds."""

    gaps: Iterator[int]
    _due = 0

    def outgoing(self, can_id: int, data: bytes) -> bool:
        return can_id != ERROR_CONTROL + self.node.node_id or data[0] == NmtState.BOOT_UP

    def poll(self, now: int) -> None:
        if now >= self._due:
            self._due = now + next(self.gaps) * MS
            self.node.transmit(ERROR_CONTROL + self.node.node_id, bytes((self.node.state,)), past=self)

    def next_event(self, now: int) -> int | None:
        return self._due


def _jitter() -> Iterator[int]:
    chance = random.Random(1)
    while True:
        yield chance.randint(40, 160)


HABITS: dict[str, Callable[[], Iterator[int]]] = {
    "fixed period of 20 ms": lambda: repeat(20),
    "jitter of 40 to 160 ms": _jitter,
    "burst of four each second": lambda: cycle([1, 1, 1, *[100] * 9, 97]),
    "one more each second": lambda: cycle([*[100] * 9, 1, 99]),
    "fixed period of 250 ms": lambda: repeat(250),
}


def _plant(gaps: Iterator[int]) -> Callable[[SimulatedNode], None]:
    """The device sends its heartbeats after these gaps."""

    def plant(node: SimulatedNode) -> None:
        fault = _Heartbeats(gaps=gaps)
        fault.node = node
        node.behaviours["heartbeats"] = fault
        node.touch()

    return plant


def _with(gaps: Iterator[int]) -> Callable[[Daemon], None]:
    return lambda daemon: drive_of(daemon).do(_plant(gaps))


def _run(plc: Plc, seconds: float) -> None:
    plc.exchange(round(seconds * SECOND / plc.daemon.cycle_ns))


@pytest.mark.parametrize("habit", HABITS)
def test_drive_with_odd_heartbeats_stays_in_operation(habit: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "gateway")
    with operating(configuration(axis(1)), _with(HABITS[habit]())) as (daemon, plc):
        plc.turn(SPEED)
        _run(plc, 10)
        item = daemon.axes[0]
        assert plc.value("NIST_A") == SPEED
        assert (item.drive.generation, list(item.faults), item.outputs.warning) == (1, [], 0)
    told = [record.getMessage() for record in caplog.records if "1017h" in record.getMessage()]
    expected = ["axis 1: node heartbeat comes every 20 ms, 1017h is 100"] if "20 ms" in habit else []
    assert told == expected


def test_no_question_is_asked_before_the_last_one_is_answered() -> None:
    """Its answer would count for neither, and all reading by SDO would wait until it cannot come any more."""

    def spoil(daemon: Daemon) -> None:
        drive_of(daemon).do(_plant(repeat(20)))
        drive_of(daemon).node.start_fault("slow-sdo", delay_ms=30)

    open_requests, most = 0, 0

    def tap(_: int, sender: Member, can_id: int, data: bytes) -> None:
        nonlocal open_requests, most
        open_requests = max(0, open_requests + (can_id == SDO_REQUEST + 1) - (can_id == SDO_RESPONSE + 1))
        most = max(most, open_requests)

    with operating(before=spoil) as (daemon, plc):
        world_of(daemon).bus("world").taps.append(tap)
        plc.turn(SPEED)
        _run(plc, 20)
    assert most == 1


def test_encoder_with_a_heartbeat_of_20_ms_stays_online() -> None:
    encoder = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\n"
    with running(configuration(encoder), lambda daemon: encoder_of(daemon).do(_plant(repeat(20)))) as daemon:
        made = daemon.encoders[0]
        until(daemon, lambda: made.good, "online")
        world_of(daemon).loop.run_for(10 * SECOND)
        assert (made.good, made.client.generation, list(made.faults)) == (True, 1, [])
        assert made.client.sdo.doubles.early > 100


def test_drive_with_a_heartbeat_of_one_second_is_refused_with_its_period() -> None:
    with running(configuration(axis(1)), _with(repeat(1000))) as daemon:
        client = daemon.axes[0].drive
        until(daemon, lambda: client.status is NodeStatus.REFUSED, "refused")
        assert "'one every 1 s' is not allowed, expected one every 100 ms" in client.status_text
        world_of(daemon).loop.run_for(20 * SECOND)
        assert client.generation <= 1, "never online again, to be lost at once"


# -- a second device ----------------------------------------------------------------------------------------------


def _second(daemon: Daemon) -> Member:
    return world_of(daemon).bus("world").join("second device")


def _beat(plc: Plc, second: Member, states: Iterator[bytes], period_ns: int = PERIOD_NS) -> None:
    """The second device sends heartbeats with these states."""

    def send() -> None:
        second.send(ERROR_CONTROL + 1, next(states))
        plc.loop.call_later(period_ns, send)

    plc.loop.call_later(period_ns, send)


def _repeat(plc: Plc, second: Member, cob_id: int, change: Callable[[bytes], bytes] = bytes) -> None:
    """The second device sends what the drive sends with this COB-ID, changed."""

    def hear(_now: int, sender: Member, can_id: int, data: bytes) -> None:
        if can_id == cob_id and sender is not second:
            second.send(can_id, change(data))

    world_of(plc.daemon).bus("world").taps.append(hear)


def _until_early(plc: Plc) -> int:
    doubles = plc.daemon.axes[0].drive.sdo.doubles
    plc.until(lambda: doubles.early, "an early frame")
    return plc.loop.now()


@pytest.mark.parametrize("period_ms", [100, 500, 1000])
def test_second_device_stops_the_axis_200_ms_after_its_first_early_frame(period_ms: int) -> None:
    with operating() as (daemon, plc):
        plc.turn(SPEED)
        client, second = daemon.axes[0].drive, _second(daemon)
        _repeat(plc, second, SDO_RESPONSE + 1)
        _beat(plc, second, repeat(OPERATIONAL), period_ms * MS + 30 * MS)
        begin = _until_early(plc)
        plc.until(lambda: plc.value("ZSW1") & 1 << 3, "a fault in ZSW1")
        assert plc.loop.now() - begin <= PROOF_NS
        assert "two devices? SDO requests are answered twice" in client.status_text
        plc.until(lambda: client.status is NodeStatus.REFUSED, "refused")
        plc.until(lambda: drive_of(daemon).model.ramp.speed == 0, "standstill")
        _run(plc, 1)
        assert {fault.number for fault in daemon.axes[0].faults} == {FaultNumber.NODE_LOST, FaultNumber.NODE_REFUSED}


def test_second_device_is_found_while_the_first_one_answers_no_question() -> None:
    """The read of a parameter client is not answered; then the drive answers again."""
    with operating(configuration(axis(1, more="simulate = true\nsdo_timeout_ms = 300"))) as (daemon, plc):
        client, second = daemon.axes[0].drive, _second(daemon)
        drive_of(daemon).do(lambda node: node.start_fault("sdo-timeout"))
        client.submit(lambda node: node.sdo.read(0x6065))
        _repeat(plc, second, SDO_RESPONSE + 1)
        _beat(plc, second, repeat(OPERATIONAL), PERIOD_NS + 30 * MS)
        begin = _until_early(plc)
        drive_of(daemon).do(lambda node: node.end_fault())
        plc.until(lambda: client.status is NodeStatus.LOST, "lost")
        assert plc.loop.now() - begin <= EXAMINED_NS
        assert "SDO requests are answered twice" in client.status_text


def test_second_heartbeats_alone_never_stop_the_axis() -> None:
    with operating() as (daemon, plc):
        plc.turn(SPEED)
        _beat(plc, _second(daemon), repeat(OPERATIONAL))
        _run(plc, 10)
        assert (plc.value("NIST_A"), list(daemon.axes[0].faults)) == (SPEED, [])


def test_heartbeats_with_two_alternating_states_are_two_devices() -> None:
    with operating() as (daemon, plc):
        client = daemon.axes[0].drive
        _beat(plc, _second(daemon), repeat(PRE_OPERATIONAL))
        plc.until(lambda: client.status is NodeStatus.REFUSED, "refused")
        assert "two devices? heartbeats show two NMT states" in client.status_text
        _run(plc, 0.1)
        origin = daemon.axes[0].origins.present
        assert origin is not None
        assert origin.evidence == "two devices had node-ID 1", "and not the node that has left Operational by itself"


@pytest.mark.parametrize("states", [repeat(b"\0"), cycle([PRE_OPERATIONAL, OPERATIONAL, b"\0"])])
def test_boot_up_messages_do_not_prove_a_second_device(states: Iterator[bytes]) -> None:
    with operating() as (daemon, plc):
        client, texts = daemon.axes[0].drive, set[str]()
        _beat(plc, _second(daemon), states, SECOND)
        for _ in range(100):
            _run(plc, 0.1)
            texts.add(client.status_text)
        assert client.generation > 5, "restarted"
        assert not [text for text in texts if "two devices" in text]


def test_states_that_another_master_commands_are_of_one_device() -> None:
    with operating() as (daemon, plc):
        client, texts, master = daemon.axes[0].drive, set[str](), _second(daemon)
        for number in range(60):
            master.send(NMT, bytes((NmtCommand.START if number % 2 else NmtCommand.ENTER_PRE_OPERATIONAL, 1)))
            _run(plc, 0.15)
            texts.add(client.status_text)
        assert any(text.startswith("Pre-operational: another master has sent NMT command 80h") for text in texts)
        assert not [text for text in texts if "two devices" in text]


TURN = 4096
"""Position units of a revolution of the simulated drive."""


@pytest.mark.parametrize(
    ("distance", "two"), [(TURN // 2, True), (10 * TURN + TURN // 4, True), (TURN // 100, False), (TURN, False)]
)
def test_two_positions_of_a_node_that_is_suspected_stop_the_axis(distance: int, two: bool) -> None:
    """Noise, and a position that wraps by whole revolutions, are no second position. The second device answers no SDO."""
    with operating(configuration(axis(1, telegram_number=3))) as (daemon, plc):
        client, second = daemon.axes[0].drive, _second(daemon)
        slot = next(slot for slot in client.operation.slots if "position_actual" in slot.pdo.attributes)
        offset = slot.pdo.struct.size - 4 if slot.pdo.attributes[-1] == "position_actual" else 0

        def moved(data: bytes) -> bytes:
            position = int.from_bytes(data[offset : offset + 4], "little", signed=True) + distance
            return data[:offset] + position.to_bytes(4, "little", signed=True) + data[offset + 4 :]

        _repeat(plc, second, slot.cob_id, moved)
        _run(plc, 3)
        assert client.generation == 1, "not suspected"
        _beat(plc, second, repeat(OPERATIONAL))
        begin = _until_early(plc)
        _run(plc, 3)
        lost = [fault for fault in daemon.axes[0].faults if fault.number == FaultNumber.NODE_LOST]
        assert bool(lost) == two
        if two:
            assert "two devices? TPDO" in lost[0].text
            assert "shows two positions" in lost[0].text
            assert lost[0].time_ns - begin <= EXAMINED_NS + 2 * 20 * MS
