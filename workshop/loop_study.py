"""Study of a position loop through the gateway: following error and stability by gain and cycle time, in virtual time.

A simulated PLC closes the loop (``peers.plc.position_loop``) over telegram 105: without DSC, and with both forms of DSC. For
each point a gateway with a simulated drive makes a small step and then follows a sine. The drive has no load.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pdgw.durations import MS, SECOND
from pdgw.gateway.assembly import build_gateway
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.example import SIMULATED_WATCHDOG_FACTOR
from pdgw.gateway.errors import GatewayError
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.drive.model.motion import INCREMENTS_PER_REVOLUTION
from pdgw.peers.plc.exchange.cycling import CyclingPlc
from pdgw.peers.plc.exchange.position_loop import PositionLoop
from pdgw.peers.world import World
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.demo.trace import pyplot_for, save

FORMS = {"without DSC": None, "DSC, speed": "speed", "DSC, position": "position"}
"""The forms of the loop, and the key ``dsc`` of each."""
CYCLES_MS = (1.0, 2.0, 4.0)
GAINS = (10, 20, 30, 45, 70, 100, 140, 200, 300)
_NUMBER = 105
_REFERENCE_RPM = 3000.0
_STEP = 40
"""Increments: small enough that no ramp limits the speed."""
_STEP_NS, _SINE_NS, _SETTLING_NS = 500 * MS, SECOND, 250 * MS
_AMPLITUDE, _FREQUENCY = 1024, 1.0
"""Amplitude of the sine in increments, and its frequency in 1/s."""
_SETTLED = 4
"""A stable loop is within this number of increments at the end of the step."""


@dataclass(frozen=True, slots=True)
class Point:
    """Result of one loop."""

    form: str
    cycle_ms: float
    gain: float
    """1/s."""
    overshoot: float
    """Share of the step."""
    stable: bool
    """Whether the step response had ended after half a second."""
    following_error: float
    """Largest following error of the sine in increments of the shaft: target minus position at the same time."""
    samples: tuple[tuple[float, float, float], ...]
    """Samples of the sine: seconds, target, position."""


def sine(seconds: float) -> float:
    """The target of the sine, in increments from its start."""
    return _AMPLITUDE * math.sin(2 * math.pi * _FREQUENCY * seconds)


def _configuration(form: str, cycle_ms: float) -> GatewayConfig:
    return GatewayConfig.model_validate(
        {
            "can": {"interface": "virtual", "channel": "loop"},
            "transport": {"cycle_time_ms": cycle_ms, "watchdog_factor": SIMULATED_WATCHDOG_FACTOR},
            "axis": {
                "do_id": 1,
                "node_id": 1,
                "telegram": _NUMBER,
                "simulate": True,
                "dsc": FORMS[form] or "speed",
                "following_window": INCREMENTS_PER_REVOLUTION,
            },
        }
    )


class _Life:
    """A gateway, its drive and a PLC that closes the loop."""

    def __init__(self, form: str, cycle_ms: float, gain: float) -> None:
        config = _configuration(form, cycle_ms)
        self.world = World()
        self.world.simulate(config)
        self.loop = self.world.loop
        self.daemon = build_gateway(config, self.world)
        port = self.world.network.open("plc", 0, "PLC")
        self.plc = CyclingPlc(self.loop, port, self.daemon.address, [telegram(_NUMBER)], self.daemon.cycle_ns)
        drive = self.world.simulations[config.can[0].name].device(1)
        assert isinstance(drive, SimulatedDrive)
        self.drive = drive
        self.controller = PositionLoop(
            gain,
            dsc=FORMS[form] is not None,
            increments_per_revolution=INCREMENTS_PER_REVOLUTION,
            reference_rpm=_REFERENCE_RPM,
        )
        self.target: Callable[[int], float] = lambda _: 0.0
        self.positions: list[tuple[int, float, float]] = []
        """Time, target, and position of the shaft, at each frame."""

    def enable(self) -> None:
        """Send OFF, then ON, then close the loop at the present position."""
        stw1, zsw1 = signal("STW1"), signal("ZSW1")
        self.daemon.start()
        self.plc.start()
        off = stw1.word("NO_COAST_STOP", "NO_QUICK_STOP", "ENABLE_OPERATION", "CONTROL_BY_PLC")
        self.plc.set({"STW1": off})
        ready = zsw1.bit("READY_TO_SWITCH_ON").mask
        self.loop.until(lambda: (self.plc.value("ZSW1") or 0) & ready, "ready", 20 * SECOND)
        self.plc.set({"STW1": off | stw1.bit("ON").mask})
        running = zsw1.bit("OPERATION_ENABLED").mask
        self.loop.until(lambda: (self.plc.value("ZSW1") or 0) & running, "operation", 20 * SECOND)
        self.plc.before_frame.append(self._control)

    def _control(self, now: int) -> None:
        actuals = self.plc.endpoint.actuals[0]
        if actuals is None:
            return
        target = self.target(now)
        self.positions.append((now, target, self.drive.model.turned(now)))
        self.plc.set(self.controller.step(target, actuals))

    def follow(self, target: Callable[[int], float], nanoseconds: int) -> list[tuple[int, float, float]]:
        """Follow a moving target. Return the samples."""
        self.target = target
        self.positions.clear()
        self.loop.run_for(nanoseconds)
        return list(self.positions)

    def close(self) -> None:
        """Stop PLC, gateway and drive."""
        self.plc.stop()
        self.daemon.stop()
        self.loop.until(self.daemon.stopped.is_set, "the end of the gateway", 20 * SECOND)
        self.loop.close()


def point(form: str, cycle_ms: float, gain: float) -> Point:
    """Run one loop. GatewayError for an unknown form or cycle."""
    if form not in FORMS:
        raise GatewayError(f"form {form!r} does not exist, allowed: {', '.join(FORMS)}")
    life = _Life(form, cycle_ms, gain)
    try:
        life.enable()
        stepped = life.follow(lambda _: _STEP, _STEP_NS)
        begin = life.loop.now()
        swung = life.follow(lambda now: _STEP + sine((now - begin) / SECOND), _SINE_NS + _SETTLING_NS)
    finally:
        life.close()
    tail = [position for now, _, position in stepped if now >= stepped[-1][0] - _SETTLING_NS // 2]
    seen = [(now, target, position) for now, target, position in swung if now >= begin + _SETTLING_NS]
    return Point(
        form,
        cycle_ms,
        gain,
        max(0.0, max(position for _, _, position in stepped) / _STEP - 1),
        max(abs(position - _STEP) for position in tail) <= _SETTLED,
        max(abs(target - position) for _, target, position in seen),
        tuple(((now - begin) / SECOND, target - _STEP, position - _STEP) for now, target, position in seen),
    )


def study(cycles_ms: Sequence[float] = CYCLES_MS, gains: Sequence[float] = GAINS) -> Iterator[Point]:
    """Every form with every cycle time and gain. The drive's own loop ("position") has only its own gain."""
    for form, key in FORMS.items():
        for cycle_ms in cycles_ms:
            for gain in gains if key != "position" else gains[:1]:
                yield point(form, cycle_ms, gain)


def plot(points: Sequence[Point], picture: Path) -> None:
    """Plot following error and overshoot by gain. GatewayError without matplotlib, or when the file cannot be written."""
    figure, (errors, steps) = pyplot_for("the picture").subplots(1, 2, figsize=(13, 5), constrained_layout=True)
    colours = dict(
        zip(sorted({item.cycle_ms for item in points}), ("#4c78a8", "#f58518", "#54a24b", "#b279a2"), strict=False)
    )
    lines = dict(zip(FORMS, ("--o", "-s", ":"), strict=True))
    for form, line in lines.items():
        for cycle_ms, colour in colours.items():
            mine = [item for item in points if item.form == form and item.cycle_ms == cycle_ms]
            label = f"{form}, {cycle_ms:g} ms"
            if FORMS[form] == "position":
                for item in mine:
                    errors.axhline(item.following_error, color=colour, ls=":", lw=1.6, label=label)
                continue
            stable = [item for item in mine if item.stable]
            errors.plot(
                [p.gain for p in stable], [p.following_error for p in stable], line, color=colour, label=label, ms=4
            )
            steps.plot([p.gain for p in mine], [100 * p.overshoot for p in mine], line, color=colour, label=label, ms=4)
            lost = [item for item in mine if not item.stable]
            steps.plot([p.gain for p in lost], [100 * p.overshoot for p in lost], "x", color="#e45756", ms=9)
    errors.set_title(f"largest following error, sine of {_AMPLITUDE} increments at {_FREQUENCY:g} Hz", fontsize=10)
    errors.set_ylabel("increments (4096 per revolution)")
    errors.set_yscale("log")
    steps.set_title("overshoot of a step; x: not at rest after 0.5 s", fontsize=10)
    steps.set_ylabel("% of the step")
    steps.set_ylim(-5, 150)
    for panel in (errors, steps):
        panel.set_xlabel("gain KPC in 1/s")
        panel.set_xscale("log")
        panel.grid(alpha=0.3, which="both")
        if points:
            panel.legend(fontsize=7)
    save(figure, picture, "--plot", dpi=110)
