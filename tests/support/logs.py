"""The log of a command in the process of a test: its handlers are removed, so that they do not affect the next test."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def log_put_back() -> Iterator[None]:
    """Afterwards the loggers that commands and gateways change are as they were: handlers of the root, levels, no filter."""
    root = logging.getLogger()
    handlers = list(root.handlers)
    levels = [(logger, logger.level) for logger in (root, logging.getLogger("gateway"), logging.getLogger("canopen"))]
    try:
        yield
    finally:
        root.handlers[:] = handlers
        logging.getLogger("gateway").filters.clear()
        for logger, level in levels:
            logger.setLevel(level)
