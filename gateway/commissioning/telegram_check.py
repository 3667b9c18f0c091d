"""Check what a drive lacks for a telegram, by the rules of the axis machine, before anything is configured or moves."""

from __future__ import annotations

from collections.abc import Mapping

from pdgw.base.durations import MS
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.node.planner import found_in_data_sheet
from pdgw.ds301.pdo import PdoLayout
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.modes import MODE_NAMES, Mode
from pdgw.dsp402.pdo import planner
from pdgw.dsp402.pdo.planner import plan_pdos
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.telegrams import (
    CENTRAL_TELEGRAM_NUMBERS,
    DSC_TELEGRAM_NUMBERS,
    drive_layout,
    drive_telegrams,
    initial_mode,
)
from pdgw.gateway.configuration.defaults import SIMULATED_KEYS, USUAL_CYCLE_MS
from pdgw.gateway.configuration.positioner_config import PositionerConfig
from pdgw.gateway.motion.dsc_setpoint import DscChoices, DscForm
from pdgw.profidrive.telegrams import Telegram

_USUAL = AxisSettings(
    dsc=DscChoices(DscForm.SPEED, following_window=1),
    cycle_ns=USUAL_CYCLE_MS * MS,
    positioner=PositionerConfig.model_validate(SIMULATED_KEYS).choices(()),
)
"""For telegrams that need keys of the configuration, where there is none yet."""


def _form(settings: AxisSettings) -> DscForm:
    return DscForm.SPEED if settings.dsc is None else settings.dsc.form


def lacks(drive: DriveType, chosen: Telegram, settings: AxisSettings = _USUAL) -> str:
    """Why a drive cannot be operated with a telegram; empty if its known objects suffice."""
    mode = initial_mode(chosen, _form(settings))
    # A speed needs one of several modes; the executor knows which.
    if mode is not None and mode is not Mode.VELOCITY and mode.value not in drive.modes:
        return f"modes of the drive (6502h): {mode.value} ({MODE_NAMES[mode]}) is missing"
    lacking = AxisMachine(chosen, settings, DriveFeedback()).lacking(drive, homing_method=0)
    if lacking:
        return lacking
    try:
        planned(drive, chosen, settings=settings)
    except CanopenError as error:
        return str(error)
    return ""


def missing_lines(drive: DriveType, *telegrams: Telegram, settings: AxisSettings = _USUAL) -> tuple[str, ...]:
    """Every key of the configuration that these telegrams lack with a drive, as lines to paste into its [[axis]]."""
    machines = (AxisMachine(chosen, settings, DriveFeedback()) for chosen in telegrams)
    return tuple(dict.fromkeys(line for machine in machines for line in machine.missing(drive).lines))


def planned(
    drive: DriveType, chosen: Telegram, node_id: int = 1, *, sync: bool = False, settings: AxisSettings = _USUAL
) -> PdoPlan:
    """The planned PDOs, by the data sheet; CanopenError if no plan is possible."""
    cyclic = chosen.base in DSC_TELEGRAM_NUMBERS or (sync and chosen.base in CENTRAL_TELEGRAM_NUMBERS)
    needs = _needs(chosen, settings)
    return plan_pdos(needs, drive, node_id, found_in_data_sheet(drive.pdos), sync=sync or cyclic, sync_rpdos=cyclic)


def not_available(drive: DriveType, chosen: Telegram, settings: AxisSettings = _USUAL) -> tuple[str, ...]:
    """One line for each optional object of the telegram that the drive lacks, with the effect."""
    return planner.not_available(_needs(chosen, settings), drive)


def _needs(chosen: Telegram, settings: AxisSettings) -> PdoLayout:
    """The contents of the PDOs."""
    return drive_layout(chosen, _form(settings), settings.second_sensor, g1_is_encoder=settings.g1_is_encoder)


def lacks_by_telegram(drive: DriveType) -> Mapping[int, str]:
    """``lacks`` for every telegram a drive axis can have."""
    return {number: lacks(drive, chosen) for number, chosen in drive_telegrams().items()}
