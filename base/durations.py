"""Units of time. What counts time without a unit in its name counts nanoseconds; MS is a millisecond in them.

Every room may import it. The constants are literals, which mypyc puts where they are used.
"""

from __future__ import annotations

from typing import Final

US: Final = 1_000
MS: Final = 1_000_000
SECOND: Final = 1_000_000_000
US_PER_MS: Final = 1_000
MS_PER_SECOND: Final = 1_000
SECONDS_PER_MINUTE: Final = 60
