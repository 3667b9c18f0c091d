"""Check a node and write a configuration into it, step by step, in its task.

Source: CiA DS 301 V4.02 chapter 7.5.2.36. A parameter that cannot be written but already has the requested value is accepted.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

import canopen

from pdgw.ds301.aborts import NOT_THERE, Abort, CanopenError, SdoAbortedError, abort_text
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import IDENTITY, SYNC_COB_ID, SYNC_COUNTER, SYNC_PERIOD, SYNC_PRODUCER, profile_of
from pdgw.ds301.configuration import EVENT_DRIVEN_PROFILE, SdoStep, has_effect
from pdgw.ds301.node.node import Cause
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.node.sdo import SdoAccess
from pdgw.ds301.objects import CanType
from pdgw.ds301.pdo import Pdo, PdoDirection, direction_of, is_communication_parameter

_SHEET: Final = Cause("the EDS")


@dataclass(frozen=True, slots=True)
class DeviceKind:
    """The device profile of a node: ``name`` and ``a_name`` for messages (``drive``, ``a drive``), number of 1000h, and error."""

    name: str
    a_name: str
    profile: int
    error_type: type[CanopenError]


class ConfiguringAccess(SdoAccess):
    """SDO access that writes ``SdoStep``s."""

    def __init__(
        self, network: CanNetwork, node_id: int, dictionary: canopen.ObjectDictionary, kind: DeviceKind
    ) -> None:
        super().__init__(network, node_id, dictionary, kind.error_type)
        self.kind = kind
        self.expected = 0
        """Number of accesses that the present bring-up probably needs."""
        self.had_sync = False
        """The node sends SYNC after its boot-up (1005h bit 30), until it is configured."""

    @property
    def progress(self) -> str:
        """How far the present bring-up is."""
        return f"object {self.asked:04X}h, {self.accesses} of about {max(self.accesses, self.expected)}"

    def check_identity(self, device_type: int, device: tuple[int, int] = (0, 0), sheet: Cause = _SHEET) -> None:
        """Compare device type (1000h), vendor and product with profile and EDS; the package's error names a difference.

        A device need not have a product code. ``device``: vendor-ID and product code if they were read already, else 0.
        ``sheet``: name of the EDS for people, and what to do if it is another device's.
        """
        name = f"node {self._node_id} device type 1000h"
        if profile_of(device_type) != self.kind.profile:
            raise self.error_type(
                name, f"profile {profile_of(device_type)}", f"{self.kind.a_name} (profile {self.kind.profile})"
            )
        information = self.dictionary.device_information
        for what, subindex, expected in (
            ("vendor-ID 1018h/1", 1, information.vendor_number),
            ("product code 1018h/2", 2, information.product_number),
        ):
            if not expected:
                continue
            optional = subindex > 1
            read = self.read_optional if optional else self.require
            found = device[subindex - 1] or read(IDENTITY, subindex)
            if found != expected and (found or not optional):
                raise self.error_type(
                    f"node {self._node_id} {what}",
                    f"{found:08X}h",
                    f"{expected:08X}h, as in {sheet.evidence}",
                    sheet.remedy,
                )

    def do(self, step: SdoStep) -> None:
        """Write a step; the package's error when the node rejects it."""
        try:
            self.write_repeatedly(step.index, step.subindex, step.data)
        except SdoAbortedError as error:
            if step.optional or self._is_as_required(step):
                return
            raise self.refused(step, error) from error

    def refused(self, step: SdoStep, error: SdoAbortedError) -> CanopenError:
        """The package's error for a step that the node rejects."""
        return self.error_type(
            f"node {self._node_id} {step.meaning} ({step.index:04X}h/{step.subindex} := {step.value:X}h)",
            abort_text(error.code),
            f"{self.kind.a_name} that accepts it",
        )

    def map_pdos(self, plan: PdoPlan, steps: Iterable[SdoStep]) -> tuple[SdoStep, SdoAbortedError] | None:
        """Carry out a plan until a write is refused; that one, with its abort.

        A mapping, COB-ID or transmission type that reads otherwise counts as read-only, although its write was confirmed: the
        node would not receive its commands, would take one for another, or one value would be shown as another.
        """
        steps = list(steps)
        # A mapping that is already right need not be written. It may be the manufacturer's fixed one.
        planned = (*plan.rpdos, *plan.tpdos)
        mapped = {item.pdo.mapping_index for item in planned if not item.adopted and self._is_mapped(item.pdo)}
        for step in steps:
            if step.index in mapped or self._is_event_driven(step):
                continue
            try:
                self.write_repeatedly(step.index, step.subindex, step.data)
            except SdoAbortedError as error:
                if not (step.optional or self._is_as_required(step)):
                    return step, error
        for pdo in (item.pdo for item in planned if not item.adopted):
            if pdo.mapping_index not in mapped and not self._is_mapped(pdo):
                kept = SdoStep(pdo.mapping_index, 0, CanType.U8, 0, f"{pdo} keeps another mapping than was written")
                return kept, SdoAbortedError(Abort.READ_ONLY)
        last = {(step.index, step.subindex): step for step in steps if step.is_cob_id or step.is_transmission_type}
        for step in last.values():
            if not self._is_as_required(step):
                kept = replace(step, meaning=f"{step.meaning}: confirmed, but reads otherwise")
                return kept, SdoAbortedError(Abort.READ_ONLY)
        return None

    def _is_event_driven(self, step: SdoStep) -> bool:
        """Whether a TPDO is event-driven already: a stack that only supports 254 may confirm 255 and send nothing."""
        wanted = step.is_transmission_type and step.value == EVENT_DRIVEN_PROFILE
        return wanted and direction_of(step.index) is PdoDirection.TPDO and self._is_as_required(step)

    def _is_as_required(self, step: SdoStep) -> bool:
        """Whether a communication parameter of the node has the required effect, also if the node does not accept the write."""
        if not is_communication_parameter(step.index):
            return False
        try:
            return has_effect(step, self.read_number(step.index, step.subindex))
        except SdoAbortedError:
            return False

    def write_checked(self, step: SdoStep) -> int:
        """Write and read back; what the node holds, a rounded time too. The package's error when that is another value."""
        self.do(step)
        found = self.read(step.index, step.subindex)[: len(step.data)]  # some devices send 32 bits for every number
        held = int.from_bytes(found, "little", signed=step.value < 0)
        if not step.is_held_by(held):
            raise self.error_type(step.meaning, found.hex(), f"{step.data.hex()} when read back")
        return held

    def read_optional(self, index: int, subindex: int = 0) -> int:
        """A number; 0 for an object that the node does not have."""
        try:
            return self.read_number(index, subindex)
        except SdoAbortedError as error:
            if error.code not in NOT_THERE:
                raise
            return 0

    def stop_sync_producer(self) -> bool:
        """Clear bit 30 of 1005h; bits 0 to 29 may not change. True if it was set; the package's error if it stays set."""
        try:
            cob_id = self.read_optional(SYNC_COB_ID)
        except SdoAbortedError:
            return False  # it cannot be read: a SYNC of the node is that of another master
        if not cob_id & SYNC_PRODUCER:
            return False
        self.write_checked(SdoStep(SYNC_COB_ID, 0, CanType.U32, cob_id & ~SYNC_PRODUCER, "SYNC producer, 1005h bit 30"))
        self.had_sync = True
        return True

    def stop_sync_counter(self) -> None:
        """Make a node accept a SYNC without a counter; the package's error if 1019h stays. It can be written while 1006h is 0."""
        if not self.read_optional(SYNC_COUNTER):
            return
        period = self.read_optional(SYNC_PERIOD)
        pause = SdoStep(SYNC_PERIOD, 0, CanType.U32, 0, "SYNC period", optional=True)
        self.do(pause)
        self.write_checked(SdoStep(SYNC_COUNTER, 0, CanType.U8, 0, "SYNC counter overflow value"))
        self.do(replace(pause, value=period))

    def _is_mapped(self, pdo: Pdo) -> bool:
        """Whether the PDO carries exactly these objects already."""
        wanted = [len(pdo.entries), *(entry.mapping for entry in pdo.entries)]
        return all(self.require(pdo.mapping_index, subindex) == value for subindex, value in enumerate(wanted))

    def cob_id_of(self, index: int) -> int | None:
        """Sub-index 1 of a PDO's communication parameter; None for one that the EDS or the device does not have."""
        if not is_communication_parameter(index):
            return None
        try:
            return self.read_number(index, 1)
        except SdoAbortedError as error:
            if error.code == Abort.NO_SUCH_OBJECT:
                return None
            raise
