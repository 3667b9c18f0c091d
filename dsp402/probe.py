"""Asks a drive what it is, with nothing written: for commissioning, while no gateway runs on its bus.

Source: CiA 301 (SDO upload), CiA 402. Every object is one SDO upload; no NMT command, no PDO.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import can
import canopen
from canopen.sdo import SdoAbortedError, SdoCommunicationError

from pdgw.dsp402.describe import PRODUCT_CODE, VENDOR_ID, describe, questions, signed, variable
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.errors import Dsp402Error
from pdgw.dsp402.generic import NOT_THERE, Read, dictionary_of
from pdgw.dsp402.scaling import UnitKeys


@contextmanager
def probing(bus: can.BusABC) -> Iterator[canopen.Network]:
    """A network that reads from this bus until the end of the block, and shuts the bus down."""
    network = canopen.Network(bus)
    network.connect()
    try:
        yield network
    finally:
        network.disconnect()


def probe(
    network: canopen.Network,
    node_id: int,
    dictionary: canopen.ObjectDictionary | None,
    units: UnitKeys | None = None,
    family: str = "",
    timeout_s: float = 0.5,
) -> DriveType:
    """The drive at this node, with its data sheet or without; Dsp402Error when none answers."""
    node = canopen.RemoteNode(node_id, canopen.ObjectDictionary())
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = timeout_s

    def read(index: int, subindex: int) -> bytes | None:
        try:
            data: bytes = node.sdo.upload(index, subindex)
        except SdoAbortedError as error:
            return None if error.code in NOT_THERE else b""
        return data

    try:
        if dictionary is None:
            vendor, product = (int.from_bytes(read(*address) or b"", "little") for address in (VENDOR_ID, PRODUCT_CODE))
            dictionary = dictionary_of(node_id, read, vendor, product, family)
        answers = _answers(dictionary, read)
    except SdoCommunicationError as error:
        raise Dsp402Error(f"node {node_id}", str(error), "a drive that answers SDO") from error
    finally:
        del network[node_id]
    return describe(dictionary, answers, units, family)


def _answers(dictionary: canopen.ObjectDictionary, read: Read) -> dict[tuple[int, int], int]:
    answers = {}
    for index, subindex in questions(dictionary):
        data = read(index, subindex)
        declared = variable(dictionary, index, subindex)
        if data and declared is not None:
            data = data[: max(1, len(declared) // 8)]
            answers[index, subindex] = int.from_bytes(data, "little", signed=signed(dictionary, (index, subindex)))
    return answers
