"""The version of the installed package."""

from __future__ import annotations

from functools import cache


@cache
def package_version() -> str:
    """From its metadata, as ``0.9.0``."""
    from importlib.metadata import version  # noqa: PLC0415 (slow to load, and the help of a command needs none)

    return version("profidrive-gateway")
