"""How a refusal is described in the OpenAPI document: one schema, and the statuses of each operation."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from app.errors import CODES

PARTS: dict[str, Any] = json.loads(Path(__file__).with_name("openapi_parts.json").read_text(encoding="utf-8"))
"""What no signature states: descriptions of parameters by name (of a header in small letters) and of
statuses, the header of every write, and the schemas of a refusal."""


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """For ``responses=``: problems of these statuses."""
    return {status: _response(PARTS["statuses"][str(status)]) for status in statuses}


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
    result, own = schemas["CommandResult"]["properties"], PARTS["schemas"]
    problem = {**own["Problem"], "properties": {**result, **own["Problem"]["properties"]}}
    return {**own, "Problem": problem, "ProblemCode": {**own["ProblemCode"], "enum": sorted(CODES)}}


@cache
def _response(description: str) -> dict[str, Any]:
    content = {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {"description": description, "content": content}
