"""The commented example of a configuration, and the one of a simulation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from pdgw.explain import problems
from pdgw.gateway.axis.telegrams import (
    DSC_TELEGRAM_NUMBERS,
    POSITIONER_TELEGRAM_NUMBERS,
    SECOND_SENSOR_NUMBERS,
    SPEED_TELEGRAM_NUMBERS,
)
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.tables.defaults import SIMULATED_BLOCKS, SIMULATED_ENCODER_TELEGRAM, SIMULATED_KEYS
from pdgw.gateway.errors import GatewayError


def example() -> str:
    """A commented configuration that is itself valid: ``example.toml`` beside this module."""
    return Path(__file__).with_name("example.toml").read_text(encoding="utf-8")


SIMULATED_WATCHDOG_FACTOR = 250
"""Cycles without a frame until the PLC is lost, where nothing real moves: a busy laptop holds a program up for some 0.1 s."""

_SIMULATED_TIMES = {"heartbeat_ms": 2000, "sdo_timeout_ms": 5000}
"""For the same reason: a device that has not got the processor for seconds is not lost. A start waits for a heartbeat."""

_SIMULATED_JOG = {"jog_speeds_rpm": (-150, 150)}


def simulated(
    numbers: Sequence[int], encoders: int = 0, encoder_number: int = SIMULATED_ENCODER_TELEGRAM
) -> GatewayConfig:
    """The configuration of ``pdgw run --simulate``: simulated drives and encoders on a virtual bus, 4 ms.

    ``numbers``: the telegram of each axis. The encoders are on the shafts of the axes in order. GatewayError for an
    impossible request.
    """
    document = {
        "can": {"interface": "virtual", "channel": "pdgw"},
        "transport": {"watchdog_factor": SIMULATED_WATCHDOG_FACTOR},
        "axis": [
            {"do_id": n, "node_id": n, "telegram": number, "simulate": True, "tpdo_event_ms": 500}
            | _SIMULATED_TIMES
            | (
                {"positioner": SIMULATED_KEYS, "block": SIMULATED_BLOCKS}
                if number in POSITIONER_TELEGRAM_NUMBERS
                else {}
            )
            | (_SIMULATED_JOG if number in SPEED_TELEGRAM_NUMBERS else {})
            | ({"dsc": "position", "following_window": 4096} if number in DSC_TELEGRAM_NUMBERS else {})
            | ({"g2": "drive"} if number in SECOND_SENSOR_NUMBERS else {})
            for n, number in enumerate(numbers, 1)
        ],
        "encoder": [
            {
                "do_id": len(numbers) + n,
                "node_id": len(numbers) + n,
                "telegram": encoder_number,
                "simulate": True,
                "motion": f"shaft={(n - 1) % len(numbers) + 1}",
            }
            | _SIMULATED_TIMES
            for n in range(1, encoders + 1)
        ],
    }
    try:
        return GatewayConfig.model_validate(document)
    except ValidationError as error:
        messages = dict.fromkeys(problem.text for problem in problems(error, GatewayConfig))
        raise GatewayError("\n".join(messages)) from error
