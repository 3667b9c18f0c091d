"""Files that a user names: regular ones of limited size."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.files import read_file


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert read_file(path, 5) == b"12345"
    with pytest.raises(OSError, match="longer than 4 bytes; check that it is the right file"):
        read_file(path, 4)


@pytest.mark.parametrize(("path", "reason"), [("/dev/zero", "a pipe or a device"), ("/", "a directory")])
def test_other_things_with_a_path_are_rejected(path: str, reason: str) -> None:
    with pytest.raises(OSError, match=f"{reason}, expected a file"):
        read_file(Path(path), 5)
