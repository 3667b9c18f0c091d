"""How commands end: after wrong use with one line and status 1, by signals, and without streams that the caller has closed."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import re
import signal
import socket
import sys
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from pdgw.ds301.counters import Counters
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.ports import bound, refusal
from pdgw.gateway.configuration.file import config_text, simulated
from pdgw.tools.cli import main
from pdgw.tools.commands.commissioning.config import check
from pdgw.tools.options import end_as_by_ctrl_c
from pdgw.tools.service import run_log
from pdgw.tools.service.log_format import LogFormat, LogLevel
from tests.support.cli import pdgw
from tests.support.processes import free_tcp_port, free_udp_port


class NoLog:
    """The log stays that of the tests."""

    reopens = False

    def count_in(self, counters: Counters) -> None:
        """Nothing is lost."""

    def stop(self) -> None:
        """There is none."""


@pytest.fixture
def unlogged(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = run_log.RunLog

    def set_up(level: LogLevel, file: Path | None, log_format: LogFormat) -> object:
        return whole(level, file, log_format) if file is not None else NoLog()

    monkeypatch.setattr(run_log, "RunLog", set_up)


@pytest.mark.usefixtures("unlogged")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[can]\ninterface = "socketcan"\nchannel = "nocan9"\n', "CAN interface: 'socketcan channel nocan9'"),
        ('[can]\ninterface = "bogus"\n', "CAN interface: 'bogus channel None'"),
    ],
)
def test_an_unreachable_can_interface_ends_with_one_line_and_status_1(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "g.toml"
    ports = f"[transport]\ncyclic_port = {free_udp_port()}\nstatus_port = 0\nacyclic_port = 0\n"
    path.write_text(text + ports + "[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n")
    result = pdgw("run", str(path))
    assert result.returncode == 1
    assert message in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.usefixtures("unlogged")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run",), "either a configuration file or --simulate"),
        (("run", "none.toml"), "none.toml: cannot be read"),
        (("run", "--simulate", "--telegram", "113"), "telegram = 113 is not supported"),
        (
            ("run", "--simulate", "--axes", "3", "--telegram", "1", "--telegram", "9"),
            "--axes 3: --telegram is given 2 times",
        ),
        (("run", "gateway.toml", "--telegram", "9"), "--telegram: only with --simulate"),
        (("run", "gateway.toml", "--encoders", "1"), "--encoders: only with --simulate"),
        (("run", "--simulate", "--listen", "here"), "--listen here"),
        (("run", "--simulate", "--listen", "0.0.0.0"), "peer is missing: other computers can reach listen = 0.0.0.0"),
        (("run", "--simulate", "--listen", "0.0.0.0", "--peer", "here"), "--peer here"),
        (("run", "--simulate", "--status-port", "70000"), "--status-port 70000"),
        (("run", "--simulate", "--cycle-time-ms", "0"), "--cycle-time-ms 0"),
        (("run", "--simulate", "--log-file", "/nowhere/log"), "--log-file /nowhere/log: cannot be written"),
        (("status", "--port", "1"), "no gateway answers"),
        (("sim", "plc"), "give either a scenario file or --interactive"),
        (("sim", "plc", "turn.yaml", "--interactive"), "give either a scenario file or --interactive"),
        (("sim", "plc", "turn.yaml", "--telegram", "9"), "--telegram: only with --interactive"),
        (("sim", "plc", "--interactive", "--html", "turn.html"), "--html: only with a scenario"),
        (
            ("sim", "plc", "--interactive", "--profinet", "nowhere0", "--name", "Press_1"),
            "--name Press_1: allowed: labels of 1..63 of a-z",
        ),
        (
            ("sim", "plc", "--interactive", "--profinet", "nowhere0", "--device-ip", "1.2.3.4.5"),
            "--device-ip 1.2.3.4.5: expected an address with its prefix",
        ),
        (("sim", "plc", "--interactive", "--profinet", "nowhere0"), "interface nowhere0: does not exist"),
        (("sim", "drive", "--interface", "bogus"), "CAN interface"),
        (("decode", "047F2000"), "047F2000: not a file; hexadecimal data: pdgw decode --hex '047F2000'"),
        (("decode", "04", "7F", "20", "00"), "04: not a file; hexadecimal data: pdgw decode --hex '04 7F 20 00'"),
        (("timeline", "/"), "/: a folder; name the files in it, for example /gateway.pcapng"),
        (("replay", "/"), "/: a folder; name the files in it, for example /gateway.pcapng"),
        (("sim", "inject", "--port", "1", "fault", "7"), "no simulator answers"),
    ],
)
def test_wrong_use_ends_with_one_line_and_status_1(arguments: tuple[str, ...], message: str) -> None:
    result = pdgw(*arguments)
    assert result.returncode == 1
    assert message in result.stderr.replace("\n", " ")
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("check", "gateway.toml"), "No such command 'check'. Did you mean 'pdgw config check'?"),
        (("config", "scan"), "No such command 'scan'. Did you mean 'pdgw bus scan'?"),
        (("staus",), "Did you mean 'status'?"),
        (("run", "--simulate", "--telegram", "1,3"), "'1,3': expected an integer; repeat the option for several"),
        (("run", "--simulate", "--axes", "33"), "'33': allowed: at most 32"),
        (("status", "x"), "'x': expected an integer"),
        (("run", "x.toml", "--log-level", "foo"), "'foo' is not one of 'debug', 'info', 'warning', 'error'"),
    ],
)
def test_wrong_command_or_option_is_named_with_what_is_allowed(
    arguments: tuple[str, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "150")
    result = pdgw(*arguments)
    assert result.returncode == 2
    assert message in result.stderr
    assert "Input should" not in result.stderr


@pytest.mark.usefixtures("unlogged")
def test_a_port_in_use_is_named(tmp_path: Path) -> None:
    path = tmp_path / "g.toml"
    path.write_text('[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n')
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        result = pdgw("run", str(path), "--cyclic-port", str(port), "--status-port", "0")
    assert result.returncode == 1
    assert f"127.0.0.1 port {port} cannot be used" in result.stderr
    if sys.platform == "linux":
        assert f"(Address already in use by process {os.getpid()}, " in result.stderr


def test_check_with_run_names_a_port_in_use_and_leaves_a_free_one(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    trace = tmp_path / "trace"
    with bound("other", "127.0.0.1", 0, "-") as taken:
        port = taken.getsockname()[1]
        keys = {"cyclic_port": port, "acyclic_port": 0, "status_port": free_tcp_port()}
        transport = "".join(f"{key} = {value}\n" for key, value in keys.items())
        device = '[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n'
        file.write_text(f'[transport]\n{transport}[trace]\ndirectory = "{trace}"\n{device}')
        assert pdgw("config", "check", str(file)).returncode == 0
        result = pdgw("config", "check", "--run", str(file))
        assert result.returncode == 1
        assert f"127.0.0.1 port {port} cannot be used (Address already in use by process {os.getpid()}" in result.stderr
    for _ in range(2):
        result = pdgw("config", "check", "--run", str(file))
        assert result.returncode == 0, result.stderr
        assert "this machine: ports and CAN interfaces can be opened, " in result.stdout
    assert not trace.exists()


@pytest.mark.skipif(sys.platform != "linux", reason="the process of a port is read from /proc")
@pytest.mark.parametrize("backlog", [0, 1])
def test_process_that_has_a_port_is_named(backlog: int) -> None:
    with bound("one", "127.0.0.1", 0, "-", backlog) as taken:
        port = taken.getsockname()[1]
        text = f"two: 127.0.0.1 port {port} cannot be used (Address already in use by process {os.getpid()}, "
        with pytest.raises(GatewayError, match=re.escape(text)) as refused:
            bound("two", "127.0.0.1", port, "choose another", backlog)
    assert str(refused.value).endswith("); choose another")


def test_refused_port_that_no_process_has_shows_the_error_of_the_system() -> None:
    assert refusal(OSError(errno.EACCES, "Permission denied"), 1) == "Permission denied"
    assert refusal(OSError(errno.EADDRINUSE, "Address already in use"), 0) == "Address already in use"


@pytest.mark.parametrize(
    ("key", "text"),
    [
        (
            'simulate = ["brake-open"]',
            "[[axis]] do_id = 1: fault: 'brake-open' is not allowed, expected one of brake-opens, brake-closes,",
        ),
        ('simulate = ["slow-sdo delay=3"]', "fault slow-sdo parameter: 'delay' is not allowed, expected delay_ms"),
        ('simulate = ["slow-sdo delay_ms=-3"]', "fault slow-sdo delay_ms: -3 is not allowed"),
    ],
)
def test_config_check_names_a_habit_that_does_not_exist(key: str, text: str, tmp_path: Path) -> None:
    file = tmp_path / "g.toml"
    file.write_text(
        f'[can]\ninterface = "virtual"\nchannel = "x"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n{key}\n'
    )
    with pytest.raises(GatewayError) as error:
        check(file)
    assert text in str(error.value)


def test_config_example_and_check(tmp_path: Path) -> None:
    path = tmp_path / "gateway.toml"
    path.write_text(pdgw("config", "example").stdout)
    good = pdgw("config", "check", str(path))
    assert good.returncode == 0
    assert "ok, 1 axis" in good.stdout
    path.write_text(path.read_text().replace("telegram = 1", "telegram = 113"))
    bad = pdgw("config", "check", str(path))
    assert bad.returncode == 1
    assert f"{path}:" in bad.stderr
    assert "[[axis]] number 1: telegram = 113 is not supported" in bad.stderr, "brackets are no markup"


def test_devices_without_a_bus_are_refused_unless_one_is_opened_for_them(tmp_path: Path) -> None:
    path = tmp_path / "bus.toml"
    path.write_text("[[device]]\nnode_id = 1\n")
    result = pdgw("sim", "bus", str(path))
    assert result.returncode == 1
    assert f"{path}: [can] is missing: it names the bus of the devices; --serve opens one for them" in result.stderr


@pytest.mark.parametrize(
    ("encoding", "arguments"),
    [
        *(("ascii", words) for words in (("--help",), ("map", "x.toml"), ("drives",), ("config", "example"))),
        *((page, ("drives", "epos4")) for page in ("cp1252", "cp1251", "cp437", "latin-1", "ascii")),
    ],
)
def test_unknown_characters_of_a_code_page_end_no_command(
    arguments: tuple[str, ...], encoding: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("x.toml").write_text(config_text(simulated([1])))
    monkeypatch.setattr("sys.argv", ["pdgw", *arguments])
    printed = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    with redirect_stdout(printed), contextlib.suppress(SystemExit):
        main()
    printed.flush()
    assert len(printed.buffer.getvalue()) > 100  # type: ignore[attr-defined]


class TerminalOutput(io.TextIOWrapper):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("command", ["decode", "drives"])
def test_control_characters_of_a_file_do_not_reach_the_terminal(
    command: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    title = "\x1b]0;title\x07"
    files = {
        "decode": f"(1.5) can{title} 701#00\n",
        "drives": f"[DeviceInfo]\n[1000]\nParameterName=x\x1b[31m\nDataType=7\nAccessType={title}\n",
    }
    path = tmp_path / "file"
    path.write_text(files[command])
    monkeypatch.setattr("sys.argv", ["pdgw", command, str(path)])
    monkeypatch.setenv("COLUMNS", "150")
    printed = TerminalOutput(io.BytesIO(), encoding="utf-8")
    with redirect_stdout(printed):
        with contextlib.suppress(SystemExit):
            main()
        sys.stdout.flush()
        found = printed.buffer.getvalue().decode()  # type: ignore[attr-defined]
    assert found
    assert "\x07" not in found
    assert "\x1b]" not in found
    assert "\x1b[31m" not in found
    assert command == "decode" or r"\x1b]0;title\x07" in found


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("arguments", [("--help",), ("config", "example"), ("drives",)])
def test_output_that_cannot_be_written_is_one_line(
    arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["pdgw", *arguments])
    with Path("/dev/full").open("w") as full, redirect_stdout(full), pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 1
    assert capsys.readouterr().err == "error: output: No space left on device\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_unfinished_capture_is_reported_after_the_results(tmp_path: Path) -> None:
    scenario = tmp_path / "short.yaml"
    scenario.write_text("name: short\ntelegrams: [1]\nsteps:\n  - {expect: {ZSW1.FAULT: 0}, within: 10 ms}\n")
    results = tmp_path / "results.json"
    result = pdgw("sim", "plc", str(scenario), "--pcap", "/dev/full", "--json", str(results))
    assert result.returncode == 1
    assert "ZSW1.FAULT 0" in result.stdout
    assert "FAIL" in result.stdout
    assert results.exists()
    assert result.stderr == "error: --pcap /dev/full: cannot be written (No space left on device)\n"


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
