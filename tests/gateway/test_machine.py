"""What the machine does to a gateway that exchanges: clock steps, suspend, no descriptors, a full or read-only file system."""

from __future__ import annotations

import errno
import os
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from pdgw.ds301.loop.loop import MACHINE_CLOCK, SystemLoop
from pdgw.durations import SECOND
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.reasons import FaultNumber
from pdgw.gateway.service.status import snapshot
from pdgw.gateway.trace.reader import RingReader
from pdgw.gateway.trace.recorder import FlightRecorder
from tests.support.gateways.daemon import Plc, axis, configuration, running, world_of

DAY_S = 86_400
HALF_SPEED = 0x2000


class Turning:
    """An axis at half speed."""

    def __init__(self, daemon: Daemon) -> None:
        self.daemon = daemon
        self.axis = daemon.axes[0]
        self.loop = world_of(daemon).loop
        self.plc = Plc(daemon, [1])
        self.plc.enable()
        self.plc.endpoint.set(0, {"NSOLL_A": HALF_SPEED})
        self.plc.until(lambda: self.plc.value("NIST_A") == HALF_SPEED, "half speed")

    def undisturbed(self, cycles: int = 500) -> None:
        """Continue: speed and state stay in every cycle, without fault or loss."""
        for _ in range(cycles):
            self.plc.exchange()
            assert (self.plc.value("NIST_A"), self.plc.state()) == (HALF_SPEED, 0x07), snapshot(self.daemon)
        assert (self.axis.reason, self.axis.fault_log.count) == (None, 0)


@contextmanager
def turning(config: GatewayConfig | None = None, directory: Path | None = None) -> Iterator[Turning]:
    def record(daemon: Daemon) -> None:
        if directory is not None:
            daemon.services.append(FlightRecorder(daemon, directory, "test"))

    with running(configuration(axis(1)) if config is None else config, record) as daemon:
        yield Turning(daemon)


@pytest.mark.parametrize("step_s", [DAY_S, -DAY_S])
def test_a_step_of_the_wall_clock_leaves_the_axis_in_operation(tmp_path: Path, step_s: int) -> None:
    with turning(directory=tmp_path) as machine:
        before = snapshot(machine.daemon)
        machine.loop._epoch += step_s
        machine.undisturbed()
        after = snapshot(machine.daemon)
        assert after["time"][:10] != before["time"][:10]
        assert after["uptime_s"] - before["uptime_s"] == pytest.approx(500 * machine.daemon.cycle_ns / SECOND, abs=0.1)
        with RingReader(tmp_path / "test.ring") as ring:
            newest = ring.cycles(at_most=1)[0].wall_ns / SECOND
        assert newest == pytest.approx(machine.loop.wall(), abs=0.1), "records have the time as it is set now"


def test_after_a_suspend_the_axis_is_stopped_and_needs_an_off_before_the_next_on() -> None:
    with turning() as machine:
        machine.loop._now += 3600 * SECOND  # nothing runs meanwhile: neither gateway nor drive nor PLC
        machine.plc.until(lambda: machine.plc.state() != 0x07, "the stop")
        assert machine.axis.reason is not None
        assert {record.number for record in machine.axis.fault_log.history} & {
            FaultNumber.PLC_LOST,
            FaultNumber.NODE_LOST,
        }, "the reason is reported"
        for _ in range(1000):  # ON stays set
            machine.plc.exchange()
            assert machine.plc.state() != 0x07
        machine.plc.until(lambda: abs(machine.plc.value("NIST_A")) < 10, "standstill")


def test_the_loop_counts_the_time_of_a_suspend() -> None:
    """CLOCK_MONOTONIC stops while the machine is suspended: the last frame of the PLC would look new afterwards."""
    assert isinstance(MACHINE_CLOCK, partial)
    assert (MACHINE_CLOCK.func, MACHINE_CLOCK.args) == (time.clock_gettime_ns, (time.CLOCK_BOOTTIME,))
    loop = SystemLoop()
    try:
        before = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        assert before <= loop.now() <= time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    finally:
        loop.close()


@contextmanager
def no_descriptors() -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    probe = os.open("/dev/null", os.O_RDONLY)
    os.close(probe)
    resource.setrlimit(resource.RLIMIT_NOFILE, (probe, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_without_file_descriptors_the_axis_stays_in_operation(tmp_path: Path) -> None:
    trace = "[trace]\nenabled = false\nseconds = 1\n"
    config = configuration(axis(1) + trace).model_copy(update={"store": tmp_path / "store.json"})
    with turning(config, tmp_path) as machine:
        with no_descriptors():
            with pytest.raises(
                GatewayError, match=r"cannot be written .Too many open files.; the old values remain valid"
            ):
                machine.daemon.store.save()
            machine.undisturbed()
        with RingReader(tmp_path / "test.ring") as ring:
            assert ring.newest_cycle == machine.daemon.cycles, "a segment is closed before the next one is opened"
        machine.daemon.store.save()


def test_a_read_only_store_refuses_a_change_and_leaves_the_axis_in_operation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = configuration(axis(1)).model_copy(update={"store": tmp_path / "store.json"})
    with turning(config) as machine:

        def refuse(*_: object, **__: object) -> None:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))

        monkeypatch.setattr(Path, "open", refuse)
        with pytest.raises(
            GatewayError, match=r"cannot be written .Read-only file system.; the old values remain valid"
        ):
            machine.daemon.store.save()
        machine.undisturbed()
