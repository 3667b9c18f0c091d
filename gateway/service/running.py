"""The running gateway as those see it that are beside its cyclic exchange: parameters, status, flight recorder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.loop.loop import Loop
from pdgw.gateway.base.platform import Platform
from pdgw.gateway.base.store import DeviceParameters, ParameterStore
from pdgw.gateway.base.udp import Address
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.links.link import Link
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.objects.encoder import EncoderObject
from pdgw.gateway.service.cycle_times import CycleWatch
from pdgw.gateway.service.events import EventLog


class Service(Protocol):
    """Something that runs on the loop beside the cyclic exchange."""

    def start(self) -> None: ...

    def stop(self) -> None: ...


class Recording(Protocol):
    """A flight recorder, with the configuration that it records."""

    path: Path
    configuration: str


class Synchronising(Protocol):
    """What sends SYNC on a bus."""

    def status(self) -> dict[str, object]: ...


class RunningGateway(Protocol):
    """What ``gateway.daemon.daemon.Daemon`` is to them."""

    config: GatewayConfig
    platform: Platform
    loop: Loop
    store: ParameterStore
    networks: dict[str, CanNetwork]
    axes: list[Axis]
    encoders: list[EncoderObject]
    objects: list[DriveObject]
    link: Link
    watch: CycleWatch
    events: EventLog
    recorder: Recording | None
    cycle_ns: int
    started_ns: int
    file: tuple[str, float] | None

    @property
    def name(self) -> str: ...

    @property
    def address(self) -> Address: ...

    @property
    def notes(self) -> list[str]: ...

    @property
    def sync_producers(self) -> Mapping[str, Synchronising]: ...

    def check_telegram_change(self, changed: DriveObject, number: int, asked_by: str | None) -> None: ...

    def change_telegram(self, changed: DriveObject, number: int, asked_by: str | None = None) -> None: ...

    def update_store(self, change: Callable[[DeviceParameters], None]) -> None: ...
