"""PDGW_Udp against a gateway behind a router, in virtual time: the frames count only with the gateway's tick."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from pdgw.base.durations import MS
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from pdgw.peers.world.udp import Conditions
from pdgw.tools.plc.code import structured_text
from pdgw.tools.plc.sockets import Sockets
from tests.support.gateways.daemon import axis, drive_of, running, world_of
from tests.support.plc.structured_text import TextPlc, program

PLC, PORT = "192.168.0.10", 34962
ROUTED = f'cycle_time_ms = 4\nlisten = "192.168.0.5"\npeer = "{PLC}"\n'
SIEMENS = """
TYPE TCON_IP_v4 : STRUCT
    InterfaceId : UINT;
    ID : WORD;
    ConnectionType : BYTE;
    LocalPort : UINT;
END_STRUCT; END_TYPE
TYPE TADDR_Param : STRUCT
    REM_IP_ADDR : ARRAY[1..4] OF USINT;
    REM_PORT_NR : UINT;
END_STRUCT; END_TYPE
FUNCTION_BLOCK TCON
VAR_INPUT REQ : BOOL; ID : WORD; END_VAR
VAR_IN_OUT CONNECT : TCON_IP_v4; END_VAR
VAR_OUTPUT DONE : BOOL; BUSY : BOOL; END_VAR
VAR before : BOOL; failures : INT; port : UINT; calls : INT; END_VAR
    (* Fails twice, then needs three calls. *)
    DONE := FALSE;
    IF REQ AND NOT before AND NOT BUSY THEN
        failures := failures + 1;
        BUSY := failures > 2;
        calls := 0;
        port := CONNECT.LocalPort;
    ELSIF BUSY THEN
        calls := calls + 1;
        DONE := calls = 3;
        BUSY := NOT DONE;
    END_IF;
    before := REQ;
END_FUNCTION_BLOCK
FUNCTION_BLOCK TURCV
VAR_INPUT EN_R : BOOL; ID : WORD; LEN : UDINT; END_VAR
VAR_IN_OUT DATA : ARRAY[0..45] OF BYTE; ADDR : TADDR_Param; END_VAR
VAR_OUTPUT NDR : BOOL; RCVD_LEN : UDINT; END_VAR
VAR waiting : ARRAY[0..45] OF BYTE; length : UDINT; place : INT; END_VAR
    IF NDR THEN
        NDR := FALSE;
    ELSIF length > 0 THEN
        FOR place := 0 TO 45 DO
            DATA[place] := waiting[place];
        END_FOR;
        NDR := TRUE;
        RCVD_LEN := length;
        length := 0;
    END_IF;
END_FUNCTION_BLOCK
FUNCTION_BLOCK TUSEND
VAR_INPUT REQ : BOOL; ID : WORD; LEN : UDINT; END_VAR
VAR_IN_OUT DATA : ARRAY[0..45] OF BYTE; ADDR : TADDR_Param; END_VAR
VAR_OUTPUT DONE : BOOL; BUSY : BOOL; END_VAR
VAR before : BOOL; jobs : INT; frame : ARRAY[0..45] OF BYTE; port : UINT; END_VAR
    (* A job needs two calls. *)
    DONE := BUSY;
    IF BUSY THEN
        frame := DATA;
        port := ADDR.REM_PORT_NR;
        jobs := jobs + 1;
    END_IF;
    BUSY := REQ AND NOT before AND NOT BUSY;
    before := REQ;
END_FUNCTION_BLOCK
"""
"""What the instructions of TIA Portal do, for the interpreter: jobs that start with an edge and need several calls."""
MAIN = """
PROGRAM Main
VAR_INPUT received : ARRAY[0..45] OF BYTE; END_VAR
VAR_OUTPUT sent : ARRAY[0..45] OF BYTE; END_VAR
VAR io : PDGW_Udp; drive : PDGW_Speed_T1; END_VAR
    drive(Actual := io.axis_1_actual, Good := io.axis_1_good);
    io(hw_interface := 64, connection_id := 16#0001, axis_1_set := drive.Setpoints);
END_PROGRAM
"""


@pytest.fixture
def config() -> GatewayConfig:
    return parse_config(
        f'[can]\ninterface = "virtual"\n[trace]\nenabled = false\n[transport]\nwatchdog_factor = 75\n{ROUTED}{axis(1)}'
    )


@pytest.fixture
def gateway(config: GatewayConfig) -> Iterator[Daemon]:
    with running(config) as daemon:
        world_of(daemon).network.conditions = Conditions(delay_ns=2 * MS, jitter_ns=MS)
        yield daemon


def turns_and_is_lost(plc: TextPlc, gateway: Daemon) -> None:
    """The axis turns, and stops when the PLC uses no newer frame of the gateway."""
    shaft = drive_of(gateway).node.model
    plc.set(ReferenceSpeed=3000.0)
    plc.enable()
    plc.set(Speed=600.0)
    plc.until(lambda block: block["INSPEED"] and block["ACTSPEED"] > 590, "600 rpm")
    assert snapshot(gateway)["plc"]["connected"]
    assert plc.controller.variables["IO"]["AXIS_1_USED"]
    plc.deaf = True
    plc.until(lambda _: shaft.velocity_actual == 0, "the tick is too old")
    assert "older than the age limit" in str(snapshot(gateway)["plc"])


def test_an_axis_turns_with_frames_that_have_the_tick(config: GatewayConfig, gateway: Daemon) -> None:
    turns_and_is_lost(TextPlc(gateway, program(config), PLC), gateway)


class S7(TextPlc):
    """Exchanges frames with the instructions of TIA Portal."""

    def exchange(self, cycles: int = 1) -> None:
        for _ in range(cycles):
            io = self.controller.variables["IO"]
            if self._newest is not None:
                io["RECEIVE"]["WAITING"][:], io["RECEIVE"]["LENGTH"] = self._newest, len(self._newest)
                self._newest = None
            jobs = io["SEND"]["JOBS"]
            self.controller.cycle(self.loop.now(), None)
            if io["OPENED"] and io["SEND"]["JOBS"] != jobs:
                self.port.send(bytes(io["SEND"]["FRAME"]), self.daemon.address)
            self.loop.run_for(self.daemon.cycle_ns)


def test_an_s7_opens_the_connection_and_turns_an_axis(config: GatewayConfig, gateway: Daemon) -> None:
    text = structured_text(config, Sockets.S7).replace("HW_ANY", "UINT").replace("CONN_OUC", "WORD")
    plc = S7(gateway, SIEMENS + text + MAIN, PLC)
    turns_and_is_lost(plc, gateway)
    io = plc.controller.variables["IO"]
    assert (io["CONNECT"]["PORT"], io["SEND"]["PORT"]) == (PORT, PORT)


def test_the_block_of_codesys_differs_in_its_sockets_alone(config: GatewayConfig) -> None:
    plain, codesys = (structured_text(config, kind).split("\n") for kind in (Sockets.NONE, Sockets.CODESYS))
    more = [line for line in codesys if line not in plain]
    assert [line for line in plain if line not in codesys] == [
        "(* The UDP frames of all axes: call it once in each cycle, after the blocks of the axes. *)",
        "    received : ARRAY[0..45] OF BYTE; (* the newest frame of the gateway *)",
        f"    sent : ARRAY[0..45] OF BYTE; (* send it to port {PORT} of the gateway *)",
    ]
    assert f"        partner.sin_port := SysSockHtons({PORT});" in more
    assert sum("sent[" in line or "received[" in line for line in more) == 0
