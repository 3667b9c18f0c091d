"""An open PROFIdrive-to-CANopen gateway.

docs/architecture.md describes the sub-packages. This module exports the names for programs; each is loaded on first use.
"""

from __future__ import annotations

TYPE_CHECKING = False  # as in typing, without importing it: Ctrl-C during that import would print a traceback
if TYPE_CHECKING:
    from typing import Any

    from pdgw.base.errors import PdgwError
    from pdgw.ds301.aborts import CanopenError
    from pdgw.ds301.eds.importer import import_eds
    from pdgw.dsp402.identification.overlay import add_family
    from pdgw.gateway.axis.telegrams import add_telegram
    from pdgw.gateway.base.errors import GatewayError
    from pdgw.gateway.client.session import read_parameters
    from pdgw.gateway.configuration.config import GatewayConfig
    from pdgw.gateway.configuration.file import load_config, parse_config
    from pdgw.gateway.daemon.assembly import build_gateway
    from pdgw.gateway.daemon.daemon import Daemon
    from pdgw.peers.world import Gateway, Plc, SimulatedDevice, World
    from pdgw.profidrive.errors import ProfidriveError
    from pdgw.profidrive.signals import Signal, signal
    from pdgw.profidrive.telegrams import Telegram, telegram
    from pdgw.tools.decoder.capture.source import read_records
    from pdgw.tools.decoder.export.archive import read_table
    from pdgw.tools.decoder.frames.recognise import recognise
    from pdgw.tools.decoder.frames.records import Record

    __version__: str

__all__ = [
    "CanopenError",
    "Daemon",
    "Gateway",
    "GatewayConfig",
    "GatewayError",
    "PdgwError",
    "Plc",
    "ProfidriveError",
    "Record",
    "Signal",
    "SimulatedDevice",
    "Telegram",
    "World",
    "__version__",
    "add_family",
    "add_telegram",
    "build_gateway",
    "import_eds",
    "load_config",
    "parse_config",
    "read_parameters",
    "read_records",
    "read_table",
    "recognise",
    "signal",
    "telegram",
]

_ROOMS = {
    "CanopenError": "ds301.aborts",
    "Daemon": "gateway.daemon.daemon",
    "Gateway": "peers.world",
    "GatewayConfig": "gateway.configuration.config",
    "GatewayError": "gateway.base.errors",
    "PdgwError": "base.errors",
    "Plc": "peers.world",
    "ProfidriveError": "profidrive.errors",
    "Record": "tools.decoder.frames.records",
    "Signal": "profidrive.signals",
    "SimulatedDevice": "peers.world",
    "Telegram": "profidrive.telegrams",
    "World": "peers.world",
    "add_family": "dsp402.identification.overlay",
    "add_telegram": "gateway.axis.telegrams",
    "build_gateway": "gateway.daemon.assembly",
    "import_eds": "ds301.eds.importer",
    "load_config": "gateway.configuration.file",
    "parse_config": "gateway.configuration.file",
    "read_parameters": "gateway.client.session",
    "read_records": "tools.decoder.capture.source",
    "read_table": "tools.decoder.export.archive",
    "recognise": "tools.decoder.frames.recognise",
    "signal": "profidrive.signals",
    "telegram": "profidrive.telegrams",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from pdgw.base.version import package_version  # noqa: PLC0415

        found: Any = package_version()
    elif name in _ROOMS:
        from importlib import import_module  # noqa: PLC0415

        found = getattr(import_module(f"pdgw.{_ROOMS[name]}"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
