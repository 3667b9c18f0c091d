"""The demo's picture: set and actual values of the three axes and the encoder with their states marked."""

from __future__ import annotations

import csv
from pathlib import Path

from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.client import TRACE_COLUMNS
from pdgw.profidrive.datatypes import N2_100_PERCENT, N4_100_PERCENT
from pdgw.profidrive.signals import signal

_SPEED_RPM = 3000
_SEEN_S = 0.08
_POSITION = 500_000
_RPM_PER_UNIT = 0.5
_ZSW1 = signal("ZSW1")
_RED, _GREEN = "#e45756", "#72b7b2"
_STATES = (("fault", _ZSW1.bit("FAULT").mask, _RED), ("operation", _ZSW1.bit("OPERATION_ENABLED").mask, _GREEN))
_ENCODER_STATES = (("fault", signal("ZSW2_ENC").bit("FAULT").mask, _RED),)
_PANELS = {
    1: ("Telegram 1: speed", "rpm", _SPEED_RPM / N2_100_PERCENT, "NSOLL_A", "NIST_A", _STATES),
    9: ("Telegram 9: position", "increments", _POSITION / N4_100_PERCENT, "MDI_TARPOS", "XIST_A", _STATES),
    100: ("Telegram 100: speed", "rpm", _RPM_PER_UNIT, "Target Velocity", "Velocity Actual Value", _STATES),
    83: (
        "Telegram 83: speed of the encoder on axis 1",
        "rpm",
        _SPEED_RPM / N4_100_PERCENT,
        "",
        "NIST_B",
        _ENCODER_STATES,
    ),
}
"""In the order of the axes: title, unit, scale, set value (none for an encoder), actual value, bits of the status word."""


def _faults(rows: list[dict[str, float]], states: tuple[tuple[str, int, str], ...]) -> list[tuple[float, float]]:
    """From when to when the status word shows a fault."""
    mask = next(mask for name, mask, _ in states if name == "fault")
    spans: list[tuple[float, float]] = []
    before = False
    for row in rows:
        faulty = bool(int(row["status"]) & mask)
        if faulty:
            spans[-1:] = [(spans[-1][0], row["time_s"])] if before else [*spans[-1:], (row["time_s"], row["time_s"])]
        before = faulty
    return spans


def plot(trace: Path, notes: list[tuple[float, str]], picture: Path) -> None:
    """Draw ``trace.csv``; GatewayError when matplotlib is not installed."""
    try:
        import matplotlib as mpl  # noqa: PLC0415

        mpl.use("Agg")
        from matplotlib import pyplot  # noqa: PLC0415
    except ImportError as error:
        raise GatewayError("the picture needs matplotlib: pip install 'profidrive-gateway[plot]'") from error
    with trace.open(encoding="utf-8") as file:
        rows = [dict(zip(TRACE_COLUMNS, map(float, row), strict=True)) for row in list(csv.reader(file))[1:]]
    figure, panels = pyplot.subplots(len(_PANELS), 1, figsize=(15, 14), sharex=True, constrained_layout=True)
    for axis, (panel, number) in enumerate(zip(panels, _PANELS, strict=True), 1):
        title, unit, scale, demand, actual, states = _PANELS[number]
        mine = [row for row in rows if row["axis"] == axis]
        times = [row["time_s"] for row in mine]
        if demand:
            panel.step(
                times, [row["setpoint"] * scale for row in mine], where="post", color="#f58518", lw=1.2, label=demand
            )
        panel.plot(times, [row["actual"] * scale for row in mine], color="#4c78a8", lw=1.6, label=actual)
        low, high = panel.get_ylim()
        for name, mask, colour in states:
            on = [bool(int(row["status"]) & mask) for row in mine]
            panel.fill_between(times, low, high, where=on, color=colour, alpha=0.16, lw=0, label=name, step="post")
        for begin, end in _faults(mine, states):
            # A fault that is acknowledged at once is to be seen too.
            panel.axvspan(begin, max(end, begin + _SEEN_S), color=_RED, alpha=0.35, lw=1)
        panel.set_ylim(low, high)
        panel.set_title(title, loc="left", fontsize=11, fontweight="bold", pad=24)
        panel.set_ylabel(unit)
        panel.grid(alpha=0.3)
        panel.legend(loc="upper left", bbox_to_anchor=(1.005, 1.0), fontsize=8, frameon=False)
        shown = [(when, note.split(": ", 1)[1]) for when, note in notes if note.startswith(f"telegram {number}:")]
        shown += [(when, note) for when, note in notes if note.startswith("PLC")]
        # Numbers above the panel, their texts beside it: nothing lies on a curve.
        for place, (when, _) in enumerate(sorted(shown), 1):
            panel.axvline(when, color="#555555", lw=0.8, ls=":")
            panel.annotate(
                str(place),
                (when, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(0, 3 + 7 * (place % 2)),
                textcoords="offset points",
                ha="center",
                fontsize=7,
                color="#222222",
            )
        texts = "\n".join(f"{place}  {text}" for place, (_, text) in enumerate(sorted(shown), 1))
        panel.text(1.01, 0.55, texts, transform=panel.transAxes, va="top", fontsize=7, color="#222222")
    panels[-1].set_xlabel("time in s")
    figure.suptitle("PLC -> gateway -> CANopen drives and encoder", fontsize=13)
    figure.savefig(picture, dpi=90)
    pyplot.close(figure)
