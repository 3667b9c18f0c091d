"""python canopen as an independent master in virtual time: its own SDO client, PDO, NMT and CiA 402 code, the world's clock.

Its queues, conditions and clock are replaced in its modules; a wait advances the world.
"""

from __future__ import annotations

import queue
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import canopen
import canopen.emcy
import canopen.lss
import canopen.nmt
import canopen.pdo.base
import canopen.profiles.p402
import canopen.sdo.client

from pdgw.base.durations import SECOND
from pdgw.ds301.bus.can_frame import REMOTE
from pdgw.peers.world import World

_WAITING = (canopen.sdo.client, canopen.pdo.base, canopen.nmt, canopen.emcy, canopen.lss, canopen.profiles.p402)


def _run_until(world: World, condition: Any, timeout_s: float) -> bool:
    """Run the world until the condition is true. False after this number of its seconds."""
    try:
        world.loop.until(condition, "what canopen waits for", int(timeout_s * SECOND))
    except TimeoutError:
        return False
    return True


class _Queue(queue.Queue[bytes]):
    """Waiting for an answer runs the world."""

    def __init__(self, world: World) -> None:
        super().__init__()
        self._world = world

    def get(self, block: bool = True, timeout: float | None = None) -> bytes:
        if block:
            _run_until(self._world, lambda: not self.empty(), timeout or 0.0)
        return super().get(block=False)


class _Condition:
    """Waiting runs the world."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._told = False

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass

    def notify_all(self) -> None:
        self._told = True

    def wait(self, timeout: float) -> bool:
        self._told = False
        return _run_until(self._world, lambda: self._told, timeout)


class Master(canopen.Network):  # type: ignore[misc]
    """canopen's network with its end on a bus of the world; a ``ds301.bus.port.Receiver``."""

    def __init__(self, world: World, channel: str) -> None:
        super().__init__()
        self._world = world
        self._member = world.bus(channel).join("canopen")
        self._member.start(self)

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._member.send(can_id | (REMOTE if remote else 0), bytes(data))

    def on_frame(self, can_id: int, data: bytes, now: int) -> None:
        self.notify(can_id, bytearray(data), self._world.loop.now() / SECOND)

    def on_other_frame(self, can_id: int, data: bytes, *, extended: bool, remote: bool) -> None:
        """Not used."""

    def on_error_frame(self, *, bus_off: bool, passive: bool) -> None:
        raise AssertionError("an error on the bus")

    def on_room(self) -> None:
        """What was refused is not repeated."""

    def on_refused(self) -> None:
        raise AssertionError("a frame did not go out")

    def on_lost(self, text: str) -> None:
        raise AssertionError(text)


@contextmanager
def master(world: World, channel: str) -> Iterator[Master]:
    """canopen on this bus, and the clock of the world in all of canopen."""
    clock = SimpleNamespace(
        time=world.loop.wall,
        monotonic=lambda: world.loop.now() / SECOND,
        sleep=lambda seconds: world.loop.run_for(int(seconds * SECOND)),
    )
    replaced = {
        "time": clock,
        "queue": SimpleNamespace(Queue=lambda: _Queue(world), Empty=queue.Empty),
        "threading": SimpleNamespace(Condition=lambda: _Condition(world)),
    }
    with ExitStack() as patched:
        for module in _WAITING:
            for name, value in replaced.items():
                if hasattr(module, name):
                    patched.enter_context(patch.object(module, name, value))
        yield Master(world, channel)
