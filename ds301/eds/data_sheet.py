"""The data sheet of a node: its object dictionary from an EDS or DCF, with errors a user can act on."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import canopen

from pdgw.ds301.eds.importer import import_eds
from pdgw.ds301.eds.text import EdsError
from pdgw.ds301.errors import CanopenError

log = logging.getLogger("gateway")


def load_dictionary(
    path: Path, node_id: int, needed: Sequence[int], device: str, error_type: type[CanopenError] = CanopenError
) -> canopen.ObjectDictionary:
    """The object dictionary of an EDS/DCF, its repairs logged.

    Raises ``error_type``, naming the file and what is wrong with it: not readable, not valid, or without one of the objects
    ``needed`` that make it the data sheet of ``device``.
    """
    try:
        imported = import_eds(path, node_id)
    except EdsError as error:
        raise error_type("EDS", str(path), f"a usable EDS or DCF ({error})") from error
    if imported.repairs:
        log.info("%s: %d repairs; list them with pdgw drives", path, len(imported.repairs))
    dictionary = imported.dictionary
    for index in needed:
        if index not in dictionary:
            raise error_type("EDS", str(path), f"a data sheet of {device} with object {index:04X}h")
    return dictionary
