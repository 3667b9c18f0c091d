"""``conformance shapes``: every drive variant with telegrams 1, 3, 9 and 100, through the complete gateway in virtual time.

Each moves as commanded (a quarter of the rated speed, or ten revolutions), or is rejected with the expected reason.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from pdgw.ds301.node.node import NodeStatus
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit, State
from pdgw.durations import MS, SECOND
from pdgw.gateway.assembly import build_gateway
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.reasons import FaultNumber
from pdgw.peers.drive import SHAPES, Latency, SimulatedDrive, shape
from pdgw.peers.drive.model.motion import INCREMENTS_PER_REVOLUTION
from pdgw.peers.world import Plc, World
from pdgw.profidrive.telegrams import ApplicationMode, telegram
from tests.long.conformance.tested import Tested

TELEGRAMS = (1, 3, 9, 100)
_CONFIG = """
[can]
interface = "virtual"
channel = "world"

[transport]
cyclic_port = 0
acyclic_port = 0
status_port = 0

[[axis]]
do_id = 1
node_id = 1
telegram = {number}
"""
_ONLINE_NS = 300 * SECOND
"""A drive that answers each SDO after half a second gets hundreds of them."""
_ANSWER_NS = 20 * SECOND
_SETTLED_NS = 100 * MS
_RPM = 750
_QUARTER = 0x1000
_TURNS = 10 * INCREMENTS_PER_REVOLUTION
_FREE_RANGE = 1 << 30
"""100 % of a position without a range limit, in its units."""
_LIMITED_RANGE = 500_000
_OFF = 0x047E

_LACKS = "not an object of this drive"
_OF_THE_ENGEL_LIKE = ("engel", "synchronous")
REFUSALS: Mapping[tuple[str, int], str] = {
    **{(name, 100): _LACKS for name in SHAPES if name not in _OF_THE_ENGEL_LIKE},
    **{("unguarded", number): "guarding of the gateway by the drive" for number in (1, 3, 9)},
    **{(name, 9): "modes of the drive" for name in ("vl", "csv", "csp")},
    **{("csp", number): _LACKS for number in (1, 3)},
    ("no-range", 9): "set rated_acceleration_rpm_s",
}
"""Expected reasons of rejection, a part of the text, by variant and telegram. Without an entry the drive must move."""


@dataclass(frozen=True)
class Outcome:
    """A field of the matrix."""

    shape: str
    telegram: int
    latency: Latency
    moved: bool
    text: str
    """How it moved, or the reason of its rejection."""
    tested: Tested
    failure: str = ""

    @property
    def passed(self) -> bool:
        return not self.failure

    def as_dict(self) -> dict[str, object]:
        """Plain data."""
        return {
            "shape": self.shape,
            "telegram": self.telegram,
            "command_latency_ms": self.latency.command_ms,
            "status_latency_ms": self.latency.status_ms,
            "moved": self.moved,
            "text": self.text,
            "failure": self.failure,
        }


class _Site:
    """A gateway, a drive and a PLC that acknowledges, switches off and on and sets the setpoint."""

    def __init__(self, name: str, number: int, seed: int) -> None:
        self.number = number
        self.world = World(seed)
        self.latency = Latency.draw(self.world.chance(f"{name} {number}"))
        self.loop = self.world.loop
        self.daemon = build_gateway(parse_config(_CONFIG.format(number=number)), self.world)
        self.drive: SimulatedDrive = self.world.drive("world", 1, shape=shape(name), latency=self.latency)
        self.axis = self.daemon.axes[0]
        self.raw = telegram(number).setpoints.mode is ApplicationMode.TRANSPARENT
        self.plc = Plc(self.world, self.daemon)

    def exchange(self, until: Callable[[], object], limit_ns: int = _ANSWER_NS) -> bool:
        """Run cycles until a condition is true; False on timeout."""
        end = self.loop.now() + limit_ns
        while not until():
            if self.loop.now() > end:
                return False
            self.plc.exchange(0)
        return True

    @property
    def refusal(self) -> str:
        """Why the axis is not in operation; empty if there is no reason."""
        client = self.axis.drive
        if client.status is NodeStatus.REFUSED:
            return client.status_text
        reference = [item.text for item in self.axis.faults if item.number == FaultNumber.REFERENCE]
        return reference[-1] if reference else ""

    def operate(self) -> bool:
        """Acknowledge until no fault is shown, then OFF and ON. False when the drive does not reach operation."""
        state = self.drive.model
        for _ in range(3):
            self._command(ControlBit.FAULT_RESET)
            self.exchange(lambda: False, _SETTLED_NS)
            self._command(0)
            self.exchange(lambda: False, _SETTLED_NS)
        self._command(1)
        return self.exchange(lambda: state.state is State.OPERATION_ENABLED)

    def _command(self, bits: int) -> None:
        """Send OFF plus these bits; 1 makes it ON."""
        if self.raw:
            word = 0x0F if bits == 1 else 0x06 | bits
            self.plc.set(0, {"Controlword": word, "Modes of Operation": Mode.VELOCITY} | _RAW)
            if bits == 1:
                for step in (0x06, 0x07, 0x0F):
                    self.plc.set(0, {"Controlword": step})
                    self.exchange(lambda: False, _SETTLED_NS)
            return
        self.plc.set(0, {"STW1": _OFF | bits})

    def move(self) -> bool:
        """Command a quarter of the rated speed or ten revolutions. Return whether the drive moved so."""
        model = self.drive.model
        if self.number == 9:
            limits = self.axis.drive.drive_type
            free = limits is None or limits.scaling.position_range is None
            self._start_task(_FREE_RANGE if free else _LIMITED_RANGE)
            return self.exchange(lambda: abs(model.position_actual - _TURNS) <= 1)
        if self.raw:
            self.plc.set(0, {"Target Velocity": 2 * _RPM})
        elif self.number == 3:
            self.plc.set(0, {"NSOLL_B": _QUARTER << 16})
        else:
            self.plc.set(0, {"NSOLL_A": _QUARTER})
        return self.exchange(lambda: abs(model.ramp.speed - _RPM) < 1) and self.exchange(self._shows_the_speed)

    def _start_task(self, reference: int) -> None:
        values = {"SATZANW": 0x8000, "MDI_MOD": 1, "MDI_TARPOS": (_TURNS << 30) // reference, "MDI_VELOCITY": 1 << 29}
        self.plc.set(0, {**values, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000, "STW1": 0x043F})
        self.exchange(lambda: False, _SETTLED_NS)
        self.plc.set(0, {"STW1": 0x047F})

    def _shows_the_speed(self) -> bool:
        """Whether the PLC sees the actual speed."""
        actuals = self.plc.actuals[0]
        if actuals is None:
            return False
        if self.raw:
            return abs(actuals["Velocity Actual Value"] - 2 * _RPM) <= 2
        wide = self.number == 3
        shown = actuals["NIST_B"] >> 16 if wide else actuals["NIST_A"]
        return abs(shown - _QUARTER) <= _QUARTER // 1000


_RAW = {"Profile Velocity": 6000, "Profile Acceleration": 300, "Profile Deceleration": 300}


def run_case(name: str, number: int, seed: int = 0) -> Outcome:
    """Run one variant with one telegram. The seed sets the latency of the drive."""
    site = _Site(name, number, seed)
    site.daemon.start()
    try:
        # The PLC waits: the drive comes online without it, which takes minutes for a slow one.
        site.loop.until(lambda: site.axis.drive.generation or site.refusal, "the drive", _ONLINE_NS)
        site.exchange(lambda: site.refusal, _SETTLED_NS)
        moved = False
        # A problem that is found while the drive turns stops it once.
        for _ in range(2):
            if moved or site.refusal:
                break
            site.exchange(lambda: site.axis.drive.status is NodeStatus.ONLINE)
            moved = site.operate() and site.move()
        refusal = site.refusal
    finally:
        site.daemon.stop()
        site.loop.until(site.daemon.stopped.is_set, "the end of the gateway", _ANSWER_NS)
    expected = REFUSALS.get((name, number), "")
    failure = ""
    if expected and (moved or expected not in refusal):
        failure = f"must be refused with {expected!r}"
    elif not expected and not moved:
        failure = f"must move: {refusal or site.axis.drive.status_text}"
    tested = Tested.of(site.daemon.config, [site.drive.node])
    return Outcome(
        name, number, site.latency, moved, "moved as commanded" if moved else f"refused: {refusal}", tested, failure
    )
