"""The walks: telegrams with the user's settings, with a short and a full set of inputs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import TypeVar

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.eds.importer import import_eds
from pdgw.ds301.eds.writer import write_eds
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.identification.describe import answers_of_defaults, describe
from pdgw.dsp402.modes import Mode
from pdgw.gateway.axis.settings import AxisSettings, ControlLost, PlcLossReaction
from pdgw.gateway.axis.telegrams import (
    DRIVE_TELEGRAM_NUMBERS,
    ENCODER_TELEGRAM_NUMBERS,
    POSITIONER_TELEGRAM_NUMBERS,
    TASK_TELEGRAM_NUMBERS,
)
from pdgw.gateway.motion.blocks import Block
from pdgw.gateway.motion.dsc_setpoint import DscChoices, DscForm
from pdgw.gateway.motion.requests import PositionerChoices
from pdgw.peers.drive import shape
from pdgw.profidrive.sign_of_life import MONITORING_OFF
from tests.long.rules import Rule
from tests.long.walk.brakes import BrakeMonitor
from tests.long.walk.drive import anything, guarded, polled
from tests.long.walk.machine import Transducer
from tests.long.walk.monitor import Expected, Monitor
from tests.long.walk.plc import HOMING_METHOD, RAW, frames, is_central, stops, with_life
from tests.long.walk.recovery import recovery
from tests.long.walk.search import PowerWalk, Result, search
from tests.long.walk.values import Plc, Shown

Walked = TypeVar("Walked", bound=Transducer)
TICK_NS = 200 * MS
"""One step of the walk. The relevant ages (200, 300, 500 ms) are one to three steps, so that each is checked inside, at and
after its end with the fewest states.
"""
FINE_TICK_NS = 100 * MS
LONG_TICK_NS = 1000 * MS
"""One step of a walk with homing or jog. Ages of a mode and a homing (1 s) and of a setpoint (2 s) are one and two steps. Shorter
ages are over after one step; the walks without homing and jog have them.
"""
_BRAKE_STEPS = 5
_ON_STEPS = 4
"""Steps that an ON waits for the drive: the slowest correct one (``recovery``) needs three for a transition."""
NOT_WALKED = dict.fromkeys(ENCODER_TELEGRAM_NUMBERS, "an encoder has no power stage and no motion")
"""Telegrams without a walk, with the reason."""
ANSWER_NS = 2 * SECOND
"""Time in which a drive acknowledges a setpoint (docs/motion.md)."""
STOP_TIME_NS = FINE_TICK_NS // 2
"""With this time, the limit in the speed supervision falls to the setpoint within one step."""


@cache
def drive() -> DriveType:
    """A simulated drive with all modes, from its data sheet."""
    chosen = shape("engel")
    dictionary = import_eds(write_eds(chosen.info, chosen.objects()).encode(), 1).dictionary
    return describe(dictionary, answers_of_defaults(dictionary))


@dataclass(frozen=True, slots=True)
class Case:
    """One walk."""

    number: int
    on_plc_loss: PlcLossReaction = PlcLossReaction.QUICK_STOP
    resume: bool = False
    hold: bool = False
    full: bool = False
    guarding: bool = False
    """Walk the stops beside the Controlword, with the results of guarding, instead of the Controlword."""
    brake: bool = False
    """A drive at standstill has five steps to leave operation, as with a holding brake."""
    life: int | None = None
    """P925, with a PLC that has a sign of life; None: without one."""
    by_sdo: bool = False
    """The speed of the drive is read by SDO, with late and lost answers."""
    homing: bool = False
    """Traversing tasks with homing."""
    jog: bool = False
    """Traversing tasks with jog."""
    tick_ns: int = TICK_NS

    @property
    def name(self) -> str:
        """Name for the output."""
        parts = (
            *(f"telegram {self.number}", self.on_plc_loss.value, "resume" * self.resume, "hold" * self.hold),
            *(
                "full" * self.full,
                "guarding" * self.guarding,
                "brake" * self.brake,
                "sign of life" * (self.life is not None),
                "speed by SDO" * self.by_sdo,
            ),
            *("homing" * self.homing, "jog" * self.jog),
        )
        return " ".join(filter(None, parts))

    def run(self, until: Collection[Rule] = ()) -> Result:
        """Walk to the fixpoint, then bring the axis back from every state. ``until``: end when one of these rules is broken."""
        number, machine = self.number, self.machine(Transducer)
        plc = self._frames()
        expected = Expected(
            self.on_plc_loss,
            self.resume and number != RAW,
            self.hold,
            raw=number == RAW,
            tasks=self._tasks,
            own_ramp=is_central(number),
            life=self.life,
            answer_steps=ANSWER_NS // self.tick_ns,
            enter_steps=2,
            on_steps=_ON_STEPS,
            by_sdo=self.by_sdo,
        )
        monitor = BrakeMonitor(_BRAKE_STEPS if self.brake else 0) if self.guarding else Monitor(expected)
        result = search(PowerWalk(machine, monitor), machine, until)
        if not result.violations and not self.guarding:
            off, acknowledge, on = (next(item for item in plc if item.word & 0x8F == word) for word in (0xE, 0x8E, 0xF))
            if stuck := recovery(machine, range(len(machine)), self._mode, off, acknowledge, on):
                result.violations[Rule.RETURNS] = stuck
        return result

    def machine(self, kind: Callable[..., Walked]) -> Walked:
        """The axis machine with all inputs. ``kind``: Transducer or a subclass."""
        shown = self._shown()
        shown = guarded(shown) if self.guarding else polled(shown) if self.by_sdo else shown
        made, on_ns = self._frames(), self.tick_ns * _ON_STEPS
        inputs = product(stops(made) if self.by_sdo else made, shown)
        more = {"guarding": self.guarding, "on_ns": on_ns, "polled": self.by_sdo}
        return kind(self.number, self.settings(), drive(), self.tick_ns, inputs, **more)

    @property
    def _tasks(self) -> bool:
        return self.number in TASK_TELEGRAM_NUMBERS

    @property
    def _mode(self) -> int:
        return (Mode.POSITION if self._tasks else Mode.VELOCITY).value

    def _shown(self) -> list[Shown]:
        return anything(self._mode, tasks=self._tasks, homing=self.homing, jog=self.jog, full=self.full)

    def _frames(self) -> list[Plc]:
        made = frames(self.number, homing=self.homing, jog=self.jog, full=self.full)
        if self.guarding:
            made = stops(made)
        return made if self.life is None else list(with_life(made))

    def settings(self) -> AxisSettings:
        """The user's settings of the axis."""
        return AxisSettings(
            on_plc_loss=self.on_plc_loss,
            ramp_stop_resume=self.resume,
            control_lost=ControlLost.HOLD if self.hold else ControlLost.STOP,
            stop_time_ns=STOP_TIME_NS,
            enter_ns=self.tick_ns * (_BRAKE_STEPS if self.brake else 1),
            stall_ns=self.tick_ns,
            sign_of_life_failures=MONITORING_OFF if self.life is None else self.life,
            cycle_ns=self.tick_ns,
            dsc=DscChoices(DscForm.SPEED, following_window=4096),
            positioner=PositionerChoices(
                lu_per_revolution=4096,
                lu_per_unit=1000,
                max_velocity=30_000,
                max_acceleration=1000,
                max_deceleration=1000,
                jog_velocities=(-6144, 6144),
                position_window=5,
                homing_method=HOMING_METHOD,
                blocks=(Block(0, position=1000, velocity=6144),),
            ),
        )


def short() -> Iterator[Case]:
    """For the tests: the defaults with both ways in which a PLC commands the power stage."""
    yield Case(1)
    yield Case(RAW)


def selected() -> Iterator[Case]:
    """Each telegram of a drive with the defaults, each setting once, sign of life, guarding, and a speed by SDO."""
    yield from map(Case, DRIVE_TELEGRAM_NUMBERS)
    quick_stop, ramp, coast = PlcLossReaction.QUICK_STOP, PlcLossReaction.RAMP, PlcLossReaction.COAST
    yield Case(1, quick_stop, resume=True, hold=True)
    yield Case(1, ramp)
    yield Case(1, coast, hold=True)
    yield Case(RAW, ramp)
    yield Case(2, life=1)
    yield Case(1, guarding=True)
    yield Case(1, guarding=True, brake=True)
    yield Case(1, by_sdo=True)


def every() -> Iterator[Case]:
    """Also all settings with all telegrams, with the full set of inputs where a telegram has no tasks; homing and jog."""
    before = list(selected())
    yield from before
    for number in DRIVE_TELEGRAM_NUMBERS:
        full = number not in TASK_TELEGRAM_NUMBERS
        for loss, resume, hold in product(PlcLossReaction, (False, True), (False, True)):
            case = Case(number, loss, resume, hold, full=full, tick_ns=FINE_TICK_NS if full else TICK_NS)
            if case not in before:
                yield case
    yield from (Case(1, loss, by_sdo=True) for loss in (PlcLossReaction.RAMP, PlcLossReaction.COAST))
    yield from (Case(number, homing=True, tick_ns=LONG_TICK_NS) for number in TASK_TELEGRAM_NUMBERS)
    yield from (Case(number, jog=True, tick_ns=LONG_TICK_NS) for number in POSITIONER_TELEGRAM_NUMBERS)
