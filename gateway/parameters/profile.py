"""The profile parameters of the gateway's drive objects, bound to axes, store and daemon.

DO 0 is the device. With a single axis it also answers for that axis, as a single-axis drive does; with several it has the
global parameters only. Source: docs/parameter-channel.md "Profile parameters".
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.load import DEFAULT_BITRATE
from pdgw.ds301.communication import LOAD_SIGNATURE, RESTORE_PARAMETERS, SAVE_SIGNATURE, STORE_PARAMETERS
from pdgw.dsp402.drive_type import DriveFault
from pdgw.dsp406.objects import (
    ALARMS,
    OFFSET,
    OPERATING_STATUS,
    OPERATING_TIME,
    SUPPORTED_ALARMS,
    SUPPORTED_WARNINGS,
    TOTAL_RANGE,
    UNITS_PER_REVOLUTION,
    VERSIONS,
    WARNINGS,
)
from pdgw.gateway.base import identity
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import DEVICE_WARNING, EMCY_WARNING, FaultNumber
from pdgw.gateway.base.store import DeviceParameters, DoParameters
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.objects.encoder import EncoderObject
from pdgw.gateway.objects.fault_buffer import fault_rows
from pdgw.gateway.parameters.bound_object import BoundObject
from pdgw.gateway.parameters.objects import ObjectAccess, ObjectParameter, RequestContext
from pdgw.gateway.parameters.signal_list import signal_list
from pdgw.gateway.service.running import RunningGateway
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.catalogue import (
    AXIS_CLASS,
    ENCODER_CLASS,
    ENCODER_IDENTIFICATION,
    NAME_SIZE,
    OBJECT_PNUS,
    PARAMETERS,
    PROFILE_IDENTIFICATION,
    ParameterSpec,
    bit_texts,
)
from pdgw.profidrive.parameters.codec import MAX_PARAMETERS
from pdgw.profidrive.parameters.description import Pnu
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber as Number
from pdgw.profidrive.parameters.error_numbers import ParameterRefused
from pdgw.profidrive.parameters.model import BoundParameter, Parameter
from pdgw.profidrive.sensor_format import encode_sensor_format
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import ApplicationMode
from pdgw.profinet.station import Station

log = logging.getLogger("gateway")

MAX_BLOCK = 4096
"""P974: longest parameter request and response, in bytes."""
_OPERATING_MODES = {ApplicationMode.VELOCITY: 1, ApplicationMode.POSITIONING: 2}
_MANUFACTURER_MODE = 0x8000
_ENCODER_CLASS_3 = 0x4000
"""P975: without isochronous operation."""
_STATUS_HEADER = 0x000C_0101
"""P65001: twelve elements, structure version 1.1."""
_STATUS_OBJECTS = (
    (OPERATING_STATUS, 0),
    (ALARMS, 0),
    (SUPPORTED_ALARMS, 0),
    (WARNINGS, 0),
    (SUPPORTED_WARNINGS, 0),
    (VERSIONS, 0),
    (OPERATING_TIME, 0),
    (OFFSET, 0),
    (UNITS_PER_REVOLUTION, 0),
    (TOTAL_RANGE, 0),
)
"""Elements 1 to 10 of P65001."""
_STEPS_PER_SECOND = 0
"""Element 11 of P65001: the unit of 6030h."""
_I32_MAX = (1 << 31) - 1
_FURTHER_WARNINGS = 1 << 13
"""P953: any of the warnings whose own bit is above the sixteenth."""
_WARNING_NAMES = {fault.warning_mask: fault.title for fault in FaultNumber if fault.is_warning} | {
    _FURTHER_WARNINGS: "number above 123",
    EMCY_WARNING: "EMCY",
    DEVICE_WARNING: "device warning",
}
_WARNING_TEXTS = bit_texts(_WARNING_NAMES.get(1 << bit, "reserved") for bit in range(16))


def _warning_word(warnings: int) -> int:
    """P953 of the warnings of a step."""
    return warnings & 0xFFFF | (_FURTHER_WARNINGS if warnings > 0xFFFF else 0)


def _unit(daemon: RunningGateway) -> tuple[int, ...]:
    transport = daemon.config.transport
    return identity.unit(transport.vendor_id, transport.device_id)


def _store_is_saved(daemon: RunningGateway, change: Callable[[DeviceParameters], None]) -> None:
    """Change stored parameters and write the file; the PLC gets an error when it cannot be written, and nothing changes."""
    try:
        daemon.update_store(change)
    except GatewayError as error:
        log.error("%s", error)
        raise ParameterRefused(Number.NOT_EXECUTABLE_IN_STATE) from error


class NodeObject(BoundObject):
    """A drive object with a node: common part of axes and encoders."""

    def __init__(self, daemon: RunningGateway, owner: DriveObject) -> None:
        super().__init__(owner.do_id)
        self.daemon = daemon
        self.owner = owner
        self.access = ObjectAccess(owner)
        self._reset_prepared = 0
        self._bind_common()

    @property
    def _stored(self) -> DoParameters:
        return self.daemon.store.parameters.drive_object(self.do_id)

    def parameter(self, pnu: int, context: RequestContext) -> Parameter:
        return ObjectParameter(self.access, pnu, context) if pnu in OBJECT_PNUS else super().parameter(pnu, context)

    def check_writable(self, pnu: int) -> None:
        if pnu != Pnu.OPERATION_PRIORITY and not self._stored.operation_priority:
            raise ParameterRefused(Number.NO_OPERATION_PRIORITY)

    def further_pnus(self) -> Iterable[int]:
        return (index for index in self.owner.client.sdo.dictionary if index in OBJECT_PNUS)

    def _bind_common(self) -> None:
        owner, log_ = self.owner, self.owner.fault_log
        bus = self.daemon.config.bus_of(owner.config)
        self.bind(Pnu.SETPOINT_SIGNALS, lambda: [item.number for item in owner.telegram.setpoints.signals])
        self.bind(Pnu.ACTUAL_SIGNALS, lambda: [item.number for item in owner.telegram.actuals.signals])
        self.bind(Pnu.NODE_ADDRESS, lambda: owner.node_id)
        self.bind(Pnu.DEVICE_NAME, self._name)
        self._parameters[Pnu.TELEGRAM] = lambda context: BoundParameter(
            PARAMETERS[Pnu.TELEGRAM],
            lambda: owner.telegram.number,
            lambda number: self._select_telegram(number, context.host),
        )
        self.bind(Pnu.SIGNAL_LIST, signal_list)
        masks = tuple(signal(name).bit("SIGN_OF_LIFE").mask for name in ("ZSW2", "STW2"))
        self.bind(Pnu.SIGN_OF_LIFE_BIT, lambda: masks)
        self.bind(Pnu.SIGN_OF_LIFE_TOLERANCE, lambda: self._stored.sign_of_life_tolerance, self._set_tolerance)
        self.bind(
            Pnu.OPERATION_PRIORITY, lambda: self._stored.operation_priority, partial(self._store, "operation_priority")
        )
        self.bind(Pnu.CONTROL_PRIORITY, lambda: 1, lambda _: None)
        self.bind(Pnu.FAULT_COUNTER, lambda: log_.buffer.counter)
        self.bind(Pnu.FAULT_CODE, lambda: [fault.code for fault in log_.entries()])
        self.bind(Pnu.FAULT_CODE_LIST, lambda: [code for _, code, _ in fault_rows(self._own_faults)])
        self.bind(
            Pnu.FAULT_NUMBER_LIST,
            lambda: [number for number, _, _ in fault_rows(self._own_faults)],
            texts=self._fault_texts,
        )
        self.bind(Pnu.FAULT_NUMBER, lambda: [fault.number for fault in log_.entries()], texts=self._fault_texts)
        self.bind(Pnu.FAULT_TIME, lambda: [fault.time_ms for fault in log_.entries()])
        self.bind(Pnu.FAULT_VALUE, lambda: [fault.value for fault in log_.entries()])
        self.bind(Pnu.FAULT_SITUATIONS, lambda: log_.buffer.situations, self._clear_faults)
        self.bind(Pnu.WARNING_WORD, lambda: _warning_word(owner.outputs.warning), texts=lambda: _WARNING_TEXTS)
        self.bind(Pnu.BAUD_RATE, lambda: (bus.bitrate or DEFAULT_BITRATE) // 1000)
        self.bind_action(Pnu.LOAD, self.load)
        self.bind_action(Pnu.SAVE, self.save)
        self.bind(Pnu.RESET, lambda: self._reset_prepared, self._reset)

    @property
    def _own_faults(self) -> Mapping[int, DriveFault]:
        """The manufacturer's fault numbers."""
        return {}

    def _fault_texts(self) -> Sequence[str]:
        return [text[:NAME_SIZE] for _, _, text in fault_rows(self._own_faults)]

    def _name(self) -> bytes:
        return (self._stored.name or f"{self.owner.kind} {self.do_id}").encode()

    def _store(self, name: str, value: int | None) -> None:
        _store_is_saved(self.daemon, lambda stored: setattr(stored.drive_object(self.do_id), name, value))

    def _set_tolerance(self, failures: int) -> None:
        self._store("sign_of_life_tolerance", failures)
        self.owner.set_sign_of_life_tolerance(failures)

    def _select_telegram(self, number: int, host: str | None) -> None:
        if number not in self.owner.telegram_numbers:
            raise ParameterRefused(Number.VALUE_IMPERMISSIBLE)
        self._telegram(self.daemon.check_telegram_change, number, host)
        before = self._stored.telegram
        self._store("telegram", number)
        try:
            self._telegram(self.daemon.change_telegram, number, host)
        except ParameterRefused:
            self._store("telegram", before)
            raise

    def _telegram(self, act: Callable[[DriveObject, int, str | None], None], number: int, host: str | None) -> None:
        """Check or change to another telegram; ParameterRefused, with the reason in the log, if this is not possible now."""
        if number == self.owner.telegram.number:
            return
        try:
            act(self.owner, number, host)
        except (GatewayError, ProfidriveError, CanopenError) as error:
            log.warning("DO %d: P922 := %d refused: %s", self.do_id, number, error)
            raise ParameterRefused(Number.NOT_EXECUTABLE_IN_STATE) from error

    def _clear_faults(self, value: int) -> None:
        if value:
            raise ParameterRefused(Number.SETTING_NOT_PERMITTED)
        self.owner.clear_faults()

    def require_power_off(self) -> None:
        """ParameterRefused while something may move."""
        if self.owner.powered:
            raise ParameterRefused(Number.NOT_EXECUTABLE_IN_STATE)

    def may_load(self, context: RequestContext) -> bool:
        """Whether the configured telegram can be selected now."""
        configured = self.owner.config.telegram
        try:
            if configured != self.owner.telegram.number:
                self.daemon.check_telegram_change(self.owner, configured, context.host)
        except (GatewayError, CanopenError):
            return False
        return True

    def load(self, context: RequestContext) -> None:
        """P970: the node's factory values (1011h) after a restart of it, the gateway's own as configured."""
        self.require_power_off()
        configured = self.owner.config.telegram
        self._telegram(self.daemon.check_telegram_change, configured, context.host)
        before = self._stored.model_copy()
        self._replace_stored(DoParameters(own_values=before.own_values, device=before.device))
        try:
            self.access.write(RESTORE_PARAMETERS, 1, LOAD_SIGNATURE.to_bytes(4, "little"), context)
            self._telegram(self.daemon.change_telegram, configured, context.host)
        except ParameterRefused:
            self._replace_stored(before.model_copy(update={"own_values": self._stored.own_values}))
            raise
        self.owner.set_sign_of_life_tolerance(self._stored.sign_of_life_tolerance)

    def _replace_stored(self, parameters: DoParameters) -> None:
        _store_is_saved(self.daemon, lambda stored: stored.objects.update({self.do_id: parameters}))

    def save(self, context: RequestContext) -> None:
        """P971: 1010h of the node, and the gateway's store."""
        self.access.write(STORE_PARAMETERS, 1, SAVE_SIGNATURE.to_bytes(4, "little"), context)
        _store_is_saved(self.daemon, lambda _: None)

    def _reset(self, value: int) -> None:
        if value:
            self.require_power_off()
        if value == 1:
            self.owner.reset_node()
        self._reset_prepared = 2 if value == 2 else 0


class AxisObject(NodeObject):
    """The drive object of an axis."""

    def __init__(self, daemon: RunningGateway, axis: Axis) -> None:
        super().__init__(daemon, axis)
        self.axis = axis
        self.bind(Pnu.OPERATING_MODE, self._operating_mode)
        self.bind(Pnu.PROFILE, lambda: PROFILE_IDENTIFICATION)
        self.bind(Pnu.STW1, lambda: axis.last_setpoints[0] if axis.last_setpoints else 0)
        self.bind(Pnu.ZSW1, lambda: axis.actuals[0])
        self.bind(Pnu.DRIVE_OBJECT, lambda: (*_unit(daemon), AXIS_CLASS, axis.telegram.class_bits, self.do_id))
        self.bind(Pnu.SENSOR_FORMAT, lambda: encode_sensor_format(axis.sensor_formats))
        self.bind(Pnu.REFERENCE_SPEED, self._reference_speed)
        self.bind_lists()

    @property
    def _own_faults(self) -> Mapping[int, DriveFault]:
        return self.axis.manufacturer_faults

    def _operating_mode(self) -> int:
        telegram = self.axis.telegram
        return _OPERATING_MODES.get(telegram.setpoints.mode, _MANUFACTURER_MODE | telegram.number)

    def _reference_speed(self) -> float:
        drive = self.axis.drive.drive_type
        if drive is None or drive.scaling.rated_speed_rpm is None:
            raise ParameterRefused(Number.NOT_EXECUTABLE_IN_STATE)
        return float(drive.scaling.rated_speed_rpm)


class EncoderChannelObject(NodeObject):
    """The drive object of an encoder's channel."""

    def __init__(self, daemon: RunningGateway, encoder: EncoderObject) -> None:
        super().__init__(daemon, encoder)
        self.encoder = encoder
        identification = ENCODER_IDENTIFICATION.to_bytes(2, "big")
        self.bind(Pnu.PROFILE, lambda: identification, data_type=DataType.OCTET_STRING)
        self.bind(Pnu.DRIVE_OBJECT, lambda: (*_unit(daemon), ENCODER_CLASS, _ENCODER_CLASS_3, self.do_id))
        self.bind(Pnu.SENSOR_FORMAT, lambda: encode_sensor_format([encoder.sensor_format]))
        self.bind(Pnu.REFERENCE_SPEED, lambda: float(encoder.config.reference_speed))
        self._parameters[Pnu.PRESET_VALUE] = lambda _: BoundParameter(
            self._preset_spec(), lambda: encoder.preset_value, self._set_preset
        )
        self._parameters[Pnu.OPERATING_STATUS] = lambda context: BoundParameter(
            PARAMETERS[Pnu.OPERATING_STATUS], lambda: self._operating_status(context)
        )
        self.bind_lists()

    def _preset_spec(self) -> ParameterSpec:
        """P65000: a position, or for a relative preset a shift below the total range in either direction."""
        spec, references = PARAMETERS[Pnu.PRESET_VALUE], self.encoder.references
        if references is None or references.total_range > _I32_MAX:
            return spec
        return replace(spec, low=1 - references.total_range, high=references.total_range - 1)

    def _set_preset(self, value: int) -> None:
        self.encoder.preset_value = value

    def _operating_status(self, context: RequestContext) -> Sequence[int]:
        """Read the status from the encoder; missing objects are 0."""
        values = [_STATUS_HEADER]
        for index, subindex in _STATUS_OBJECTS:
            try:
                raw = self.access.read(index, subindex, context)
            except ParameterRefused as refused:
                if refused.number not in {Number.IMPERMISSIBLE_PNU, Number.FAULTY_SUBINDEX}:
                    raise
                raw = b""
            # Unsigned32 values above the range of the parameter keep their bits.
            value = int.from_bytes(raw[:4].ljust(4, b"\0"), "little")
            values.append(value - (1 << 32) if value >> 31 else value)
        return (*values, _STEPS_PER_SECOND)


class DeviceObject(BoundObject):
    """DO 0: the device; also every DO's global parameters."""

    def __init__(self, daemon: RunningGateway, axes: Sequence[NodeObject]) -> None:
        super().__init__(0)
        config = daemon.config
        address = config.transport.listen.packed
        self._axes = axes
        if len(axes) != 1:
            self.bind(Pnu.NODE_ADDRESS, lambda: config.can[0].node_id)
            self.bind(Pnu.DEVICE_NAME, identity.ORDER_ID.encode)
        self.bind(Pnu.DRIVE_UNIT, lambda: (*_unit(daemon), len(axes)))
        self.bind(Pnu.PROFILE, lambda: PROFILE_IDENTIFICATION)
        latency = int(config.parameter_timeout_ms / 10)
        self.bind(Pnu.PARAMETER_ACCESS, lambda: (MAX_BLOCK, MAX_PARAMETERS, latency))
        self.bind(Pnu.DRIVE_OBJECT, lambda: (*_unit(daemon), 0, 0, 0))
        self.bind_action(Pnu.LOAD_DEVICE, self._load_all)
        self.bind_action(Pnu.SAVE_DEVICE, self._save_all)
        self.bind(Pnu.DRIVE_OBJECTS, lambda: [axis.do_id for axis in axes])
        self.bind(Pnu.STATION_NAME, config.transport.station_name.encode)
        self.bind(Pnu.STATION_IP, lambda: address)
        # The UDP transport has no Ethernet parameters of its own; the operating system manages the host's addresses.
        self.bind(Pnu.STATION_MAC, lambda: bytes(6))
        self.bind(Pnu.STATION_GATEWAY, lambda: bytes(4))
        self.bind(Pnu.STATION_MASK, lambda: bytes(4))
        if daemon.config.transport.type == "profinet":
            from pdgw.gateway.links.profinet.io_device import (  # noqa: PLC0415 (the other transport starts without)
                ProfinetLink,
            )

            assert isinstance(daemon.link, ProfinetLink)
            self._bind_station(daemon.link.station)
        for axis in axes:
            axis.adopt(self)
            axis.bind_lists()
        if len(axes) == 1:
            self.adopt(axes[0])
        self.bind_lists()

    def _bind_station(self, station: Station) -> None:
        self.bind(Pnu.STATION_NAME, lambda: bytes(station.name, "ascii"))
        self.bind(Pnu.STATION_IP, lambda: station.ip.address.packed)
        self.bind(Pnu.STATION_MAC, lambda: station.identity.mac)
        self.bind(Pnu.STATION_GATEWAY, lambda: station.ip.gateway.packed)
        self.bind(Pnu.STATION_MASK, lambda: station.ip.mask.packed)

    def _load_all(self, context: RequestContext) -> None:
        for axis in self._axes:
            axis.require_power_off()
        remaining = list(self._axes)
        while remaining:
            # The telegram of another axis may need the room on the bus that this one leaves.
            axis = next((item for item in remaining if item.may_load(context)), remaining[0])
            remaining.remove(axis)
            axis.load(context)

    def _save_all(self, context: RequestContext) -> None:
        for axis in self._axes:
            axis.save(context)

    def parameter(self, pnu: int, context: RequestContext) -> Parameter:
        if pnu in OBJECT_PNUS and len(self._axes) == 1:
            return self._axes[0].parameter(pnu, context)
        return super().parameter(pnu, context)

    def check_writable(self, pnu: int) -> None:
        if len(self._axes) == 1:
            self._axes[0].check_writable(pnu)

    def further_pnus(self) -> Iterable[int]:
        return self._axes[0].further_pnus() if len(self._axes) == 1 else ()
