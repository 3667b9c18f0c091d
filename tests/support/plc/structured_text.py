"""A PLC that runs a Structured Text program against a gateway in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from pdgw.gateway.configuration.byte_map import frame_maps
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.profidrive.telegrams import ApplicationMode, telegram
from pdgw.tools.plc.code import structured_text
from pdgw.tools.plc.library import block_name
from tests.support.gateways.daemon import PATIENCE, POSITIONER, axis, configuration, world_of
from tests.support.structured_text.controller import Controller

DSC = 'simulate = true\nfollowing_window = 4096\ndsc = "speed"'
SPEED_RPM = 3000


def config_of(number: int, blocks: str = "") -> GatewayConfig:
    """One simulated drive object with a telegram."""
    if telegram(number).mode is ApplicationMode.ENCODER:
        more = 'simulate = true\nmotion = "speed=6000"'
        return configuration(axis(1, telegram_number=number, more=more).replace("[[axis]]", "[[encoder]]"))
    more = "simulate = true"
    if number in {5, 6, 105, 106}:
        more = DSC
    elif number in {7, 110, 111, 112}:
        more = f"simulate = true\nrated_speed_rpm = {SPEED_RPM}\n{POSITIONER}{blocks}"
    return configuration(axis(1, telegram_number=number, more=more))


def program(config: GatewayConfig, body: str = "", variables: str = "", block: str = "") -> str:
    """The generated blocks, and a program that calls the block of the first axis, then exchanges the frames."""
    sending, receiving = frame_maps(config)
    return f"""{structured_text(config)}
PROGRAM Main
VAR_INPUT
    received : ARRAY[0..{receiving.size - 1}] OF BYTE;
END_VAR
VAR_OUTPUT
    sent : ARRAY[0..{sending.size - 1}] OF BYTE;
END_VAR
VAR
    io : PDGW_Udp;
    drive : {block or block_name(telegram(config.objects[0].telegram))};
{variables}
END_VAR
{body or "    drive(Actual := io.axis_1_actual, Good := io.axis_1_good);"}
    io(received := received, axis_1_set := drive.Setpoints, sent => sent);
END_PROGRAM
"""


@cache
def _compiled(text: str) -> Controller:
    return Controller(text)


def restarted(text: str) -> Controller:
    """A controller with its first values; one text has one controller, which no two tests have at a time."""
    controller = _compiled(text)
    controller.now = 0
    controller.variables = controller.program.initial
    return controller


class TextPlc:
    """``block`` has the inputs and outputs of the block under test, by names in upper case."""

    def __init__(self, daemon: Daemon, text: str, host: str = "plc") -> None:
        self.daemon = daemon
        self.controller = restarted(text)
        self.loop = world_of(daemon).loop
        self.port = world_of(daemon).network.open(host, 0, "PLC")
        self.port.start(self._take)
        self._newest: bytes | None = None
        self.deaf = False
        """No frame of the gateway arrives."""
        self.cycles: list[tuple[int, bytes | None, bytes]] = []
        """Time, received frame and sent frame of each cycle."""

    @property
    def block(self) -> dict[str, Any]:
        found: dict[str, Any] = self.controller.variables["DRIVE"]
        return found

    def set(self, **inputs: Any) -> None:
        """Inputs of the block under test, by their names."""
        for name, value in inputs.items():
            assert name.upper() in self.block, name
            self.block[name.upper()] = value

    def _take(self) -> None:
        while (datagram := self.port.receive()) is not None:
            if not self.deaf:
                self._newest = datagram[0]

    def exchange(self, cycles: int = 1) -> None:
        for _ in range(cycles):
            frame = self.controller.cycle(self.loop.now(), self._newest)
            self.cycles.append((self.loop.now(), self._newest, frame))
            self._newest = None
            self.port.send(frame, self.daemon.address)
            self.loop.run_for(self.daemon.cycle_ns)

    def until(self, condition: Callable[[dict[str, Any]], object], what: str, patience: int = PATIENCE) -> None:
        """Exchange until the block under test shows something."""
        deadline = self.loop.now() + patience
        while not condition(self.block):
            assert self.loop.now() < deadline, f"{what}: {self.block}"
            self.exchange()

    def enable(self) -> None:
        self.set(Enable=False)
        self.exchange(2)
        self.until(lambda block: block["READY"], "ready")
        self.set(Enable=True)
        self.until(lambda block: block["ENABLED"], "enabled")
