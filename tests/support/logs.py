"""The log of a command in a test's own process: what it sets up is taken back, or the next test hears none, or too much."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def log_put_back() -> Iterator[None]:
    """Afterwards the loggers that commands change are as they were: handlers and level of the root, the levels of others."""
    root = logging.getLogger()
    handlers = list(root.handlers)
    levels = [(logger, logger.level) for logger in (root, logging.getLogger("gateway"), logging.getLogger("canopen"))]
    try:
        yield
    finally:
        root.handlers[:] = handlers
        for logger, level in levels:
            logger.setLevel(level)
