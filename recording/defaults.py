"""Default values of the commands on recordings, which a help text names without loading the decoder."""

from typing import Final

from pdgw.durations import MS

TOLERANCE_NS: Final = 50 * MS
"""So far recorded times may be off in a replay: a busy machine lets a recorder or the gateway's reader wait for some cycles."""
