"""Default values of the commands on recordings, which a help text names without loading the decoder."""

from typing import Final

from pdgw.durations import MS

TOLERANCE_NS: Final = 50 * MS
"""Tolerance of recorded times in a replay: a busy machine delays a recorder or the gateway's reader by some cycles."""
