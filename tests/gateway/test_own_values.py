"""The drive's own limits and ramps, which the gateway overwrites, survive a crash of the gateway beside a drive with power."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from pdgw.ds301.aborts import SdoAbortedError
from pdgw.ds301.communication import LOAD_SIGNATURE, NMT, NmtCommand
from pdgw.dsp402.drive.client import DriveClient
from pdgw.dsp402.drive.own_values import OwnValueKeeper, OwnValues
from pdgw.dsp402.identification.describe import OPTIONAL_OBJECTS, questions
from pdgw.dsp402.identification.generic import generic_dictionary
from pdgw.dsp402.pdo.layouts import LAYOUTS
from pdgw.dsp402.states import State, state_of
from pdgw.gateway.base.store import ParameterStore
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.drive import SimulatedDrive, shape
from pdgw.peers.node.node import Value
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import ParameterAddress, Values
from tests.support.gateways.daemon import (
    OFF,
    SIMULATED_POSITIONER,
    Plc,
    axis,
    client,
    configuration,
    drive_of,
    exchanging,
    operating,
    record_server,
    running,
    world_of,
)
from tests.support.gateways.parameters import word, write
from tests.support.gateways.recorded_daemon import recorded, replay_of

MAX_TORQUE, ACCELERATION, SERIAL = (0x6072, 0), (0x6083, 0), (0x1018, 4)
FACTORY = 3000
"""6072h of a simulated drive without stored parameters."""
KEPT = (MAX_TORQUE, ACCELERATION, SERIAL, (0x6099, 1), (0x6099, 2))
ACTIVATE, HOMING = 0x40, 0x800
READY, GO = 0x043E, 0x043F
CLAMPS = """[[axis.block]]
number = 1
task = "fixed-stop"
mode = "relative"
position = 1000000
velocity = 6000
value = 250
"""
REDUCED = {"MOMRED": 0x2000}


def speed(number: int) -> GatewayConfig:
    return configuration(axis(1, telegram_number=number))


def clamping() -> GatewayConfig:
    return configuration(axis(1, telegram_number=111, more=SIMULATED_POSITIONER + CLAMPS))


@dataclass
class Site:
    """A drive that keeps its power while gateways beside it come and go."""

    store: Path | None
    shown: dict[tuple[int, int], Value] = field(default_factory=dict)
    """What the drive shows to the next gateway."""
    _file: bytes | None = None

    @contextmanager
    def gateway(self, config: GatewayConfig, folder: Path | None = None) -> Iterator[Plc]:
        """A gateway, and its PLC; ``folder``: of its recording."""

        def prepare(daemon: Daemon) -> None:
            node = drive_of(daemon).node
            node.stored.update(self.shown)
            node.restart()

        with TemporaryDirectory() as other:
            chosen = config.model_copy(update={"store": self.store})
            with recorded(chosen, folder or Path(other), prepare) as plc:
                yield plc
        if self.store is not None and self._file is not None:
            self.store.write_bytes(self._file)
            self._file = None

    def crash(self, plc: Plc) -> None:
        """What this gateway does after now, in the drive and in its file, did not happen."""
        node = drive_of(plc.daemon).node
        self.shown = {address: node.read(*address) for address in KEPT}
        self._file = None if self.store is None or not self.store.exists() else self.store.read_bytes()

    def kept(self) -> OwnValues:
        assert self.store is not None
        return ParameterStore(self.store, pytest.fail).parameters.drive_object(1).own_values


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "store.json")


def torque(plc: Plc) -> int:
    return drive_of(plc.daemon).node.model.max_torque


def start(plc: Plc) -> None:
    plc.enable() if plc.daemon.axes[0].telegram.number != 111 else enable_positioner(plc)


def enable_positioner(plc: Plc) -> None:
    if plc.daemon.axes[0].telegram.number == 111:
        plc.endpoint.set(0, {"OVERRIDE": 0x4000, "POS_STW1": 1})
    plc.endpoint.set(0, {"STW1": READY})
    plc.exchange()
    plc.exchange()
    plc.until(lambda: plc.state() == 0x01, "ready")
    plc.endpoint.set(0, {"STW1": GO})
    plc.until(lambda: plc.state() == 0x07, "operation")


def press(plc: Plc) -> None:
    """A fixed stop with 250 of 1000."""
    enable_positioner(plc)
    plc.endpoint.set(0, {"STW1": GO | ACTIVATE})
    plc.until(lambda: torque(plc) == 250 and plc.value("NIST_B") > 0, "a fixed stop on its way")


def reduce(plc: Plc) -> None:
    """Half of the torque."""
    own = torque(plc)
    plc.enable()
    plc.endpoint.set(0, REDUCED)
    plc.until(lambda: torque(plc) == own // 2, "half of the torque")


def test_a_new_gateway_knows_the_torque_limit_that_a_fixed_stop_had_lowered(site: Site) -> None:
    with site.gateway(clamping()) as plc:
        press(plc)
        own = plc.daemon.axes[0].drive.drive_type.max_torque
        site.crash(plc)
    for _ in range(2):
        with site.gateway(clamping()) as plc:
            assert torque(plc) == 250
            plc.until(lambda: plc.daemon.axes[0].drive.generation > 0, "a drive online")
            assert torque(plc) == plc.daemon.axes[0].drive.drive_type.max_torque == own
            press(plc)
            site.crash(plc)


def test_reductions_of_one_gateway_after_the_other_do_not_compound(site: Site) -> None:
    with site.gateway(speed(102)) as plc:
        own = torque(plc)
        reduce(plc)
        site.crash(plc)
    for _ in range(2):
        with site.gateway(speed(102)) as plc:
            assert torque(plc) == own // 2
            plc.endpoint.set(0, REDUCED)
            plc.enable()
            assert torque(plc) == own // 2
            site.crash(plc)


@pytest.mark.parametrize("telegram", [1, 111])
def test_another_telegram_of_a_new_gateway_has_the_drives_own_torque(site: Site, telegram: int) -> None:
    with site.gateway(speed(102)) as plc:
        own = torque(plc)
        reduce(plc)
        site.crash(plc)
    with site.gateway(clamping() if telegram == 111 else speed(telegram)) as plc:
        start(plc)
        assert torque(plc) == own
    assert site.kept() == OwnValues()


def test_another_telegram_of_a_new_gateway_has_the_drives_own_ramp(site: Site) -> None:
    site.shown = {ACCELERATION: 777}
    with site.gateway(clamping()) as plc:
        press(plc)
        site.crash(plc)
    assert site.shown[ACCELERATION] != 777
    with site.gateway(speed(1)) as plc:
        plc.enable()
        assert drive_of(plc.daemon).node.read(*ACCELERATION) == 777


def test_another_telegram_of_a_new_gateway_has_the_drives_own_homing_speeds(site: Site) -> None:
    site.shown = {(0x6099, 1): 50, (0x6099, 2): 10}
    with site.gateway(speed(9)) as plc:
        plc.endpoint.set(0, {"SATZANW": 0x8000 | 35, "MDI_VELOCITY": 1 << 29})
        enable_positioner(plc)
        plc.endpoint.set(0, {"STW1": GO | HOMING})
        plc.until(lambda: plc.value("ZSW1") & 0x800, "homed")
        site.crash(plc)
    assert site.shown[0x6099, 1] != 50
    with site.gateway(clamping()) as plc:
        enable_positioner(plc)
        assert [drive_of(plc.daemon).node.read(0x6099, sub) for sub in (1, 2)] == [50, 10]


def test_a_client_may_not_change_the_limit_that_a_fixed_stop_restores(site: Site) -> None:
    with site.gateway(clamping()) as plc:
        assert plc.daemon.axes[0].owns(*MAX_TORQUE)
    with site.gateway(configuration(axis(1, telegram_number=111, more=SIMULATED_POSITIONER))) as plc:
        assert not plc.daemon.axes[0].owns(*MAX_TORQUE)


def test_no_other_object_that_is_overwritten_is_read_as_a_property_of_the_drive() -> None:
    """What a drive is asked at its start, beside the existence of optional objects."""
    commanded = {entry.address for layout in LAYOUTS.values() for pdo in layout.rpdos for entry in pdo.entries}
    by_sdo = {MAX_TORQUE, (0x6098, 0), (0x6099, 1), (0x6099, 2), (0x6007, 0), (0x60C2, 1), (0x60C2, 2)}
    asked = set(questions(generic_dictionary())) - OPTIONAL_OBJECTS
    assert asked & (commanded | by_sdo) == {MAX_TORQUE}


def test_an_orderly_stop_writes_back_what_was_overwritten(site: Site) -> None:
    site.shown = {ACCELERATION: 777}
    with site.gateway(clamping()) as plc:
        press(plc)
        node = drive_of(plc.daemon).node
        assert len(site.kept().values) > 2
    assert node.read(*ACCELERATION) == 777
    assert node.read(*MAX_TORQUE) != 250
    assert site.kept() == OwnValues()


def test_a_drive_in_exchange_keeps_its_own_limit(site: Site, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    with site.gateway(clamping()) as plc:
        press(plc)
        site.crash(plc)
    site.shown |= {SERIAL: 4711, MAX_TORQUE: 800}
    with site.gateway(clamping()) as plc:
        enable_positioner(plc)
        assert torque(plc) == plc.daemon.axes[0].drive.drive_type.max_torque == 800
    assert "another drive (1018h)" in caplog.text


def test_a_limit_that_another_tool_wrote_meanwhile_is_the_drives_own(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    with site.gateway(clamping()) as plc:
        press(plc)
        site.crash(plc)
    site.shown[MAX_TORQUE] = 800
    with site.gateway(clamping()) as plc:
        enable_positioner(plc)
        assert torque(plc) == 800
    assert "6072h = 800 is the drive's own value now" in caplog.text


def test_an_exchanged_drive_has_its_own_limit_in_the_same_gateway(site: Site) -> None:
    with site.gateway(clamping()) as plc:
        press(plc)
        node = drive_of(plc.daemon).node
        node.stored |= {SERIAL: 4711, MAX_TORQUE: 800}
        drive_of(plc.daemon).do(lambda item: item.restart())
        plc.until(lambda: not plc.daemon.axes[0].powered, "a drive that is lost")
        enable_positioner(plc)
        plc.exchange(50)
        assert torque(plc) == 800


def test_without_a_store_the_loss_by_a_crash_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    with Site(None).gateway(speed(102)) as plc:
        plc.enable()
    assert "no parameter store: a crash of the gateway loses the drive's own 6072h" in caplog.text


def test_drive_stores_its_own_limit_while_the_plc_reduces_it(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    with site.gateway(speed(102)) as plc:
        own, node = torque(plc), drive_of(plc.daemon).node
        reduce(plc)
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: not plc.daemon.axes[0].powered, "off")
        stored: list[int] = []
        monkeypatch.setattr(node, "_store", lambda *_: stored.append(torque(plc)))
        with exchanging(plc), client(plc.daemon, record_server(plc.daemon).address, 1) as parameters:
            assert not write(parameters, 971, word(1)).failed
        assert stored == [own]
        plc.until(lambda: torque(plc) == own // 2, "half of the torque again")
        start(plc)


def test_what_a_drive_restores_is_its_own(site: Site) -> None:
    site.shown = {MAX_TORQUE: 1200}
    with site.gateway(speed(102)) as plc:
        reduce(plc)
        assert torque(plc) == 600
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: not plc.daemon.axes[0].powered, "off")
        generation = plc.daemon.axes[0].drive.generation
        with exchanging(plc), client(plc.daemon, record_server(plc.daemon).address, 1) as parameters:
            assert not write(parameters, 970, word(1)).failed
        plc.until(lambda: plc.daemon.axes[0].drive.generation > generation, "a drive online again")
        drive = plc.daemon.axes[0].drive.drive_type
        assert drive is not None
        assert drive.max_torque == FACTORY
        plc.until(lambda: torque(plc) == FACTORY // 2, "half of the restored torque")


@pytest.mark.parametrize("clamps", [True, False])
def test_replay_of_a_gateway_after_a_crash_is_equal(site: Site, tmp_path: Path, clamps: bool) -> None:
    config, lower = (clamping(), press) if clamps else (speed(102), reduce)
    with site.gateway(config) as plc:
        lower(plc)
        site.crash(plc)
    with site.gateway(config, tmp_path) as plc:
        lower(plc) if clamps else start(plc)
        plc.endpoint.set(0, {} if clamps else REDUCED)
        plc.exchange(100)
        other = world_of(plc.daemon).bus("world").join("another tool")
        other.send(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, 1)))
        plc.until(lambda: not plc.daemon.axes[0].powered, "a lost node")
        start(plc)
        plc.exchange(100)
    assert not replay_of(tmp_path)[0].differences


def test_a_drive_that_may_have_been_exchanged_keeps_its_lower_limit(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    site.shown = {SERIAL: 0}
    with site.gateway(speed(102)) as plc:
        reduce(plc)
        site.crash(plc)
    site.shown[MAX_TORQUE] = 800
    with site.gateway(speed(102)) as plc:
        start(plc)
        drive = plc.daemon.axes[0].drive.drive_type
        assert drive is not None
        assert torque(plc) == drive.max_torque == 800
    assert "no serial number (1018h/4)" in caplog.text


def test_a_drive_without_a_product_code_comes_online_again(tmp_path: Path) -> None:
    text = (
        (Path(__file__).parents[2] / "dsp402/eds/engel.eds")
        .read_text()
        .replace("ProductNumber=0x1\n", "ProductNumber=0\n")
    )
    eds = tmp_path / "drive.eds"
    eds.write_text(re.sub(r"\[1018sub2\].*?(?=\n\[)", "", text, flags=re.DOTALL))

    def prepare(daemon: Daemon) -> None:
        node = drive_of(daemon).node
        node.entries = {address: entry for address, entry in node.entries.items() if address != (0x1018, 2)}

    config = configuration(axis(1, telegram_number=102, more=f'simulate = true\neds = "{eds}"'))
    with running(config, prepare) as daemon:
        plc = Plc(daemon, [102])
        drive = daemon.axes[0].drive
        plc.until(lambda: drive.generation == 1, "online")
        assert drive.own_values
        drive_of(daemon).do(lambda item: item.restart())
        plc.until(lambda: drive.generation == 2, "online again")


def refuse(plc: Plc, method: str, address: tuple[int, int], times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The drive aborts the next accesses to an object (0800 0022h)."""
    node = drive_of(plc.daemon).node
    access, left = getattr(node, method), [times]

    def refusing(index: int, subindex: int, *args: object, **options: object) -> object:
        if (index, subindex) == address and left[0]:
            left[0] -= 1
            raise SdoAbortedError(0x08000022)
        return access(index, subindex, *args, **options)

    monkeypatch.setattr(node, method, refusing)


def test_a_drive_that_refuses_its_own_value_comes_online(
    site: Site, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level(logging.INFO)
    with site.gateway(clamping()) as plc:
        press(plc)
        site.crash(plc)
    with site.gateway(speed(1)) as plc:
        refuse(plc, "set_data", ACCELERATION, 1000, monkeypatch)
        start(plc)
        assert "6083h" in caplog.text
        assert "is not written back" in caplog.text
        assert site.kept().values, "kept for the next start"


def test_a_limit_that_cannot_be_read_once_is_not_forgotten(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    with site.gateway(clamping()) as plc:
        press(plc)
        drive = plc.daemon.axes[0].drive
        assert drive.drive_type is not None
        own, generation = drive.drive_type.max_torque, drive.generation
        refuse(plc, "get_data", MAX_TORQUE, 1, monkeypatch)
        other = world_of(plc.daemon).bus("world").join("another tool")
        other.send(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, 1)))
        plc.until(lambda: drive.generation > generation, "online again")
        assert drive.drive_type.max_torque == own


def test_a_save_that_failed_is_repeated(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    with site.gateway(speed(102)) as plc:
        plc.until(lambda: plc.daemon.axes[0].drive.generation == 1, "online")
        drive, values = plc.daemon.axes[0].drive, site.kept()
        assert values.values
        results = [False, True]
        monkeypatch.setattr(drive.own_values, "save", lambda _: results.pop(0))
        drive.own_values._values.pop(MAX_TORQUE)
        drive.own_values.commit()
        drive.own_values.commit()
        drive.own_values.commit()
        assert results == []


def test_a_value_that_a_client_writes_is_the_drives_own(site: Site) -> None:
    with site.gateway(speed(9)) as plc:
        plc.endpoint.set(0, {"SATZANW": 0x8000 | 35, "MDI_VELOCITY": 1 << 29})
        enable_positioner(plc)
        plc.endpoint.set(0, {"STW1": GO | HOMING})
        plc.until(lambda: plc.value("ZSW1") & 0x800, "homed")
        drive = plc.daemon.axes[0].drive
        assert (0x6099, 1) in drive.own_values
        done = drive.submit(lambda node: node.write_for_client(0x6099, 1, bytes((100, 0, 0, 0))))
        plc.until(done.done, "written")
        done.result()
        assert drive_of(plc.daemon).node.read(0x6099, 1) == 100
        assert (0x6099, 1) not in {item.address for item in site.kept().values}


def switch_off(plc: Plc) -> None:
    plc.endpoint.set(0, {"STW1": OFF})
    plc.until(lambda: not plc.daemon.axes[0].powered, "off")


def test_what_a_drive_restores_by_a_raw_write_is_its_own(site: Site) -> None:
    site.shown = {MAX_TORQUE: 1200}
    with site.gateway(speed(102)) as plc:
        reduce(plc)
        switch_off(plc)
        drive = plc.daemon.axes[0].drive
        with exchanging(plc), client(plc.daemon, record_server(plc.daemon).address, 1) as parameters:
            answers = parameters.request(
                [ParameterAddress(0x1011, 1, 1)], [Values(DataType.UNSIGNED32, (LOAD_SIGNATURE,))]
            )
            assert not answers[0].failed
        for _ in range(2):
            generation = drive.generation
            plc.until(lambda before=generation: drive.generation > before, "a drive online again")  # type: ignore[misc]
            drive_of(plc.daemon).do(lambda item: item.restart())  # the engineer's reset
        generation = drive.generation
        plc.until(lambda: drive.generation > generation, "online after the reset")
        assert drive.drive_type is not None
        assert drive.drive_type.max_torque == FACTORY
        plc.until(lambda: torque(plc) == FACTORY // 2, "half of the restored torque")


@pytest.mark.parametrize("operates", [False, True])
def test_own_values_are_written_back_without_torque_only(
    site: Site, caplog: pytest.LogCaptureFixture, operates: bool
) -> None:
    caplog.set_level(logging.INFO)
    site.shown = {ACCELERATION: 777}
    with site.gateway(clamping()) as plc:
        press(plc)
        drive, node = plc.daemon.axes[0].drive, drive_of(plc.daemon).node
        if not operates:
            plc.endpoint.set(0, {"STW1": GO & ~0x8})
            plc.until(lambda: state_of(drive.feedback.statusword) is State.SWITCHED_ON, "switched on")
        done = drive.submit(DriveClient.write_back)
        plc.until(done.done, "written back")
        done.result()
        assert (node.read(*ACCELERATION) == 777) is not operates
        told = "in Operation Enabled: the drive's own values are not written back"
        plc.until(lambda: not operates or told in caplog.text, "a line in the log")


def test_an_own_value_that_cannot_be_read_is_named(
    site: Site, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level(logging.INFO)
    with site.gateway(clamping()) as plc:
        press(plc)
        switch_off(plc)
        refuse(plc, "get_data", ACCELERATION, 1, monkeypatch)
    assert "is not written back: it cannot be read now" in caplog.text


def test_torque_limit_is_not_lowered_while_its_own_value_cannot_be_read(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    with site.gateway(clamping()) as plc:
        enable_positioner(plc)
        own, axis_1 = torque(plc), plc.daemon.axes[0]
        refuse(plc, "get_data", MAX_TORQUE, 1, monkeypatch)
        plc.endpoint.set(0, {"STW1": GO | ACTIVATE})
        plc.until(lambda: axis_1.faults or torque(plc) == 250, "an answer to the torque limit")
        assert torque(plc) == own
        assert "an object that can be read" in axis_1.faults[-1].text


def keeper(shown: dict[tuple[int, int], int]) -> OwnValueKeeper:
    def set_value(index: int, subindex: int, data: bytes) -> None:
        if data == bytes(2):
            raise SdoAbortedError(0x06090030)
        shown[index, subindex] = int.from_bytes(data, "little")

    return OwnValueKeeper(lambda *address: shown[address].to_bytes(2, "little"), set_value, lambda *_: None)


def test_number_of_values_that_count_as_written_is_limited() -> None:
    shown = {MAX_TORQUE: 1000}
    values = keeper(shown)
    saved: list[OwnValues] = []
    values.save = lambda item: not saved.append(item)  # type: ignore[func-returns-value]
    for value in range(1, 900):
        values.write(*MAX_TORQUE, value.to_bytes(2, "little"))
        (kept,) = saved[-1].values
        assert kept.written is not None
        assert len(kept.written) <= 16
        assert value in kept.written
    count = len(saved)
    for value in (890, 899, 890):
        values.write(*MAX_TORQUE, value.to_bytes(2, "little"))
    assert len(saved) == count, "the store is not written for values that it has"
    values.write_back()
    assert shown[MAX_TORQUE] == 1000


def test_values_that_a_drive_refuses_do_not_replace_the_one_it_has() -> None:
    shown = {MAX_TORQUE: 1000}
    values = keeper(shown)
    values.write(*MAX_TORQUE, (250).to_bytes(2, "little"))
    for _ in range(100):
        with pytest.raises(SdoAbortedError):
            values.write(*MAX_TORQUE, bytes(2))
    values.write_back()
    assert shown[MAX_TORQUE] == 1000


def test_identity_and_serial_number_are_read_once_at_a_start(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    with site.gateway(clamping()) as plc:
        press(plc)
        switch_off(plc)
        drive, node = plc.daemon.axes[0].drive, drive_of(plc.daemon).node
        assert drive.own_values
        get, read = node.get_data, list[tuple[int, int]]()

        def counting(index: int, subindex: int, *args: object, **options: object) -> bytes:
            read.append((index, subindex))
            return get(index, subindex, *args, **options)  # type: ignore[arg-type]

        monkeypatch.setattr(node, "get_data", counting)
        generation = drive.generation
        drive_of(plc.daemon).do(lambda item: item.restart())
        plc.until(lambda: drive.generation > generation, "online again")
        assert [read.count((0x1018, subindex)) for subindex in (1, 2, 4)] == [1, 1, 1]


def test_a_drive_guarded_by_its_rpdo_has_no_fault_while_it_stores(site: Site) -> None:
    drives: list[SimulatedDrive] = []

    def prepare(daemon: Daemon) -> None:
        drives.append(world_of(daemon).drive("world", 1, shape=shape("rpdo-timeout")))

    with operating(configuration(axis(1, telegram_number=102, more="")), prepare) as (daemon, plc):
        axis_1 = daemon.axes[0]
        plc.endpoint.set(0, REDUCED)
        switch_off(plc)
        guarding = axis_1.drive.guarding
        assert guarding is not None
        assert guarding.rpdos
        faults = len(axis_1.faults)
        plc.until(lambda: axis_1.drive.own_values, "own values")
        drives[0].do(lambda node: node.start_fault("slow-sdo", delay_ms=250))
        with exchanging(plc), client(daemon, record_server(daemon).address, 1) as parameters:
            assert not write(parameters, 971, word(1)).failed
        assert list(axis_1.faults)[faults:] == []
