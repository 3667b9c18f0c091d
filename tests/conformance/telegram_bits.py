"""Cases for the bits of the motion telegrams, through the complete gateway in virtual time.

Each case runs steps of a PLC scenario with a gateway and a simulated drive. It names the bit and its word, the action, and
what both sides saw. Source: docs/motion.md. The bits that several telegrams share are in ``shared_bits``.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from pdgw.base.durations import SECOND
from pdgw.gateway.configuration.file import simulated
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.scenario import Scenario
from pdgw.peers.simulation.console import Console
from pdgw.peers.world import Plc, World
from tests.support.gateways.daemon import running, world_of

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


_IN_LU = {"OVERRIDE": "100 %", "MDI_ACC": "100 %", "MDI_DEC": "100 %"}
_FULL: Mapping[int, Mapping[str, Any]] = {
    110: _IN_LU,
    111: _IN_LU,
    112: {"OVERRIDE": "100 %", "MDI_ACC_F": 100, "MDI_DEC_F": 100},
}
"""Override and ramps of a telegram's positioner."""


def enabled(number: int) -> list[dict[str, Any]]:
    """The steps that enable the axis."""
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
        yield case_of(number, name, did, *enabled(number), *steps, on_can=row.get("on_can"))


CASES = tuple(_read_cases(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8")))


class BitsPlc(Plc):
    """A PLC in the world that runs the steps of cases with one axis."""

    def __init__(self, world: World, daemon: Daemon) -> None:
        super().__init__(world, daemon)
        self._loop = world.loop
        simulation = world.simulations[daemon.config.can[0].name]
        self._console = Console(simulation, threading.Event())
        drive = simulation.device(1)
        assert isinstance(drive, SimulatedDrive)
        self._model = drive.model

    def run_steps(self, steps: Steps) -> str:
        """Run the steps to their end, one cycle after the other; AssertionError if an expectation fails.

        Returns what the PLC saw last.
        """
        numbers = [item.number for item in self.endpoint.telegrams]
        engine = Engine(Scenario.model_validate({"telegrams": numbers, "steps": list(steps)}), self.endpoint)
        engine.drive = self._console.execute
        end = self._loop.now() + _LIMIT_NS
        while not engine.finished and self._loop.now() < end:
            engine.step(self._loop.now())
            self.exchange(0)
        failed = [f"{item.name}: {item.measured}" for item in engine.results if not item.passed]
        assert not failed, failed
        assert engine.finished
        return engine.results[-1].measured if engine.results else ""

    def check(self, case: Case) -> None:
        """Run a case; AssertionError if one of the sides sees something else."""
        seen = self.run_steps(case.steps)
        sent = {name: int(getattr(self._model, attribute)) for name, attribute in _ON_CAN.items()}
        print(f"{case.title}, {case.did}: seen by the PLC: {seen}; on CAN: {sent}")
        assert (case.on_can or {}).items() <= sent.items(), f"{sent}, must contain {case.on_can}"


@contextmanager
def gateway(number: int) -> Iterator[BitsPlc]:
    """The PLC of a gateway with one simulated axis in a world of its own."""
    with running(simulated([number])) as daemon:
        yield BitsPlc(world_of(daemon), daemon)


def run_case(case: Case) -> None:
    """Run one case in a world of its own."""
    with gateway(case.telegram) as plc:
        plc.check(case)
