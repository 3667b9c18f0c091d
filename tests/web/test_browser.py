"""The page in Chromium: what a technician reads when an axis moves, and when it does not.

The gateway runs in virtual time and the test advances it. The test waits for the browser and never sleeps.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from pdgw.gateway.base.reasons import AxisState, Enable, Reason
from pdgw.gateway.trace.recorder import FlightRecorder
from pdgw.tools.output.reports import Check, Report
from pdgw.tools.recording.recordings import Part, write_page
from pdgw.tools.web import stream
from tests.support.axis.recorded import RecordedRig, speed
from tests.support.buses import PATIENCE_S
from tests.support.gateways.daemon import Plc, axis, configuration, drive_of, running
from tests.support.page import TOKEN, Page, ShownGateway, page
from tests.support.processes import free_tcp_port

if TYPE_CHECKING:
    from playwright.sync_api import Browser
    from playwright.sync_api import Page as Tab

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine (apt-get install chromium)"),
]
PATIENCE_MS = PATIENCE_S * 1000
TIMES = "watchdog_factor = 3\ncycle_time_ms = 4"
ENCODER = "[[encoder]]\ndo_id = 3\nnode_id = 20\ntelegram = 83\nsimulate = true\n"
PHONE = {"width": 390, "height": 844}
OFF, ON = 0x047E, 0x047F


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    api = pytest.importorskip("playwright.sync_api", reason="no playwright (pip install 'profidrive-gateway[browser]')")
    root = ["--no-sandbox"] if os.getuid() == 0 else []
    quiet = ["--disable-gpu", "--disable-background-networking", "--disable-component-update", "--no-first-run"]
    with api.sync_playwright() as started:
        launched = started.chromium.launch(executable_path=CHROMIUM, args=[*root, *quiet], timeout=PATIENCE_MS)
        yield launched
        launched.close()


class Shown:
    """Two axes in virtual time, the first one turning, the page of them, and a tab that shows it."""

    def __init__(self, browser: Browser, directory: Path, at_end: ExitStack) -> None:
        self.browser = browser
        self.at_end = at_end
        config = configuration(axis(1) + axis(2) + ENCODER, name="line-3", transport=TIMES)
        self.daemon = at_end.enter_context(
            running(config, lambda daemon: daemon.services.append(FlightRecorder(daemon, directory, "test")))
        )
        self.plc = Plc(self.daemon, [1, 1, 83])
        self.plc.enable()
        self.plc.endpoint.set(0, {"STW1": ON, "NSOLL_A": 0x2000})
        self.plc.until(lambda: self.plc.value("NIST_A") == 0x2000, "half speed")
        self.gateway = ShownGateway()
        self.show()
        self.served: Page = at_end.enter_context(page(config, self.gateway))
        self.noise: list[str] = []
        self.asked: list[str] = []
        self.tab = self.open()

    def show(self) -> None:
        """The page learns what the daemon would say now."""
        self.gateway.show(self.daemon)

    def open(self, path: str = "#/axes", **options: Any) -> Tab:
        """Another tab; all its requests and its console are remembered."""
        context = self.browser.new_context(**options)
        self.at_end.callback(context.close)
        tab = context.new_page()
        tab.set_default_timeout(PATIENCE_MS)
        tab.on("console", lambda message: self.noise.append(f"{message.type}: {message.text}"))
        tab.on("pageerror", lambda error: self.noise.append(str(error)))
        tab.on("request", lambda request: self.asked.append(request.url))
        tab.goto(f"{self.served.address}/{path}")
        tab.wait_for_selector("#main h2")
        return tab

    def go(self, tab: Tab, path: str) -> None:
        """To a view, by its link."""
        tab.evaluate("path => { location.hash = path; }", path)
        tab.wait_for_selector("#main h2")

    def until(self, condition: Callable[[], object], what: str) -> None:
        self.plc.until(condition, what)
        self.show()


def a_fault() -> RecordedRig:
    """A recording of an axis that turned until its drive had a fault."""
    rig = speed()
    rig.node.model.inject(7)
    rig.step(30)
    return rig


@pytest.fixture
def shown(browser: Browser, tmp_path: Path) -> Iterator[Shown]:
    with ExitStack() as at_end:
        yield Shown(browser, tmp_path, at_end)


def reads(tab: Tab, selector: str, text: str) -> None:
    """Wait until something on the page reads so."""
    tab.wait_for_function(
        "([selector, text]) => [...document.querySelectorAll(selector)]"
        ".some(e => e.innerText.replace(/\\s+/g, ' ').includes(text))",
        arg=[selector, text],
    )


def has_no_alert(tab: Tab) -> None:
    """A tab that got nothing for seconds, on a busy machine, has one until it hears the page again."""
    tab.wait_for_function("() => !document.querySelector('[role=alert]')")


def test_home_shows_every_axis_changes_by_itself_and_greys_old_values(shown: Shown) -> None:
    tab = shown.tab
    reads(tab, "[role=status]", "live, PLC connected, 1 of 2 axes in operation")
    reads(tab, "nav[aria-label=Views] a[aria-current=page]", "Axes")
    reads(tab, "[data-do='1']", "● In operation")
    reads(tab, "[data-do='1'] [data-live]", "1500 of 1500 rpm")
    reads(tab, "[data-do='2']", Reason.NO_CONTROL.value)
    assert tab.locator("[data-do='1'] .lamps .holds").count() == 9
    assert tab.locator("[data-do='2'] .lamps").get_attribute("title") == "Enables: missing: control by PLC"
    tab.wait_for_function("() => document.querySelector(\"[data-do='1'] .curve path\").getAttribute('d').includes('L')")
    assert tab.locator("[data-do]").count() == 3
    standstill = str(tab.locator("[data-do='2'] .curve path").get_attribute("d"))
    assert set(re.findall(r" ([\d.]+)", standstill)) == {"23.0"}, "a speed of 0 is at the bottom"
    shown.plc.endpoint.set(0, {"NSOLL_A": 0x1000})
    shown.until(lambda: shown.plc.value("NIST_A") == 0x1000, "a quarter of the speed")
    reads(tab, "[data-do='1'] [data-live]", "750 of 750 rpm")
    has_no_alert(tab)
    assert shown.noise == []
    assert all(url.startswith(shown.served.address) for url in shown.asked), "nobody else is asked"

    # The header is green only when all is well, and no old value keeps its colour.
    quiet = tab.evaluate("getComputedStyle(document.querySelector('small')).color")

    def colour(selector: str) -> str:
        return str(tab.evaluate("s => getComputedStyle(document.querySelector(s)).color", selector))

    reads(tab, "[role=status].waits", "1 of 2 axes in operation")  # axis 2 has no control by the PLC
    good = colour("[data-do='1'] .state")
    assert colour("[role=status]") != good
    shown.plc.silent = True
    shown.until(lambda: not shown.daemon.link.connected and not shown.daemon.axes[0].powered, "PLC lost")
    reads(tab, "[role=status].old", "no PLC, 0 of 2 axes in operation")
    shown.gateway.failure = "gone"
    reads(tab, "[role=alert]", "The gateway does not answer")
    assert {colour(f"[data-do='{number}'] .state") for number in (1, 2)} == {quiet}
    assert colour("[data-do='1'] [data-live]") == quiet


def broken(tab: Tab) -> str:
    return tab.locator("[data-chain] li.broken").first.inner_text()


def link_is(shown: Shown, tab: Tab, reason: Reason) -> None:
    """The page has reason, first broken link and remedy, word by word as the gateway says them."""
    item = shown.gateway.document["axes"][0]
    assert item["reason_id"] == reason.name
    reads(tab, "#main .reason", item["reason"])
    reads(tab, "[data-chain] li.broken", reason.enable.value)
    assert item["remedy"] in broken(tab)


def test_the_chain_names_the_first_broken_link_and_what_to_do(shown: Shown) -> None:
    tab = shown.open("#/axis/1")
    reads(tab, "#main h2", "Axis 1")
    reads(tab, ".large", "In operation")
    assert "Position" not in tab.locator(".facts").inner_text(), "of an axis with a speed telegram"
    assert tab.locator("[data-chain] li.holds").count() == 9

    shown.plc.endpoint.set(0, {"STW1": ON & ~(1 << 10)})
    shown.until(
        lambda: shown.daemon.axes[0].reason is Reason.NO_CONTROL and not shown.daemon.axes[0].powered, "control"
    )
    link_is(shown, tab, Reason.NO_CONTROL)

    shown.plc.endpoint.set(0, {"STW1": ON})
    shown.until(lambda: shown.daemon.axes[0].reason is Reason.NEEDS_OFF, "ON without OFF")
    link_is(shown, tab, Reason.NEEDS_OFF)

    shown.plc.enable()
    shown.plc.silent = True
    shown.until(lambda: shown.daemon.axes[0].reason is Reason.PLC_LOST and not shown.daemon.axes[0].powered, "PLC lost")
    reads(tab, "[data-chain] li.broken", Enable.PLC.value)
    reads(tab, ".banner", "The axes are stopped; each needs OFF, then ON.")
    shown.plc.silent = False
    shown.plc.enable()

    drive_of(shown.daemon).inject(12)
    shown.until(lambda: shown.daemon.axes[0].reason is Reason.DRIVE_FAULT, "a fault")
    link_is(shown, tab, Reason.DRIVE_FAULT)
    reads(tab, "tbody tr", "active")

    drive_of(shown.daemon).node.power_off()
    shown.until(lambda: shown.daemon.axes[0].reason is Reason.DRIVE_OFFLINE, "off the bus")
    link_is(shown, tab, Reason.DRIVE_OFFLINE)
    reads(tab, ".large", "■ Not on the bus")
    shown.gateway.document["axes"][0]["heard_age_ms"] = 51_672
    reads(tab, ".facts", "51 s ago")
    tab.get_by_role("button", name="What happened").click()
    reads(tab, ".happened li", "fault 12: EMCY")
    reads(tab, ".happened li", "Not on the bus: node 1")
    assert shown.noise == []


def test_axis_view_has_words_by_bits_and_a_live_trend(shown: Shown) -> None:
    tab = shown.open("#/axis/1")
    reads(tab, ".word", "STW1 047Fh")
    reads(tab, ".bits li.set", "ENABLE_OPERATION")
    reads(tab, ".word", "NSOLL_A 2000h 50.000 % = 1500.0 rpm")
    tab.wait_for_selector("#main canvas")
    reads(tab, ".u-legend", "NIST_A (rpm)")
    reads(tab, ".u-series", "NSOLL_A (rpm)1500.0")
    shown.plc.endpoint.set(0, {"NSOLL_A": 0x3000})
    shown.until(lambda: shown.plc.value("NIST_A") == 0x3000, "three quarters")
    reads(tab, ".word", "= 2250.0 rpm")
    reads(tab, ".u-series", "NIST_A (rpm)2250.0")
    tab.get_by_role("button", name="Pause").click()
    assert tab.get_by_role("button", name="Pause").get_attribute("aria-pressed") == "true"
    tab.get_by_role("button", name="60 s").click()
    reads(tab, "button[aria-pressed=true]", "60 s")
    with tab.expect_download() as download:
        tab.get_by_role("link", name="CSV").click()
    assert "NIST_A" in Path(download.value.path()).read_text()
    drive_of(shown.daemon).node.power_off()
    shown.until(lambda: not shown.daemon.axes[0].good, "drive lost")
    for _ in range(10):
        shown.plc.exchange()
    reads(tab, ".u-series", "NIST_A (rpm)\u2013")
    reads(tab, ".u-series", "NSOLL_A (rpm)2250.0")
    assert shown.noise == []


def test_values_are_marked_old_while_gateway_or_page_does_not_answer(
    shown: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    tab = shown.tab
    reads(tab, "[role=status]", "live")
    shown.gateway.failure = "stopped"
    reads(tab, "[role=alert]", "The gateway does not answer since")
    reads(tab, "[role=status]", "no data since")
    reads(tab, "[data-do='1'] [data-live]", "1500 of 1500 rpm")
    assert tab.locator("main.old").count() == 1
    assert tab.locator("[role=alert]").evaluate("e => getComputedStyle(e).opacity") == "1"
    shown.gateway.failure = ""
    reads(tab, "[role=status]", "live")
    has_no_alert(tab)

    with ExitStack() as first:
        served = first.enter_context(page(shown.daemon.config, shown.gateway, port=free_tcp_port()))
        tab = shown.browser.new_context().new_page()
        tab.set_default_timeout(PATIENCE_MS)
        with monkeypatch.context() as patched:
            patched.setattr(stream, "STREAMS_MAX", 0)
            tab.goto(f"{served.address}/")
            reads(tab, "[role=alert]", "0 pages are open; that is the maximum. Values below are old.")
        reads(tab, "[role=status]", "live")
    reads(tab, "[role=alert]", "This page lost its connection at")
    reads(tab, "[data-do='1'] [data-live]", "1500 of 1500 rpm")
    with page(shown.daemon.config, shown.gateway, port=served.port):
        reads(tab, "[role=status]", "live")
        has_no_alert(tab)
    tab.context.close()


def test_views_and_pages_of_files_are_accessible_fit_a_telephone_and_need_no_mouse(
    shown: Shown, tmp_path: Path
) -> None:
    files = [tmp_path / "trace.html", tmp_path / "passed.html", tmp_path / "failed.html"]
    write_page(a_fault().open(tmp_path), Part(), files[0])
    checks = (Check("axis 1", "ready", "ZSW1.READY = 1"), Check("axis 2", "speed", "NIST_A = 20", ("expected less",)))
    for number, file in enumerate(files[1:], 1):
        Report("a run", checks[:number], 'name = "line"').write(None, file)
    drive_of(shown.daemon, 2).inject(7)
    shown.until(lambda: shown.daemon.axes[1].faults, "fault")
    for scheme in ("light", "dark"):
        tab = shown.open(viewport=PHONE, color_scheme=scheme)
        assert not tab.locator("[data-do='1'] [data-label=Position]").is_visible()
        assert tab.locator("[data-do='3'] [data-label=Position]").is_visible()
        for view, text in (
            ("axes", "Axis 1"),
            ("axis/1", "From the PLC"),
            ("axis/2", "over-current"),
            ("axis/3", "Encoder 3"),
            ("plc", "Result"),
            ("buses", "worst case planned"),
            ("parameters", "No parameter is read yet"),
            ("events", "PLC connected"),
            ("about", "Licences"),
        ):
            shown.go(tab, f"#/{view}")
            reads(tab, "#main", text)
            assert tab.evaluate("document.documentElement.scrollWidth") <= PHONE["width"], f"{view} is too wide"
            is_accessible(tab)
            if view == "axis/1":  # all its enables are OK; a late status has a line until the next one
                tab.wait_for_function(
                    f"document.querySelector('.plot').getBoundingClientRect().bottom < {PHONE['height']}",
                    timeout=PATIENCE_S * 1000,
                )
        for file in files:
            tab.goto(file.as_uri())
            is_accessible(tab)
            if file.name == "trace.html":
                keys_work(tab)
    assert shown.noise == []

    # The keyboard reaches everything, and the first line stays visible.
    tab = shown.open()
    reads(tab, "[data-do='1']", "In operation")
    tab.keyboard.press("Tab")
    assert tab.evaluate("document.activeElement.id") == "skip"
    reached: list[str] = []
    for _ in range(20):
        tab.keyboard.press("Tab")
        name = tab.evaluate("document.activeElement.innerText")
        reached.append(name)
        if name == "Axis 2":
            break
    assert reached[:6] == ["Axes", "PLC", "Buses", "Parameters", "Events", "About"]
    tab.keyboard.press("Enter")
    reads(tab, "#main h2", "Axis 2")
    assert tab.evaluate("document.activeElement.id") == "main"
    assert tab.evaluate("scrollY") == 0
    top = tab.evaluate("document.querySelector('#main h2').getBoundingClientRect().top")
    assert top >= tab.evaluate("document.querySelector('header').getBoundingClientRect().bottom")

    # 64 objects with one cause fit on one screen.
    tab = shown.tab
    document = shown.gateway.document
    first = document["axes"][0] | {"state": "Waits", "state_id": "WAITS"}
    document["axes"] = [first | {"do_id": number, "label": f'axis {number} "slide"'} for number in range(1, 65)]
    document["encoders"] = []
    cause = {"state": "Waits", "state_id": "WAITS", "reason": "no PLC", "reason_id": "NO_PLC", "remedy": "start it"}
    document["causes"] = [cause | {"who": "axes 1-64", "objects": list(range(1, 65))}]
    reads(tab, ".complaints li", "Axes 1-64 waits: no PLC. To do: start it.")
    assert tab.locator(".complaints li").count() == 1
    assert tab.locator(".tiles li").count() == 64
    reads(tab, ".tiles li", 'Axis 64 "slide"')
    for number in range(1, 65):
        shown.gateway.add_event(number, f"Waits: no PLC {number}")
    shown.go(tab, "#/events")
    reads(tab, "#main", "1 to 25 of")
    assert tab.locator(".events li").count() == 25
    first = tab.locator(".events li").first.get_attribute("data-event")
    tab.get_by_role("button", name="Older").click()
    reads(tab, "#main", "26 to 50 of")
    tab.get_by_role("button", name="Newer").click()
    reads(tab, "#main", "1 to 25 of")
    assert tab.locator(".events li").first.get_attribute("data-event") == first
    shown.go(tab, "#/axes")
    bottom = tab.evaluate("document.querySelector('.tiles').getBoundingClientRect().bottom")
    assert bottom <= tab.evaluate("innerHeight"), "one screen"


def is_accessible(tab: Tab) -> None:
    """Axe-core, an independent checker, finds nothing: contrast, names, roles, headings, keyboard."""
    api = pytest.importorskip("axe_playwright_python.sync_playwright", reason="no axe-core (extra `browser`)")
    found = api.Axe().run(tab).response["violations"]
    assert [(item["impact"], item["id"], item["nodes"][0]["html"]) for item in found] == [], tab.url


def keys_work(tab: Tab) -> None:
    """On a page with curves: every curve and the list of what happened can be reached and used."""
    tab.locator("canvas").first.focus()
    before = tab.locator("canvas").first.evaluate("e => e.toDataURL()")
    for key in ("+", "+", "ArrowRight"):
        tab.keyboard.press(key)
    assert tab.locator("canvas").first.evaluate("e => e.toDataURL()") != before
    tab.keyboard.press("Home")
    assert tab.locator("canvas").first.evaluate("e => e.toDataURL()") == before
    lines = tab.get_by_role("listbox", name="Timeline")
    lines.focus()
    chosen = lines.get_by_role("option", selected=True)
    read = [chosen.inner_text()]
    for key in ("ArrowDown", "ArrowDown", "ArrowUp"):
        tab.keyboard.press(key)
        read.append(chosen.inner_text())
    assert read[3] == read[1]
    assert len(set(read)) == 3


def test_seven_tabs_are_live_for_hidden_ones_hold_no_connection(shown: Shown) -> None:
    tabs = [shown.tab]
    for _ in range(6):
        tab = shown.tab.context.new_page()
        tab.set_default_timeout(PATIENCE_MS)
        tab.goto(f"{shown.served.address}/#/axes")
        # Headless tabs are never hidden by themselves: say it, as a browser does when another one is in front.
        tabs[-1].evaluate(
            "() => { Object.defineProperty(document, 'hidden', {get: () => true, configurable: true});"
            " document.dispatchEvent(new Event('visibilitychange')); }"
        )
        tabs.append(tab)
        reads(tab, "[role=status]", "live, PLC connected")


def test_parameters_are_read_and_events_filtered_on_request_and_texts_of_devices_stay_text(shown: Shown) -> None:
    tab = shown.open("#/parameters")
    tab.get_by_label("Parameter", exact=True).fill("P922")
    tab.get_by_role("button", name="Read").click()
    reads(tab, "tbody tr", "P922 Telegram 1")

    tab = shown.open("#/events")
    reads(tab, ".events li", "reason Axis 1 In operation")
    before = tab.locator(".events li").count()
    tab.get_by_label("Kind").select_option("plc")
    tab.wait_for_function("count => document.querySelectorAll('.events li').length < count", arg=before)
    assert {kind.inner_text() for kind in tab.locator(".events .kind").all()} == {"plc"}

    script = "<img src=x onerror=alert(1)><b>bold</b>"
    shown.gateway.document["axes"][0]["faults"] = [
        {"id": 99, "active": True, "number": 12, "code": 1, "text": script, "is_warning": False}
        | {"time": "2026-03-01T12:03:41.500+01:00", "age_s": 1}
    ]
    shown.gateway.document["axes"][0]["reason"] = script
    shown.gateway.histories[1] = shown.gateway.document["axes"][0]["faults"]
    shown.gateway.add_event(1, script)
    for view in ("axes", "axis/1", "events"):
        shown.go(shown.tab, f"#/{view}")
        reads(shown.tab, "#main", script)
        assert shown.tab.locator("#main img, #main b:text-is('bold')").count() == 0


def test_an_axis_that_is_off_is_not_red_and_one_off_the_bus_is_grey(shown: Shown) -> None:
    shown.daemon.networks["can"].on_frame(0x700 + 77, b"\x05", 0)
    for number in (0, 1):
        shown.plc.endpoint.set(number, {"STW1": OFF})
    shown.plc.endpoint.set(2, {"STW2_ENC": 1 << 10})
    shown.until(
        lambda: all(item.enable_status.state is AxisState.OFF for item in shown.daemon.axes), "both axes are off"
    )
    tab = shown.tab
    reads(tab, "[role=status].live", "0 of 2 axes in operation")
    assert tab.locator(".lamps .broken").count() == 0
    shown.go(tab, "#/axis/1")
    reads(tab, "[data-chain] li.off", Enable.ON_EDGE.value)
    assert tab.locator("[data-chain] li.broken").count() == 0
    shown.go(tab, "#/buses")
    reads(tab, "tbody tr", "77 ? not in the configuration")

    drive_of(shown.daemon).node.power_off()
    shown.until(lambda: shown.daemon.axes[0].reason is Reason.DRIVE_OFFLINE, "off the bus")
    shown.go(tab, "#/axes")
    reads(tab, "[data-do='1']", "Not on the bus")
    assert "NaN" not in str(tab.locator("[data-do='1'] .curve path").get_attribute("d"))
    reads(tab, "[role=status].old", "0 of 2 axes")
    colour = "s => getComputedStyle(document.querySelector(s)).color"
    assert tab.evaluate(colour, "[data-do='1'] .state") == tab.evaluate(colour, "[data-do='1'] small")
    assert shown.noise == []


def test_the_token_opens_the_page_and_stays_out_of_reach_of_scripts(shown: Shown) -> None:
    guarded = shown.at_end.enter_context(page(shown.daemon.config, shown.gateway, TOKEN))
    tab = shown.browser.new_context().new_page()
    tab.set_default_timeout(PATIENCE_MS)
    tab.goto(f"{guarded.address}/")
    tab.get_by_label("Token").fill("a wrong token of some length")
    tab.get_by_role("button", name="Open").click()
    reads(tab, "output", "wrong token")
    tab.get_by_label("Token").fill(TOKEN)
    tab.get_by_role("button", name="Open").click()
    reads(tab, "[role=status]", "live, PLC connected")
    assert tab.evaluate("document.cookie") == ""
    assert TOKEN not in tab.content()
    tab.context.close()
