"""The native cyclic engine of this source tree, and an interface whose real-time frames it exchanges in virtual time."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sysconfig
from functools import cache
from pathlib import Path
from typing import Any, cast

import pytest

from pdgw.ds301.loop.loop import Loop, Timer
from pdgw.gateway.links.profinet.native import Engine, Table
from tests.support.wire.ethernet import FakeEthernet

SOURCE = Path(__file__).parents[2] / "gateway" / "links" / "profinet" / "engine.c"
_BUILT = SOURCE.parents[3] / "build" / "engine"


@cache
def engine_type() -> Any:
    """The class ``Engine``, compiled from the source as it is, without a warning; skips without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    include = Path(sysconfig.get_path("include"))
    if compiler is None or not (include / "Python.h").exists() or not hasattr(os, "eventfd"):
        pytest.skip("the native engine needs Linux, a C compiler and Python.h")
    built = _BUILT / hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:16] / "engine.abi3.so"
    if not built.exists():
        built.parent.mkdir(parents=True, exist_ok=True)
        own = built.with_suffix(f".{os.getpid()}")
        options = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-pthread"]
        done = subprocess.run(
            [compiler, *options, "-isystem", str(include), str(SOURCE), "-o", str(own)],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        own.replace(built)
    spec = importlib.util.spec_from_file_location("engine", built)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Engine


class NativeEthernet(FakeEthernet):
    """Like a machine with the engine, whose thread the loop runs."""

    def __init__(self, loop: Loop) -> None:
        super().__init__(loop)
        self.made: list[Any] = []
        """Every engine, the present one last."""
        self.held_up = False
        """Python is not woken."""
        self.changes: dict[str, int] = {}
        """Of the next engine's table."""
        self._due: Timer | None = None

    @property
    def given(self) -> Any:
        """The engine that exchanges frames; None: none does."""
        return self.made[-1] if self._due is not None else None

    def engine(self, table: Table) -> Engine | None:
        engine = engine_type()(**{**table, **self.changes})
        self.made.append(engine)
        self.listening = False
        self._wait(engine)
        while self.real_time:
            self.arrive(None, self.real_time.popleft())
        return cast(Engine, engine)

    def detach(self, engine: Engine) -> None:
        engine.stop()
        if self._due is not None:
            self._due.cancel()
            self._due = None
        self.listen(on=True)

    def _wait(self, engine: Any) -> None:
        def send() -> None:
            frame = engine.provide(self.loop.now())
            if frame is not None:
                self.send(frame)
            self._wait(engine)

        self._due = self.loop.call_at(engine.due, send)

    def arrive(self, address: tuple[str, int] | None, data: bytes) -> None:
        engine = self.given
        if address is not None or engine is None or int.from_bytes(data[14:16], "big") >= 0xFEFC:
            super().arrive(address, data)
            return
        engine.offer(data, self.loop.now())
        self.wake()

    def wake(self) -> None:
        """As the loop does while the engine's descriptor is readable."""
        while self.given is not None and self.given.signalled and not self.held_up:
            self.on_real_time()
