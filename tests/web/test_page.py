"""The interface of the page: documents, streams that resume, limits, headers, trends; data of a silent gateway."""

from __future__ import annotations

import csv
import io
import json
import socket
import struct
import threading
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.service.events import EventLog
from pdgw.gateway.trace.reader import RingReader
from pdgw.gateway.trace.recorder import FlightRecorder
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.decoder.capture.pcap import read_capture
from pdgw.tools.decoder.frames.records import LinkType
from pdgw.tools.output.status_text import status_lines
from pdgw.tools.web.app import READS_PER_S, Allowance
from pdgw.tools.web.server.guard import HEADERS, Token
from pdgw.tools.web.server.server import CONNECTIONS_MAX
from pdgw.tools.web.status.events import KEPT
from pdgw.tools.web.status.events import EventLog as Lines
from pdgw.tools.web.status.feed import Document
from pdgw.tools.web.status.watch import Watch
from pdgw.tools.web.stream import STREAMS_MAX
from pdgw.tools.web.trend import Traces, usual
from tests.support.buses import PATIENCE_S
from tests.support.gateways.daemon import OFF, Plc, axis, configuration, drive_of, online, running
from tests.support.page import TOKEN, Page, ShownGateway, events_of, look, page, until

ENCODER = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 83\nsimulate = true\n"


class Turning:
    """An axis that turns at half speed and an encoder, in virtual time, with their flight recorder, and the page of them."""

    def __init__(self, directory: Path, at_end: ExitStack) -> None:
        config = configuration(axis(1) + ENCODER, name="line-3")
        self.daemon = at_end.enter_context(
            running(config, lambda daemon: daemon.services.append(FlightRecorder(daemon, directory, "test")))
        )
        self.gateway = ShownGateway()
        self.plc = Plc(self.daemon, [1, 83])
        self.plc.enable()
        self.plc.endpoint.set(0, {"NSOLL_A": 0x2000})
        self.plc.until(lambda: self.plc.value("NIST_A") == 0x2000, "half speed")
        self.gateway.show(self.daemon)
        self.page = at_end.enter_context(page(self.daemon.config, self.gateway))
        self.page.heard()

    def lose_drive(self) -> None:
        """The drive is switched off while it turns."""
        drive_of(self.daemon).node.power_off()
        axis = self.daemon.axes[0]
        self.plc.until(lambda: axis.faults and axis.reason is Reason.DRIVE_OFFLINE, "drive lost")


@pytest.fixture
def turning(tmp_path: Path) -> Iterator[Turning]:
    with ExitStack() as at_end:
        yield Turning(tmp_path, at_end)


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """The page of an axis that turned until now."""
    with ExitStack() as at_end:
        yield Turning(tmp_path_factory.mktemp("ring"), at_end).page


@pytest.fixture(scope="module")
def still() -> Iterator[Page]:
    """The page of a gateway nothing happens at."""
    gateway = ShownGateway()
    with running(configuration(axis(1) + ENCODER, name="line-3")) as daemon:
        gateway.show(daemon)
        with page(daemon.config, gateway) as served:
            served.heard()
            yield served


@contextmanager
def stream(served: Page, query: str = "", **headers: str) -> Iterator[Iterator[tuple[str, str, object]]]:
    """The messages of a stream."""
    answer = served.get(f"/api/v1/events{query}", **headers)
    assert (answer.status, answer.headers["content-type"]) == (200, "text/event-stream")

    def messages() -> Iterator[tuple[str, str, object]]:
        while True:
            yield from events_of(answer, 1)

    try:
        yield messages()
    finally:
        answer.close()


# -- documents -----------------------------------------------------------------------------------------------------------


def test_status_is_the_gateway_document_with_its_age(turning: Turning) -> None:
    document = turning.page.document("/api/v1/status")
    assert document["stale"] is False
    own = turning.gateway.document
    assert {key: document[key] for key in own if key != "buses"} == {key: own[key] for key in own if key != "buses"}
    item = document["axes"][0]
    assert (item["speed_rpm"], item["speed_text"]) == (1500, "1500 of 1500 rpm")
    assert any(f", {item['speed_text']})" in line for line in status_lines(document, 400)), "status shows the same"

    turning.gateway.failure = "hangs"
    turning.page.heard()
    answer = turning.page.get("/api/v1/status")
    assert answer.status == 503
    old = json.loads(answer.read())
    assert (old["stale"], old["axes"][0]["speed_rpm"]) == (True, 1500)
    assert old["answered"] >= document["answered"]
    turning.page.heard()
    assert turning.page.document("/api/v1/status") == old, "as it was when it last answered"


def test_health_is_of_the_page_and_readiness_of_the_axes(turning: Turning) -> None:
    served = turning.page
    assert [served.get(path).status for path in ("/healthz", "/readyz")] == [200, 200]
    turning.lose_drive()
    turning.gateway.show(turning.daemon)
    served.heard()
    assert [served.get(path).status for path in ("/healthz", "/readyz")] == [200, 503]
    turning.gateway.failure = "hangs"
    served.heard()
    assert [served.get(path).status for path in ("/healthz", "/readyz")] == [503, 503]


def test_every_answer_has_the_headers_that_keep_the_page_to_itself(still: Page) -> None:
    for path in ("/", "/static/app.js", "/api/v1/status", "/metrics", "/nowhere", "/static/nowhere", "/healthz"):
        answer = still.get(path)
        for name, value in HEADERS.items():
            assert answer.headers[name] == value, path
        assert "server" not in answer.headers
        assert "access-control-allow-origin" not in answer.headers


@pytest.mark.parametrize(
    ("path", "status", "field", "part"),
    [
        ("/nowhere", 404, "path", "Not Found"),
        ("/api/v1/objects/9/faults", 404, "do_id", "allowed: 1, 2"),
        ("/api/v1/objects/x/faults", 400, "do_id", "whole number"),
        ("/api/v1/telegrams/77", 404, "number", "telegram"),
        ("/api/v1/objects/1/trace?seconds=0", 400, "seconds", "1 to 600"),
        ("/api/v1/objects/1/trace?seconds=1e3", 400, "seconds", "whole number"),
        ("/api/v1/objects/1/trace?bins=" + "9" * 5000, 400, "bins", "bins"),
        ("/api/v1/events?after=-1", 400, "after", "whole number"),
        ("/api/v1/events?trace=9", 404, "trace", "drive object 9 does not exist"),
        ("/api/v1/objects/1/trace", 502, "gateway", "no flight recorder"),
        ("/static/../app.py", 404, "path", "Not Found"),
        ("/static/%2e%2e/app.py", 404, "path", "Not Found"),
    ],
)
def test_missing_or_forbidden_requests_are_rejected_with_their_field(
    still: Page, path: str, status: int, field: str, part: str
) -> None:
    answer = still.get(path)
    document = json.loads(answer.read())
    assert (answer.status, document["field"]) == (status, field)
    assert part in document["error"]


def test_words_are_declared_with_bits_and_units(still: Page) -> None:
    telegram = still.document("/api/v1/telegrams/9")
    stw1, *_ = telegram["setpoints"]
    assert [bit["name"] for bit in stw1["bits"] if bit["position"] in {4, 10}] == ["DO_NOT_REJECT", "CONTROL_BY_PLC"]
    nsoll = still.document("/api/v1/telegrams/1")["setpoints"][1]
    assert (nsoll["name"], nsoll["digits"], nsoll["bits"]) == ("NSOLL_A", 4, [])
    states = still.document("/api/v1/states")
    assert states["OBEYS"] == {"text": "In operation", "symbol": "●"}
    assert len(states) == 7


def test_the_about_view_has_licences_and_the_configuration_without_secrets() -> None:
    gateway = ShownGateway()
    bus = '[can]\ninterface = "virtual"\nchannel = "world"\nremote_password = "hidden"\n'
    with running(configuration(axis(1), can=bus)) as daemon:
        gateway.show(daemon)
        with page(daemon.config, gateway) as served:
            document = served.document("/api/v1/about")
            archive = zipfile.ZipFile(io.BytesIO(served.get("/api/v1/support").read()))
    assert "hidden" not in document["configuration"]
    assert 'remote_password = "..."' in document["configuration"]
    licences = {item["name"]: item["licence"] for item in document["licences"]}
    assert (licences["uplot"], licences["lit-html"], licences["starlette"]) == ("MIT", "BSD-3-Clause", "BSD-3-Clause")
    assert not {"scapy", "pytest", "ruff", "mypy", "hypothesis", "playwright"} & set(licences), "only what runs"
    assert set(archive.namelist()) == {"status.json", "events.json", "gateway.toml", "capture.txt"}
    assert b"hidden" not in archive.read("gateway.toml")


def test_no_more_than_five_parameters_are_read_in_a_second() -> None:
    allowance = Allowance(READS_PER_S)
    assert [allowance.take(moment) for moment in (0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.99)] == [True] * 5 + [False] * 2
    assert [allowance.take(moment) for moment in (1.0, 1.05, 1.1)] == [True, False, True]
    assert [allowance.take(9) for _ in range(6)] == [True] * 5 + [False]


def test_parameters_are_read_one_at_a_time(still: Page) -> None:
    (element,) = still.document("/api/v1/objects/2/parameters?pnu=P922")["elements"]
    assert (element["parameter"], element["value"]) == ("P922", 2)
    with still.parameters.slow:  # the reading thread has to wait
        first = still.ask("/api/v1/objects/1/parameters/dump")
        until(lambda: still.parameters.waiting, "the first read")
        answer = still.get("/api/v1/objects/1/parameters?pnu=P922")
        assert answer.status == 429
        assert "one read at a time" in json.loads(answer.read())["error"]
    assert json.loads(first.getresponse().read())["do_id"] == 1


def test_invalid_parameter_is_reported(still: Page) -> None:
    answers = []

    def answered() -> bool:
        answers.append(still.get("/api/v1/objects/1/parameters?pnu=P9"))
        return answers[-1].status != 429

    until(answered, "a read")
    assert answers[-1].status == 400
    assert json.loads(answers[-1].read()) == {"error": "parameter 'P9': only P922 here", "field": "pnu"}


@pytest.mark.parametrize("path", ["objects/{}/faults", "telegrams/{}", "objects/1/trace?seconds={}", "events?trace={}"])
def test_number_of_any_length_is_reported(still: Page, path: str) -> None:
    for digits in (16, 21, 5000):
        answer = still.get("/api/v1/" + path.format("9" * digits))
        assert answer.status in (400, 404)
        assert "expected" in (text := json.loads(answer.read())["error"]) or "allowed" in text


@pytest.mark.parametrize("key", ["uptime_s", "counters", "buses"])
def test_status_of_another_version_is_ignored_and_polling_continues(turning: Turning, key: str) -> None:
    whole = turning.gateway.document
    turning.gateway.document = {name: value for name, value in whole.items() if name != key}
    turning.page.heard()
    assert turning.page.get("/api/v1/status").status == 503
    turning.gateway.document = whole
    turning.page.heard()
    assert turning.page.get("/api/v1/status").status == 200


# -- streams -------------------------------------------------------------------------------------------------------------


def test_a_stream_has_the_status_and_every_event_once(turning: Turning) -> None:
    with stream(turning.page) as messages:
        first = [next(messages) for _ in range(12)]
        kinds = {kind for kind, _, _ in first}
        assert kinds == {"event", "status"}
        turning.lose_drive()
        turning.gateway.show(turning.daemon)
        texts: list[str] = []
        while not {"fault 101", "Not on the bus"} <= {text.partition(":")[0] for text in texts}:
            kind, _, data = next(messages)
            texts += [data["text"]] if kind == "event" else []  # type: ignore[index]
    assert any(text.startswith("fault 101: node lost") for text in texts)
    assert len(texts) == len(set(texts))


def test_run_between_two_answers_of_the_gateway_is_in_the_events() -> None:
    gateway = ShownGateway()
    with running(configuration(axis(1))) as daemon:
        online(daemon)
        gateway.show(daemon)
        watch = Watch(daemon.config, gateway)
        look(watch)
        before = watch.log.newest
        plc = Plc(daemon, [1])
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_A": 0x1000})
        plc.until(lambda: plc.value("NIST_A") == 0x1000, "the speed")
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 0x01, "standstill")
        plc.silent = True
        plc.until(lambda: daemon.axes[0].reason is Reason.PLC_LOST, "the loss")
        gateway.show(daemon)
        look(watch)
        look(watch)
    events = [f"{event.kind} {event.text.partition(':')[0]}" for event in watch.log.after(before)]
    assert events == [
        "plc PLC connected (plc",
        "reason In operation",
        "reason Stopping",
        "reason Off",
        "plc PLC not connected",
        "fault fault 103",
        "reason Waits",
    ]


@pytest.mark.parametrize("clock_s", [3600, -3600])
def test_events_of_a_restarted_gateway_are_shown_once_whatever_its_clock(clock_s: int) -> None:
    gateway = ShownGateway()
    with running(configuration(axis(1))) as daemon:
        watch = Watch(daemon.config, gateway)
        gateway.show(daemon)
        look(watch)
    with running(configuration(axis(1))) as daemon:
        start = daemon.loop.wall()
        later = EventLog(lambda: start + clock_s)
        later.add("gateway", None, "gateway started, version 2")
        daemon.events = later
        gateway.show(daemon)
        look(watch)
        look(watch)
        later.add("plc", None, "PLC connected")
        gateway.show(daemon)
        look(watch)
    events = [(event.text, event.count) for event in watch.log.after(0)]
    assert events[-2:] == [("gateway started, version 2", 1), ("PLC connected", 1)]


def test_stream_continues_after_the_last_received_event(turning: Turning) -> None:
    with stream(turning.page) as messages:
        seen = [next(messages) for _ in range(6)]
    ids = [int(number) for kind, number, _ in seen if kind == "event"]
    assert ids == list(range(ids[0], ids[0] + len(ids)))
    for resumed in ({"query": f"?after={ids[1]}"}, {"last_event_id": str(ids[1])}):
        with stream(turning.page, **resumed) as messages:
            kind, number, _ = next(messages)
            assert (kind, int(number)) == ("event", ids[2])


def test_event_log_drops_the_oldest_and_resumes_after_a_restart() -> None:
    log = Lines(4999)
    for number in range(KEPT + 10):
        log.add("t", "plc", None, str(number))
    assert [event.id for event in log.after(0)] == list(range(5010, 5010 + KEPT))
    assert [event.id for event in log.after(5010 + KEPT - 2)] == [5010 + KEPT - 1]
    assert log.after(5010 + KEPT - 1) == []
    assert len(log.after(3000)) == KEPT, "a page of an earlier process gets all there is"
    assert len(log.after(10**15)) == KEPT, "so does one whose number nobody gave"


def test_gateway_is_queried_once_for_all_viewers(turning: Turning) -> None:
    with ExitStack() as at_end:
        opened = [at_end.enter_context(stream(turning.page)) for _ in range(5)]
        for messages in opened:
            next(messages)
        # The page continues to ask: read the ticks around the requests, so that each request counts with its tick.
        ticks = turning.page.watch.feed.ticks
        before = turning.gateway.asked
        turning.page.heard()
        asked = turning.gateway.asked - before
        assert asked <= turning.page.watch.feed.ticks - ticks + 1


def test_there_are_no_more_streams_than_allowed(still: Page) -> None:
    with ExitStack() as at_end:
        for _ in range(STREAMS_MAX):
            next(at_end.enter_context(stream(still)))
        answer = still.get("/api/v1/events")
        assert answer.status == 503
        assert json.loads(answer.read())["field"] == "streams"
        assert still.get("/api/v1/status").status == 200
    until(lambda: still.get("/api/v1/events").status == 200, "a place after the streams were closed")


def test_flood_of_connections_is_limited(still: Page) -> None:
    until(lambda: still.get("/healthz").status == 200, "the page")
    flood = [socket.create_connection(("127.0.0.1", still.port)) for _ in range(CONNECTIONS_MAX + 20)]
    try:
        closed = 0
        for connection in flood[-10:]:
            connection.settimeout(PATIENCE_S)
            try:
                closed += connection.recv(1) == b""
            except ConnectionResetError:
                closed += 1
        assert closed == 10, "connections beyond the bound are closed at once"
    finally:
        for connection in flood:
            connection.close()

    def answers() -> bool:
        try:
            return still.get("/healthz").status == 200
        except OSError:
            return False

    until(answers, "the page after the flood")


@pytest.mark.parametrize(
    "data", [b"\x16\x03\x01garbage\r\n\r\n", b"GET / HTTP/1.1\r\n" + b"x: y\r\n" * 5000, b"GET /\0 HTTP/1.1\r\n\r\n"]
)
def test_invalid_requests_are_rejected_and_the_page_continues(still: Page, data: bytes) -> None:
    with socket.create_connection(("127.0.0.1", still.port), timeout=PATIENCE_S) as connection:
        try:
            connection.sendall(data)
            assert connection.recv(100).startswith((b"HTTP/1.1 400", b""))
        except OSError:
            pass  # closed while it was still sent
    assert still.get("/healthz").status == 200


def test_streams_take_the_cookie_until_the_token_changes(tmp_path: Path) -> None:
    gateway = ShownGateway()
    with running(configuration(axis(1))) as daemon:
        gateway.show(daemon)
        file = tmp_path / "token"
        file.write_text(TOKEN)
        with page(daemon.config, gateway, Token.of(file)) as served:
            assert served.get("/api/v1/events").status == 401
            answer = served.get("/api/v1/login", authorization=f"Bearer {TOKEN}")
            cookie = answer.headers["set-cookie"].partition(";")[0]
            opened = served.get("/api/v1/events", cookie=cookie)
            events_of(opened, 1)
            file.write_text("another token of enough characters")
            until(lambda: not opened.readline(), "the end of the stream")
            assert served.get("/api/v1/status", cookie=cookie).status == 401


# -- trends --------------------------------------------------------------------------------------------------------------


def test_a_trend_has_set_and_actual_values_in_their_unit(turned: Page) -> None:
    document = turned.document("/api/v1/objects/1/trace?seconds=1")
    assert [(item["name"], item["unit"]) for item in document["signals"]] == [("NIST_A", "rpm"), ("NSOLL_A", "rpm")]
    assert [column[-1] for column in document["values"]] == [1500, 1500]
    assert document["time"] == sorted(document["time"])
    assert 200 < len(document["time"]) <= 251, "a second at 4 ms"


@pytest.mark.parametrize(
    ("number", "names"),
    [(9, ["XIST_A", "MDI_TARPOS"]), (111, ["XIST_A", "MDI_TARPOS"]), (112, ["XIST_F", "MDI_TARPOS_F"])],
)
def test_the_usual_trend_of_a_positioning_axis_has_positions(number: int, names: list[str]) -> None:
    assert usual({}, telegram(number)) == names


def test_a_trend_in_bins_keeps_the_extremes(turning: Turning) -> None:
    turning.plc.endpoint.set(0, {"NSOLL_A": 0x7000})
    turning.plc.exchange()
    turning.plc.endpoint.set(0, {"NSOLL_A": 0})
    for _ in range(200):
        turning.plc.exchange()
    document = turning.page.document("/api/v1/objects/1/trace?seconds=10&bins=10&signals=NSOLL_A")
    (values,) = document["values"]
    assert len(values) <= 22
    assert max(values) == 5250, "a peak of one cycle is not lost"


def test_a_trend_as_a_file_for_a_spreadsheet(turned: Page) -> None:
    for query, headers in (("&format=csv", {}), ("", {"accept": "text/csv"})):
        answer = turned.get(f"/api/v1/objects/1/trace?seconds=1&signals=velocity,NIST_A{query}", **headers)
        assert answer.headers["content-type"].startswith("text/csv")
        rows = list(csv.reader(io.StringIO(answer.read().decode())))
        assert rows[0] == ["time_s", "velocity (rpm)", "NIST_A (rpm)"]
        assert [float(cell) for cell in rows[-1][1:]] == [1500, 1500]


def test_unknown_signals_are_reported_with_the_known_ones(turned: Page) -> None:
    answer = turned.get("/api/v1/objects/1/trace?signals=SPEED")
    document = json.loads(answer.read())
    assert (answer.status, document["field"]) == (400, "signals")
    assert "unknown, allowed: NSOLL_A, NIST_A, velocity" in document["error"]


def test_a_stream_brings_what_the_recorder_wrote_since(turning: Turning) -> None:
    with stream(turning.page, "?trace=1") as messages:
        for kind, _, _ in messages:
            if kind == "status":
                break
        turning.plc.endpoint.set(0, {"NSOLL_A": 0x1000})
        for _ in range(50):
            turning.plc.exchange()
        chunk = next(data for kind, _, data in messages if kind == "trace")
    assert isinstance(chunk, dict)
    assert chunk["do_id"] == 1
    assert min(chunk["values"][1]) == 750


def test_actual_values_end_while_the_drive_is_lost_and_return(turning: Turning) -> None:
    def newest() -> list[object]:
        document = turning.page.document("/api/v1/objects/1/trace?seconds=1&signals=NIST_A,NSOLL_A,velocity")
        return [column[-1] for column in document["values"]]

    assert newest() == [1500, 1500, 1500]
    turning.lose_drive()
    assert newest() == [None, 1500, None], "the PLC still receives its last speed, marked as bad"
    drive_of(turning.daemon).node.start(turning.daemon.loop.now())
    turning.plc.until(lambda: turning.daemon.axes[0].good, "the drive is back")
    turning.plc.exchange()
    assert newest() == [0, 1500, 0]


def test_trend_and_history_at_once_use_a_reader_each(turning: Turning, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader keeps its place in the ring, so two threads would read a piece twice or not at all."""
    threads: dict[RingReader, set[int]] = {}
    follow = RingReader._follow

    def watched(reader: RingReader) -> None:
        threads.setdefault(reader, set()).add(threading.get_ident())
        follow(reader)

    monkeypatch.setattr(RingReader, "_follow", watched)
    traces = Traces(lambda: turning.gateway.document)
    documents: list[Document] = []
    thread = threading.Thread(
        target=lambda: documents.extend(traces.history(1, 10, ["NIST_A"], None) for _ in range(20))
    )
    thread.start()
    tick = 0
    while thread.is_alive():
        turning.plc.exchange()
        tick += 1
        assert b'"error"' not in traces.live(1, tick)
    thread.join()
    assert len(documents) == 20
    assert all(len(used) == 1 for used in threads.values())


def test_trend_that_cannot_be_read_leaves_the_status_alone(turning: Turning, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RingReader, "cycles", lambda *_: struct.unpack(">I", b""))
    with stream(turning.page, "?trace=1") as messages:
        found = [next(messages) for _ in range(40)]
        assert sum(kind == "status" for kind, _, _ in found) > 5
        error = next(data for kind, _, data in found if kind == "trace")
        assert error == {"do_id": 1, "error": "unpack requires a buffer of 4 bytes"}
        monkeypatch.undo()
        for _, _, data in messages:
            turning.plc.exchange()
            if isinstance(data, dict) and data.get("values"):
                break


def test_the_trend_follows_the_daemon_to_its_next_ring(turning: Turning, tmp_path: Path) -> None:
    before = turning.page.document("/api/v1/objects/1/trace?seconds=10")
    ring = Path(turning.gateway.document["trace"])
    ring.rename(ring.with_suffix(".gone"))
    answer = turning.page.get("/api/v1/objects/1/trace?seconds=10")
    assert answer.status == 502
    ring.with_suffix(".gone").rename(ring)
    assert turning.page.document("/api/v1/objects/1/trace?seconds=10")["values"] == before["values"]


def test_the_last_seconds_of_both_buses_are_a_capture(turned: Page, tmp_path: Path) -> None:
    file = tmp_path / "page.pcapng"
    file.write_bytes(turned.get("/api/v1/capture?seconds=1").read())
    with file.open("rb") as stream:
        links = {packet.link for packet in read_capture(stream, "page")}
    assert links == {LinkType.CAN_SOCKETCAN, LinkType.ETHERNET}
    archive = zipfile.ZipFile(io.BytesIO(turned.get("/api/v1/support").read()))
    assert archive.read("capture.pcapng")[:4] == b"\x0a\x0d\x0d\x0a"


def test_an_encoder_has_a_trend_too(turned: Page) -> None:
    document = turned.document("/api/v1/objects/2/trace?seconds=1")
    assert document["signals"]
    assert all(len(column) == len(document["time"]) for column in document["values"])
