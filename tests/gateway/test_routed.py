"""A gateway behind a network that may delay frames: the PLC copies the tick."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.store import ParameterStore
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.gateway.links.new_frames import Verdict
from pdgw.gateway.service.status import snapshot
from pdgw.peers.world.udp import Conditions
from pdgw.tools.output.status_text import status_lines
from tests.support.gateways.daemon import OFF, Plc, axis, configuration, running, until, world_of

PLC = "192.168.0.10"
ROUTED = f'cycle_time_ms = 4\nlisten = "192.168.0.5"\npeer = "{PLC}"\n'


def routed(more: str = "") -> GatewayConfig:
    return configuration(axis(1), transport=ROUTED + more)


def refused(config: GatewayConfig, key: str) -> str:
    with pytest.raises(GatewayError) as caught:
        parse_config(
            f'[can]\ninterface = "virtual"\n[transport]\n{key}\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n'
        )
    return str(caught.value)


def test_a_plc_enables_moves_and_sees_the_age_of_its_frames() -> None:
    with running(routed()) as daemon:
        world_of(daemon).network.conditions = Conditions(delay_ns=3 * MS, jitter_ns=MS)
        plc = Plc(daemon, [1], PLC)
        plc.enable()
        plc.exchange(100)
        document = snapshot(daemon)
        assert document["plc"]["connected"]
        (line,) = (line for line in status_lines(document) if line.startswith("age of frames"))
        assert line.startswith("age of frames: p50 at most 10 ms, p99 at most 10 ms, max 1")
        assert line.endswith("limit 24 ms")


def test_a_normal_connection_is_not_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    """The PLC sends first, without a tick: it has none yet."""
    with running(routed()) as daemon:
        world_of(daemon).network.conditions = Conditions(delay_ns=3 * MS, jitter_ns=MS)
        plc = Plc(daemon, [1], PLC)
        plc.enable()
        frames = daemon.link.status()["frames"]
        assert frames[Verdict.CONNECTING.value] > 0  # type: ignore[index]
        assert [record.getMessage() for record in caplog.records if "dropped" in record.getMessage()] == []


def test_a_restarted_gateway_connects_again_and_starts_nothing() -> None:
    with running(routed()) as daemon:
        plc = Plc(daemon, [1], PLC)
        plc.enable()
        world, address = world_of(daemon), daemon.address
        daemon.stop()
        until(daemon, daemon.stopped.is_set, "the end")
        world.loop.run_for(MS)  # its last heartbeat may be on its way
        again = build_gateway(
            routed().model_copy(
                update={"transport": daemon.config.transport.model_copy(update={"cyclic_port": address[1]})}
            ),
            world,
        )
        again.start()
        plc.daemon = again
        plc.exchange(500)
        assert again.link.connected
        assert again.link.status()["frames"][Verdict.NO_TICK.value] > 0  # type: ignore[index]
        assert plc.state() != 0x07, "the ON that stays active starts nothing"
        plc.enable()
        again.stop()
        world.loop.until(again.stopped.is_set, "the end", 10 * SECOND)


def test_p922_to_a_layout_of_the_same_size_takes_no_frame_of_the_old_one() -> None:
    """All PLC frames that are on their way have the old layout: their ticks do not count any more."""
    with running(routed()) as daemon:
        world_of(daemon).network.conditions = Conditions(delay_ns=5 * MS)
        plc = Plc(daemon, [1], PLC)
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 0x01, "ready")
        accepted = daemon.link.status()["frames"][Verdict.ACCEPTED.value]  # type: ignore[index]
        daemon.change_telegram(daemon.objects[0], 9, PLC)
        plc.exchange(3)
        assert daemon.link.status()["frames"][Verdict.ACCEPTED.value] == accepted  # type: ignore[index]
        plc.port.close()
        changed = Plc(daemon, [9], PLC)
        changed.endpoint.set(0, {"STW1": 0x043E})
        changed.until(lambda: changed.state() == 0x01, "ready with the new layout")


def test_a_stored_telegram_of_a_version_without_ticks_still_connects(tmp_path: Path) -> None:
    store = ParameterStore(tmp_path / "store.json", print)
    store.update(lambda parameters: setattr(parameters.drive_object(1), "telegram", 9))
    config = routed().model_copy(update={"store": store.path})
    with running(config) as daemon:
        plc = Plc(daemon, [9], PLC)
        plc.endpoint.set(0, {"STW1": 0x043E})
        plc.until(lambda: plc.state() == 0x01, "ready")


@pytest.mark.parametrize(
    ("size", "told"),
    [(46, "copy bytes 38 to 41"), (50, "the layout without a tick")],
)
def test_a_plc_program_without_tick_is_named(size: int, told: str) -> None:
    """A frame of 46 bytes has zeros in place of the tick; a longer one is four bytes too short."""
    axes = axis(1) if size == 46 else axis(1, telegram_number=9) + axis(2, telegram_number=9)
    with running(configuration(axes, transport=ROUTED)) as daemon:
        numbers = [item.telegram.number for item in daemon.objects]
        plc = Plc(daemon, numbers, PLC)
        for _ in range(20):
            frame = bytes(plc.endpoint.build(plc.loop.now()))
            old = frame[:-8] + bytes(4) * (size == 46) + frame[-4:]
            assert len(old) == size
            plc.port.send(old, daemon.address)
            plc.loop.run_for(daemon.cycle_ns)
        assert not daemon.link.connected
        text = "\n".join(status_lines(snapshot(daemon), 1000))
        assert told in text


def test_direct_connects_a_plc_program_without_tick() -> None:
    with running(routed("direct = true\n")) as daemon:
        plc = Plc(daemon, [1], PLC)
        plc.port.pause()  # it never reads a tick
        plc.send()
        plc.loop.run_for(daemon.cycle_ns)
        assert daemon.link.connected


@pytest.mark.parametrize("more", ["", "direct = true\n"])
def test_an_order_reaches_the_drive_with_its_first_frame(more: str) -> None:
    with running(routed(more)) as daemon:
        plc = Plc(daemon, [1], PLC)
        plc.enable()
        controlwords: list[int] = []
        for word in (0x047F, 0x047D, 0x047F):
            plc.endpoint.set(0, {"STW1": word})
            plc.exchange()
            controlwords.append(daemon.axes[0].outputs.command.controlword)
        assert controlwords[0] & 0xF == 0xF
        assert not controlwords[1] & 0x2, "OFF2 of one frame"
        assert controlwords[2] & 0xF != 0xF


def test_keys_of_the_age_limit_are_checked() -> None:
    config = routed()
    assert config.transport.age_limit_ns == 24 * MS
    assert routed("direct = true\n").transport.age_limit_ns is None
    assert "the longest watchdog time" in refused(
        config, f"{ROUTED}watchdog_factor = 255\ncycle_time_ms = 8".replace("cycle_time_ms = 4\n", "")
    )
    assert "age_limit_ms: was removed in 0.9.0: it is twice the watchdog time" in refused(config, "age_limit_ms = 20")
