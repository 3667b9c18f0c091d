"""EDS and DCF files as entries for the decoder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pdgw.decoder.frames.canopen.decoder import Dictionary
from pdgw.ds301.eds.values import UNICODE_STRING
from pdgw.ds301.errors import CanopenError
from pdgw.ds301.objects import Access, CanType, Entry
from pdgw.gateway.errors import GatewayError

_TYPES = {type_.code: type_ for type_ in CanType}


def _type(code: int | None) -> CanType:
    if code is None:
        return CanType.DOMAIN
    return _TYPES.get(code, CanType.OCTET_STRING if code == UNICODE_STRING else CanType.DOMAIN)


def _entry(variable: Any) -> Entry:
    # A DCF has the configured value of this device, an EDS the default.
    value = variable.value if variable.value is not None else variable.default
    access = variable.access_type if variable.access_type in {a.value for a in Access} else Access.RW.value
    return Entry(
        variable.index, variable.subindex, variable.name, _type(variable.data_type), Access(access), default=value
    )


def entries(dictionary: Any) -> list[Entry]:
    """Every variable of one of canopen's object dictionaries."""
    found = []
    for item in dictionary.values():
        variables = item.values() if hasattr(item, "subindices") else [item]
        found += [_entry(variable) for variable in variables]
    return found


def dictionary_of(files: Mapping[int, Path], default: Path | None = None) -> Dictionary:
    """EDS/DCF files by node-ID, and one for all other nodes; each is read when its node is first seen."""

    @cache
    def of(node_id: int) -> Sequence[Entry] | None:
        path = files.get(node_id, default)
        if path is None:
            return None
        from pdgw.ds301.eds.importer import import_eds  # noqa: PLC0415 (slow to load, and needed with an EDS only)

        try:
            return entries(import_eds(path, node_id).dictionary)
        except CanopenError as error:
            raise GatewayError(f"{path}: {error}") from error

    return of
