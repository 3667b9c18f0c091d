"""A telegram of the user's own, declared in the configuration: carried out as the one it is like, refused where it cannot be."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from pdgw.gateway.axis import telegrams
from pdgw.gateway.axis.telegrams import add_telegram
from pdgw.gateway.configuration.byte_map import frame_maps
from pdgw.gateway.configuration.file import config_text, parse_config
from pdgw.gateway.errors import GatewayError
from pdgw.peers.world import Plc
from pdgw.profidrive import telegrams as catalogue
from pdgw.profidrive.errors import ProfidriveError
from pdgw.tools.output.data_sheets import write_gsdml
from tests.support.gateways.daemon import drive_of, running, world_of

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
def only_here() -> Iterator[None]:
    """Remove the telegrams that a test adds."""
    yield
    for known in (catalogue._CATALOGUE, telegrams.DRIVE_TELEGRAMS):
        for number in [number for number in known if number in catalogue.OWN_NUMBERS]:
            known.pop(number)  # type: ignore[attr-defined]


def file(number: int, more: str = "") -> str:
    axis = f"[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = {number}\nsimulate = true\n"
    return f'{more}[can]\ninterface = "virtual"\nchannel = "own"\n{axis}'


def life(number: int, more: str) -> list[tuple[object, ...]]:
    """What the PLC sees and what the drive is sent in some seconds of the same random orders, by the names of the signals."""
    with running(parse_config(file(number, more))) as daemon:
        drive, plc, draw = drive_of(daemon), Plc(world_of(daemon), daemon), random.Random(5)
        seen: list[tuple[object, ...]] = []
        plc.exchange(4, STW1=0x047E)
        for _ in range(60):
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
    assert "0x000103E9" in write_gsdml(config.transport, tmp_path, "--gsdml").read_text()
    assert parse_config(config_text(config)) == config


def test_own_telegram_has_six_words_of_the_user_each_way() -> None:
    words = ["USER"] * 4
    own = telegrams.add_telegram(
        1001, 1, ["STW1", *words, "NSOLL_A", "USER", "USER"], ["ZSW1", "NIST_A", *words, "USER"]
    )
    assert own.setpoints.names == ("STW1", "USER", "USER_2", "USER_3", "USER_4", "NSOLL_A", "USER_5", "USER_6")
    assert own.actuals.names[-1] == "USER_5"


def test_telegram_of_the_document_has_the_words_of_352() -> None:
    document = (Path(__file__).parents[3] / "docs" / "plc.md").read_text(encoding="utf-8")
    parse_config(file(1352, document.partition("```toml\n")[2].partition("```")[0]))
    own = catalogue.telegram(1352)
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
        add_telegram(number, like, *names)
    assert number not in telegrams.DRIVE_TELEGRAM_NUMBERS


def test_own_telegram_number_has_only_one_layout() -> None:
    add_telegram(1001, 1, *SPEED)
    add_telegram(1001, 1, *SPEED)
    with pytest.raises(ProfidriveError, match="1001 with two layouts"):
        add_telegram(1001, 2, ["STW1", "NSOLL_B"], ["ZSW1", "NIST_B"])


def test_error_names_the_table_of_the_own_telegram() -> None:
    with pytest.raises(GatewayError, match=r":2: \[\[telegram\]\].*actuals: MELDW missing"):
        parse_config(file(1001, OWN.replace('"MELDW"', '"XIST_A"')))
