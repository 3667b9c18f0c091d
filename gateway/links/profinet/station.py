"""The gateway as a PROFINET device: identity and model from the configuration, name and address.

Name and address come from DCP, and are kept in the store, at the interface and in the log."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from datetime import date

from pdgw.base.durations import MS
from pdgw.ds301.loop.loop import Loop
from pdgw.gateway.base import identity
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.store import DeviceParameters, ParameterStore
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.configuration.devices import EncoderConfig
from pdgw.gateway.configuration.environment import TransportConfig
from pdgw.gateway.links.profinet.ethernet import EthernetPort
from pdgw.profidrive.frame import COUNTER_UNIT_NS
from pdgw.profidrive.telegrams import Telegram
from pdgw.profinet.connection.application_relation import ApplicationRelation
from pdgw.profinet.device import Refused
from pdgw.profinet.discovery.dcp import Flash, IpSet, NameSet, ResetToFactory
from pdgw.profinet.model import SEND_CLOCKS, DeviceModel, ObjectKind, drive_model
from pdgw.profinet.station import Identity, IpSuite, Station

PRODUCT = "profidrive-gateway"
"""Also the name that engineering tools propose for the station."""
VENDOR_NAME = "pdgw"
RELEASED = date(identity.RELEASE_YEAR, identity.RELEASE_DAY_MONTH % 100, identity.RELEASE_DAY_MONTH // 100)


def profinet_identity(transport: TransportConfig, mac: bytes) -> Identity:
    """Identity of the device."""
    return Identity(
        mac,
        transport.vendor_id,
        transport.device_id,
        PRODUCT,
        identity.ORDER_ID,
        transport.station_name[:16],
        identity.HARDWARE_REVISION,
        ("V", *identity.RELEASE),
    )


def min_device_interval(transport: TransportConfig) -> int:
    """Shortest cycle of a controller in 31.25 us: 1 ms, or less if the configured cycle is shorter."""
    return next(
        (clock for clock in SEND_CLOCKS if clock * COUNTER_UNIT_NS >= transport.cycle_time_ms * MS), SEND_CLOCKS[-1]
    )


def profinet_model(
    transport: TransportConfig, mac: bytes, objects: Sequence[AxisConfig | EncoderConfig], telegrams: Sequence[Telegram]
) -> DeviceModel:
    """A slot for each drive object, in the order of the configuration."""
    kinds = [ObjectKind.AXIS if isinstance(item, AxisConfig) else ObjectKind.ENCODER for item in objects]
    identified = list(zip(kinds, telegrams, strict=True))
    device = profinet_identity(transport, mac)
    return drive_model(device, identified, min_device_interval(transport))


log = logging.getLogger("gateway")

FLASH_NS = 3_000 * MS
"""Duration of the signal after a DCP flash request."""
_SAME_REFUSAL_NS, _OTHER_REFUSAL_NS = 60_000 * MS, 1_000 * MS
"""Times after which a refused Connect is logged again: for the same reason, for another reason."""
_NAMED_NS = 30_000 * MS
"""Time for which a refused Connect is named: longer than a controller waits before the next one."""


class StationKeeper:
    """Station of one interface. A fixed address (``ip`` in [transport]) has priority over the stored one, and that over the
    present one."""

    def __init__(self, port: EthernetPort, transport: TransportConfig, store: ParameterStore, loop: Loop) -> None:
        self._port = port
        self._transport = transport
        self._store = store
        self._loop = loop
        self._flashing_until = 0
        self._logged: Refused | None = None
        self._logged_at = 0
        self._refused: Refused | None = None
        self._refused_at = 0
        self.address = IpSuite()
        """The address of the interface; one that was not set here belongs to another program."""

    def first_name(self) -> str:
        """The name to start with."""
        stored = self._store.parameters.station_name
        return self._transport.station_name if stored is None else stored

    def first_ip(self) -> IpSuite:
        """The address to start with, which the interface has from then on; GatewayError when that is not allowed."""
        self.address = current = self._port.ip()
        suite, stored = self._transport.ip_suite, self._store.parameters.station_ip
        if suite is None:
            if stored is None:
                return current
            suite = IpSuite.decode(bytes.fromhex(stored))
        if (current.address, current.mask) != (suite.address, suite.mask):
            self._port.set_ip(suite)
            self.address = self._port.ip()
        return suite

    def give_ip(self, suite: IpSuite) -> bool:
        """The address that DCP gives; False where the configured one is fixed, or none may be set."""
        fixed = self._transport.ip_suite
        if fixed is not None:
            if suite != fixed:
                log.error(
                    "DCP Set of IP address %s rejected: ip = %s in [transport] is fixed", suite.address, fixed.address
                )
            return suite == fixed
        present = self._port.ip()
        if (present.address, present.mask) == (suite.address, suite.mask):
            return True
        try:
            self._port.set_ip(suite)
        except GatewayError as error:
            log.error("%s", error)
            return False
        self.address = self._port.ip()
        return True

    def address_changed(self) -> bool:
        """Whether another program has changed the interface's address; ``address`` is the present one."""
        before, self.address = self.address, self._port.ip()
        if self.address == before:
            return False
        log.error(
            "the IP address is now %s instead of %s: another program changed it", self.address.address, before.address
        )
        return True

    @property
    def flashing(self) -> bool:
        """The device shows itself."""
        return self._loop.now() < self._flashing_until

    def status(self, station: Station, relation: ApplicationRelation | None) -> dict[str, object]:
        """For ``pdgw status``, with the relationship of its controller."""
        return {
            "name": station.name,
            "ip": str(station.ip.address),
            "mac": self._port.mac.hex(":"),
            "link_up": station.link_up,
            "relationship": relation.state.value if relation else "none",
            "controller": relation.plan.ar.station_name if relation else "",
            "cycle_ms": relation.provider.cycle_ns / MS if relation and relation.provider else None,
            "flashing": self.flashing,
        }

    def on_event(self, event: NameSet | IpSet | ResetToFactory | Flash | Refused, name: str) -> None:
        """Store changes by DCP; log all events. ``name``: name of the station."""
        match event:
            case NameSet(given, permanent):
                log.info("name of station set to %r by DCP", given)
                self.keep("station_name", given if permanent else "")
            case IpSet(suite, permanent):
                log.info("IP address set to %s by DCP", suite.address)
                self.keep("station_ip", suite.encode().hex() if permanent else None)
            case ResetToFactory():
                log.warning("reset to factory by DCP: name, IP address and I&M1 to I&M4 are cleared")
                self._save(DeviceParameters.reset_station, "reset to factory")
            case Flash():
                self._flashing_until = self._loop.now() + FLASH_NS
                log.warning("flash signal: this is the device %s", name or "without a name")
            case Refused():
                self._log_refused(event)

    def refused(self, now: int) -> Refused | None:
        """The newest Connect that was rejected; None if that was long ago, or before a relationship began or ended."""
        return self._refused if now - self._refused_at <= _NAMED_NS else None

    def forget_refused(self) -> None:
        """A relationship begins or ends. Earlier rejections are forgotten, because they cannot be the cause of a later loss."""
        self._refused = None

    def _log_refused(self, refused: Refused) -> None:
        """A controller repeats its Connect every few seconds, an unknown sender at any rate: log each reason, with a limit."""
        now = self._loop.now()
        self._refused, self._refused_at = refused, now
        silent = _SAME_REFUSAL_NS if refused == self._logged else _OTHER_REFUSAL_NS
        if self._logged is None or now - self._logged_at >= silent:
            self._logged, self._logged_at = refused, now
            log.error("%s", refused.text)

    def keep(self, field: str, value: str | None) -> None:
        """Store a value of the station."""
        self._save(lambda parameters: setattr(parameters, field, value), f"store {field}")

    def _save(self, change: Callable[[DeviceParameters], None], what: str) -> None:
        """Store without waiting for the disk."""

        def save() -> None:
            try:
                self._loop.result(self._loop.offload(lambda: self._store.update(change)))
            except GatewayError as error:
                log.error("%s", error)

        self._loop.spawn(save, what)
