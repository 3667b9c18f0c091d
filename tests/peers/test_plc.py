"""The PLC simulator: its endpoint against the gateway's, the scenario language, and its messages."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from ipaddress import IPv4Interface
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.layers.inet import UDP
from scapy.utils import rdpcap

from pdgw.base.durations import MS
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.client.address import Target, parse_target
from pdgw.gateway.client.session import Element
from pdgw.gateway.client.udp import ParameterClient
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.links.new_frames import Verdict
from pdgw.peers.controller.plc import ProfinetPlc
from pdgw.peers.plc.client import PlcClient, PlcRunner
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.notation import parse_time
from pdgw.peers.plc.scenario import Scenario
from pdgw.peers.plc.scenario_file import load_scenario
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import RtFrame
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import Direction, Telegram, telegram
from pdgw.tools.output.plc_capture import Capture
from tests.support.axis.strategies import axes_values
from tests.support.gateways.daemon import record_server
from tests.support.gateways.machine import configuration, running

CYCLE = 4 * MS
SCENARIOS = Path(__file__).parents[2] / "tools" / "scenarios"


@given(drawn=axes_values(Direction.SETPOINT))
def test_setpoints_reach_the_gateway_as_they_were_set(drawn: tuple[list[Telegram], list[tuple[int, ...]]]) -> None:
    telegrams, values = drawn
    plc = PlcEndpoint(telegrams, CYCLE)
    for index, drawn_values in enumerate(values):
        plc.set(index, telegrams[index].setpoints.as_dict(drawn_values))
    device = CyclicEndpoint(telegrams, cycle_ns=CYCLE)
    assert device.receive(bytes(plc.build()), ("127.0.0.1", 1), CYCLE) is Verdict.ACCEPTED
    assert device.setpoints == values


@given(drawn=axes_values(Direction.ACTUAL), bad=st.integers(0, 3))
def test_actual_values_reach_the_plc_and_bad_ones_are_none(
    drawn: tuple[list[Telegram], list[tuple[int, ...]]], bad: int
) -> None:
    telegrams, values = drawn
    device = CyclicEndpoint(telegrams, cycle_ns=CYCLE)
    plc = PlcEndpoint(telegrams, CYCLE)
    good = [index != bad for index in range(len(values))]
    assert plc.receive(bytes(device.build(values, good)))
    for index, half in enumerate(t.actuals for t in telegrams):
        assert plc.actuals[index] == (half.as_dict(values[index]) if good[index] else None)


def test_stale_foreign_and_malformed_frames_of_a_gateway_are_counted() -> None:
    device = CyclicEndpoint([telegram(1)], cycle_ns=CYCLE)
    plc = PlcEndpoint([telegram(1)], CYCLE)
    frame = bytes(device.build([(0, 0)], [True]))
    assert plc.receive(frame)
    assert not plc.receive(frame)
    assert not plc.receive(b"\xc0\x00")
    assert not plc.receive(RtFrame(0xC005, b"", 1).encode())
    assert (plc.counters["stale"], plc.counters["malformed"], plc.counters["foreign"]) == (1, 1, 1)


def test_frames_of_a_backup_or_without_valid_data_are_counted_and_not_used() -> None:
    plc = PlcEndpoint([telegram(1)], CYCLE)
    frame = bytes(CyclicEndpoint([telegram(1)], cycle_ns=CYCLE).build([(0x37, 5)], [True]))
    status = len(frame) - 2
    for bit in (0x01, 0x04):
        assert not plc.receive(frame[:status] + bytes([frame[status] & ~bit]) + frame[status + 1 :])
    assert plc.actuals == [None]
    assert (plc.counters["not primary"], plc.counters["not valid"]) == (1, 1)


def test_silent_gateway_clears_values_and_may_return_with_any_counter() -> None:
    plc = PlcEndpoint([telegram(1)], CYCLE)
    device = CyclicEndpoint([telegram(1)], cycle_ns=CYCLE)
    first, second = bytes(device.build([(0x37, 0)], [True])), bytes(device.build([(0x37, 0)], [True]))
    assert plc.receive(second, 0)
    assert not plc.poll(200 * MS)
    assert plc.actuals[0] is not None
    engine = Engine(Scenario.model_validate({"steps": [{"expect": {"ZSW1": 0x37}, "within": "4 ms"}]}), plc)
    assert plc.poll(201 * MS)
    assert not plc.poll(202 * MS)
    for now in (201, 205):
        engine.step(now * MS)
    assert not engine.passed
    assert plc.receive(first, 300 * MS)
    assert plc.actuals == [{"ZSW1": 0x37, "NIST_A": 0}]


def test_a_setpoint_that_does_not_fit_is_named_and_changes_nothing() -> None:
    plc = PlcEndpoint([telegram(1)], CYCLE)
    with pytest.raises(ProfidriveError, match="NSOLL_A"):
        plc.set(0, {"NSOLL_A": 40000})
    assert plc.setpoints[0]["NSOLL_A"] == 0


def run_plc(
    document: dict[str, object], answers: list[dict[str, int] | None], drive: Callable[[str], None] = lambda _: None
) -> tuple[Engine, list[dict[str, int]]]:
    """Run a scenario; ``answers``: actual values of axis 1, cycle by cycle; the last one is repeated."""
    scenario = Scenario.model_validate(document)
    plc = PlcEndpoint([telegram(number) for number in scenario.telegrams], CYCLE)
    engine = Engine(scenario, plc)
    engine.drive = drive
    sent = []
    for cycle in range(5000):
        answer = answers[min(cycle, len(answers) - 1)]
        plc.actuals[0] = None if answer is None else {**dict.fromkeys(plc.telegrams[0].actuals.names, 0), **answer}
        engine.step(cycle * CYCLE)
        sent.append(dict(plc.setpoints[0]))
        if engine.finished:
            break
    return engine, sent


def test_enable_is_off_then_on_with_its_expectations() -> None:
    engine, sent = run_plc(
        {"steps": [{"enable": True}]}, [{"ZSW1": 0x40}, {"ZSW1": 0x40}, {"ZSW1": 0x31}, {"ZSW1": 0x37}]
    )
    assert [values["STW1"] for values in sent] == [0x047E, 0x047E, 0x047F, 0x047F]
    assert engine.passed
    assert [item.name.split(":")[0] for item in engine.results] == ["ready", "operation enabled"]


def test_an_enable_of_a_drive_that_is_not_ready_ends_without_on() -> None:
    engine, sent = run_plc({"steps": [{"enable": True, "within": "8 ms"}, {"hold": "20 ms"}]}, [{"ZSW1": 0x40}])
    assert [item.name.split(":")[0] for item in engine.results] == ["ready"]
    assert not engine.passed
    assert {values["STW1"] for values in sent} == {0x047E}


def test_an_expectation_that_is_not_met_in_time_fails_with_the_measured_value() -> None:
    engine, sent = run_plc(
        {"steps": [{"expect": {"NIST_A": "1500 rpm +- 10 rpm"}, "within": "40 ms"}]}, [{"NIST_A": 100}]
    )
    assert not engine.passed
    assert engine.results[0].measured == "NIST_A = 18.3 rpm"
    assert len(sent) == 11


@pytest.mark.parametrize(
    ("wanted", "values", "measured"),
    [
        ({"NIST_A": "50 % +- 1 %"}, {"NIST_A": -8192}, "NIST_A = -50.0 %"),
        ({"NIST_A": 0}, {"NIST_A": -100}, "NIST_A = -100"),
        ({"NIST_A": "<= 2000h"}, {"NIST_A": -1}, "NIST_A = FFFFh"),
        ({"ZSW1": "& 0x4F = 0x40"}, {"ZSW1": 0x670}, "ZSW1 = 0670h"),
        ({"ZSW1.FAULT": 1}, {"ZSW1": 0x670}, "ZSW1.FAULT = 0"),
    ],
)
def test_measured_value_has_the_notation_of_the_expected_one(
    wanted: dict[str, str | int], values: dict[str, int], measured: str
) -> None:
    engine, _ = run_plc({"steps": [{"expect": wanted, "within": "8 ms"}]}, [values])
    assert engine.results[0].measured == measured


def test_bad_iops_fails_an_expectation() -> None:
    engine, _ = run_plc({"steps": [{"expect": {"ZSW1": 0}, "within": "4 ms"}]}, [None])
    assert engine.results[0].measured.startswith("no valid actual values: no datagram from a gateway: start one")


@pytest.mark.parametrize(
    ("numbers", "start"),
    [
        ([9], "pdgw run --simulate --telegram 9"),
        ([1, 1], "pdgw run --simulate --telegram 1 --axes 2"),
        ([1, 1, 83], "pdgw run --simulate --telegram 1 --axes 2 --encoders 1 --encoder-telegram 83"),
        ([1, 9, 1], "pdgw run --simulate --telegram 1 --telegram 9 --telegram 1"),
        ([1, 81, 83], "pdgw run CONFIG"),
        ([83], "pdgw run CONFIG"),
    ],
    ids=str,
)
def test_suggested_gateway_command_is_valid(numbers: list[int], start: str) -> None:
    plc = PlcEndpoint([telegram(number) for number in numbers], 4_000_000)
    assert f"start one ({start})" in plc.why_no_values(0)


def test_reason_for_missing_values_follows_from_the_counters() -> None:
    gateway = CyclicEndpoint([telegram(1)], cycle_ns=4_000_000)
    plc = PlcEndpoint([telegram(1)], 4_000_000)
    assert plc.why_no_values(0).startswith("no datagram from a gateway: start one (pdgw run --simulate --telegram 1)")
    plc.receive(bytes(CyclicEndpoint([telegram(1)] * 12, cycle_ns=4_000_000).build([(0, 0)] * 12, [True] * 12)))
    assert plc.why_no_values(0).startswith("received 1 datagrams, but none is a frame of 46 bytes")
    plc.receive(bytes(gateway.build([(0, 0)], [False])), 1)
    assert plc.why_no_values(0).startswith("the gateway marks the values as bad (IOPS BAD)")
    plc.receive(bytes(gateway.build([(0, 0)], [True])), 2)
    assert plc.why_no_values(0) == ""
    plc.poll(10_000_000_000)
    assert plc.why_no_values(0) == "the gateway's frames have stopped"


class LateGateway(PlcRunner):
    """A link without delays whose gateway answers the fifth frame; 0: none."""

    def __init__(self, endpoint: PlcEndpoint, answers: int) -> None:
        super().__init__(endpoint, 0)
        self.answers = answers

    def _wait(self, ns: int) -> None:
        raise AssertionError

    def _send(self, *, muted: bool = False) -> None:
        self.endpoint.build()
        self.endpoint.counters["received"] += self.endpoint.counters["sent"] == self.answers

    def _open_parameters(self) -> ParameterClient:
        raise AssertionError


@pytest.mark.parametrize("answers", [5, 0])
def test_scenario_that_waits_for_nothing_lasts_until_the_first_answer(answers: int) -> None:
    plc = PlcEndpoint([telegram(1)], MS)
    engine = Engine(Scenario(within="3 s" if answers else "1 ms", steps=[{"set": {"NSOLL_A": 500}}]), plc)  # type: ignore[list-item]
    LateGateway(plc, answers).run(engine)
    assert engine.finished
    assert plc.counters["received"] == bool(answers)
    assert plc.setpoints[0]["NSOLL_A"] == 500


@pytest.mark.parametrize("value", ["99999 rpm", "-6001 rpm", "201 %"])
def test_a_speed_no_telegram_can_carry_is_refused(value: str) -> None:
    with pytest.raises(GatewayError, match=r"step 1 \(speed\): NSOLL_A = .*: the maximum is .* in either direction"):
        run_plc({"steps": [{"speed": value}]}, [])


@pytest.mark.parametrize(
    ("text", "raw"),
    [
        ("50 %", 0x2000),
        ("1500 rpm", 0x2000),
        ("-100 %", -0x4000),
        ("0.5 rpm", 2),
        ("12.5 %", 0x800),
        ("2000h", 0x2000),
        ("0x0666", 0x666),
        ("-5", -5),
    ],
)
def test_values_in_every_notation(text: str, raw: int) -> None:
    _, sent = run_plc({"steps": [{"set": {"NSOLL_A": text}}]}, [{}])
    assert sent[-1]["NSOLL_A"] == raw


def test_mute_provider_stop_hold_and_drive_commands_reach_the_edge() -> None:
    steps = [{"mute": True}, {"run": False}, {"drive": "fault 7"}, {"hold": "20 ms"}]
    commands: list[str] = []
    engine, sent = run_plc({"steps": steps}, [{}], commands.append)
    assert engine.muted
    assert not engine.endpoint.run
    assert commands == ["fault 7"]
    assert len(sent) == 6


def test_an_encoder_is_enabled_preset_and_acknowledged() -> None:
    steps = [{"enable": True}, {"preset": "relative"}, {"ack": True}]
    normal = {"ZSW2_ENC": 0x0200}
    answers = [normal, normal | {"G1_ZSW": 0x1000}, {"ZSW2_ENC": 0x0208, "G1_ZSW": 0x8000}, normal]
    engine, sent = run_plc({"telegrams": [81], "steps": steps}, answers)
    assert engine.passed
    words = [(values["STW2_ENC"], values["G1_STW"]) for values in sent]
    assert words == [(0x0400, 0x1800), (0x0400, 0x0800), (0x0480, 0x8800), (0x0400, 0x0800)]


def element(value: int | float | str, error: int | None = None) -> Element:
    return Element(0, 0, None if error is not None else DataType.INTEGER32, value, error)


def parameters(step: dict[str, object], answers: list[list[Element] | Exception | None]) -> tuple[Engine, list[object]]:
    """Run one step on the parameter channel: one answer a cycle, which is an exception for an error and None for none."""
    scenario = Scenario.model_validate({"telegrams": [1, 1], "steps": [{"axis": 2, "within": "20 ms", **step}]})
    engine = Engine(scenario, PlcEndpoint([telegram(1)] * 2, CYCLE))
    asked: list[object] = []
    waiting: list[Future[list[Element]]] = []

    def request(*addressed: object) -> Future[list[Element]]:
        asked.append(addressed)
        waiting.append(Future())
        return waiting[-1]

    engine.request = request
    for cycle in range(20):
        engine.step(cycle * CYCLE)
        answer = answers[min(cycle, len(answers) - 1)]
        if waiting and isinstance(answer, Exception):
            waiting.pop().set_exception(answer)
        elif waiting and answer is not None:
            waiting.pop().set_result(answer)
        if engine.finished:
            break
    assert engine.finished
    return engine, asked


def test_parameters_are_read_from_the_drive_object_of_the_axis_until_they_are_as_expected() -> None:
    wanted = {"P922": 1, "6041h": "& 0x6F = 0x27", "P60000": 3000, "P919": "axis 2", "606Ch": "> -5"}
    good = [element(1), element(0x1637), element(3000.0), element("axis 2"), element(-4)]
    bad = [element(1), element(0x1631), element(3000.5), element("axis 3"), element(-5)]
    engine, asked = parameters({"read": wanted}, [bad, good])
    assert engine.passed
    assert asked == 2 * [(2, tuple(map(parse_target, wanted)), ())]
    assert [item.name for item in engine.results] == [f"{name} {value}" for name, value in wanted.items()]
    engine, _ = parameters({"read": wanted}, [bad])
    assert [item.passed for item in engine.results] == [True, False, False, False, False]
    assert [item.measured for item in engine.results] == ["1", "5681", "3000.5", "axis 3", "-5"]


def test_parameters_are_written_once_and_a_rejection_can_be_expected() -> None:
    step = {"write": {"6083h": 250, "P65000": "-7"}}
    refused = [element("", 0x0B), element("", 0x0B)]
    engine, asked = parameters(step, [[element(250), element(-7)]])
    assert engine.passed
    assert asked == [(2, (Target(0x6083), Target(65000)), ("250", "-7"))]
    engine, asked = parameters(step, [refused])
    assert [item.measured for item in engine.results] == ["0Bh: no operation priority"] * 2
    assert not engine.passed
    assert len(asked) == 1
    assert parameters(step | {"refused": 0x0B}, [refused])[0].passed
    assert not parameters(step | {"refused": 0x0B}, [[element(250), element(-7)]])[0].passed
    assert not parameters(step | {"refused": 0x0B}, [[element("", 2), element("", 2)]])[0].passed


@pytest.mark.parametrize(
    ("answer", "measured"),
    [
        (None, "no answer in time"),
        (GatewayError("gateway: does not answer"), "gateway: does not answer"),
        (KeyError("a mistake"), "KeyError('a mistake')"),
    ],
)
def test_a_silent_parameter_channel_fails_every_expectation_of_the_step(
    answer: Exception | None, measured: str
) -> None:
    for action in ("read", "write"):
        engine, _ = parameters({action: {"P922": 1, "P965": 2}}, [answer])
        assert [(item.passed, item.measured) for item in engine.results] == [(False, measured)] * 2


def test_capture_with_a_lost_packet_is_reported_as_incomplete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = Capture(tmp_path / "plc.pcap")
    take = capture.conversation(("127.0.0.1", 1), ("127.0.0.1", 2))

    def mistaken(_: object) -> None:
        raise ValueError("a mistake")

    monkeypatch.setattr(capture, "_file", SimpleNamespace(write=mistaken, close=lambda: None))
    take(True, bytes(46))
    with pytest.raises(GatewayError, match=r"cannot be written \(ValueError\('a mistake'\)\)"):
        capture.close()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_capture_on_a_full_disk_is_one_error_at_its_end() -> None:
    capture = Capture(Path("/dev/full"))
    take = capture.conversation(("127.0.0.1", 1), ("127.0.0.1", 2))
    for _ in range(1000):
        take(True, bytes(46))
    with pytest.raises(GatewayError, match=r"^--pcap /dev/full: cannot be written \(No space left on device\)$"):
        capture.close()


@pytest.mark.e2e
def test_a_plc_reads_and_writes_parameters_beside_its_cyclic_exchange_and_captures_both(tmp_path: Path) -> None:
    steps = [
        {"expect": {"ZSW1.CONTROL_REQUESTED": 1}},
        {"read": {"P965": 0x0329, "1018h.1": "> 0"}},
        {"write": {"6083h": 250, "6084h": "F9h"}},
        {"read": {"6083h": 250, "6084h": 249}},
        {"write": {"6040h": 0, "60FFh": 0}, "refused": 0x0B},
    ]
    with running(configuration()) as daemon:
        endpoint = PlcEndpoint([telegram(1)], daemon.cycle_ns)
        engine = Engine(Scenario.model_validate({"within": "120 s", "steps": steps}), endpoint)
        capture = Capture(tmp_path / "plc.pcap")
        port = record_server(daemon).address[1]
        client = PlcClient(daemon.address, endpoint, daemon.cycle_ns, capture.conversation, port)
        try:
            client.run(engine)
        finally:
            client.close()
            capture.close()
    assert engine.passed, [item for item in engine.results if not item.passed]
    assert len(engine.results) == 9
    ports = {(packet[UDP].sport, packet[UDP].dport) for packet in rdpcap(str(tmp_path / "plc.pcap"))}
    assert {port for pair in ports for port in pair} >= {34962, 34964}
    assert len(ports) == 4, "two conversations, both directions"


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.yaml")), ids=lambda path: path.name)
def test_the_scenarios_of_the_package_are_valid(path: Path) -> None:
    assert load_scenario(path).steps


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("steps: [{fly: true}]", ["step 1", "fly", "unknown word"]),
        ("steps: [{enable: true, off1: true}]", ["step 1", "2 actions", "exactly one"]),
        ("steps: [{axis: 3, enable: true}]", ["step 1", "axis 3 does not exist", "1..1"]),
        ("steps: [{set: {NSOL: 1}}]", ["step 1", "'NSOL'", "STW1, NSOLL_A"]),
        ("steps: [{set: {STW1.FOO: 1}}]", ["bit of STW1", "FOO"]),
        ("steps: [{set: {STW1.ON: 2}}]", ["STW1.ON = 2", "0..1"]),
        ("steps: [{speed: fast}]", ["NSOLL_A = 'fast'", "1500 rpm"]),
        ("steps: [{set: {NSOLL_A: 40000}}]", ["NSOLL_A", "-32768..32767"]),
        ("steps: [{speed: 40000}]", ["step 1 (speed)", "the unit is missing"]),
        ("steps: [{move: {to: 1}}]", ["step 1 (move)", "not in the telegram"]),
        ("steps: [{hold: soon}]", ["time 'soon'"]),
        ("telegrams: [113]\nsteps: [{off1: true}]", ["telegram", "113"]),
        ("steps: []", ["steps"]),
        ("steps: [", ["not valid YAML"]),
        ("just text", ["expected keys with values"]),
        ("telegrams: [9]\nsteps: [{move: {to: 1, fast: 2}}]", ["step 1", "move.fast", "velocity, acc, dec, relative"]),
        ("references: {rpm: 2}\nsteps: [{off1: true}]", ["references.rpm", "speed_rpm, position"]),
        ("references: {speed_rpm: .inf}\nsteps: [{speed: 5 rpm}]", ["references.speed_rpm = inf", "finite"]),
        ("steps: [{speed: [1]}]", ["step 1: speed: expected a number or a text"]),
        ("steps: [{expect: {}}]", ["step 1", "expect", "at least one"]),
        ("steps: [{set: {}}]", ["step 1", "set", "at least one"]),
        ("steps: [{read: {}}]", ["step 1", "read", "at least one"]),
        ("steps: [{read: {speed: 1}}]", ["step 1 (read)", "parameter 'speed'", "P922"]),
        ("steps: [{write: {'P947[0..7]': 1}}]", ["step 1 (write)", "P947[0..7]", "one element"]),
        ("steps: [{enable: true, refused: 11}]", ["step 1", "refused", "allowed only with a write"]),
        ("steps: [{preset: absolute}]", ["step 1 (preset)", "'G1_STW' is not in the telegram"]),
        ("telegrams: [81]\nsteps: [{off1: true}]", ["step 1 (off1)", "not possible with telegram 81, only with 1, 2"]),
        ("steps: [{expect: {NIST_A: .nan}}]", ["step 1 (expect)", "NIST_A = 'nan'"]),
        ("when: 2001-99-99", ["not valid YAML", "month"]),
        ("[" * 500, ["nested too deeply"]),
        (f"steps: [{{speed: {'1' * 5000}}}]", ["not valid YAML"]),
        (f"steps: [{{speed: '{'1' * 5000} %'}}]", ["step 1 (speed)", "expected"]),
        (f"steps: [{{hold: '{'1' * 5000} s'}}]", ["step 1 (hold)", "time"]),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else "",
)
def test_bad_scenarios_are_rejected_with_step_key_value_and_allowed(
    tmp_path: Path, text: str, parts: list[str]
) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(text)
    with pytest.raises(GatewayError) as error:
        load_scenario(path)
    assert str(path) in str(error.value)
    for part in parts:
        assert part in str(error.value), str(error.value)


@given(text=st.text(max_size=60))
def test_arbitrary_files_are_refused_with_the_packages_error(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    path = tmp_path_factory.getbasetemp() / "s.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(GatewayError):
        load_scenario(path)


def test_times_are_milliseconds_or_seconds() -> None:
    assert parse_time("500 ms") == 500 * MS
    assert parse_time("1.5 s") == 1500 * MS


def test_over_profinet_the_sign_of_life_counts_with_each_cycle_too(monkeypatch: pytest.MonkeyPatch) -> None:
    half, life = telegram(105).setpoints, signal("STW2").bit("SIGN_OF_LIFE")
    sent: list[int] = []
    provider = SimpleNamespace(
        place=lambda _: (0, half.size),
        set=lambda _, data, good: sent.append(life.of(half.decode(data)[half.index("STW2")])),
    )
    controller = SimpleNamespace(provider=provider)
    monkeypatch.setattr(
        "pdgw.peers.controller.plc.RunningController", lambda *_: SimpleNamespace(controller=controller)
    )
    endpoint = PlcEndpoint([telegram(105)], 4_000_000)
    endpoint.count(0, "STW2", life)
    plc = ProfinetPlc("eth1", "press-1", IPv4Interface("192.168.0.2/24"), endpoint, 4_000_000)
    for _ in range(17):
        plc._send()
    assert sent == [*range(1, 16), 1, 2]
