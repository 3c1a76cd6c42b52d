"""The families of metrics that Prometheus reads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.registry import Collector

from app.core.database.files import free_bytes
from app.line.alarms.alarm import Alarm
from app.line.alarms.line_alarms import LineAlarms
from app.line.alarms.rules import PRESENT_STATES
from app.line.conditions.condition import PRIORITIES, percent_of
from app.line.history.status import HistoryStatus
from app.line.live.bus_live import BusLive, LiveState, draw_of, speed_decimals, unit_link_now
from app.people.audit.anchor import AnchorStatus
from app.system.mqtt.session import NodeSession
from app.system.opcua.settings import OpcuaProcesses
from app.system.postgresql.publisher import PublisherStatus
from app.version import VERSION
from bus.catalogue.values import OUTPUT_NUMBERS, output_is_on
from bus.instants import UnixTime, unix_now

_COUNTED = {
    "polls": "Status requests sent to a unit",
    "timeouts": "Requests that got no response in time",
    "checksum_errors": "Responses of a unit with a wrong checksum",
    "retries": "Requests sent again to a unit",
    "late": "Responses of a unit that came after the timeout",
}

_ALARM_FACTS: dict[str, tuple[str, Callable[[Alarm], bool]]] = {
    "active": ("Alarms whose condition holds, hidden ones included", lambda alarm: alarm.facts.active),
    "unacknowledged": ("Alarms to acknowledge", lambda alarm: alarm.is_unacknowledged),
    "shelved": ("Shelved alarms", lambda alarm: alarm.facts.shelved_until is not None),
    "out_of_service": ("Alarms out of service", lambda alarm: alarm.facts.out_of_service),
}


@dataclass(frozen=True, slots=True)
class Measured:
    """The data of all metrics at one moment. ``pages``: the number of open pages; ``commands``: their number
    by outcome; ``newest_backup``: its start, None if no backup is wanted; ``publisher``: None without a
    plant's database; ``nodes``: None without a broker; ``opcua``: empty if OPC UA is not served; ``data``:
    the folder of the stores."""

    live: LiveState
    pages: int
    commands: Mapping[str, int]
    anchor: AnchorStatus
    alarms: LineAlarms
    history: HistoryStatus
    newest_backup: UnixTime | None
    publisher: PublisherStatus | None
    nodes: Iterable[NodeSession] | None
    opcua: OpcuaProcesses
    data: Path


class LineCollector(Collector):
    """The collector of every family at one moment."""

    def __init__(self, measured: Measured) -> None:
        self._measured = measured

    def collect(self) -> Iterator[Metric]:
        measured = self._measured
        buses = measured.live.buses.items()
        build = "The release that runs"
        yield InfoMetricFamily("lineside_build", build, value={"version": VERSION})
        yield from _readings(buses, unix_now())
        yield from _unit_counters(buses)
        yield from _bus_gauges(buses)
        yield GaugeMetricFamily("lineside_browsers", "Connected browsers", value=measured.pages)
        commands = CounterMetricFamily("lineside_commands", "Commands by outcome", labels=["outcome"])
        for outcome, count in measured.commands.items():
            commands.add_metric([outcome], count)
        yield commands
        yield _alarm_states(measured.alarms)
        yield from _alarm_counts(measured.alarms)
        free = "Free space on the disk of the data folder"
        yield GaugeMetricFamily("lineside_disk_free_bytes", free, value=free_bytes(measured.data))
        yield from _history_metrics(measured.history)
        if (newest := measured.newest_backup) is not None:
            words = "When the newest backup was begun; without any, since when there is to be one"
            yield GaugeMetricFamily("lineside_backup_timestamp_seconds", words, value=float(newest))
        if (publisher := measured.publisher) is not None:
            yield from _publisher_metrics(publisher, unix_now())
        if measured.nodes is not None:
            yield from _node_metrics(measured.nodes)
        yield from _opcua_metrics(measured.opcua)
        degraded = 1 if measured.anchor.altered or measured.anchor.unwritten else 0
        words = "1 while the audit log is not anchored, or was altered after it was"
        yield GaugeMetricFamily("lineside_audit_degraded", words, value=degraded)


def _alarm_states(alarms: LineAlarms) -> Metric:
    present = Counter((alarm.facts.state, alarm.definition.priority) for alarm in alarms.present())
    labels = ["state", "priority"]
    family = GaugeMetricFamily(
        "lineside_alarms", "Alarms that are not normal, by state and priority", labels=labels
    )
    for state, priority in product(PRESENT_STATES, PRIORITIES):
        family.add_metric([state, priority], present[state, priority])
    return family


def _alarm_counts(alarms: LineAlarms) -> Iterator[Metric]:
    labels = ["bus", "priority"]
    places = list(product(("", *alarms.buses), PRIORITIES))
    annunciated = CounterMetricFamily(
        "lineside_alarm_annunciated", "Alarms annunciated since the server started", labels=labels
    )
    for bus, priority in places:
        annunciated.add_metric([bus, priority], alarms.list_of(bus).annunciated[priority])
    yield annunciated
    present = alarms.present()
    for name, (words, holds) in _ALARM_FACTS.items():
        count = Counter((a.definition.bus or "", a.definition.priority) for a in present if holds(a))
        family = GaugeMetricFamily(f"lineside_alarm_{name}", words, labels=labels)
        for bus, priority in places:
            family.add_metric([bus, priority], count[bus, priority])
        yield family


def _history_metrics(status: HistoryStatus) -> Iterator[Metric]:
    stored = 0 if status.state in ("paused", "failed") else 1
    yield GaugeMetricFamily("lineside_history_stored", "0 while no reading is stored", value=stored)
    size = "What the history takes on the disk of the server"
    yield GaugeMetricFamily("lineside_history_bytes", size, value=status.size_bytes)
    waiting = "Updates that are not in the store yet"
    yield GaugeMetricFamily("lineside_history_waiting", waiting, value=status.waiting)
    yield CounterMetricFamily("lineside_history_lost", "Updates that could not be stored", value=status.lost)


def _publisher_metrics(status: PublisherStatus, now: UnixTime) -> Iterator[Metric]:
    words = "For how long the plant's database has lacked something that is stored"
    yield GaugeMetricFamily("lineside_publisher_lag_seconds", words, value=status.lag_s(now))
    words = "0 while the plant's database takes nothing"
    yield GaugeMetricFamily("lineside_publisher_up", words, value=0 if status.fault else 1)
    words = "Rows that were sent to the plant's database"
    yield CounterMetricFamily("lineside_publisher_rows", words, value=status.rows)


def _node_metrics(nodes: Iterable[NodeSession]) -> Iterator[Metric]:
    """Yield the metrics of the edge nodes, one sample for each bus."""
    up = GaugeMetricFamily(
        "lineside_mqtt_up", "0 while a line is not published on the broker", labels=("bus",)
    )
    lag = GaugeMetricFamily(
        "lineside_mqtt_lag_seconds", "For how long readings of a line were not received", labels=("bus",)
    )
    sent = CounterMetricFamily("lineside_mqtt_messages", "Messages sent to the broker", labels=("bus",))
    refused = CounterMetricFamily("lineside_mqtt_refused", "Commands by MQTT, all refused", labels=("bus",))
    for node in nodes:
        bus = node.node.name
        up.add_metric([bus], float(node.status.is_connected))
        lag.add_metric([bus], node.lag_s())
        sent.add_metric([bus], node.status.sent)
        refused.add_metric([bus], node.node.refused)
    yield from (up, lag, sent, refused)


def _opcua_metrics(processes: OpcuaProcesses) -> Iterator[Metric]:
    if not processes:
        return
    (process,) = processes
    status = process.status
    gauges = {
        "up": ("0 while OPC UA is not served", float(status.is_serving)),
        "sessions": ("Sessions of OPC UA clients", status.sessions),
        "subscriptions": ("Subscriptions of OPC UA clients", status.subscriptions),
        "memory_bytes": ("What the OPC UA process takes of the memory", status.memory_bytes),
    }
    for name, (words, value) in gauges.items():
        yield GaugeMetricFamily(f"lineside_opcua_{name}", words, value=value)
    counters = {
        "refused": ("Connections, sessions and requests by OPC UA that the process refused", status.refused),
        "restarts": ("How often the OPC UA process was started again", process.restarts),
        "cpu_seconds": ("CPU time of the OPC UA process", status.cpu_s),
    }
    for name, (words, value) in counters.items():
        yield CounterMetricFamily(f"lineside_opcua_{name}", words, value=value)


def _readings(buses: Iterable[tuple[str, BusLive]], now: UnixTime) -> Iterator[Metric]:
    """Yield the readings of units. A value that is not current has no sample: a graph has a gap, not the last
    value."""
    info = InfoMetricFamily("lineside_unit", "The name of a unit", labels=["bus", "unit"])
    online = _unit_gauge("lineside_unit_online", "1 while the values of a unit are of the present")
    actual = _unit_gauge("lineside_speed_actual", "Actual speed, as the display of the unit shows it")
    commanded = _unit_gauge(
        "lineside_speed_commanded", "Commanded speed, as the display of the unit shows it"
    )
    deviation = _unit_gauge("lineside_speed_deviation", "Actual less commanded speed, as the unit shows them")
    draw = _unit_gauge("lineside_draw_percent", "Draw to the section before")
    words = "1 while an output is on, as the unit reports it"
    output = GaugeMetricFamily("lineside_output_on", words, labels=["bus", "unit", "output"])
    for name, bus in buses:
        for number, unit in bus.units.items():
            of_unit, is_online = [name, str(number)], unit_link_now(bus, unit, now) == "online"
            info.add_metric(of_unit, {"name": unit.settings.name, "group": unit.settings.group})
            online.add_metric(of_unit, 1 if is_online else 0)
            reading, decimals = unit.reading, speed_decimals(bus, unit)
            if not is_online or reading is None:
                continue
            for which in OUTPUT_NUMBERS:
                output.add_metric([*of_unit, str(which)], float(output_is_on(reading.outputs, which)))
            if decimals is None:
                continue
            families, speeds = (actual, commanded, deviation), (reading.actual, reading.commanded)
            for family, raw in zip(families, (*speeds, reading.deviation), strict=True):
                if raw is not None:
                    family.add_metric(of_unit, raw / 10**decimals)
            found = draw_of(bus, unit, now)
            if found.tenths is not None:
                draw.add_metric(of_unit, float(percent_of(found.tenths)))
    yield from (info, online, actual, commanded, deviation, draw, output)


def _unit_gauge(name: str, words: str) -> GaugeMetricFamily:
    return GaugeMetricFamily(name, words, labels=["bus", "unit"])


def _unit_counters(buses: Iterable[tuple[str, BusLive]]) -> Iterator[Metric]:
    each = [(name, unit) for name, bus in buses if bus.figures for unit in bus.figures.units]
    for field, words in _COUNTED.items():
        family = CounterMetricFamily(f"lineside_{field}", words, labels=["bus", "unit"])
        for name, unit in each:
            family.add_metric([name, str(unit.unit)], getattr(unit, field))
        yield family
    naks = CounterMetricFamily("lineside_naks", "Refusals of a unit", labels=["bus", "unit", "code"])
    for name, unit in each:
        for code, count in unit.naks.items():
            naks.add_metric([name, str(unit.unit), str(code)], count)
    yield naks


def _bus_gauges(buses: Iterable[tuple[str, BusLive]]) -> Iterator[Metric]:
    is_open = GaugeMetricFamily("lineside_bus_open", "1 while the port of a bus is open", labels=["bus"])
    scan = GaugeMetricFamily("lineside_scan_hz", "Scans of all units a second", labels=["bus"])
    use = GaugeMetricFamily("lineside_wire_utilisation", "Share of the wire in use, 0 to 1", labels=["bus"])
    linked = GaugeMetricFamily("lineside_worker_linked", "1 while a worker speaks for a bus", labels=["bus"])
    for name, bus in buses:
        linked.add_metric([name], 1 if bus.worker_connected else 0)
        is_open.add_metric([name], 1 if bus.link.link == "open" else 0)
        if bus.figures:
            scan.add_metric([name], bus.figures.scan_hz)
            use.add_metric([name], bus.figures.wire_utilisation)
    yield from (linked, is_open, scan, use)


def text(measured: Measured) -> bytes:
    """Return all metrics as Prometheus reads them."""
    registry = CollectorRegistry()
    registry.register(LineCollector(measured))
    ProcessCollector(registry=registry)
    return generate_latest(registry)
