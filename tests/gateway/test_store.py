"""The non-volatile parameters survive a crash at any moment, and damage is told and set aside."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.store import DeviceParameters, ParameterStore
from pydantic import ValidationError

WRITER = """
import sys
from pathlib import Path
from pdgw.gateway.store import ParameterStore
store = ParameterStore(Path(sys.argv[1]), print)
number = 0
while True:
    number += 1
    text = f"{number:032d}"
    store.parameters.im1_function = text
    store.parameters.im3_descriptor = text
    store.parameters.drive_object(1).telegram = 1 + number % 9
    store.save()
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


def test_a_missing_file_means_the_configuration_holds(tmp_path: Path) -> None:
    store = ParameterStore(tmp_path / "none.json", nothing_to_report)
    assert store.parameters == DeviceParameters()


@pytest.mark.parametrize("kills", [8])
def test_kill_9_at_any_moment_leaves_the_old_or_the_new_set(tmp_path: Path, kills: int) -> None:
    path = tmp_path / "parameters.json"
    for round_number in range(kills):
        with subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            acknowledged = 0
            for _ in range(3 + 7 * round_number):
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


def test_values_are_checked_when_they_are_set() -> None:
    with pytest.raises(ValidationError, match="telegram"):
        DeviceParameters().drive_object(1).telegram = 0


def test_a_directory_that_is_not_there_is_reported(tmp_path: Path) -> None:
    store = ParameterStore(tmp_path / "missing" / "parameters.json", nothing_to_report)
    with pytest.raises(GatewayError, match="cannot be written"):
        store.save()
