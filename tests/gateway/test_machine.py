"""What the machine does to a gateway: clock steps, suspend, no descriptors, a full file system, a killed process."""

from __future__ import annotations

import errno
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from pdgw.base.durations import SECOND
from pdgw.ds301.loop.system_loop import MACHINE_CLOCK, SystemLoop
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.store import DeviceParameters, ParameterStore
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import load_config
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from pdgw.gateway.trace.reader import RingReader
from pdgw.gateway.trace.recorder import FlightRecorder
from tests.support.gateways.daemon import Plc, axis, configuration, running, world_of

# -- a gateway that exchanges -------------------------------------------------------------------------------------


DAY_S = 86_400
HALF_SPEED = 0x2000


class Turning:
    """An axis at half speed."""

    def __init__(self, daemon: Daemon) -> None:
        self.daemon = daemon
        self.axis = daemon.axes[0]
        self.loop = world_of(daemon).loop
        self.plc = Plc(daemon, [1])
        self.plc.enable()
        self.plc.endpoint.set(0, {"NSOLL_A": HALF_SPEED})
        self.plc.until(lambda: self.plc.value("NIST_A") == HALF_SPEED, "half speed")

    def undisturbed(self) -> None:
        """Continue: speed and state stay in every cycle, without fault or loss."""
        for _ in range(500):
            self.plc.exchange()
            assert (self.plc.value("NIST_A"), self.plc.state()) == (HALF_SPEED, 0x07), snapshot(self.daemon)
        assert (self.axis.reason, self.axis.fault_log.count) == (None, 0)


@contextmanager
def turning(config: GatewayConfig | None = None, directory: Path | None = None) -> Iterator[Turning]:
    def record(daemon: Daemon) -> None:
        if directory is not None:
            daemon.services.append(FlightRecorder(daemon, directory, "test"))

    with running(configuration(axis(1)) if config is None else config, record) as daemon:
        yield Turning(daemon)


@pytest.mark.parametrize("step_s", [DAY_S, -DAY_S])
def test_a_step_of_the_wall_clock_leaves_the_axis_in_operation(tmp_path: Path, step_s: int) -> None:
    with turning(directory=tmp_path) as machine:
        before = snapshot(machine.daemon)
        machine.loop._epoch += step_s
        machine.undisturbed()
        after = snapshot(machine.daemon)
        assert after["time"][:10] != before["time"][:10]
        assert after["uptime_s"] - before["uptime_s"] == pytest.approx(500 * machine.daemon.cycle_ns / SECOND, abs=0.1)
        ring = RingReader(tmp_path / "test.ring")
        newest = ring.cycles(at_most=1)[0].wall_ns / SECOND
        assert newest == pytest.approx(machine.loop.wall(), abs=0.1), "records have the time as it is set now"


def test_after_a_suspend_the_axis_is_stopped_and_needs_an_off_before_the_next_on() -> None:
    with turning() as machine:
        machine.loop._now += 3600 * SECOND  # nothing runs meanwhile: neither gateway nor drive nor PLC
        machine.plc.until(lambda: machine.plc.state() != 0x07, "the stop")
        assert machine.axis.reason is not None
        assert {record.number for record in machine.axis.fault_log.history} & {
            FaultNumber.PLC_LOST,
            FaultNumber.NODE_LOST,
        }, "the reason is reported"
        for _ in range(1000):  # ON stays set
            machine.plc.exchange()
            assert machine.plc.state() != 0x07
        machine.plc.until(lambda: abs(machine.plc.value("NIST_A")) < 10, "standstill")


def test_the_loop_counts_the_time_of_a_suspend() -> None:
    """CLOCK_MONOTONIC stops while the machine is suspended: the last frame of the PLC would look new afterwards."""
    assert isinstance(MACHINE_CLOCK, partial)
    assert (MACHINE_CLOCK.func, MACHINE_CLOCK.args) == (time.clock_gettime_ns, (time.CLOCK_BOOTTIME,))
    loop = SystemLoop()
    try:
        before = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        assert before <= loop.now() <= time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    finally:
        loop.close()


@contextmanager
def no_descriptors() -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    probe = os.open("/dev/null", os.O_RDONLY)
    os.close(probe)
    resource.setrlimit(resource.RLIMIT_NOFILE, (probe, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_without_file_descriptors_the_axis_stays_in_operation(tmp_path: Path) -> None:
    trace = "[trace]\nenabled = false\nseconds = 1\n"
    config = configuration(axis(1) + trace).model_copy(update={"store": tmp_path / "store.json"})
    with turning(config, tmp_path) as machine:
        with no_descriptors():
            with pytest.raises(
                GatewayError, match=r"cannot be written .Too many open files.; the old values remain valid"
            ):
                machine.daemon.store.save()
            machine.undisturbed()
        ring = RingReader(tmp_path / "test.ring")
        assert ring.newest_cycle == machine.daemon.cycles, "a segment is closed before the next one is opened"
        machine.daemon.store.save()


def test_a_read_only_store_refuses_a_change_and_leaves_the_axis_in_operation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = configuration(axis(1)).model_copy(update={"store": tmp_path / "store.json"})
    with turning(config) as machine:

        def refuse(*_: object, **__: object) -> None:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))

        monkeypatch.setattr(Path, "open", refuse)
        with pytest.raises(
            GatewayError, match=r"cannot be written .Read-only file system.; the old values remain valid"
        ):
            machine.daemon.store.save()
        machine.undisturbed()


# -- the parameter store: the old or the new set, whatever happens ------------------------------------------------


WRITER = """
import sys
from pathlib import Path
from pdgw.gateway.base.store import ParameterStore
store = ParameterStore(Path(sys.argv[1]), print)
number = 0
while True:
    number += 1
    text = f"{number:032d}"
    def change(parameters):
        parameters.im1_function = text
        parameters.im3_descriptor = text
        parameters.drive_object(1).telegram = 1 + number % 9
    store.update(change)
    print(number, flush=True)
"""


def nothing_to_report(message: str) -> None:
    raise AssertionError(message)


def test_what_is_saved_is_loaded_again(tmp_path: Path) -> None:
    path = tmp_path / "parameters.json"
    store = ParameterStore(path, nothing_to_report)
    store.parameters.drive_object(2).telegram = 9
    store.parameters.drive_object(2).name = "slide"
    store.parameters.im1_location = "hall 3"
    store.save()
    again = ParameterStore(path, nothing_to_report).parameters
    assert again == store.parameters
    assert again.drive_object(2).telegram == 9


def test_stored_values_of_a_positioner_are_ignored_with_a_line(tmp_path: Path) -> None:
    path = tmp_path / "parameters.json"
    item = {"telegram": 111, "positioner": {"2571": 12000}, "positioner_blocks": {"9": [9, 5000]}}
    nothing = {"telegram": 9, "positioner": {}, "positioner_blocks": {}}
    parameters = json.dumps({"version": 1, "objects": {"1": item, "2": nothing}})
    path.write_text(json.dumps({"checksum": f"{zlib.crc32(parameters.encode()):08x}", "parameters": parameters}))
    reports: list[str] = []
    store = ParameterStore(path, reports.append)
    assert [store.parameters.drive_object(do_id).telegram for do_id in (1, 2)] == [111, 9]
    (report,) = reports
    assert "DO 1: stored positioner values (P2571 to P2623) are ignored" in report
    assert "{'2571': 12000}, blocks {'9': [9, 5000]}" in report
    store.save()
    ParameterStore(path, nothing_to_report)


def test_a_missing_file_means_the_configuration_holds(tmp_path: Path) -> None:
    store = ParameterStore(tmp_path / "none.json", nothing_to_report)
    assert store.parameters == DeviceParameters()


@pytest.mark.parametrize("kills", [int(os.environ.get("PDGW_STORE_KILLS", "4"))])
@pytest.mark.e2e
def test_kill_9_at_any_moment_leaves_the_old_or_the_new_set(tmp_path: Path, kills: int) -> None:
    path = tmp_path / "parameters.json"
    for round_number in range(kills):
        with subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            acknowledged = 0
            for _ in range(3 + 7 * (round_number % 8)):
                acknowledged = int(process.stdout.readline())
            process.send_signal(signal.SIGKILL)
            remaining = process.stdout.read().split()
            acknowledged = int(remaining[-1]) if remaining else acknowledged
        stored = ParameterStore(path, nothing_to_report).parameters
        assert stored.im1_function == stored.im3_descriptor, "a mix of two sets"
        assert int(stored.im1_function) in {acknowledged, acknowledged + 1}


@given(position=st.integers(0, 10_000), flip=st.integers(1, 255))
def test_any_damaged_byte_is_noticed(tmp_path_factory: pytest.TempPathFactory, position: int, flip: int) -> None:
    path = tmp_path_factory.mktemp("store") / "parameters.json"
    store = ParameterStore(path, nothing_to_report)
    store.parameters.drive_object(1).telegram = 100
    store.save()
    data = bytearray(path.read_bytes())
    data[position % len(data)] ^= flip
    path.write_bytes(data)
    reports: list[str] = []
    loaded = ParameterStore(path, reports.append).parameters
    if reports:
        assert loaded == DeviceParameters()
        assert "kept as parameters.json.damaged-1" in reports[0]
        assert (path.parent / "parameters.json.damaged-1").read_bytes() == bytes(data)
    else:
        assert loaded == store.parameters, "damage that changes nothing may pass unnoticed, nothing else"


@given(text=st.binary(max_size=200))
def test_arbitrary_files_never_raise(tmp_path_factory: pytest.TempPathFactory, text: bytes) -> None:
    path = tmp_path_factory.mktemp("store") / "parameters.json"
    path.write_bytes(text)
    reports: list[str] = []
    assert ParameterStore(path, reports.append).parameters == DeviceParameters()
    assert len(reports) == 1


@pytest.mark.parametrize("place", ["fifo", "directory", "device"])
def test_a_store_that_is_not_a_file_is_rejected_at_once(tmp_path: Path, place: str) -> None:
    path = Path("/dev/zero") if place == "device" else tmp_path / "store.json"
    if place == "fifo":
        os.mkfifo(path)
    elif place == "directory":
        path.mkdir()
    with pytest.raises(GatewayError, match=r"cannot be read: a (pipe or a device|directory), expected a file"):
        ParameterStore(path, print)


def test_a_store_of_brackets_is_set_aside(tmp_path: Path) -> None:
    path = tmp_path / "store.json"
    path.write_text("[" * 100_000)
    reports: list[str] = []
    assert ParameterStore(path, reports.append).parameters == DeviceParameters()
    assert "not a parameter file; kept as store.json.damaged-1" in reports[0]


def test_values_are_checked_when_they_are_set() -> None:
    with pytest.raises(ValidationError, match="telegram"):
        DeviceParameters().drive_object(1).telegram = 0


def test_a_directory_that_is_not_there_is_reported(tmp_path: Path) -> None:
    store = ParameterStore(tmp_path / "missing" / "parameters.json", nothing_to_report)
    with pytest.raises(GatewayError, match="cannot be written"):
        store.save()


class FullDisk:
    """A file system that takes the first bytes of a file and then refuses, as a full one does; or refuses at once."""

    def __init__(self, error: int, at: str) -> None:
        self._error = error
        self._at = at

    def install(self, patch: pytest.MonkeyPatch) -> None:
        def refuse(*_: object, **__: object) -> None:
            raise OSError(self._error, os.strerror(self._error))

        if self._at == "open":
            patch.setattr(Path, "open", refuse)
        else:
            patch.setattr(os, self._at, refuse)


@pytest.mark.parametrize(
    "disk", [FullDisk(errno.ENOSPC, "fsync"), FullDisk(errno.EROFS, "open"), FullDisk(errno.EIO, "fsync")]
)
def test_what_cannot_be_saved_is_not_put_in_force_and_the_file_keeps_the_old_set(
    tmp_path: Path, disk: FullDisk
) -> None:
    path = tmp_path / "parameters.json"
    store = ParameterStore(path, nothing_to_report)
    store.update(lambda parameters: setattr(parameters.drive_object(1), "telegram", 9))
    before = path.read_bytes()
    with pytest.MonkeyPatch.context() as patch:
        disk.install(patch)
        with pytest.raises(GatewayError, match=r"cannot be written .*; the old values remain valid"):
            store.update(lambda parameters: setattr(parameters.drive_object(1), "telegram", 2))
    assert store.parameters.drive_object(1).telegram == 9
    assert path.read_bytes() == before
    store.update(lambda parameters: setattr(parameters.drive_object(1), "telegram", 2))
    assert ParameterStore(path, nothing_to_report).parameters.drive_object(1).telegram == 2


def test_a_change_that_is_not_allowed_changes_nothing(tmp_path: Path) -> None:
    store = ParameterStore(tmp_path / "parameters.json", nothing_to_report)

    def change(parameters: DeviceParameters) -> None:
        parameters.im1_location = "hall 3"
        parameters.drive_object(1).telegram = 0

    with pytest.raises(ValidationError):
        store.update(change)
    assert store.parameters == DeviceParameters()


def test_a_damaged_file_on_a_read_only_disk_is_reported_and_the_gateway_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "parameters.json"
    path.write_text("no store")

    def refuse(*_: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "replace", refuse)
    reports: list[str] = []
    assert ParameterStore(path, reports.append).parameters == DeviceParameters()
    assert "cannot be renamed" in reports[0]


def test_a_configuration_that_names_no_store_has_one_by_its_name_in_the_state_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tmp_path / "press.toml"
    config.write_text('[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n')
    for variable, value, expected in (
        ("STATE_DIRECTORY", str(tmp_path / "service"), tmp_path / "service"),
        ("XDG_STATE_HOME", str(tmp_path / "xdg"), tmp_path / "xdg" / "pdgw"),
        ("HOME", str(tmp_path / "home"), tmp_path / "home" / ".local" / "state" / "pdgw"),
    ):
        with monkeypatch.context() as patch:
            for name in ("STATE_DIRECTORY", "XDG_STATE_HOME"):
                patch.delenv(name, raising=False)
            patch.setenv(variable, value)
            path = load_config(config).store
            assert path is not None
            assert path.parent == expected
            assert re.fullmatch(r"press-[0-9a-f]{8}\.json", path.name)
            store = ParameterStore(path, nothing_to_report)
            store.update(lambda parameters: setattr(parameters.drive_object(1), "telegram", 9))
            assert ParameterStore(path, nothing_to_report).parameters.drive_object(1).telegram == 9
