"""Commands to a positioner (telegrams 7, 110, 111, 112) by name: the words and bits to set, and the answers to wait for.

Source: docs/motion.md. A program is a list of ``Ask``, ``Wait`` and pauses that the scenario's engine runs. Values are
length units (LU) and 1000 LU/min; for telegram 112 they have the configured unit of length.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from pdgw.durations import MS
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.motion.blocks import HIGHEST_BLOCK
from pdgw.profidrive.telegrams import Telegram

Scalar = int | float | str
FULL = "100 %"
_DEFAULT_VELOCITY = 3000
_READY = {"STW1.DO_NOT_REJECT": 1, "STW1.NO_INTERMEDIATE_STOP": 1}
_ACKNOWLEDGED, _TAKEN_BACK = {"ZSW1.TASK_ACKNOWLEDGE": 1}, {"ZSW1.TASK_ACKNOWLEDGE": 0}


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Mdi(_Model):
    """``mdi``: a task with position and velocity. ``update``: STW1.6 stays set, and further ``mdi`` steps change the active
    task.

    ``velocity``: default 3000 (1000 LU/min); telegram 112 needs it. ``direction``: for a modulo axis.
    """

    to: int | float
    velocity: Annotated[int | float | None, Field(ge=0)] = None
    acceleration: int | str = FULL
    deceleration: int | str = FULL
    relative: bool = False
    update: bool = False
    direction: Literal["positive", "negative"] | None = None


class SettingUp(_Model):
    """``setting_up``: move with a signed velocity until a reject."""

    velocity: int | float


class Ask(NamedTuple):
    """Setpoints by signal or ``signal.bit``. ``if_zero``: setpoints to set only if they are 0."""

    values: Mapping[str, Scalar]
    if_zero: Mapping[str, Scalar] = MappingProxyType({})


class Wait(NamedTuple):
    """Actual values to wait for."""

    values: Mapping[str, int | str]
    name: str


Program = list[Ask | Wait | int]
"""An integer is a pause in nanoseconds."""
PULSE_NS = 100 * MS
"""Time for which a bit with a counting edge stays set, at any cycle time."""


class PositionerWords:
    """The words of one positioner telegram."""

    def __init__(self, telegram: Telegram) -> None:
        names = telegram.setpoints.names
        self._names = names
        self._number = telegram.number
        self._second = "POS_STW2" if "POS_STW2" in names else "POS_STW"
        self._block = "POS_STW1" if "POS_STW1" in names else "SATZANW"
        self._form = "_F" if "MDI_TARPOS_F" in names else ""
        """Suffix of the MDI setpoints' names: ``_F`` for floats."""

    def _has(self, name: str, what: str) -> None:
        if name not in self._names:
            raise GatewayError(f"{what} is not possible with telegram {self._number}: it has no {name}")

    @property
    def _override(self) -> dict[str, int | str]:
        return {"OVERRIDE": FULL} if "OVERRIDE" in self._names else {}

    def _mode(self, absolute: bool, positive: bool, negative: bool) -> dict[str, int | str]:
        word = "POS_STW1" if self._block == "POS_STW1" else "MDI_MOD"
        return {
            f"{word}.ABSOLUTE": int(absolute),
            f"{word}.POSITIVE_DIRECTION": int(positive),
            f"{word}.NEGATIVE_DIRECTION": int(negative),
            f"{self._block}.MDI": 1,
        }

    def _begin(self, values: Mapping[str, Scalar]) -> Program:
        """Set the override to 100 % if it is not given."""
        task = Ask({**values, **_READY, "STW1.ACTIVATE_TASK": 1}, self._override)
        return [task, Wait(_ACKNOWLEDGED, "task acknowledged")]

    def _edge(self, values: Mapping[str, Scalar]) -> Program:
        """Set data and edge in one frame. STW1.6 falls when the task is acknowledged."""
        return [
            *self._begin(values),
            Ask({"STW1.ACTIVATE_TASK": 0}),
            Wait(_TAKEN_BACK, "ready for the next task"),
        ]

    def mdi(self, task: Mdi) -> Program:
        """A traversing task; with ``update`` STW1.6 stays set."""
        self._has(f"MDI_TARPOS{self._form}", "mdi")
        if task.velocity is None and self._form:
            raise GatewayError(
                f"mdi.velocity is missing: telegram {self._number} needs it in the gateway's unit of length"
            )
        values: dict[str, Scalar] = {
            **self._mode(not task.relative, task.direction == "positive", task.direction == "negative"),
            f"MDI_TARPOS{self._form}": task.to,
            f"MDI_VELOCITY{self._form}": _DEFAULT_VELOCITY if task.velocity is None else task.velocity,
            f"MDI_ACC{self._form}": task.acceleration,
            f"MDI_DEC{self._form}": task.deceleration,
        }
        if self._block == "POS_STW1":
            values |= {"POS_STW1.SETTING_UP": 0, "POS_STW1.CONTINUOUS_UPDATE": int(task.update)}
        elif task.update:
            self._has("POS_STW1", "update")
        return self._begin(values) if task.update else self._edge(values)

    def setting_up(self, wish: SettingUp) -> Program:
        """Move with a velocity."""
        self._has("POS_STW1", "setting_up")
        forward = wish.velocity > 0
        return self._edge(
            {
                **self._mode(False, forward, not forward),
                f"MDI_VELOCITY{self._form}": abs(wish.velocity),
                f"MDI_ACC{self._form}": FULL,
                f"MDI_DEC{self._form}": FULL,
                "POS_STW1.SETTING_UP": 1,
                "POS_STW1.CONTINUOUS_UPDATE": 0,
            }
        )

    def block(self, number: int) -> Program:
        """A traversing block, or the chain that starts with it."""
        if not 0 <= number <= HIGHEST_BLOCK:
            raise GatewayError(f"block = {number} is not allowed, expected 0..{HIGHEST_BLOCK}")
        return self._edge({f"{self._block}.BLOCK": number, f"{self._block}.MDI": 0})

    def next_block(self) -> Program:
        """The edge of STW1.13 that an external change waits for."""
        return [Ask({"STW1.EXTERNAL_BLOCK_CHANGE": 1}), PULSE_NS, Ask({"STW1.EXTERNAL_BLOCK_CHANGE": 0})]

    def jog(self, which: Literal[0, 1, 2], *, distance: bool) -> Program:
        """Jog 1 or 2; 0 ends it. ``distance``: incremental jog."""
        values: dict[str, int | str] = {**_READY, "STW1.JOG_1_ON": int(which == 1), "STW1.JOG_2_ON": int(which == 2)}
        if distance:
            self._has(self._second, "jog_distance")
        if self._second in self._names:
            values[f"{self._second}.JOG_INCREMENTAL"] = int(distance)
        return [Ask(values, self._override if distance else {})]

    def set_reference(self) -> Program:
        """Set the reference point at the present position."""
        self._has(self._second, "set_reference")
        bit = f"{self._second}.SET_REFERENCE_POINT"
        return [Ask({bit: 1}), PULSE_NS, Wait({"ZSW1.HOME_POSITION_SET": 1}, "reference point set"), Ask({bit: 0})]

    def home(self, *, passive: bool, negative: bool) -> Program:
        """Homing, active or passive (waits for the probe's edge). STW1.11 stays set until ``home_end``."""
        bits = {"PASSIVE_HOMING": passive, "HOMING_NEGATIVE": negative}
        if self._second == "POS_STW2":
            return [Ask({**{f"POS_STW2.{name}": int(on) for name, on in bits.items()}, "STW1.START_HOMING": 1})]
        if any(bits.values()):
            self._has("POS_STW2", "home: passive and negative")
        return [Ask({"STW1.START_HOMING": 1})]
