"""The statements of docs/telegrams.md, one test each."""

from __future__ import annotations

from pdgw.dsp402.states import State
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.dsc_setpoint import DscChoices, DscForm
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.catalogue import PARAMETERS
from pdgw.profidrive.parameters.model import BoundParameter, Parameter, answer
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram
from tests.gateway.axis.test_velocity import Bench
from tests.support.axis.positioner import CHOICES
from tests.support.axis.rig import Rig
from tests.support.documents.parts import read_part
from tests.support.documents.profile_numbers import word_positions
from tests.support.documents.statements import PLACE, statement, statement_table

PROFILE = "profile 4.1, general state diagram"
MANUALS = "drive manuals (STW1, ZSW1)"
TIA = "TIA help, SinaPos"
OPC = "OPC 30144, B.2"
EXAMPLE = "a vendor's V4.2 example (parameter manager, table 31 of the profile)"
OFF, ON = 0x047E, 0x047F
READY, STARTING = 0x043E, 0x043F
ZSW1 = signal("ZSW1")
REACHED, TOLERANCE, FAULT = (ZSW1.bit(name).mask for name in ("TARGET_REACHED", "WITHIN_TOLERANCE", "FAULT"))
ACKNOWLEDGED = ZSW1.bit("TASK_ACKNOWLEDGE", positioning=True).mask
POS_STW1, POS_ZSW1 = signal("POS_STW1"), signal("POS_ZSW1")


def turning(number: int = 1) -> Bench:
    bench = Bench(number)
    bench.operate()
    bench.step(ON, 0x2000, cycles=20)
    return bench


def positioner(word: int = 0, **settings: object) -> Rig:
    rig = Rig(111, positioner=CHOICES, **settings)
    rig.values |= {"POS_STW1": word, "OVERRIDE": 0x4000, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000, "MDI_VELOCITY": 6000}
    rig.enable()
    return rig


@statement("A constant ON does not leave 'switching on inhibited': an OFF must come first.", PROFILE)
def test_on_without_off_does_not_start() -> None:
    bench = Bench()
    assert bench.step(ON, cycles=50) & 0x4F == 0x40
    assert bench.stepper.reason is Reason.NEEDS_OFF


@statement("OFF1 ramps to standstill and then removes power; ZSW1.2 is 0 during the ramp.", PROFILE)
def test_off1_ramps_before_power_off() -> None:
    bench = turning()
    assert bench.step(OFF) & 0x07 == 0x03
    assert bench.drive.feedback.velocity_actual > 0
    assert bench.step(OFF, cycles=50) & 0x4F == 0x01


@statement(
    "ON during an OFF1 ramp returns to operation.",
    PROFILE,
    "the stop is completed, unless `ramp_stop_resume` is set",
)
def test_on_during_an_off1_ramp_does_not_resume() -> None:
    bench = turning()
    bench.step(OFF)
    assert bench.step(ON, 0x2000, cycles=50) & 0x04 == 0
    resumed = Bench(ramp_stop_resume=True)
    resumed.operate()
    resumed.step(OFF)
    assert resumed.step(ON, 0x2000, cycles=50) & 0x04


@statement("OFF2 has priority over OFF3 and OFF1.", PROFILE)
def test_off2_has_priority_over_off3() -> None:
    bench = turning()
    bench.step(0x0478, cycles=3)
    assert bench.drive.state is State.SWITCH_ON_DISABLED


@statement("ZSW1.4 is 0 while STW1.1 is 0; ZSW1.5 is 0 while STW1.2 is 0.", MANUALS)
def test_both_off_bits_are_shown() -> None:
    shown = {word: turning().step(word, cycles=3) >> 4 & 0x3 for word in (0x0478, 0x047A, 0x047C)}
    assert shown == {0x0478: 0b00, 0x047A: 0b01, 0x047C: 0b10}


@statement("OFF2 and OFF3 latch: operation needs an OFF and an ON afterwards.", PROFILE)
def test_off3_latches() -> None:
    bench = turning()
    bench.step(0x047B, cycles=20)
    assert bench.step(ON, cycles=20) & 0x4F == 0x40


@statement(
    "STW1.10 = 0: new process data are ignored, the old ones stay in force.",
    MANUALS,
    "OFF1, OFF2 and OFF3 still act and nothing starts, so a telegram of zeros stops the drive; see `control_lost`",
)
def test_a_telegram_of_zeros_stops() -> None:
    bench = turning()
    bench.step(0, cycles=20)
    assert bench.drive.state is State.SWITCH_ON_DISABLED


@statement(
    "STW1.3 = 0 in operation disables the pulses: the axis coasts.",
    MANUALS,
    "it is Disable Operation of CiA 402; 605Ch of the drive defines how the axis stops",
)
def test_disable_operation_uses_the_drives_reaction() -> None:
    bench = turning()
    bench.step(0x0477)
    assert bench.controlword & 0xF == 0x7


@statement("STW1.4 = 0 and STW1.6 = 0 mean speed 0.", MANUALS)
def test_a_disabled_setpoint_is_speed_0() -> None:
    for word in (ON & ~0x10, ON & ~0x40):
        bench = turning()
        bench.step(word, 0x2000)
        assert bench.stepper.command.target_velocity == 0


@statement("STW1.5 = 0 freezes the ramp at its present value.", MANUALS)
def test_the_ramp_freezes() -> None:
    rig = Rig(1)
    rig.enable(OFF)
    rig.values["NSOLL_A"] = 0x4000
    rig.step(14)
    rig.values["STW1"] = ON & ~0x20
    rig.step(100)
    assert 0 < rig.feedback.velocity_actual < 3000


@statement(
    "Telegrams with DSC do not evaluate STW1.4 to .6.",
    "one drive manual",
    "STW1.5 = 0 with .4 and .6 = 1 freezes the speed, as in the other telegrams",
)
def test_dsc_evaluates_freeze_without_other_ramp_bits() -> None:
    rig = Rig(105, dsc=DscChoices(DscForm.SPEED, following_window=4096))
    rig.enable(OFF)
    rig.values |= {"NSOLL_B": 0x1000_0000, "STW1": ON & ~0x70}
    rig.step(100)
    assert rig.feedback.velocity_actual > 0
    rig.values |= {"NSOLL_B": 0, "STW1": ON & ~0x20}
    rig.step(100)
    assert rig.feedback.velocity_actual > 0


@statement("ZSW1.8: the speed follows its demand value within a tolerance.", MANUALS)
def test_the_tolerance_is_shown() -> None:
    rig = Rig(2)
    rig.enable(OFF)
    assert rig.step(5)["ZSW1"] & TOLERANCE


@statement(
    "ZSW1.10 of speed telegrams: the speed is at or above a comparison value.",
    MANUALS,
    "it is Statusword.10 (target reached), because CiA 402 has no comparison value",
)
def test_speed_reached_comes_from_the_drive() -> None:
    rig = Rig(1)
    rig.enable(OFF)
    rig.values["NSOLL_A"] = 0x2000
    assert not rig.step(10)["ZSW1"] & REACHED
    rig.until(lambda actuals: bool(actuals["ZSW1"] & REACHED))
    assert rig.feedback.velocity_actual == 3000


@statement(
    "POS_ZSW1 shows the selected mode; a master waits for it.",
    f"{TIA}; simatic-ax SinaPos",
)
def test_the_selected_mode_is_shown() -> None:
    assert positioner(POS_STW1.word("MDI")).step()["POS_ZSW1"] & POS_ZSW1.word("MDI_ACTIVE", "BLOCK_MODE") == 0x8000


@statement(
    "ZSW1.10 is 1 in an intermediate stop at standstill.",
    "festo-edcon 1.0.3, pause_motion_task()",
    "telegram 9 of another maker has 0 there; `intermediate_stop_reached` selects it",
)
def test_intermediate_stop_does_not_show_target_reached() -> None:
    rig = positioner(POS_STW1.word("MDI", "ABSOLUTE"))
    rig.values |= {"MDI_TARPOS": 400_000, "STW1": ON}
    rig.step(60)
    rig.values["STW1"] = 0x041F
    rig.until(lambda _: rig.feedback.velocity_actual == 0)
    assert not rig.step(5)["ZSW1"] & REACHED


@statement("ZSW1.12 acknowledges a task and falls with STW1.6.", TIA)
def test_the_acknowledge_falls_with_the_edge() -> None:
    rig = positioner(POS_STW1.word("MDI", "ABSOLUTE"))
    rig.values |= {"MDI_TARPOS": 5000, "STW1": ON}
    rig.until(lambda actuals: bool(actuals["ZSW1"] & ACKNOWLEDGED))
    rig.values["STW1"] = STARTING
    assert not rig.step(3)["ZSW1"] & ACKNOWLEDGED


@statement("Jog 1 is backward and jog 2 forward unless configured otherwise.", TIA)
def test_the_direction_of_jog() -> None:
    for bit, sign in ((0x0100, -1), (0x0200, 1)):
        rig = positioner()
        rig.values["STW1"] = STARTING | bit
        rig.step(60)
        assert rig.feedback.velocity_actual * sign > 0


@statement(
    "The override also acts on jog and homing.",
    TIA,
    "jog and homing use their configured speeds; incremental jog is scaled",
)
def test_override_does_not_affect_jog() -> None:
    rig = positioner()
    rig.values |= {"OVERRIDE": 0x0400, "STW1": STARTING | 0x0200}
    rig.step(100)
    full = positioner()
    full.values["STW1"] = STARTING | 0x0200
    full.step(100)
    assert rig.feedback.velocity_actual == full.feedback.velocity_actual > 0


@statement("A rejected task (STW1.4 = 0) ends with 'target reached' at standstill.", TIA)
def test_rejected_task_shows_target_reached() -> None:
    rig = positioner(POS_STW1.word("MDI", "SETTING_UP", "POSITIVE_DIRECTION"))
    rig.values["STW1"] = ON
    rig.step(60)
    rig.values["STW1"] = 0x042F
    rig.until(lambda actuals: bool(actuals["ZSW1"] & REACHED))
    assert rig.feedback.velocity_actual == 0


@statement("FAULT_CODE is the number of the active fault.", TIA)
def test_the_fault_code_is_that_of_a_present_fault() -> None:
    rig = positioner()
    rig.stepper.machine.inputs.fault_code = 7
    assert rig.step()["FAULT_CODE"] == 0
    rig.node.model.inject(7)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & FAULT))
    assert rig.actuals["FAULT_CODE"] == 7


@statement(
    "Telegram 112 has 17 words of setpoints and 12 of actual values, its floats from word 6 on.",
    "S200 manual of 2023; TIA help, BasicPosControl V3.0",
)
def test_the_layout_of_telegram_112() -> None:
    found = telegram(112)
    assert (found.setpoints.words, found.actuals.words) == (17, 12)
    assert word_positions(found.setpoints)[5:] == (6, 8, 10, 12, 14, 16)
    assert word_positions(found.actuals)[5:] == (6, 8, 10, 11, 12)


class _Device:
    def parameter(self, pnu: int) -> Parameter:
        return BoundParameter(PARAMETERS[pnu], lambda: 1)

    def check_writable(self, pnu: int) -> None:
        """Always."""


def _answered(request: str) -> str:
    response = answer(bytes.fromhex(request), lambda _: _Device(), 240)
    assert response is not None
    return response.hex(" ")


@statement(
    "Type codes 37h and 38h are 64-bit integers, 0Fh a 64-bit float, 27h UNICODE, 32h to 36h dates and times.",
    OPC,
)
def test_type_codes() -> None:
    codes = {0x37: "INTEGER64", 0x38: "UNSIGNED64", 0x0F: "FLOATING_POINT64", 0x27: "UNICODE_STRING", 0x32: "DATE"}
    assert {code: DataType.from_code(code).name for code in codes} == codes


@statement("PNU 0 is answered with 16h.", EXAMPLE)
def test_pnu_0_is_refused() -> None:
    assert _answered("01 01 01 01 10 00 00 00 00 00") == "01 81 01 01 44 01 00 16"


@statement("An unknown request ID is answered with error 21h and the response ID 80h.", EXAMPLE)
def test_an_unknown_request_id_is_refused() -> None:
    assert _answered("01 05 01 01 10 00 03 9A 00 00") == "01 80 01 01 44 01 00 21"


@statement("P952 can only be reset (bit 13 of its description).", "Danfoss PROFIBUS manual, parameter description")
def test_p952_is_reset_only() -> None:
    assert int(_answered("01 01 01 01 20 01 03 B8 00 01")[-5:].replace(" ", ""), 16) & 0x2000


@statement(
    "A description names the unit: 11, 67 are revolutions per minute.", "Danfoss PROFIBUS manual, table of units"
)
def test_p60000_is_in_its_documented_unit() -> None:
    assert _answered("01 01 01 01 20 01 EA 60 00 04").endswith("0b 43")


def test_the_document_has_the_statements() -> None:
    assert read_part(*PLACE) == statement_table()
