"""Drives of every variant on the gateway, without a data sheet: each follows or is rejected with its reason."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.objects import Access
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.identification.overlay import Overlay, QuirkKeys
from pdgw.dsp402.objects import MODE
from pdgw.dsp402.states import State
from pdgw.gateway.axis.executors.positions.homing import Homing
from pdgw.gateway.axis.executors.positions.mode import ModeSwitch
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.telegrams import TASK_TELEGRAM_NUMBERS
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.client.session import Session
from pdgw.gateway.commissioning.telegram_check import lacks
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import SimulatedDrive, shape
from pdgw.profidrive.parameters.codec import ParameterAddress
from pdgw.profidrive.telegrams import telegram
from tests.support.documents.profile_numbers import decode_sensor_format
from tests.support.drives.drive_types import described
from tests.support.gateways.daemon import (
    OFF,
    ON,
    POSITIONER,
    SIMULATED_POSITIONER,
    Plc,
    axis,
    configuration,
    online,
    running,
    serving,
    until,
    world_of,
)

QUARTER = 0x1000
TASK = 1 << 6
"""STW1: a rising edge starts a traversing task."""
HAS = "modes of the drive (6502h):"
PROFILE_POSITION = "1 (profile position) for a traversing task: use a drive with that mode, or a telegram without"
PATIENCE = 300_000 * MS
"""A drive that answers SDO after half a second has some hundred of them to answer."""


def _drive(daemon: Daemon, name: str) -> SimulatedDrive:
    return world_of(daemon).drive("world", 1, shape=shape(name))


def test_a_quarter_of_the_rated_speed_is_750_rpm_and_the_status_shows_why() -> None:
    with running(configuration(axis(1, more=""))) as daemon:
        drive = _drive(daemon, "si")
        until(daemon, lambda: daemon.axes[0].drive.generation, "online", PATIENCE)
        plc = Plc(daemon, [1])
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_A": QUARTER})
        plc.until(lambda: abs(drive.model.ramp.speed - 750) < 1, "750 rpm")
        plc.until(lambda: abs(plc.value("NIST_A") - QUARTER) <= 2, "the actual speed")
        (status,) = snapshot(daemon)["axes"]
        assert status["scaling"][0].startswith("speed: 100 % = 3000 rpm = ")


@pytest.mark.parametrize(
    ("name", "number", "said"),
    [
        *(("csp", number, f"{HAS} [6, 8] is not allowed, expected {PROFILE_POSITION}") for number in (9, 111)),
        ("vl", 9, PROFILE_POSITION),
    ],
)
def test_a_shape_without_profile_position_is_refused_with_its_modes(name: str, number: int, said: str) -> None:
    more = POSITIONER if number == 111 else ""
    with running(configuration(axis(1, telegram_number=number, more=more))) as daemon:
        drive = _drive(daemon, name)
        until(daemon, lambda: daemon.axes[0].drive.status.value == "refused", "refused")
        assert said in daemon.axes[0].drive.status_text
        assert drive.model.ramp.speed == 0


@pytest.mark.parametrize("number", TASK_TELEGRAM_NUMBERS)
def test_the_scan_refuses_a_drive_without_profile_position_with_the_same_reason(number: int) -> None:
    assert PROFILE_POSITION in lacks(described("csp"), telegram(number))


TEN_TURNS = 40_960
KEYS = 'rated_acceleration_rpm_s = 10000\nacceleration_unit = "rpm/s"\n'
"""Keys for values that the variant lacks."""


def _asks_for_ten_turns(plc: Plc) -> None:
    task = {"SATZANW": 0x8000, "MDI_TARPOS": TEN_TURNS, "MDI_VELOCITY": 1 << 29, "MDI_MOD": 1}
    plc.endpoint.set(0, {**task, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000, "STW1": 0x043F})
    plc.exchange(5)
    plc.endpoint.set(0, {"STW1": 0x047F})


def test_a_task_of_telegram_9_ends_at_its_target() -> None:
    with running(configuration(axis(1, telegram_number=9, more=KEYS))) as daemon:
        drive = _drive(daemon, "no-range")
        until(daemon, lambda: daemon.axes[0].drive.generation, "online", PATIENCE)
        plc = Plc(daemon, [9])
        plc.enable()
        _asks_for_ten_turns(plc)
        plc.until(lambda: abs(drive.model.position_actual - TEN_TURNS) <= 1, "ten revolutions")


def test_a_mode_that_can_only_be_written_is_confirmed_by_6061h() -> None:
    with running(configuration(axis(1, telegram_number=9, more=KEYS))) as daemon:
        drive = _drive(daemon, "no-range")
        entries = drive.node.entries
        drive.node.entries = {**entries, MODE: replace(entries[MODE], access=Access.WO)}
        until(daemon, lambda: daemon.axes[0].drive.generation, "online", PATIENCE)
        plc = Plc(daemon, [9])
        plc.enable()
        _asks_for_ten_turns(plc)
        plc.until(lambda: abs(drive.model.position_actual - TEN_TURNS) <= 1, "ten revolutions")


def test_a_shape_with_an_unknown_unit_refuses_telegram_9_and_says_why() -> None:
    with running(configuration(axis(1, telegram_number=9, more=""))) as daemon:
        drive = _drive(daemon, "no-range")
        online(daemon)
        plc = Plc(daemon, [9])
        plc.endpoint.set(0, {"STW1": 0x047E})
        plc.until(lambda: daemon.axes[0].faults, "a fault")
        plc.endpoint.set(0, {"STW1": 0x047F})
        plc.exchange(100)
        fault = daemon.axes[0].faults[-1]
        assert fault.number == FaultNumber.REFERENCE
        assert "set rated_acceleration_rpm_s" in fault.text
        broken = daemon.axes[0].enable_status.broken
        assert broken is not None
        assert broken.evidence == fault.text, (
            "each unknown quantity is evidence, and none of them the remedy of another"
        )
        assert broken.evidence.count(": set ") > 1
        assert broken.todo == fault.remedy
        assert broken.todo.startswith("paste into its [[axis]] and fill in: ")
        assert daemon.axes[0].outputs.reason is Reason.REFERENCE_INVALID
        assert drive.model.ramp.speed == 0


GUARDED = {
    "rpm": "the gateway's heartbeat (1016h, 300 ms), then quick stop (6007h = 3)",
    "node-guarding": "life guarding (100Ch, 100Dh, 300 ms), then quick stop (6007h = 3)",
    "rpdo-timeout": "the timeout of its RPDO (1400h/5, 300 ms), then quick stop (6007h = 3)",
    "no-abort-option": "the gateway's heartbeat (1016h, 300 ms), then its own reaction, by default a malfunction (no 6007h)",
}


@pytest.mark.parametrize("name", GUARDED)
def test_a_drive_of_a_gateway_that_dies_stops_by_what_the_status_names(name: str) -> None:
    with running(configuration(axis(1, more=""))) as daemon:
        drive = _drive(daemon, name)
        online(daemon)
        plc = Plc(daemon, [1])
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_A": QUARTER})
        plc.until(lambda: abs(drive.model.ramp.speed - 750) < 1, "750 rpm")
        (status,) = snapshot(daemon)["axes"]
        assert status["guarding"] == GUARDED[name]
        plc.exchange(250)
        assert drive.model.ramp.speed == pytest.approx(750), "guarded for a second, and not stopped"
        world_of(daemon).gateway_port("world").connect(False)
        plc.loop.run_for(1500 * MS)
        assert drive.model.ramp.speed == 0
        world_of(daemon).gateway_port("world").connect(True)


@pytest.mark.parametrize("name", ["node-guarding", "rpdo-timeout"])
def test_drive_that_answers_each_sdo_with_four_bytes_is_guarded(name: str) -> None:
    with running(configuration(axis(1, more=""))) as daemon:
        _drive(daemon, name).do(lambda node: node.start_fault("sdo-four-bytes"))
        online(daemon)
        (status,) = snapshot(daemon)["axes"]
        assert status["guarding"] == GUARDED[name]


def test_allow_unguarded_operates_a_drive_that_has_nothing_and_says_so() -> None:
    with running(configuration(axis(1, more="allow_unguarded = true"))) as daemon:
        _drive(daemon, "unguarded")
        online(daemon)
        (status,) = snapshot(daemon)["axes"]
        assert status["guarding"] == "nothing"


@pytest.mark.parametrize(
    ("name", "says"),
    [
        (
            "node-guarding",
            ("answer to node guarding of node 1: 'none'", "check that the CAN adapter sends remote frames"),
        ),
        ("unguarded", ("guarding of the gateway by the drive: '1016h: ", "set allow_unguarded = true")),
    ],
)
def test_drive_that_cannot_be_guarded_is_rejected_with_what_is_missing(name: str, says: tuple[str, ...]) -> None:
    with running(configuration(axis(1, more=""))) as daemon:
        drive = _drive(daemon, name)
        drive.do(lambda node: setattr(node, "receive_remote", lambda can_id, now: None))
        until(daemon, lambda: daemon.axes[0].drive.refusal, "rejected")
        sentence = daemon.axes[0].enable_status.sentence
        assert [text for text in says if text.lower() not in sentence.lower()] == [], sentence
        assert sentence.count("is not allowed") == 1


def test_a_drive_that_answers_node_guarding_with_the_same_toggle_bit_is_lost() -> None:
    with running(configuration(axis(1, more=""))) as daemon:
        drive = _drive(daemon, "node-guarding")
        online(daemon)
        stuck = bytes([0x85])
        drive.do(lambda node: setattr(node, "receive_remote", lambda can_id, now: node.transmit(can_id, stuck)))
        until(daemon, lambda: daemon.axes[0].drive.status.value == "lost", "lost")
        assert "no heartbeat for 300 ms" in daemon.axes[0].drive.status_text


def test_an_object_that_is_taken_in_a_tpdo_and_never_sent_is_noticed_and_read_by_sdo_from_then_on() -> None:
    with running(configuration(axis(1, more=""))) as daemon:
        drive = _drive(daemon, "frozen")
        client = daemon.axes[0].drive
        online(daemon)
        plc = Plc(daemon, [1])
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_A": QUARTER})
        plc.until(lambda: client.status.value == "lost", "lost")
        assert "TPDO1 accepts Velocity Actual Value 606Ch but does not send it: it shows 0" in client.status_text
        plc.until(lambda: drive.model.ramp.speed == 0, "stopped")
        plc.endpoint.set(0, {"NSOLL_A": 0})
        plc.until(lambda: client.generation == 2, "online again")
        assert client.plan is not None
        assert "read by SDO every 100 ms: Velocity Actual Value 606Ch" in client.plan.lines


@pytest.mark.parametrize("fault", [("late-pdos", {"delay_ms": 150}), ("lost-pdos", {"every": 2})])
def test_a_late_or_irregular_tpdo_does_not_count_as_a_missing_one(
    fault: tuple[str, dict[str, int]],
) -> None:
    with running(configuration(axis(1, more=""))) as daemon:
        drive = _drive(daemon, "synchronous")
        client = daemon.axes[0].drive
        online(daemon)
        name, values = fault
        drive.do(lambda node: node.start_fault(name, **values))
        plc = Plc(daemon, [1])
        for _ in range(20):
            plc.enable()
            plc.endpoint.set(0, {"NSOLL_A": QUARTER})
            plc.until(lambda: drive.model.ramp.speed > 100, "turns")
            plc.endpoint.set(0, {"STW1": OFF, "NSOLL_A": 0})
            plc.until(lambda: plc.state() == 1, "off")
        assert "does not send it" not in client.status_text
        assert client.generation == 1


def test_positioning_in_a_constant_rhythm_does_not_stop_a_healthy_drive() -> None:
    """Objects are read each second: with tasks of this period, as the axis starts and no frame shows it yet."""
    with running(configuration(axis(1, telegram_number=111, more=SIMULATED_POSITIONER))) as daemon:
        client = daemon.axes[0].drive
        online(daemon)
        plc = Plc(daemon, [111])

        def send(cycles: int, **words: int) -> None:
            plc.endpoint.set(0, words)
            plc.exchange(cycles)

        send(85, POS_STW1=0x8100, OVERRIDE=0x4000, MDI_VELOCITY=30_000, MDI_ACC=0x4000, MDI_DEC=0x4000)
        plc.enable()
        for task in range(16):
            send(250, STW1=ON, MDI_TARPOS=20_000 * (1 - task % 2))
            send(1, STW1=ON & ~TASK)
        assert client.generation == 1, client.status_text


def test_no_speed_is_sent_before_the_drive_shows_its_mode_and_one_that_never_does_is_stopped() -> None:
    with running(configuration(axis(1, more=""))) as daemon:
        drive = _drive(daemon, "mode-late")
        client = daemon.axes[0].drive
        online(daemon)
        drive.do(lambda node: node.start_fault("mode-display-stuck"))
        plc = Plc(daemon, [1])
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_A": QUARTER})
        plc.until(lambda: client.status.value == "lost", "lost")
        assert "6061h shows 0 for 1 s in operation, not 3" in client.status_text
        assert drive.model.started == 0
        assert drive.model.turned(plc.loop.now()) == 0


def test_a_drive_that_powers_up_in_fault_and_needs_two_edges_is_acknowledged_by_one_edge_of_the_plc(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    family = Overlay(name="test", title="test", sources=("this test",), quirks=QuirkKeys(fault_reset_edges=2))
    monkeypatch.setattr("pdgw.dsp402.identification.overlay.Families.of", lambda *_: family)
    with running(configuration(axis(1, more=""))) as daemon:
        drive = _drive(daemon, "two-edges")
        online(daemon)
        plc = Plc(daemon, [1])
        plc.endpoint.set(0, {"STW1": 0x047E})
        plc.until(lambda: plc.state() == 0x08, "the fault")
        plc.endpoint.set(0, {"STW1": 0x04FE})
        plc.until(lambda: plc.state() == 0x01, "acknowledged, and ready")
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_A": QUARTER})
        plc.until(lambda: abs(drive.model.ramp.speed - 750) < 1, "750 rpm")


def test_a_drive_that_stays_in_quick_stop_is_led_out_of_it_and_can_be_started_again() -> None:
    with running(configuration(axis(1, more=""))) as daemon:
        drive = _drive(daemon, "stays-stopped")
        online(daemon)
        plc = Plc(daemon, [1])
        for _ in range(2):
            plc.enable()
            plc.endpoint.set(0, {"NSOLL_A": QUARTER})
            plc.until(lambda: abs(drive.model.ramp.speed - 750) < 1, "750 rpm")
            plc.endpoint.set(0, {"STW1": 0x047B, "NSOLL_A": 0})
            plc.until(lambda: drive.model.ramp.speed == 0, "standstill")
            plc.until(lambda: drive.model.state is State.SWITCH_ON_DISABLED, "off")


@pytest.mark.parametrize(("asked", "there"), [(35, 37), (37, 35), (35, 35)])
def test_homing_at_the_current_position_is_35_and_37_whichever_the_drive_has(asked: int, there: int) -> None:
    executor = AxisMachine(telegram(9), AxisSettings(), DriveFeedback()).executor
    homing = Homing(executor, ModeSwitch(executor, 1))
    homing.methods = frozenset({1, there})
    assert homing.require_method(asked)
    homing.begin(asked, None)
    assert executor.outputs.writes is not None
    assert executor.outputs.writes[0].value == there


@pytest.mark.parametrize(
    ("name", "resolution", "code", "object_", "unit"),
    [
        ("engel", 0x1000, 0x7305, ("Dynamic Speed Limit", "0.5 rpm"), "velocity units (6094h rpm)"),
        ("si", 0x1000, 0, ("", ""), "velocity units"),
        ("vl", None, 0, ("", ""), "velocity units"),
    ],
)
def test_parameters_have_of_a_drive_only_what_its_family_has(
    name: str, resolution: int | None, code: int, object_: tuple[str, str], unit: str
) -> None:
    with serving(configuration(axis(1, more="")), connect=lambda daemon: _drive(daemon, name)) as (_, client):
        codes, sensors = client.request([ParameterAddress(946, 5, 1), ParameterAddress(979, 0, 31)])
        assert codes.values == (code,)
        (sensor,) = decode_sensor_format(tuple(map(int, sensors.values)))
        assert (sensor.valid, sensor.resolution) == (resolution is not None, resolution or 0)
        session = Session(client)
        assert session.name_and_unit(0x2003, 0) == object_
        assert session.name_and_unit(0x60FF, 0) == ("Target Velocity", unit)


INVERTER = shape("inverter")


@pytest.mark.parametrize("telegram_number", [1, 2, 3])
def test_inverter_without_the_objects_of_the_mode_turns_in_its_one_mode(
    telegram_number: int, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level("INFO"), running(configuration(axis(1, telegram_number=telegram_number, more=""))) as daemon:
        world_of(daemon).drive("world", 1, shape=INVERTER)
        plc = Plc(daemon, [telegram_number])
        plc.enable()
        setpoint, actual, half = (
            ("NSOLL_A", "NIST_A", 0x2000) if telegram_number == 1 else ("NSOLL_B", "NIST_B", 1 << 29)
        )
        plc.endpoint.set(0, {setpoint: half})
        plc.until(lambda: abs(plc.value(actual) - half) < half // 100, "half of the rated speed")
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: abs(plc.value(actual)) < half // 100, "standstill")
    assert "without 6060h and 6061h: operated in its one mode, 2 (velocity)" in caplog.text


def test_drive_without_the_objects_of_the_mode_and_with_objects_of_two_is_refused() -> None:
    with running(configuration(axis(1, more=""))) as daemon:
        world_of(daemon).drive("world", 1, shape=replace(INVERTER, lacks=INVERTER.lacks - {0x6071}))
        until(daemon, lambda: daemon.axes[0].drive.refusal, "refused")
        assert "mode of operation (6060h/0 := 2h)" in daemon.axes[0].drive.status_text
