"""The cause of a loss of the controller: what ended its data, not what somebody else tried before or after."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.service.status import explanation, snapshot
from tests.support.gateways.daemon import axis
from tests.support.gateways.profinet_daemon import OTHER_IP, Plant, abort, configuration, plant, try_to_connect
from tests.support.wire.profinet import PLC_IP, PLC_MAC


@contextmanager
def turning(folder: Path) -> Iterator[Plant]:
    """The controller drives axis 1."""
    with plant(configuration(axis(1), folder / "store.json")) as site:
        drives(site)
        yield site


def drives(site: Plant) -> None:
    site.connect()
    site.enable(1, 0x1000)


def refuse_wrong_tag(site: Plant) -> None:
    """The owner's first Connect has a watchdog that is not allowed."""
    try_to_connect(site, PLC_IP, PLC_MAC, data_hold=0)


def fall_silent(site: Plant) -> None:
    site.killed = True


def release(site: Plant) -> None:
    site.plc.release(site.loop.now())


def sentence(site: Plant) -> str:
    text = snapshot(site.daemon)["axes"][0]["sentence"]
    assert isinstance(text, str)
    return text


def loss(site: Plant) -> str:
    """The text of fault 103."""
    return next(item.text for item in site.daemon.axes[0].faults if item.number == FaultNumber.PLC_LOST)


def explained(site: Plant) -> list[str]:
    """What ``pdgw explain`` prints."""
    return [line["text"] for line in explanation(site.daemon, site.daemon.objects)]


@pytest.mark.parametrize("way", [fall_silent, release], ids=lambda way: way.__name__)
def test_a_refused_controller_is_not_the_cause_of_a_later_loss(tmp_path: Path, way: Callable[[Plant], None]) -> None:
    with turning(tmp_path) as site:
        site.run(SECOND)
        try_to_connect(site)
        site.run(SECOND)
        way(site)
        for seconds in (1, 20):
            site.run(seconds * SECOND)
            assert sentence(site).startswith("Waits: PLC lost: ")
            assert ", since " in sentence(site)
            assert "rejected" not in " ".join((sentence(site), loss(site), *explained(site)))


def test_another_refused_controller_stays_beside_the_silence_of_the_owner(tmp_path: Path) -> None:
    with turning(tmp_path) as site:
        fall_silent(site)
        site.run(2 * SECOND)
        try_to_connect(site, data_hold=0)
        assert sentence(site).startswith("Waits: PLC lost: no valid frame for 3 cycles, since ")
        assert f"Connect from {OTHER_IP} rejected" in snapshot(site.daemon)["plc"]["refused"]


def test_a_refusal_of_the_owner_after_its_loss_is_the_cause(tmp_path: Path) -> None:
    with turning(tmp_path) as site:
        fall_silent(site)
        site.run(2 * SECOND)
        refuse_wrong_tag(site)
        assert "rejected" in sentence(site)


@pytest.mark.parametrize("way", [fall_silent, release], ids=lambda way: way.__name__)
def test_a_refused_connect_ends_with_a_good_relationship(tmp_path: Path, way: Callable[[Plant], None]) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json")) as site:
        refuse_wrong_tag(site)
        assert "rejected" in sentence(site)
        drives(site)
        way(site)
        site.run(2 * SECOND)
        assert "PLC lost" in sentence(site)
        assert "rejected" not in sentence(site) + loss(site)


@pytest.mark.parametrize("code", [0x24, 0x19, 0x02, 0x0B, 0x15], ids="{:02X}".format)
def test_a_received_err_is_kept_as_it_was_on_the_wire(tmp_path: Path, code: int) -> None:
    with turning(tmp_path) as site:
        abort(code)(site)
        site.run(SECOND)
        wanted = f"CF 81 FD {code:02X}"
        assert wanted in sentence(site)
        assert wanted in loss(site)
        assert any(wanted in text for text in explained(site))
        (entry,) = site.link.device.cm.records.log
        assert entry.status == 0xCF81FD00 | code


def test_before_any_connect_the_remedy_is_that_of_profinet(tmp_path: Path) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json")) as site:
        site.run(SECOND)
        assert "no controller has connected to the name of station press-1" in sentence(site)
        assert "modules and telegrams of the controller's project" in sentence(site)
        assert "port" not in sentence(site)


def test_repeated_silence_is_the_cause_until_the_controller_connects_again(tmp_path: Path) -> None:
    with turning(tmp_path) as site:
        for _ in range(3):
            site.plc.silent = True
            site.run(40 * MS)
            site.plc.silent = False
            site.run(200 * MS)
        assert re.search(
            "the PLC is lost repeatedly: its frames come 4. .*ms apart, the limit is 12 ms", sentence(site)
        )
        release(site)
        site.run(100 * MS)
        site.connect()
        assert "repeatedly" not in sentence(site)
