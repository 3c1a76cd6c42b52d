"""Find anything by its name: a list below the field of each page, and a page for browsers without scripts."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from app.core.find.finders import Finders, Search
from app.core.web.admission.access import Viewer
from app.core.web.admission.turns import SEARCH
from app.core.web.rendering.templating import render, templates_of
from app.core.web.services import service_of
from bus.text import OneLine

router = APIRouter(include_in_schema=False)
Typed = Annotated[OneLine, Query(max_length=80)]
Near = Annotated[str, Query(max_length=200)]


@router.get("/find", dependencies=[SEARCH])
async def find_page(
    request: Request, person: Viewer, typed: Typed = "", near: Near = "", part: bool = False
) -> Response:
    """What the typed text finds. ``part``: the list alone."""
    templates = templates_of(request)
    language = templates.language_of(request)
    may = partial(templates.may, person)
    search = Search(typed, language, templates.formats(language.tag), may, near)
    found = await service_of(request, Finders).find(search)
    template = "find/_found.html" if part else "find/page.html"
    return render(request, template, typed=typed, near=near, found=found)
