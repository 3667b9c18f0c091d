"""The metrics of a gateway for Prometheus, made from its status when they are asked for.

Base units; label values are bounded by the configuration and by our own tables: no free text, no address, no speed or position.
A gateway that does not answer has ``pdgw_up`` 0 and nothing else: old values would look like a healthy machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import accumulate

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import generate_latest
from prometheus_client.registry import Collector

from pdgw.base.durations import MS_PER_SECOND
from pdgw.gateway.base.reasons import AxisState
from pdgw.gateway.links.new_frames import Verdict
from pdgw.tools.web.status.feed import Document
from pdgw.tools.web.status.watch import Watch, counter

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

_LINK_COUNTERS = (
    ("watchdog_expiries", "pdgw_plc_watchdog_expiries", "Timeouts of the PLC: no valid frame in time."),
    ("iops_bad", "pdgw_plc_iops_bad", "Frames in which the PLC marked the data of a drive object as bad."),
    ("accepted", "pdgw_plc_frames_accepted", "Frames of the PLC that were accepted."),
    ("sent", "pdgw_plc_frames_sent", "Frames sent to the PLC."),
    ("skipped", "pdgw_plc_frames_skipped", "Frames overtaken by a newer frame before the axes read them."),
)
_DROPPED = tuple(verdict.name.lower() for verdict in Verdict if verdict is not Verdict.ACCEPTED)


class GatewayCollector(Collector):
    """Makes all metrics of a watch."""

    def __init__(self, watch: Watch) -> None:
        self._watch = watch

    def collect(self) -> Iterator[Metric]:
        """For the registry."""
        document = self._watch.document
        yield GaugeMetricFamily("pdgw_up", "1 if the gateway answers.", document is not None)
        if document is None:
            return
        build = GaugeMetricFamily("pdgw_build_info", "Version of the gateway.", labels=["version", "build"])
        build.add_metric([document["version"], document.get("build", "unknown").lower().replace(" ", "_")], 1)
        yield build
        yield GaugeMetricFamily("pdgw_uptime_seconds", "Time since the gateway started.", document["uptime_s"])
        yield GaugeMetricFamily("pdgw_simulated", "1 if at least one device is simulated.", document["simulated"])
        cycle_s = document["plc"]["cycle_ms"] / MS_PER_SECOND
        yield GaugeMetricFamily("pdgw_cycle_time_seconds", "Configured cycle time.", cycle_s)
        yield from _plc(document)
        yield from _objects(document)
        yield from _acyclic(document)
        yield from self._faults(document)
        yield from self._buses(document)

    def _faults(self, document: Document) -> Iterator[Metric]:
        counts = CounterMetricFamily(
            "pdgw_faults", "Faults since this process or the gateway started.", labels=["do", "number"]
        )
        for (do_id, number), count in sorted(self._watch.fault_counts.items()):
            counts.add_metric([str(do_id), str(number)], count)
        active = GaugeMetricFamily("pdgw_fault_active", "Not acknowledged.", labels=["do", "number"])
        for item in (*document["axes"], *document["encoders"]):
            for number in item["active_faults"]:
                active.add_metric([str(item["do_id"]), str(number)], 1)
        yield from (counts, active)

    def _buses(self, document: Document) -> Iterator[Metric]:
        frames = CounterMetricFamily("pdgw_can_frames", "Frames on a bus.", labels=["bus", "direction"])
        errors = CounterMetricFamily("pdgw_can_send_errors", "Frames that the bus did not accept.", labels=["bus"])
        healthy = GaugeMetricFamily("pdgw_can_bus_healthy", "1 if the bus works.", labels=["bus"])
        load = GaugeMetricFamily("pdgw_can_bus_load_ratio", "Share of the bit rate in use.", labels=["bus", "kind"])
        for bus in document["buses"]:
            name, part = bus["name"], f"bus {bus['name']}"
            for direction in ("sent", "received"):
                frames.add_metric([name, direction], counter(document, part, direction) or 0)
            errors.add_metric([name], counter(document, part, "send_errors") or 0)
            healthy.add_metric([name], bus["healthy"])
            for kind, loads in (("planned", self._watch.loads.planned), ("measured", self._watch.loads.measured)):
                if name in loads:
                    load.add_metric([name, kind], loads[name])
        yield from (frames, errors, healthy, load)


def _plc(document: Document) -> Iterator[Metric]:
    yield GaugeMetricFamily("pdgw_plc_connected", "1 if the PLC is connected.", document["plc"]["connected"])
    for name, metric, text in _LINK_COUNTERS:
        value = counter(document, "link", name)
        if value is not None:
            yield CounterMetricFamily(metric, text, value=value)
    dropped = CounterMetricFamily("pdgw_frames_dropped", "Frames that were rejected or ignored.", labels=["reason"])
    for reason in _DROPPED:
        value = counter(document, "link", reason)
        if value is not None:
            dropped.add_metric([reason], value)
    yield dropped
    if document["plc"].get("age_limit_ms"):
        limit_s = document["plc"]["age_limit_ms"] / MS_PER_SECOND
        yield GaugeMetricFamily(
            "pdgw_age_max_seconds", "Greatest age of a frame of the PLC that counted.", document["age_times"]["max_s"]
        )
        yield GaugeMetricFamily("pdgw_age_limit_seconds", "Frames of the PLC that may be older do not count.", limit_s)
    for name, text in (
        ("cycle", "Time from one step of the drive objects to the next."),
        ("response", "Time from a frame of the PLC to its answer."),
        ("age", "Greatest possible age of the PLC's frames: the round trip (UDP, not direct)."),
    ):
        yield _histogram(f"pdgw_{name}_seconds", text, document[f"{name}_times"])


def _histogram(name: str, text: str, times: Document) -> Metric:
    """``times``: upper bounds, the count of each and of those above, the sum."""
    ends = [*(f"{bound:g}" for bound in times["bounds_s"]), "+Inf"]
    buckets = list(zip(ends, accumulate(times["counts"]), strict=True))
    return HistogramMetricFamily(name, text, buckets=buckets, sum_value=times["sum_s"])


def _objects(document: Document) -> Iterator[Metric]:
    state = GaugeMetricFamily("pdgw_axis_state", "1 for the state of a drive object.", labels=["do", "state"])
    blocked = GaugeMetricFamily(
        "pdgw_object_blocked", "Reason why the drive object is not in operation.", labels=["do", "reason"]
    )
    online = GaugeMetricFamily("pdgw_node_online", "1 if the device is on the bus.", labels=["do", "node"])
    age = GaugeMetricFamily(
        "pdgw_heartbeat_age_seconds", "Time since the last frame of the device.", labels=["bus", "node"]
    )
    for item in (*document["axes"], *document["encoders"]):
        do_id, node = str(item["do_id"]), str(item["node_id"])
        for known in AxisState:
            state.add_metric([do_id, known.name.lower()], item["state_id"] == known.name)
        if item["reason_id"]:
            blocked.add_metric([do_id, item["reason_id"].lower()], 1)
        online.add_metric([do_id, node], item["drive"] == "online")
        if item["heard_age_ms"] is not None and not any(
            sample.labels == {"bus": item["bus"], "node": node} for sample in age.samples
        ):
            age.add_metric([item["bus"], node], item["heard_age_ms"] / MS_PER_SECOND)
    info = GaugeMetricFamily("pdgw_object_info", "Name of a drive object.", labels=["do", "name"])
    for item in (*document["axes"], *document["encoders"]):
        if item["name"]:
            info.add_metric([str(item["do_id"]), item["name"]], 1)
    yield from (state, blocked, online, age, info)


def _acyclic(document: Document) -> Iterator[Metric]:
    aborts = CounterMetricFamily("pdgw_sdo_aborts", "SDO accesses that the node rejected.", labels=["bus", "node"])
    nodes = {(item["bus"], item["node_id"]) for item in (*document["axes"], *document["encoders"])}
    for bus, node in sorted(nodes):
        aborts.add_metric([bus, str(node)], counter(document, f"node {node} on {bus}", "sdo_aborts") or 0)
    requests = CounterMetricFamily(
        "pdgw_parameter_requests", "Requests of the parameter channel.", labels=["do", "result"]
    )
    for do_id in (0, *(item["do_id"] for item in (*document["axes"], *document["encoders"]))):
        for result in ("answered", "refused"):
            value = counter(document, f"parameters of DO {do_id}", result)
            if value is not None:
                requests.add_metric([str(do_id), result], value)
    yield from (aborts, requests)


def exposition(watch: Watch) -> Callable[[], bytes]:
    """A function that gives the metrics in the text format 0.0.4."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(GatewayCollector(watch))
    return lambda: generate_latest(registry)
