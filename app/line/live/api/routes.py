"""``GET /line``, the buses, the units and ``GET /stream``: the live state over HTTP, and ``GET
/asyncapi.json``, the description of the stream as an AsyncAPI 3.0 document.

The stream sends changes of the line as they are reported, the same for every program. Each change is a
Server-Sent Event (WHATWG HTML, 9.2), numbered without a gap. It is found once, by comparing what the API
shows of a unit with what it showed before; nothing is compared while no one reads. A program that reads too
slowly, or was away for too long, gets a snapshot in place of what it missed: no queue grows for it. The
sockets ``/live`` and ``/feed`` are not described, because they connect parts of one release.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache, partial
from itertools import cycle, islice
from math import ceil
from secrets import token_hex
from typing import Annotated, Any, NamedTuple

import msgspec
from fastapi import APIRouter, Depends, Header, Query
from pydantic import TypeAdapter
from pydantic.json_schema import JsonSchemaMode
from starlette.requests import HTTPConnection, Request
from starlette.responses import Response, StreamingResponse
from typing_extensions import TypedDict

from app.core.server.addresses import source_of
from app.core.web.access import Viewer
from app.core.web.api import ApiRoute, schema_name, with_published_names
from app.core.web.assets import Asset
from app.core.web.request_rules import parse_apart
from app.core.web.routes import GuardedRoute
from app.core.web.services import service
from app.core.web.shape import iso, parse_integer
from app.errors import Problem
from app.line.live.api.view import (
    BusShown,
    BusStatistics,
    Json,
    Line,
    LineView,
    Time,
    UnitShown,
    bus_fields,
    figures_json,
)
from app.line.live.bus_live import Audience, LiveState, changed_by
from app.line.live.fields import put_fields
from app.line.live.requests import Admission, bus_or_404, unit_or_404
from app.version import VERSION
from bus.contract import Update
from bus.instants import Clock, Monotonic, MonotonicClock, monotonic_now, unix_now
from bus.messages import Message

PIECE_BYTES = 64 * 1024
"""The most bytes that a program is sent at a time."""

_encode = msgspec.json.Encoder().encode


class StreamEvent(NamedTuple):
    """An event in the text that is sent. ``bus``: None for the site."""

    bus: str | None
    text: bytes


class RecentEvents:
    """The newest events. ``run``: distinguishes the numbers of this server from those before its start."""

    def __init__(self, run: str, most_bytes: int) -> None:
        self._run = run
        self._most_bytes = most_bytes
        self._events: dict[int, StreamEvent] = {}
        self._size = 0
        self.newest = 0

    def add(self, kind: str, bus: str | None, data: dict[str, Any]) -> None:
        """Add an event; drop the oldest if there are too many."""
        self.newest += 1
        event = StreamEvent(bus, self.text(kind, self.newest, data))
        self._events[self.newest] = event
        self._size += len(event.text)
        while self._size > self._most_bytes:
            oldest = self._events.pop(self.newest - len(self._events) + 1)
            self._size -= len(oldest.text)

    def interrupt(self) -> None:
        """Drop all events after a pause in which none were noted: no client can resume before this."""
        self._events.clear()
        self._size = 0
        self.newest += 1

    def text(self, kind: str, number: int, data: dict[str, Any]) -> bytes:
        """Return an event as it is sent. JSON has no line break, which would end it."""
        id_ = f"{self._run}-{number}"
        return f"id: {id_}\nevent: {kind}\ndata: ".encode() + _encode(data) + b"\n\n"

    def number_of(self, last_event_id: str) -> int | None:
        """Return the number in an id; None if the id is not of this run."""
        run, _, number = last_event_id.rpartition("-")
        return parse_integer(number) if run == self._run else None

    def has_all_after(self, number: int) -> bool:
        """Return whether every event after this number is still here."""
        return self.newest - len(self._events) <= number <= self.newest

    def after(self, number: int, bus: str | None) -> tuple[int, bytes]:
        """Return the events after ``number``, which are all here, in one piece, and the number of the last of
        them. ``bus``: only those of this bus and of the site; None: all."""
        texts: list[bytes] = []
        size = 0
        while number < self.newest and size < PIECE_BYTES:
            number += 1
            event = self._events[number]
            if bus is None or event.bus in (None, bus):
                texts.append(event.text)
                size += len(event.text)
        return number, b"".join(texts)


TICK_S = 0.1
TICKS_OF_ALL = 10
"""The ticks in which every unit is compared once: comparing a long line at once would delay everything else
for tens of milliseconds."""
HEARTBEAT_TICKS = 50
AWAY_S = 60.0
"""The seconds for which events are noted after the last program left, for its return."""
PAUSE_S = 0.05
"""The pause between two pieces for one program, in seconds; events in between go together."""
SNAPSHOT_S = 1.0
"""The age in seconds up to which a snapshot serves another program; later changes follow it."""
MAX_BYTES = 4 * 1024 * 1024
"""The bytes of events kept: some ten seconds of the longest line at four readings a second."""
MAX_STREAMS_OF_ACCOUNT, MAX_STREAMS_OF_ADDRESS = 16, 64
RETRY = b"retry: 2000\n"
"""Sent first: the milliseconds after which a client connects again."""


@dataclass(eq=False, repr=False)
class LineStream:
    """The stream of the line, which notes changes while someone reads. ``clock``: Unix time in seconds."""

    _view: LineView
    clock: Clock
    monotonic: MonotonicClock = monotonic_now

    def __post_init__(self) -> None:
        self.admission = Admission(MAX_STREAMS_OF_ACCOUNT, MAX_STREAMS_OF_ADDRESS)
        self._recent = RecentEvents(token_hex(4), MAX_BYTES)
        self._shown: dict[tuple[str, int | None], Json] = {}
        """The state of each bus and unit (None: the bus itself) as last compared; empty while no one
        reads."""
        self._noting = asyncio.Event()
        self._keys: list[tuple[str, int | None]] = []
        self._turns: Iterator[tuple[str, int | None]] = iter(())
        self._snapshots: dict[str | None, tuple[Monotonic, int, bytes]] = {}
        self._readers = 0
        self._left_at = self.monotonic()
        self._has_more = asyncio.Event()
        self._is_ending = False
        for name, bus in self._view.live.buses.items():
            bus.subscribe(Audience.STREAM, partial(self._on_updates, name))

    # --- to the programs ------------------------------------------------------------------------------

    @contextmanager
    def reading(self) -> Iterator[None]:
        """Note changes while a program reads, and for a while after."""
        self._readers += 1
        if not self._noting.is_set():
            self._take_up()
        try:
            yield
        finally:
            self._readers -= 1
            self._left_at = self.monotonic()

    async def pieces(
        self, bus: str | None, last_event_id: str = "", seconds: float | None = None
    ) -> AsyncIterator[bytes]:
        """Yield all events after the one of this id, or a snapshot and all after it, for ``seconds`` or until
        the server ends. ``bus``: only events of this bus and of the site."""
        loop = asyncio.get_running_loop()
        end = None if seconds is None else loop.time() + seconds
        yield RETRY
        number = self._recent.number_of(last_event_id)
        while not self._is_ending and (end is None or loop.time() < end):
            has_more = self._has_more
            if number is None or not self._recent.has_all_after(number):
                number, text = self._snapshot(bus)
            else:
                number, text = self._recent.after(number, bus)
            for begin in range(0, len(text), PIECE_BYTES):
                yield text[begin : begin + PIECE_BYTES]
            if number == self._recent.newest:
                with suppress(TimeoutError):
                    async with asyncio.timeout_at(end):
                        await has_more.wait()
            await asyncio.sleep(PAUSE_S)

    def end(self) -> None:
        """End every response, because the server ends."""
        self._is_ending = True
        self._has_more.set()

    def _snapshot(self, bus: str | None) -> tuple[int, bytes]:
        made_at, number, text = self._snapshots.get(bus, (Monotonic(0.0), -1, b""))
        now = self.monotonic()
        if now - made_at > SNAPSHOT_S or not self._recent.has_all_after(number):
            number = self._recent.newest
            text = self._recent.text("snapshot", number, self._view.line(self.clock(), bus))
            self._snapshots[bus] = now, number, text
        return number, text

    # --- what changes ---------------------------------------------------------------------------------

    async def follow(self) -> None:
        """Look for what has aged and send heartbeats while someone reads, until canceled."""
        ticks = 0
        while True:
            await self._noting.wait()
            await asyncio.sleep(TICK_S)
            ticks += 1
            self.tick(with_heartbeat=ticks % HEARTBEAT_TICKS == 0)

    def tick(self, *, with_heartbeat: bool) -> None:
        """Note changes that no report brings: an overdue response, a block."""
        if self._noting.is_set() and not self._readers and self.monotonic() - self._left_at > AWAY_S:
            self._noting.clear()
            self._shown, self._snapshots = {}, {}
            self._recent.interrupt()
        if self._noting.is_set():
            for bus, unit in islice(self._turns, ceil(len(self._keys) / TICKS_OF_ALL)):
                self._compare(bus, unit)
        if with_heartbeat:
            self.add("heartbeat", None, lambda: {"time": iso(self.clock())})

    def add(self, kind: str, bus: str | None, make: Callable[[], Any]) -> None:
        """Add an event, which is made only if someone reads. ``bus``: None for the site."""
        if self._noting.is_set():
            self._recent.add(kind, bus, make())
            self._wake()

    def _take_up(self) -> None:
        """Begin to compare what is shown of the buses."""
        self._noting.set()
        buses = self._view.live.buses
        self._keys = [(name, unit) for name, bus in buses.items() for unit in (None, *bus.units)]
        self._turns = cycle(self._keys)
        self._shown = {key: self._fields(*key) for key in self._keys}
        self._snapshots = {}

    def _wake(self) -> None:
        self._has_more.set()
        self._has_more = asyncio.Event()

    def _on_updates(self, bus_name: str, updates: Sequence[Update]) -> None:
        if self._noting.is_set():
            units, is_bus = changed_by(self._view.live.buses[bus_name], updates)
            for unit in (None, *units) if is_bus else units:
                self._compare(bus_name, unit)

    def _compare(self, bus_name: str, unit: int | None) -> None:
        key = bus_name, unit
        if changed := put_fields(self._shown, key, self._fields(*key)):
            self.add("change", bus_name, lambda: {"bus": bus_name, "unit": unit} | changed[key])

    def _fields(self, bus_name: str, unit: int | None) -> Json:
        if unit is None:
            return bus_fields(self._view.live.buses[bus_name])
        fields = self._view.unit(bus_name, unit, self.clock())
        # The age grows without a change; ``read_at`` is in the reading too.
        del fields["age_ms"]
        return fields


document_router = APIRouter(include_in_schema=False, route_class=GuardedRoute)


@dataclass(frozen=True, slots=True)
class AlarmType:
    """The schema of the data of an ``alarm``. The feature of alarms adds it, because the live state has
    none."""

    shown: type


class Heartbeat(TypedDict):
    """The server's time. If none comes for 10 s, no value counts as fresh."""

    time: Time


MEANINGS = {
    "snapshot": "The state of the line, as of GET /line. It replaces everything before it.",
    "change": "Fields of a unit, or (unit null) of a bus, that have another value now.",
    "alarm": "An alarm that has changed, as in GET /alarms.",
    "heartbeat": "Every 5 s.",
}
"""The meaning of each event, by its name."""
EXAMPLES: dict[str, Any] = {
    "change": {"bus": "dry-end", "unit": 1, "actual_raw": 12001, "actual": "1200.1"},
    "heartbeat": {"time": "2026-11-21T03:12:00.125+00:00"},
}
_REF = "#/components/schemas/"


@document_router.get("/api/v1/asyncapi.json")
async def asyncapi(request: Request, _: Viewer, alarm: Annotated[AlarmType, service(AlarmType)]) -> Response:
    """Return the AsyncAPI document of the stream of events."""
    description = await parse_apart(partial(_rendered_once, alarm))
    return description.response(request, "no-cache")


@cache
def _rendered_once(alarm: AlarmType) -> Asset:
    text = json.dumps(stream_document(alarm), separators=(",", ":"))
    asset = Asset(text.encode(), "application/json")
    asset.pack()
    return asset


def stream_document(alarm: AlarmType) -> dict[str, Any]:
    """Return the AsyncAPI document."""
    payloads = {"snapshot": Line, "alarm": alarm.shown, "heartbeat": Heartbeat}
    names = {name: schema_name(kind.__name__) for name, kind in payloads.items()} | {"change": "Change"}
    messages = {name: {"$ref": f"#/components/messages/{name}"} for name in MEANINGS}
    channel: dict[str, Any] = {
        "address": "/api/v1/stream",
        "title": "Changes of the line",
        "description": "Server-Sent Events without end. Last-Event-ID resumes after an event.",
        "messages": messages,
        "servers": [{"$ref": "#/servers/lineside"}],
    }
    operation = {
        "action": "send",
        "channel": {"$ref": "#/channels/stream"},
        "summary": "Send a snapshot, then each change",
        "messages": [{"$ref": f"#/channels/stream/messages/{name}"} for name in MEANINGS],
        "bindings": {"http": {"method": "GET", "query": _QUERY, "bindingVersion": "0.3.0"}},
    }
    return {
        "asyncapi": "3.0.0",
        "info": {"title": "Lineside", "version": VERSION, "description": "Events of a drive line."},
        "defaultContentType": "application/json",
        "servers": {"lineside": _SERVER},
        "channels": {"stream": channel},
        "operations": {"sendStream": operation},
        "components": {
            "messages": {name: _message(name, names[name]) for name in MEANINGS},
            "schemas": _schemas(Line, UnitShown, BusShown, alarm.shown, Heartbeat),
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
    }


_QUERY = {
    "type": "object",
    "properties": {"bus": {"type": "string", "description": "Only events of this bus and of the site."}},
}
_SERVER = {
    "host": "{address}",
    "protocol": "http",
    "description": "The server that this document comes from.",
    "variables": {"address": {"default": "127.0.0.1:8000", "description": "Host and port."}},
    "security": [{"$ref": "#/components/securitySchemes/token"}],
}


def _message(name: str, schema: str) -> dict[str, Any]:
    headers = {
        "type": "object",
        "required": ["id", "event"],
        "properties": {
            "id": {"type": "string", "description": "For Last-Event-ID."},
            "event": {"const": name},
        },
    }
    payload = {"$ref": _REF + schema}
    message = {"name": name, "summary": MEANINGS[name], "headers": headers, "payload": payload}
    return message | ({"examples": [{"payload": EXAMPLES[name]}]} if name in EXAMPLES else {})


def _schemas(*kinds: type) -> dict[str, Any]:
    adapters: list[tuple[str, JsonSchemaMode, TypeAdapter[Any]]] = [
        (kind.__name__, "serialization", TypeAdapter(kind)) for kind in kinds
    ]
    _, made = TypeAdapter.json_schemas(adapters, ref_template=_REF + "{model}")
    named = with_published_names({"components": {"schemas": made["$defs"]}})
    schemas: dict[str, Any] = named["components"]["schemas"]
    return schemas | {
        "UnitChange": _part_of(schemas["Unit"], {"type": "integer"}, leave_out=("age_ms",)),
        "BusChange": _part_of(schemas["Bus"], {"type": "null"}, leave_out=("units",)),
        "Change": {"anyOf": [{"$ref": f"{_REF}UnitChange"}, {"$ref": f"{_REF}BusChange"}]},
    }


def _part_of(schema: dict[str, Any], unit: dict[str, Any], leave_out: tuple[str, ...]) -> dict[str, Any]:
    """Return a schema of some members of an object, with the bus and unit to which they belong."""
    members = {name: each for name, each in schema["properties"].items() if name not in leave_out}
    place = {"bus": {"type": "string"}, "unit": unit}
    return {"type": "object", "required": ["bus", "unit"], "properties": members | place}


router = APIRouter(prefix="/api/v1", tags=["line"], route_class=ApiRoute)
Live = Annotated[LiveState, service(LiveState)]
LineViewService = Annotated[LineView, service(LineView)]


@router.get("/line", response_model=Line)
async def get_line(_: Viewer, view: LineViewService) -> dict[str, Any]:
    """Return the current state of every bus and unit. ``history``: why no values are stored, null while they
    are."""
    return view.line(unix_now())


@router.get("/buses/{bus}", response_model=BusShown)
async def get_bus(_: Viewer, view: LineViewService, bus: str) -> dict[str, Any]:
    """Return one bus with its units."""
    bus_or_404(view.live, bus)
    return view.bus(bus, unix_now())


@router.get("/buses/{bus}/units/{unit:int}", response_model=UnitShown)
async def get_unit(_: Viewer, view: LineViewService, bus: str, unit: int) -> dict[str, Any]:
    """Return one unit, with the age of its values."""
    unit_or_404(view.live, bus, unit)
    return view.unit(bus, unit, unix_now())


@router.get("/buses/{bus}/figures", response_model=BusStatistics)
async def get_bus_statistics(_: Viewer, live: Live, bus: str) -> dict[str, Any]:
    """Return the wire load of a bus, and the counters of each unit since its worker started."""
    return figures_json(bus, bus_or_404(live, bus).figures)


EVENT_STREAM = "text/event-stream"
TEXT = {
    "type": "string",
    "description": "The events of GET /asyncapi.json, an empty line after each.",
}
EVENTS: dict[int | str, dict[str, Any]] = {200: {"content": {EVENT_STREAM: {"schema": TEXT}}}}
MAX_SECONDS = 3600
SECONDS: dict[str, Any] = {
    "parameters": [
        {
            "name": "seconds",
            "in": "query",
            "required": True,
            "schema": {"type": "integer", "minimum": 1, "maximum": MAX_SECONDS, "default": 10},
            "description": "Ends the response after this time. A generated call reads a response to its end "
            "and has to give it; without it, as EventSource requests it, the response has no end.",
        }
    ]
}
"""Required only in the document, because a generated call would otherwise never return."""
Stream = Annotated[LineStream, service(LineStream)]


async def _admitted(connection: HTTPConnection, person: Viewer, stream: Stream) -> AsyncIterator[None]:
    """Count a reader until its response has ended. Raise Problem 429 for one too many."""
    address = source_of(connection.client.host if connection.client else "")
    if not stream.admission.enter(person.account, address):
        raise Problem(429, "too_many", Message("too_many_streams")).with_headers(Retry_After="10")
    try:
        with stream.reading():
            yield
    finally:
        stream.admission.leave(person.account, address)


@router.get(
    "/stream",
    response_class=StreamingResponse,
    responses=EVENTS,
    dependencies=[Depends(_admitted)],
    openapi_extra=SECONDS,
)
async def get_stream(
    _: Viewer,
    live: Live,
    stream: Stream,
    bus: str | None = None,
    seconds: Annotated[int | None, Query(ge=1, le=MAX_SECONDS, include_in_schema=False)] = None,
    last_event_id: Annotated[str, Header(description="Resumes after this event.")] = "",
) -> StreamingResponse:
    """Stream Server-Sent Events, without end unless ``seconds`` are given: a ``snapshot`` (as GET /line),
    then each ``change`` (``bus``, ``unit`` and its fields that changed; ``unit`` null: of the bus itself),
    ``alarm`` (as in GET /alarms) and, every 5 s, a ``heartbeat``. A client that cannot resume, or reads too
    slowly, gets a ``snapshot`` in place of what it missed. ``bus``: only of this bus and of the site."""
    if bus is not None:
        bus_or_404(live, bus)
    # A proxy would otherwise collect a response before it passes it on.
    headers = {"X-Accel-Buffering": "no"}
    return StreamingResponse(
        stream.pieces(bus, last_event_id, seconds), headers=headers, media_type=EVENT_STREAM
    )
