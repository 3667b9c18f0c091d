"""``conformance telegrams``: bits of the motion telegrams, asked for one by one through the whole gateway in virtual time.

Each case plays steps of a PLC scenario against a gateway with a simulated drive, and says which bit of which word it is about,
what was done, and what was seen on both sides. Source: docs/motion.md. Bits that several telegrams have are in ``shared``.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from pdgw.durations import SECOND
from pdgw.gateway.assembly import build_gateway
from pdgw.gateway.configuration.example import simulated
from pdgw.gateway.daemon import Daemon
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.scenario import Scenario
from pdgw.peers.simulation.console import Console
from pdgw.peers.world import Plc, World
from pdgw.workshop.conformance.tested import Tested

Steps = Sequence[Mapping[str, Any]]
_LIMIT_NS = 120 * SECOND
_ON_CAN = {
    "6040h": "controlword",
    "6060h": "modes_of_operation",
    "607Ah": "target_position",
    "60FFh": "target_velocity",
    "6072h": "max_torque",
}
"""What is shown of the drive's side."""


@dataclass(frozen=True)
class Case:
    """One bit (or value) of one word; ``did`` and ``steps`` are the same in words and as a scenario."""

    telegram: int
    word: str
    bit: str
    did: str
    steps: Steps
    on_can: Mapping[str, int] | None = None
    """What the drive must have been sent in the end, by object."""

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


def _case(number: int, name: str, did: str, *steps: Mapping[str, Any], on_can: Mapping[str, int] | None = None) -> Case:
    word, _, bit = name.partition(".")
    return Case(number, word, bit, did, (*_on(number), *steps), on_can)


def _see(**actuals: Any) -> dict[str, Any]:
    return {"expect": {name.replace("__", "."): value for name, value in actuals.items()}, "within": "10 s"}


_REACHED = _see(ZSW1__TARGET_REACHED=1)
_HOME: Steps = ({"home": {}}, _see(ZSW1__HOME_POSITION_SET=1), {"home_end": True}, {"hold": "150 ms"})
_FORWARD = {"setting_up": {"velocity": 3000}}

CASES: tuple[Case, ...] = (
    _case(111, "POS_STW1.MDI", "task to 20000 LU", {"mdi": {"to": 20_000}}, _REACHED, on_can={"607Ah": 8192}),
    _case(
        111,
        "POS_STW1.ABSOLUTE",
        "twice 5000 LU absolute",
        {"mdi": {"to": 5000}},
        _REACHED,
        {"mdi": {"to": 5000}},
        _see(XIST_A=5000),
    ),
    _case(
        *(111, "POS_STW1.ABSOLUTE = 0", "twice 5000 LU relative"),
        *({"mdi": {"to": 5000, "relative": True}}, _REACHED, {"mdi": {"to": 5000, "relative": True}}),
        _see(XIST_A=10_000, ZSW1__TARGET_REACHED=1),
    ),
    _case(
        111,
        "POS_STW1.POSITIVE_DIRECTION",
        "setting up forward",
        _FORWARD,
        _see(POS_ZSW2__MOVES_FORWARD=1),
        on_can={"60FFh": 600},
    ),
    _case(
        *(111, "POS_STW1.NEGATIVE_DIRECTION", "setting up backward", {"setting_up": {"velocity": -3000}}),
        _see(POS_ZSW2__MOVES_BACKWARD=1, POS_ZSW1__SETTING_UP=1),
        on_can={"60FFh": -600, "6060h": 3},
    ),
    _case(
        *(111, "POS_STW1.SETTING_UP", "both directions: nothing moves"),
        {"set": {"POS_STW1": 0xC600, "MDI_VELOCITY": 3000, "STW1": 0x047F}},
        _see(ZSW1__WARNING=1, ZSW1__TASK_ACKNOWLEDGE=0, ZSW1__DRIVE_STOPPED=1),
    ),
    _case(
        *(111, "POS_STW1.CONTINUOUS_UPDATE", "target changed without an edge"),
        *({"mdi": {"to": 30_000, "update": True}}, {"set": {"MDI_TARPOS": -4000}}),
        _see(XIST_A="-4000 +- 2", ZSW1__TASK_ACKNOWLEDGE=1, ZSW1__TARGET_REACHED=1),
    ),
    _case(
        111,
        "POS_STW1.BLOCK",
        "block that is not there",
        {"set": {"POS_STW1": 99, "STW1": 0x047F}},
        _see(ZSW1__WARNING=1),
    ),
    _case(111, "POS_STW2.TRACKING", "tracking", {"set": {"POS_STW2.TRACKING": 1}}, _see(POS_ZSW2__TRACKING=1)),
    _case(
        *(111, "POS_STW2.SET_REFERENCE_POINT", "after 5000 LU"),
        *({"mdi": {"to": 5000}}, _REACHED, {"set_reference": True}, _see(XIST_A=0, ZSW1__HOME_POSITION_SET=1)),
    ),
    _case(
        *(111, "POS_STW2.JOG_INCREMENTAL", "jog 2 by its distance, bit stands", {"jog_distance": 2}),
        *(_see(XIST_A=5000, ZSW1__TARGET_REACHED=1), {"hold": "500 ms"}, _see(XIST_A=5000)),
    ),
    _case(
        *(111, "POS_STW2.PASSIVE_HOMING", "probe armed"),
        {"set": {"POS_STW2.PASSIVE_HOMING": 1, "STW1.START_HOMING": 1}},
        _see(POS_ZSW1__PASSIVE_HOMING=1, ZSW1__HOME_POSITION_SET=0),
    ),
    _case(
        111,
        "POS_STW2.SOFTWARE_LIMITS",
        "target beyond",
        *_HOME,
        {"set": {"POS_STW2.SOFTWARE_LIMITS": 1}},
        {"mdi": {"to": 2_000_000, "velocity": 30_000}},
        _see(ZSW1__WARNING=1),
        on_can={"607Ah": 409_600},
    ),
    _case(
        *(111, "OVERRIDE.25 %", "setting up at 3000", _FORWARD, {"set": {"OVERRIDE": "25 %"}}),
        {"hold": "300 ms"},
        on_can={"60FFh": 150},
    ),
    _case(
        *(111, "OVERRIDE.0", "during a task, then 100 %", {"mdi": {"to": 40_000}}, {"set": {"OVERRIDE": 0}}),
        *(_see(ZSW1__DRIVE_STOPPED=1, ZSW1__TARGET_REACHED=0), {"set": {"OVERRIDE": "100 %"}}),
        _see(XIST_A=40_000, ZSW1__TARGET_REACHED=1),
    ),
    _case(
        111,
        "STW1.JOG_1_ON",
        "jog 1",
        {"jog": 1},
        _see(POS_ZSW1__JOGGING=1, POS_ZSW2__MOVES_BACKWARD=1),
        on_can={"60FFh": -600},
    ),
    _case(
        111,
        "STW1.JOG_2_ON",
        "jog 2",
        {"jog": 2},
        _see(POS_ZSW1__JOGGING=1, POS_ZSW2__MOVES_FORWARD=1),
        on_can={"60FFh": 600},
    ),
    _case(
        *(111, "STW1.JOG_1_ON and JOG_2_ON", "both, after jog 1", {"jog": 1}, _see(POS_ZSW1__JOGGING=1)),
        *(
            {"set": {"STW1.JOG_2_ON": 1}},
            _see(POS_ZSW1__JOGGING=0, ZSW1__DRIVE_STOPPED=1),
            {"set": {"STW1.JOG_1_ON": 0}},
        ),
        *({"hold": "500 ms"}, _see(POS_ZSW1__JOGGING=0)),
        on_can={"60FFh": 0},
    ),
    _case(111, "STW1.START_HOMING", "homing", *_HOME, _see(ZSW1__HOME_POSITION_SET=1, POS_ZSW1__HOMING=0, XIST_A=0)),
    _case(
        *(111, "STW1.DO_NOT_REJECT", "reject of a task", {"mdi": {"to": 200_000}}, {"reject": True}),
        _see(POS_ZSW1__MDI_ACTIVE=1, POS_ZSW2__TRAVERSING=0, ZSW1__TARGET_REACHED=1, XIST_A="< 190000"),
    ),
    _case(
        *(111, "STW1.NO_INTERMEDIATE_STOP", "stop and go on", {"mdi": {"to": 30_000, "relative": True}}),
        *({"intermediate_stop": True}, _see(ZSW1__DRIVE_STOPPED=1, ZSW1__TARGET_REACHED=0), {"resume": True}),
        _see(XIST_A=30_000, ZSW1__TARGET_REACHED=1),
    ),
    _case(111, "STW1.ACTIVATE_TASK", "edge and its end", {"mdi": {"to": 1000}}, _see(ZSW1__TASK_ACKNOWLEDGE=0)),
    _case(111, "MELDW.DRIVE_READY", "enabled", _see(MELDW__DRIVE_READY=1, MELDW__PULSES_ENABLED=1)),
    _case(
        110,
        "SATZANW.MDI",
        "task to 20000 LU",
        {"mdi": {"to": 20_000}},
        _see(XIST_A=20_000, AKTSATZ__MDI_ACTIVE=1),
        on_can={"607Ah": 8192},
    ),
    _case(
        *(112, "POS_STW1.MDI", "task to 20 mm", {"mdi": {"to": 20.0, "velocity": 6000}}, _REACHED),
        *(_see(XIST_F=20.0), {"hold": "100 ms"}),
        on_can={"607Ah": 8192},
    ),
    _case(
        *(112, "POS_STW1.ABSOLUTE = 0", "twice 5 mm relative"),
        *({"mdi": {"to": 5.0, "velocity": 6000, "relative": True}}, _REACHED),
        *({"mdi": {"to": 5.0, "velocity": 6000, "relative": True}}, _see(XIST_F=10.0, ZSW1__TARGET_REACHED=1)),
    ),
    _case(
        *(112, "POS_STW1.POSITIVE_DIRECTION", "setting up at 3000 mm/min", _FORWARD),
        _see(POS_ZSW2__MOVES_FORWARD=1, VIST_F="> 2900"),
        on_can={"60FFh": 600},
    ),
    _case(
        *(112, "POS_STW1.NEGATIVE_DIRECTION", "setting up backward", {"setting_up": {"velocity": -3000}}),
        _see(POS_ZSW2__MOVES_BACKWARD=1, VIST_F="< -2900"),
        on_can={"60FFh": -600, "6060h": 3},
    ),
    _case(
        *(112, "POS_STW1.CONTINUOUS_UPDATE", "target changed without an edge"),
        *({"mdi": {"to": 40.0, "velocity": 6000, "update": True}}, {"hold": "50 ms"}, {"set": {"MDI_TARPOS_F": 5.0}}),
        _see(XIST_F=5.0),
    ),
    _case(
        *(112, "POS_STW2.SET_REFERENCE_POINT", "at 2.5 mm, by REF_COORDINATE", {"set": {"REF_COORDINATE": 2.5}}),
        *({"set_reference": True}, _see(ZSW1__HOME_POSITION_SET=1, XIST_F=2.5)),
    ),
    _case(
        *(
            112,
            "MDI_VELOCITY_F.0",
            "no speed: refused",
            {"set": {"POS_STW1": 0x8100, "MDI_TARPOS_F": 5.0, "STW1": 0x047F}},
        ),
        _see(ZSW1__WARNING=1, XIST_F=0.0),
    ),
    _case(110, "POS_STW.JOG_INCREMENTAL", "jog 2 by its distance", {"jog_distance": 2}, _see(XIST_A=5000)),
    _case(110, "POS_STW.SET_REFERENCE_POINT", "at once", {"set_reference": True}, _see(ZSW1__HOME_POSITION_SET=1)),
    _case(
        7, "SATZANW.MDI", "no MDI in telegram 7", {"set": {"SATZANW": 0x8001, "STW1": 0x047F}}, _see(ZSW1__WARNING=1)
    ),
    _case(102, "MOMRED.50 %", "half torque", {"set": {"MOMRED": "50 %"}}, {"hold": "50 ms"}, on_can={"6072h": 1500}),
    _case(
        102,
        "MELDW.SPEED_BELOW_THRESHOLD_2",
        "1500 rpm",
        {"speed": "1500 rpm"},
        _see(MELDW__SPEED_BELOW_THRESHOLD_2=0, MELDW__SPEED_WITHIN_TOLERANCE=1),
    ),
    _case(102, "STW2.SIGN_OF_LIFE", "first counter", {"set": {"STW2.SIGN_OF_LIFE": 5}}, _see(ZSW2__SIGN_OF_LIFE="> 0")),
    _case(105, "KPC.0", "speed alone", {"set": {"NSOLL_B": "750 rpm"}}, _see(NIST_B="750 rpm +- 10 rpm")),
    _case(105, "KPC and XERR", "error that stays: turns on", {"set": {"KPC": 20_000, "XERR": 50}}, _see(NIST_B="> 0")),
    _case(
        105,
        "XERR.far",
        "starts too far from the axis",
        {"set": {"KPC": 20_000, "XERR": 500_000}},
        {"hold": "200 ms"},
        _see(NIST_B=0),
    ),
)


class _Plc(Plc):
    """A PLC in the world, that plays steps of a scenario."""

    def __init__(self, world: World, daemon: Daemon) -> None:
        super().__init__(world, daemon)
        self.loop = world.loop
        self.daemon = daemon
        self.console = Console(world.simulations[daemon.config.can[0].name], threading.Event())

    def play(self, steps: Steps) -> Engine:
        """Cycle by cycle to the end of the steps."""
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
    """A gateway in a world of its own, its PLC and its drive."""
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
    """Play one case in a world of its own."""
    with _gateway(case.telegram) as (plc, drive):
        return _outcome(case, plc, drive)


def run_walk(cases: Sequence[Case]) -> list[Outcome]:
    """Play cases of one telegram one after the other with the same gateway, which is in operation at the begin of each."""
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
