"""An open PROFIdrive-to-CANopen gateway. The rooms of the house are its sub-packages, see docs/architecture.md."""

from importlib.metadata import version

__version__ = version("profidrive-gateway")
