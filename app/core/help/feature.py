"""Serves the handbook and the reference of the API as pages."""

from __future__ import annotations

import json
from functools import partial
from itertools import groupby
from typing import Annotated

from fastapi import APIRouter, FastAPI, Query
from starlette.requests import Request
from starlette.responses import FileResponse, Response

from app.core.help.handbook import BY_NAME, CHAPTERS, Chapter, Handbook
from app.core.help.reference import Call, calls_of
from app.core.web.access import Viewer
from app.core.web.api import rendered_once
from app.core.web.assets import docs_dir
from app.core.web.request_rules import parse_apart
from app.core.web.routes import SEARCH
from app.core.web.services import service_of
from app.core.web.templating import render, templates_of
from app.errors import Problem
from app.feature import Feature, Services
from app.version import VERSION
from bus.messages import Message
from bus.validation import OneLine

router = APIRouter(include_in_schema=False)
TypedHelp = Annotated[OneLine, Query(max_length=80)]


@router.get("/help", dependencies=[SEARCH])
async def help_page(request: Request, _: Viewer, typed: TypedHelp = "") -> Response:
    """Show the list of the chapters, or what the typed words find in them."""
    handbook, language = service_of(request, Handbook), _language(request)
    groups, hits = await parse_apart(
        lambda: (_chapters_by_group(handbook, language), handbook.search(typed, language))
    )
    return render(request, "help/page.html", groups=groups, typed=typed, hits=hits, version=VERSION)


def _chapters_by_group(handbook: Handbook, language: str) -> list[tuple[Message, list[tuple[Chapter, str]]]]:
    """Return each chapter with its title, by group."""
    titles = [(chapter, handbook.chapter(chapter, language).title) for chapter in CHAPTERS]
    return [(group, list(each)) for group, each in groupby(titles, key=lambda title: title[0].group)]


def _language(request: Request) -> str:
    return templates_of(request).language_of(request).tag


@router.get("/help/pictures/{name}")
async def picture(request: Request, _: Viewer, name: str) -> Response:
    """Return a picture of the handbook."""
    path = service_of(request, Handbook).picture(name)
    if path is None:
        raise Problem(404, "not_found", Message("no_such_page"))
    return FileResponse(path, media_type="image/png")


@router.get("/help/{name:path}")
async def chapter_page(request: Request, _: Viewer, name: str) -> Response:
    """Show one chapter, in the language of the reader if it is written in it."""
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
    """Show every call of the API, with what it takes and returns."""
    return render(request, "help/api.html", tags=await parse_apart(partial(_calls, request.app)))


def _calls(app: FastAPI) -> list[tuple[str, list[Call]]]:
    return calls_of(json.loads(rendered_once(app).body))


def make(services: Services) -> None:
    services.add(Handbook(docs_dir()))


FEATURE = Feature(make, (router,))
