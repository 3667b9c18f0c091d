"""The table of an axis: one drive and its telegram."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from math import ceil
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, ValidationInfo, model_validator

from pdgw.base.durations import MS, US_PER_MS
from pdgw.base.validation import misplaced
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.identification.overlay import NO_CHOICE, Families, Overlay, overlay, own_family
from pdgw.dsp402.pdo.layouts import PdoLayout
from pdgw.dsp402.units.mechanics import UnitKeys, check_unit_keys, unit_object
from pdgw.gateway.axis.settings import (
    AxisSettings,
    ControlLost,
    LastStop,
    PlcLossReaction,
    SecondSensor,
    SetpointEnable,
)
from pdgw.gateway.axis.telegrams import (
    CENTRAL_TELEGRAM_NUMBERS,
    DSC_TELEGRAM_NUMBERS,
    FLOAT_TELEGRAM_NUMBERS,
    POSITIONER_TELEGRAM_NUMBERS,
    TASK_TELEGRAM_NUMBERS,
    drive_layout,
    drive_telegrams,
    initial_mode,
)
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.environment import (
    Boolean,
    DriveObjectSection,
    Integer,
    Simulated,
    Surroundings,
)
from pdgw.gateway.configuration.positioner_config import BlockConfig, PositionerConfig
from pdgw.gateway.motion.dsc_setpoint import DELAY_CYCLES_MAX, FOLLOWING_WINDOW_MAX, DscChoices, DscForm
from pdgw.profidrive.telegrams import TELEGRAMS, Telegram

_AXIS: Final = AxisSettings()
_NODE: Final = DriveSettings(node_id=1)
_DSC: Final = DscChoices(DscForm.SPEED, following_window=1)
"""Defaults of the keys that the file does not set."""
Place = tuple[str, int]
"""Section and number of its table."""


def _fraction(value: object) -> object:
    """A number as it is written (0.1 is a tenth), or a ratio such as "10/3"."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return value
    try:
        return Fraction(str(value).replace(" ", ""))
    except (ValueError, ZeroDivisionError) as error:
        raise ValueError(f'{value!r} is not a number or ratio, expected for example 3000, 0.5 or "10/3"') from error


def _percent(value: object) -> object:
    """A number in percent; a fraction stays one."""
    found = _fraction(value)
    return found / 100 if isinstance(found, Fraction) and found is not value else found


_REACTION_MARGIN = 2
Ratio = Annotated[Fraction, BeforeValidator(_fraction), Field(gt=0, le=10**12)]
UnitObject = Annotated[int, BeforeValidator(unit_object)]
SignedRatio = Annotated[Fraction, BeforeValidator(_fraction), Field(ge=-(10**6), le=10**6)]


def as_list(value: object) -> object:
    """A table in place of an array of tables."""
    return [value] if isinstance(value, dict) else value


def _family(family: str, info: ValidationInfo) -> str:
    """A family by name, or the whole path of the file of an own one."""
    try:
        if not family.endswith(".toml"):
            return overlay(family).name
        path = (info.context or Surroundings()).folder / family
        own_family(path)
        return str(path.resolve())
    except Dsp402Error as error:
        raise ValueError(str(error)) from error


class AxisConfig(DriveObjectSection):
    """One drive and its telegram."""

    on_plc_loss: PlcLossReaction = _AXIS.on_plc_loss
    setpoint_enable: SetpointEnable = _AXIS.setpoint_enable
    control_lost: ControlLost = _AXIS.control_lost
    stop_time_ms: Annotated[Integer, Field(ge=10, le=600_000)] = _AXIS.stop_time_ns // MS
    """Time from 100 % speed to standstill with the drive's own ramps (6084h, 6085h)."""
    last_stop: LastStop = _AXIS.last_stop
    enter_ms: Annotated[Integer, Field(ge=1_000, le=600_000)] = _AXIS.enter_ns // MS
    """Time in which the drive follows an ON, enters operation, and leaves it at standstill: DC link, brake, commutation."""
    modulo_axis: Boolean = _AXIS.modulo_axis
    intermediate_stop_reached: Boolean = _AXIS.intermediate_stop_reached
    simulate: Simulated = False
    ramp_stop_resume: Boolean = _AXIS.ramp_stop_resume
    standstill_window_percent: Annotated[Fraction, BeforeValidator(_percent), Field(gt=0, le=Fraction(1, 2))] = (
        _AXIS.standstill_window
    )
    tpdo_event_ms: Annotated[Integer, Field(ge=1, le=10_000)] = _NODE.tpdo_event_ms
    sync: Boolean = False
    allow_unguarded: Boolean = _NODE.allow_unguarded
    g1: Annotated[Integer, Field(ge=1, le=254)] | None = None
    """Telegrams with G1: the do_id of the encoder that it is; None: the drive's own position."""
    g2: Annotated[Integer, Field(ge=1, le=254)] | Literal["drive"] | None = None
    """Telegrams with G2: the do_id of the encoder that it is, or the drive's second encoder (60E4h); None: error 0F01h."""
    family: Annotated[str, AfterValidator(_family)] | None = None
    """The overlay of the drive; None: the one that fits its identity."""
    rated_speed_rpm: Ratio | None = None
    velocity_unit: str = ""
    position_unit: str = ""
    counts_per_revolution: Ratio | None = None
    acceleration_unit: str = ""
    gear: Ratio | None = None
    rated_acceleration_rpm_s: Ratio | None = None
    ignored_unit_objects: tuple[UnitObject, ...] | None = None
    """Objects of the drive that say something wrong about its units."""
    jog_speeds_rpm: tuple[SignedRatio, SignedRatio] | None = None
    """Speed telegrams, signed: those of STW1.8 and STW1.9 with .4 to .6 = 0."""
    dsc: DscForm | None = None
    """Telegrams 5, 6, 105 and 106: where the position loop is closed."""
    following_window: Annotated[Integer, Field(ge=1, le=FOLLOWING_WINDOW_MAX)] | None = None
    """Position units within which DSC may start."""
    dsc_delay_cycles: Annotated[Integer, Field(ge=0, le=DELAY_CYCLES_MAX)] = _DSC.delay_cycles
    positioner: PositionerConfig | None = None
    block: Annotated[tuple[BlockConfig, ...], BeforeValidator(as_list)] = ()
    _families: Families = PrivateAttr(NO_CHOICE)

    @property
    def units(self) -> UnitKeys:
        """The units from the keys."""
        return UnitKeys(
            self.rated_speed_rpm,
            self.velocity_unit,
            self.position_unit,
            self.counts_per_revolution,
            self.acceleration_unit,
            self.gear,
            self.rated_acceleration_rpm_s,
            frozenset(self.ignored_unit_objects or ()),
        )

    def model_post_init(self, context: Surroundings | None, /) -> None:
        """Keep the family that is named."""
        super().model_post_init(context)
        if self.family is not None and self.family.endswith(".toml"):
            own = own_family(self.family)
            self._families = Families((own,), own)
        elif self.family is not None:
            self._families = Families(named=overlay(self.family))

    @property
    def families(self) -> Families:
        """The families that the drive may be of."""
        return self._families

    def with_families(self, own: tuple[Overlay, ...]) -> AxisConfig:
        """The same with these families of the user's own."""
        copy = self.model_copy()
        copy._families = replace(self._families, own=own)
        return copy

    @model_validator(mode="after")
    def _units_are_units(self) -> AxisConfig:
        try:
            check_unit_keys(self.units)
        except Dsp402Error as error:
            raise misplaced(str(error), error.field) from error
        return self

    @cached_property
    def drive_telegrams(self) -> dict[int, Telegram]:
        """Every telegram of a drive axis by its number, those of the user among them."""
        return drive_telegrams((TELEGRAMS | self._own_telegrams).values())

    @model_validator(mode="after")
    def _telegram_is_supported(self) -> AxisConfig:
        if self.telegram not in self.drive_telegrams:
            raise misplaced(
                f"telegram = {self.telegram} is not supported, allowed: {list(self.drive_telegrams)}", "telegram"
            )
        return self

    @model_validator(mode="after")
    def _dsc_is_complete(self) -> AxisConfig:
        if self.chosen.base in DSC_TELEGRAM_NUMBERS and (self.dsc is None or self.following_window is None):
            text = f'telegram = {self.telegram} needs dsc = "position" or "speed", and following_window'
            raise misplaced(text, "telegram")
        return self

    @model_validator(mode="after")
    def _positioner_is_complete(self) -> AxisConfig:
        if self.positioner is None:
            if self.telegram in POSITIONER_TELEGRAM_NUMBERS:
                raise misplaced(f"telegram = {self.telegram} needs [axis.positioner]", "telegram")
            if self.block:
                raise misplaced("[[axis.block]] needs [axis.positioner]", "block")
            return self
        if self.telegram in FLOAT_TELEGRAM_NUMBERS and not self.positioner.has_unit:
            text = f"telegram = {self.telegram} needs lu_per_unit and velocity_per in [axis.positioner]"
            raise misplaced(text, "telegram")
        try:
            self.positioner.choices(self.block)
        except GatewayError as error:
            raise misplaced(str(error), "block") from error
        return self

    def settings_at(self, cycle_time_ms: float) -> AxisSettings:
        """The user's choices, with those that the cycle of the PLC belongs to."""
        cycle_ns = round(cycle_time_ms * MS)
        dsc: DscChoices | None = None
        if self.dsc is not None and self.following_window is not None:
            dsc = DscChoices(self.dsc, self.following_window, self.dsc_delay_cycles)
        return AxisSettings(
            self.on_plc_loss,
            self.setpoint_enable,
            self.modulo_axis,
            self.ramp_stop_resume,
            self.standstill_window_percent,
            self.control_lost,
            stop_time_ns=self.stop_time_ms * MS,
            last_stop=self.last_stop,
            enter_ns=self.enter_ms * MS,
            jog_speeds_rpm=self.jog_speeds_rpm,
            g1_is_encoder=self.g1 is not None,
            second_sensor=self._second_sensor,
            cycle_ns=cycle_ns,
            dsc=dsc,
            intermediate_stop_reached=self.intermediate_stop_reached,
            positioner=None if self.positioner is None else self.positioner.choices(self.block),
        )

    def reaction_ns(self, number: int, cycle_time_ms: float) -> int:
        """Longest time until a stop has an effect: the refresh repeats a lost command, the event timer a lost answer."""
        drive = self.drive_settings(number, cycle_time_ms)
        return int(_REACTION_MARGIN * (drive.rpdo_refresh_ms + drive.tpdo_event_ms + cycle_time_ms) * MS)

    def _is_modulo(self, number: int) -> bool:
        """Whether the gateway chooses the direction to a target with this telegram."""
        if number in POSITIONER_TELEGRAM_NUMBERS:
            return self.positioner is not None and self.positioner.modulo_range > 0
        return self.modulo_axis

    @property
    def _second_sensor(self) -> SecondSensor:
        if self.g2 is None:
            return SecondSensor.NONE
        return SecondSensor.ENCODER if isinstance(self.g2, int) else SecondSensor.DRIVE

    def drive_layout(self, number: int) -> PdoLayout:
        """The PDOs a telegram needs."""
        return drive_layout(
            self.telegram_of(number), self.dsc_form, self._second_sensor, g1_is_encoder=self.g1 is not None
        )

    @property
    def telegrams(self) -> tuple[int, ...]:
        """Telegrams that P922 can select: those whose keys are set and compatible with ``g1``."""
        missing = {
            *(POSITIONER_TELEGRAM_NUMBERS if self.positioner is None else ()),
            *(FLOAT_TELEGRAM_NUMBERS if self.positioner is None or not self.positioner.has_unit else ()),
            *(DSC_TELEGRAM_NUMBERS if self.dsc is None or self.following_window is None or self.g1 is not None else ()),
        }
        return tuple(number for number, item in self.drive_telegrams.items() if item.base not in missing)

    @property
    def dsc_form(self) -> DscForm:
        """The form of DSC, which decides mode and PDOs of telegrams with DSC."""
        return self.dsc or DscForm.SPEED

    def inhibit_us(self, cycle_time_ms: float) -> int:
        """The inhibit time: one event-driven TPDO for each cycle of the PLC, more would only load the bus."""
        return int(min(cycle_time_ms, self.tpdo_event_ms) * US_PER_MS)

    def drive_settings(self, number: int, cycle_time_ms: float) -> DriveSettings:
        """For a telegram, which may differ from the configured one (P922)."""
        chosen = self.telegram_of(number)
        cyclic = chosen.base in DSC_TELEGRAM_NUMBERS or (self.sync and chosen.base in CENTRAL_TELEGRAM_NUMBERS)
        on_sync = self.sync or cyclic
        return DriveSettings(
            node_id=self.node_id,
            eds=self.eds,
            heartbeat_ms=self.heartbeat_ms,
            # With SYNC a value arrives once per cycle, at any cycle time.
            tpdo_event_ms=max(self.tpdo_event_ms, ceil(cycle_time_ms)) if on_sync else self.tpdo_event_ms,
            tpdo_inhibit_us=self.inhibit_us(cycle_time_ms),
            cycle_ms=ceil(cycle_time_ms),
            sdo_timeout_ms=self.sdo_timeout_ms,
            sync=on_sync,
            sync_period_us=round(cycle_time_ms * US_PER_MS) if cyclic else 0,
            tasks=number in TASK_TELEGRAM_NUMBERS,
            modulo=self._is_modulo(number),
            allow_unguarded=self.allow_unguarded,
            initial_mode=initial_mode(chosen, self.dsc_form),
            units=self.units,
            families=self.families,
        )
