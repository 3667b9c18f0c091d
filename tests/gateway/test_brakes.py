"""A drive that continues with its last command: frames sent to it and withheld from it, until standstill and after."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.communication import DEFAULT_GATEWAY_NODE_ID, ERROR_CONTROL, NMT, SYNC, NmtCommand
from pdgw.ds301.objects import Entry
from pdgw.dsp402.states import State
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.drive import SimulatedDrive, SimulatedDriveNode, shape
from pdgw.peers.drive.model.shapes import SYNCHRONOUS
from pdgw.peers.node.node import Value
from tests.gateway.test_sync import KNOWN_TO_STOP, SPEED_KEYS, unguarded
from tests.support.gateways.daemon import Plc, axis, configuration, drive_of, exchanging, running, until, world_of

OFF3 = 0x047F & ~0x4
STOP = bytes((NmtCommand.STOP, 1))
CONTROL = 0x201
"""RPDO 1 of node 1, with the Controlword."""
HEARTBEAT = ERROR_CONTROL + DEFAULT_GATEWAY_NODE_ID


class Sent:
    """What the gateway sends."""

    def __init__(self, daemon: Daemon) -> None:
        self._daemon = daemon
        self.frames: list[tuple[int, bytes]] = []
        daemon.networks["can"].listeners.append(
            lambda message: (
                self.frames.append((message.arbitration_id, bytes(message.data))) if not message.is_rx else None
            )
        )

    def within(self, ns: int) -> set[int]:
        """COB-IDs of what is sent in the time that follows."""
        self.frames.clear()
        world_of(self._daemon).loop.run_for(ns)
        return {can_id for can_id, _ in self.frames}


@dataclass(frozen=True)
class Guard:
    """A kind of drive, by what guards the gateway for it."""

    drive: Callable[[Daemon], SimulatedDrive]
    withheld: frozenset[int]
    """Of heartbeat, SYNC and RPDO."""
    telegram: int = 1
    more: str = ""


def _of_shape(name: str) -> Callable[[Daemon], SimulatedDrive]:
    return lambda daemon: world_of(daemon).drive("world", 1, shape=shape(name))


GUARDS = {
    "heartbeat": Guard(_of_shape("rpm"), frozenset({HEARTBEAT})),
    "life guarding": Guard(_of_shape("node-guarding"), frozenset({HEARTBEAT})),
    "RPDO": Guard(_of_shape("rpdo-timeout"), frozenset({HEARTBEAT, CONTROL})),
    "SYNC": Guard(unguarded, frozenset({HEARTBEAT, SYNC}), 105, SPEED_KEYS),
    "heartbeat beside SYNC": Guard(
        lambda daemon: world_of(daemon).drive("world", 1, shape=SYNCHRONOUS), frozenset({HEARTBEAT}), 105, SPEED_KEYS
    ),
}


def _ignore_commands(node: SimulatedDriveNode, *, nmt: bool) -> None:
    """Every RPDO has the data of the last one; ``nmt``: NMT commands are executed."""
    receive = node.receive
    held: dict[int, bytes] = {}

    def without_reaction(can_id: int, data: bytes, now: int) -> None:
        if can_id != NMT or nmt:
            receive(can_id, held.setdefault(can_id, data) if node.is_pdo(can_id) else data, now)

    node.receive = without_reaction  # type: ignore[method-assign]


def _begin_again(node: SimulatedDriveNode) -> None:
    del node.receive
    node.restart()


def _turning(daemon: Daemon, guard: Guard) -> tuple[SimulatedDrive, Plc]:
    drive = guard.drive(daemon)
    plc = Plc(daemon, [guard.telegram])
    plc.enable()
    plc.endpoint.set(0, {"NSOLL_A": 0x1000} if guard.telegram == 1 else {"NSOLL_B": 1 << 28})
    plc.until(lambda: drive.model.ramp.speed > 100, "it turns")
    return drive, plc


def _stop_commands(daemon: Daemon, plc: Plc) -> Sent:
    """OFF3, some cycles later; what the gateway sends from then on."""
    plc.exchange(50)
    sent = Sent(daemon)
    plc.endpoint.set(0, {"STW1": OFF3})
    return sent


@pytest.mark.parametrize("name", GUARDS)
def test_a_drive_that_follows_neither_controlword_nor_nmt_is_stopped_by_its_guarding(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pdgw.dsp402.identification.overlay.Families.of", lambda *_: KNOWN_TO_STOP)
    guard = GUARDS[name]
    with running(configuration(axis(1, telegram_number=guard.telegram, more=guard.more))) as daemon:
        drive, plc = _turning(daemon, guard)
        drive.do(lambda node: _ignore_commands(node, nmt=False))
        sent = _stop_commands(daemon, plc)
        with exchanging(plc):
            until(daemon, lambda: (NMT, STOP) in sent.frames, "NMT stop")
            assert [fault.number for fault in daemon.axes[0].faults] == [FaultNumber.STOP_IGNORED]
            assert not daemon.axes[0].withholds_heartbeat, "one brake after the other"
            until(daemon, lambda: daemon.axes[0].withholds_heartbeat, "the next")
            stops = sent.frames.count((NMT, STOP))
            assert stops == 2, "again with the next brake, and not in every cycle"
            with pytest.raises(GatewayError, match="the telegram cannot be changed"):
                daemon.change_telegram(daemon.axes[0], 2)
            seen = sent.within(150 * MS)
            usual = {HEARTBEAT, CONTROL} | ({SYNC} if guard.telegram == 105 else set())
            assert not seen & guard.withheld
            assert seen >= usual - guard.withheld
            until(daemon, lambda: drive.model.ramp.speed == 0, "standstill")
            drive.do(_begin_again)
            until(daemon, lambda: daemon.axes[0].drive.generation == 2, "configured anew")
            until(daemon, lambda: daemon.axes[0].good, "online again")
            assert sent.within(300 * MS) >= usual, "what the next start needs"


def test_the_telegram_of_a_lost_drive_is_not_changed_before_it_is_found_without_power() -> None:
    """The machine of another telegram knows nothing of the stop that is under way."""
    guard = GUARDS["heartbeat"]
    with running(configuration(axis(1, more=guard.more))) as daemon:
        drive, plc = _turning(daemon, guard)
        item = daemon.axes[0]
        with exchanging(plc):
            world_of(daemon).gateway_port("world").connect(False)
            until(daemon, lambda: not item.good, "lost")
            world_of(daemon).loop.run_for(5 * SECOND)
            with pytest.raises(GatewayError, match="the telegram cannot be changed"):
                daemon.change_telegram(item, 2)
            world_of(daemon).gateway_port("world").connect(True)
            until(daemon, lambda: item.good and drive.model.state is State.SWITCH_ON_DISABLED, "there again")
        daemon.change_telegram(item, 2)
        assert item.telegram.number == 2


def test_a_drive_that_follows_nmt_keeps_the_gateways_heartbeat_during_bring_up_and_stop_by_sdo() -> None:
    """Others on the bus need it."""
    guard = GUARDS["heartbeat"]
    with running(configuration(axis(1, more=guard.more))) as daemon:
        drive, plc = _turning(daemon, guard)
        drive.do(lambda node: node.start_fault("turns-in-pre-operational"))
        drive.do(lambda node: node.start_fault("slow-sdo", delay_ms=400))
        drive.do(lambda node: _ignore_commands(node, nmt=True))
        sent = _stop_commands(daemon, plc)
        with exchanging(plc):
            until(daemon, lambda: (NMT, STOP) in sent.frames, "NMT stop")
            until(daemon, lambda: drive.model.state is State.QUICK_STOP_ACTIVE, "its stop by SDO")
            assert not daemon.axes[0].withholds_heartbeat
            assert all(HEARTBEAT in sent.within(150 * MS) for _ in range(10))
            assert drive.model.ramp.speed == 0


def test_a_drive_that_turns_on_whatever_nmt_and_sdo_say_loses_the_heartbeat() -> None:
    guard = GUARDS["heartbeat"]
    with running(configuration(axis(1, more=guard.more))) as daemon:
        drive, plc = _turning(daemon, guard)

        def refuse(entry: Entry, value: Value) -> None:
            if entry.index == 0x6040:
                raise SdoAbortedError(Abort.CANNOT_STORE_DEVICE_STATE)

        drive.do(lambda node: setattr(node, "on_nmt", lambda state: None))
        drive.do(lambda node: _ignore_commands(node, nmt=True))
        drive.do(lambda node: setattr(node, "on_written", refuse))
        _stop_commands(daemon, plc)
        with exchanging(plc):
            until(daemon, lambda: daemon.axes[0].withholds_heartbeat, "the last brake")
            assert drive.model.ramp.speed > 0
            assert daemon.axes[0].drive.generation == 2, "brought up in between"
            until(daemon, lambda: drive.model.ramp.speed == 0, "standstill")
            assert daemon.axes[0].withholds_heartbeat


def _ended(last_stop: str, habit: str, *, acknowledges: bool = False) -> str:
    """The sentence of an axis 20 s after OFF3, with its speed before it."""
    with running(configuration(axis(1, more=f'simulate = true\nlast_stop = "{last_stop}"'))) as daemon:
        plc, drive = Plc(daemon, [1]), drive_of(daemon)
        plc.enable()
        plc.turn(0x1000)
        drive.do(lambda node: node.start_fault(habit))
        with exchanging(plc):
            plc.endpoint.set(0, {"STW1": OFF3})
            world_of(daemon).loop.run_for(20 * SECOND + 100 * MS)
            if acknowledges:
                plc.endpoint.set(0, {"STW1": OFF3 | 0x80})
                world_of(daemon).loop.run_for(SECOND)
            return f"{drive.model.ramp.speed:.0f} rpm: {daemon.axes[0].enable_status.sentence}"


@pytest.mark.parametrize("acknowledges", [False, True])
def test_status_says_for_how_long_a_drive_turns_that_no_stop_stops(*, acknowledges: bool) -> None:
    said = _ended("none", "quick-stop-too-slow", acknowledges=acknowledges)
    seconds = 21 if acknowledges else 20
    assert re.match(
        rf"[5-7]\d\d rpm: Fault: no stop of the gateway stops the drive: it turns, since \d\d:\d\d:\d\d, for {seconds} s, "
        rf"with [5-7][\d.]+ rpm\. Only safe torque off \(STO\) or switching its supply off stops it; ",
        said,
    ), said


def test_status_says_so_of_a_drive_that_contradicts_its_units() -> None:
    """A runaway is fault 128 first."""
    with running(configuration(axis(1, more='simulate = true\nlast_stop = "none"'))) as daemon:
        plc, drive = Plc(daemon, [1]), drive_of(daemon)
        plc.enable()
        drive.do(lambda node: node.start_fault("runs-away-without-brake"))
        with exchanging(plc):
            world_of(daemon).loop.run_for(10 * SECOND)
            assert daemon.axes[0].machine.units_contradicted
            assert "no stop of the gateway stops the drive" in daemon.axes[0].enable_status.sentence


def test_status_says_nothing_of_that_while_a_stop_is_left() -> None:
    assert _ended("disable-voltage", "quick-stop-too-slow").startswith("0 rpm: Fault: drive does not stop")
