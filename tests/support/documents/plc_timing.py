"""Timing diagrams of the blocks for a PLC: each block runs against a gateway and a simulated drive in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pdgw.client.udp import ParameterClient
from pdgw.gateway.assembly import build_gateway
from pdgw.gateway.configuration.byte_map import frame_maps
from pdgw.gateway.configuration.example import simulated
from pdgw.gateway.parameters.acyclic import AcyclicServer
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.world import World, WorldChannel
from pdgw.profidrive.telegrams import ApplicationMode, telegram
from pdgw.tools.plc.code import structured_text
from pdgw.tools.plc.library import block_name
from tests.support.structured_text.controller import Controller

FOLDER = "plc-timing"
_DOCS = Path(__file__).parents[3] / "docs"
PICTURES = {
    "PDGW_Speed": "enabling, 600 rpm, OFF1",
    "PDGW_Axis": "Disabled 0, Standstill 1, Homing 4, DiscreteMotion 2, ContinuousMotion 3, Stopping 5, ErrorStop 6",
    "PDGW_Pos": "an absolute task; the block keeps STW1.6 = 1 until ZSW1.12 answers",
    "PDGW_Encoder": "a valid position, then a preset",
    "PDGW_Drive": "enabling, a fault and its acknowledgement",
    "PDGW_ParameterRequest": "three reads of parameter 922, each a new request",
    "PDGW_ParameterResponse": "the answers to the three reads",
    "MC_Power": "power on, later power off",
    "MC_Reset": "acknowledgement of a fault after its cause was removed",
    "MC_Stop": "MC_Stop ends a motion; Execute keeps the axis in Stopping",
    "MC_ReadActualPosition": "the position is valid after the first homing",
    "MC_ReadStatus": "the states of the whole run",
    "MC_MoveAbsolute": "a move; Done is TRUE until Execute falls",
    "MC_MoveRelative": "a move; Execute falls before the end, so Done is TRUE for one call",
    "MC_MoveVelocity": "a motion until MC_Halt replaces it",
    "MC_Home": "a homing at the present position",
    "MC_Halt": "MC_Halt ends a motion",
}
"""Description of the picture of each block."""
_MOTION = (
    "Power",
    "Reset",
    "Home",
    "MoveAbsolute",
    "MoveRelative",
    "MoveVelocity",
    "Halt",
    "Stop",
    "ReadStatus",
    "ReadActualPosition",
)
Samples = list[dict[str, float]]


class Trace(NamedTuple):
    """A signal over time: a number for each cycle."""

    name: str
    values: list[float]


class _Bench:
    """A PLC with one program, a gateway and its simulated device. ``samples``: the values of each cycle."""

    def __init__(
        self, number: int, calls: str, variables: str, seen: Callable[[dict[str, Any]], dict[str, float]]
    ) -> None:
        encoder = telegram(number).mode is ApplicationMode.ENCODER
        config = simulated([1], 1, number) if encoder else simulated([number])
        sending, receiving = frame_maps(config)
        do_id = config.objects[-1].do_id
        self.controller = Controller(
            structured_text(config),
            f"""PROGRAM Main
VAR_INPUT received : ARRAY[0..{receiving.size - 1}] OF BYTE; END_VAR
VAR_OUTPUT sent : ARRAY[0..{sending.size - 1}] OF BYTE; END_VAR
VAR read : PDGW_Read; build : PDGW_Build; {variables} END_VAR
    read(frame := received);
    {calls.replace("INPUTS", f"Actual := read.axis_{do_id}, Good := read.good_{do_id}")}
    build(axis_{do_id} := drive.Setpoints, good_{do_id} := read.good_{do_id}, frame => sent);
END_PROGRAM""",
        )
        self.world = World()
        self.world.simulate(config)
        self.gateway = build_gateway(config, self.world)
        self.gateway.start()
        self.samples: Samples = []
        self._seen = seen
        self._port = self.world.network.open("plc", 0, "PLC")
        self._newest: bytes | None = None
        self._port.start(self._take)

    def __getitem__(self, name: str) -> dict[str, Any]:
        """Inputs and outputs of a block, with names in upper case."""
        found: dict[str, Any] = self.controller.variables[name.upper()]
        return found

    @property
    def drive(self) -> SimulatedDrive:
        (simulation,) = self.world.simulations.values()
        device = simulation.device(1)
        assert isinstance(device, SimulatedDrive)
        return device

    def _take(self) -> None:
        while (datagram := self._port.receive()) is not None:
            self._newest = datagram[0]

    def exchange(self, cycles: int, block: str = "drive", **inputs: object) -> None:
        self[block].update({name.upper(): value for name, value in inputs.items()})
        for _ in range(cycles):
            frame = self.controller.cycle(self.world.loop.now(), self._newest)
            self._newest = None
            self._port.send(frame, self.gateway.address)
            self.world.loop.run_for(self.gateway.cycle_ns)
            self.samples.append(self._seen(self.controller.variables))

    def until(self, block: str, output: str) -> None:
        """Run cycles until an output is TRUE."""
        for _ in range(2500):
            if self[block][output.upper()]:
                return
            self.exchange(1)
        raise AssertionError(f"{block}.{output} stays FALSE")

    def begin(self) -> None:
        """Start the picture here, with three idle cycles."""
        self.samples.clear()
        self.exchange(3)

    def stop(self) -> None:
        self.gateway.stop()
        self.world.loop.until(self.gateway.stopped.is_set, "the end of the gateway")


def _outputs(*names: str, block: str = "DRIVE") -> Callable[[dict[str, Any]], dict[str, float]]:
    return lambda variables: {name: float(variables[block][name.upper()]) for name in names}


def _telegram_bench(number: int, seen: Callable[[dict[str, Any]], dict[str, float]], inputs: str = "") -> _Bench:
    return _Bench(number, f"drive(INPUTS{inputs});", f"drive : {block_name(telegram(number))};", seen)


def _speed() -> Iterator[tuple[str, Samples]]:
    bench = _telegram_bench(
        1, _outputs("Enable", "Enabled", "Speed", "InSpeed", "ActSpeed", "Reason"), ", ReferenceSpeed := 3000.0"
    )
    bench.until("drive", "Ready")
    bench.begin()
    bench.exchange(25, Enable=True)
    bench.exchange(60, Speed=600.0)
    bench.exchange(60, Enable=False)
    bench.stop()
    yield "PDGW_Speed", bench.samples


def _position() -> Iterator[tuple[str, Samples]]:
    def seen(variables: dict[str, Any]) -> dict[str, float]:
        drive = variables["DRIVE"]
        control, status = drive["SETPOINTS"]["STW1"], drive["ACTUAL"]["ZSW1"]
        bits = {"STW1.6": float(control >> 6 & 1), "ZSW1.12": float(status >> 12 & 1)}
        names = ("Execute", "Busy", "InPosition", "Done", "ActPosition")
        return bits | {name: float(drive[name.upper()]) for name in names}

    bench = _telegram_bench(111, seen, ", PositionFactor := 1.0, VelocityFactor := 1.0")
    bench.until("drive", "Ready")
    bench.exchange(1)
    bench.exchange(100, Enable=True)
    bench.exchange(100, ModePos=4, Execute=True)
    bench.exchange(20, Execute=False)
    bench.begin()
    bench.exchange(60, ModePos=2, Position=6000.0, Velocity=6000.0, Execute=True)
    bench.exchange(30, Execute=False)
    bench.stop()
    yield "PDGW_Pos", bench.samples


def _encoder() -> Iterator[tuple[str, Samples]]:
    bench = _telegram_bench(81, _outputs("Enable", "Valid", "Preset", "PresetDone", "Reason"))
    bench.until("drive", "Good")
    bench.exchange(100)
    bench.begin()
    bench.exchange(40, Enable=True)
    bench.exchange(50, Preset=True)
    bench.exchange(20, Preset=False)
    bench.stop()
    yield "PDGW_Encoder", bench.samples


def _transparent() -> Iterator[tuple[str, Samples]]:
    bench = _telegram_bench(100, _outputs("Enable", "Enabled", "Error", "AckError", "Reason"))
    bench.until("drive", "Good")
    bench.exchange(100)
    bench.begin()
    bench.exchange(40, Enable=True)
    bench.drive.node.model.inject(5)
    bench.exchange(60)
    bench.drive.node.model.clear()
    bench.exchange(20)
    bench.exchange(40, AckError=True)
    bench.exchange(10, AckError=False, Enable=False)
    bench.exchange(30, Enable=True)
    bench.stop()
    yield "PDGW_Drive", bench.samples


def _parameter() -> Iterator[tuple[str, Samples]]:
    def seen(variables: dict[str, Any]) -> dict[str, float]:
        request, response = variables["REQUEST"], variables["RESPONSE"]
        return {
            "RequestNumber": float(request["REQUESTNUMBER"]),
            "record sent": float(variables["ASKS"]),
            "Length": float(request["LENGTH"]),
            "Valid": float(response["VALID"]),
            "Value": float(response["VALUE"]),
        }

    bench = _Bench(
        1,
        """drive(INPUTS, ReferenceSpeed := 3000.0);
    IF asks THEN request(DoId := 16#01, Number := 922); END_IF;
    response(Bytes := answer, Length := length, RequestNumber := request.RequestNumber);""",
        """drive : PDGW_Speed_T1; request : PDGW_ParameterRequest; response : PDGW_ParameterResponse;
    asks : BOOL; answer : ARRAY[0..15] OF BYTE; length : INT;""",
        seen,
    )
    bench.until("drive", "Ready")
    server = next(item for item in bench.gateway.services if isinstance(item, AcyclicServer))
    variables = bench.controller.variables
    with ParameterClient(server.address, 1, channel=WorldChannel(bench.world, server.address)) as records:
        bench.samples.clear()
        for _ in range(3):
            bench.exchange(10)
            variables["ASKS"] = True
            bench.exchange(1)
            variables["ASKS"] = False
            request = bench["request"]
            answer = records.exchange(bytes(request["BYTES"][: request["LENGTH"]]))
            bench.exchange(5)
            variables["ANSWER"][:], variables["LENGTH"] = [*answer, *bytes(16)][:16], len(answer)
        bench.exchange(10)
    bench.stop()
    yield (
        "PDGW_ParameterRequest",
        [{key: item[key] for key in ("record sent", "RequestNumber", "Length")} for item in bench.samples],
    )
    yield (
        "PDGW_ParameterResponse",
        [{key: item[key] for key in ("RequestNumber", "Valid", "Value")} for item in bench.samples],
    )


_SHOWN = {
    "Power": ("Enable", "Status", "Error"),
    "Reset": ("Execute", "Busy", "Done"),
    "MoveVelocity": ("Execute", "Busy", "InVelocity", "CommandAborted"),
    "ReadStatus": ("Disabled", "Standstill", "DiscreteMotion", "ContinuousMotion", "Homing", "Stopping", "ErrorStop"),
    "ReadActualPosition": ("Enable", "Valid", "Position"),
}
"""Inputs and outputs in the pictures of those MC_... blocks that are not commands."""
_COMMAND = ("Execute", "Busy", "Done", "CommandAborted")


def _motion() -> Iterator[tuple[str, Samples]]:
    def seen(variables: dict[str, Any]) -> dict[str, float]:
        found = {
            f"{block}.{name}": float(variables[block.upper()][name.upper()])
            for block in _MOTION
            for name in _SHOWN.get(block, _COMMAND)
        }
        axis = variables["AXIS"]
        return found | {"State": float(axis["STATE"]), "ActPosition": axis["ACTPOSITION"]}

    bench = _Bench(
        111,
        "\n".join(f"{name}(Axis := axis);" for name in _MOTION)
        + "drive(Axis := axis, INPUTS, PositionFactor := 10000.0, VelocityFactor := 10.0, FullVelocity := 30000.0);",
        "axis : PDGW_AXIS; drive : PDGW_Axis_T111;" + "".join(f"{name} : MC_{name};" for name in _MOTION),
        seen,
    )
    begun: dict[str, int] = {}
    ended: dict[str, int] = {}

    def picture(block: str, cycles: int, **inputs: object) -> None:
        begun.setdefault(block, len(bench.samples) - 3)
        bench.exchange(cycles, block, **inputs)
        ended[block] = len(bench.samples)

    bench.until("axis", "Good")
    bench.exchange(500, "ReadStatus", Enable=True)
    bench.samples.clear()
    bench.exchange(5)
    picture("ReadActualPosition", 0, Enable=True)
    picture("Power", 40, Enable=True)
    picture("Home", 30, Execute=True)
    picture("Home", 10, Execute=False)
    ended["ReadActualPosition"] = len(bench.samples)
    picture("MoveAbsolute", 60, Execute=True, Position=0.6, Velocity=600.0)
    picture("MoveAbsolute", 10, Execute=False)
    picture("MoveRelative", 15, Execute=True, Distance=0.4, Velocity=600.0)
    picture("MoveRelative", 55, Execute=False)
    ended["ReadActualPosition"] = len(bench.samples)
    picture("MoveVelocity", 40, Execute=True, Velocity=300.0)
    picture("Halt", 30, Execute=True)
    picture("MoveVelocity", 5, Execute=False)
    picture("Halt", 10, Execute=False)
    bench.exchange(40, "MoveVelocity", Execute=True)
    picture("Stop", 40, Execute=True)
    picture("Stop", 10, Execute=False)
    ended["Power"] = begun["MoveAbsolute"]
    bench.exchange(10, "MoveVelocity", Execute=False)
    bench.drive.node.model.inject(5)
    bench.exchange(60)
    bench.drive.node.model.clear()
    picture("Reset", 30, Execute=True)
    picture("Reset", 10, Execute=False)
    bench.exchange(10, "Power", Enable=False)
    bench.exchange(40, "Power", Enable=True)
    off = len(bench.samples) - 10
    bench.exchange(20, "Power", Enable=False)
    bench.stop()
    samples = bench.samples
    for block in _MOTION:
        keys = [f"{block}.{name}" for name in _SHOWN.get(block, _COMMAND)]
        chosen = samples[max(0, begun.get(block, 0)) : ended.get(block, len(samples))]
        if block == "Power":
            chosen = chosen[:45] + samples[off:]
        more = ("State", "ActPosition") if block not in {"ReadStatus", "ReadActualPosition", "Power", "Reset"} else ()
        yield f"MC_{block}", [{key.rpartition(".")[2]: item[key] for key in (*keys, *more)} for item in chosen]
    yield "PDGW_Axis", [{key: item[key] for key in ("State", "ActPosition")} for item in samples]


_LEFT, _WIDE, _HIGH, _ROW = 130, 620, 22, 36


def timing_svg(traces: Sequence[Trace], cycle_ms: float) -> str:
    """A timing diagram: a step line for each signal with its greatest value, and a time scale."""
    cycles = len(traces[0].values)
    wide = _WIDE / cycles
    width, height = _LEFT + _WIDE + 40, len(traces) * _ROW + 40
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="13">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]
    for row, trace in enumerate(traces):
        top, low = max(trace.values), min(0.0, *trace.values)
        base = (row + 1) * _ROW - 4
        points: list[str] = []
        for place, value in enumerate(trace.values):
            x, y = f"{_LEFT + place * wide:.1f}", f"{base - (value - low) / (max(top, 1.0) - low) * _HIGH:.1f}"
            if not points or not points[-1].endswith(f",{y}"):
                points += [f"{x},{points[-1].partition(',')[2]}"] if points else []
                points.append(f"{x},{y}")
        points.append(f"{_LEFT + _WIDE},{points[-1].partition(',')[2]}")
        out.append(f'<text x="8" y="{base}">{trace.name}</text>')
        if top > 1:
            out.append(f'<text x="{_LEFT + _WIDE + 4}" y="{base - _HIGH + 8}" font-size="10">{top:.4g}</text>')
        out.append(f'<polyline points="{" ".join(points)}" fill="none" stroke="#1f4e8c" stroke-width="1.6"/>')
    tick = next(step for step in (10, 25, 50, 100, 250) if cycles / step < 8)
    for place in range(0, cycles, tick):
        x = f"{_LEFT + place * wide:.1f}"
        out.append(f'<text x="{x}" y="{height - 12}">{place * cycle_ms:g} ms</text>')
        out.append(f'<line x1="{x}" y1="8" x2="{x}" y2="{height - 28}" stroke="#bbb" stroke-dasharray="3 3"/>')
    return "\n".join([*out, "</svg>", ""])


def pictures() -> dict[str, str]:
    """The pictures by file name, each drawn from a run."""
    cycle_ms = simulated([1]).transport.cycle_time_ms
    found = {}
    for run in (_speed, _position, _encoder, _transparent, _parameter, _motion):
        for name, samples in run():
            traces = [Trace(key, [sample[key] for sample in samples]) for key in samples[0]]
            found[f"{name}.svg"] = timing_svg(traces, cycle_ms)
    return found


if __name__ == "__main__":
    for file_name, picture in pictures().items():
        (_DOCS / FOLDER / file_name).write_text(picture, encoding="utf-8")
