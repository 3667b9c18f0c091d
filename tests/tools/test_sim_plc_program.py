"""``pdgw sim plc --st``: a program between the frames, its outputs as lines, and wrong use."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from pdgw.gateway.configuration.file import load_config
from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.structured_text.controller import Controller
from pdgw.peers.plc.structured_text.endpoint import ProgramEndpoint
from pdgw.tools.commands.simulation.plc import plc
from pdgw.tools.plc.code import structured_text

PROGRAM = """PROGRAM Main
VAR_INPUT received : ARRAY[0..1] OF BYTE; END_VAR
VAR_OUTPUT sent : ARRAY[0..1] OF BYTE; calls : INT; finished : BOOL; END_VAR
    sent[0] := received[0];
    calls := calls + 1;
    finished := calls = 3;
END_PROGRAM
"""
EXAMPLES = Path(__file__).parents[2] / "examples"


def test_the_program_makes_each_frame_from_the_newest_one() -> None:
    endpoint = ProgramEndpoint(Controller(PROGRAM))
    assert endpoint.build(0) == b"\0\0"
    endpoint.receive(b"\1\0")
    endpoint.receive(b"\2\0")
    assert endpoint.build(1) == b"\2\0"
    assert not endpoint.poll(2)
    assert endpoint.counters == {"sent": 2, "received": 2}


def test_outputs_are_shown_until_the_program_is_finished(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "main.st"
    path.write_text(PROGRAM)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as nobody:
        nobody.bind(("127.0.0.1", 0))
        with pytest.raises(GatewayError, match="no frame from a gateway"):
            plc(st=[path], gateway=f"127.0.0.1:{nobody.getsockname()[1]}")
        assert nobody.recv(10) == b"\0\0"
    shown = [line.split(" s  ")[1] for line in capsys.readouterr().out.splitlines()]
    assert shown == ["calls = 1", "finished = False", "calls = 2", "calls = 3", "finished = True"]


def test_an_error_names_its_file_and_line(tmp_path: Path) -> None:
    blocks, main = tmp_path / "blocks.st", tmp_path / "main.st"
    blocks.write_text("TYPE Pair : STRUCT a : INT; END_STRUCT; END_TYPE\n")
    main.write_text(PROGRAM.replace("calls + 1", "calls + 1.0"))
    with pytest.raises(GatewayError, match=r"^main.st line 5: real literal 1.0 where INT is expected"):
        plc(st=[blocks, main])


@pytest.mark.parametrize(
    "more", [{"interactive": True}, {"scenario": Path("x")}, {"telegram": [1]}, {"profinet": "eth0"}]
)
def test_program_rejects_other_kinds_of_control(more: dict[str, object]) -> None:
    with pytest.raises(GatewayError, match=r"give either|only with"):
        plc(st=[Path("main.st")], **more)  # type: ignore[arg-type]


def test_the_example_fits_its_configuration() -> None:
    config = load_config(EXAMPLES / "axis_sequence.toml")
    Controller(structured_text(config), (EXAMPLES / "axis_sequence.st").read_text())
