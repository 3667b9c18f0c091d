"""Scan of an unconfigured bus: nodes, their types, and what each telegram lacks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import can
import canopen

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import Abort, SdoAbortedError, SdoCommunicationError
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import (
    DEVICE_NAME,
    DEVICE_TYPE,
    IDENTITY,
    NODE_IDS,
    SDO_REQUEST,
    SDO_RESPONSE,
    SYNC_PERIOD,
    NmtState,
    profile_of,
)
from pdgw.ds301.configuration import SdoStep
from pdgw.ds301.eds.importer import load_dictionary
from pdgw.ds301.node.sdo import Inquiry
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.drive.guarding import guard
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.drive_type import DriveType, Dsp402Error
from pdgw.dsp402.identification.generic import probe
from pdgw.dsp402.objects import DRIVE_PROFILE
from pdgw.dsp406.kinds import ENCODER_PROFILE, EncoderType
from pdgw.dsp406.objects import POSITION, POSITION_MULTI_SENSOR
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.telegrams import ENCODER_TELEGRAM_NUMBERS
from pdgw.gateway.commissioning.master_watch import MasterWatch
from pdgw.gateway.commissioning.telegram_check import lacks, lacks_by_telegram
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.profidrive.telegrams import Telegram

_PAUSE_NS = 2 * MS
"""Between two questions: a transmit queue is short."""
_QUESTION = bytes((0x40,)) + DEVICE_TYPE.to_bytes(2, "little") + bytes(5)
"""SDO upload of 1000h."""


@dataclass(frozen=True, slots=True)
class Sheet:
    """A data sheet, and the device it is of."""

    path: Path
    dictionary: canopen.ObjectDictionary

    @property
    def identity(self) -> tuple[int, int]:
        """Vendor-ID and product code."""
        information = self.dictionary.device_information
        return information.vendor_number or 0, information.product_number or 0


@dataclass(frozen=True, slots=True)
class Expected:
    """A node in the configuration."""

    what: str
    """Such as ``DO 1``."""
    telegram: Telegram
    profile: int = DRIVE_PROFILE
    eds: Path | None = None
    settings: AxisSettings | None = None
    drive: DriveSettings | None = None


@dataclass(slots=True)
class FoundNode:
    """A node with a received frame or an answer."""

    node_id: int
    nmt_state: str = ""
    """State in its last heartbeat; empty without one."""
    device_type: int | None = None
    """1000h; None when it answers no SDO."""
    vendor_id: int | None = None
    product_code: int | None = None
    revision: int | None = None
    serial_number: int | None = None
    name: str = ""
    """1008h."""
    eds: Path | None = None
    """The data sheet that fits its identity, or that the configuration names."""
    notes: list[str] = field(default_factory=list)
    """Remarks for the user, one sentence each."""
    drive: DriveType | None = None
    lacks: Mapping[int, str] = field(default_factory=dict)
    """Missing parts by telegram; an empty text if nothing is missing."""

    @property
    def profile(self) -> int | None:
        """Number of its device profile."""
        return None if self.device_type is None else profile_of(self.device_type)


def expected_on(config: GatewayConfig, bus: CanConfig) -> dict[int, Expected]:
    """The nodes of a bus in the configuration; of several drive objects of a node, the first."""
    expected: dict[int, Expected] = {}
    for axis in config.axis:
        if config.bus_of(axis).name == bus.name:
            cycle_ms = config.transport.cycle_time_ms
            expected[axis.node_id] = Expected(
                f"DO {axis.do_id}",
                axis.chosen,
                DRIVE_PROFILE,
                axis.eds,
                axis.settings_at(cycle_ms),
                axis.drive_settings(axis.telegram, cycle_ms),
            )
    for node_id, channels in config.encoders_of(bus).items():
        first = channels[0]
        expected[node_id] = Expected(f"DO {first.do_id}", first.chosen, ENCODER_PROFILE, first.eds)
    return expected


def load_sheets(paths: Iterable[Path]) -> list[Sheet]:
    """The data sheets of files, and of folders what ends in .eds or .dcf. CanopenError names one that cannot be used."""
    sheets = []
    for path in paths:
        found = (
            sorted(item for item in path.iterdir() if item.suffix.lower() in {".eds", ".dcf"})
            if path.is_dir()
            else [path]
        )
        for item in found:
            sheets.append(Sheet(item, _dictionary(item, 1)))
    return sheets


def _dictionary(path: Path, node_id: int) -> canopen.ObjectDictionary:
    return load_dictionary(path, node_id, (DEVICE_TYPE,), "a device")


class Scan:
    """The scan of a bus. ``run`` is for a task; the network must have been started."""

    def __init__(
        self,
        network: CanNetwork,
        sheets: Sequence[Sheet] = (),
        expected: Mapping[int, Expected] | None = None,
        *,
        listen_ns: int = SECOND,
        answer_ns: int = SECOND,
        timeout_s: float = 0.5,
    ) -> None:
        self.network = network
        self.sheets = sheets
        self.expected: Mapping[int, Expected] = expected or {}
        self._listen_ns = listen_ns
        self._answer_ns = answer_ns
        self._timeout_s = timeout_s
        self._masters = MasterWatch(network)
        self._answered: set[int] = set()

    def run(self) -> list[FoundNode]:
        """Every node, in order. GatewayError when a master works on the bus: its SDOs and ours would disturb each other."""
        loop, network = self.network.loop, self.network
        network.listeners.append(self._on_message)
        try:
            loop.sleep(self._listen_ns)
            self._masters.refuse()
            for node_id in NODE_IDS:
                network.send(SDO_REQUEST + node_id, _QUESTION)
                loop.sleep(_PAUSE_NS)
            loop.sleep(self._answer_ns)
            found = [
                self._ask(node_id)
                for node_id in sorted(self._answered | self._masters.states.keys() | self.expected.keys())
            ]
            self._masters.refuse()
        finally:
            network.listeners.remove(self._on_message)
        return found

    def _on_message(self, message: can.Message) -> None:
        self._masters.see(message)
        base, node_id = message.arbitration_id & ~0x7F, message.arbitration_id & 0x7F
        if message.is_rx and not message.is_extended_id and base == SDO_RESPONSE and node_id:
            self._answered.add(node_id)

    # -- one node -------------------------------------------------------------------------------------------------------

    def _ask(self, node_id: int) -> FoundNode:
        found = FoundNode(node_id)
        state = self._masters.states.get(node_id)
        if state is not None:
            found.nmt_state = NmtState.text(state)
        if node_id == self.network.node_id:
            found.notes.append("this is the node-ID of the gateway, too: [can] node_id must be another one")
        expected = self.expected.get(node_id)
        if node_id not in self._answered:
            heard = found.nmt_state or "not heard"
            found.notes.append(
                f"no answer to SDO ({heard})"
                + (f": {expected.what} of the configuration is missing" if expected else "")
            )
            return found
        try:
            with Inquiry(self.network, node_id, self._timeout_s) as node:
                self._identify(node, found)
                self._describe(node, found, expected)
        except SdoCommunicationError as error:
            found.notes.append(f"stopped answering ({error})")
        return found

    def _identify(self, node: Inquiry, found: FoundNode) -> None:
        found.device_type = node.number(DEVICE_TYPE)
        found.vendor_id, found.product_code, found.revision, found.serial_number = (
            node.number(IDENTITY, subindex) for subindex in range(1, 5)
        )
        found.name = node.text(DEVICE_NAME)

    def _describe(self, node: Inquiry, found: FoundNode, expected: Expected | None) -> None:
        sheet = self._sheet(found, expected)
        if expected is None and self.expected:
            found.notes.append("this node is not in the configuration")
        if expected is not None and found.profile != expected.profile:
            found.notes.append(
                f"{expected.what} of the configuration needs device profile {expected.profile}; this device has "
                "another one"
            )
            expected = None
        if found.profile == DRIVE_PROFILE:
            self._describe_drive(node, found, sheet, expected)
        elif found.profile == ENCODER_PROFILE:
            _describe_encoder(node, found)
        else:
            found.notes.append(
                f"device profile {found.profile}: neither a drive (402) nor an encoder (406), no telegram supports it"
            )

    def _sheet(self, found: FoundNode, expected: Expected | None) -> Sheet | None:
        """The configured data sheet, else the one that fits; what differs is noted."""
        identity = found.vendor_id or 0, found.product_code or 0
        if expected is not None and expected.eds is not None:
            sheet = Sheet(expected.eds, _dictionary(expected.eds, found.node_id))
            declared = sheet.identity
            if any(expected and expected != seen for expected, seen in zip(declared, identity, strict=True)):
                found.notes.append(
                    f"{sheet.path} belongs to vendor-ID {declared[0]:08X}h, product code {declared[1]:08X}h: another "
                    "device, pdgw run rejects it"
                )
                return None
        else:
            fitting = [sheet for sheet in self.sheets if sheet.identity == identity]
            if not fitting:
                if self.sheets:
                    found.notes.append("no data sheet belongs to this device")
                return None
            sheet = fitting[0]
            sheet = Sheet(sheet.path, _dictionary(sheet.path, found.node_id))
        found.eds = sheet.path
        revision = sheet.dictionary.device_information.revision_number
        if revision and found.revision is not None and revision != found.revision:
            found.notes.append(f"{sheet.path} has revision {revision:08X}h")
        return sheet

    def _describe_drive(self, node: Inquiry, found: FoundNode, sheet: Sheet | None, expected: Expected | None) -> None:
        settings = (expected.drive if expected is not None else None) or DriveSettings(node.node_id)
        try:
            drive = probe(node, None if sheet is None else sheet.dictionary, settings.units, settings.families)
        except Dsp402Error as error:
            found.notes.append(str(error))
            return
        found.drive = drive
        found.lacks = dict(lacks_by_telegram(drive))
        found.notes.append(f"if the gateway dies, this device is stopped by {self._guarding(node, drive, settings)}")
        if expected is None:
            return
        number = expected.telegram.number
        if expected.settings is not None:
            found.lacks = {**found.lacks, number: lacks(drive, expected.telegram, expected.settings)}
        missing = found.lacks.get(number, "")
        found.notes.append(
            f"{expected.what} of the configuration, telegram {number}: " + (missing or "nothing is missing")
        )

    def _guarding(self, node: Inquiry, drive: DriveType, settings: DriveSettings) -> str:
        """Text on the possible guarding of the gateway. An existing object counts as writable."""

        def number(index: int, subindex: int) -> int:
            value = node.number(index, subindex)
            if value is None:
                raise SdoAbortedError(Abort.NO_SUCH_OBJECT)
            # The gateway would have written the period.
            return times.sync_period_us if index == SYNC_PERIOD else value

        def pretend(step: SdoStep) -> int:
            number(step.index, step.subindex)
            return step.value

        times = settings.guarding_of(drive, self.network.node_id, PdoDirection.RPDO.communication_index)
        found = guard(times, pretend, number)
        if not found.refusal:
            return found.text
        if settings.allow_unguarded:
            return f"{found.text}; pdgw run operates it because allow_unguarded = true"
        remedy = found.remedy
        if times.sync_loss_periods and not times.sync_period_us:
            remedy = "use a telegram with SYNC in a cyclic synchronous mode: drives of this family stop without SYNC"
        return f"{found.text}; pdgw run rejects it; {remedy}"


def _describe_encoder(node: Inquiry, found: FoundNode) -> None:
    assert found.device_type is not None
    number = found.device_type >> 16
    if number in EncoderType._value2member_map_:
        found.notes.append(f"encoder type {number}: {EncoderType(number).name.replace('_', ' ').lower()}")
    position = POSITION_MULTI_SENSOR if number == EncoderType.MULTI_SENSOR else POSITION
    has_position = node.fetch(position) is not None
    missing = "" if has_position else f"no position {position:04X}h"
    found.lacks = dict.fromkeys(ENCODER_TELEGRAM_NUMBERS, missing)
