"""Values of command line options for simulated devices, which a help text names without loading a simulator."""

from typing import Final

ENGEL: Final = "engel"
"""The shape of a simulated drive where no other one is given."""
SYNCHRONOUS: Final = "synchronous"
SHAPES: Final = (
    ENGEL,
    SYNCHRONOUS,
    "rpm",
    "counts",
    "si",
    "fixed-pdo",
    "no-event-timer",
    "vl",
    "csv",
    "csp",
    "node-guarding",
    "rpdo-timeout",
    "unguarded",
    "no-abort-option",
    "mode-late",
    "frozen",
    "two-edges",
    "stays-stopped",
    "slow-sdo",
    "four-pdo",
    "no-range",
    "slow-boot",
)
"""The names of ``peers.drive.SHAPES``, in its order."""
MOTIONS: Final = (
    "still[=POSITION], speed=PER_SECOND, sine=AMPLITUDE,SECONDS, csv=FILE, follow=COB_ID,BYTE,INCREMENTS, shaft=NODE_ID"
)
"""What ``parse_motion`` of simulated encoders takes."""
CONSOLE_COMMANDS: Final = (
    "fault N (1-12), fault NAME [PARAMETER=VALUE ...], clear [NAME], di1 on|off, probe 1|2 on|off, motion MOTION [CHANNEL], "
    "faults, status, quit"
)
"""What the console of simulated devices takes."""
BUS_PORT: Final = 34966
"""UDP on loopback: a bus between processes."""
