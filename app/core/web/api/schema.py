"""The OpenAPI document: what FastAPI knows, under published names, every parameter described, every refusal
as a problem of RFC 9457.

The names of schemas are those of their classes: clients are generated from them. They are published, so such
a class is not renamed; ``tests/app/openapi_names.txt`` lists them and the operations, which have the names of
their functions.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.openapi.utils import get_openapi
from starlette.requests import Request
from starlette.responses import Response

from app.core.web.admission.access import Viewer
from app.core.web.admission.bounds import parse_apart
from app.core.web.api.examples import add_examples
from app.core.web.rendering.assets import Asset
from app.errors import CODES

PARTS: dict[str, Any] = json.loads(Path(__file__).with_name("openapi_parts.json").read_text(encoding="utf-8"))
"""What no signature states: descriptions of parameters by name (of a header in small letters) and of
statuses, the header of every write, and the schemas of a refusal."""


RATE_LIMIT = ("RateLimit-Limit", "RateLimit-Remaining", "RateLimit-Reset")


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """For ``responses=``: problems of these statuses."""
    return {status: _response(PARTS["statuses"][str(status)]) for status in statuses}


def limited(status: int) -> dict[int | str, dict[str, Any]]:
    """For ``responses=`` of an operation with a limit: its headers where it succeeds (``status``) and where
    it is refused."""
    return {
        status: {"headers": _header_references(*RATE_LIMIT)},
        429: {
            **_response(PARTS["statuses"]["429"]),
            "headers": _header_references("Retry-After", *RATE_LIMIT),
        },
    }


def _header_references(*names: str) -> dict[str, Any]:
    return {name: {"$ref": f"#/components/headers/{name}"} for name in names}


def usual_problems(path: str, methods: Iterable[str]) -> dict[int | str, dict[str, Any]]:
    """For every operation of the API, by its path and methods."""
    statuses = {401, 403, 422, 503}
    statuses |= {404} if "{" in path else set()
    statuses |= {409} if set(methods) - {"GET", "HEAD"} else set()
    return {
        **problems(*sorted(statuses)),
        "default": {
            **_response("Any other refusal. detail states what was done."),
            "headers": _header_references("Retry-After"),
        },
    }


def problem_schemas(schemas: Mapping[str, Any]) -> dict[str, Any]:
    """The schemas of a problem. Where a command was sent, its result's members are in the problem too."""
    result, own = schemas["CommandResult"]["properties"], PARTS["schemas"]
    problem = {**own["Problem"], "properties": {**result, **own["Problem"]["properties"]}}
    return {**own, "Problem": problem, "ProblemCode": {**own["ProblemCode"], "enum": sorted(CODES)}}


@cache
def _response(description: str) -> dict[str, Any]:
    content = {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {"description": description, "content": content}


router = APIRouter(include_in_schema=False)


@router.get("/api/v1/openapi.json")
async def openapi(request: Request, _: Viewer) -> Response:
    """The description of every call."""
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


def openapi_document(app: Any) -> dict[str, Any]:
    """The document of an app. Raises ValueError where two schemas would have one name."""
    document = with_published_names(
        get_openapi(title=app.title, version=app.version, summary=app.summary, routes=app.routes)
    )
    for path in document["paths"].values():
        for method, operation in path.items():
            _complete(operation, is_write=method not in ("get", "head"))
    components = document["components"]
    components["schemas"] |= problem_schemas(components["schemas"])
    components["headers"] = PARTS["headers"]
    components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
    add_examples(document)
    document["security"] = [{"token": []}]
    document["servers"] = [{"url": "/", "description": "The server that this document comes from."}]
    return document


def _complete(operation: dict[str, Any], *, is_write: bool) -> None:
    """Add to an operation what no signature states."""
    for parameter in operation.get("parameters", ()):
        name = parameter["name"] if parameter["in"] != "header" else parameter["name"].lower()
        if name in PARTS["parameters"]:
            parameter.setdefault("description", PARTS["parameters"][name])
    for content in operation.get("requestBody", {}).get("content", {}).values():
        match content["schema"]:
            # A body that is not required can be left out: generated clients fail where it may be null, too.
            case {"anyOf": [schema, {"type": "null"}]}:
                content["schema"] = schema
    if is_write:
        # When the write was made: the server reads the header beside the routes. Its schema has no
        # ``format``: openapi-python-client generates no call with a ``date-time`` in a header.
        operation.setdefault("parameters", []).append(PARTS["sentAt"])


_REF = "#/components/schemas/"


def schema_name(model: str) -> str:
    """The name of the class, without the ending that it has where a class of the domain has that name:
    ``AlarmShown`` → ``Alarm``, ``CommandRequestBody`` → ``CommandRequest``."""
    return model.removesuffix("Shown").removesuffix("Body")


def with_published_names(document: dict[str, Any]) -> dict[str, Any]:
    """The document with every schema under its published name. Raises ValueError where two would have one."""
    schemas = document["components"]["schemas"]
    named = {schema_name(name): schema for name, schema in schemas.items()}
    if len(named) < len(schemas):
        raise ValueError("two schemas have one published name; rename one class")
    document["components"]["schemas"] = named
    renamed: dict[str, Any] = _renamed(document)
    return renamed


def _portable(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema of a dictionary with a pattern for its keys, in the form that generators understand."""
    patterns = schema.get("patternProperties", {})
    if len(patterns) != 1:
        return schema
    ((pattern, values),) = patterns.items()
    rest = {key: value for key, value in schema.items() if key != "patternProperties"}
    return {**rest, "propertyNames": {"pattern": pattern}, "additionalProperties": values}


def _renamed(node: Any) -> Any:
    if isinstance(node, list):
        return [_renamed(each) for each in node]
    if not isinstance(node, dict):
        return node
    renamed = {key: _renamed(value) for key, value in _portable(node).items()}
    reference, title = renamed.get("$ref"), renamed.get("title")
    if isinstance(reference, str) and reference.startswith(_REF):
        renamed["$ref"] = _REF + schema_name(reference.removeprefix(_REF))
    if isinstance(title, str):
        renamed["title"] = schema_name(title)
    return renamed
