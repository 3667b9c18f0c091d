"""Stops on their way to the drive: their times, with a late Statusword, and to a drive that still has power."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.communication import SDO_REQUEST, SDO_RESPONSE
from pdgw.ds301.objects import Entry
from pdgw.dsp402.states import Command, State
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.drive import SimulatedDrive, SimulatedDriveNode
from pdgw.peers.node.behaviour import Behaviour
from pdgw.peers.node.node import Value
from tests.support.axis.limit_cycle import TRANSPARENT, search
from tests.support.documents.parts import read_part
from tests.support.documents.stop_times import BUSES, LINKS, PLACE, Link, Row, measure
from tests.support.gateways.daemon import OFF, Plc, axis, configuration, drive_of, exchanging, running, until, world_of

# -- time from a stop in the PLC, and from its death, to the Controlword; the table of docs/safety.md -------------


@pytest.mark.parametrize(
    ("link", "cycle_ms"), list(zip(LINKS, (4, 16, 4, 16), strict=True)), ids=lambda item: getattr(item, "name", None)
)
def test_stops_reach_a_full_bus_within_their_bounds(link: Link, cycle_ms: int) -> None:
    row = measure(link, cycle_ms, 2)
    assert row.stop_ns <= row.stop_bound_ns
    assert row.death_ns <= row.death_bound_ns


def test_the_document_has_all_times_within_their_bounds() -> None:
    cells = r"\| (\d+) ms \| ([\d.]+) ms \| ([\d.]+) ms \|"
    text = read_part(*PLACE)
    for link in LINKS:
        found = re.findall(rf"\| {re.escape(link.name)} {cells}", text)
        assert [int(cycle) for cycle, _, _ in found] == list(BUSES)
        for cycle, stop, death in found:
            row = Row(link, int(cycle), round(float(stop) * MS), round(float(death) * MS))
            assert row.stop_ns <= row.stop_bound_ns
            assert row.death_ns <= row.death_bound_ns


# -- no OFF switches a drive on (``make long LONG=limit-cycles`` runs every delay) --------------------------------


EVERY = "PDGW_LIMIT_CYCLES" in os.environ
CYCLES_MS = (1, 2, 4, 16)
SELECTED = {1: (4,), 9: (2,), TRANSPARENT: (4,), 105: (4,), 111: (16,)}
"""Telegrams and cycle times of the suite: one of each kind of executor."""


@pytest.mark.parametrize(
    ("number", "cycle_ms"),
    [
        (number, cycle)
        for number in DRIVE_TELEGRAM_NUMBERS
        for cycle in (CYCLES_MS if EVERY else SELECTED.get(number, ()))
    ],
)
def test_standing_off_never_enables_a_drive_with_late_statusword(number: int, cycle_ms: int) -> None:
    assert search(number, cycle_ms, range(101) if EVERY else (5, 60)) == []


# -- a drive with power is brought up: it takes no RPDO, its stop goes by SDO -------------------------------------


FULL_SPEED = 0x4000
OFF2 = OFF & ~0x2
_DOWNLOAD = range(0x20, 0x40)


def _turning(daemon: Daemon) -> tuple[Plc, SimulatedDrive]:
    """The drive at 3000 rpm; NMT pre-operational does not stop it."""
    drive = drive_of(daemon)
    drive.do(lambda node: node.start_fault("turns-in-pre-operational"))
    plc = Plc(daemon, [1])
    plc.enable()
    plc.turn(FULL_SPEED)
    return plc, drive


def _written(daemon: Daemon) -> list[tuple[int, int]]:
    """Object and value of every SDO download to the drive from now on."""
    written: list[tuple[int, int]] = []
    daemon.networks["can"].listeners.append(
        lambda message: (
            written.append((int.from_bytes(message.data[1:3], "little"), int.from_bytes(message.data[4:], "little")))
            if message.arbitration_id == SDO_REQUEST + 1 and not message.is_rx and message.data[0] in _DOWNLOAD
            else None
        )
    )
    return written


@dataclass(kw_only=True, eq=False)
class _LostSdo(Behaviour):
    """Single SDO frames are lost: those of these numbers, from 0."""

    name = "lost-sdo"
    numbers: frozenset[int]
    answers: bool
    """Those of the drive, or those to it."""
    _count: int = field(init=False, default=0)

    def _passes(self) -> bool:
        self._count += 1
        return self._count - 1 not in self.numbers

    def incoming(self, can_id: int, data: bytes) -> bool:
        return self.answers or can_id != SDO_REQUEST + self.node.node_id or self._passes()

    def outgoing(self, can_id: int, data: bytes) -> bool:
        return not self.answers or can_id != SDO_RESPONSE + self.node.node_id or self._passes()


@pytest.mark.parametrize("lost", [{0}, {1}, {2, 3}, {0, 2, 4}], ids=str)
@pytest.mark.parametrize("answers", [True, False], ids=["answers", "requests"])
def test_a_lost_sdo_frame_delays_the_stop_by_a_tenth_of_the_time_for_an_answer(lost: set[int], answers: bool) -> None:
    with running(configuration(axis(1))) as daemon:
        plc, drive = _turning(daemon)
        fault = _LostSdo(numbers=frozenset(lost), answers=answers)

        def plant(node: SimulatedDriveNode) -> None:
            fault.node = node
            node.behaviours[fault.name] = fault

        drive.do(lambda node: node.start_fault("lost-pdos", every=1))
        client = daemon.axes[0].drive
        with exchanging(plc):
            until(daemon, lambda: client.status.value != "online", "lost")
            drive.do(plant)
            until(daemon, lambda: fault._count, "the first SDO frame")
            limit = len(lost) * client.settings.sdo_timeout_ms * MS // 10 + 5 * MS
            until(daemon, lambda: drive.model.state is State.QUICK_STOP_ACTIVE, "its stop", limit)
            drive.do(lambda node: node.end_fault())
            until(daemon, lambda: daemon.axes[0].good, "online again", 4 * SECOND)
        assert client.generation == 2, "a second answer to a repeated request has no effect"


def test_a_drive_that_answers_each_repeated_request_late_is_brought_up_at_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")

    def late(daemon: Daemon) -> None:
        drive_of(daemon).do(lambda node: node.start_fault("slow-sdo", delay_ms=120))

    with running(configuration(axis(1)), late) as daemon:
        until(daemon, lambda: daemon.axes[0].good, "online", 60 * SECOND)
    assert "no answer" not in caplog.text


@pytest.mark.parametrize("asked", [None, OFF2, OFF], ids=["ON", "OFF2", "OFF1"])
def test_a_lost_drive_that_turns_on_in_pre_operational_is_stopped_before_it_is_configured(asked: int | None) -> None:
    with running(configuration(axis(1))) as daemon:
        plc, drive = _turning(daemon)
        written = _written(daemon)
        drive.do(lambda node: node.start_fault("lost-pdos", every=1))
        if asked is not None:
            plc.endpoint.set(0, {"STW1": asked})
        with exchanging(plc):
            until(daemon, lambda: written, "the first SDO write")
            assert written[0] == (0x6040, Command.QUICK_STOP.word)
            until(daemon, lambda: drive.model.state is State.QUICK_STOP_ACTIVE, "its stop", 2 * MS)
            until(daemon, lambda: drive.model.ramp.speed == 0, "standstill")
            world_of(daemon).loop.run_for(4 * SECOND)
            assert [index for index, _ in written].count(0x6040) == 1, "a drive that is off gets no command"
            drive.do(lambda node: node.end_fault())
            until(daemon, lambda: daemon.axes[0].good, "online again")
            world_of(daemon).loop.run_for(SECOND)
        assert drive.model.state is not State.OPERATION_ENABLED, "a standing ON restarts nothing"


@pytest.mark.parametrize("left", [State.SWITCHED_ON, State.OPERATION_ENABLED])
def test_a_drive_that_was_left_switched_on_is_stopped_when_the_gateway_finds_it(left: State) -> None:
    with running(configuration(axis(1))) as daemon:
        written = _written(daemon)
        drive = drive_of(daemon)

        def turn(node: SimulatedDriveNode) -> None:
            node.start_fault("turns-in-pre-operational")
            model = node.model
            last = Command.SWITCH_ON if left is State.SWITCHED_ON else Command.ENABLE_OPERATION
            for word in (Command.SHUTDOWN, last):
                model.controlword = word.word
                model.command()
            model.ramp.set(1000.0)

        drive.do(turn)
        assert drive.model.state is left
        until(daemon, lambda: written, "the first SDO write")
        assert written[0] == (0x6040, Command.QUICK_STOP.word)
        until(daemon, lambda: daemon.axes[0].good, "online")
        assert drive.model.state not in {State.SWITCHED_ON, State.OPERATION_ENABLED}


@pytest.mark.parametrize("shown", [State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON])
def test_a_drive_without_power_is_brought_up_with_no_controlword_by_sdo(shown: State) -> None:
    with running(configuration(axis(1))) as daemon:
        plc = Plc(daemon, [1])
        drive, written = drive_of(daemon), _written(daemon)
        drive.do(lambda node: node.start_fault("turns-in-pre-operational"))
        plc.endpoint.set(0, {"STW1": OFF if shown is State.READY_TO_SWITCH_ON else 0})
        plc.until(lambda: drive.model.state is shown, shown.value)
        drive.do(lambda node: node.start_fault("lost-pdos", every=1))
        with exchanging(plc):
            until(daemon, lambda: not daemon.axes[0].good, "lost")
            until(daemon, lambda: drive.model.state is shown, "as it was")
            drive.do(lambda node: node.end_fault())
            until(daemon, lambda: daemon.axes[0].good, "online again")
        assert 0x6040 not in [index for index, _ in written]


def test_a_drive_that_refuses_its_stop_by_sdo_is_brought_up_and_stopped_by_its_rpdo() -> None:
    with running(configuration(axis(1))) as daemon:
        plc, drive = _turning(daemon)

        def refuse(entry: Entry, value: Value) -> None:
            if entry.index == 0x6040:
                raise SdoAbortedError(Abort.CANNOT_STORE_DEVICE_STATE)

        def lose(node: SimulatedDriveNode) -> None:
            node.on_written = refuse  # type: ignore[method-assign]
            node.start_fault("lost-pdos", every=1)

        drive.do(lose)
        client = daemon.axes[0].drive
        with exchanging(plc):
            until(daemon, lambda: client.status.value == "configuring", "brought up")
            assert drive.model.state is State.OPERATION_ENABLED
            drive.do(lambda node: node.end_fault("lost-pdos"))
            until(daemon, lambda: drive.model.ramp.speed == 0, "standstill")
        assert client.generation == 2
