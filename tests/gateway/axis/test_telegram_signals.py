"""Signals of each telegram: none without a reader or writer, what of the scaling they need, and telegrams of the user's own."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType

import pytest

from pdgw.dsp402.drive_type import DriveType, Quantity
from pdgw.gateway.axis.adapters.encoder_words import EncoderAdapter
from pdgw.gateway.axis.adapters.speed_words import SpeedAdapter
from pdgw.gateway.axis.settings import AxisSettings, needed_quantities
from pdgw.gateway.axis.telegrams import (
    DRIVE_TELEGRAM_NUMBERS,
    ENCODER_TELEGRAM_NUMBERS,
    add_telegram,
    make_adapter,
    own_drive_telegram,
)
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.commissioning.telegram_check import lacks, not_available
from pdgw.gateway.configuration.byte_map import frame_maps
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.defaults import SIMULATED_KEYS
from pdgw.gateway.configuration.file import config_text, parse_config
from pdgw.gateway.configuration.positioner_config import PositionerConfig
from pdgw.peers.world import Gateway, Plc
from pdgw.profidrive import telegrams as catalogue
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import TELEGRAMS, Telegram, telegram
from pdgw.tools.output.data_sheets import write_gsdml
from tests.support.axis.positioner import CHOICES
from tests.support.drives.drive_types import engel
from tests.support.gateways.daemon import drive_of, running, world_of

# -- signals and adapters -----------------------------------------------------------------------------------------


_SETTINGS = AxisSettings(positioner=replace(CHOICES, lu_per_unit=1000))


def with_actual(number: int, name: str) -> Telegram:
    chosen = telegram(number)
    return replace(chosen, actuals=replace(chosen.actuals, signals=(*chosen.actuals.signals, signal(name))))


@pytest.mark.parametrize("number", DRIVE_TELEGRAM_NUMBERS)
def test_adapter_serves_every_signal_of_its_telegram(number: int) -> None:
    make_adapter(telegram(number), _SETTINGS)


def test_speed_adapter_refuses_a_telegram_with_a_position() -> None:
    """Telegram 8, as someone may add it in two lines of data."""
    with pytest.raises(GatewayError, match="telegram 3: SpeedAdapter neither reads nor writes XIST_A"):
        SpeedAdapter(with_actual(3, "XIST_A"), _SETTINGS).check()


@pytest.mark.parametrize("number", ENCODER_TELEGRAM_NUMBERS)
def test_encoder_adapter_refuses_a_signal_that_it_does_not_serve(number: int) -> None:
    EncoderAdapter(telegram(number))
    with pytest.raises(GatewayError, match="neither reads nor writes MIST_GLATT"):
        EncoderAdapter(with_actual(number, "MIST_GLATT"))


# -- scaling that a telegram needs --------------------------------------------------------------------------------


ONLY_SPEED = (Quantity.SPEED,)


@pytest.mark.parametrize(
    ("number", "needed"),
    [(1, ONLY_SPEED), (2, ONLY_SPEED), (3, ONLY_SPEED), (20, ONLY_SPEED), (100, ONLY_SPEED), (9, tuple(Quantity))],
)
def test_telegram_needs_only_the_references_of_its_signals(number: int, needed: tuple[Quantity, ...]) -> None:
    assert needed_quantities(telegram(number)) == needed


def _drive(modes: tuple[int, ...], missing: str = "") -> DriveType:
    drive = engel()
    scaling = replace(drive.scaling, counts_per_revolution=Fraction(4096), acceleration_per_rpm_s=Fraction(1, 10))
    entries = {name: entry for name, entry in drive.entries.items() if name != missing}
    return replace(
        drive, scaling=scaling, modes=MappingProxyType(dict.fromkeys(modes, "")), entries=MappingProxyType(entries)
    )


def test_111_is_refused_without_profile_velocity_mode() -> None:
    assert lacks(_drive((1, 3, 6)), telegram(111)) == ""
    assert "3 for setting up and jog" in lacks(_drive((1, 6, 9)), telegram(111))


def test_a_fixed_stop_is_refused_without_the_actual_current() -> None:
    choices = PositionerConfig.model_validate(SIMULATED_KEYS | {"clamping_torque": 100}).choices(())
    settings = AxisSettings(positioner=choices)
    assert lacks(_drive((1, 3)), telegram(111), settings) == ""
    assert "current_actual: 'not an object of this drive'" in lacks(
        _drive((1, 3), "current_actual"), telegram(111), settings
    )
    assert lacks(_drive((1, 3), "current_actual"), telegram(111)) == "", "without a fixed stop nothing needs it"


@pytest.mark.parametrize("missing", ["profile_acceleration", "target_position", "velocity_actual"])
def test_objects_needed_for_motion_are_never_optional(missing: str) -> None:
    assert "not an object of this drive" in lacks(_drive((1, 3), missing), telegram(9))


@pytest.mark.parametrize("number", [7, 9, 110, 111, 112])
def test_a_drive_without_profile_velocity_is_not_refused(number: int) -> None:
    drive = _drive((1, 3), "profile_velocity")
    assert lacks(drive, telegram(number)) == ""
    assert any(
        "6081h not available: traversing tasks run at" in line for line in not_available(drive, telegram(number))
    )


# -- telegrams of the configuration -------------------------------------------------------------------------------


OWN = """
[[telegram]]
number = 1001
like = 102
setpoints = ["STW1", "G1_STW", "USER", "NSOLL_B", "MOMRED", "STW2"]
actuals = ["ZSW1", "MELDW", "NIST_B", "ZSW2", "G1_ZSW", "G1_XIST1", "G1_XIST2"]
"""
SPEED = (["STW1", "NSOLL_A"], ["ZSW1", "NIST_A"])
WORDS = {"STW1": [0x047F, 0x047F, 0x047E, 0x047B, 0x047D, 0x043F, 0x04FF], "MOMRED": [0, 0x2000], "G1_STW": [0, 0x2000]}


@pytest.fixture(autouse=True)
def nothing_in_the_process() -> Iterator[None]:
    """No test leaves a telegram in the tables of the process."""
    before = dict(TELEGRAMS)
    yield
    assert before == TELEGRAMS


@pytest.fixture
def removed_again() -> Iterator[None]:
    """Remove telegram 1001, which a test adds to the process."""
    yield
    del catalogue._CATALOGUE[1001]


def file(number: int, more: str = "") -> str:
    axis = f"[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = {number}\nsimulate = true\n"
    return f'{more}[can]\ninterface = "virtual"\nchannel = "own"\n{axis}'


def life(number: int, more: str) -> list[tuple[object, ...]]:
    """What the PLC sees and what the drive is sent in some seconds of the same random orders, by the names of the signals."""
    with running(parse_config(file(number, more))) as daemon:
        drive, plc, draw = drive_of(daemon), Plc(world_of(daemon), daemon), random.Random(5)
        seen: list[tuple[object, ...]] = []
        plc.exchange(4, STW1=0x047E)
        for _ in range(30):
            orders = {name: draw.choice(words) for name, words in WORDS.items()}
            plc.exchange(draw.choice((0.01, 0.1, 0.4)), NSOLL_B=draw.randrange(-(1 << 30), 1 << 30), **orders)
            actuals = plc.actuals[0] or {}
            sent = drive.model.controlword, drive.model.target_velocity
            seen.append((*(actuals.get(name) for name in ("ZSW1", "NIST_B", "MELDW", "G1_ZSW", "G1_XIST1")), *sent))
        return seen


def test_own_telegram_is_executed_like_its_base_telegram() -> None:
    known, own = life(102, ""), life(1001, OWN)
    assert own == known
    assert len({row[1] for row in own}) > 10, "the axis turned"


def test_map_and_device_description_contain_the_own_telegram(tmp_path: Path) -> None:
    config = parse_config(file(1001, OWN))
    setpoints, _ = frame_maps(config)
    assert [place.name for place in setpoints.places if place.axis == 1][:6] == [
        "STW1",
        "G1_STW",
        "USER",
        "NSOLL_B",
        "MOMRED",
        "STW2",
    ]
    assert not any("{" in place.description for place in setpoints.places)
    assert "0x000103E9" in write_gsdml(config.transport, tmp_path, "--gsdml", config.telegrams).read_text()
    assert parse_config(config_text(config)) == config


def test_own_telegram_has_six_words_of_the_user_each_way() -> None:
    words = ["USER"] * 4
    own = own_drive_telegram(1001, 1, ["STW1", *words, "NSOLL_A", "USER", "USER"], ["ZSW1", "NIST_A", *words, "USER"])
    assert own.setpoints.names == ("STW1", "USER", "USER_2", "USER_3", "USER_4", "NSOLL_A", "USER_5", "USER_6")
    assert own.actuals.names[-1] == "USER_5"


def test_telegram_of_the_document_has_the_words_of_352() -> None:
    document = (Path(__file__).parents[3] / "docs" / "plc.md").read_text(encoding="utf-8")
    own = parse_config(file(1352, document.partition("```toml\n")[2].partition("```")[0])).axis[0].chosen
    assert (own.setpoints.size, own.actuals.size) == (12, 12)


@pytest.mark.parametrize(
    ("number", "like", "names", "told"),
    [
        (998, 1, SPEED, r"number of a telegram of your own: 998 is not allowed, expected 999\.\.32767"),
        (1001, 9, SPEED, r"like = 9: a telegram of your own can be like one of \[1, 2, 3, 4, 5"),
        (1001, 1, (["STW1"], SPEED[1]), "setpoints: NSOLL_A missing; a telegram like 1 needs NSOLL_A, STW1"),
        (
            1001,
            1,
            ([*SPEED[0], "MOMRED"], SPEED[1]),
            "setpoints: a telegram like 1 cannot have MOMRED; possible: NSOLL_A, ",
        ),
        (1001, 1, (SPEED[0], [*SPEED[1], "XIST_A"]), "actuals: a telegram like 1 cannot have XIST_A"),
        (1001, 1, (SPEED[0], [*SPEED[1], "NIST_B"]), "SpeedAdapter neither reads nor writes NIST_B"),
        (1001, 1, (SPEED[0][::-1], SPEED[1]), "setpoints: STW1 must come first"),
        (1001, 1, (SPEED[0], SPEED[1][::-1]), "actuals: ZSW1 must come first"),
        (1001, 1, ([*SPEED[0], "STW2"], SPEED[1]), "STW2 and ZSW2 belong together"),
        (1001, 1, (["STW1", "NSOL_A"], SPEED[1]), "did you mean NSOLL_A"),
        (
            1001,
            1,
            (["STW1", "NSOLL_A", "STW1"], SPEED[1]),
            "'STW1' is not allowed, expected each signal once, USER 6 times",
        ),
        (
            1001,
            1,
            ([*SPEED[0], *["USER"] * 7], SPEED[1]),
            "'USER' is not allowed, expected each signal once, USER 6 times",
        ),
        (
            1001,
            3,
            (["STW1", "NSOLL_B", "STW2", "G1_STW"], ["ZSW1", "NIST_B", "ZSW2", "G1_ZSW", "G1_XIST2", "G1_XIST1"]),
            "G1_ZSW is not followed by G1_XIST1, G1_XIST2",
        ),
    ],
)
def test_own_telegram_without_an_executor_is_rejected(
    number: int, like: int, names: tuple[list[str], list[str]], told: str
) -> None:
    with pytest.raises((GatewayError, ProfidriveError), match=told):
        own_drive_telegram(number, like, *names)


def test_a_program_can_add_a_telegram_to_its_process(removed_again: None) -> None:
    own = add_telegram(1001, 1, *SPEED)
    assert telegram(1001) is own
    assert parse_config(file(1001)).axis[0].chosen == own
    add_telegram(1001, 1, *SPEED)
    with pytest.raises(ProfidriveError, match="1001 with two layouts"):
        add_telegram(1001, 2, ["STW1", "NSOLL_B"], ["ZSW1", "NIST_B"])


def test_a_configuration_that_is_read_twice_is_the_same() -> None:
    first, second = parse_config(file(1001, OWN)), parse_config(file(1001, OWN))
    assert first == second
    assert config_text(first) == config_text(second)


def test_a_number_has_one_layout_in_a_configuration() -> None:
    other = OWN.replace('"USER", ', "")
    with pytest.raises(GatewayError, match=r"configuration:8: .*1001 with two layouts"):
        parse_config(file(1001, OWN + other))
    assert parse_config(file(1001, OWN + OWN)).axis[0].telegram == 1001


def test_a_telegram_belongs_to_the_file_that_declares_it() -> None:
    other = OWN.replace('"USER", ', "")
    first, second = parse_config(file(1001, OWN)), parse_config(file(1001, other))
    assert "USER" in first.axis[0].chosen.setpoints.names
    assert "USER" not in second.axis[0].chosen.setpoints.names
    assert first != second
    assert 1001 in first.axis[0].telegrams, "P922 can select it"
    with pytest.raises(GatewayError, match="telegram = 1001 is not supported, allowed: "):
        parse_config(file(1001))


def test_a_copy_of_a_configuration_has_its_telegrams() -> None:
    config = parse_config(file(1001, OWN))
    assert GatewayConfig.model_validate(dict(config)) == config
    assert config.with_telegrams({1: 1}).with_telegrams({1: 1001}).axis[0].chosen == config.axis[0].chosen


def test_two_gateways_with_other_telegrams_of_one_number() -> None:
    torque, speed = (
        OWN,
        "[[telegram]]\nnumber = 1001\nlike = 1\n"
        + ('setpoints = ["STW1", "USER", "NSOLL_A"]\nactuals = ["ZSW1", "NIST_A"]\n'),
    )
    with running(parse_config(file(1001, torque))) as one, running(parse_config(file(1001, speed))) as other:
        assert [daemon.axes[0].telegram.setpoints.size for daemon in (one, other)] == [14, 6]
        first, second = (Plc(world_of(daemon), daemon) for daemon in (one, other))
        first.exchange(1, STW1=0x047E)
        second.exchange(1, STW1=0x047E)
        for plc in (first, second):
            assert plc.actuals[0] is not None
        first.exchange(4, STW1=0x047F, NSOLL_B=1 << 28, MOMRED=0)
        second.exchange(4, STW1=0x047F, NSOLL_A=0x1000)
        assert drive_of(one).model.target_velocity == drive_of(other).model.target_velocity != 0


def test_error_names_the_table_of_the_own_telegram() -> None:
    with pytest.raises(GatewayError, match=r":2: \[\[telegram\]\].*actuals: MELDW missing"):
        parse_config(file(1001, OWN.replace('"MELDW"', '"XIST_A"')))


def test_a_plc_of_a_world_commands_an_own_telegram() -> None:
    rated = OWN + '[can]\ninterface = "virtual"\nchannel = "own"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1001\n'
    with Gateway(parse_config(rated + "simulate = true\nrated_speed_rpm = 3000\n")) as gateway:
        gateway.plc.run(8, on=True, speed="300 rpm")
        assert gateway.plc.actual("NIST_B") > 0
        gateway.plc.run(4, on=False)
