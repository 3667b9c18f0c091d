"""An axis with every PLCopen block (MC_...), run against a gateway in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from pdgw.dsp402.states import State
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.profidrive.telegrams import TELEGRAMS
from pdgw.tools.plc.code import STATES, has_axis
from tests.support.gateways.daemon import drive_of, running
from tests.support.plc.structured_text import TextPlc, config_of, program

VELOCITIES = [number for number, item in TELEGRAMS.items() if has_axis(item) and number not in {7, 9, 110}]
POSITIONS = [9, 110, 111, 112]
BLOCKS = {
    "power": "MC_Power",
    "reset": "MC_Reset",
    "home": "MC_Home",
    "absolute": "MC_MoveAbsolute",
    "other": "MC_MoveAbsolute",
    "relative": "MC_MoveRelative",
    "turn": "MC_MoveVelocity",
    "halting": "MC_Halt",
    "stopping": "MC_Stop",
    "stopping_too": "MC_Stop",
    "status": "MC_ReadStatus",
    "position": "MC_ReadActualPosition",
}
TURN = {9: 8_796_093.0, 112: 10.0}
"""One revolution of the motor in the units of the telegram, where it is not 10000 LU."""


class Axis(TextPlc):
    """Every block MC_... of one axis; positions in revolutions, velocities in rpm."""

    def __init__(self, daemon: Daemon, number: int) -> None:
        factors = ""
        if "XIST_A" in TELEGRAMS[number].actuals.names or number == 112:
            factors = f", PositionFactor := {TURN.get(number, 10_000.0)}, VelocityFactor := {357_914.0 if number == 9 else 10.0}"
        elif number != 7:
            factors = ", ReferenceSpeed := 3000.0"
        if number == 9:
            factors += ", HomingMethod := 35"
        calls = "\n".join(f"    {name}(Axis := axis);" for name in BLOCKS)
        calls += f"\n    drive(Axis := axis, Actual := io.axis_1_actual, Good := io.axis_1_good{factors});"
        variables = "\n".join(f"    {name} : {kind};" for name, kind in {**BLOCKS, "axis": "PDGW_AXIS"}.items())
        text = program(daemon.config, calls, variables, f"PDGW_Axis_T{number}")
        super().__init__(daemon, text)
        self.drive = drive_of(daemon)
        self.at("status")["ENABLE"] = self.at("position")["ENABLE"] = True

    def at(self, name: str) -> dict[str, Any]:
        found: dict[str, Any] = self.controller.variables[name.upper()]
        return found

    @property
    def state(self) -> str:
        """The one state that MC_ReadStatus shows."""
        (shown,) = [name for name in STATES if self.at("status")[name.upper()]]
        return shown

    @property
    def turns(self) -> float:
        return self.drive.node.model.position_actual / 4096

    @property
    def rpm(self) -> float:
        return self.drive.node.model.velocity_actual * self.drive.node.model.unit

    def start(self, name: str, **inputs: float) -> None:
        """A rising edge of Execute."""
        block = self.at(name)
        block["EXECUTE"] = False
        self.exchange(2)
        for key, value in inputs.items():
            assert key.upper() in block
            block[key.upper()] = value
        block["EXECUTE"] = True
        self.exchange()

    def ends(self, name: str, output: str = "DONE") -> None:
        """The outputs of a block that is over: one is TRUE."""
        self.until(lambda _: not self.at(name)["BUSY"] or self.at(name)[output], f"{name} {output}: {self.at(name)}")
        shown = [key for key in ("DONE", "INVELOCITY", "COMMANDABORTED", "ERROR") if self.at(name).get(key)]
        assert shown == [output], (name, self.at(name), self.at("axis"))

    def on(self) -> None:
        self.at("power")["ENABLE"] = False
        self.until(lambda _: self.drive.node.model.state is State.READY_TO_SWITCH_ON, "ready")
        self.exchange(5)
        self.at("power")["ENABLE"] = True
        self.until(lambda _: self.at("power")["STATUS"], "power")
        self.exchange(2)
        assert self.state == "Standstill"


@contextmanager
def axis_with(number: int) -> Iterator[Axis]:
    with running(config_of(number)) as daemon:
        yield Axis(daemon, number)
