"""How a refusal is described in the OpenAPI document: one schema, and the statuses of each operation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from app.errors import CODES

_SCHEMAS = "#/components/schemas/"
_CODE = {"$ref": f"{_SCHEMAS}ProblemCode"}

STATUSES = {
    401: "Not signed in, or the token is not valid.",
    403: "The role does not allow it.",
    404: "There is no such bus, unit or entry. Nothing was sent.",
    409: "Refused by the unit (refused), not confirmed (dangerous), controlled by another (controlled).",
    422: "Out of range or malformed (invalid). Nothing was sent.",
    423: "Commands to the unit are blocked. Nothing was sent.",
    501: "pyarrow is not installed (no_parquet).",
    503: "No link to the bus (bus_closed), not sent in time (not_sent), or the store cannot be used (store).",
    504: "No response, or the read-back differs (unverified): the state of the unit is not known.",
}

_MEMBERS: dict[str, Any] = {
    "type": {
        "type": "string",
        "description": "about:blank (RFC 9457, 4.2.1): code identifies the problem.",
    },
    "title": {"type": "string", "description": "The phrase of the HTTP status."},
    "status": {"type": "integer", "description": "The HTTP status, 400 to 599."},
    "code": _CODE,
    "reason": {"type": "string", "description": "Which text detail is: more exact than code."},
    "detail": {"type": "string", "description": "What happened, why, and what to do; for people."},
    "params": {
        "type": "object",
        "additionalProperties": {"type": ["integer", "number", "string"]},
        "description": "The values in detail, by name, but for those that are members of the problem.",
    },
    "errors": {
        "type": "array",
        "items": {"$ref": f"{_SCHEMAS}InvalidField"},
        "description": "Each field that is malformed.",
    },
    "outcome": {"anyOf": [_CODE, {"type": "null"}], "description": "As code, where a command was refused."},
    "unit": {
        "type": ["integer", "null"],
        "description": "Address of the unit (#17) that it is about, 1 to 255.",
    },
    "nearest": {
        "type": ["integer", "null"],
        "description": "The nearest raw value that is allowed, 0 to 99999.",
    },
}
_INVALID_FIELD = {
    "type": "object",
    "title": "InvalidField",
    "description": "One field of a request that is malformed.",
    "required": ["where", "message", "code", "params"],
    "properties": {
        "where": {"type": "string", "description": "Its path in the body or query, steps joined by dots."},
        "message": {"type": "string", "description": "Its fault, English."},
        "code": {"type": "string", "description": "Which text message is."},
        "params": {"type": "object", "additionalProperties": True, "description": "Its values, by name."},
    },
}


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """For ``responses=``: problems of these statuses."""
    return {status: _response(STATUSES[status]) for status in statuses}


def usual_problems(path: str, methods: Iterable[str]) -> dict[int | str, dict[str, Any]]:
    """For every operation of the API, by its path and methods."""
    statuses = {401, 403, 422, 503}
    statuses |= {404} if "{" in path else set()
    statuses |= {409} if set(methods) - {"GET", "HEAD"} else set()
    return {
        **problems(*sorted(statuses)),
        "default": _response("Any other refusal. detail states what was done."),
    }


def problem_schemas(schemas: Mapping[str, Any]) -> dict[str, Any]:
    """The schemas of a problem. Where a command was sent, its result's members are in the problem too."""
    result = schemas["CommandResult"]["properties"]
    problem = {
        "type": "object",
        "title": "Problem",
        "description": "A refusal or failure as application/problem+json (RFC 9457).",
        "required": ["type", "title", "status", "code", "reason", "params", "detail"],
        "properties": {**result, **_MEMBERS},
    }
    code = {"type": "string", "title": "ProblemCode", "enum": sorted(CODES), "description": "The reason."}
    return {"Problem": problem, "ProblemCode": code, "InvalidField": _INVALID_FIELD}


def _response(description: str) -> dict[str, Any]:
    content = {"application/problem+json": {"schema": {"$ref": f"{_SCHEMAS}Problem"}}}
    return {"description": description, "content": content}
