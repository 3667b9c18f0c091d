"""System redundancy S2: two controllers with one device. tshark is the independent reader of the Connect and of DataStatus."""

from __future__ import annotations

import enum
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.durations import MS
from pdgw.peers.controller.controller import IoController, Phase
from pdgw.peers.controller.project import Redundancy
from pdgw.profidrive.frame import STATUS_DATA_VALID, STATUS_PRIMARY
from pdgw.profinet.blocks.alarm import AlarmType, MessageClass
from pdgw.profinet.connection.cmdev import AbortCode, Event, State
from pdgw.profinet.connection.redundancy import STATUS_REDUNDANCY, ArSet
from pdgw.profinet.device import Connected, Disconnected
from pdgw.profinet.rpc.records import PnioStatus
from pdgw.profinet.station import Identity, Station
from tests.support.readers import tshark_frames
from tests.support.readers.tshark import needs_tshark
from tests.support.wire.profinet import BACKUP_IP, BACKUP_MAC, DEVICE_IP, Wire, project

HOLD_MS = 200
AXIS = (1, 2)
LEADS = STATUS_PRIMARY | STATUS_DATA_VALID
BACKUP = STATUS_DATA_VALID
MISSING = STATUS_REDUNDANCY | STATUS_DATA_VALID
FAULT = STATUS_PRIMARY | STATUS_REDUNDANCY | STATUS_DATA_VALID
ROLE = FAULT


class Pair(Wire):
    """Two controllers with the same project; ``one`` and ``other`` are connected, neither leads."""

    def __init__(self, *, data_hold: int = 3, hold_max: int = HOLD_MS, **redundancy: object) -> None:
        self.of = project(data_hold=data_hold)
        settings = {"hold_ms": HOLD_MS, **redundancy}
        first = replace(self.of, redundancy=Redundancy(1, **settings))  # type: ignore[arg-type]
        super().__init__(of_project=first, hold_max=hold_max)
        self.one = self.plc
        self.other = IoController(
            Station(Identity(BACKUP_MAC, 1, 1, "plc", "PLC"), "plc-2"),
            replace(self.of, redundancy=Redundancy(2, **settings)),  # type: ignore[arg-type]
            DEVICE_IP,
            seed=2,
        )
        self.plcs[BACKUP_IP] = self.other

    def connect_both(self) -> Pair:
        for plc in (self.one, self.other):
            plc.start(self.now)
            self.run(5_000 * MS, lambda plc=plc: plc.phase is Phase.DATA)
        self.run(50 * MS)
        assert [item.state for item in self.device.relations] == [State.DATA, State.DATA]
        return self

    def roles(self) -> tuple[int, int]:
        """The role reported to each controller, after the next frames."""
        self.run(20 * MS)
        return self.one.data_status & ROLE, self.other.data_status & ROLE

    def output(self) -> bytes | None:
        return self.device.output(AXIS)


def led() -> Pair:
    """The first controller leads, and sends 047E 1000; the other one would send 0000 2000."""
    pair = Pair().connect_both()
    pair.one.set_output(AXIS, bytes.fromhex("047E1000"))
    pair.other.set_output(AXIS, bytes.fromhex("00002000"))
    pair.one.lead(primary=True)
    pair.run(20 * MS)
    return pair


def test_without_the_limit_in_the_model_the_type_of_relationship_is_refused() -> None:
    pair = Pair(hold_max=0)
    pair.one.start(0)
    pair.run(5_000 * MS, lambda: pair.one.phase is Phase.ENDED)
    assert pair.one.learned.status == PnioStatus(0xDB, 0x81, 1, 4)


def test_a_longer_hold_time_than_the_model_allows_is_refused() -> None:
    pair = Pair(hold_max=HOLD_MS - 1)
    pair.one.start(0)
    pair.run(5_000 * MS, lambda: pair.one.phase is Phase.ENDED)
    assert pair.one.learned.status == PnioStatus(0xDB, 0x81, 10, 4)


@pytest.mark.parametrize(
    ("second", "refused"),
    [
        (Redundancy(2, HOLD_MS), None),
        (Redundancy(1, HOLD_MS), (64, 4)),
        (Redundancy(2, HOLD_MS, config=b"project2"), (64, 4)),
        (Redundancy(2, HOLD_MS - 1), (64, 4)),
        (Redundancy(3, HOLD_MS), (1, 5)),
        (None, (64, 4)),
    ],
    ids=["partner", "same number", "another project", "another hold time", "third number", "no redundancy"],
)
def test_second_controller_must_be_the_partner_of_the_first(
    second: Redundancy | None, refused: tuple[int, int] | None
) -> None:
    pair = Pair()
    pair.one.start(0)
    pair.run(5_000 * MS, lambda: pair.one.phase is Phase.DATA)
    pair.other.project = replace(pair.of, redundancy=second)
    pair.other.start(pair.now)
    pair.run(5_000 * MS, lambda: pair.other.phase in {Phase.DATA, Phase.ENDED})
    if refused is None:
        assert pair.other.phase is Phase.DATA
    else:
        assert pair.other.learned.status == PnioStatus(0xDB, 0x81, *refused)
        assert len(pair.device.relations) == 1


def test_a_third_controller_is_refused_and_a_restarted_one_takes_its_own_place() -> None:
    pair = led()
    third = IoController(
        Station(Identity(bytes.fromhex("020000000009"), 1, 1, "plc", "PLC"), "plc-3"),
        replace(pair.of, redundancy=Redundancy(2, HOLD_MS)),
        DEVICE_IP,
        seed=3,
    )
    pair.plcs["192.168.0.9"] = third
    third.start(pair.now)
    pair.run(5_000 * MS, lambda: third.phase is Phase.ENDED)
    assert third.learned.status == PnioStatus(0xDB, 0x81, 64, 4)
    pair.other.start(pair.now)
    pair.run(5_000 * MS, lambda: pair.other.phase is Phase.DATA)
    assert len(pair.device.relations) == 2
    assert pair.output() == bytes.fromhex("047E1000")


def test_output_data_counts_only_of_the_primary_and_input_data_goes_to_both() -> None:
    pair = Pair().connect_both()
    assert pair.roles() == (MISSING, MISSING)
    assert pair.output() is None
    assert not pair.device.connected
    pair = led()
    assert pair.output() == bytes.fromhex("047E1000")
    assert pair.roles() == (LEADS, BACKUP)
    pair.device.set_input(AXIS, bytes.fromhex("02310055"), good=True)
    pair.run(20 * MS)
    assert pair.one.input(AXIS) == pair.other.input(AXIS) == bytes.fromhex("02310055")


@pytest.mark.parametrize(("properties", "valid"), [(0x0, True), (0x1, True), (0x4, False), (0x5, True)])
def test_input_data_of_the_backup_is_marked_as_requested(properties: int, valid: bool) -> None:
    pair = Pair(properties=properties).connect_both()
    pair.one.lead(primary=True)
    first, second = pair.roles()
    assert first == LEADS
    assert second == (BACKUP if valid else 0)
    pair.run(1000 * MS)
    assert len(pair.device.relations) == 2


def test_newest_request_for_primary_wins_and_the_other_is_reported() -> None:
    pair = led()
    pair.other.lead(primary=True)
    assert pair.roles() == (FAULT, LEADS)
    assert pair.output() == bytes.fromhex("00002000")
    pair.one.lead(primary=False)
    assert pair.roles() == (BACKUP, LEADS)
    told = pair.told(Connected)
    assert [item.relation.plan.ar.station_name for item in told] == ["plc-1", "plc-2"]


def test_both_relationships_end_if_both_request_primary_too_long() -> None:
    pair = led()
    pair.other.lead(primary=True)
    pair.run(HOLD_MS * MS - 20 * MS)
    assert len(pair.device.relations) == 2
    pair.run(40 * MS)
    assert not pair.device.relations
    assert {item.ended.event for item in pair.told(Disconnected)} == {Event.NO_PRIMARY}
    for plc in (pair.one, pair.other):
        assert plc.learned.error == AbortCode.DATA_HOLD.status.value


def test_request_of_a_lost_primary_is_no_conflict() -> None:
    pair = Pair(data_hold=100).connect_both()
    pair.one.lead(primary=True)
    pair.run(20 * MS)
    pair.dead.add(pair.one)
    pair.other.lead(primary=True)
    pair.run(3 * HOLD_MS * MS)
    assert [item.plan.ar.station_name for item in pair.device.relations] == ["plc-2"]
    assert pair.device.connected


@pytest.mark.parametrize("way", ["backup", "release", "silence"])
def test_a_switchover_within_the_hold_time_keeps_the_new_relationship(way: str) -> None:
    pair = led()
    if way == "backup":
        pair.one.lead(primary=False)
    elif way == "release":
        pair.one.release(pair.now)
    else:
        pair.dead.add(pair.one)
    pair.run(20 * MS)
    assert not pair.device.connected
    assert pair.output() is None
    assert pair.other.data_status & ROLE == MISSING
    pair.run(HOLD_MS * MS - 60 * MS)
    pair.other.lead(primary=True)
    pair.run(20 * MS)
    assert pair.device.connected
    assert pair.other.data_status & ROLE == LEADS
    assert pair.output() == bytes.fromhex("00002000")


def test_both_relationships_end_without_a_primary_for_the_hold_time() -> None:
    pair = led()
    pair.one.lead(primary=False)
    pair.run(HOLD_MS * MS - 20 * MS)
    assert len(pair.device.relations) == 2
    pair.run(40 * MS)
    assert not pair.device.relations


def test_hold_time_starts_with_the_first_primary() -> None:
    pair = Pair().connect_both()
    pair.run(10 * HOLD_MS * MS)
    assert len(pair.device.relations) == 2


def test_alarms_are_sent_to_the_primary_and_present_ones_to_a_new_primary() -> None:
    pair = led()
    pair.device.set_diagnosis((1, 1), MessageClass.TEMPERATURE)
    pair.run(100 * MS)
    assert [item.alarm_type for item in pair.one.learned.alarms] == [AlarmType.DIAGNOSIS]
    assert not pair.other.learned.alarms
    pair.other.lead(primary=True)
    pair.one.lead(primary=False)
    pair.run(100 * MS)
    assert [item.alarm_type for item in pair.other.learned.alarms] == [AlarmType.DIAGNOSIS]


@needs_tshark
def test_tshark_reads_the_connect_and_the_roles(tmp_path: Path) -> None:
    """Type, set and hold time of the Connect; the meaning of each DataStatus of a switchover."""
    pair = led()
    pair.one.lead(primary=False)
    pair.run(20 * MS)
    pair.other.lead(primary=True)
    pair.run(20 * MS)
    pair.one.lead(primary=True)
    pair.run(12 * MS)
    pair.other.lead(primary=True)
    names = [
        "pn_io.ar_type",
        "pn_io.ar_arnumber",
        "pn_io.ar_arresource",
        "pn_io.RedundancyDataHoldFactor",
        "pn_rt.ds_frame_info_meaning",
    ]
    rows = tshark_frames.read(pair.frames, tmp_path / "s2.pcap", names)
    connects = [row for row in rows if row["pn_io.RedundancyDataHoldFactor"]]
    assert [int(row["pn_io.ar_type"], 0) for row in rows if row["pn_io.ar_type"]] == [0x20, 0x20], "as granted"
    assert [int(row["pn_io.ar_arnumber"], 0) for row in connects] == [1, 2]
    assert [int(row["pn_io.ar_arresource"], 0) for row in connects] == [2, 2]
    assert {int(row["pn_io.RedundancyDataHoldFactor"], 0) for row in connects} == {HOLD_MS}
    meanings = {int(row["pn_rt.ds_frame_info_meaning"], 0) for row in rows if row["pn_rt.ds_frame_info_meaning"]}
    assert meanings == {0x04, 0x05, 0x06, 0x07}, "backup, primary, primary missing, primary fault"


class Name(enum.Enum):
    """Of a relationship."""

    ONE = "1"
    OTHER = "2"


STEPS = st.lists(
    st.tuples(st.sampled_from(Name), st.sampled_from(["ask", "withdraw", "anew"]), st.integers(0, 300)), max_size=30
)


@given(STEPS)
def test_newest_edge_defines_the_primary_in_every_sequence(steps: list[tuple[Name, str, int]]) -> None:
    both: ArSet[Name] = ArSet()
    asks = dict.fromkeys(Name, False)
    for name in Name:
        both.join(name, HOLD_MS * MS)
    now = 0
    leads: Name | None = None
    for name, what, passed in steps:
        now += passed * MS
        if what == "anew":
            both.leave(name, now)
            both.join(name, HOLD_MS * MS)
        else:
            both.ask(name, now, primary=what == "ask")
        if what == "ask" and not asks[name]:
            leads = name
        elif what != "ask" and leads is name:
            leads = None
        asks[name] = what == "ask"
        assert both.primary is leads
        for member in Name:
            status = both.status(member)
            assert bool(status & STATUS_PRIMARY) == asks[member]
            assert bool(status & STATUS_REDUNDANCY) == (member is not leads and (asks[member] or leads is None))
