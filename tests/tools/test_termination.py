"""Ends from outside: signals, and streams that the caller has closed."""

from __future__ import annotations

import signal
import sys

import pytest

from pdgw.tools.cli import main
from pdgw.tools.options import end_as_by_ctrl_c


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="signals of POSIX")
@pytest.mark.parametrize(
    ("before", "after"), [(signal.SIG_DFL, signal.default_int_handler), (signal.SIG_IGN, signal.SIG_IGN)]
)
def test_sighup_acts_like_ctrl_c_unless_ignored(before: signal.Handlers, after: object) -> None:
    numbers = (signal.SIGTERM, signal.SIGHUP)
    handlers = [signal.getsignal(number) for number in numbers]
    try:
        for number in numbers:
            signal.signal(number, before)
        end_as_by_ctrl_c()
        assert [signal.getsignal(number) for number in numbers] == [after, after]
    finally:
        for number, handler in zip(numbers, handlers, strict=True):
            signal.signal(number, handler)


@pytest.mark.parametrize("name", ["stdin", "stdout", "stderr"])
def test_command_works_with_closed_standard_streams(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, name, None)
    monkeypatch.setattr(sys, "argv", ["pdgw", "decode", "--hex", "047F2000", "--telegram", "1"])
    with pytest.raises(SystemExit) as end:
        main()
    assert not end.value.code
    getattr(sys, name).close()
