"""The device of a drive object without a running gateway: its values saved, compared with those of its files, and written.

Each method is for a task on the network. Nothing is written but by ``write``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from typing import Final

import canopen

from pdgw.base.durations import SECOND
from pdgw.ds301.aborts import NOT_THERE, SdoAbortedError, SdoCommunicationError, abort_text
from pdgw.ds301.bus.load import DEFAULT_BITRATE
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import (
    DEVICE_NAME,
    DEVICE_TYPE,
    IDENTITY,
    SAVE_SIGNATURE,
    STORE_PARAMETERS,
    VERIFY_CONFIGURATION,
)
from pdgw.ds301.configuration import SdoStep
from pdgw.ds301.eds.dcf import Commissioning, value_of, write_dcf
from pdgw.ds301.eds.importer import import_eds
from pdgw.ds301.eds.pdos import variable, variables
from pdgw.ds301.node.configuring import ConfiguringAccess, DeviceKind
from pdgw.ds301.node.device_values import ValueWriter
from pdgw.ds301.objects import CanType, ObjectAddress
from pdgw.ds301.values import DeviceValue, DeviceValues, KnownDevice, object_name
from pdgw.dsp402.drive.client import DriveClient
from pdgw.dsp402.drive.own_values import OwnValueKeeper, OwnValues
from pdgw.dsp402.drive.value_writer import DriveValueWriter
from pdgw.dsp402.identification.generic import dictionary_of
from pdgw.dsp406.device import eds_path
from pdgw.dsp406.encoder import EncoderClient
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.store import ParameterStore, stored_parameters
from pdgw.gateway.commissioning.master_watch import ALONE, MasterWatch
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.device_values import is_owned
from pdgw.gateway.configuration.devices import EncoderConfig

_AGAIN_NS: Final = 2 * SECOND
"""Time between the two readings of a saved value."""
_STORE_NS: Final = 10 * SECOND
"""Longest time of storing (1010h)."""
_ACCESSES: Final = ("rw", "rwr", "rww")
Report = Callable[[int, int], None]
"""Called with the number of objects that are read, and of all."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A value that the device does not have. ``held``: what it has, as text."""

    item: DeviceValue
    name: str
    held: str


class ConfiguredDevice:
    """The device of a drive object of a configuration. GatewayError for a drive object that is not there."""

    def __init__(self, network: CanNetwork, config: GatewayConfig, do_id: int) -> None:
        self.item = _item(config, do_id)
        self._network = network
        self._bitrate = config.bus_of(self.item).bitrate or DEFAULT_BITRATE
        self._is_drive = isinstance(self.item, AxisConfig)
        self.values: DeviceValues = self.item.device_values("axis" if self._is_drive else "encoder")
        kind: DeviceKind = DriveClient.kind if self._is_drive else EncoderClient.kind
        self.sdo = ConfiguringAccess(network, self.item.node_id, canopen.ObjectDictionary(), kind)
        self.sdo.set_timeout(self.item.sdo_timeout_ms * SECOND // 1000, slow=False)
        self.sdo.patient = True
        self._store = config.store
        self._known = KnownDevice()
        self._own_values = OwnValueKeeper(self._read, self.sdo.write, lambda *_: None)
        self._own_values.save = self._save_own_values
        self._writer = ValueWriter(self.sdo)

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Ask the device, alone on its bus. GatewayError beside a master, CanopenError for a device that is another one."""
        self.sdo.open()
        try:
            with MasterWatch(self._network, ALONE).listening():
                self._identify()
                yield
        except SdoCommunicationError as error:
            raise GatewayError(
                f"DO {self.item.do_id}: no answer from node {self.item.node_id} ({error}); pdgw bus scan lists the nodes"
            ) from error
        finally:
            self.sdo.close()

    def _identify(self) -> None:
        sdo, item = self.sdo, self.item
        device_type = sdo.read_number(DEVICE_TYPE)
        self._known = known = KnownDevice(*(sdo.read_optional(IDENTITY, subindex) for subindex in range(1, 5)))
        if item.eds is not None:
            sdo.dictionary = import_eds(item.eds, item.node_id).dictionary
        elif isinstance(item, EncoderConfig):
            sdo.dictionary = import_eds(eds_path(item.device), item.node_id).dictionary
        else:
            device = known.vendor_id, known.product_code
            sdo.dictionary = dictionary_of(item.node_id, self._read, *device, item.families)
        sdo.check_identity(device_type, (known.vendor_id, known.product_code))
        if isinstance(item, AxisConfig):
            writer = self._writer = DriveValueWriter(sdo, self._own_values)
            name = sdo.dictionary.device_information.product_name or ""
            writer.family = item.families.of(known.vendor_id, known.product_code, name)
            self._own_values.load(stored_parameters(self._store).drive_object(item.do_id).own_values)
            self._own_values.identify((known.vendor_id, known.product_code, known.serial_number))
        if self.values:
            self._writer.check_identity(self.values, known)

    def _save_own_values(self, values: OwnValues) -> bool:
        store = ParameterStore(self._store, lambda _: None)
        store.update(lambda stored: setattr(stored.drive_object(self.item.do_id), "own_values", values))
        return True

    def _read(self, index: int, subindex: int) -> bytes | None:
        try:
            return self.sdo.read(index, subindex)
        except SdoAbortedError as error:
            return None if error.code in NOT_THERE else b""

    # -- saving -------------------------------------------------------------------------------------------------------

    def save(self, now: datetime, report: Report | None) -> tuple[str, int]:
        """The text of a DCF, and the number of its values: of each object that can be read and written, twice the same."""
        dictionary = self.sdo.dictionary
        wanted = [
            (item.index, item.subindex)
            for item in variables(dictionary)
            if item.access_type in _ACCESSES and item.data_type != CanType.DOMAIN.code
        ]
        owned = [address for address in wanted if is_owned(address[0]) and address[0] != VERIFY_CONFIGURATION]
        addresses = [address for address in wanted if not is_owned(address[0])]
        comments = [f"{object_name(*address)}: written by the gateway itself" for address in owned]
        count, tell = len(addresses), report or (lambda done, all_: None)
        values = self._read_all(addresses, comments, lambda done: tell(done, 2 * count))
        self._network.loop.sleep(_AGAIN_NS)
        again = self._read_all(list(values), comments, lambda done: tell(count + done, 2 * count))
        for address, data in list(values.items()):
            declared = variable(dictionary, *address)
            assert declared is not None
            try:
                text = value_of(declared.data_type, data)
                if address not in again or data != again[address]:
                    raise ValueError(f"changed while it was read ({text})")
            except ValueError as error:
                comments.append(f"{object_name(*address)}: {error}")
                del values[address]
        known = self._known
        identity = known.vendor_id, known.product_code, known.revision, known.serial_number
        name = (self._read(DEVICE_NAME, 0) or b"").decode("latin-1").rstrip("\0 ").strip()
        device = Commissioning(self.item.node_id, self._bitrate, self.item.name or name, identity, now)
        verifies = self._writer.stamp() is not None
        return write_dcf(dictionary, values, device, comments, verifies=verifies), len(values)

    def _read_all(
        self, addresses: Sequence[ObjectAddress], comments: list[str], report: Callable[[int], None]
    ) -> dict[ObjectAddress, bytes]:
        found = {}
        for done, address in enumerate(addresses):
            report(done)
            own = self._own_values.value(address)
            try:
                data = self.sdo.read(*address)
                found[address] = data if own is None else own.to_bytes(len(data), "little")
            except SdoAbortedError as error:
                comments.append(f"{object_name(*address)}: cannot be read, {abort_text(error.code)}")
        return found

    # -- comparing and writing ----------------------------------------------------------------------------------------

    def differences(self) -> list[Difference]:
        """The values of the files that the device does not have. GatewayError without files."""
        if not self.values:
            raise GatewayError(
                f"DO {self.item.do_id} has neither dcf nor a table of objects; pdgw device save makes a DCF of a sound device"
            )
        return [
            Difference(item, self._name(item), "write-only" if held is None else item.text(held))
            for item, held in self._writer.differing(self.values.items)
        ]

    def _name(self, item: DeviceValue) -> str:
        declared = variable(self.sdo.dictionary, *item.address)
        return "" if declared is None else declared.name

    def write(self) -> list[DeviceValue]:
        """Write what differs and read it back; returns the values that act after a restart only.

        GatewayError while the device has power, CanopenError for a value that it does not take.
        """
        differing = self._writer.differing(self.values.items)
        if differing:
            if obstacle := self._writer.obstacle():
                raise GatewayError(f"DO {self.item.do_id}: values are written without power; {obstacle}")
            self._writer.clear_stamp()
            self._writer.write(differing)
        return [item for item, _ in differing if self._writer.acts_after_restart(item.index)]

    @property
    def is_stored(self) -> bool:
        """Whether the device shows that it has stored the values of its file (1020h)."""
        return self.values.date != (0, 0) and self._writer.stamp() == self.values.date

    def store(self) -> bool:
        """Set 1020h to the date of the file and store all values (1010h); whether the device then shows the date.

        CanopenError if it does not store.
        """
        if obstacle := self._writer.obstacle():
            raise GatewayError(f"DO {self.item.do_id}: values are stored without power; {obstacle}")
        if any(self.values.date) and self._writer.stamp() is not None:
            for subindex, number in enumerate(self.values.date, 1):
                self.sdo.write_checked(
                    SdoStep(VERIFY_CONFIGURATION, subindex, CanType.U32, number, "date of the configuration")
                )
        self.sdo.set_timeout(_STORE_NS, slow=True)
        self.sdo.patient = False
        self.sdo.do(SdoStep(STORE_PARAMETERS, 1, CanType.U32, SAVE_SIGNATURE, "storing of all parameters"))
        return self.is_stored


def _item(config: GatewayConfig, do_id: int) -> AxisConfig | EncoderConfig:
    for item in config.objects:
        if item.do_id == do_id:
            return item
    raise GatewayError(f"DO {do_id}: not in the configuration, allowed: {[item.do_id for item in config.objects]}")
