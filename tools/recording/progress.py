"""A progress bar beside long output: on the terminal, while the output itself goes elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Final, TypeVar

PROGRESS_FROM: Final = 4 << 20
"""Bytes of a file that deserves a progress bar."""
_EVERY: Final = 5000
_SEVERAL: Final = 2

T = TypeVar("T")


def with_progress_of(items: Iterator[T], title: str, count: int) -> Iterator[T]:
    """The items, with a bar that counts them."""
    if count < _SEVERAL or not sys.stderr.isatty():
        return items
    from rich.console import Console  # noqa: PLC0415 (slow to load)
    from rich.progress import track  # noqa: PLC0415

    return iter(track(items, title, count, console=Console(stderr=True), transient=True))


def with_progress(items: Iterator[T], title: str, size: int | None, position: Callable[[], int]) -> Iterator[T]:
    """The items with a progress bar: ``size`` is the number of bytes (None: unknown), ``position`` the bytes that were read."""
    if size is None or size < PROGRESS_FROM or not sys.stderr.isatty() or sys.stdout.isatty():
        yield from items
        return
    from rich.console import Console  # noqa: PLC0415 (slow to load)
    from rich.progress import Progress  # noqa: PLC0415

    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(title, total=size)
        for number, item in enumerate(items):
            if number % _EVERY == 0:
                progress.update(task, completed=position())
            yield item
