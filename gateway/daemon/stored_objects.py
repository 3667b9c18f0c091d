"""The drive objects of a configuration, with what the parameter store has of each; what they learn is stored."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial

from pdgw.base.errors import PdgwError
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.values import KnownDevice
from pdgw.dsp402.drive.own_values import OwnValues
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.store import DeviceParameters, DoParameters, ParameterStore
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.axis_chain import axis_enable_status
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.objects.enable_chain import encoder_enable_status
from pdgw.gateway.objects.encoder import EncoderNode, EncoderObject
from pdgw.gateway.service.events import EventLog

log = logging.getLogger("gateway")


@contextmanager
def telegrams_named(replaced: Sequence[str]) -> Iterator[None]:
    """A stored telegram (P922) may not fit the configuration, and its file does not show it: name it in the error.

    ``replaced``: a line for each of them.
    """
    try:
        yield
    except PdgwError as error:
        if not replaced:
            raise
        raise GatewayError("; ".join((str(error), "correct this for one start", *replaced))) from error


def connect(axes: Sequence[Axis], encoders: Sequence[EncoderObject]) -> None:
    """Connect the encoders that are sensors of axes, and what finds the status of each."""
    by_do = {encoder.do_id: encoder for encoder in encoders}
    for encoder in encoders:
        encoder.check_chain = partial(encoder_enable_status, encoder)
    for axis in axes:
        axis.check_chain = partial(axis_enable_status, axis)
        for place, source in enumerate((axis.config.g1, axis.config.g2)):
            if isinstance(source, int):
                axis.connect_sensor(by_do[source], place)


class StoredObjects:
    """Makes drive objects. ``update``: changes stored parameters; GatewayError when the file cannot be written."""

    def __init__(
        self,
        config: GatewayConfig,
        networks: Mapping[str, CanNetwork],
        store: ParameterStore,
        events: EventLog,
        update: Callable[[Callable[[DeviceParameters], None]], None],
    ) -> None:
        self._config, self._networks = config, networks
        self._store, self._update = store, update
        self._events = events

    def axis(self, config: AxisConfig) -> Axis:
        """An axis with its node."""
        network = self._networks[self._config.bus_of(config).name]
        stored = self._store.parameters.drive_object(config.do_id)
        failures = stored.sign_of_life_tolerance
        axis = Axis(config, network, self._config.transport.cycle_time_ms, stored.telegram, failures)
        axis.units_witnessed = stored.units_witnessed
        axis.drive.own_values.load(stored.own_values)
        axis.drive.own_values.save = partial(self._save_own_values, axis)
        self._know_device(axis, stored)
        return axis

    def encoders(self) -> tuple[list[EncoderNode], list[EncoderObject]]:
        """The encoders' nodes, and their channels in the order of the configuration."""
        nodes: list[EncoderNode] = []
        made: dict[int, EncoderObject] = {}
        for bus in self._config.can:
            for channels in self._config.encoders_of(bus).values():
                node = EncoderNode(self._networks[bus.name], channels, self._config.transport.cycle_time_ms)
                nodes.append(node)
                for config in channels:
                    stored = self._store.parameters.drive_object(config.do_id)
                    number = config.telegram if stored.telegram is None else stored.telegram
                    made[config.do_id] = EncoderObject(config, node, number, stored.sign_of_life_tolerance)
                self._know_device(made[channels[0].do_id], self._store.parameters.drive_object(channels[0].do_id))
        return nodes, [made[config.do_id] for config in self._config.encoder]

    def _know_device(self, item: DriveObject, stored: DoParameters) -> None:
        """Set the last device of its client, and keep the next one."""
        configuration, do_id = item.client.configuration, item.do_id
        configuration.known = stored.device
        if self._store.path is not None:
            configuration.save = partial(self._save_device, item)
        configuration.on_replaced = lambda text: self._events.add("node", do_id, text)

    def _save_device(self, item: DriveObject, device: KnownDevice) -> None:
        def change(parameters: DeviceParameters) -> None:
            parameters.drive_object(item.do_id).device = device

        try:
            self._update(change)
        except GatewayError as error:
            log.error("%s: the serial number of its device is not saved: %s", item.label, error)

    def _save_own_values(self, axis: Axis, values: OwnValues) -> bool:
        """True when saved. Without a store, or if it cannot be written, the log says what a crash loses; the axis runs."""

        def change(parameters: DeviceParameters) -> None:
            parameters.drive_object(axis.do_id).own_values = values

        try:
            self._update(change)
        except GatewayError as error:
            log.error("%s: the drive's own limits are not saved: %s", axis.label, error)
            return False
        if self._store.path is None and values.values:
            texts = ", ".join(item.text(item.value) for item in values.values)
            log.warning("%s: no parameter store: a crash of the gateway loses the drive's own %s", axis.label, texts)
        return True
