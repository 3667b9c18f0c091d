"""``conformance telegrams``: set the bits of the motion telegrams one by one, through the complete gateway in virtual time.

Each case runs steps of a PLC scenario with a gateway and a simulated drive. It names the bit and its word, the action, and
what both sides saw. Source: docs/motion.md. The bits that several telegrams share are in ``shared``.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from pdgw.durations import SECOND
from pdgw.gateway.assembly import build_gateway
from pdgw.gateway.configuration.example import simulated
from pdgw.gateway.daemon import Daemon
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.scenario import Scenario
from pdgw.peers.simulation.console import Console
from pdgw.peers.world import Plc, World
from tests.long.conformance.tested import Tested

Step = Mapping[str, Any]
Steps = Sequence[Step]
_LIMIT_NS = 120 * SECOND
_ON_CAN = {
    "6040h": "controlword",
    "6060h": "modes_of_operation",
    "607Ah": "target_position",
    "60FFh": "target_velocity",
    "6072h": "max_torque",
}
"""Objects shown for the drive's side."""


@dataclass(frozen=True)
class Case:
    """One bit or value of one word. ``did`` describes the ``steps`` of the scenario."""

    telegram: int
    word: str
    bit: str
    did: str
    steps: Steps
    on_can: Mapping[str, int] | None = None
    """Required values at the drive in the end, by object."""

    @property
    def title(self) -> str:
        """``111 POS_STW1.MDI``."""
        return f"{self.telegram} {self.word}.{self.bit}"


@dataclass(frozen=True)
class Outcome:
    """A row of the matrix."""

    case: Case
    seen_by_plc: str
    seen_on_can: str
    failures: tuple[str, ...]
    tested: Tested

    @property
    def passed(self) -> bool:
        return not self.failures

    def as_dict(self) -> dict[str, object]:
        """Plain data."""
        case = self.case
        return {
            "telegram": case.telegram,
            "word": case.word,
            "bit": case.bit,
            "did": case.did,
            "seen_by_plc": self.seen_by_plc,
            "seen_on_can": self.seen_on_can,
            "failures": list(self.failures),
        }


_IN_LU = {"OVERRIDE": "100 %", "MDI_ACC": "100 %", "MDI_DEC": "100 %"}
_FULL: Mapping[int, Mapping[str, Any]] = {
    110: _IN_LU,
    111: _IN_LU,
    112: {"OVERRIDE": "100 %", "MDI_ACC_F": 100, "MDI_DEC_F": 100},
}
"""Override and ramps of a telegram's positioner."""


def _on(number: int) -> list[dict[str, Any]]:
    setpoints = _FULL.get(number)
    override = [] if setpoints is None else [{"set": setpoints}]
    return [{"expect": {"ZSW1.CONTROL_REQUESTED": 1}, "within": "20 s"}, {"enable": True}, *override]


def case_of(number: int, name: str, did: str, *steps: Step, on_can: Mapping[str, int] | None = None) -> Case:
    """``name``: the word, and its bit after a dot."""
    word, _, bit = name.partition(".")
    return Case(number, word, bit, did, steps, on_can)


def see(**actuals: Any) -> Step:
    """Expect these actual values within 10 s; the dot of a name may be written as two underscores."""
    return {"expect": {name.replace("__", "."): value for name, value in actuals.items()}, "within": "10 s"}


def _read_cases(text: str) -> Iterator[Case]:
    for row in yaml.safe_load(text):
        number, name, did = row["case"]
        steps = (see(**step["see"]) if "see" in step else step for step in row["steps"])
        yield case_of(number, name, did, *_on(number), *steps, on_can=row.get("on_can"))


CASES = tuple(_read_cases(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8")))


class _Plc(Plc):
    """A PLC in the world that runs steps of a scenario."""

    def __init__(self, world: World, daemon: Daemon) -> None:
        super().__init__(world, daemon)
        self.loop = world.loop
        self.daemon = daemon
        self.console = Console(world.simulations[daemon.config.can[0].name], threading.Event())

    def play(self, steps: Steps) -> Engine:
        """Run the steps to their end, one cycle after the other."""
        numbers = [item.number for item in self.telegrams]
        engine = Engine(Scenario.model_validate({"telegrams": numbers, "steps": list(steps)}), self)
        end = self.loop.now() + _LIMIT_NS
        while not engine.finished and self.loop.now() < end:
            engine.step(self.loop.now())
            while engine.drive_commands:
                self.console.execute(engine.drive_commands.pop(0))
            self.exchange(0)
        return engine


@contextmanager
def _gateway(number: int) -> Iterator[tuple[_Plc, SimulatedDrive]]:
    """A gateway in a world of its own, with its PLC and its drive."""
    config = simulated([number])
    world = World(0)
    world.simulate(config)
    daemon = build_gateway(config, world)
    daemon.start()
    try:
        drive = world.simulations[config.can[0].name].device(1)
        assert isinstance(drive, SimulatedDrive)
        yield _Plc(world, daemon), drive
    finally:
        daemon.stop()


def run_case(case: Case) -> Outcome:
    """Run one case in a world of its own."""
    with _gateway(case.telegram) as (plc, drive):
        return _outcome(case, plc, drive)


def run_walk(cases: Sequence[Case]) -> list[Outcome]:
    """Run cases of one telegram with the same gateway, which is in operation before each."""
    number = cases[0].telegram
    with _gateway(number) as (plc, drive):
        plc.play(_on(number)[:1])
        return [_outcome(case, plc, drive) for case in cases]


def _outcome(case: Case, plc: _Plc, drive: SimulatedDrive) -> Outcome:
    engine = plc.play(case.steps)
    failures = [f"{result.name}: {result.measured}" for result in engine.results if not result.passed]
    if not engine.finished:
        failures.append("not finished")
    model = drive.node.model
    sent = {name: int(getattr(model, attribute)) for name, attribute in _ON_CAN.items()}
    for name, value in (case.on_can or {}).items():
        if sent.get(name) != value:
            failures.append(f"{name} = {sent.get(name)}, must be {value}")
    shown = engine.results[-1].measured if engine.results else ""
    on_can = ", ".join(
        f"{name} = {value:04X}h" if name == "6040h" else f"{name} = {value}" for name, value in sent.items()
    )
    return Outcome(case, shown, on_can, tuple(failures), Tested.of(plc.daemon.config, [drive.node]))
