"""``/metrics``: what the workers, the wire and the people do, for Prometheus."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Annotated, cast

from fastapi import APIRouter, Depends
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from starlette.requests import HTTPConnection
from starlette.responses import Response

from app.audit.log import Event, EventLog
from app.live.hub import Hub
from app.live.state import BusLive, LiveState
from app.web.access import Viewer
from bus.contract import UnitFigures

router = APIRouter()

OUTCOMES = ("verified", "acknowledged", "refused", "unverified", "invalid", "not_sent", "bus_closed")
_COUNTED = {
    "polls": "Status requests sent to a unit",
    "timeouts": "Requests that a unit did not answer in time",
    "checksum_errors": "Answers of a unit with a wrong checksum",
    "retries": "Requests sent again to a unit",
    "late": "Answers of a unit that came after they were given up",
}


class Counts:
    """Commands by their fate since the server started."""

    def __init__(self, events: EventLog) -> None:
        self.commands: Counter[str] = Counter(dict.fromkeys(OUTCOMES, 0))
        events.subscribe(self._see)

    def _see(self, event: Event) -> None:
        if event["kind"] == "command" and event["outcome"]:
            self.commands[event["outcome"]] += 1


class _Line(Collector):
    """One reading of everything."""

    def __init__(self, live: LiveState, hub: Hub, counts: Counts) -> None:
        self._live = live
        self._hub = hub
        self._counts = counts

    def collect(self) -> Iterator[Metric]:
        """The families of metrics."""
        yield from _of_units(self._live.buses.items())
        yield from _of_buses(self._live.buses.items())
        yield GaugeMetricFamily("lineside_browsers", "Connected browsers", value=self._hub.connected)
        commands = CounterMetricFamily("lineside_commands", "Commands by their fate", labels=["outcome"])
        for outcome, count in self._counts.commands.items():
            commands.add_metric([outcome], count)
        yield commands


def _figures(bus: BusLive) -> Iterable[UnitFigures]:
    return bus.figures.units if bus.figures else ()


def _of_units(buses: Iterable[tuple[str, BusLive]]) -> Iterator[Metric]:
    each = [(name, unit) for name, bus in buses for unit in _figures(bus)]
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


def _of_buses(buses: Iterable[tuple[str, BusLive]]) -> Iterator[Metric]:
    is_open = GaugeMetricFamily("lineside_bus_open", "1 while the port of a bus is open", labels=["bus"])
    scan = GaugeMetricFamily("lineside_scan_hz", "Rounds over all units a second", labels=["bus"])
    use = GaugeMetricFamily("lineside_wire_utilisation", "Share of the wire in use, 0 to 1", labels=["bus"])
    for name, bus in buses:
        is_open.add_metric([name], 1 if bus.link.link == "open" else 0)
        if bus.figures:
            scan.add_metric([name], bus.figures.scan_hz)
            use.add_metric([name], bus.figures.wire_utilisation)
    yield from (is_open, scan, use)


def _collector_of(connection: HTTPConnection) -> _Line:
    services = connection.app.state.services
    return _Line(cast(LiveState, services.live), cast(Hub, services.hub), cast(Counts, services.counts))


@router.get("/metrics", response_class=Response, include_in_schema=False)
async def metrics(_: Viewer, line: Annotated[_Line, Depends(_collector_of)]) -> Response:
    """Prometheus text."""
    registry = CollectorRegistry()
    registry.register(line)
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)
