"""The origin of a stop: the first event, whatever follows from it; who began it; and never "Waits" beside a shaft that turns."""

from __future__ import annotations

import ast
import itertools
import re
from datetime import datetime
from pathlib import Path

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.communication import NmtCommand
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.gateway.axis.settings import PlcLossReaction
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAMS
from pdgw.gateway.axis.values import gateway_fault
from pdgw.gateway.base.fault_numbers import By, FaultNumber, Weight
from pdgw.gateway.base.finding_text import finding_text
from pdgw.gateway.base.reasons import AxisState, Finding, Reason
from pdgw.gateway.base.step_text import remedy_text
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.objects.enable_status import EnableStatus
from pdgw.gateway.objects.origins import PROOF_NS, Origins
from pdgw.gateway.service.last_words import LastWords, kept_last_words
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive.model.model import DriveModel
from pdgw.tools.output.status_text import Health, check_line, status_lines
from tests.conformance.rig import COMPLETE
from tests.support.documents.origin_situations import (
    command,
    end_faults,
    find,
    leave_operational,
    lose,
    miss,
    start,
    time_passes,
)
from tests.support.documents.situations import SLOW_PLC, Step, both, in_operation, run_out, words
from tests.support.gateways.daemon import OFF, ON, SIMULATED_POSITIONER, Plc, axis, configuration, drive_of, running
from tests.test_package import ROOT


def silent(plc: Plc, _: Daemon) -> None:
    """The PLC is lost, and sends ON again."""
    plc.silent = True
    run_out(plc, 1000 * MS)
    plc.silent = False


def stop(plc: Plc, _: Daemon) -> None:
    """The PLC is in STOP, and in RUN again."""
    plc.endpoint.run = False
    run_out(plc, 400 * MS)
    plc.endpoint.run = True


EVENTS: dict[str, tuple[Step, By, str]] = {
    "loss of the PLC": (silent, By.PLC, "PLC lost"),
    "STOP of the PLC": (stop, By.PLC, "the PLC was in STOP"),
    "loss of the node": (lose, By.NODE, "node lost: silent"),
    "NMT command of another master": (
        both(command(NmtCommand.ENTER_PRE_OPERATIONAL), find),
        By.OTHER_MASTER,
        "another master has sent NMT command 80h",
    ),
    "Reset Communication of another master": (
        both(command(NmtCommand.RESET_COMMUNICATION), miss, find),
        By.OTHER_MASTER,
        "another master has sent NMT command 82h",
    ),
    "Pre-operational after an EMCY": (both(leave_operational, find), By.NODE, "after EMCY FF01h"),
    "STO": (
        both(start("enable-input-dropped"), time_passes, end_faults),
        By.DRIVE,
        "left operation",
    ),
    "control": (both(words((ON & ~0x400, {})), words((ON, {}))), By.PLC, "control by PLC removed"),
    "OFF3": (both(words((ON & ~0x4, {})), words((ON, {}))), By.PLC, "OFF3 (STW1.2 = 0)"),
}
"""Events that stop an axis while the PLC keeps ON, who causes each, and words of its evidence."""


def status_of(daemon: Daemon) -> EnableStatus:
    return daemon.axes[0].enable_status


@pytest.mark.parametrize("title", EVENTS)
def test_each_stop_without_an_order_has_an_origin_with_its_author(title: str) -> None:
    event, by, evidence = EVENTS[title]
    with in_operation() as (daemon, plc):
        assert daemon.axes[0].origins.present is None
        event(plc, daemon)
        run_out(plc)
        origin = daemon.axes[0].origins.present
        assert origin is not None
        assert (origin.by, evidence in origin.evidence) == (by, True), origin
        assert evidence in status_of(daemon).sentence
        document = snapshot(daemon)["axes"][0]
        assert (document["origin"]["by"], document["origin"]["text"]) == (by.value, origin.evidence)
        plc.endpoint.set(0, {"STW1": OFF})
        run_out(plc)
        assert daemon.axes[0].origins.present is None, "ON works again"


_STATES_AT_REST = (AxisState.WAITS, AxisState.OFF, AxisState.NOT_ON_THE_BUS)
_WITH_STW1 = sorted(number for number in DRIVE_TELEGRAMS if number != 100)


def dsc_keys(number: int) -> str:
    return 'dsc = "speed"\nfollowing_window = 10000\n' if number in (5, 6, 105, 106) else ""


@pytest.mark.parametrize("number", _WITH_STW1 if COMPLETE else _WITH_STW1[::4])
def test_each_stop_without_an_order_has_an_origin_with_every_telegram(number: int) -> None:
    with in_operation(axis(1, telegram_number=number, more=dsc_keys(number) + SIMULATED_POSITIONER)) as (daemon, plc):
        item = daemon.axes[0]
        for title, (event, by, evidence) in EVENTS.items():
            event(plc, daemon)
            run_out(plc)
            assert item.origins.present is not None, title
            assert (item.origins.present.by, evidence in item.origins.present.evidence) == (by, True), title
            words((OFF, {}), (OFF | 0x80, {}), (OFF, {}))(plc, daemon)
            plc.enable()
            assert item.origins.present is None, f"ON works again after {title}"


def test_each_stop_of_a_transparent_telegram_has_an_origin_and_never_waits() -> None:
    with running(configuration(axis(1, telegram_number=100), transport=SLOW_PLC)) as daemon:
        plc, item = Plc(daemon, [100]), daemon.axes[0]
        plc.until(lambda: item.good, "online")
        ramps = {"Profile Acceleration": 300, "Profile Deceleration": 300, "Dynamic Speed Limit": 1000}
        plc.endpoint.set(0, ramps | {"Modes of Operation": 3, "Target Velocity": 500, "Dynamic Torque Limit": 1000})
        for title, (event, by, evidence) in EVENTS.items():
            if title in ("control", "OFF3"):
                continue  # its Controlword is the PLC's own
            for word in (0x06, 0x86, 0x06, 0x0F):
                plc.endpoint.set(0, {"Controlword": word})
                run_out(plc, 400 * MS)
            assert item.turns
            assert item.origins.present is None, f"ON works again before {title}"
            event(plc, daemon)
            for _ in range(50):
                run_out(plc, 20 * MS)
                if item.turns:
                    assert status_of(daemon).state not in _STATES_AT_REST, status_of(daemon).sentence
            assert item.origins.present is not None, title
            assert (item.origins.present.by, evidence in item.origins.present.evidence) == (by, True), title


PAIRS = [pair for pair in itertools.permutations(EVENTS, 2) if "OFF3" not in pair]


@pytest.mark.parametrize("pair", PAIRS if COMPLETE else PAIRS[::3], ids=" - ".join)
def test_a_consequence_never_replaces_the_origin(pair: tuple[str, str]) -> None:
    first, second = (EVENTS[title] for title in pair)
    with in_operation() as (daemon, plc):
        first[0](plc, daemon)
        run_out(plc)
        before = daemon.axes[0].origins.present
        assert before is not None
        evidence = before.evidence
        second[0](plc, daemon)
        run_out(plc)
        after = daemon.axes[0].origins.present
        assert after is not None
        assert (after.evidence, after.by) == (evidence, first[1])
        assert first[2] in status_of(daemon).sentence


@pytest.mark.parametrize("acknowledges", [True, False], ids=["acknowledged", "P952 := 0"])
def test_a_severe_fault_is_shown_until_it_is_acknowledged_after_its_origin(acknowledges: bool) -> None:
    with in_operation() as (daemon, plc):
        words((ON, {"NSOLL_A": 0x1000}))(plc, daemon)
        drive_of(daemon).node.start_fault("deaf")
        plc.silent = True
        for _ in range(40):
            run_out(plc, 100 * MS)
            if daemon.axes[0].origins.severe is not None:
                assert status_of(daemon).state is AxisState.FAULT
        text = status_of(daemon).text
        assert text.startswith("Fault: PLC lost: no valid frame")
        assert "; then: drive does not stop: " in text
        plc.silent = False
        end_faults(plc, daemon)
        plc.until(lambda: daemon.axes[0].good, "online")
        words((OFF, {}), (OFF | 0x80, {}) if acknowledges else (OFF, {}), (OFF, {}))(plc, daemon)
        if not acknowledges:
            daemon.axes[0].clear_faults()
        assert status_of(daemon).state is AxisState.OFF


def test_the_same_event_is_counted_and_acknowledged_events_are_past() -> None:
    with in_operation() as (daemon, plc):
        lose(plc, daemon, 2)
        assert "(2 times)" in status_of(daemon).sentence
        words((ON | 0x80, {}))(plc, daemon)
        assert daemon.axes[0].cause is None
        silent(plc, daemon)
        run_out(plc)
        assert "ON ignored: PLC lost" in status_of(daemon).sentence


@pytest.mark.parametrize("title", EVENTS)
def test_after_a_restart_of_the_gateway_the_last_origin_is_named(title: str) -> None:
    event, _, evidence = EVENTS[title]
    with in_operation() as (daemon, plc):
        event(plc, daemon)
        run_out(plc)
        kept = daemon.origins()
    for ended in ("the last one ended on 2026-03-01 at 04:11:02: stopped as commanded", ""):
        with running(configuration(axis(1), transport=SLOW_PLC), lambda daemon: daemon.recall(ended, kept)) as daemon:  # noqa: B023
            plc = Plc(daemon, [1])
            plc.endpoint.set(0, {"STW1": ON})
            run_out(plc)
            text = status_of(daemon).text
            assert text.startswith("Waits: ON ignored: the gateway has started, since "), text
            assert (ended or "an earlier one has left no word") in text
            assert evidence in text.partition("before: ")[2]
            kept = daemon.origins()
            plc.enable()
            assert daemon.origins() == {}


def test_an_older_fault_is_named_with_what_the_last_gateway_has_kept() -> None:
    kept = {"1": "EMCY 2310h over-current, since 04:11:02"}

    def before(daemon: Daemon) -> None:
        drive_of(daemon).inject(7)
        daemon.recall("", kept)

    with running(configuration(axis(1), transport=SLOW_PLC), before) as daemon:
        plc = Plc(daemon, [1])
        plc.until(lambda: daemon.axes[0].faults, "the fault")
        assert status_of(daemon).text == f"Fault: over-current (older than the connection); before: {kept['1']}"
        assert daemon.origins() == kept, "the next gateway has this too"


def test_time_of_an_origin_has_its_date_a_day_later_and_for_the_next_gateway() -> None:
    loop, origins = VirtualLoop(), Origins(0)
    origins.enter(gateway_fault(FaultNumber.NODE_LOST, "silent", loop.now()))
    assert origins.present is not None
    now = datetime.fromtimestamp(loop.wall())
    for later in (0, 23):
        loop.run_for(later * 3600 * SECOND)
        assert finding_text(origins.present, loop).endswith(f", since {now:%H:%M:%S}")
        assert origins.last(loop).endswith(f", since {now:%H:%M:%S on %Y-%m-%d}")
    loop.run_for(3600 * SECOND)
    assert finding_text(origins.present, loop) == origins.last(loop)


def test_origins_are_kept_with_the_last_words(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    with kept_last_words(4242) as words:
        assert (words.text, words.origins) == ("", {})
        words.keep(VirtualLoop(), lambda: {"1": "node lost, since 04:11:02"})
    with kept_last_words(4242) as words:
        assert words.text.endswith(": stopped as commanded")
        assert words.origins == {"1": "node lost, since 04:11:02"}


def test_origins_of_a_gateway_that_is_killed_are_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    with kept_last_words(4242) as words, in_operation() as (daemon, plc):
        words.keep(daemon.loop, daemon.origins, daemon.last_event)
        lose(plc, daemon)
        run_out(plc)
        killed = LastWords(4242)
        assert killed.text.startswith("the last one was killed or has crashed, its last sign of life was on ")
        assert "ON ignored" not in killed.text, "the next one says in its own line what had stopped the drive object"
        assert daemon.last_event().startswith("axis 1: Waits: ON ignored: node lost: silent")
        assert "Check plug" not in daemon.last_event()
        assert list(killed.origins) == ["1"]
        assert killed.origins["1"].startswith("node lost: silent")
        with kept_last_words(4242):
            assert LastWords(4242).origins == killed.origins, "the next one is killed before it has looked"
        plc.enable()
        run_out(plc)
        assert LastWords(4242).origins == {}, "ON works again"


def test_a_stop_of_the_plc_keeps_its_end_when_the_plc_is_lost_later() -> None:
    with in_operation() as (daemon, plc):
        plc.endpoint.run = False
        run_out(plc)
        plc.endpoint.run = True
        run_out(plc)
        before = status_of(daemon).text
        assert "the PLC was in STOP from " in before
        plc.silent = True
        run_out(plc)
        plc.silent = False
        run_out(plc)
        assert status_of(daemon).text == before


STEPS: tuple[dict[str, int], ...] = (
    {"STW1": ON & ~0x40},
    {"STW1": ON},
    {"STW1": ON & ~0x40},
    {"STW1": ON & ~0x40 | 0x100},
    {"STW1": ON & ~0x10},
    {"STW1": ON},
    {"STW1": ON & ~0x20},
    {"STW1": ON & ~0x40},
    {"STW1": ON & ~0x400},
    {"STW1": ON},
    {"STW1": OFF},
    {"STW1": ON},
    {"STW1": ON & ~0x8},
    {"STW1": ON},
    {"STW1": ON & ~0x2},
    {"STW1": OFF},
    {"STW1": ON},
    {"STW1": ON & ~0x4},
)
TURNING: dict[str, int] = {
    "NSOLL_A": 0x2000,
    "NSOLL_B": 0x2000_0000,
    "MDI_TARPOS": 50_000,
    "MDI_VELOCITY": 0x1000_0000,
    "MDI_ACC": 0x4000,
    "MDI_DEC": 0x4000,
    "OVERRIDE": 0x4000,
    "POS_STW1": 0x8100,
    "SATZANW": 0x8000,
}


@pytest.mark.parametrize("number", _WITH_STW1)
@pytest.mark.parametrize(
    "reaction", PlcLossReaction if COMPLETE else [PlcLossReaction.COAST], ids=lambda item: item.name
)
def test_a_shaft_that_turns_never_waits_and_is_never_off(number: int, reaction: PlcLossReaction) -> None:
    more = f'{dsc_keys(number)}on_plc_loss = "{reaction.value}"\n{SIMULATED_POSITIONER}'
    with in_operation(axis(1, telegram_number=number, more=more)) as (daemon, plc):
        values = {name: value for name, value in TURNING.items() if name in plc.endpoint.setpoints[0]}
        item, turned = daemon.axes[0], 0

        def look(ns: int) -> None:
            nonlocal turned
            for _ in range(ns // (20 * MS)):
                run_out(plc, 20 * MS)
                turned += item.turns
                if item.turns:
                    state = item.enable_status.state
                    assert state not in _STATES_AT_REST, item.enable_status.sentence

        for word in STEPS:
            plc.endpoint.set(0, values | word)
            look(300 * MS)
        plc.endpoint.set(0, {"STW1": OFF})
        look(500 * MS)
        plc.endpoint.set(0, values | {"STW1": ON})
        look(500 * MS)
        plc.silent = True
        look(1500 * MS)
        assert turned or number in (7, 9, 110), "the shaft turned"


def test_line_of_an_axis_has_its_setpoint_and_names_a_lag() -> None:
    def blocked(model: DriveModel, _: int) -> None:
        model.velocity_actual = model.position_actual = 0

    with in_operation() as (daemon, plc):
        plc.endpoint.set(0, {"NSOLL_A": 0x1000})
        run_out(plc)
        assert any("750 of 750 rpm)" in line for line in status_lines(snapshot(daemon), 400))
        assert snapshot(daemon)["axes"][0]["notes"] == []
        plc.endpoint.set(0, {"NSOLL_A": 0})
        run_out(plc)
        drive_of(daemon).model.disguises.append(blocked)
        plc.endpoint.set(0, {"NSOLL_A": 0x1000})
        run_out(plc, 900 * MS)
        assert snapshot(daemon)["axes"][0]["notes"] == [], "its ramp has time"
        run_out(plc, 200 * MS)
        document = snapshot(daemon)
        sentence = document["axes"][0]["sentence"]
        assert re.match(r"In operation: does not follow its setpoint since [\d:]{8}; limits of the drive: ", sentence)
        assert sentence.endswith(". Check brake, torque limit and mechanics.")
        assert any("0 of 750 rpm, does not follow)" in line for line in status_lines(document, 400))
        assert status_of(daemon).state is AxisState.OBEYS
        health, line = check_line(document)
        assert health is Health.WARNING
        assert "axis 1 In operation: does not follow its setpoint since" in line
        assert [event.text for event in daemon.events.after(0) if "does not follow" in event.text]
        drive_of(daemon).model.disguises.clear()
        run_out(plc)
        assert check_line(snapshot(daemon))[0] is Health.OK


def test_an_axis_whose_torque_the_plc_reduces_may_lag() -> None:
    """A winder: its speed setpoint is above the speed of the material, which is at standstill here."""

    def holds(model: DriveModel, _: int) -> None:
        model.velocity_actual = model.position_actual = 0

    with in_operation(axis(1, telegram_number=102)) as (daemon, plc):
        drive_of(daemon).model.disguises.append(holds)
        plc.endpoint.set(0, {"NSOLL_B": 0x1000_0000, "MOMRED": 0x2000})
        run_out(plc, 2000 * MS)
        document = snapshot(daemon)
        assert check_line(document)[0] is Health.OK
        (note,) = [note for note in document["axes"][0]["notes"] if "does not follow" in note]
        assert "limited by MOMRED = 50.000 %" in note
        plc.endpoint.set(0, {"MOMRED": 0})
        run_out(plc, 100 * MS)
        assert check_line(snapshot(daemon))[0] is Health.WARNING


def test_every_gateway_fault_names_its_author_and_remedy() -> None:
    for fault in FaultNumber:
        assert fault.by in By
        text = remedy_text(fault.remedy)
        assert text[0].islower() or text[0] == "C"
    severe = {fault for fault in FaultNumber if fault.weight is Weight.SEVERE}
    assert severe == {
        FaultNumber.STATE_UNKNOWN,
        FaultNumber.STOP_IGNORED,
        FaultNumber.ENABLE_UNASKED,
        FaultNumber.VELOCITY,
    }


def test_fault_acknowledged_while_on_stays_needs_an_off_and_an_on() -> None:
    with running(configuration(axis(1))) as daemon:
        plc = Plc(daemon, [1])
        plc.enable()
        drive_of(daemon).inject(7)
        plc.exchange(60)
        drive_of(daemon).clear()
        for word in (ON | 0x80, ON):
            plc.endpoint.set(0, {"STW1": word})
            plc.exchange(50)
        text = " ".join("\n".join(status_lines(snapshot(daemon))).split())
        assert "ON ignored: EMCY 2310h over-current" in text
        assert "a blocked axis; then OFF and ON." in text


# -- a proof replaces the guess -----------------------------------------------------------------------------------


def guessed(number: FaultNumber, by: By | None = None) -> Origins:
    origins = Origins(0)
    origins.released(1)
    origins.enter(gateway_fault(number, "first symptom", SECOND, by))
    return origins


def prove(origins: Origins, after_ns: int) -> str:
    origins.prove(_PROOF._replace(since_ns=SECOND + after_ns))
    assert origins.present is not None
    return origins.present.evidence


_PROOF = Finding(Reason.BUS_LOST, "what it was", ("what to do",), by=By.BUS)
GUESSES = [FaultNumber.NODE_LOST, FaultNumber.NODE_RESTARTED, FaultNumber.LEFT_OPERATION]


@pytest.mark.parametrize("number", GUESSES)
def test_a_proof_shortly_after_a_loss_replaces_its_first_symptom(number: FaultNumber) -> None:
    origins = guessed(number)
    assert prove(origins, PROOF_NS) == "what it was"
    assert origins.present is not None
    assert (origins.present.number, origins.present.by, origins.present.since_ns) == (number, By.BUS, SECOND)


def test_a_proof_that_comes_before_the_report_of_the_loss_replaces_it_too() -> None:
    origins = Origins(0)
    origins.released(1)
    origins.prove(_PROOF._replace(since_ns=SECOND - 1))
    origins.enter(gateway_fault(FaultNumber.NODE_LOST, "first symptom", SECOND))
    assert origins.present is not None
    assert (origins.present.evidence, origins.present.remedy) == ("what it was", ("what to do",))


@pytest.mark.parametrize("by", [By.OTHER_MASTER, By.GATEWAY])
def test_a_cause_that_is_known_stays(by: By) -> None:
    assert "first symptom" in prove(guessed(FaultNumber.NODE_LOST, by), 0)


def test_other_faults_and_losses_long_ago_stay() -> None:
    assert "first symptom" in prove(guessed(FaultNumber.STOP_IGNORED), 0)
    assert "first symptom" in prove(guessed(FaultNumber.NODE_LOST), PROOF_NS + 1)


_CUTS = {"partition", "rpartition", "split", "rsplit", "removeprefix", "removesuffix", "format", "compile"}
_ROOMS = (
    "ds301/node",
    "dsp402/drive",
    "dsp402/units",
    "gateway/axis",
    "gateway/base",
    "gateway/objects",
    "gateway/service",
    "tools/web/status",
)
_OTHER_TEXTS = {
    "finding_text.py": "the renderer of findings",
    "step_text.py": "the renderer of remedies",
    "units.py": "units of a configuration",
    "identity.py": "numbers of a version",
    "log_budget.py": "lines of the log",
    "ports.py": "files of the kernel",
    "run_directory.py": "variables of the environment",
    "store.py": "variables of the environment",
    "status_port.py": "requests of a client",
}
"""Files that take texts apart, and which."""


def _takes_apart(node: ast.AST) -> bool:
    """A method that cuts a text, puts other words into it or fills it; not the one of a literal."""
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
        return False
    name, text = node.func.attr, node.func.value
    cuts = name in _CUTS or (name == "replace" and len(node.args) > 1)
    return cuts and not isinstance(text, ast.Constant)


def test_no_text_is_taken_apart_into_fields() -> None:
    """Evidence, times and remedy are fields from the place where they are known, and one text at the end."""
    files = [file for room in _ROOMS for file in (ROOT / room).rglob("*.py")]
    found = {file.name for file in files if any(map(_takes_apart, ast.walk(ast.parse(file.read_text("utf-8")))))}
    assert found == set(_OTHER_TEXTS)


def test_nothing_below_the_daemon_makes_the_text_of_a_status() -> None:
    """What decides knows findings and steps, and no text of them."""
    rooms = ("ds301", "dsp402", "dsp406", "gateway/axis", "gateway/configuration")
    files = [file for room in rooms for file in (ROOT / room).rglob("*.py")]
    assert not [file for file in files if re.search("(finding|step)_text", file.read_text("utf-8"))]
    assert "_text import" not in (ROOT / "gateway/base/reasons.py").read_text("utf-8")
