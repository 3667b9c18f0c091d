"""Values of command line options for simulated devices, for help texts without loading a simulator."""

import tomllib
from pathlib import Path
from typing import Final

ENGEL: Final = "engel"
"""The default variant of a simulated drive."""
SYNCHRONOUS: Final = "synchronous"
SHAPES_FILE: Final = Path(__file__).parent / "drive" / "model" / "shapes.toml"
SHAPES: Final = tuple(tomllib.loads(SHAPES_FILE.read_text(encoding="utf-8")))
"""The names of ``peers.drive.SHAPES`` in the same order."""
MOTIONS: Final = (
    "still[=POSITION], speed=PER_SECOND, sine=AMPLITUDE,SECONDS, csv=FILE, follow=COB_ID,BYTE,INCREMENTS, shaft=NODE_ID"
)
"""Motions that ``parse_motion`` of simulated encoders accepts."""
CONSOLE_COMMANDS: Final = (
    "fault N (1-12), fault NAME [PARAMETER=VALUE ...], clear [NAME], probe 1|2 on|off, motion MOTION [CHANNEL], faults, status, "
    "quit"
)
"""Commands of the console of simulated devices."""
BUS_PORT: Final = 34966
"""UDP port on loopback of a bus between processes."""
