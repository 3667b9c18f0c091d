"""Upgrade and downgrade: the files of every release are read, those of a newer format are rejected and stay as they are."""

from __future__ import annotations

import gzip
import json
import lzma
import zlib
from pathlib import Path

import pytest

from pdgw.base.durations import SECOND
from pdgw.gateway.base import store
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.store import ParameterStore
from pdgw.gateway.client import dump
from pdgw.gateway.client.dump import Dump
from pdgw.gateway.configuration import config
from pdgw.gateway.configuration.file import config_text, load_config
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.gateway.trace import pcapng
from pdgw.gateway.trace.reader import RingReader
from pdgw.peers.plc.exchange.plc import Plc
from pdgw.peers.world import World
from pdgw.profidrive.telegrams import telegram
from tests.formats.write import HERE
from tests.support import cli

RELEASES = sorted(path.name for path in HERE.iterdir() if path.is_dir() and path.name[0].isdigit())
NEWER = r"format version 2 is unknown, this gateway reads 1 to 1: use the gateway that wrote the file, or a newer one"


@pytest.fixture(params=RELEASES)
def release(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A folder with the files of a release."""
    for path in (HERE / request.param).iterdir():
        data = path.read_bytes()
        (tmp_path / path.name.removesuffix(".gz")).write_bytes(gzip.decompress(data) if path.suffix == ".gz" else data)
    return tmp_path


def test_the_first_release_is_kept() -> None:
    assert "0.9.0" in RELEASES
    assert (config.FORMAT_VERSION, store.FORMAT_VERSION, dump.FORMAT_VERSION, pcapng.VERSION) == (1, 1, 1, 2), (
        "a new version needs a test with files of the version before"
    )


def test_the_configuration_is_read_and_written_with_its_version(release: Path) -> None:
    loaded = load_config(release / "gateway.toml")
    assert (loaded.version, loaded.axis[0].telegram, loaded.transport.cycle_time_ms, loaded.trace.seconds) == (
        1,
        1,
        20,
        10,
    )
    assert config_text(loaded).startswith("version = 1\n")


def test_a_configuration_without_a_version_has_the_first_one(release: Path) -> None:
    path = release / "gateway.toml"
    path.write_text(path.read_text().replace("version = 1\n", ""))
    assert load_config(path).version == 1


def test_the_parameter_store_is_read_whole_and_not_changed(release: Path) -> None:
    path = release / "store.json"
    before = path.read_bytes()
    found = ParameterStore(path, pytest.fail).parameters
    known = found.objects[1]
    assert found.im1_function == "conveyor 3"
    assert (known.telegram, known.sign_of_life_tolerance, known.name) == (2, 5, "infeed")
    assert path.read_bytes() == before


def test_a_gateway_with_these_files_exchanges_frames_of_the_stored_telegram(release: Path) -> None:
    """P922 = 2 is stored, the file has telegram 1; both have frames with the tick."""
    given = load_config(release / "gateway.toml")
    loaded = given.model_copy(update={"store": release / "store.json"})
    world = World()
    world.simulate(loaded)
    daemon = build_gateway(loaded, world)
    daemon.start()
    port = world.network.open("127.0.0.1", 0, "PLC")
    plc = Plc(world.loop, port, daemon.address, [telegram(2)], daemon.cycle_ns)
    plc.start()
    world.loop.until(lambda: plc.value("ZSW1") >= 0, "data exchange", 60 * SECOND)
    assert plc.value("ZSW2") >= 0
    daemon.stop()
    plc.stop()
    world.loop.close()


def test_the_dump_is_read(release: Path) -> None:
    loaded = Dump.load(release / "dump.json")
    assert loaded.do_id == 1
    assert {item.pnu: item.value for item in loaded.parameters if item.subindex == 0}[922] == 1


def test_the_recording_is_read(release: Path) -> None:
    """Those of 0.9.0 have no steps, and no reasons."""
    done = cli.pdgw("timeline", str(release / "recording.pcapng"))
    assert (done.returncode, "+OPERATION_ENABLED" in done.stdout) == (0, True), done.stdout + done.stderr


def test_recorded_steps_of_version_1_are_read(tmp_path: Path) -> None:
    """They have all that has changed, also what the frames have."""
    path = tmp_path / "gateway.pcapng"
    path.write_bytes(lzma.decompress((HERE / "steps-1.pcapng.xz").read_bytes()))
    ring = RingReader(path)
    cycles = ring.cycles()
    speeds = {ring.value(cycle, 0, "feedback", "velocity_actual") for cycle in cycles}
    assert {ring.value(cycle, 0, "command", "target_velocity") for cycle in cycles} == {0, 1500}
    assert (len(speeds), max(filter(None, speeds))) == (81, 1500)
    assert {"NEEDS_OFF", "", "QUICK_STOP", "PLC_LOST"} <= {ring.reason(cycle, 0) for cycle in cycles}
    done = cli.pdgw("timeline", str(path))
    assert (done.returncode, "QUICK_STOP" in done.stdout) == (0, True), done.stdout + done.stderr


# -- files of a newer gateway ------------------------------------------------------------------------------------------------


def test_a_newer_configuration_is_rejected(release: Path) -> None:
    path = release / "gateway.toml"
    path.write_text(path.read_text().replace("version = 1\n", "version = 2\n"))
    with pytest.raises(GatewayError, match=NEWER):
        load_config(path)


def test_a_newer_parameter_store_is_rejected_and_stays_as_it_is(release: Path) -> None:
    """Its telegram and limits may matter: the gateway does not start with the configuration's values instead."""
    path = release / "store.json"
    parameters = json.dumps(json.loads(json.loads(path.read_text())["parameters"]) | {"version": 2, "new": 1})
    path.write_text(json.dumps({"checksum": f"{zlib.crc32(parameters.encode()):08x}", "parameters": parameters}))
    before = path.read_bytes()
    with pytest.raises(GatewayError, match=NEWER):
        ParameterStore(path, pytest.fail)
    assert path.read_bytes() == before
    assert not list(release.glob("store.json.*"))


def test_a_newer_dump_is_rejected(release: Path) -> None:
    path = release / "dump.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"version": 2}))
    with pytest.raises(GatewayError, match=NEWER):
        Dump.load(path)


def test_a_recording_with_a_newer_configuration_is_rejected(release: Path) -> None:
    path = release / "recording.pcapng"
    path.write_bytes(path.read_bytes().replace(b"version = 1\n", b"version = 2\n"))
    done = cli.pdgw("timeline", str(path))
    assert done.returncode != 0
    assert "format version 2" in " ".join(done.stderr.split())
