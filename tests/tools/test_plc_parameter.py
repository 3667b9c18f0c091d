"""The blocks of the parameter channel: each byte, then a program that reads and writes parameters of a gateway."""

from __future__ import annotations

from typing import Any

import pytest

from pdgw.gateway.client.udp import ParameterClient
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.drive.objects import DRIVE_FAULTS
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber
from pdgw.tools.plc.library import template
from tests.support.gateways.daemon import client, drive_of, record_server, running
from tests.support.plc.structured_text import TextPlc, config_of, program
from tests.support.structured_text.compiler import Compiler

BLOCKS = Compiler(lambda: 0, template("parameter")).units


def called(name: str, **inputs: object) -> dict[str, Any]:
    block = BLOCKS[name.upper()]
    values = block.initial | {key.upper(): value for key, value in inputs.items()}
    block.body(values)
    return values


def octets(text: str) -> list[int]:
    """Sixteen bytes that begin with these."""
    return [*bytes.fromhex(text), *bytes(16)][:16]


@pytest.mark.parametrize(
    ("inputs", "expected"),
    [
        ({"Number": 965}, "01 01 00 01 10 00 03C5 0000"),
        ({"Number": 0x1018, "SubIndex": 3, "IsArray": True, "DoId": 1}, "01 01 01 01 10 01 1018 0003"),
        (
            {"Number": 922, "DoId": 1, "Write": True, "Format": 0x42, "Size": 2, "Value": 9},
            "01 02 01 01 10 00 039A 0000 42 01 0009",
        ),
        (
            {"Number": 65000, "DoId": 3, "Write": True, "Format": 0x43, "Size": 4, "Value": 0x01020304},
            "01 02 03 01 10 00 FDE8 0000 43 01 01020304",
        ),
        (
            {"Number": 1, "Write": True, "Format": 0x41, "Size": 1, "Value": 0x7F},
            "01 02 00 01 10 00 0001 0000 41 01 7F00",
        ),
    ],
)
def test_requests_are_those_of_the_parameter_channel(inputs: dict[str, object], expected: str) -> None:
    made = called("PDGW_ParameterRequest", **inputs)
    assert bytes(made["BYTES"][: made["LENGTH"]]) == bytes.fromhex(expected)
    assert not any(made["BYTES"][made["LENGTH"] :])


@pytest.mark.parametrize(
    ("answer", "valid", "error", "number", "value"),
    [
        ("02 01 00 01 06 01 0329", True, False, 0, 0x0329),
        ("02 01 01 01 43 01 01020304", True, False, 0, 0x01020304),
        ("02 01 01 01 41 01 7F00", True, False, 0, 0x7F),
        ("02 02 01 01", True, False, 0, 0),
        ("02 81 01 01 44 01 0000", True, True, 0, 0),
        ("02 81 01 01 44 01 0011", True, True, 0x11, 0x11),
        ("03 01 00 01 06 01 0329", False, False, 0, None),
        ("02 01 01 01 43 01 0102", False, False, 0, 0),
    ],
)
def test_responses_are_read(answer: str, valid: bool, error: bool, number: int, value: int | None) -> None:
    length = len(bytes.fromhex(answer))
    read = called("PDGW_ParameterResponse", Bytes=octets(answer), Length=length, RequestNumber=2)
    assert (read["VALID"], read["ERROR"], read["ERRORNUMBER"]) == (valid, error, number)
    assert value is None or read["VALUE"] == value


def test_the_number_of_a_request_changes_and_is_never_0() -> None:
    block = BLOCKS["PDGW_PARAMETERREQUEST"]
    values = block.initial
    seen = []
    for _ in range(300):
        block.body(values)
        seen.append(values["REQUESTNUMBER"])
    assert seen[:2] == [1, 2]
    assert seen[254:256] == [255, 1]


VARIABLES = """\
    request : PDGW_ParameterRequest;
    response : PDGW_ParameterResponse;
    step : INT;
    asks : BOOL; (* the instruction for records is at work *)
    record : ARRAY[0..15] OF BYTE;
    length : INT;
    answered : BOOL;
    fault : DWORD;
    deceleration : DWORD;
    refusal : UINT;
    finished : BOOL;
"""
PROGRAM = """\
    drive(Actual := io.axis_1_actual, Good := io.axis_1_good, ReferenceSpeed := 3000.0);
    IF asks AND answered THEN
        asks := FALSE;
        answered := FALSE;
        response(Bytes := record, Length := length, RequestNumber := request.RequestNumber);
        IF response.Valid THEN
            CASE step OF
                1: fault := response.Value;
                3: deceleration := response.Value;
                4: refusal := response.ErrorNumber;
            END_CASE;
            finished := step = 4;
        ELSE
            step := step - 1; (* not the answer to this request: once more *)
        END_IF;
    END_IF;
    IF (drive.Error OR step > 0) AND NOT asks AND NOT finished THEN
        step := step + 1;
        CASE step OF
            1: (* P945, the newest fault *)
                request(DoId := 16#01, Number := 945, IsArray := TRUE);
            2: (* 6085h, quick-stop deceleration *)
                request(DoId := 16#01, Number := 16#6085, IsArray := FALSE, Write := TRUE,
                        Format := 16#43, Size := 4, Value := 16#00000FA0);
            3:
                request(DoId := 16#01, Number := 16#6085, Write := FALSE);
            4: (* 6041h, the Statusword, cannot be written *)
                request(DoId := 16#01, Number := 16#6041, Write := TRUE, Format := 16#42, Size := 2, Value := 16#00000000);
        END_CASE;
        record := request.Bytes;
        length := request.Length;
        asks := TRUE;
    END_IF;
"""


class RecordPlc(TextPlc):
    """A PLC with an instruction that writes and reads a record, as WRREC and RDREC do, beside the cyclic frames."""

    def __init__(self, daemon: Daemon, text: str, records: ParameterClient) -> None:
        super().__init__(daemon, text)
        self._records = records
        self.log: list[tuple[str, str]] = []
        """Requests and their answers, in hex."""

    def run(self) -> None:
        """Until the program has finished."""
        variables = self.controller.variables
        for _ in range(1000):
            self.exchange()
            if variables["FINISHED"]:
                return
            if variables["ASKS"] and not variables["ANSWERED"]:
                request = bytes(variables["RECORD"][: variables["LENGTH"]])
                answer = self._records.exchange(request)
                self.log.append((request.hex(" "), answer.hex(" ")))
                variables["RECORD"][:] = [*answer, *bytes(16)][:16]
                variables["LENGTH"], variables["ANSWERED"] = len(answer), True
        raise AssertionError(variables["STEP"])


def test_a_program_reads_a_fault_and_writes_a_parameter() -> None:
    config = config_of(1)
    with running(config) as daemon, client(daemon, record_server(daemon).address, 1) as records:
        plc, drive = RecordPlc(daemon, program(config, PROGRAM, VARIABLES), records), drive_of(daemon)
        plc.until(lambda block: block["GOOD"], "values")
        drive.node.model.inject(5)
        plc.run()
        variables = plc.controller.variables
        assert variables["FAULT"] == DRIVE_FAULTS[5].error_code, "P945"
        assert (variables["DECELERATION"], drive.node.read(0x6085)) == (4000, 4000)
        assert variables["REFUSAL"] == ParameterErrorNumber.VALUE_CANNOT_BE_CHANGED
        assert [request[:2] for request, _ in plc.log] == ["01", "02", "03", "04"]
        assert plc.block["GOOD"], "the frames went on"
