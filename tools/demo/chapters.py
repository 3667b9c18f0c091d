"""The chapters of the demo: axes, devices, scenario, and the plotted signals.

A new chapter is an entry of ``CHAPTERS`` and a scenario file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from pdgw.gateway.configuration.defaults import SIMULATED_BLOCKS, SIMULATED_KEYS
from pdgw.peers.option_values import ENGEL, SYNCHRONOUS
from pdgw.profidrive.datatypes import N2_100_PERCENT, N4_100_PERCENT

_SCENARIOS = Path(__file__).parent.parent / "scenarios"
_RPM, _POSITION = 3000, 500_000
"""100 % of the speeds (rpm) and of telegram 9's positions, as in the scenarios."""
_RPM_PER_UNIT = 0.5
_I32: Final = 1 << 31
_PATIENT_CYCLES, _PATIENT_PERIODS = 250, 750
"""Watchdogs: of the gateway in cycles, of the drives in SYNC periods. They tolerate a pause of a second on a busy machine;
SYNC crosses one more process.
"""
_HEARTBEAT_MS, _SDO_MS, _TPDO_MS, _ENCODER_MS = 2000, 5000, 2000, 20

Values = Mapping[str, int]
"""Newest setpoints and actual values of an axis, by name."""


@dataclass(frozen=True)
class Curve:
    """A value over time, in the unit of its panel."""

    label: str
    value: Callable[[Values], float]
    setpoint: bool = False
    """A setpoint, drawn in steps."""


@dataclass(frozen=True)
class Panel:
    """A plot of one axis. ``notes``: prefix of the notes that belong to it."""

    title: str
    unit: str
    axis: int
    curves: tuple[Curve, ...]
    notes: str


def _panel(telegram: int, what: str, unit: str, axis: int, *curves: Curve) -> Panel:
    return Panel(f"Telegram {telegram}: {what}", unit, axis, curves, f"telegram {telegram}")


def _scaled(name: str, scale: float = 1.0, *, setpoint: bool = False) -> Curve:
    return Curve(name, lambda values: values[name] * scale, setpoint)


@dataclass(frozen=True)
class Chapter:
    """A scenario with its own gateway. ``axes``: further keys of each [[axis]]. The encoders are on the shaft of node 1."""

    name: str
    about: str
    scenario: Path
    axes: tuple[Mapping[str, Any], ...]
    panels: tuple[Panel, ...]
    encoders: tuple[int, ...] = ()
    cycle_ms: int = 8
    like: str = ENGEL
    blocks: Sequence[Mapping[str, Any]] = field(default=())

    def gateway(
        self, can: Mapping[str, Any], transport: Mapping[str, Any], *, simulate: bool = False
    ) -> dict[str, Any]:
        """The tables of the gateway's configuration. Its timeouts tolerate pauses of a busy machine."""
        times = {"status_port": 0, "cycle_time_ms": self.cycle_ms, "watchdog_factor": _PATIENT_CYCLES}
        more = {"simulate": simulate, "block": self.blocks}
        axes = [
            {"do_id": number, "node_id": number, **_times(_TPDO_MS), **keys, **more}
            for number, keys in enumerate(self.axes, 1)
        ]
        encoders = [
            {"do_id": number, "node_id": number, "telegram": telegram, **_times(_ENCODER_MS), "simulate": simulate}
            for number, telegram in enumerate(self.encoders, len(axes) + 1)
        ]
        return {"can": can, "transport": {**transport, **times}, "axis": axes, "encoder": encoders}

    def devices(self, can: Mapping[str, Any], control_port: int) -> dict[str, Any]:
        """The tables of the devices for ``pdgw sim bus``."""
        drive = {"type": "drive", "axis": "linear", "like": self.like, "sync_tolerance": _PATIENT_PERIODS}
        found = [{"node_id": number, **drive} for number in range(1, len(self.axes) + 1)]
        first = len(self.axes) + 1
        found += [{"node_id": first + n, "type": "encoder", "motion": "shaft=1"} for n in range(len(self.encoders))]
        return {"can": can, "control": {"port": control_port}, "device": found}


def _times(tpdo_ms: int) -> dict[str, int]:
    return {"heartbeat_ms": _HEARTBEAT_MS, "sdo_timeout_ms": _SDO_MS, "tpdo_event_ms": tpdo_ms}


def _wide(position: int) -> int:
    """Convert an UNSIGNED32 of the telegram to a signed position."""
    return position - 2 * _I32 if position >= _I32 else position


_N2, _N4, _P4 = _RPM / N2_100_PERCENT, _RPM / N4_100_PERCENT, _POSITION / N4_100_PERCENT

CHAPTERS: Final[Mapping[str, Chapter]] = {
    chapter.name: chapter
    for chapter in (
        Chapter(
            "basics",
            "telegrams 1, 9 and 100, an encoder with 83, parameters",
            _SCENARIOS / "demo.yaml",
            ({"telegram": 1}, {"telegram": 9}, {"telegram": 100}),
            (
                _panel(1, "speed", "rpm", 1, _scaled("NSOLL_A", _N2, setpoint=True), _scaled("NIST_A", _N2)),
                _panel(
                    9, "position", "increments", 2, _scaled("MDI_TARPOS", _P4, setpoint=True), _scaled("XIST_A", _P4)
                ),
                _panel(
                    *(100, "speed", "rpm", 3, _scaled("Target Velocity", _RPM_PER_UNIT, setpoint=True)),
                    _scaled("Velocity Actual Value", _RPM_PER_UNIT),
                ),
                _panel(83, "speed of the encoder on axis 1", "rpm", 4, _scaled("NIST_B", _N4)),
            ),
            encoders=(83,),
        ),
        Chapter(
            "positioner",
            "telegram 111: jog, homing, MDI with continuous update, override, traversing blocks, software limit",
            _SCENARIOS / "demo-positioner.yaml",
            ({"telegram": 111, "positioner": {**SIMULATED_KEYS, "software_limits": [-20_000, 90_000]}},),
            (
                _panel(111, "position", "LU", 1, _scaled("MDI_TARPOS", setpoint=True), _scaled("XIST_A")),
                _panel(111, "speed", "rpm", 1, _scaled("NIST_B", _N4)),
                _panel(
                    *(111, "override and active block", "", 1),
                    Curve("OVERRIDE in 10 %", lambda values: values["OVERRIDE"] * 10 / N2_100_PERCENT, True),
                    Curve("POS_ZSW1.BLOCK", lambda values: values["POS_ZSW1"] & 0x7F, True),
                ),
            ),
            like=SYNCHRONOUS,
            blocks=SIMULATED_BLOCKS,
        ),
        Chapter(
            "dsc",
            "telegram 105: the PLC follows a sine, without DSC and with it",
            _SCENARIOS / "demo-dsc.yaml",
            ({"telegram": 105, "dsc": "position", "following_window": 4096},),
            (
                _panel(
                    *(105, "position", "increments", 1),
                    Curve("target (G1_XIST1 + XERR)", lambda v: _wide(v["G1_XIST1"]) + v["XERR"], True),
                    Curve("G1_XIST1", lambda v: _wide(v["G1_XIST1"])),
                ),
                _panel(105, "position error as the PLC sees it", "increments", 1, _scaled("XERR")),
                _panel(105, "speed", "rpm", 1, _scaled("NSOLL_B", _N4, setpoint=True), _scaled("NIST_B", _N4)),
            ),
            cycle_ms=4,
            like=SYNCHRONOUS,
        ),
    )
}
