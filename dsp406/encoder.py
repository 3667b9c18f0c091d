"""The encoder client: brings one CiA 406 encoder into operation on a bus and keeps watching it.

What every node needs is in ``ds301.node.client``; this adds the encoder's PDOs, cyclic timer, parameters and diagnostics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import canopen

from pdgw.base.durations import MS
from pdgw.ds301.aborts import SdoAbortedError
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import DEVICE_TYPE, PRODUCER_HEARTBEAT
from pdgw.ds301.configuration import EVENT_DRIVEN_MANUFACTURER, SdoStep
from pdgw.ds301.eds.importer import load_dictionary
from pdgw.ds301.eds.pdos import pdo_capabilities, variable
from pdgw.ds301.emcy import emcy_text
from pdgw.ds301.node.bring_up import NodeSetup
from pdgw.ds301.node.client import NodeClient
from pdgw.ds301.node.configuring import DeviceKind
from pdgw.ds301.node.node import NodeNotice, Notice
from pdgw.ds301.node.plan import Pace, PdoPlan
from pdgw.ds301.node.planner import Findings, found_in_data_sheet, plan_pdos
from pdgw.ds301.objects import CanType
from pdgw.ds301.pdo import PdoCapabilities
from pdgw.dsp406.device import eds_path
from pdgw.dsp406.diagnosis import Diagnosis
from pdgw.dsp406.faults import ENCODER_EMCY
from pdgw.dsp406.images import (
    PARAMETER_OBJECTS,
    EncoderFeedback,
    EncoderParameters,
    position_of,
    speed_of,
)
from pdgw.dsp406.kinds import ENCODER_PROFILE, Dsp406Error
from pdgw.dsp406.objects import (
    CYCLIC_TIMER,
    POSITION,
    POSITION_MULTI_SENSOR,
)
from pdgw.dsp406.pdos import encoder_layout
from pdgw.dsp406.settings import EncoderSettings


def load_eds(path: Path, node_id: int) -> canopen.ObjectDictionary:
    """The object dictionary of a user's EDS/DCF; Dsp406Error names the file and what is wrong with it."""
    dictionary = load_dictionary(path, node_id, (DEVICE_TYPE,), "an encoder", Dsp406Error)
    if POSITION not in dictionary and POSITION_MULTI_SENSOR not in dictionary:
        raise Dsp406Error("EDS", str(path), "a data sheet of an encoder with object 6004h or 6020h")
    return dictionary


def _text_of(code: int) -> str:
    return ENCODER_EMCY.get(code) or emcy_text(code)


class EncoderSheet:
    """The PDOs of an encoder by its data sheet. Dsp406Error for a data sheet or for channels that cannot be used."""

    def __init__(self, settings: EncoderSettings) -> None:
        self.settings = settings
        self.dictionary = load_eds(settings.eds or eds_path(settings.device), settings.node_id)
        device = replace(pdo_capabilities(self.dictionary), common_timer=CYCLIC_TIMER in self.dictionary)
        self.capabilities = device
        self.layout = encoder_layout(self.dictionary, device, settings.channels, sync=settings.sync)

    def plan(self, findings: Findings | None = None) -> PdoPlan:
        """The plan for an encoder that gave these answers; None: for one that does what its data sheet says.

        Event-driven TPDOs have the type of the profile, 254: the encoder sends them by its cyclic timer.
        """
        return plan_pdos(
            self.layout,
            self.capabilities,
            self.settings.node_id,
            findings or found_in_data_sheet(self.capabilities),
            sync=self.settings.sync,
            event_driven=EVENT_DRIVEN_MANUFACTURER,
        )


class EncoderClient(NodeClient[EncoderSettings]):
    """One encoder. ``on_event`` is called whenever something happens to it that the owner must know."""

    kind = DeviceKind("encoder", "an encoder", ENCODER_PROFILE, Dsp406Error)

    def __init__(self, network: CanNetwork, settings: EncoderSettings, on_event: Callable[[NodeNotice], None]) -> None:
        self.feedback = EncoderFeedback(settings.channels)
        self.parameters: EncoderParameters | None = None
        """Read while configuring; None before."""
        self._sheet = sheet = EncoderSheet(settings)
        image = self.feedback.image
        super().__init__(NodeSetup(network, settings, sheet.layout, sheet.dictionary, image, on_event, _text_of))
        self._diagnosis = Diagnosis(self.sdo, self.feedback, lambda: self.settings.diagnosis_ms * MS)
        self.parts = (self._polled, self._diagnosis)
        self.emergencies.on_frame = self._diagnosis.on_emergency

    def has_speed(self, channel: int) -> bool:
        """The encoder sends the speed of a channel (6030h); otherwise ``speed`` in the feedback stays 0."""
        return self.plan is not None and speed_of(channel) in self.plan.shown

    def position_time(self, channel: int) -> int:
        """When the position of a channel arrived, monotonic nanoseconds; 0 before the first."""
        name = position_of(channel)
        sent = (slot.time for slot in self.operation.slots if name in slot.pdo.attributes)
        read = self.polling.find(name)
        return max([0 if read is None else read.asked_ns, *sent])

    def refresh(self, now: int) -> bool:
        """Cyclic: as for every node, and no value that is read by SDO may be overdue either."""
        fresh = super().refresh(now)
        return fresh and all(now - item.asked_ns <= self._read_age_ns for item in self.polling.objects)

    @property
    def _read_age_ns(self) -> int:
        """Longest age of a position that is read by SDO: one answer may be lost."""
        return self.polling.age_ns + self.settings.sdo_timeout_ms * MS

    @property
    def position_age_ns(self) -> int:
        """Longest age of a position that counts."""
        return max(self.operation.timeout_ns, self._read_age_ns) if self.polling.objects else self.operation.timeout_ns

    # -- the node's task ------------------------------------------------------------------------------------------------

    def read_parameters(self) -> EncoderParameters:
        """Read the parameters again (in the node's task) and keep them in ``parameters``."""
        values = {
            name: self.sdo.require(index, subindex, signed=name == "offset")
            for name, index, subindex in PARAMETER_OBJECTS
            if variable(self.sdo.dictionary, index, subindex) is not None
        }
        self.parameters = parameters = EncoderParameters(**values)
        self.operation.position = ("position", 0 if parameters.position_step else parameters.units_per_turn)
        return parameters

    def _read_capabilities(self) -> PdoCapabilities:
        return self._sheet.capabilities

    def _make_plan(self, findings: Findings) -> PdoPlan:
        return self._sheet.plan(findings)

    def _configure(self, plan: PdoPlan) -> None:
        settings = self.settings
        if self._sheet.capabilities.common_timer and any(item.pace is Pace.TIMER for item in plan.tpdos):
            self.sdo.do(SdoStep(CYCLIC_TIMER, 0, CanType.U16, settings.tpdo_event_ms, "cyclic timer"))
        self.heartbeat.expected = settings.heartbeat_ms > 0
        period, meaning = settings.heartbeat_ms, "the encoder's heartbeat"
        heartbeat = SdoStep(PRODUCER_HEARTBEAT, 0, CanType.U16, period, meaning, time=True)
        try:
            self.sdo.write_checked(heartbeat)
        except (Dsp406Error, SdoAbortedError) as error:
            text = str(error)
            self.heartbeat.expected = False  # only the TPDOs show that the encoder is running
            self._notify(Notice.PROGRESS, f"no heartbeat: {text}")
        self.read_parameters()
        self.feedback.error_code = 0
        self._diagnosis.read()
