"""Asks a drive what it is, with nothing written: for commissioning, while no gateway runs on its bus.

Source: CiA 301 (SDO upload), CiA 402. Every object is one SDO upload; no NMT command, no PDO.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import can
import canopen
from canopen.sdo import SdoAbortedError, SdoCommunicationError
from pdgw.dsp402.describe import describe, questions, signed, variable
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.errors import Dsp402Error
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
    dictionary: canopen.ObjectDictionary,
    units: UnitKeys | None = None,
    family: str = "",
    timeout_s: float = 0.5,
) -> DriveType:
    """The drive at this node; Dsp402Error when none answers."""
    node = canopen.RemoteNode(node_id, dictionary)
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = timeout_s
    answers: dict[tuple[int, int], int] = {}
    try:
        for index, subindex in questions(dictionary):
            try:
                data = node.sdo.upload(index, subindex)
            except SdoAbortedError:
                continue
            declared = variable(dictionary, index, subindex)
            size = len(data) if declared is None else min(len(data), max(1, len(declared) // 8))
            answers[index, subindex] = int.from_bytes(
                data[:size], "little", signed=signed(dictionary, (index, subindex))
            )
    except SdoCommunicationError as error:
        raise Dsp402Error(f"node {node_id}", str(error), "a drive that answers SDO") from error
    finally:
        del network[node_id]
    return describe(dictionary, answers, units, family)
