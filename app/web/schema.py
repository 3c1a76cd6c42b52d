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
from app.web.schema_problem import PARTS, problem_schemas


def describe_parameters(document: dict[str, Any]) -> None:
    """Give every parameter that has no description the one of its name."""
    for path in document["paths"].values():
        for operation in path.values():
            for parameter in operation.get("parameters", ()):
                name = parameter["name"] if parameter["in"] != "header" else parameter["name"].lower()
                if name in PARTS["parameters"]:
                    parameter.setdefault("description", PARTS["parameters"][name])


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
        known.pack()
    return known


def leave_bodies_out(document: dict[str, Any]) -> None:
    """A body that is not required can be left out, so it need not be null: generated clients fail on both."""
    for path in document["paths"].values():
        for operation in path.values():
            for content in operation.get("requestBody", {}).get("content", {}).values():
                match content["schema"]:
                    case {"anyOf": [schema, {"type": "null"}]}:
                        content["schema"] = schema


def add_sent_at(document: dict[str, Any]) -> None:
    """Every write may state when it was made: the server reads the header beside the routes. Its schema has
    no ``format``: openapi-python-client generates no call with a ``date-time`` in a header."""
    for path in document["paths"].values():
        for method, operation in path.items():
            if method not in ("get", "head"):
                operation.setdefault("parameters", []).append(PARTS["sentAt"])


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
