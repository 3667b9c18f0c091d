"""The timing diagram of MC_Power, MC_Home and MC_MoveAbsolute, drawn from a run that does what it shows.

``python -m tests.tools.test_plc_timing`` (make docs) writes it.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.configuration.file import simulated
from tests.support.gateways.daemon import running
from tests.support.plc.motion_blocks import Axis

PATH = Path(__file__).parents[2] / "docs" / "plc-timing.svg"
_SIGNALS = (
    *(("power", name) for name in ("Enable", "Status")),
    *((block, name) for block in ("home", "absolute") for name in ("Execute", "Busy", "Done")),
    ("position", "Position"),
)
_TITLES = {"power": "MC_Power", "home": "MC_Home", "absolute": "MC_MoveAbsolute", "position": "MC_ReadActualPosition"}
_LEFT, _WIDE, _HIGH, _ROW, _TICK_MS = 230, 620, 22, 36, 500


class Recorded(Axis):
    """An axis whose signals are recorded in each cycle."""

    samples: tuple[tuple[float, ...], ...] = ()

    def exchange(self, cycles: int = 1) -> None:
        for _ in range(cycles):
            super().exchange()
            self.samples += (tuple(float(self.at(block)[name.upper()]) for block, name in _SIGNALS),)


def picture() -> str:
    """Run the blocks with the drive of ``pdgw run --simulate``; AssertionError unless each ends with Done at its position."""
    with running(simulated([111])) as daemon:
        axis = Recorded(daemon, 111)
        axis.until(lambda _: axis.at("axis")["GOOD"], "valid actual values")
        axis.samples = ()
        axis.on()
        began = axis.loop.now()
        axis.start("home")
        axis.ends("home")
        assert axis.loop.now() - began < 2 * SECOND, "a user expects a simulated homing to end soon"
        axis.exchange(30)
        axis.start("absolute", position=0.6, velocity=60.0)
        axis.ends("absolute")
        assert axis.turns == pytest.approx(0.6, abs=0.002)
        axis.exchange(30)
        assert axis.samples[-1][-1] == pytest.approx(0.6, abs=0.002)
        axis.at("power")["ENABLE"] = False
        axis.exchange(50)
        assert not axis.at("power")["STATUS"]
        return _svg(axis.samples, daemon.cycle_ns / MS)


def _svg(samples: tuple[tuple[float, ...], ...], cycle_ms: float) -> str:
    """A step line for each signal with its greatest value, and a time scale."""
    step = _WIDE / len(samples)
    width, height = _LEFT + _WIDE + 40, len(_SIGNALS) * _ROW + 40
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="13">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]
    for row, (block, name) in enumerate(_SIGNALS):
        values = [sample[row] for sample in samples]
        base, top = (row + 1) * _ROW - 4, max(values)
        points = f"M{_LEFT},{base}"
        for place, value in enumerate(values):
            if place == 0 or value != values[place - 1]:
                points += f"H{_LEFT + place * step:.1f}V{base - value / top * _HIGH:.1f}"
        out.append(f'<text x="8" y="{base}">{_TITLES[block]}.{name}</text>')
        out.append(f'<text x="{_LEFT + _WIDE + 4}" y="{base - _HIGH + 8}" font-size="10">{top:.4g}</text>')
        out.append(f'<path d="{points}H{_LEFT + _WIDE}" fill="none" stroke="#1f4e8c" stroke-width="1.6"/>')
    for time_ms in range(0, round(len(samples) * cycle_ms), _TICK_MS):
        x = f"{_LEFT + time_ms / cycle_ms * step:.1f}"
        out.append(f'<text x="{x}" y="{height - 12}">{time_ms} ms</text>')
        out.append(f'<line x1="{x}" y1="8" x2="{x}" y2="{height - 28}" stroke="#bbb" stroke-dasharray="3 3"/>')
    return "\n".join([*out, "</svg>", ""])


def test_timing_diagram_shows_blocks_that_are_done_at_their_positions() -> None:
    assert PATH.read_text(encoding="utf-8") == picture(), "run: make docs"


if __name__ == "__main__":
    PATH.write_text(picture(), encoding="utf-8")
