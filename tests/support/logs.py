"""The log of a ``pdgw run`` in a test's own process: what it sets up is taken back, or other tests hear no warnings any more."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def log_put_back() -> Iterator[None]:
    """Afterwards the loggers a RunLog changes are as they were: handlers and level of the root, the levels of others."""
    root = logging.getLogger()
    handlers = list(root.handlers)
    levels = [(logger, logger.level) for logger in (root, logging.getLogger("gateway"), logging.getLogger("canopen"))]
    try:
        yield
    finally:
        root.handlers[:] = handlers
        for logger, level in levels:
            logger.setLevel(level)
