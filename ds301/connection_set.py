"""The pre-defined connection set: COB-IDs of the services of CiA 301, declared once. Those of PDOs are in ``ds301.pdo``.

Source: CiA DS 301 V4.02 chapter 7.3.5. A base plus the node-ID is the COB-ID of that node's service.
"""

from __future__ import annotations

from typing import Final

NODE_IDS: Final = range(1, 128)

NMT: Final = 0x000
SYNC: Final = 0x080
EMCY: Final = 0x080
"""Base: 081h to 0FFh."""
TIME: Final = 0x100
SDO_RESPONSE: Final = 0x580
"""Base: from the server."""
SDO_REQUEST: Final = 0x600
"""Base: to the server."""
ERROR_CONTROL: Final = 0x700
"""Base: heartbeat, boot-up and node guarding."""
