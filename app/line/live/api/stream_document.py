"""``GET /api/v1/asyncapi.json``: the events of ``GET /stream`` as an AsyncAPI 3.0 document.

It is made of the types with which the API describes the line and its alarms. The sockets ``/live`` and
``/feed`` are not in it, as they are between the parts of one release.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache, partial
from typing import Annotated, Any

from fastapi import APIRouter
from pydantic import TypeAdapter
from pydantic.json_schema import JsonSchemaMode
from starlette.requests import Request
from starlette.responses import Response
from typing_extensions import TypedDict

from app.core.web.access import Viewer
from app.core.web.api import schema_name, with_published_names
from app.core.web.assets import Asset
from app.core.web.request_rules import parse_apart
from app.core.web.services import service
from app.line.live.api.schemas import BusShown, Line, Time, UnitShown
from app.version import VERSION

router = APIRouter(include_in_schema=False)


@dataclass(frozen=True, slots=True)
class AlarmType:
    """``shown``: the type of the data of an ``alarm``. The feature of alarms adds it, as the live state knows
    none."""

    shown: type


class Heartbeat(TypedDict):
    """The server's time. Where none comes for 10 s, no value counts as fresh."""

    time: Time


MEANINGS = {
    "snapshot": "The state of the line, as of GET /line. It replaces everything before it.",
    "change": "Fields of a unit, or (unit null) of a bus, that have another value now.",
    "alarm": "An alarm that has changed, as in GET /alarms.",
    "heartbeat": "Every 5 s.",
}
"""What an event means, by its name."""
EXAMPLES: dict[str, Any] = {
    "change": {"bus": "dry-end", "unit": 1, "actual_raw": 12001, "actual": "1200.1"},
    "heartbeat": {"time": "2026-11-21T03:12:00.125+00:00"},
}
_REF = "#/components/schemas/"


@router.get("/api/v1/asyncapi.json")
async def asyncapi(request: Request, _: Viewer, alarm: Annotated[AlarmType, service(AlarmType)]) -> Response:
    """Return the description of the stream."""
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
    """Return a schema of some members of an object, with the bus and unit they belong to."""
    members = {name: each for name, each in schema["properties"].items() if name not in leave_out}
    place = {"bus": {"type": "string"}, "unit": unit}
    return {"type": "object", "required": ["bus", "unit"], "properties": members | place}
