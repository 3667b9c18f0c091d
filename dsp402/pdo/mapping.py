"""Inputs of the PDO plan during configuration: the data sheet, and the refusals of the drive.

Source: CiA DS 301 V4.02 chapter 7.5.2.36. After each refusal, the plan is made again without the refused item.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pdgw.ds301.aborts import Abort
from pdgw.ds301.configuration import EVENT_TIMER, SdoStep
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.objects import ObjectAddress
from pdgw.ds301.pdo import COB_ID_INVALID, PdoDirection, PdoLayout, is_communication_parameter, pdo_of
from pdgw.ds301.sdo_transfer import SdoAbortedError
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.pdo.planner import Findings, Key, plan_pdos

ReadNumber = Callable[[int, int], int]
_NOT_NOW = (Abort.CANNOT_STORE, Abort.CANNOT_STORE_LOCAL_CONTROL, Abort.CANNOT_STORE_DEVICE_STATE)
"""Aborts caused by the present state of the drive; they prove nothing about its capabilities."""


class DriveMapping:
    """The findings about one drive. ``read`` reads a number by SDO."""

    def __init__(self, read: ReadNumber) -> None:
        self._read = read
        self._findings = Findings()

    def survey(self, drive: DriveType, cob_ids: Mapping[int, int]) -> None:
        """Start again with the existing PDOs. An object that was never received is still not trusted."""
        findings = self._findings = Findings(dropped=self._findings.dropped)
        for index, cob_id in cob_ids.items():
            key = pdo_of(index)
            findings.present.add(key)
            findings.cob_ids[key] = cob_id
        for direction, slots in ((PdoDirection.RPDO, drive.pdos.rpdos), (PdoDirection.TPDO, drive.pdos.tpdos)):
            for slot in slots:
                if (key := (direction, slot.number)) not in findings.present:
                    continue
                if not slot.mapping_writable:
                    findings.fixed[key] = self._mapped(key)
                if not slot.cob_id_writable:
                    valid = not findings.cob_ids[key] & COB_ID_INVALID
                    (findings.kept if valid else findings.dead).add(key)

    def plan(self, needs: PdoLayout, drive: DriveType, node_id: int, *, sync: bool, sync_rpdos: bool) -> PdoPlan:
        """As ``plan_pdos``."""
        return plan_pdos(needs, drive, node_id, self._findings, sync=sync, sync_rpdos=sync_rpdos)

    def drop(self, address: ObjectAddress) -> None:
        """An object that the drive accepts in a mapping but does not send."""
        self._findings.dropped.add(address)

    def learn(self, step: SdoStep, error: SdoAbortedError) -> bool:
        """Learn from a refused write; False if that is not new, or does not concern the drive's PDOs."""
        if error.code in _NOT_NOW:
            return False
        key = pdo_of(step.index)
        if is_communication_parameter(step.index):
            return self._learn_communication(key, step)
        return self._learn_mapping(key, step)

    def _learn_communication(self, key: Key, step: SdoStep) -> bool:
        findings = self._findings
        if step.is_cob_id:
            findings.cob_ids[key] = self._read(step.index, step.subindex)
            valid = not findings.cob_ids[key] & COB_ID_INVALID
            known = findings.kept if valid else findings.dead
            new = key not in known
            known.add(key)
        elif step.is_transmission_type:
            new = key not in findings.types
            findings.types[key] = self._read(step.index, step.subindex)
        else:
            new = step.subindex == EVENT_TIMER and key not in findings.timerless
            findings.timerless.add(key)
        return new

    def _learn_mapping(self, key: Key, step: SdoStep) -> bool:
        findings = self._findings
        if step.subindex:
            address = step.value >> 16, step.value >> 8 & 0xFF
            new = address not in findings.unmappable
            findings.unmappable.add(address)
        elif step.value > 1:
            findings.most[key] = step.value - 1
            new = True
        else:
            new = key not in findings.fixed
            findings.fixed[key] = self._mapped(key)
        return new

    def _mapped(self, key: Key) -> tuple[int, ...]:
        """The mapping of a PDO as it is."""
        direction, number = key
        index = direction.mapping_index + number - 1
        try:
            return tuple(self._read(index, subindex) for subindex in range(1, self._read(index, 0) + 1))
        except SdoAbortedError:
            return ()
