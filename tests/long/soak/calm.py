"""Calm days: lives without any disturbance, in which every fault, warning, refusal, stop or missing end of a task is a violation.

All rules apply, and those that only healthy devices keep. Each part draws legal habits of its device from ``peers.habits``.
``calm_tasks`` has the PLC's program.
"""

from __future__ import annotations

from collections.abc import Sequence
from random import Random
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.states import State
from pdgw.gateway.axis.settings import ControlLost, PlcLossReaction
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS, ENCODER_TELEGRAM_NUMBERS, TASK_TELEGRAM_NUMBERS
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.peers.drive import ROTARY_AXIS
from pdgw.peers.drive.model.latency import NO_LATENCY
from pdgw.peers.drive.model.ramps import INCREMENTS_PER_REVOLUTION
from pdgw.peers.habits import HABITS, Habit
from tests.long.rules import Seen, broken
from tests.long.soak.calm_tasks import program
from tests.long.soak.plan import CYCLES_MS, TRANSPARENT, AxisPlan, Part, Plan, habits_ms, shapes_of
from tests.long.soak.soak_run import CHANNEL, SoakRun
from tests.long.soak.watch import ViolationError, require

CALM_TELEGRAMS: Final = (*DRIVE_TELEGRAM_NUMBERS, 81, 83)
_SHARE: Final = 0.12
"""Share of the habits that a device has."""
_NOT_HEALTHY: Final = frozenset({"frozen", "two-edges"})
"""Drive variants with a defect that the gateway has to report: an object that is never sent, a fault at power-on."""
_NO_POSITIONING: Final = frozenset({"csp"})
"""Drive variants that position only with targets for each SYNC."""
_MDI: Final = 9
_COUNTS_KEYS: Final = 'acceleration_unit = "inc/s2"\n'
_RPM_KEYS: Final = f'counts_per_revolution = {INCREMENTS_PER_REVOLUTION}\nacceleration_unit = "rpm/s"\n'
_MOTION_KEYS: Final = """\
homing_method = 35
[[axis.block]]
number = 3
position = 5000
velocity = 12000
next = "continue-with-stop"
[[axis.block]]
number = 4
position = -5000
velocity = 20000
"""
_NEEDED_KEYS: Final = {"sync-counter": "sync = true\n"}
"""Keys of [[axis]] or [[encoder]] without which a habit has no effect."""
NEEDED_OBJECTS: Final[dict[int | str, set[str]]] = {
    TRANSPARENT: {"current-missing", "inputs-missing", "identity-of-vendor-only"},
    "csv": {"supported-modes-missing"},
    "engel": {"position-wraps"},
    "synchronous": {"position-wraps"},
    "no-abort-option": {"starts-itself"},
}
"""Habits without objects that a telegram is made of, or without the identity by which devices are found. By drive variant:
without what says that it has one of two modes with the same objects (it is refused by the name of the mode), and against its
overlay (``range_is_limit``). One is in fault when it leaves Operational, as a node that starts itself does at the bring-up.
"""
UNFIT: Final[dict[int, set[str]]] = {
    number: {"flying-start", "load-sags", "load-swings-back"} for number in (*TASK_TELEGRAM_NUMBERS, TRANSPARENT)
}
"""Habits by telegram: before its first task a positioner brakes with the smallest 6084h, a homing on a shaft that turns is one
whose bits may be stuck, and a load that swings beyond the standstill window is a task that the drive continues.
"""
_PASSING_NS: Final = 2 * SECOND
"""A reason of a handshake with the drive ends within this time."""
_PASSING: Final = frozenset(
    {
        Reason.MODE_NOT_CONFIRMED,
        Reason.HOMING_SETUP,
        Reason.NOT_OPERATING,
        Reason.SENSOR_PRESETTING,
        Reason.SENSOR_PARKED,
        Reason.JOG_WAITS,
    }
)
"""Reasons of a handshake; the PLC parks a sensor for a shorter time."""
_PASSING_WITH: Final = {"motion-starts-late": Reason.INTERNAL_LIMIT}
"""The same with a habit: a limit bit at rest may be why the axis does not move yet."""
_ASKED_NS: Final = SECOND // 2
"""What the PLC asks for is over within this time after it, besides the latency of the drive."""
_CAUSED: Final = {
    Reason.REJECTED: 0x0010,
    Reason.INTERMEDIATE_STOP: 0x0020,
    Reason.SETPOINT_DISABLED: 0x0070,
    Reason.HOMING_STOPPED: 0x0800,
}
"""Reasons that the PLC asks for by a 0 in these bits of STW1."""
_JOG: Final = 0x0300


def calm_shapes(number: int) -> tuple[str, ...]:
    """Healthy drive variants of a telegram; a positioner has the keys of units that a variant does not report."""
    positions = number in TASK_TELEGRAM_NUMBERS
    unfit = _NOT_HEALTHY | _NO_POSITIONING if positions else _NOT_HEALTHY
    return tuple(name for name in shapes_of(_MDI if positions else number) if name not in unfit)


def legal_habits(device: str) -> list[Habit]:
    """The habits of which the gateway must not even warn."""
    return [habit for habit in HABITS.values() if device in habit.legal_for and not habit.warns]


def draw_habits(chance: Random, number: int, shape: str = "") -> dict[str, dict[str, int]]:
    """Draw a combination of legal habits, with parameters in their legal ranges."""
    device = "encoder" if number in ENCODER_TELEGRAM_NUMBERS else "drive"
    drawn = [habit for habit in legal_habits(device) if chance.random() < _SHARE]
    needed = NEEDED_OBJECTS.get(number, set()) | NEEDED_OBJECTS.get(shape, set()) | UNFIT.get(number, set())
    habits = {
        habit.name: {key: chance.randint(*limits) for key, limits in habit.legal.items()}
        for habit in drawn
        if habit.name not in needed
    }
    if "motion-starts-late" in habits:
        for name in ("flying-start", "load-sags", "load-swings-back"):
            habits.pop(name, None)  # a closed brake holds the load
    return habits


def calm_plan(number: int, cycle_ms: int, name: str, habits: dict[str, dict[str, int]], *, direct: bool = True) -> Plan:
    """A part with one axis (``name``: the drive variant), or one encoder, with these habits."""
    keys = "".join(_NEEDED_KEYS.get(habit, "") for habit in habits)
    if number in ENCODER_TELEGRAM_NUMBERS:
        return Plan(cycle_ms, (), number, direct, encoder_habits=habits, encoder_keys=keys)
    keys += "" if name in shapes_of(number) else _COUNTS_KEYS if name == "counts" else _RPM_KEYS
    axis = AxisPlan(number, name, NO_LATENCY, PlcLossReaction.RAMP, ControlLost.STOP, habits, keys)
    return Plan(cycle_ms, (axis,), 0, direct, _MOTION_KEYS)


def draw_calm(chance: Random, _: int, telegrams: Sequence[int]) -> Plan:
    """Draw a part with one axis, or one encoder."""
    number, cycle_ms, direct = telegrams[0], chance.choice(CYCLES_MS), chance.random() < 0.5
    name = "" if number in ENCODER_TELEGRAM_NUMBERS else chance.choice(calm_shapes(number))
    return calm_plan(number, cycle_ms, name, draw_habits(chance, number, name), direct=direct)


class CalmRun(SoakRun):
    """Runs one part of a calm day with the PLC's program of its telegram."""

    linear = ROTARY_AXIS  # a healthy machine does not reach its limit switches

    def __init__(self, part: Part, *, frames: bool = False, records: bool = False) -> None:
        super().__init__(part, keep_telegrams=True, frames=frames, records=records)
        self.working = False
        """The PLC has switched on, and the drive has shown operation."""
        self._reason: Reason | None = None
        self._reason_since = self.begin
        self._caused: dict[Reason | None, int] = {}
        """When the PLC caused a reason last."""
        habits = self.plan.axes[0].habits if self.axes else self.plan.encoder_habits
        self.late_ns = habits_ms(habits) * MS + 4 * self.cycle_ns
        self._passing = _PASSING | {reason for name, reason in _PASSING_WITH.items() if name in habits}
        self._warned = any(HABITS[name].warns for name in habits)
        self.encoder = self.world.encoder(CHANNEL, 1, habits=habits) if self.plan.encoder else None
        self.program = program(self)

    @property
    def tasks(self) -> int:
        """Number of tasks that have ended as they must."""
        return self.program.done

    def _phases(self) -> None:
        try:
            self.program.run()
        except ViolationError as violation:
            self._violation = violation

    def _use_parameters(self) -> None:
        """The parameter channel is used by the program alone."""

    def _check(self) -> None:
        super()._check()
        for item in (*self.daemon.axes, *self.daemon.encoders):
            lost = item.client.generation > 1 or (self.working and not item.good)
            faults = [fault.text for fault in item.fault_log.history if not (fault.is_warning and self._warned)]
            alarms = [*faults[-1:], *([] if self._warned else self.trace.alarms[-1:])]
            alarms += [item.client.status_text] if lost else []
            states = [axis.drive.model.state for axis in self.axes]
            seen = Seen(
                reported=bool(alarms),
                stopped=self.working and bool(states) and states[item.do_id - 1] is not State.OPERATION_ENABLED,
                denied=self._denied(item),
            )
            if broken(seen):
                require(item.label, seen, "; ".join([self.program.task, *alarms, self.describe()]))

    def run_to(self, until: int) -> None:
        try:
            super().run_to(until)
        except ViolationError as violation:
            raise ViolationError(f"{violation} ({self.plan})") from None

    def _denied(self, item: DriveObject) -> bool:
        """Whether the gateway gives a reason that the PLC does not cause, or for longer than it may."""
        now, word = self.loop.now(), self.axes[0].words.word if self.axes else 0
        reason = item.reason if self.working else None
        if reason is None or reason is not self._reason:
            self._reason, self._reason_since = reason, now
        for cause, bits in _CAUSED.items():
            if bits & ~word:
                self._caused[cause] = now
        if word & _JOG and not self.plan.direct:
            self._caused[Reason.INTERMEDIATE_STOP] = now  # the end of a jog is one until more frames confirm it
        passing = reason in self._passing
        since = self._reason_since if passing else self._caused.get(reason, 0)
        limit = _PASSING_NS if passing else _ASKED_NS
        return reason is not None and now - since > limit + 2 * self.late_ns
