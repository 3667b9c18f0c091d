"""An open PROFIdrive-to-CANopen gateway. The rooms of the house are its sub-packages, see docs/architecture.md."""

from __future__ import annotations


def __getattr__(name: str) -> str:
    """``__version__``, looked up when it is asked for: every command imports this package."""
    if name == "__version__":
        from importlib.metadata import version  # noqa: PLC0415

        return version("profidrive-gateway")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
