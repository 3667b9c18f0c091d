"""The protections of an axis that its configuration or its telegram has: whether each is active, or what it lacks.

``pdgw status AXIS``, the page and ``pdgw config check`` show the result of this module. An axis that never ran lacks what only
its drive and its PLC can say.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

from pdgw.gateway.axis.executors.positions.tasks import PositionerExecutor
from pdgw.gateway.axis.executors.torque import TorqueExecutor
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.requests import Command

if TYPE_CHECKING:
    from pdgw.gateway.objects.axis import Axis


class Protection(NamedTuple):
    """One protection. ``active``: None if only the drive has the answer."""

    name: str
    active: bool | None
    detail: str
    """What it does, or what it lacks."""

    @property
    def text(self) -> str:
        """State and detail."""
        state = {True: "active", False: "not active", None: "not known"}[self.active]
        return f"{state}: {self.detail}"


def _of(name: str, detail: str, *lacks: str, known: bool = True) -> Protection:
    """A protection that is active if it lacks nothing; ``lacks`` may have empty texts."""
    needs = " and ".join(filter(None, lacks))
    if not known:
        return Protection(name, None, "the drive is not configured yet")
    return Protection(name, not needs, f"{detail}; needs {needs}" if needs else detail)


def protections(axis: Axis) -> list[Protection]:
    """Those of an axis after its last step, or before its first one."""
    machine, guarding, scaling = axis.machine, axis.drive.guarding, axis.scaling
    known = axis.drive.drive_type is not None
    found = list(_of_positions(axis))
    refusal, stopped_by = ("", "") if guarding is None else (guarding.refusal, guarding.text)
    text = f"if the gateway dies, the drive is stopped by {stopped_by}"
    found.append(_of("guarding", text, refusal and f"{refusal} (allow_unguarded = true)", known=guarding is not None))
    lacks = (
        "an acknowledge of fault 128" if machine.units_contradicted else "",
        "" if scaling.counts_per_revolution else "counts_per_revolution",
        "" if scaling.velocity_per_rpm else "velocity_unit",
    )
    found.append(_of("speed check", "6064h over time against 606Ch", *lacks, known=known))
    executor = machine.executor
    if isinstance(executor, TorqueExecutor) or (isinstance(executor, PositionerExecutor) and executor.clamps):
        rejects = "a drive that accepts 6072h" if axis.reason is Reason.TORQUE_LIMIT else ""
        found.append(_of("torque limit", "6072h", rejects, known=known))
    limit = f"a stop from 100 % that takes longer than {axis.config.stop_time_ms} ms is enforced (stop_time_ms)"
    return [*found, _of("stop supervision", limit)]


def _of_positions(axis: Axis) -> Iterator[Protection]:
    executor, positioner, plan = axis.machine.executor, axis.config.positioner, axis.drive.plan
    if not isinstance(executor, PositionerExecutor) or positioner is None:
        return
    basic = executor.positioner
    by_bits = "POS_STW2" in axis.telegram.setpoints.names
    if (limits := positioner.software_limits) is not None:
        needs = "POS_STW2.14 = 1" if by_bits else "a PLC in control"
        watched = "" if basic.request.commands & Command.SOFTWARE_LIMITS else needs
        home = "" if basic.home_set else "a homed axis or a reference point"
        yield _of("software limits", f"{limits[0]} to {limits[1]} LU", watched, home)
    lacks = [] if plan is None or "digital_inputs" in plan.shown else ["60FDh in a PDO"]
    if not basic.request.commands & Command.HARDWARE_LIMITS:
        lacks.append("POS_STW2.15 = 1" if by_bits else "a PLC in control")
    shown = f"; POS_ZSW1 shows them with {' and '.join(lacks)}" if lacks else ", and POS_ZSW1 shows them"
    yield Protection("hardware limit switches", None, f"the drive itself stops at them{shown}")
