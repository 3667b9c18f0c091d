"""TCP servers of the simulators, on threads of their own."""

from __future__ import annotations

import socketserver
import time
from typing import Any

from pdgw.ds301.readiness import NO_DESCRIPTOR

_PAUSE_S = 1.0


class PatientServer(socketserver.ThreadingTCPServer):
    """A thread for each connection. When no file descriptor is left for one it pauses: the port goes on being readable."""

    allow_reuse_address = True
    daemon_threads = True

    def get_request(self) -> tuple[Any, Any]:
        """The next connection; socketserver goes on when it cannot be had."""
        try:
            return super().get_request()
        except OSError as error:
            if error.errno in NO_DESCRIPTOR:
                time.sleep(_PAUSE_S)
            raise
