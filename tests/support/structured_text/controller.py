"""A controller that runs one program, sans-I/O."""

from __future__ import annotations

from pdgw.tools.plc.declarations import StructuredTextError
from tests.support.structured_text.compiler import Compiler
from tests.support.structured_text.types import Array, Unit, Value, Variable

RECEIVED, SENT, FINISHED = "RECEIVED", "SENT", "FINISHED"
"""Variables of the program: newest frame from the gateway, frame to the gateway, and whether it has finished."""


class Controller:
    """Runs the only PROGRAM of a text. ``variables``: those of the program, by name in upper case."""

    def __init__(self, *texts: str) -> None:
        self.now = 0
        compiler = Compiler(lambda: self.now, *texts)
        programs = [unit for unit in compiler.units.values() if unit.kind == "PROGRAM"]
        if len(programs) != 1:
            raise StructuredTextError(f"the text has {len(programs)} PROGRAMs, expected 1")
        self.program: Unit = programs[0]
        self.variables = self.program.initial
        self._frame(RECEIVED, "VAR_INPUT")
        self._frame(SENT, "VAR_OUTPUT")

    def _frame(self, name: str, section: str) -> None:
        variable = self.program.variables.get(name, Variable(Array(0, 0, Array(0, 0, self.program))))
        if not isinstance(variable.type, Array) or variable.type.element.name != "BYTE" or variable.section != section:
            raise StructuredTextError(f"{self.program.name} needs {name} : ARRAY OF BYTE in {section}")

    @property
    def finished(self) -> bool:
        """Whether the program has set its output ``finished``."""
        return self.variables.get(FINISHED) is True

    def outputs(self) -> dict[str, Value]:
        """The outputs of the program, except the frame."""
        return {key: self.variables[key] for key in self.program.section("VAR_OUTPUT") if key != SENT}

    def cycle(self, now: int, received: bytes | None) -> bytes:
        """Run the program once, with a frame of the gateway if one has arrived. ``now`` in nanoseconds."""
        self.now = now
        frame = self.variables[RECEIVED]
        if received is not None and len(received) == len(frame):
            frame[:] = received
        self.program.body(self.variables)
        return bytes(self.variables[SENT])
