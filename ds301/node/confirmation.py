"""What a node must show after NMT start: its TPDOs, its NMT state and its heartbeat. Nothing here changes anything."""

from __future__ import annotations

from contextlib import suppress
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.ds301.aborts import CanopenError, SdoAbortedError
from pdgw.ds301.communication import ERROR_REGISTER, NmtState
from pdgw.ds301.emcy import error_register_text
from pdgw.ds301.node.configuring import ConfiguringAccess
from pdgw.ds301.node.emergencies import Emergencies
from pdgw.ds301.node.heartbeat import Heartbeat
from pdgw.ds301.node.node import NodeSettings
from pdgw.ds301.node.operation import Operation

FIRST_SIGN_NS: Final = SECOND
"""So soon after NMT start each TPDO has to come, and the heartbeat if its own limit is not longer."""
TPDO_REMEDY: Final = "check the TPDOs of the device, and who writes its communication objects"


class Confirmation:
    """Of one start of a node. Each method returns the package's error about what is missing, or None."""

    def __init__(
        self,
        sdo: ConfiguringAccess,
        heartbeat: Heartbeat,
        emergencies: Emergencies,
        settings: NodeSettings,
        operation: Operation,
        *,
        first: bool,
    ) -> None:
        self._sdo = sdo
        self._heartbeat = heartbeat
        self._emergencies = emergencies
        self._settings = settings
        self._operation = operation
        self._first = first
        """The node was not online before."""
        self._kind = sdo.kind
        self._started = sdo.loop.now()

    def missing_tpdos(self) -> CanopenError | None:
        """The TPDOs that have not come."""
        missing = self._operation.missing()
        if not missing:
            return None
        # A node that another gateway had online may have sent them before: SYNC is only one of the causes.
        by_sync = self._first and not self._settings.sync
        return self._kind.error_type(
            f"TPDOs of the {self._kind.name}",
            f"none of {', '.join(missing)}",
            "each within 1 s of NMT start",
            TPDO_REMEDY + ("; if they are sent on SYNC only, set sync = true" if by_sync else ""),
        )

    @property
    def heartbeat_ns(self) -> int:
        """So soon after NMT start the heartbeat has to come."""
        return max(FIRST_SIGN_NS, self._settings.heartbeat_limit_ns)

    def missing_heartbeat(self) -> CanopenError | None:
        """A node whose heartbeat is dead would only be lost again: one that says operational comes first."""
        heartbeat, settings = self._heartbeat, self._settings
        runs = heartbeat.state == NmtState.OPERATIONAL
        if not heartbeat.expected or (runs and heartbeat.gap <= settings.heartbeat_limit_ns):
            return None
        if heartbeat.by_requests:
            missing, todo = "answer to node guarding", "check that the CAN adapter sends remote frames"
        else:
            missing, todo = "heartbeat", "set heartbeat_ms, or check the firmware: it accepted 1017h"
        return self._kind.error_type(
            f"{missing} of node {settings.node_id}",
            f"one every {heartbeat.gap / SECOND:.2g} s" if runs else "none",
            f"one every {settings.heartbeat_ms} ms, the first within {self.heartbeat_ns / SECOND:g} s of NMT start",
            todo,
        )

    def explanation(self) -> CanopenError | None:
        """In the node's task: what the node shows since NMT start that explains a missing TPDO or heartbeat."""
        node, state = f"node {self._settings.node_id}", self._heartbeat.state
        if state not in (NmtState.BOOT_UP, NmtState.OPERATIONAL):
            error, register = "", 0
            with suppress(SdoAbortedError):
                register = self._sdo.read_number(ERROR_REGISTER)
            if register:
                error = f", error register 1001h = {register:02X}h ({error_register_text(register)})"
            return self._kind.error_type(
                f"NMT state of {node} after NMT start",
                f"{NmtState.text(state)}{self._emergencies.after(self._started)}{error}",
                "Operational",
                "remove the errors of the device, then restart the node (P972, or power off and on)",
            )
        for slot in self._operation.slots:
            if slot.data is None and slot.short is not None:
                return self._kind.error_type(
                    f"{slot.pdo} of {node}",
                    f"{slot.short} bytes",
                    f"{slot.pdo.size} bytes as mapped",
                    f"check the firmware of the {self._kind.name}",
                )
        return None
