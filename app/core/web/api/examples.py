"""An example of each request and response of the OpenAPI document. Pure.

Requests are written, as only some members go together; a response is made of its schema, so that it has every
member.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

Schema = Mapping[str, Any]
_WRITTEN: dict[str, Any] = json.loads(
    Path(__file__).with_name("openapi_examples.json").read_text(encoding="utf-8")
)
_REF = "#/components/schemas/"
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
                content["example"] = example_of(content["schema"], schemas) if written is None else written


def _operations(document: Schema) -> Iterator[dict[str, Any]]:
    for methods in document["paths"].values():
        yield from methods.values()


def example_of(schema: Schema, schemas: Schema, name: str = "") -> Any:
    """A value of the schema; of a member of this name."""
    match schema:
        case {"examples": [example, *_]}:
            return example
        case {"$ref": str(reference)}:
            model = reference.removeprefix(_REF)
            made = example_of(schemas[model], schemas, name)
            return made | _WRITTEN["objects"][model] if model in _WRITTEN["objects"] else made
        case {"enum": [first, *_]} | {"const": first}:
            return first
        case {"anyOf": [*choices]} if {"type": "null"} in choices and name not in _WRITTEN["members"]:
            return None
        case {"anyOf": [first, *_]} | {"oneOf": [first, *_]}:
            return example_of(first, schemas, name)
        case {"type": "object"}:
            return {
                member: example_of(each, schemas, member)
                for member, each in schema.get("properties", {}).items()
            }
        case {"type": kind} if _is_of(_WRITTEN["members"].get(name), kind):
            return _WRITTEN["members"][name]
        case {"type": "array"}:
            return [example_of(schema["items"], schemas)]
        case {"format": str(form)} if form in _FORMATS:
            return _FORMATS[form]
    plain = _PLAIN.get(schema.get("type", "null"))
    return max(plain, schema["minimum"]) if plain is not None and "minimum" in schema else plain


def _is_of(value: Any, kind: Any) -> bool:
    """Whether a value is of a type of JSON Schema."""
    kinds = {"string": str, "integer": int, "array": list}
    return isinstance(value, kinds.get(kind, ()))
