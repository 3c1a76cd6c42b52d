"""The calls of the API as a list for people, made from the OpenAPI document. Pure."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from markupsafe import Markup, escape

ALTERNATIVES = ("anyOf", "oneOf")
_CODE = re.compile(r"(`+)(.+?)\1", re.DOTALL)


@dataclass(frozen=True, slots=True)
class CallMember:
    """A parameter of a call, or a member of its body. ``kind``: its type as OpenAPI names it."""

    name: str
    kind: str
    is_required: bool
    words: Markup


@dataclass(frozen=True, slots=True)
class Call:
    """A call of the API. ``responses``: what they mean, by status; ``sent``, ``received``: examples of its
    body and its response, empty without one. ``can_open``: whether a browser can open it without a
    parameter."""

    id: str
    tag: str
    method: str
    path: str
    summary: str
    words: Markup
    parameters: tuple[CallMember, ...]
    body: tuple[CallMember, ...]
    responses: tuple[tuple[str, Markup], ...]
    sent: str
    received: str

    @property
    def can_open(self) -> bool:
        required = any(parameter.is_required for parameter in self.parameters)
        return self.method == "GET" and not required and not self.path.endswith("/stream")


def calls_of(document: Mapping[str, Any]) -> list[tuple[str, list[Call]]]:
    """Return each tag with its calls, tags in alphabetical order, calls in that of the document."""
    calls = sorted(_calls(document), key=lambda call: call.tag)
    return [(tag, list(group)) for tag, group in groupby(calls, key=lambda call: call.tag)]


def _calls(document: Mapping[str, Any]) -> Iterator[Call]:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            members = [
                _member(each["name"], each["schema"], each, required=each.get("required", False))
                for each in operation.get("parameters", ())
            ]
            yield Call(
                operation["operationId"],
                operation.get("tags", [""])[0],
                method.upper(),
                path,
                operation.get("summary", ""),
                in_html(operation.get("description", "")),
                tuple(members),
                tuple(_body(document, operation)),
                tuple(_responses(operation)),
                _example(operation.get("requestBody", {})),
                "".join(
                    _example(each) for status, each in operation["responses"].items() if status[0] == "2"
                ),
            )


def _responses(operation: Mapping[str, Any]) -> Iterator[tuple[str, Markup]]:
    for status, each in operation["responses"].items():
        yield status, in_html(each["description"])


def _example(message: Mapping[str, Any]) -> str:
    """Return the example of a request or response in the first of its media types: JSON in lines, or the
    text."""
    content: Mapping[str, Any] = next(iter(message.get("content", {}).values()), {})
    example = content.get("example", "")
    return example if isinstance(example, str) else json.dumps(example, ensure_ascii=False, indent=2)


def _body(document: Mapping[str, Any], operation: Mapping[str, Any]) -> Iterator[CallMember]:
    for content in operation.get("requestBody", {}).get("content", {}).values():
        schema = content.get("schema", {})
        if "$ref" in schema:
            schema = document["components"]["schemas"][_named(schema["$ref"])]
        for name, each in schema.get("properties", {}).items():
            yield _member(name, each, each, required=name in schema.get("required", ()))


def _member(name: str, schema: Mapping[str, Any], words: Mapping[str, Any], *, required: bool) -> CallMember:
    return CallMember(name, _kind(schema), required, in_html(words.get("description", "")))


def _kind(schema: Mapping[str, Any]) -> str:
    """Return the type of a value in a few words: ``integer``, ``array of Alarm``, ``string or null``."""
    if "$ref" in schema:
        return _named(schema["$ref"])
    for word in ALTERNATIVES:
        if word in schema:
            return " or ".join(dict.fromkeys(_kind(each) for each in schema[word]))
    if "enum" in schema:
        return ", ".join(str(each) for each in schema["enum"])
    if "const" in schema:
        return str(schema["const"])
    kind = schema.get("type", "any")
    return f"array of {_kind(schema['items'])}" if kind == "array" and "items" in schema else str(kind)


def in_html(description: str) -> Markup:
    """Return a description for a page. Of CommonMark the document uses only code between backquotes."""
    return Markup(_CODE.sub(r"<code>\2</code>", str(escape(description))))


def _named(reference: str) -> str:
    return reference.rpartition("/")[2]
