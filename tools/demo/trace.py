"""The demo's picture: set and actual values of the three axes and the encoder with their states marked."""

from __future__ import annotations

import csv
from pathlib import Path

from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.client import TRACE_COLUMNS
from pdgw.profidrive.datatypes import N2_100_PERCENT, N4_100_PERCENT
from pdgw.profidrive.signals import signal

_SPEED_RPM = 3000
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
    figure, panels = pyplot.subplots(len(_PANELS), 1, figsize=(13, 13), sharex=True, constrained_layout=True)
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
        panel.set_ylim(low, high)
        panel.set_title(title, loc="left", fontsize=11, fontweight="bold")
        panel.set_ylabel(unit)
        panel.grid(alpha=0.3)
        panel.legend(loc="lower right", bbox_to_anchor=(1, 1), fontsize=8, ncols=4, frameon=False)
        shown = [(when, note.split(": ", 1)[1]) for when, note in notes if note.startswith(f"telegram {number}:")]
        shown += [(when, note) for when, note in notes if note.startswith("PLC")]
        for when, text in shown:
            panel.axvline(when, color="#555555", lw=0.8, ls=":")
            panel.annotate(
                text, (when, low), xytext=(3, 4), textcoords="offset points", rotation=90, fontsize=8, color="#222222"
            )
    panels[-1].set_xlabel("time in s")
    figure.suptitle("PLC -> gateway -> CANopen drives and encoder", fontsize=13)
    figure.savefig(picture, dpi=90)
    pyplot.close(figure)
