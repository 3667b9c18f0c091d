"""The log of a command in the process of a test: its handlers are removed, so that they do not affect the next test."""

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
