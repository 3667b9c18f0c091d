"""Device descriptions: the GSDML file that is written, the data sheets (EDS, DCF) that are read.

Write the device description for engineering tools (GSDML). Show the import of data sheets (EDS, DCF) as text and JSON:
repairs, and lines that prevent the import.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from pdgw.base.phrases import counted
from pdgw.ds301.eds.importer import EdsImport, import_eds
from pdgw.ds301.eds.text import EdsError
from pdgw.gateway.axis.telegrams import ENCODER_TELEGRAM_NUMBERS, drive_telegrams
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.environment import TransportConfig
from pdgw.gateway.links.profinet.station import PRODUCT, RELEASED, VENDOR_NAME, min_device_interval, profinet_identity
from pdgw.profidrive.telegrams import TELEGRAMS, Telegram
from pdgw.profinet.gsdml import GsdmlWriter, Snmp, file_name
from pdgw.profinet.model import ObjectKind

_NO_MAC = bytes(6)


def write_gsdml(
    transport: TransportConfig, folder: Path, option: str, known: Mapping[int, Telegram] = TELEGRAMS
) -> Path:
    """Write the file to a folder. GatewayError names the ``option`` of the folder when writing fails."""
    axes = [*drive_telegrams(known.values()).values()]
    kinds = {ObjectKind.AXIS: axes, ObjectKind.ENCODER: [known[number] for number in ENCODER_TELEGRAM_NUMBERS]}
    snmp = Snmp.NONE if transport.snmp_community is None else Snmp.READ
    if transport.snmp_write_community is not None:
        snmp = Snmp.WRITE
    device, interval = profinet_identity(transport, _NO_MAC), min_device_interval(transport)
    text = GsdmlWriter(device, VENDOR_NAME, kinds, snmp=snmp, min_device_interval=interval).write()
    path = folder / file_name(VENDOR_NAME, PRODUCT, RELEASED)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise GatewayError(f"{option} {folder}: {path.name} cannot be written ({error.strerror or error})") from error
    return path


def imported(file: Path, node_id: int) -> EdsImport | EdsError:
    """Import a file; an EdsError is a result, not an exception."""
    try:
        return import_eds(file, node_id)
    except EdsError as error:
        return error


def write_repaired(path: Path, text: str) -> None:
    """Write the repaired text of a file; raises GatewayError when that fails."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise GatewayError(f"--write: {path}: {error.strerror}") from error


def import_document(file: Path, result: EdsImport | EdsError) -> dict[str, Any]:
    """Return the result of an import for JSON."""
    if isinstance(result, EdsError):
        problems = [asdict(problem) for problem in result.problems]
        return {"file": str(file), "usable": False, "objects": 0, "repairs": [], "problems": problems}
    repairs = [asdict(repair) for repair in result.repairs]
    return {"file": str(file), "usable": True, "objects": len(result.dictionary), "repairs": repairs, "problems": []}


def print_import(console: Console, file: Path, result: EdsImport | EdsError) -> None:
    """Print the result of an import with one row for each line of the file that is repaired or wrong."""
    name = escape(str(file))
    if isinstance(result, EdsError):
        console.print(
            f"[red]{name}: rejected[/red], {counted(len(result.problems), 'line')} to correct", highlight=False
        )
        rows = [(item.line, item.section, item.key, item.found, item.reason) for item in result.problems]
        console.print(_table("reason", rows))
        return
    console.print(
        f"[green]{name}: usable[/green], {counted(len(result.dictionary), 'object')}, "
        f"{counted(len(result.repairs), 'repair')}",
        highlight=False,
    )
    if result.repairs:
        rows = [(item.line, item.section, item.key, item.found, item.used or "(omitted)") for item in result.repairs]
        console.print(_table("used", rows))


def _table(last: str, rows: list[tuple[int, str, str, str, str]]) -> Table:
    table = Table("line", "section", "key", "found", last, box=None)
    for line, *texts in rows:
        table.add_row(str(line or "-"), *(escape(text) for text in texts))
    return table
