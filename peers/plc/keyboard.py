"""The keys of the PLC simulator, sans-I/O: what a person types becomes steps of a scenario on the chosen axes."""

from __future__ import annotations

import queue
from collections.abc import Callable
from typing import Any, Final

from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.endpoint import PlcEndpoint
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.scenario import Scenario
from pdgw.profidrive.signals import signal

KEYS: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    "o": ("OFF1", {"off1": True}),
    "e": ("enable", {"enable": True}),
    "+": ("faster", {"speed": "0 %"}),
    "-": ("slower", {"speed": "0 %"}),
    "q": ("quick stop", {"quick_stop": True}),
    "c": ("coast stop", {"coast": True}),
    "a": ("acknowledge", {"ack": True}),
    "h": ("home (method 35)", {"home": {"method": 35}}),
    "m": ("move +10 %", {"move": {"to": "10 %", "relative": True}}),
    "p": ("positioner: +10000 LU", {"mdi": {"to": 10_000, "relative": True}}),
    "b": ("block 1", {"block": 1}),
    "v": ("setting up, forward", {"setting_up": {"velocity": 3000}}),
    "j": ("jog 1", {"jog": 1}),
    "k": ("jog 2", {"jog": 2}),
    "l": ("let go", {"jog": 0}),
    "r": ("reject", {"reject": True}),
    "s": ("set reference point", {"set_reference": True}),
    " ": ("intermediate stop / resume", {"intermediate_stop": True}),
}
"""What each key does to an axis, as a step of a scenario; an axis has the keys whose step its telegram takes."""
EXIT: Final = "x"
ALL: Final = "0"
"""Digits choose an axis, this one all of them."""
_SPEED_STEP = 10
_NO_INTERMEDIATE_STOP = signal("STW1").bit("NO_INTERMEDIATE_STOP", positioning=True).mask


class Keyboard:
    """Keys to setpoints, sans-I/O: ``press`` from any thread, ``step`` once per cycle.

    Each axis works off its keys by itself. A stop key acts at once: what has not begun is dropped, an enable that waits for
    the drive is given up, and only a handshake that has begun is completed. ``tell`` gets what the user must know.
    """

    def __init__(self, endpoint: PlcEndpoint, tell: Callable[[str], None]) -> None:
        self.endpoint = endpoint
        self.tell = tell
        self.selected: int | None = None
        """The axis (from 1) the keys are for; None: all."""
        self._numbers = [item.number for item in endpoint.telegrams]
        self._keys: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._pending: list[list[tuple[str, Engine]]] = [[] for _ in self._numbers]
        self._speeds = [0] * len(self._numbers)
        self._available = [
            {key for key, (_, action) in KEYS.items() if self._possible(axis, action)}
            for axis in range(1, len(self._numbers) + 1)
        ]

    def press(self, key: str) -> None:
        """Take a key; an unknown one does nothing."""
        if key in KEYS or key.isdecimal():
            self._keys.put(key)

    def step(self, now: int) -> None:
        """Obey the keys pressed since the last cycle and go on with what is under way."""
        while not self._keys.empty():
            self._obey(self._keys.get(), now)
        for pending in self._pending:
            if pending:
                key, engine = pending[0]
                engine.step(now)
                if engine.finished:
                    pending.pop(0)
                    self._tell_failures(key, engine)

    @property
    def help(self) -> str:
        """The chosen axes and the keys they have."""
        chosen = "all axes" if self.selected is None else f"axis {self.selected}"
        keys = [key for key in KEYS if any(key in self._available[axis - 1] for axis in self._chosen)]
        texts = [f"{'space' if key == ' ' else key}={KEYS[key][0]}" for key in keys]
        if len(self._numbers) > 1:
            texts.append(f"1..{min(9, len(self._numbers))}=axis, {ALL}=all")
        return f"{chosen}:  {'  '.join([*texts, f'{EXIT}=exit'])}"

    @property
    def _chosen(self) -> range:
        return range(1, len(self._numbers) + 1) if self.selected is None else range(self.selected, self.selected + 1)

    def _engine(self, axis: int, action: dict[str, Any]) -> Engine:
        document = {"telegrams": self._numbers, "steps": [{"axis": axis, **action}]}
        return Engine(Scenario.model_validate(document), self.endpoint)

    def _possible(self, axis: int, action: dict[str, Any]) -> bool:
        try:
            self._engine(axis, action)
        except GatewayError:
            return False
        return True

    def _tell_failures(self, key: str, engine: Engine) -> None:
        for result in engine.results:
            if not result.passed:
                self.tell(f"{KEYS[key][0]}, axis {result.axis}: {result.name} not met: {result.measured}")

    def _obey(self, key: str, now: int) -> None:
        if key.isdecimal():
            self._select(key)
            return
        for axis in self._chosen:
            if key in self._available[axis - 1]:
                self._do(key, axis, now)
            elif self.selected is not None or not any(key in keys for keys in self._available):
                self.tell(f"{KEYS[key][0]}, axis {axis}: telegram {self._numbers[axis - 1]} has no use for this key")

    def _select(self, key: str) -> None:
        if key == ALL:
            self.selected = None
        elif int(key) <= len(self._numbers):
            self.selected = int(key)
        else:
            self.tell(f"axis {key}: there are {len(self._numbers)}")

    def _do(self, key: str, axis: int, now: int) -> None:
        action = KEYS[key][1]
        if key in "+-":
            step = _SPEED_STEP if key == "+" else -_SPEED_STEP
            self._speeds[axis - 1] = max(-100, min(100, self._speeds[axis - 1] + step))
            action = {"speed": f"{self._speeds[axis - 1]} %"}
        elif key == " " and not self.endpoint.setpoints[axis - 1].get("STW1", 0) & _NO_INTERMEDIATE_STOP:
            action = {"resume": True}
        pending = self._pending[axis - 1]
        engine = self._engine(axis, action)
        if key in "oqclr" or "intermediate_stop" in action:
            pending[:] = [item for item in pending[:1] if item[0] != "e" and item[1].current]
            engine.step(now)
        else:
            pending.append((key, engine))
