"""The routes of the API and the OpenAPI document.

Repeated and unknown parameters of a request are refused, not guessed at. The document is FastAPI's, under
published names, with every parameter described, every refusal as a problem of RFC 9457, and an example of
each request and response: requests are written, because only some members go together; a response is made
from its schema, so that it has every member.

The names of schemas are those of their classes: clients are generated from them, so such a class is not
renamed. ``tests/app/openapi_names.txt`` lists them and the operations, which have the names of their
functions.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Coroutine, Iterable, Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

from fastapi import APIRouter, FastAPI, Header, params
from fastapi.dependencies.utils import get_flat_params
from fastapi.openapi.utils import get_openapi
from starlette.datastructures import QueryParams
from starlette.requests import Request
from starlette.responses import Response

from app.core.web.access import Viewer
from app.core.web.assets import Asset
from app.core.web.request_rules import MAX_PLAIN_BODY_BYTES, parse_apart
from app.core.web.routes import GuardedRoute
from app.errors import CODES, Problem
from bus.messages import Message

MAX_MEMBERS = 1000
"""The most members of a JSON object; the largest has one for each of 255 units. Each unknown one is a
fault."""
_HALF_PAIR = re.compile("[\ud800-\udfff]")
_RouteHandler = Callable[[Request], Coroutine[Any, Any, Response]]
RequestKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=200,
        description="A request that is sent again with its key is carried out once.",
    ),
]


class ApiRoute(GuardedRoute):
    """A route of the API, for ``APIRouter(route_class=ApiRoute)``, that refuses repeated and unknown
    parameters.

    Most servers take the last of two and ignore unknown ones. A filter with a slip in its name would then let
    everything through, and of two setpoints one would be set that another program did not see.
    """

    def complete(self, options: dict[str, Any]) -> dict[str, Any]:
        name = self.endpoint.__name__
        usual = _usual_problems(self.path, self.methods or ())
        return {
            **options,
            "operation_id": options.get("operation_id") or name,
            "summary": options.get("summary") or name.replace("_", " ").capitalize(),
            "responses": usual | (options.get("responses") or {}),
        }

    def get_route_handler(self) -> _RouteHandler:
        """Return FastAPI's handler behind the checks."""
        handle = super().get_route_handler()
        expected = get_flat_params(self.dependant)
        known = {
            parameter.alias: _is_list(parameter.field_info.annotation)
            for parameter in expected
            if isinstance(parameter.field_info, params.Query)
        }

        async def careful(request: Request) -> Response:
            _check_query(request.query_params, known)
            return await handle(_OfOneMeaning(request.scope, request.receive))

        return careful


class _OfOneMeaning(Request):
    """A request whose JSON has no repeated key (RFC 8259, 4 leaves open which of them would hold)."""

    async def json(self) -> Any:
        """Return the body as JSON. Raise Problem 422 for a repeated key."""
        body = await self.body()
        if len(body) <= MAX_PLAIN_BODY_BYTES:
            return _loads(body)
        return await parse_apart(lambda: _loads(body))


def _loads(body: bytes) -> Any:
    return json.loads(body, object_pairs_hook=_each_once)


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(pairs) > MAX_MEMBERS:
        raise Problem(422, "invalid", Message.of("too_many_members", n=MAX_MEMBERS))
    made: dict[str, Any] = {}
    for name, value in pairs:
        if name in made:
            raise _twice(ascii(name))
        made[name] = value
    for name in made:
        # Pydantic ignores a key with half a surrogate pair, even if unknown ones are forbidden.
        if _HALF_PAIR.search(name):
            raise Problem(422, "invalid", Message.of("field_unknown", name=ascii(name)))
    return made


def _check_query(query: QueryParams, known: Mapping[str, bool]) -> None:
    """Raise Problem 422 for an unknown parameter, and for a repeated one unless ``known`` allows it by its
    name."""
    for name in query:
        if name not in known:
            names = {"known": ", ".join(known)} if known else {}
            code = "parameter_unknown" if known else "parameter_unknown_none"
            raise Problem(422, "invalid", Message.of(code, name=name, **names))
        if not known[name] and len(query.getlist(name)) > 1:
            raise _twice(name)


def _twice(name: str) -> Problem:
    return Problem(422, "invalid", Message.of("parameter_twice", name=name))


def _is_list(annotation: Any) -> bool:
    return list in (get_origin(each) for each in (annotation, *get_args(annotation)))


NEXT_PAGE: dict[int | str, dict[str, Any]] = {
    200: {"headers": {"Link": {"$ref": "#/components/headers/Link"}}},
}
"""The header of a response with a next page, for ``responses=``."""


def link_next(request: Request, response: Response, before: int) -> None:
    """Name the page before an id in the ``Link`` header (RFC 8288), with the other parameters of the
    request."""
    url = request.url.include_query_params(before=before)
    response.headers["Link"] = f'<{url.path}?{url.query}>; rel="next"'


PARTS: dict[str, Any] = json.loads(Path(__file__).with_name("openapi_parts.json").read_text(encoding="utf-8"))
"""The parts that no signature states: descriptions of parameters by name (of a header in small letters) and
of statuses, the header of every write, and the schemas of a refusal."""


_RATE_LIMIT = ("RateLimit-Limit", "RateLimit-Remaining", "RateLimit-Reset")


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return ``responses=`` with problems of these statuses."""
    return {status: _response(PARTS["statuses"][str(status)]) for status in statuses}


def limited(status: int) -> dict[int | str, dict[str, Any]]:
    """Return ``responses=`` of an operation with a limit: its headers on success (``status``) and on
    refusal."""
    return {
        status: {"headers": _header_references(*_RATE_LIMIT)},
        429: {
            **_response(PARTS["statuses"]["429"]),
            "headers": _header_references("Retry-After", *_RATE_LIMIT),
        },
    }


def _header_references(*names: str) -> dict[str, Any]:
    return {name: {"$ref": f"#/components/headers/{name}"} for name in names}


def _usual_problems(path: str, methods: Iterable[str]) -> dict[int | str, dict[str, Any]]:
    """Return the problems that any operation of the API may have, by its path and methods."""
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


def _problem_schemas(schemas: Mapping[str, Any]) -> dict[str, Any]:
    """Return the schemas of a problem, which also has the members of a command's result if one was sent."""
    result, own = schemas["CommandResult"]["properties"], PARTS["schemas"]
    problem = {**own["Problem"], "properties": {**result, **own["Problem"]["properties"]}}
    return {**own, "Problem": problem, "ProblemCode": {**own["ProblemCode"], "enum": sorted(CODES)}}


@cache
def _response(description: str) -> dict[str, Any]:
    content = {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {"description": description, "content": content}


router = APIRouter(include_in_schema=False, route_class=GuardedRoute)


@router.get("/api/v1/openapi.json")
async def openapi(request: Request, _: Viewer) -> Response:
    """Send the OpenAPI document."""
    description = await parse_apart(partial(rendered_once, request.app))
    return description.response(request, "no-cache")


def rendered_once(app: FastAPI) -> Asset:
    """Return the rendered document. Making it takes a second, compressing it tens of milliseconds."""
    known: Asset | None = getattr(app.state, "description", None)
    if known is None:
        text = json.dumps(openapi_document(app), ensure_ascii=False, separators=(",", ":"))
        known = app.state.description = Asset(text.encode(), "application/json")
        known.pack()
    return known


def openapi_document(app: Any) -> dict[str, Any]:
    """Return the document of an app. Raise ValueError if two schemas would have one name."""
    document = with_published_names(
        get_openapi(title=app.title, version=app.version, summary=app.summary, routes=app.routes)
    )
    for path in document["paths"].values():
        for method, operation in path.items():
            _complete(operation, is_write=method not in ("get", "head"))
    components = document["components"]
    components["schemas"] |= _problem_schemas(components["schemas"])
    components["headers"] = PARTS["headers"]
    components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
    add_examples(document)
    document["security"] = [{"token": []}]
    document["servers"] = [{"url": "/", "description": "The server that this document comes from."}]
    return document


def _complete(operation: dict[str, Any], *, is_write: bool) -> None:
    """Add to an operation of the OpenAPI document the parts that no signature states."""
    for parameter in operation.get("parameters", ()):
        name = parameter["name"] if parameter["in"] != "header" else parameter["name"].lower()
        if name in PARTS["parameters"]:
            parameter.setdefault("description", PARTS["parameters"][name])
    for content in operation.get("requestBody", {}).get("content", {}).values():
        match content["schema"]:
            # Generated clients fail at a body that may be left out and may also be null.
            case {"anyOf": [schema, {"type": "null"}]}:
                content["schema"] = schema
    if is_write:
        # The header states when the write was made; the server reads it beside the routes. Its schema has no
        # ``format``: openapi-python-client generates no call with a ``date-time`` in a header.
        operation.setdefault("parameters", []).append(PARTS["sentAt"])


_REF = "#/components/schemas/"


def schema_name(model: str) -> str:
    """Return the published name of a class, without the ending that distinguishes it from a class of the
    domain: ``AlarmShown`` → ``Alarm``, ``CommandRequestBody`` → ``CommandRequest``."""
    return model.removesuffix("Shown").removesuffix("Body")


def with_published_names(document: dict[str, Any]) -> dict[str, Any]:
    """Return the document with every schema under its published name. Raise ValueError if two would have the
    same."""
    schemas = document["components"]["schemas"]
    named = {schema_name(name): schema for name, schema in schemas.items()}
    if len(named) < len(schemas):
        raise ValueError("two schemas have one published name; rename one class")
    document["components"]["schemas"] = named
    renamed: dict[str, Any] = _renamed(document)
    return renamed


def _portable(schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a dictionary whose keys have a pattern in the form that generators understand."""
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


Schema = Mapping[str, Any]
_WRITTEN: dict[str, Any] = json.loads(
    Path(__file__).with_name("openapi_examples.json").read_text(encoding="utf-8")
)
_FORMATS = {
    "date-time": "2026-11-21T03:12:00.125+00:00",
    "date": "2026-11-21",
}
_PLAIN: dict[str, Any] = {"integer": 1, "number": 1.5, "string": "text", "boolean": True, "null": None}


def add_examples(document: dict[str, Any]) -> None:
    """Give every request and every successful response an example, as far as one is known: a document without
    one is better than none."""
    schemas = document["components"]["schemas"]
    for operation in _operations(document):
        for content in operation.get("requestBody", {}).get("content", {}).values():
            model = content["schema"].get("$ref", "").removeprefix(_REF)
            if model in _WRITTEN["requests"]:
                content["example"] = _WRITTEN["requests"][model]
        for status, response in operation["responses"].items():
            for media_type, content in response.get("content", {}).items() if status[0] == "2" else ():
                written = _WRITTEN["texts"].get(media_type)
                content["example"] = _example_of(content["schema"], schemas) if written is None else written


def _operations(document: Schema) -> Iterator[dict[str, Any]]:
    for methods in document["paths"].values():
        yield from methods.values()


def _example_of(schema: Schema, schemas: Schema, name: str = "") -> Any:
    """Return a value of the schema; ``name``: that of the member that it is for."""
    match schema:
        case {"examples": [example, *_]}:
            return example
        case {"$ref": str(reference)}:
            model = reference.removeprefix(_REF)
            made = _example_of(schemas[model], schemas, name)
            return made | _WRITTEN["objects"][model] if model in _WRITTEN["objects"] else made
        case {"enum": [first, *_]} | {"const": first}:
            return first
        case {"anyOf": [*choices]} if {"type": "null"} in choices and name not in _WRITTEN["members"]:
            return None
        case {"anyOf": [first, *_]} | {"oneOf": [first, *_]}:
            return _example_of(first, schemas, name)
        case {"type": "object"}:
            return {
                member: _example_of(each, schemas, member)
                for member, each in schema.get("properties", {}).items()
            }
        case {"type": kind} if _is_of(_WRITTEN["members"].get(name), kind):
            return _WRITTEN["members"][name]
        case {"type": "array"}:
            return [_example_of(schema["items"], schemas)]
        case {"format": str(form)} if form in _FORMATS:
            return _FORMATS[form]
    plain = _PLAIN.get(schema.get("type", "null"))
    return max(plain, schema["minimum"]) if plain is not None and "minimum" in schema else plain


def _is_of(value: Any, kind: Any) -> bool:
    """Return whether a value is of a type of JSON Schema."""
    kinds = {"string": str, "integer": int, "array": list}
    return isinstance(value, kinds.get(kind, ()))
