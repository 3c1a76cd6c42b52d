"""The OpenAPI document: what FastAPI knows, under published names, every parameter described, every refusal
as a problem of RFC 9457."""

from __future__ import annotations

import json
from functools import partial
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.openapi.utils import get_openapi
from starlette.requests import Request
from starlette.responses import Response

from app.web.access import Viewer
from app.web.assets import Asset
from app.web.bounds import parse_apart
from app.web.schema_names import with_published_names
from app.web.schema_problem import problem_schemas

DESCRIPTIONS = {
    "idempotency-key": "Id of this command, 1 to 200 characters: sent twice, the command is executed once.",
    "alarm_id": "Id of an occurrence of an alarm.",
    "before": "Only entries before this id: next of the page before.",
    "bus": "Name of a bus in lineside.toml.",
    "format": "Of the times or of the file.",
    "from": "Start of the span, ISO 8601 with zone; an hour before its end when left out.",
    "from_unit": "Address of a unit of the document, 1 to 255.",
    "gaps": "Read in the gaps of the scan only: slower, and the scan keeps its rate.",
    "kind": "Only events of this kind.",
    "limit": "Entries per response.",
    "group": "Only alarms of this group: what they are about; own: those of the configuration.",
    "name": "Name of the recipe.",
    "maintenance_id": "Id of a maintenance.",
    "number": "Number of the output (1 to 6) or of the parameter (1 to 40).",
    "other_id": "Id of the other parameter set.",
    "other_unit": "Address of the unit in the other set, 1 to 255; the same when left out.",
    "points": "Points of the response, 1 to 20000.",
    "recipe_id": "Id of a version of a recipe.",
    "priority": "Only alarms of this priority.",
    "refresh": "Read all parameters from the unit now.",
    "resolution": "auto: values if they are stored for the complete span, else minutes.",
    "restore_id": "Id of a restore.",
    "search": "Only events with this text.",
    "seconds": "As text, this many seconds back, up to 3600.",
    "secrets": "With the operator password (#21).",
    "series": "bus/unit/value, such as dry-end/1/actual; several times.",
    "set_id": "Id of a parameter set.",
    "state": "Only alarms in this state; when left out, all that are not normal.",
    "timeout_s": "Time that the command may wait for the wire, 0.05 to 30 s; 2 s when left out.",
    "to": "End of the span, ISO 8601 with zone; now when left out.",
    "tolerance": "Raw counts that still pass as equal.",
    "unit": "Address of the unit (#17), 1 to 255.",
    "value": "commanded, actual, analog, the name of an input, output.1 to output.6, remote or at_speed.",
    "who": "Only events of this user or token.",
}
"""By the name of the parameter; of a header in small letters."""


def describe_parameters(document: dict[str, Any]) -> None:
    """Give every parameter that has no description the one of its name."""
    for path in document["paths"].values():
        for operation in path.values():
            for parameter in operation.get("parameters", ()):
                name = parameter["name"] if parameter["in"] != "header" else parameter["name"].lower()
                if name in DESCRIPTIONS:
                    parameter.setdefault("description", DESCRIPTIONS[name])


router = APIRouter(include_in_schema=False)


@router.get("/api/v1/openapi.json")
async def openapi(request: Request, _: Viewer) -> Response:
    """The description of every call."""
    description: Asset | None = getattr(request.app.state, "description", None)
    if description is None:
        description = await parse_apart(partial(rendered_once, request.app))
    return description.response(request, "no-cache")


def rendered_once(app: FastAPI) -> Asset:
    """The document as it is sent; to make it takes a second, to compress it tens of milliseconds."""
    known: Asset | None = getattr(app.state, "description", None)
    if known is None:
        text = json.dumps(openapi_document(app), ensure_ascii=False, separators=(",", ":"))
        known = app.state.description = Asset(text.encode(), "application/json")
        _ = known.packed
    return known


def leave_bodies_out(document: dict[str, Any]) -> None:
    """A body that is not required can be left out, so it need not be null: generated clients fail on both."""
    for path in document["paths"].values():
        for operation in path.values():
            for content in operation.get("requestBody", {}).get("content", {}).values():
                match content["schema"]:
                    case {"anyOf": [schema, {"type": "null"}]}:
                        content["schema"] = schema


SENT_AT_HEADER = {
    "name": "Lineside-Sent-At",
    "in": "header",
    "required": False,
    "schema": {"type": "string", "examples": ["2026-11-21T03:12:00.250Z"]},
    "description": "When the write was made, ISO 8601 with zone; without it, when it arrived.",
}
"""Without ``format``: openapi-python-client generates no call with a ``date-time`` in a header."""


def add_sent_at(document: dict[str, Any]) -> None:
    """Every write may state when it was made: the server reads the header beside the routes."""
    for path in document["paths"].values():
        for method, operation in path.items():
            if method not in ("get", "head"):
                operation.setdefault("parameters", []).append(SENT_AT_HEADER)


def openapi_document(app: Any) -> dict[str, Any]:
    """The document of an app. Raises ValueError where two schemas would have one name."""
    document = with_published_names(
        get_openapi(title=app.title, version=app.version, summary=app.summary, routes=app.routes)
    )
    describe_parameters(document)
    leave_bodies_out(document)
    add_sent_at(document)
    components = document["components"]
    components["schemas"] |= problem_schemas(components["schemas"])
    components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
    document["security"] = [{"token": []}]
    document["servers"] = [{"url": "/", "description": "The server that this document comes from."}]
    return document
