"""Map the PDOs of a node by SDO: plan them, write the plan, and plan again without what the node refuses."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pdgw.ds301.aborts import SdoAbortedError
from pdgw.ds301.bus.can_frame import STANDARD_ID
from pdgw.ds301.bus.network import UNUSED, CanNetwork
from pdgw.ds301.configuration import disable_pdo
from pdgw.ds301.node.configuring import ConfiguringAccess
from pdgw.ds301.node.node import NodeSettings
from pdgw.ds301.node.plan import PdoPlan, plan_steps
from pdgw.ds301.node.planner import DeviceMapping, Findings
from pdgw.ds301.pdo import COB_ID_INVALID, PdoCapabilities, pdo_of


class PdoMapper:
    """Of one node, in its task."""

    def __init__(self, network: CanNetwork, sdo: ConfiguringAccess) -> None:
        self._network = network
        self._sdo = sdo
        self.device = DeviceMapping(sdo.read_number)
        """What its refusals have shown."""

    def map(
        self,
        settings: NodeSettings,
        capabilities: Callable[[], PdoCapabilities],
        make_plan: Callable[[Findings], PdoPlan],
    ) -> PdoPlan:
        """Return the plan that the node has now. The package's error if it takes none.

        ``capabilities`` reads the PDOs in the data sheet. ``make_plan`` makes a plan from the findings about the node.
        """
        sdo, device, node_id = self._sdo, self.device, settings.node_id
        found = {index: cob_id for index in sdo.dictionary if (cob_id := sdo.cob_id_of(index)) is not None}
        device.survey(capabilities(), found)
        plan = make_plan(device.findings)
        self._check_cob_ids(plan, node_id)
        self._disable_others(plan, found, node_id)
        times = {"event_ms": settings.tpdo_event_ms, "inhibit_us": settings.tpdo_inhibit_us}
        while refused := sdo.map_pdos(plan, plan_steps(plan, node_id, found, **times)):
            # A plan must include an unused PDO that cannot be disabled.
            if not (plan.uses(refused[0].index) and device.learn(*refused)):
                raise sdo.refused(*refused)
            plan = make_plan(device.findings)
            self._check_cob_ids(plan, node_id)
        return plan

    def _check_cob_ids(self, plan: PdoPlan, node_id: int) -> None:
        """Refuse a plan with the COB-ID of another node: that node would take the commands, or its values would be mixed."""
        for item in (*plan.rpdos, *plan.tpdos):
            other = self._network.node_of_pdo(item.cob_id, node_id)
            if other != node_id:
                whose = "an unused PDO" if other == UNUSED else f"node {other}"
                raise self._sdo.error_type(
                    f"node {node_id} {item.pdo}",
                    f"COB-ID {item.cob_id:03X}h",
                    f"a COB-ID that {whose} does not have (PDO5 is PDO1 of the node-ID that is 64 higher): "
                    "set another node-ID",
                )

    def _disable_others(self, plan: PdoPlan, found: Mapping[int, int], node_id: int) -> None:
        """Disable unused PDOs for which the gateway has no COB-ID: theirs may be that of another node."""
        for index, cob_id in found.items():
            direction, number = pdo_of(index)
            if cob_id & COB_ID_INVALID or plan.uses(index) or direction.has_cob_id(number, node_id):
                continue
            step = disable_pdo(direction, number, cob_id)
            try:
                self._sdo.write_repeatedly(step.index, step.subindex, step.data)
            except SdoAbortedError as error:
                if self._network.node_of_pdo(cob_id & STANDARD_ID, UNUSED) not in (UNUSED, node_id):
                    raise self._sdo.refused(step, error) from error
