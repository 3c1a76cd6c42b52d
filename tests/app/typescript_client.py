"""A TypeScript client made from an OpenAPI document: its types, and a function for each operation. Pure."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

Json = Mapping[str, Any]
SEND = """export type Send = (method: string, path: string, query: object, body: unknown) => Promise<unknown>;
"""


def client_of(document: Json) -> str:
    """The text of a module."""
    schemas = document["components"]["schemas"]
    types = (f"export type {name} = {type_of(each)};\n" for name, each in schemas.items())
    return SEND + "".join(types) + "".join(_functions(document))


def type_of(schema: Json) -> str:
    """A schema as a type. Raises KeyError for a schema without a type."""
    match schema:
        case {"$ref": str(reference)}:
            return reference.rpartition("/")[2]
        case {"enum": values}:
            return " | ".join(json.dumps(value) for value in values)
        case {"const": value}:
            return json.dumps(value)
        case {"type": list(kinds)}:
            return " | ".join(type_of({**schema, "type": kind}) for kind in kinds)
        case {"anyOf": choices} | {"oneOf": choices}:
            return " | ".join(dict.fromkeys(type_of(choice) for choice in choices))
        case {"type": "array", "items": items}:
            return f"Array<{type_of(items)}>"
        case {"type": "object"}:
            return _object(schema)
    return _PLAIN[schema["type"]]


_PLAIN = {"integer": "number", "number": "number", "string": "string", "boolean": "boolean", "null": "null"}


def _object(schema: Json) -> str:
    if "properties" not in schema:
        values = schema.get("additionalProperties")
        return f"Record<string, {type_of(values) if isinstance(values, dict) and values else 'unknown'}>"
    required = schema.get("required", ())
    members = (
        f"{json.dumps(name)}{'' if name in required else '?'}: {type_of(each)}"
        for name, each in schema["properties"].items()
    )
    return "{ " + "; ".join(members) + " }"


def _functions(document: Json) -> Iterator[str]:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield _function(method.upper(), path, operation)


def _function(method: str, path: str, operation: Json) -> str:
    places = [each for each in operation.get("parameters", ()) if each["in"] == "path"]
    query = [each for each in operation.get("parameters", ()) if each["in"] == "query"]
    body = operation.get("requestBody")
    arguments = ["send: Send", *(f"{each['name']}: {type_of(each['schema'])}" for each in places)]
    if body is not None:
        bodies = " | ".join(type_of(each["schema"]) for each in body["content"].values())
        arguments.append(f"body: {bodies}" + ("" if body.get("required") else " | undefined"))
    members = "; ".join(
        f"{json.dumps(each['name'])}{'' if each.get('required') else '?'}: {type_of(each['schema'])}"
        for each in query
    )
    optional = "" if any(each.get("required") for each in query) else " = {}"
    arguments.append(f"query: {{ {members} }}{optional}")
    result = _result(operation)
    target = re.sub(r"{(\w+)}", r"${encodeURIComponent(\1)}", path)
    sent = "body" if body else "undefined"
    return (
        f"export function {operation['operationId']}({', '.join(arguments)}): Promise<{result}> {{\n"
        f'  return send("{method}", `{target}`, query, {sent}) as Promise<{result}>;\n'
        "}\n"
    )


def _result(operation: Json) -> str:
    success = next(each for status, each in operation["responses"].items() if status.startswith("2"))
    found = dict.fromkeys(type_of(each["schema"]) for each in success.get("content", {}).values())
    return " | ".join(found) or "undefined"
