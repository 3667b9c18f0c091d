"""Cost of one axis and cycle in the hot path: frame bytes to RPDO bytes, TPDO bytes to frame bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.identification.generic import recorded_drive_type
from pdgw.dsp402.pdo.layouts import PdoLayout
from pdgw.durations import MS
from pdgw.gateway.axis.executors.positions.motion import ACKNOWLEDGED, NEW_SETPOINT
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.telegrams import drive_layout
from pdgw.gateway.axis.values import Configured
from pdgw.gateway.configuration.example import simulated
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import telegram
from tests.long.bench.measuring.measure import nanoseconds_per_call

GOALS_NS = {1: 10_000, 9: 20_000, 111: 12_000}
"""Goals for one axis cycle, in nanoseconds by telegram."""
_CYCLE_NS = MS
FRAMES = 4096
"""Number of different frames, which are then repeated."""
_PEER = ("127.0.0.1", 40000)
_ENABLED = 0x0637
_WITH_TASKS = (9, 111)
"""Telegrams whose drive acknowledges a new setpoint (CW.4)."""


@dataclass(frozen=True, slots=True)
class TranslationCost:
    """Nanoseconds of one axis cycle."""

    telegram: int
    total_ns: float
    goal_ns: int | None


def axis_cycle(number: int) -> Callable[[], object]:
    """A function for one complete axis cycle of a telegram, with new setpoints and a new actual value each time."""
    chosen = telegram(number)
    plc = PlcEndpoint([chosen], _CYCLE_NS)
    endpoint = CyclicEndpoint([chosen], cycle_ns=_CYCLE_NS)
    layout = drive_layout(number)
    feedback = DriveFeedback()
    machine = AxisMachine(number, simulated([number]).axis[0].settings_at(_CYCLE_NS / MS), feedback)
    inputs, command = machine.inputs, machine.outputs.command
    inputs.news.append(Configured(recorded_drive_type(frozenset())))
    inputs.drive_ok = True
    now = _enable(endpoint, machine, plc, number)
    # The cycle counter continues when the frames repeat: it overflows after a whole number of repetitions.
    frames = [_frame(plc, number, value) for value in range(1, FRAMES + 1)]
    acknowledge = ACKNOWLEDGED if number in _WITH_TASKS else 0
    tpdos = [
        [_tpdos(layout, value, command.modes_of_operation, status) for value in range(1, 17)]
        for status in (_ENABLED, _ENABLED | acknowledge)
    ]
    position = 0
    good = [True]

    def run() -> object:
        nonlocal position, now
        now += _CYCLE_NS
        endpoint.receive(frames[position % FRAMES], _PEER, now)
        position += 1
        for pdo, data in tpdos[command.controlword & NEW_SETPOINT != 0][position & 15]:
            pdo.unpack_into(data, feedback)
        inputs.now = now
        inputs.setpoints, inputs.fresh = endpoint.setpoints[0], True
        outputs = machine.step()
        for pdo in layout.rpdos:
            pdo.pack(command)
        return endpoint.build([outputs.actuals], good)

    return run


def _tpdos(layout: PdoLayout, value: int, mode: int, status: int) -> list[tuple[Pdo, bytes]]:
    """TPDOs of a drive with this Statusword whose speed and position depend on ``value``."""
    image = DriveFeedback()
    image.statusword = status
    image.modes_of_operation_display = mode
    image.velocity_actual = 100 * value
    image.position_actual = 1000 * value
    return [(pdo, pdo.pack(image)) for pdo in layout.tpdos]


def _frame(plc: PlcEndpoint, number: int, value: int) -> bytes:
    words = {
        1: {"STW1": 0x047F, "NSOLL_A": value},
        9: {"STW1": 0x043F | (value & 8) << 3, "SATZANW": 0x8000, "MDI_TARPOS": value << 10, "MDI_VELOCITY": 1 << 29},
        111: {"STW1": 0x047F, "POS_STW1": 0x9100, "OVERRIDE": 0x4000, "MDI_TARPOS": value << 4, "MDI_VELOCITY": 3000},
        100: {"Controlword": 0x0F, "Target Velocity": value, "Profile Acceleration": 300, "Profile Deceleration": 300},
    }
    plc.set(0, words[number])
    return bytes(plc.build())


def _enable(endpoint: CyclicEndpoint, machine: AxisMachine, plc: PlcEndpoint, number: int) -> int:
    """Bring the axis into operation. Return the time of the last frame."""
    now = 0
    word = plc.telegrams[0].setpoints.names[0]
    off = {1: 0x047E, 9: 0x043E, 100: 0x0006, 111: 0x043E}[number]
    for control, status in ((off, 0x0250), (off, 0x0231), (off | 1, 0x0231), (off | 1, 0x0233)):
        plc.set(0, {word: control})
        now += _CYCLE_NS
        endpoint.receive(bytes(plc.build()), _PEER, now)
        machine.inputs.feedback.statusword = status
        machine.inputs.setpoints, machine.inputs.fresh = endpoint.setpoints[0], True
        machine.step()
    return now


def run() -> list[TranslationCost]:
    """Measure telegrams 1, 9, 100 and 111 (continuous update: a new target in each cycle)."""
    return [TranslationCost(n, nanoseconds_per_call(axis_cycle(n)), GOALS_NS.get(n)) for n in (1, 9, 100, 111)]
