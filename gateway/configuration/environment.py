"""Configuration of the gateway's environment: buses, nodes, transport, parameter channel."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from ipaddress import IPv4Address, IPv4Interface, IPv4Network
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, Strict, model_validator

from pdgw.base.durations import MS
from pdgw.base.validation import misplaced
from pdgw.ds301.communication import DEFAULT_GATEWAY_NODE_ID, NODE_IDS
from pdgw.ds301.node.node import NodeSettings
from pdgw.ds301.values import DeviceValues
from pdgw.gateway.base import identity
from pdgw.gateway.configuration.defaults import (
    LONGEST_AGE_MS,
    STATUS_PORT,
    USUAL_CYCLE_MS,
    WATCHDOG_FACTOR,
    WATCHDOG_FACTOR_MAX,
    Trigger,
)
from pdgw.gateway.configuration.device_values import Value, check_objects, device_values
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import CYCLIC_PORT
from pdgw.profidrive.telegrams import TELEGRAMS, Telegram, telegram
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.profinet.station import IpSuite, check_name

_NODE: Final = NodeSettings(node_id=1)
"""Defaults of the node keys."""
_MISSPELT = 0.85
"""A further [can] key this similar to a known key counts as a typing error."""

Integer = Annotated[int, Strict()]
"""true and "3" are not numbers here."""
Boolean = Annotated[bool, Strict()]
Simulated = Boolean | tuple[str, ...]
"""Whether a simulated device is used; a list has its habits, each as "NAME PARAMETER=VALUE ..."."""
Port = Annotated[Integer, Field(ge=0, le=65535)]
NodeId = Annotated[Integer, Field(ge=NODE_IDS[0], le=NODE_IDS[-1])]
DeviceNumber = Annotated[Integer, Field(ge=0, le=65535)]


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a table means depends on it: the context of its validation."""

    folder: Path = Path()
    """Relative paths of drive families are in it."""
    telegrams: Mapping[int, Telegram] = field(default_factory=dict)
    """The user's own ones in the same file, by number."""


def in_words(pattern: str, allowed: str) -> AfterValidator:
    """A text that the pattern matches as a whole. ``allowed`` says the same to the user."""

    def check(text: str) -> str:
        if re.fullmatch(pattern, text) is None:
            raise ValueError(f"allowed: {allowed}")
        return text

    return AfterValidator(check)


DisplayName = Annotated[
    str,
    in_words(r"(?!\s)[^/+#\"\x00-\x1f]{1,40}(?<!\s)", '1 to 40 characters without / + # and ", no space at either end'),
]
"""A name that people gave; without what separates topics and quotes."""
Community = Annotated[str, in_words("[!-~]{1,32}", "1 to 32 letters, digits and marks of ASCII, without spaces")]


class DriveObjectSection(Section):
    """Keys of every drive object: one node, and its telegram."""

    do_id: Annotated[Integer, Field(ge=1, le=254)]
    name: DisplayName | None = None
    """Shown beside the number."""
    node_id: NodeId
    telegram: Integer
    can: str | None = None
    """Name of its bus; None: the first."""
    eds: Path | None = None
    dcf: Path | None = None
    """Its values are written to the device at each bring-up. It is the data sheet, too, where ``eds`` is not given."""
    objects: Annotated[dict[str, Value], AfterValidator(check_objects)] = {}
    """Further values, by the name of their object."""
    heartbeat_ms: Annotated[Integer, Field(ge=10, le=10_000)] = _NODE.heartbeat_ms
    sdo_timeout_ms: Annotated[Integer, Field(ge=10, le=60_000)] = _NODE.sdo_timeout_ms
    _own_telegrams: Mapping[int, Telegram] = PrivateAttr({})

    def model_post_init(self, context: Surroundings | None, /) -> None:
        """Keep the user's own telegrams, which P922 can select too."""
        if context is not None:
            self._own_telegrams = context.telegrams

    def telegram_of(self, number: int) -> Telegram:
        """The telegram of the user's own with this number, else of this package; ProfidriveError lists the known ones."""
        return telegram(number, TELEGRAMS | self._own_telegrams)

    @property
    def chosen(self) -> Telegram:
        """The telegram of its number."""
        return self.telegram_of(self.telegram)

    @model_validator(mode="before")
    @classmethod
    def _dcf_is_a_data_sheet(cls, keys: object) -> object:
        if isinstance(keys, dict) and keys.get("eds") is None and keys.get("dcf") is not None:
            return {**keys, "eds": keys["dcf"]}
        return keys

    def device_values(self, section: str) -> DeviceValues:
        """The values that its device gets; see the function. ``section``: of its table."""
        return device_values(section, self.node_id, self.dcf, self.eds, self.objects)


class CanConfig(BaseModel):
    """One bus; keys this model does not know go to the python-can interface unchanged."""

    model_config = ConfigDict(extra="allow", frozen=True)

    interface: str
    channel: Annotated[str, Strict()] | Integer | None = None
    bitrate: Annotated[Integer, Field(ge=10_000, le=1_000_000)] | None = None
    name: str = "can"
    node_id: NodeId = DEFAULT_GATEWAY_NODE_ID
    """Node-ID of the gateway, which no other device of the bus may have."""

    @model_validator(mode="after")
    def _further_keys_are_meant(self) -> CanConfig:
        for key in self.extra:
            close = difflib.get_close_matches(key, type(self).model_fields, n=1, cutoff=_MISSPELT)
            if close:
                raise misplaced(f"{key}: unknown key; did you mean {close[0]}?", key)
        return self

    @property
    def extra(self) -> dict[str, object]:
        """Further keys for python-can."""
        return dict(self.model_extra or {})


DEFAULT_STATION_NAME = "pdgw"


def _is_station_name(text: str) -> str:
    try:
        if text:
            check_name(text)
    except ProfidriveError as error:
        raise ValueError(f"allowed: {error.allowed}") from error
    return text


def _has_prefix(value: object) -> object:
    """An address alone would be one of a network without neighbours."""
    if isinstance(value, str) and re.fullmatch(r"[\d.]+", value):
        raise ValueError(f'the prefix length is missing, such as "{value}/24" for the mask 255.255.255.0')
    return value


class TransportConfig(Section):
    """The transport to the PLC."""

    type: Literal["udp", "profinet"] = "udp"
    interface: Annotated[str, in_words(r"\S{1,15}", "the name of a network interface, 1 to 15 characters")] | None = (
        None
    )
    """Ethernet interface of ``profinet``."""
    ip: Annotated[IPv4Interface, BeforeValidator(_has_prefix)] | None = None
    """A fixed address with its prefix length; without it the controller or engineering tool gives one by DCP."""
    router: IPv4Address | None = None
    """The IP suite's standard gateway, with a fixed address."""
    snmp_community: Community | None = None
    """Community of the SNMP agent (``profinet``), usually "public"; None: no agent."""
    snmp_write_community: Community | None = None
    """Community that may write sysContact, sysName and sysLocation; None: none."""
    vendor_id: DeviceNumber = identity.VENDOR_ID
    device_id: DeviceNumber = identity.DEVICE_ID
    listen: IPv4Address = IPv4Address("127.0.0.1")
    cyclic_port: Port = CYCLIC_PORT
    acyclic_port: Port = ACYCLIC_PORT
    cycle_time_ms: Annotated[float, Strict(), Field(ge=0.25, le=512)] = USUAL_CYCLE_MS
    watchdog_factor: Annotated[Integer, Field(ge=1, le=WATCHDOG_FACTOR_MAX)] = WATCHDOG_FACTOR
    peer: IPv4Address | None = None
    direct: Boolean = False
    """Only cables and switches are between PLC and ``udp``: no frame is late. Loopback always is direct."""
    status_port: Port = STATUS_PORT
    """``pdgw status`` on loopback."""
    station_name: Annotated[str, AfterValidator(_is_station_name)] = DEFAULT_STATION_NAME
    """P61000; of ``profinet`` the name until DCP gives another one, "" for none: a controller may name the device then."""

    @property
    def delays(self) -> bool:
        """The network may keep the PLC's frames for seconds."""
        return self.type == "udp" and not self.direct and not self.listen.is_loopback

    @property
    def age_limit_ns(self) -> int | None:
        """Greatest age of a frame of the PLC: twice the watchdog time. None where no frame is late."""
        if not self.delays:
            return None
        return int(min(2 * self.cycle_time_ms * self.watchdog_factor, LONGEST_AGE_MS) * MS)

    @property
    def ip_suite(self) -> IpSuite | None:
        """The fixed address, if one is given."""
        return None if self.ip is None else IpSuite(self.ip.ip, self.ip.netmask, self.router or IPv4Address(0))

    @model_validator(mode="after")
    def _snmp_writes_by_another_community(self) -> TransportConfig:
        if self.snmp_write_community is not None and self.snmp_community in {None, self.snmp_write_community}:
            raise misplaced("snmp_write_community: needs a different snmp_community", "snmp_write_community")
        return self

    @model_validator(mode="after")
    def _is_one_transport(self) -> TransportConfig:
        if self.type == "profinet" and self.direct:
            raise misplaced('direct: allowed only with type = "udp" (PROFINET is always direct)', "direct")
        if self.delays and self.cycle_time_ms * self.watchdog_factor > LONGEST_AGE_MS:
            raise misplaced(
                f"watchdog_factor: {self.watchdog_factor} cycles of {self.cycle_time_ms:g} ms are more than "
                f"{LONGEST_AGE_MS} ms, the longest watchdog time of a network that may delay frames; lower it, or set "
                "direct = true if only cables and switches connect PLC and gateway",
                "watchdog_factor",
            )
        if self.type == "profinet" and self.interface is None:
            raise misplaced('interface is missing: type = "profinet" needs it, for example "eth1"', "type")
        if self.type != "profinet":
            if self.station_name != DEFAULT_STATION_NAME:
                raise misplaced('station_name: allowed only with type = "profinet"', "station_name")
            for key in ("interface", "ip", "router", "snmp_community", "snmp_write_community"):
                if getattr(self, key) is not None:
                    raise misplaced(f'{key}: allowed only with type = "profinet"', key)
        elif self.router is not None and (self.ip is None or self.router not in self.ip.network):
            raise misplaced("router: must be an address in the network of ip, and ip must be set", "router")
        elif self.ip_suite is not None:
            try:
                self.ip_suite.check()
            except ProfidriveError as error:
                raise misplaced(f"ip = {self.ip}: allowed: {error.allowed}", "ip") from error
        return self

    @model_validator(mode="after")
    def _peer_is_known(self) -> TransportConfig:
        if not self.listen.is_loopback and self.peer is None:
            raise misplaced(
                f"peer is missing: other computers can reach listen = {self.listen}, and the first sender would "
                "control the drives; set peer to the address of the PLC",
                "peer",
            )
        return self


class ParametersConfig(Section):
    """Access rights to the parameter channel."""

    write_from: tuple[IPv4Network, ...] | None = None
    """Addresses and networks parameters may be written from. None: all senders if ``listen`` is loopback, else none."""

    def writers(self, listen: IPv4Address) -> tuple[IPv4Network, ...] | None:
        """The networks that may write; None for all senders."""
        if self.write_from is None:
            return None if listen.is_loopback else ()
        return self.write_from


class TraceConfig(Section):
    """The flight recorder: the last minutes in RAM."""

    enabled: Boolean = True
    """False: nothing is recorded. True records where there is a run directory."""
    directory: Path | None = None
    """On a file system in RAM; None: systemd's RuntimeDirectory, or ``pdgw`` in the XDG run directory, or in /dev/shm."""
    seconds: Annotated[Integer, Field(ge=1, le=86_400)] = 120
    """Least time that the ring covers, if there is enough space."""
    megabytes: Annotated[Integer, Field(ge=1, le=4096)] = 32
    """All records together at most."""
    keep: tuple[Trigger, ...] = ()
    """Events with the seconds before and after them saved to a file in ``traces`` of the state directory."""
