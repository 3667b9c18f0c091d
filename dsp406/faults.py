"""EMCY error codes of encoders, and the faults a simulated encoder can be given.

Source: CiA DSP 406 V2.0 chapter 6.2; CiA DS 301 (error register 1001h). Which alarm goes with which code is our choice: the
profile leaves it to the manufacturer.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from pdgw.dsp406.kinds import Alarm, Warnings

MEMORY_ERROR = 0x5100
"""The error code of a hardware memory error."""

ENCODER_EMCY: MappingProxyType[int, str] = MappingProxyType(
    {
        0x0000: "no error",
        0x1000: "generic error",
        0x2000: "current",
        0x2100: "device input current",
        0x2110: "input current too high",
        0x3000: "voltage",
        0x3100: "device input voltage",
        0x3110: "input voltage out of range",
        0x4000: "temperature inside out of range",
        0x5000: "device hardware",
        MEMORY_ERROR: "hardware memory error",
        0x6000: "device software",
        0x7000: "additional modules",
        0x8000: "monitoring",
        0x9000: "external error",
        0xF000: "additional functions",
        0xFFFF: "device specific",
    }
)
"""Text of each error code of the profile."""


_NO_ALARM = Alarm(0)
_NO_WARNING = Warnings(0)


@dataclass(frozen=True, slots=True)
class EncoderFault:
    """Effects of a cause: EMCY error code (0: none), bits of the error register 1001h, alarms and warnings."""

    name: str
    meaning: str
    error_code: int = 0
    error_register: int = 0
    alarms: Alarm = _NO_ALARM
    warnings: Warnings = _NO_WARNING


SENSOR_DEFECT = "sensor-defect"
"""The fault that only the commissioning diagnostics find."""

ENCODER_FAULTS: MappingProxyType[str, EncoderFault] = MappingProxyType(
    {
        fault.name: fault
        for fault in (
            EncoderFault(
                "position-error",
                "The sensor signal is not reliable: the position may be wrong.",
                0x1000,
                0x21,
                Alarm.POSITION_ERROR,
            ),
            EncoderFault("input-current", "The input current is too high.", 0x2110, 0x03),
            EncoderFault("input-voltage", "The input voltage is out of its range.", 0x3110, 0x05),
            EncoderFault("temperature", "The internal temperature is out of range.", 0x4000, 0x09),
            EncoderFault(
                "memory",
                "The memory has an error: the position may be wrong.",
                MEMORY_ERROR,
                0x01,
                Alarm.POSITION_ERROR,
            ),
            EncoderFault("software", "The firmware detected an internal error.", 0x6000, 0x01),
            EncoderFault("monitoring", "A supervision of the device responded.", 0x8000, 0x01),
            EncoderFault("external", "A device outside the encoder has a fault.", 0x9000, 0x01),
            EncoderFault("device-specific", "An error that only the manufacturer can explain.", 0xFFFF, 0x81),
            EncoderFault(
                SENSOR_DEFECT, "A part of the sensor is defective; only the commissioning diagnostics detect it."
            ),
            EncoderFault(
                "frequency",
                "The encoder turned faster than its sensor can follow.",
                warnings=Warnings.FREQUENCY_EXCEEDED,
            ),
            EncoderFault("light", "The light source is nearly worn out.", warnings=Warnings.LIGHT_CONTROL_RESERVE),
            EncoderFault("watchdog", "The watchdog has restarted the processor.", warnings=Warnings.CPU_WATCHDOG),
            EncoderFault(
                "operating-time", "The operating time has reached its limit.", warnings=Warnings.OPERATING_TIME
            ),
            EncoderFault(
                "battery", "The battery that keeps the position is nearly empty.", warnings=Warnings.BATTERY_CHARGE
            ),
            EncoderFault(
                "reference-point", "The reference point has not been reached.", warnings=Warnings.REFERENCE_POINT
            ),
        )
    }
)
"""The causes by name."""

COMMISSIONING_FAULT = EncoderFault(
    "commissioning diagnostics", "The diagnostics found a defect.", 0x5000, 0x21, Alarm.COMMISSIONING_DIAGNOSTICS
)
"""Result of the diagnostics; not a cause of its own."""
