"""The pages of the configuration: its tables, one of them to change, its versions."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

from fastapi import APIRouter, Form
from starlette.datastructures import FormData
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.core.web.access import Person
from app.core.web.formats import Formats
from app.core.web.routes import GuardedRoute
from app.core.web.services import service
from app.core.web.templating import render, templates_of
from app.errors import Problem
from app.line.conditions.catalogue import CONDITIONS
from app.records.notification.settings import DAYS
from app.system.configuration.api import (
    MAX_REASON,
    ConfigurationChanger,
    FileOfServer,
    RestartOfServer,
    act_on,
    edit_of,
)
from app.system.configuration.document import at, content_of, difference, masked
from app.system.configuration.service import (
    RESTART,
    ROLL_BACK,
    ConfigurationFile,
    ConfigurationReview,
    PresentFile,
    SystemsBeside,
)
from app.system.configuration.tables import (
    ALARM_CODES,
    FORMS,
    TablePlace,
    end_of,
    place_or_404,
    places_of,
    same_table,
    texts_of,
    title_of,
)
from bus.configuration import lines_of, statements
from bus.errors import CallerError
from bus.messages import Message
from bus.validation import OneLine

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)

SEE_OTHER = 303
_DUTY = next(form for form in FORMS if form.kind == "duty")
Restarter = Annotated[Person, RESTART.permitted]
RollBacker = Annotated[Person, ROLL_BACK.permitted]
Digest = Annotated[str, Form(max_length=64)]
_WORDS = {day: Message(f"day_{number}") for number, day in enumerate(DAYS)} | {
    code: Message(CONDITIONS[code].texts[0]) for code in ALARM_CODES
}
"""Of the choices of a field."""
ReasonOfChange = Annotated[OneLine, Form(max_length=MAX_REASON)]


class ShownTable(NamedTuple):
    """A table of the list: where it is, and what it is called."""

    place: TablePlace
    title: str


@router.get("/configuration")
async def configuration_page(
    request: Request,
    _: ConfigurationChanger,
    file: FileOfServer,
    restart: RestartOfServer,
    beside: Annotated[SystemsBeside, service(SystemsBeside)],
    done: int = 0,
    restarting: bool = False,
) -> Response:
    """Show the tables of the file, what it lacks, and its newest versions."""
    try:
        present = await file.present()
    except Problem as problem:
        return render(request, "configuration/none.html", problem=problem)
    data = present.data
    shown: dict[str, list[ShownTable]] = {form.kind: [] for form in FORMS}
    for place in places_of(data):
        shown[place.form.kind].append(ShownTable(place, title_of(place, data)))
    return render(
        request,
        "configuration/page.html",
        path_of_file=file.path,
        present=present,
        waiting=await asyncio.to_thread(file.waiting, present),
        shown=shown,
        new={form.kind: end_of(form, data).name for form in FORMS if form.is_listed and len(form.path) < 5},
        duties=[ShownTable(end_of(_DUTY, data, group.place.path), group.title) for group in shown["group"]],
        buses=buses_of(present),
        versions=await file.versions(),
        done=done,
        can_restart=restart.is_offered and not present.faults,
        restarting=restarting,
        beside=[state_of() for state_of in beside],
    )


@router.get("/configuration/tables/{name}")
async def configuration_table_page(
    request: Request, _: ConfigurationChanger, file: FileOfServer, name: str
) -> Response:
    """Show one table to change, or a new one."""
    present = await file.present()
    place = place_or_404(name, present.data)
    return _form(request, place, present, texts_of(place, present.data))


@router.post("/configuration/tables/{name}")
async def change_configuration_table(
    request: Request,
    person: ConfigurationChanger,
    file: FileOfServer,
    name: str,
    reason_of_change: ReasonOfChange = "",
) -> Response:
    """Review what was typed; with ``confirmed`` write it. A file that was changed meanwhile is shown as it is
    now, with what was typed."""
    form = await request.form()
    try:
        return await _changed(request, person, file, name, form, reason_of_change)
    except Problem as problem:
        if problem.code != "superseded":
            raise
    return await _superseded(request, file, name, form)


async def _changed(
    request: Request, person: Person, file: ConfigurationFile, name: str, form: FormData, reason: str
) -> Response:
    digest, present = _text_in(form, "digest"), await file.present()
    file.refuse_superseded(present, digest)
    place = place_or_404(name, present.data)
    texts, kind, act = _typed(request, place, form), _text_in(form, "act"), act_on(place)
    act.check(person)
    edit = edit_of(place, kind, texts)
    try:
        review = await file.review(edit, digest)
    except CallerError as fault:
        return _form(request, place, present, texts, fault=fault.message)
    if review.faults:
        errors, others = _faults_by_field(place, review)
        return _form(request, place, present, texts, errors=errors, faults=others)
    if review.text == present.text:
        return _form(request, place, present, texts, fault=Message("configuration_nothing_changed"))
    if not _text_in(form, "confirmed"):
        fields = {"act": kind, **texts}
        return review_page(request, file, present, review, f"/configuration/tables/{name}", fields)
    version = await file.save(person, act, edit, digest, reason)
    return RedirectResponse(f"/configuration?done={version.number}", SEE_OTHER)


@router.get("/configuration/versions/{number}")
async def configuration_version_page(
    request: Request, _: ConfigurationChanger, file: FileOfServer, number: int
) -> Response:
    """Show what was changed since a version, until now."""
    stored, present = await file.version(number), await file.present()
    return render(
        request,
        "configuration/version.html",
        version=stored.version,
        lines=difference(stored.text, present.text),
        digest=present.digest,
    )


@router.post("/configuration/versions/{number}/roll-back")
async def roll_back_configuration_page(
    request: Request,
    person: RollBacker,
    file: FileOfServer,
    number: int,
    digest: Digest = "",
    reason_of_change: ReasonOfChange = "",
    confirmed: Annotated[str, Form()] = "",
) -> Response:
    """Review the way back to a version; with ``confirmed`` write it, as a version itself."""
    stored, present = await file.version(number), await file.present()
    review = await file.review(lambda _: stored.text, digest)
    if confirmed and not review.faults:
        saved = await file.save(person, ROLL_BACK, lambda _: stored.text, digest, reason_of_change)
        return RedirectResponse(f"/configuration?done={saved.number}", SEE_OTHER)
    return review_page(request, file, present, review, f"/configuration/versions/{number}/roll-back", {})


@router.post("/configuration/restart")
async def restart_server_page(
    person: Restarter, restart: RestartOfServer, digest: Digest = "", reason_of_change: ReasonOfChange = ""
) -> Response:
    """Restart with the lines that the page has shown."""
    await restart.request(person, digest, reason_of_change)
    return RedirectResponse("/configuration?restarting=true", SEE_OTHER)


def review_page(
    request: Request,
    file: ConfigurationFile,
    present: PresentFile,
    review: ConfigurationReview,
    action: str,
    fields: Mapping[str, str],
) -> Response:
    """Show what the file would become; ``fields`` are posted to ``action`` again when it is confirmed."""
    shown = masked(review.text)
    return render(
        request,
        "configuration/review.html",
        status=422 if review.faults else 200,
        present=present,
        path_of_file=file.path,
        owner=file.owner,
        review=review,
        action=action,
        fields=fields,
        shown=shown,
        is_masked=lines_of(shown) != [f"{line.rstrip()}\n" for line in lines_of(review.text)],
    )


def _form(
    request: Request,
    place: TablePlace,
    present: PresentFile,
    texts: Mapping[str, str],
    *,
    errors: Mapping[str, Message] | None = None,
    faults: tuple[Message, ...] = (),
    fault: Message | None = None,
    **more: Any,
) -> Response:
    is_refused = bool(errors or faults or fault)
    return render(
        request,
        "configuration/table.html",
        status=more.pop("status", 422 if is_refused else 200),
        place=place,
        title=title_of(place, present.data),
        is_new=place.form.is_listed and at(present.data, place.path) is None,
        texts=texts,
        digest=present.digest,
        errors=errors or {},
        faults=(*faults, *((fault,) if fault else ())),
        permitted=act_on(place).name,
        words=_WORDS,
        **{"lines": (), **more},
    )


async def _superseded(request: Request, file: ConfigurationFile, name: str, form: FormData) -> Response:
    """Return what was typed, over the file as it is now: what was not changed here is as in the file."""
    present, began = await file.present(), await file.version_of(_text_in(form, "digest"))
    before = content_of(began.text) if began else present.data
    place = place_or_404(name, before)
    typed, former = _typed(request, place, form), texts_of(place, before)
    changed = {key: text for key, text in typed.items() if began is None or text != former[key]}
    now = same_table(place, before, present.data)
    lines = difference(began.text, present.text) if began else []
    message = Message("configuration_superseded")
    if now is None or _text_in(form, "act") != "change":
        return render(
            request, "configuration/moved.html", status=409, message=message, lines=lines, typed=changed
        )
    texts = {**texts_of(now, present.data), **changed}
    return _form(request, now, present, texts, fault=message, lines=lines, status=409)


def _faults_by_field(
    place: TablePlace, review: ConfigurationReview
) -> tuple[dict[str, Message], tuple[Message, ...]]:
    """Return the faults that are of a key of the form, and the others with their line."""
    lines = {each.first: each.paths for each in statements(review.text) if not each.is_header}
    errors, others = {}, []
    for fault in review.faults:
        paths = lines.get(int(str(fault.params.get("line", 0))), ())
        keys = [field.key for field in place.form.fields if (*place.path, *field.key.split(".")) in paths]
        inner = fault.params.get("fault")
        if keys and isinstance(inner, Message):
            errors[keys[0]] = inner
        else:
            others.append(inner if isinstance(inner, Message) else fault)
    return errors, tuple(others)


def _typed(request: Request, place: TablePlace, form: FormData) -> dict[str, str]:
    """Return what was typed, by key. A field of several choices has each that was chosen; a number may have
    the decimal comma of the reader."""
    templates = templates_of(request)
    formats: Formats = templates.formats(templates.language_of(request).tag)
    texts = {}
    for field in place.form.fields:
        given = [value for value in form.getlist(field.key) if isinstance(value, str)]
        text = ", ".join(given).strip()
        texts[field.key] = formats.typed_number(text) if field.kind == "number" else text
    return texts


def buses_of(present: PresentFile) -> list[dict[str, Any]]:
    """Return the buses of the file."""
    buses = at(present.data, ("bus",))
    return [bus for bus in buses if isinstance(bus, dict)] if isinstance(buses, list) else []


def _text_in(form: FormData, key: str) -> str:
    value = form.get(key, "")
    return value if isinstance(value, str) else ""
