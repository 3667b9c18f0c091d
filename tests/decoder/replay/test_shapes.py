"""Replay of drives other than the ENGEL-like one: with other speed objects, or with one ramp."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from pdgw.dsp402.indices import PROFILE_DECELERATION
from pdgw.peers.drive import Shape, shape
from tests.support.gateways.daemon import axis, until, world_of
from tests.support.gateways.recorded_daemon import RecordedPlc, only, recorded

RPDO1 = 0x201
BACKWARD = -0x1000
"""A quarter of the rated speed, in N2."""
TASK = {
    "SATZANW": 0x8000,
    "MDI_TARPOS": 0x0200_0000,
    "MDI_VELOCITY": 1 << 29,
    "MDI_ACC": 0x4000,
    "MDI_DEC": 0x2000,
    "MDI_MOD": 1,
}


@contextmanager
def driven(chosen: Shape, number: int) -> Iterator[RecordedPlc]:
    """A drive of a shape in operation."""
    with recorded([number], axis(1, telegram_number=number, more="")) as plc:
        world_of(plc.daemon).drive("world", 1, shape=chosen)
        until(plc.daemon, lambda: plc.daemon.axes[0].drive.generation, "online")
        plc.enable()
        yield plc


@contextmanager
def velocity_mode() -> Iterator[RecordedPlc]:
    """Backward, and to standstill."""
    with driven(shape("vl"), 1) as plc:
        plc.endpoint.set(0, {"NSOLL_A": BACKWARD})
        for _ in range(150):
            plc.exchange()
        assert plc.value("NIST_A") < -0xF00, "it turns backward"
        plc.endpoint.set(0, {"STW1": 0x047E})
        for _ in range(150):
            plc.exchange()
        yield plc


def _travels(plc: RecordedPlc) -> None:
    """A task, and its end."""
    plc.endpoint.set(0, TASK | {"STW1": 0x043F})
    for _ in range(5):
        plc.exchange()
    plc.endpoint.set(0, {"STW1": 0x047F})
    for _ in range(400):
        plc.exchange()


@contextmanager
def one_ramp() -> Iterator[RecordedPlc]:
    """The drive has no 6084h: 6083h carries the deceleration, which is the smaller."""
    plain = shape("rpm")
    has = tuple(spec for spec in plain.has if spec.index != PROFILE_DECELERATION)
    with driven(replace(plain, has=has, lacks=plain.lacks | {PROFILE_DECELERATION}), 9) as plc:
        _travels(plc)
        yield plc


RECORDINGS = {"vl": velocity_mode, "one ramp": one_ramp}
TARGET = {"vl": "vl target velocity", "one ramp": "Target Position"}


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_recording_of_the_shape_is_equal(name: str, tmp_path: Path) -> None:
    with RECORDINGS[name]() as plc:
        assert only(plc.replayed(tmp_path)) == []


@pytest.mark.parametrize("name", RECORDINGS)
def test_another_set_point_on_the_bus_is_the_difference(name: str, tmp_path: Path) -> None:
    with RECORDINGS[name]() as plc:
        can = plc.frames.can
        places = [i for i, item in enumerate(can) if item[1] == RPDO1 and any(item[2][:2])]
        place = places[len(places) // 3]
        now, cob_id, data = can[place]
        can[place] = (now, cob_id, bytes((data[0] ^ 0x55,)) + data[1:])
        assert only(plc.replayed(tmp_path)) == [("RPDO1", (TARGET[name],))]
