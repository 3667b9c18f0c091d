"""``pdgw axis test``: turns an axis slowly and not far, and distinguishes wrong units from right ones."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from random import Random

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.communication import ERROR_CONTROL
from pdgw.ds301.objects import Access, CanType, Entry, array, var
from pdgw.dsp402.states import State
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.store import ParameterStore, confirmation, units_text
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import ENGEL, Shape, SimulatedDrive, shape
from pdgw.peers.drive.model.model import DriveModel
from pdgw.peers.world import World
from pdgw.tools.bus_task import complete
from pdgw.tools.commissioning import axis_test
from pdgw.tools.commissioning.axis_test import TURNS, AxisTest, Choices, Outcome
from tests.support.cli import pdgw
from tests.support.gateways.daemon import axis, configuration, running, until
from tests.support.processes import PATIENT

BUS = "world"
TURN = 4096
WRONG = 'rated_speed_rpm = 3000\nignored_unit_objects = ["6094h"]\n'
"""Keys with which a wrong unit is used."""
CHOICES = Choices(Fraction(2), Fraction(2))
"""60 rpm for two turns."""


class Site:
    """A drive, the test of its axis, and what happened to it."""

    def __init__(
        self,
        keys: str = "",
        shape: Shape = ENGEL,
        *,
        typed: str | None = "turn 1",
        turns: str | None = "",
        choices: Choices = CHOICES,
        config: GatewayConfig | None = None,
    ) -> None:
        self.world = World()
        self.drive: SimulatedDrive = self.world.drive(BUS, 1, shape=shape)
        self.config = config or configuration(axis(1, more=keys))
        self.lines: list[str] = []
        self.asked: list[str] = []
        self.fastest = 0.0
        """rpm of the motor."""
        self.states: set[State | None] = set()

        def confirm(wanted: str, answer: Callable[[str], None]) -> None:
            self.asked.append(wanted)
            text = turns if wanted == TURNS else typed
            if text is not None:
                answer(text + "\n")

        self.test = AxisTest(self.config, 1, self.world, self.lines.append, confirm, choices)
        self._watch()

    def _watch(self) -> None:
        model = self.drive.model
        self.fastest = max(self.fastest, abs(model.ramp.speed))
        self.states.add(model.state)
        self.world.loop.call_later(5 * MS, self._watch)

    def when_turning(self, action: Callable[[], object]) -> None:
        """Once the creep speed is reached."""

        def look() -> None:
            if abs(self.drive.model.ramp.speed) > 14:
                action()
            else:
                self.world.loop.call_later(5 * MS, look)

        look()

    def run(self) -> Outcome:
        return complete(self.world.loop, self.test.run)

    @property
    def turned(self) -> float:
        """Turns of the motor."""
        return self.drive.shaft(0)

    def at_standstill_without_power(self) -> bool:
        model = self.drive.model
        return model.ramp.speed == 0 and model.state in {
            State.SWITCH_ON_DISABLED,
            State.READY_TO_SWITCH_ON,
            State.FAULT,
        }


@pytest.mark.parametrize("name", ["engel", "counts", "si", "csv", "rpm", "vl", "four-pdo", "slow-boot"])
def test_every_drive_variant_turns_as_commanded_and_not_further(name: str) -> None:
    site = Site(shape=shape(name))
    outcome = site.run()
    assert outcome.passed, site.lines
    assert outcome.speed_factor is not None
    assert abs(outcome.speed_factor - 1) < Fraction(1, 20)
    if outcome.position_factor is not None:
        assert abs(outcome.position_factor - 1) < Fraction(1, 50)
    else:  # a drive that does not report the unit of its position
        fit = re.search(r"counts_per_revolution is unknown, (\d+) would match", "".join(site.lines))
        assert fit is not None
        assert abs(int(fit[1]) - TURN) < TURN // 50
    assert 2.4 < site.turned < 3
    assert site.fastest < 61
    assert site.at_standstill_without_power()
    assert any(line.startswith("in all     6064h +") for line in site.lines)


@pytest.mark.parametrize(
    ("habit", "values", "line"),
    [
        ("heartbeat-period", {"period_ms": 200}, "heartbeat 200 ms; limit 300 ms NEAR: raise heartbeat_factor"),
        ("heartbeat-jitter", {"jitter_ms": 60}, "heartbeat [4-6][0-9] ms to 1[4-6][0-9] ms; limit 300 ms"),
        ("tpdo-by-timer", {}, "TPDO 50 ms; limit 200 ms"),
        ("slow-sdo", {"delay_ms": 20}, "SDO answer .*2[0-2] ms; limit 500 ms"),
        ("brake-opens", {"delay_ms": 1800}, "entering operation 1.8 s; limit 10 s"),
        ("brake-closes", {"delay_ms": 700}, "leaving operation at standstill 70[0-9] ms; limit 10 s"),
        ("status-latency", {"status_ms": 100}, r"reaction to a command (100 ms to )?10[0-9] ms; limit 320 ms"),
        ("mode-display-late", {"delay_ms": 200}, "change of the mode 2[0-9]{2} ms; limit 1 s"),
    ],
)
def test_each_habit_of_the_drive_is_measured_beside_its_limit(habit: str, values: dict[str, int], line: str) -> None:
    site = Site()
    site.drive.do(lambda node: node.start_fault(habit, **values))
    assert site.run().passed, site.lines
    assert any(re.search(line, " ".join(shown.split())) for shown in site.lines), site.lines


@pytest.mark.parametrize(
    ("turns", "confirmed"), [("2.5", True), ("2,6", True), ("", False), ("yes", False), (None, False)]
)
def test_without_a_number_of_turns_nothing_is_verified(
    turns: str | None, confirmed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(axis_test, "_TYPING_NS", 2 * SECOND)
    site = Site(turns=turns)
    outcome = site.run()
    assert (outcome.passed, outcome.confirmed) == (True, confirmed)
    assert any(line.startswith("not verified") for line in site.lines) is not confirmed
    assert site.asked == ["turn 1", TURNS]
    assert site.at_standstill_without_power(), "while the person counts"


def test_consistently_wrong_resolution_is_detected_by_the_mark() -> None:
    honest = shape("counts")
    own = [spec for spec in honest.has if spec.index not in {0x607F, 0x608F}]
    parts = (Entry(0x608F, sub, "", CanType.U32, default=16 * TURN if sub == 1 else 1) for sub in (1, 2))
    resolution = array(0x608F, "Position encoder resolution", *parts)
    limit = var(0x607F, "Max profile velocity", CanType.U32, Access.RW, default=16 * 204_800)
    site = Site(shape=replace(honest, has=(*own, limit, resolution)), turns="41")
    outcome = site.run()
    assert outcome.position_factor is not None
    assert abs(outcome.position_factor - 1) < Fraction(1, 50), "drive and gateway agree"
    assert 35 < site.turned < 48
    assert not outcome.passed
    assert not outcome.confirmed
    assert any("the mark made 41 turns, commanded were 2." in line for line in site.lines)


def test_direction_and_speed_are_options() -> None:
    site = Site(choices=Choices(Fraction(-5), Fraction(1)))
    assert site.run().passed, site.lines
    assert -2.5 < site.turned < -1.2
    assert 149 < site.fastest < 151


def test_drive_with_unknown_units_is_not_turned_and_the_key_is_named() -> None:
    site = Site(shape=replace(shape("rpm"), lacks=shape("rpm").lacks | {0x6080}))
    outcome = site.run()
    assert not outcome.passed
    assert "set rated_speed_rpm" in outcome.abort_reason
    assert site.asked == []
    assert site.turned == 0


@pytest.mark.parametrize("typed", ["", "y", "turn 2", "turn1"])
def test_without_the_typed_words_no_power_is_switched_on(typed: str) -> None:
    site = Site(typed=typed)
    outcome = site.run()
    assert "not confirmed" in outcome.abort_reason
    assert site.asked == ["turn 1"]
    assert site.states <= {State.NOT_READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED}


def test_missing_confirmation_times_out() -> None:
    site = Site(typed=None)
    assert "an input" in site.run().abort_reason
    assert State.OPERATION_ENABLED not in site.states
    assert site.world.loop.now() < 200 * SECOND


def test_unit_wrong_by_two_is_detected_at_creep_speed() -> None:
    site = Site('velocity_unit = "rpm"\n' + WRONG)
    outcome = site.run()
    assert not outcome.passed
    assert outcome.speed_factor == 1, "the drive's own word agrees: it is read in the same wrong unit"
    assert outcome.position_factor is not None
    assert abs(outcome.position_factor - Fraction(1, 2)) < Fraction(1, 50)
    assert re.search(r"one unit of 60FFh is 0\.50\d* rpm", "".join(site.lines))
    assert site.fastest < 16
    assert site.turned < 1
    assert site.at_standstill_without_power()


@pytest.mark.parametrize("unit", ["1/4 rpm", "0.1 rpm", "0.005 rpm"])
def test_too_fast_motion_stops_within_a_fraction_of_a_turn(unit: str) -> None:
    site = Site(f'velocity_unit = "{unit}"\n' + WRONG)
    outcome = site.run()
    assert "wrong units, or runaway" in outcome.abort_reason
    assert site.turned < 1
    assert site.at_standstill_without_power()


def test_wrong_counts_per_revolution_has_both_explanations() -> None:
    site = Site("counts_per_revolution = 8192\n")
    outcome = site.run()
    assert outcome.position_factor is not None
    assert abs(outcome.position_factor - Fraction(1, 2)) < Fraction(1, 50)
    fit = re.search(r"if it turned at 15 rpm, one revolution is (\d+) of 6064h", "".join(site.lines))
    assert fit is not None
    assert abs(int(fit[1]) - TURN) < TURN // 50
    assert site.fastest < 16


@pytest.mark.parametrize("at", [2**31 - 100, -(2**31) + 100])
def test_a_position_that_wraps_is_followed(at: int) -> None:
    site = Site(choices=Choices(Fraction(2) if at > 0 else Fraction(-2), Fraction(1)), shape=shape("counts"))
    site.drive.do(lambda node: node.model.stop_at(at))
    outcome = site.run()
    assert outcome.passed, site.lines
    assert outcome.moved is not None
    assert 1.2 < abs(outcome.moved) / TURN < 2


def test_delayed_answers_do_not_make_units_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    site = Site()
    read, chance = AxisTest._position, Random(7)

    def position(test: AxisTest) -> int | None:
        found = read(test)
        site.world.loop.sleep(chance.choice((0, 0, 700)) * MS)
        return found

    monkeypatch.setattr(AxisTest, "_position", position)
    outcome = site.run()
    assert outcome.passed, site.lines
    assert outcome.position_factor is not None
    assert abs(outcome.position_factor - 1) < Fraction(1, 50)


def test_drive_that_never_reacts_times_out() -> None:
    site = Site()
    site.drive.do(lambda node: node.start_fault("deaf"))
    outcome = site.run()
    assert "the drive is ready to switch on" in outcome.abort_reason
    assert site.turned == 0


def test_drive_that_stops_reacting_is_stopped_by_nmt() -> None:
    site = Site()
    site.when_turning(lambda: site.drive.do(lambda node: node.start_fault("deaf")))
    outcome = site.run()
    assert not outcome.passed
    assert any("DOES NOT STOP" in line for line in site.lines)
    assert site.fastest < 16
    assert site.drive.model.ramp.speed == 0, "by NMT stop or the missing heartbeat"


@pytest.mark.parametrize(
    ("attribute", "said"),
    [("velocity_actual", "in the wrong direction: 606Ch is -"), ("position_actual", "6064h moved by -")],
)
def test_a_drive_that_shows_the_other_direction_is_stopped_at_once(
    monkeypatch: pytest.MonkeyPatch, attribute: str, said: str
) -> None:
    site = Site()
    original = DriveModel.advance

    def advance(model: DriveModel, now: int) -> None:
        original(model, now)
        setattr(model, attribute, -abs(getattr(model, attribute)))

    monkeypatch.setattr(DriveModel, "advance", advance)
    outcome = site.run()
    assert said in outcome.abort_reason
    assert site.turned < 0.3
    assert site.at_standstill_without_power()


def test_a_fault_of_the_drive_while_it_turns_ends_the_test_with_its_text() -> None:
    site = Site()
    site.when_turning(lambda: site.drive.inject(7))
    outcome = site.run()
    assert "the drive has left operation" in outcome.abort_reason
    assert "over-current" in outcome.abort_reason.lower() or "2310h" in outcome.abort_reason
    assert site.at_standstill_without_power()


def test_ctrl_c_stops_the_drive_by_quick_stop() -> None:
    site = Site()
    site.when_turning(site.test.interrupt)
    outcome = site.run()
    assert outcome.interrupted
    assert State.QUICK_STOP_ACTIVE in site.states
    assert site.turned < 0.3
    assert site.at_standstill_without_power()


def test_axis_test_does_not_start_beside_a_plc() -> None:
    site = Site()
    plc = site.world.network.open("plc", 0, "PLC")
    address = str(site.config.transport.listen), 34980
    config = site.config.model_copy(
        update={"transport": site.config.transport.model_copy(update={"cyclic_port": 34980})}
    )
    site.test = AxisTest(config, 1, site.world, site.lines.append, lambda *_: None, CHOICES)
    site.world.loop.call_later(400 * MS, lambda: plc.send(b"frame", address))
    with pytest.raises(GatewayError, match="a PLC sends frames from plc:"):
        site.run()
    assert site.turned == 0


def test_plc_switched_on_meanwhile_ends_the_axis_test() -> None:
    config = configuration(axis(1, more=""), transport="watchdog_factor = 75\n")
    config = config.model_copy(update={"transport": config.transport.model_copy(update={"cyclic_port": 34980})})
    site = Site(config=config)
    plc = site.world.network.open("plc", 0, "PLC")
    site.when_turning(lambda: plc.send(b"frame", ("127.0.0.1", 34980)))
    assert "a PLC sends frames from plc:" in site.run().abort_reason
    assert site.at_standstill_without_power()


def test_axis_test_does_not_start_beside_a_gateway() -> None:
    config = configuration(axis(1, more=""))
    config = config.model_copy(update={"transport": config.transport.model_copy(update={"cyclic_port": 34980})})
    site = Site(config=config)
    daemon = Daemon(config, site.world)
    with pytest.raises(GatewayError, match="is a gateway running"):
        site.run()
    daemon.release()


@pytest.mark.parametrize("turning", [False, True], ids=["before", "while it turns"])
def test_another_master_ends_the_axis_test(turning: bool) -> None:
    site = Site()
    other = site.world.bus(BUS).join("other")

    def beat() -> None:
        other.send(ERROR_CONTROL + 127, b"\x05")
        site.world.loop.call_later(100 * MS, beat)

    if turning:
        site.when_turning(beat)
    else:
        beat()
    with pytest.raises(GatewayError, match="another gateway"):
        site.run()
    assert (State.OPERATION_ENABLED in site.states) == turning
    assert site.at_standstill_without_power()


def test_a_speed_below_one_unit_of_the_drive_is_refused() -> None:
    site = Site(shape=shape("rpm"), choices=Choices(Fraction(1, 10), Fraction(1)))
    assert "choose a higher --percent" in site.run().abort_reason
    assert site.turned == 0


def test_unknown_axis_is_reported_with_the_known_ones() -> None:
    with pytest.raises(GatewayError, match=r"DO 7: not an axis, allowed: \[1\]"):
        AxisTest(configuration(axis(1)), 7, World(), print, lambda *_: None, CHOICES)


def test_stored_verification_is_of_one_drive_and_its_units() -> None:
    outcome = Site(turns="2.5").run()
    assert outcome.scaling is not None
    kept = confirmation("2026-11-22", outcome.serial_number, outcome.scaling)
    assert outcome.serial_number == 1
    assert units_text(kept, 1, outcome.scaling) == "units verified on 2026-11-22 (axis test)"
    assert "not verified" in units_text(None, 1, outcome.scaling)
    other = units_text(kept, 2, outcome.scaling)
    assert other == (
        "units not verified (pdgw axis test): "
        "the axis test of 2026-11-22 was for the drive with serial number 1, this drive has 2"
    )
    changed = replace(outcome.scaling, velocity_per_rpm=Fraction(1))
    assert units_text(kept, 1, changed).endswith("was for other units")


def test_status_shows_whether_the_units_are_verified(tmp_path: Path) -> None:
    outcome = Site(turns="2.5").run()
    assert outcome.scaling is not None
    store = ParameterStore(tmp_path / "store.json", print)
    kept = confirmation("2026-11-22", outcome.serial_number, outcome.scaling)
    for expected, path in (
        ("units not verified (pdgw axis test)", None),
        ("units verified on 2026-11-22 (axis test)", store.path),
    ):
        store.update(lambda parameters: setattr(parameters.drive_object(1), "units_witnessed", kept))
        with running(configuration(axis(1)).model_copy(update={"store": path})) as daemon:
            until(daemon, lambda: daemon.axes[0].drive.generation, "online")
            (status,) = snapshot(daemon)["axes"]
            assert status["units_witnessed"] == expected


@pytest.mark.e2e
def test_command_turns_a_simulated_axis_after_confirmation(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(
        '[can]\ninterface = "virtual"\nchannel = "x"\n[transport]\ncyclic_port = 0\n'
        "[[axis]]\ndo_id = 3\nnode_id = 5\ntelegram = 9\nsimulate = true\n" + PATIENT
    )
    for _ in range(40):
        result = pdgw("axis", "test", "3", str(file), "--percent", "10", "--turns", "0.5", text="turn 3\n4\n")
        # If the drive or this process is paused, distance and time do not match, and the test correctly fails.
        if not result.returncode:
            break
    assert result.returncode == 0, result.stdout + result.stderr
    assert "Type 'turn 3' to continue:" in result.stdout
    assert "the axis follows its commands" in result.stdout
    assert "units verified on" in result.stdout
