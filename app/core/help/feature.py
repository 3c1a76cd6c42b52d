"""The handbook and the reference of the API as pages; the reference is a list for people, made from the
OpenAPI document."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import Annotated, Any

from fastapi import APIRouter, FastAPI, Query
from markupsafe import Markup, escape
from starlette.requests import Request
from starlette.responses import FileResponse, Response

from app.core.find.finders import Finders, FoundPlace, Search, matched
from app.core.help.handbook import BY_NAME, Chapter, Handbook
from app.core.web.access import Viewer
from app.core.web.api import rendered_once
from app.core.web.assets import docs_dir
from app.core.web.request_rules import parse_apart
from app.core.web.routes import SEARCH, GuardedRoute
from app.core.web.services import service_of
from app.core.web.templating import render, templates_of
from app.errors import Problem
from app.feature import Feature, Services
from app.version import VERSION
from bus.messages import Message
from bus.validation import OneLine

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
    """A call of the API. ``responses``: their meanings, by status; ``sent``, ``received``: examples of its
    body and its response, empty if there is none. ``can_open``: whether a browser can open it without a
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
    """Return the example of a request or response in the first of its media types: indented JSON, or the
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


router = APIRouter(include_in_schema=False, route_class=GuardedRoute)
TypedHelp = Annotated[OneLine, Query(max_length=80)]


@router.get("/help", dependencies=[SEARCH])
async def help_page(request: Request, _: Viewer, typed: TypedHelp = "") -> Response:
    """Show the list of the chapters, or the sections that match the typed words."""
    handbook, language = service_of(request, Handbook), _language(request)
    groups, hits = await parse_apart(
        lambda: (_chapters_by_group(handbook, language), handbook.search(typed, language))
    )
    return render(request, "help/page.html", groups=groups, typed=typed, hits=hits, version=VERSION)


def _chapters_by_group(handbook: Handbook, language: str) -> list[tuple[Message, list[tuple[Chapter, str]]]]:
    """Return each chapter with its title, by group."""
    titles = groupby(handbook.titles(language), key=lambda title: title[0].group)
    return [(group, list(each)) for group, each in titles]


def _language(request: Request) -> str:
    return templates_of(request).language_of(request).tag


@router.get("/help/pictures/{name}")
async def picture(request: Request, _: Viewer, name: str) -> Response:
    """Return a picture of the handbook."""
    path = service_of(request, Handbook).picture(name)
    if path is None:
        raise Problem(404, "not_found", Message("no_such_page"))
    return FileResponse(path, media_type="image/png")


@router.get("/help/legend")
async def legend(request: Request, _: Viewer, part: bool = False) -> Response:
    """Show the meaning of the marks. ``part``: only the content of the drawer."""
    return render(request, "help/legend.html", part=part)


@router.get("/help/{name:path}")
async def chapter_page(request: Request, _: Viewer, name: str) -> Response:
    """Show one chapter, in the language of the reader if it exists in that."""
    chapter = BY_NAME.get(name)
    if chapter is None:
        raise Problem(404, "not_found", Message("no_such_page"))
    language = _language(request)
    rendered = await parse_apart(partial(service_of(request, Handbook).chapter, chapter, language))
    written_in = language if chapter.file_in(language) != chapter.file else "en"
    return render(
        request, "help/chapter.html", chapter=rendered, written_in=written_in, is_one_page=chapter.is_one_page
    )


@router.get("/docs")
async def api_reference(request: Request, _: Viewer) -> Response:
    """Show every call of the API, with its parameters and its response."""
    return render(request, "help/api.html", tags=await parse_apart(partial(_calls_by_tag, request.app)))


def _calls_by_tag(app: FastAPI) -> list[tuple[str, list[Call]]]:
    return calls_of(json.loads(rendered_once(app).body))


def make(services: Services) -> None:
    handbook = services.add(Handbook(docs_dir()))
    services[Finders].add("find_help", partial(_find, handbook))


async def _find(handbook: Handbook, search: Search) -> Iterable[FoundPlace]:
    """Find chapters by their title and by their name, which is English in every language."""
    found: list[FoundPlace] = []
    for chapter, title in handbook.titles(search.language.tag):
        name = chapter.name.replace("-", " ")
        found += matched(search, FoundPlace(title, f"/help/{chapter.name}", is_name=True), title, name)
    return found


FEATURE = Feature(make, (router,))
