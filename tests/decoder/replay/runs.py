"""What a gateway and a PLC do in the recordings that are replayed, and the kept ones: recorded by the version that wrote them.

``python -m tests.decoder.replay.runs`` records all of them again with this version. Do so only for an intended change of the axis
machine, after you have read the differences. With names it records only these.
"""

from __future__ import annotations

import lzma
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from tests.support.gateways.daemon import OFF, ON, SIMULATED_POSITIONER, Plc, axis, configuration, drive_of, encoder_of
from tests.support.gateways.recorded_daemon import recorded, recording

COAST, QUICK_STOP = ON & ~2, ON & ~4
KEPT = Path(__file__).parent / "kept"
ENCODER = "[[encoder]]\ndo_id = 9\nnode_id = 20\ntelegram = 83\nsimulate = true\n"
TASK = {"SATZANW": 0x8000, "MDI_TARPOS": 0x0200_0000, "MDI_VELOCITY": 1 << 29, "MDI_ACC": 0x4000, "MDI_DEC": 0x2000}


def speeds(plc: Plc) -> None:
    """ON without OFF, operation, a loss of the PLC, a fault, OFF1; after OFF2 and OFF3 an ON that was not taken back."""
    plc.endpoint.set(0, {"STW1": ON})
    plc.exchange(120)
    for word in (COAST, QUICK_STOP):
        plc.enable()
        plc.endpoint.set(0, {"STW1": word})
        plc.exchange(20)
        plc.endpoint.set(0, {"STW1": ON})
        plc.exchange(20)
    plc.enable()
    plc.endpoint.set(0, {"NSOLL_A" if plc.daemon.axes[0].telegram.number == 1 else "NSOLL_B": 0x1000})
    plc.exchange(60)
    plc.silent = True
    plc.exchange(120)
    plc.silent = False
    plc.enable()
    drive_of(plc.daemon).inject(7)
    plc.exchange(60)
    drive_of(plc.daemon).clear()
    plc.endpoint.set(0, {"STW1": OFF | 0x80})
    plc.exchange(20)
    plc.enable()
    plc.endpoint.set(0, {"STW1": OFF})
    plc.exchange(60)


def tasks(plc: Plc) -> None:
    """Homing, a task, an intermediate stop, a rejected task."""
    plc.endpoint.set(0, {"STW1": 0x043E})
    plc.exchange(150)
    plc.endpoint.set(0, {"STW1": 0x043F, "SATZANW": 0x8000 | 35})
    plc.exchange(50)
    for word, more in (
        (0x0C3F, {}),
        (0x043F, {}),
        (0x047F, TASK | {"MDI_MOD": 1}),
        (0x045F, {}),
        (0x047F, {}),
        (0x046F, {}),
    ):
        plc.endpoint.set(0, {"STW1": word, **more})
        plc.exchange(60)


def jogs(plc: Plc) -> None:
    """A positioner homes at its position, jogs and is switched off."""
    plc.enable()
    for word in (ON | 1 << 8, ON, ON & ~2):
        plc.endpoint.set(0, {"STW1": word})
        plc.exchange(100)


def raw(plc: Plc) -> None:
    """The Controlword itself."""
    plc.exchange(150)
    for word in (0, 6, 7, 15):
        plc.endpoint.set(0, {"Controlword": word, "Modes of Operation": 3, "Target Velocity": 2000})
        plc.exchange(30)


def another_telegram(plc: Plc) -> None:
    """P922 while the axis is off."""
    plc.exchange(150)
    plc.daemon.change_telegram(plc.daemon.axes[0], 2)
    other = Plc(plc.daemon, [2], host="plc")
    other.enable()
    other.endpoint.set(0, {"NSOLL_B": 0x1000_0000})
    other.exchange(60)


def presets(plc: Plc) -> None:
    """An encoder turns and takes a preset."""
    plc.exchange(150)
    plc.endpoint.set(0, {"STW2_ENC": 0x0400, "G1_STW": 0})
    plc.exchange(20)
    plc.endpoint.set(0, {"G1_STW": 1 << 12})
    plc.exchange(60)
    encoder_of(plc.daemon).node.restart()
    plc.exchange(100)


def silent_drive(plc: Plc) -> None:
    """STW1.3 changes twice while the drive shows nothing of it; then the drive is lost and found again while ON stays."""
    drive = drive_of(plc.daemon)
    plc.enable()
    for words, cycles in (((ON & ~8, ON), 5), ((ON,), 80)):
        drive.do(lambda node: node.start_fault("lost-pdos", every=1))
        for word in words:
            plc.endpoint.set(0, {"STW1": word})
            plc.exchange(cycles)
        drive.do(lambda node: node.end_fault())
        plc.exchange(40)
    plc.enable()
    plc.endpoint.set(0, {"STW1": OFF})
    plc.exchange(20)


RUNS: dict[str, tuple[str, Callable[[Plc], None]]] = {
    "telegram 1": (axis(1), speeds),
    "telegram 3": (axis(1, telegram_number=3), speeds),
    "silent drive": (axis(1), silent_drive),
    "telegram 102": (axis(1, telegram_number=102), speeds),
    "telegram 9": (axis(1, telegram_number=9), tasks),
    "telegram 100": (axis(1, telegram_number=100), raw),
    "telegram 111": (axis(1, telegram_number=111, more=SIMULATED_POSITIONER), jogs),
    "P922": (axis(1), another_telegram),
    "encoder": (ENCODER, presets),
    "encoder as G1": (axis(1, telegram_number=3, more="simulate = true\ng1 = 9") + ENCODER, speeds),
    "two axes": (axis(1) + axis(2, telegram_number=3), speeds),
}


def kept(name: str) -> Path:
    """The file of a run."""
    return KEPT / f"{name.replace(' ', '-')}.pcapng.xz"


def keep(name: str) -> None:
    """Record a run, and replace its kept recording."""
    tables, happens = RUNS[name]
    with tempfile.TemporaryDirectory() as folder:
        with recorded(configuration(tables), Path(folder)) as plc:
            happens(plc)
        data = Path(recording(Path(folder))).read_bytes()
    kept(name).write_bytes(lzma.compress(data, preset=9))


if __name__ == "__main__":
    for chosen in sys.argv[1:] or RUNS:
        keep(chosen)
