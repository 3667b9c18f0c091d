"""Telegrams 81 to 84: an encoder's control word and sensor words, its position and speed.

Source: docs/devices.md "Encoder telegrams", docs/telegrams.md; PROFIdrive encoder profile 4.1.
"""

from __future__ import annotations

from collections.abc import Sequence

from pdgw.gateway.axis.adapters.adapter import SignalAdapter
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.telegrams import Telegram


class EncoderAdapter(SignalAdapter):
    """``control`` and ``sensor_word`` are those of the last ``read``, None without a PLC.

    GatewayError for a telegram with other signals.
    """

    def __init__(self, telegram: Telegram) -> None:
        super().__init__(telegram)
        self.control: int | None = None
        """STW2_ENC."""
        self.sensor_word: int | None = None
        """G1_STW."""
        self._control = self.setpoint("STW2_ENC")
        self._sensor = self.setpoint("G1_STW")
        self._status = self.actual("ZSW2_ENC")
        self._g1_zsw = self.actual("G1_ZSW")
        self._xist1 = self.actual("G1_XIST1")
        self._xist2 = self.actual("G1_XIST2")
        self._xist3 = self.actual("G1_XIST3")
        self._speed = max(self.actual("NIST_A"), self.actual("NIST_B"))
        self.check()

    @property
    def speed_type(self) -> DataType | None:
        """N2 or N4; None for a telegram without a speed."""
        return self.telegram.actuals.signals[self._speed].type if self._speed >= 0 else None

    def read(self, setpoints: Sequence[int] | None) -> None:
        """Raw setpoints in telegram order, None without a valid PLC."""
        if setpoints is None:
            self.control = self.sensor_word = None
        else:
            self.control = setpoints[self._control]
            self.sensor_word = setpoints[self._sensor]

    def write(self, status: int, sensor: tuple[int, int, int], xist3: int, speed: int, actuals: list[int]) -> None:
        """ZSW2_ENC; G1_ZSW, XIST1 and XIST2; XIST3; NIST as it is on the wire."""
        actuals[self._status] = status
        actuals[self._g1_zsw], xist1, actuals[self._xist2] = sensor
        if self._xist1 >= 0:
            actuals[self._xist1] = xist1
        if self._xist3 >= 0:
            actuals[self._xist3] = xist3
        if self._speed >= 0:
            actuals[self._speed] = speed
