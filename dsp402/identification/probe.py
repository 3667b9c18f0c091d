"""Identify a drive by SDO uploads; nothing is written. Source: CiA 301 (SDO upload), CiA 402."""

from __future__ import annotations

import canopen

from pdgw.ds301.communication import IDENTITY_PRODUCT, IDENTITY_VENDOR
from pdgw.ds301.node.inquiry import Inquiry
from pdgw.ds301.sdo_transfer import SdoCommunicationError
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.errors import Dsp402Error
from pdgw.dsp402.identification.describe import describe, questions, signed, variable
from pdgw.dsp402.identification.generic import Read, dictionary_of
from pdgw.dsp402.units.unit_keys import UnitKeys


def probe(
    node: Inquiry, dictionary: canopen.ObjectDictionary | None, units: UnitKeys | None = None, family: str = ""
) -> DriveType:
    """The drive at this node, with its data sheet or without, in a task; Dsp402Error when none answers."""
    try:
        if dictionary is None:
            vendor, product = (node.number(*address) or 0 for address in (IDENTITY_VENDOR, IDENTITY_PRODUCT))
            dictionary = dictionary_of(node.node_id, node.fetch, vendor, product, family)
        answers = _answers(dictionary, node.fetch)
    except SdoCommunicationError as error:
        raise Dsp402Error(f"node {node.node_id}", str(error), "a drive that answers SDO") from error
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
