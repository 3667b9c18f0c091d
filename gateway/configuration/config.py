"""The configuration file: TOML, validated by pydantic, with messages a user can act on.

Keys of [can], [transport] and [[axis]] are fixed, others have defaults; encoders are in ``gateway.configuration.devices``,
what surrounds the drive objects in ``gateway.configuration.environment``, reading a file in
``gateway.configuration.file``. Left out: the PLC's own parameters, which live in the parameter store.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, ValidationInfo, model_validator

from pdgw.base.validation import misplaced
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.load import DEFAULT_BITRATE, CyclicFrames, check_load
from pdgw.ds301.node.plan import PdoPlan
from pdgw.dsp402.identification.overlay import NO_CHOICE, Families, Overlay
from pdgw.gateway.axis.telegrams import DSC_TELEGRAM_NUMBERS, has_second_sensor, may_have_own_encoder
from pdgw.gateway.base.errors import at_most
from pdgw.gateway.base.store import default_store
from pdgw.gateway.configuration.axis_config import AxisConfig, Place, as_list
from pdgw.gateway.configuration.bus_load import cyclic_frames
from pdgw.gateway.configuration.devices import EncoderConfig, TelegramConfig
from pdgw.gateway.configuration.environment import (
    CanConfig,
    DisplayName,
    Integer,
    ParametersConfig,
    Section,
    Surroundings,
    TraceConfig,
    TransportConfig,
)
from pdgw.gateway.configuration.web import MqttConfig, WebConfig
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import CSduLayout
from pdgw.profidrive.telegrams import TELEGRAMS, Direction, Telegram, by_number

FORMAT_VERSION: Final = 1
_PARAMETER_TIMEOUT_MS: Final = 2000


Item = TypeVar("Item", AxisConfig, EncoderConfig)


def _by_number(tables: tuple[TelegramConfig, ...]) -> tuple[TelegramConfig, ...]:
    """Each number has one layout."""
    for place in range(len(tables)):
        try:
            by_number(item.own for item in tables[: place + 1])
        except ProfidriveError as error:
            raise misplaced(str(error), place) from error
    return tables


def _among_own(axis: object, info: ValidationInfo) -> AxisConfig:
    """An axis, which may have one of the telegrams of the file."""
    own = by_number(item.own for item in info.data.get("telegram", ()))
    return AxisConfig.model_validate(axis, context=replace(info.context or Surroundings(), telegrams=own))


def _share_families(axes: tuple[AxisConfig, ...]) -> tuple[AxisConfig, ...]:
    """A drive may be of the family that another axis names: its identity decides."""
    own: dict[str, Overlay] = {}
    for place, axis in enumerate(axes):
        for item in axis.families.own:
            if own.setdefault(item.name, item) != item:
                text = f"family = {axis.family!r}: set another file name: there is a family {item.name} already"
                raise misplaced(text, place, "family")
    return tuple(axis.with_families(tuple(own.values())) for axis in axes)


class GatewayConfig(Section):
    """The whole file."""

    version: Annotated[Integer, AfterValidator(at_most(FORMAT_VERSION))] = FORMAT_VERSION
    """Version of the format; a file without it has the first version."""
    name: DisplayName | None = None
    """Name of the gateway; None: "pdgw", with PROFINET the name of station."""
    telegram: Annotated[tuple[TelegramConfig, ...], BeforeValidator(as_list), AfterValidator(_by_number)] = ()
    """Telegrams of the user's own. Before the axes, which may have them."""
    can: Annotated[tuple[CanConfig, ...], BeforeValidator(as_list), Field(min_length=1)]
    transport: TransportConfig = TransportConfig()
    parameters: ParametersConfig = ParametersConfig()
    axis: Annotated[
        tuple[Annotated[AxisConfig, BeforeValidator(_among_own)], ...],
        BeforeValidator(as_list),
        AfterValidator(_share_families),
    ] = ()
    encoder: Annotated[tuple[EncoderConfig, ...], BeforeValidator(as_list)] = ()
    """The drive objects of the frame: all axes, then all encoders, each in their order."""
    trace: TraceConfig = TraceConfig()
    web: WebConfig = WebConfig()
    mqtt: MqttConfig | None = None
    store: Path | None = None
    """File of the non-volatile gateway parameters; ``load_config`` puts one in the state directory where none is given."""
    _file: Path | None = PrivateAttr(None)

    @property
    def file(self) -> Path | None:
        """The whole path of the configuration file, if ``store`` is its default one."""
        return self._file

    def of_file(self, file: Path) -> GatewayConfig:
        """The same with the default store of a file."""
        made = self.model_copy(update={"store": default_store(file)})
        made._file = file.resolve()
        return made

    @property
    def parameter_timeout_ms(self) -> int:
        """A parameter request is answered within this time; what the device has not answered by then fails.

        The slowest device may use its whole ``sdo_timeout_ms``.
        """
        return max([_PARAMETER_TIMEOUT_MS, *(item.sdo_timeout_ms for item in self.objects)])

    @property
    def telegrams(self) -> dict[int, Telegram]:
        """Every telegram by its number: those of this package, and the user's own."""
        return TELEGRAMS | by_number(item.own for item in self.telegram)

    @property
    def families(self) -> Families:
        """Every family of drives, the user's own among them."""
        return Families(self.axis[0].families.own) if self.axis else NO_CHOICE

    @property
    def objects(self) -> tuple[AxisConfig | EncoderConfig, ...]:
        """In the order of the frame."""
        return (*self.axis, *self.encoder)

    def with_telegrams(self, numbers: Mapping[int, int]) -> GatewayConfig:
        """The same with these telegrams, by DO-ID: those that are stored (P922) replace those of the file."""

        def changed(item: Item) -> Item:
            return item.model_copy(update={"telegram": numbers.get(item.do_id, item.telegram)})

        axes, encoders = tuple(map(changed, self.axis)), tuple(map(changed, self.encoder))
        return self.model_copy(update={"axis": axes, "encoder": encoders})

    def replaced_telegrams(self, numbers: Mapping[int, int]) -> list[str]:
        """One line for each telegram that differs from those of the file."""
        return [
            f"DO {item.do_id}: telegram {number} is stored (P922) and replaces telegram {item.telegram} of the configuration; "
            f'to return to it, run "pdgw param write P922 {item.telegram} --do {item.do_id}"'
            for item in self.objects
            if (number := numbers.get(item.do_id, item.telegram)) != item.telegram
        ]

    def bus_of(self, axis: AxisConfig | EncoderConfig) -> CanConfig:
        """The bus an axis or encoder is on."""
        if axis.can is None:
            return self.can[0]
        return next(bus for bus in self.can if bus.name == axis.can)

    @model_validator(mode="after")
    def _fits_together(self) -> GatewayConfig:
        names = [bus.name for bus in self.can]
        buses = [("can", number) for number in range(len(names))]
        _no_twice("name", names, buses, "name")
        ends = [(bus.interface, bus.channel, bus.extra) for bus in self.can]
        _no_twice("interface and channel", ends, buses, "channel")
        transport = self.transport
        if transport.cyclic_port == transport.acyclic_port != 0:
            text = f"cyclic_port and acyclic_port are both {transport.cyclic_port}; set two different ports"
            raise misplaced(text, "transport", "acyclic_port")
        if not self.objects:
            raise misplaced("[[axis]] or [[encoder]]: at least one is needed")
        _no_twice("do_id", [item.do_id for item in self.objects], self._places, "do_id")
        named = [(place, item.name) for place, item in zip(self._places, self.objects, strict=True) if item.name]
        _no_twice("name", [name for _, name in named], [place for place, _ in named], "name")
        for place, item in zip(self._places, self.objects, strict=True):
            if item.can is not None and item.can not in names:
                raise misplaced(
                    f'can = "{item.can}" is not the name of a [[can]] table, allowed: {names}', *place, "can"
                )
            if item.can is None and len(names) > 1:
                raise misplaced(f"can is missing: several buses need it; allowed: {names}", *place)
        self._check_nodes()
        self._check_sensors()
        try:
            telegrams = [item.chosen for item in self.objects]
            for direction in Direction:
                CSduLayout(telegrams, direction)
            for number, bus in enumerate(self.can):
                try:
                    self.check_load(bus)
                except CanopenError as error:
                    raise misplaced(str(error), "can", number) from error
        except ProfidriveError as error:
            raise misplaced(str(error)) from error
        return self

    @property
    def _places(self) -> list[Place]:
        """The line of each of ``objects`` in the file."""
        sections = (("axis", self.axis), ("encoder", self.encoder))
        return [(section, number) for section, items in sections for number in range(len(items))]

    def check_load(self, bus: CanConfig) -> None:
        """CanopenError if the worst-case frames do not fit on the bus. A virtual bus without a bit rate has no limit."""
        if bus.interface != "virtual" or bus.bitrate is not None:
            check_load(bus.name, self.frames_of(bus), bus.bitrate or DEFAULT_BITRATE)

    def frames_of(self, bus: CanConfig, plans: Mapping[int, PdoPlan] | None = None) -> list[CyclicFrames]:
        """The cyclic frames of a bus in the worst case. ``plans``: of axes whose drives were read, by node-ID."""
        cycle_ms = self.transport.cycle_time_ms
        return cyclic_frames(self.axes_of(bus), self.encoders_of(bus), cycle_ms, bus.node_id, plans)

    def _check_nodes(self) -> None:
        for bus in self.can:
            on_bus = [
                (place, item)
                for place, item in zip(self._places, self.objects, strict=True)
                if self.bus_of(item).name == bus.name
            ]
            devices: dict[int, EncoderConfig] = {}
            nodes: list[int] = []
            channels: list[tuple[int, int]] = []
            node_places: list[Place] = []
            channel_places: list[Place] = []
            for place, item in on_bus:
                if item.node_id == bus.node_id:
                    raise misplaced(
                        f"node_id = {item.node_id} is that of the gateway on bus {bus.name}; set another [can] node_id, or give "
                        "the device another node-ID",
                        *place,
                        "node_id",
                    )
                if isinstance(item, AxisConfig) or item.node_id not in devices:
                    nodes.append(item.node_id)
                    node_places.append(place)
                if isinstance(item, EncoderConfig):
                    first = devices.setdefault(item.node_id, item)
                    channels.append((item.node_id, item.channel))
                    channel_places.append(place)
                    if first.device_keys != item.device_keys:
                        raise misplaced(
                            f"do_id {item.do_id} differs from do_id {first.do_id}, another channel of node "
                            f"{item.node_id}, in a key that applies to the whole device",
                            *place,
                        )
            one = "one node is one [[axis]] or [[encoder]], and further axes of a device (6800h) are not supported"
            _no_twice(f"node_id on bus {bus.name}", nodes, node_places, "node_id", one)
            _no_twice(f"node_id and channel on bus {bus.name}", channels, channel_places, "channel")

    def _check_sensors(self) -> None:
        encoders = [item.do_id for item in self.encoder]
        for number, axis in enumerate(self.axis):
            for key, value, fits in (("g1", axis.g1, may_have_own_encoder), ("g2", axis.g2, has_second_sensor)):
                problem = ""
                if value is not None and not fits(axis.chosen):
                    dsc = key == "g1" and axis.chosen.base in DSC_TELEGRAM_NUMBERS
                    numbers = [number for number, item in axis.drive_telegrams.items() if fits(item)]
                    reason = "closes its position loop in the drive (DSC)" if dsc else f"has no {key.upper()}"
                    problem = f": telegram {axis.telegram} {reason}, allowed with telegram {numbers}"
                elif isinstance(value, int) and value not in encoders:
                    problem = f" is not the do_id of an [[encoder]], allowed: {encoders}"
                if problem:
                    raise misplaced(f"{key} = {value}{problem}", "axis", number, key)
            if axis.g2 is not None and axis.g2 == axis.g1:
                text = f"g2 = {axis.g2} is already used by g1; one encoder has one control word: set another encoder"
                raise misplaced(text, "axis", number, "g2")

    def encoders_of(self, bus: CanConfig) -> dict[int, list[EncoderConfig]]:
        """The channels of each encoder on a bus, by node-ID."""
        nodes: dict[int, list[EncoderConfig]] = {}
        for item in self.encoder:
            if self.bus_of(item).name == bus.name:
                nodes.setdefault(item.node_id, []).append(item)
        return nodes

    def axes_of(self, bus: CanConfig) -> list[AxisConfig]:
        """The axes of a bus."""
        return [axis for axis in self.axis if self.bus_of(axis).name == bus.name]


def _no_twice(
    what: str, values: Sequence[Any], places: Sequence[Place], key: str, allowed: str = "each must be different"
) -> None:
    for position, (value, place) in enumerate(zip(values, places, strict=True)):
        if value in values[:position]:
            raise misplaced(f"{what}: {value!r} is used twice; {allowed}", *place, key)
