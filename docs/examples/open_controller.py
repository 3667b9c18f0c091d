"""Turn an axis from an open PROFINET controller of others: profinet-py (``pip install profinet-py``, GPL).

    python open_controller.py eth0 press-1 GSDML-V2.4-....xml

As root or with CAP_NET_RAW. Slot 1 of the project is an axis with telegram 1, as the GSDML file describes it; the station has its
IP address already (``ip`` of ``[transport]``).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from profinet import IOCRSetup, IOSlot, ProfinetDevice
from profinet.gsdml import load_gsdml

AXIS = (1, 2)
OFF, ON = 0x047E, 0x047F
SPEED = 0x1000
"""NSOLL_A: 4000h is 100 %."""
READY, OPERATION, FAULT = 0x4F, 0x07, 0x08
CYCLE_MS = 16
HOLD_CYCLES = 100
"""Python on a usual system: a frame may be late."""
DISCOVERY_S = 2
PATIENCE_S = 30


def main(interface: str, station: str, gsdml: str) -> None:
    """Connect, enable, turn at 25 % for a moment, stop."""
    catalogue = load_gsdml(gsdml)
    axis, chosen = catalogue.modules["MODULE_AXIS"], catalogue.submodule_catalog["TELEGRAM_1"]
    # The head module and the axis in slot 1 with its access point (subslot 1); the telegram is plugged in subslot 2.
    slots = catalogue.build_io_slots({1: axis.id})
    slots.append(
        IOSlot(
            *AXIS,
            input_length=chosen.input_length,
            output_length=chosen.output_length,
            module_ident=axis.module_ident,
            submodule_ident=chosen.submodule_ident,
            api=chosen.api,
        )
    )
    setup = IOCRSetup(slots=slots, reduction_ratio=CYCLE_MS, watchdog_factor=HOLD_CYCLES, data_hold_factor=HOLD_CYCLES)
    with ProfinetDevice.discover(station, interface, timeout=DISCOVERY_S) as device:
        print(f"{device.name} at {device.ip}")
        exchange = device.start_cyclic(setup)

        def set_points(word: int, speed: int = 0) -> None:
            exchange.set_output_data(*AXIS, word.to_bytes(2, "big") + speed.to_bytes(2, "big", signed=True))

        def actual() -> tuple[int, int]:
            """ZSW1 and NIST_A."""
            data = exchange.get_input_data(*AXIS) or bytes(4)
            return int.from_bytes(data[:2], "big"), int.from_bytes(data[2:4], "big", signed=True)

        def wait(what: str, condition: Callable[[int, int], bool]) -> None:
            end = time.monotonic() + PATIENCE_S
            while not condition(*actual()):
                if time.monotonic() > end:
                    raise SystemExit(f"not {what}: ZSW1 {actual()[0]:04X}h")
                time.sleep(CYCLE_MS / 1000)
            word, speed = actual()
            print(f"{what}: ZSW1 {word:04X}h, NIST_A {speed / 0x4000:.1%}")

        set_points(OFF)
        wait("ready to switch on", lambda word, speed: word & READY == 0x01)
        set_points(ON, SPEED)
        wait("in operation", lambda word, speed: word & READY == OPERATION)
        wait("turns at 25 %", lambda word, speed: abs(speed - SPEED) < SPEED // 50)
        set_points(OFF)
        wait("stands", lambda word, speed: word & READY == 0x01 and abs(speed) < SPEED // 50)
        exchange.stop()


if __name__ == "__main__":
    main(*sys.argv[1:4])
