"""The whole file for a PLC: types, frames, and the blocks of every telegram of a configuration, in one of two languages."""

from __future__ import annotations

import re
from collections.abc import Iterator

from pdgw.gateway.configuration.byte_map import FrameMap, counter_step, frame_maps
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.encoder import EncoderConfig
from pdgw.gateway.motion.units import LU_PER_VELOCITY_UNIT
from pdgw.gateway.reasons import Reason
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.plc.frames import block, comment, frame_code, profinet_block, profinet_variables
from pdgw.tools.plc.library import axis_block, telegram_block, template
from pdgw.tools.plc.motion import has_axis, motion_blocks
from pdgw.tools.plc.scl import scl

_LONGEST = 80
"""Characters of a STRING without a length, where it is shortest."""


def structured_text(config: GatewayConfig) -> str:
    """IEC 61131-3 Structured Text, second edition."""
    maps = frame_maps(config)
    return "\n".join([*_code(config, maps), *profinet_variables(maps), ""])


def siemens_scl(config: GatewayConfig) -> str:
    """An external source of TIA Portal."""
    maps = frame_maps(config)
    text = scl("\n".join([*_code(config, maps), *profinet_block(maps)]))
    return re.sub(r"\bMC_(?=[A-Z])", "PDGW_MC_", text)  # TIA Portal has instructions of these names


def siemens_types(config: GatewayConfig) -> str:
    """The data types alone: a UDT file of TIA Portal."""
    return "\n\n".join(re.findall(r"^TYPE .*?END_TYPE$", siemens_scl(config), re.DOTALL | re.MULTILINE)) + "\n"


def _code(config: GatewayConfig, maps: tuple[FrameMap, FrameMap]) -> Iterator[str]:
    yield comment(
        "Made by pdgw map. Order and lengths are those of the configuration: make it again when that changes."
    )
    yield from frame_code(maps, counter_step(config))
    yield from _reasons()
    numbers = sorted({item.telegram for item in config.objects})
    if any(signal.is_float for number in numbers for signal in telegram(number).setpoints.signals):
        yield from (template("float"), "")
    for number in numbers:
        yield from (telegram_block(telegram(number), initial_values(config, number)), "")
    yield from (template("parameter"), "")
    yield from (text for item in motion_blocks() for text in (item, ""))
    for number in numbers:
        if has_axis(telegram(number)):
            yield from (axis_block(telegram(number), initial_values(config, number)), "")


def initial_values(config: GatewayConfig, number: int) -> dict[str, str]:
    """What the configuration says of the scaling of a telegram, the same for all its axes."""
    speeds = {
        item.reference_speed if isinstance(item, EncoderConfig) else item.units.rated_speed_rpm
        for item in config.objects
        if item.telegram == number
    }
    values = {}
    (speed,) = speeds if len(speeds) == 1 else (None,)
    if speed is not None:
        values["reference_speed"] = f"{float(speed):.3f}"
    lengths = {item.positioner.lu_per_revolution for item in config.axis if item.telegram == number and item.positioner}
    if speed is not None and len(lengths) == 1:
        values["full_velocity"] = f"{float(speed * lengths.pop() / LU_PER_VELOCITY_UNIT):.3f}"
    if any(signal.is_float for signal in telegram(number).setpoints.signals):
        # The telegram has the gateway's unit of length itself.
        values |= {"position_factor": "1.0", "velocity_factor": "1.0"}
    return values


def _reasons() -> Iterator[str]:
    """The text of a reason: the same table as that of ``pdgw status``."""
    body = ["Text := '';", "CASE Reason OF"]
    body += [f"    {reason.code}: Text := '{_string(reason.value)}';" for reason in Reason]
    body += ["END_CASE;"]
    sections = [("VAR_INPUT", ["Reason : INT;"]), ("VAR_OUTPUT", ["Text : STRING;"])]
    yield from block("PDGW_ReasonText", sections, body)


def _string(text: str) -> str:
    """In a string of these languages, cut at a word."""
    while len(text) > _LONGEST:
        text = text.rpartition(" ")[0]
    return text.rstrip(",;:").replace("$", "$$").replace("'", "$'")
