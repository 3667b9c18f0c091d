"""The stored parameters survive a crash at any time; damage is reported and the file kept aside."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import zlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from pdgw.gateway.configuration.file import load_config
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.store import DeviceParameters, ParameterStore

WRITER = """
import sys
from pathlib import Path
from pdgw.gateway.store import ParameterStore
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


@pytest.mark.parametrize("kills", [int(os.environ.get("PDGW_STORE_KILLS", "8"))])
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
def test_a_store_that_is_no_file_is_rejected_at_once(tmp_path: Path, place: str) -> None:
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


def test_a_damaged_file_on_a_read_only_disk_is_told_and_does_not_keep_the_gateway_from_starting(
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
        ("STATE_DIRECTORY", str(tmp_path / "service"), tmp_path / "service" / "press.json"),
        ("XDG_STATE_HOME", str(tmp_path / "xdg"), tmp_path / "xdg" / "pdgw" / "press.json"),
        ("HOME", str(tmp_path / "home"), tmp_path / "home" / ".local" / "state" / "pdgw" / "press.json"),
    ):
        with monkeypatch.context() as patch:
            for name in ("STATE_DIRECTORY", "XDG_STATE_HOME"):
                patch.delenv(name, raising=False)
            patch.setenv(variable, value)
            path = load_config(config).store
            assert path == expected
            store = ParameterStore(path, nothing_to_report)
            store.update(lambda parameters: setattr(parameters.drive_object(1), "telegram", 9))
            assert ParameterStore(path, nothing_to_report).parameters.drive_object(1).telegram == 9
