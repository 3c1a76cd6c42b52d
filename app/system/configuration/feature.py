"""The configuration file in the browser: its tables, one table to change, its versions; and the page of a
present or new bus: its port, a scan of the port, its units."""

from __future__ import annotations

import asyncio
import re
import tomllib
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

from fastapi import APIRouter, Form, Path
from starlette.datastructures import FormData
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.core.web.access import Person
from app.core.web.formats import Formats
from app.core.web.problems import is_fragment
from app.core.web.result import result_of, send_to, shown_once
from app.core.web.routes import GuardedRoute
from app.core.web.services import service
from app.core.web.templating import render, templates_of
from app.errors import Problem
from app.feature import Feature, Services
from app.line.conditions.catalogue import CONDITIONS
from app.people.audit.log import EventLog
from app.records.notification.settings import DAYS
from app.system.configuration import api
from app.system.configuration.api import (
    MAX_REASON,
    ConfigurationChanger,
    FileOfServer,
    RestartOfServer,
    act_on,
    edit_of,
)
from app.system.configuration.document import (
    Edit,
    TomlValue,
    VersionStore,
    at,
    content_of,
    difference,
    masked,
    with_values,
    without,
)
from app.system.configuration.port_scan import PortScan, ports
from app.system.configuration.service import (
    ACTS,
    CHANGE_PORTS,
    RESTART,
    ROLL_BACK,
    ConfigurationFile,
    ConfigurationReview,
    PresentFile,
    Restart,
)
from app.system.configuration.tables import (
    ALARM_CODES,
    DEFAULTS,
    FORMS,
    TablePlace,
    changes_of,
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
from bus.settings import BAUDS, BusSettings, check_port
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
"""The texts of a field's choices."""
ReasonOfChange = Annotated[OneLine, Form(max_length=MAX_REASON)]


class ShownTable(NamedTuple):
    """A table of the list: its place, its title, and its keys with their texts (empty if not set)."""

    place: TablePlace
    title: str
    texts: Mapping[str, str]


@router.get("/configuration")
async def configuration_page(
    request: Request,
    _: ConfigurationChanger,
    file: FileOfServer,
    restart: RestartOfServer,
) -> Response:
    """Show the tables of the file, its faults, its newest versions, and at its row what was just written."""
    try:
        present = await file.present()
    except Problem as problem:
        return render(request, "configuration/none.html", problem=problem)
    data = present.data
    shown: dict[str, list[ShownTable]] = {form.kind: [] for form in FORMS}
    for place in places_of(data):
        shown[place.form.kind].append(ShownTable(place, title_of(place, data), texts_of(place, data)))
    result = result_of(request)
    page = render(
        request,
        "configuration/page.html",
        path_of_file=file.path,
        present=present,
        waiting=await asyncio.to_thread(file.waiting, present),
        shown=shown,
        new={form.kind: end_of(form, data).name for form in FORMS if form.is_listed and len(form.path) < 5},
        duties=[(end_of(_DUTY, data, group.place.path).name, group.title) for group in shown["group"]],
        buses=buses_of(present),
        versions=await file.versions(),
        done=result.get("version"),
        changed=(result.get("changed", ""), result.get("field", "")),
        words=_WORDS,
        defaults=DEFAULTS,
        can_restart=restart.is_offered and not present.faults,
        restarting="restarting" in result,
    )
    return shown_once(request, page)


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
    """Review the typed values; with ``confirmed`` write them, with ``again`` show them in the form once more.
    If the file was changed meanwhile, show its present values with the typed ones."""
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
    if _text_in(form, "again"):
        return _form(request, place, present, texts)
    if kind == "up" and changes_of(place, present.data, texts):
        return _form(request, place, present, texts, fault=Message("configuration_moved_alone"))
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
    if kind != "change":
        return _written(request, version.number)
    first = next(iter(changes_of(place, present.data, texts)))
    return _written(request, version.number, place.name, first if place.form.kind in DEFAULTS else "")


def _written(request: Request, version: int, place: str = "", field: str = "") -> Response:
    """Return to the list, at the row of the changed table, bus or ``field``."""
    return send_to(request, "/configuration", version=str(version), changed=place, field=field)


@router.get("/configuration/versions/{number}")
async def configuration_version_page(
    request: Request, _: ConfigurationChanger, file: FileOfServer, number: int
) -> Response:
    """Show the changes from a version to the present file."""
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
    """Review the way back to a version; with ``confirmed`` write it as a new version."""
    stored, present = await file.version(number), await file.present()
    review = await file.review(lambda _: stored.text, digest)
    if confirmed and not review.faults:
        saved = await file.save(person, ROLL_BACK, lambda _: stored.text, digest, reason_of_change)
        return _written(request, saved.number)
    return review_page(request, file, present, review, f"/configuration/versions/{number}/roll-back", {})


@router.post("/configuration/restart")
async def restart_server_page(
    request: Request,
    person: Restarter,
    restart: RestartOfServer,
    digest: Digest = "",
    reason_of_change: ReasonOfChange = "",
) -> Response:
    """Restart with the lines that the page has shown."""
    await restart.request(person, digest, reason_of_change)
    return send_to(request, "/configuration", restarting="yes")


def review_page(
    request: Request,
    file: ConfigurationFile,
    present: PresentFile,
    review: ConfigurationReview,
    action: str,
    fields: Mapping[str, str],
) -> Response:
    """Show the file as it would become; confirming posts ``fields`` to ``action`` again."""
    shown = masked(review.text)
    return render(
        request,
        "configuration/review.html",
        part=is_fragment(request),
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
    wanted = next(iter(errors), "") if errors else request.query_params.get("field", "")
    return render(
        request,
        "configuration/table.html",
        part=is_fragment(request),
        focused=wanted or place.form.fields[0].key,
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
    """Show the typed values on top of the present file; values not typed here come from the file."""
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
            request,
            "configuration/moved.html",
            part=is_fragment(request),
            status=409,
            message=message,
            lines=lines,
            typed=changed,
        )
    texts = {**texts_of(now, present.data), **changed}
    return _form(request, now, present, texts, fault=message, lines=lines, status=409)


def _faults_by_field(
    place: TablePlace, review: ConfigurationReview
) -> tuple[dict[str, Message], tuple[Message, ...]]:
    """Return the faults by key of the form, and the other faults with their line."""
    lines = {each.first: each.paths for each in statements(review.text) if not each.is_header}
    errors, others = {}, []
    for fault in review.faults:
        paths = lines.get(int(str(fault.params.get("line", 0))), ())
        keys = [field.key for field in place.form.fields if (*place.path, *field.key.split(".")) in paths]
        inner = _inner(fault)
        if keys and inner is not fault:
            errors[keys[0]] = _right_of(inner)
        else:
            others.append(inner)
    return errors, tuple(others)


_COMMA = re.compile(r"^(-?\d+),(\d{1,2}|\d{4,})$")


def _typed(request: Request, place: TablePlace, form: FormData) -> dict[str, str]:
    """Return the typed values by key. A field with several choices has each chosen one, a band its limits; a
    number may have a decimal comma in every language, but for three digits after it, which are thousands in
    some."""
    templates = templates_of(request)
    formats: Formats = templates.formats(templates.language_of(request).tag)
    texts = {}
    for field in place.form.fields:
        given = [value.strip() for value in form.getlist(field.key) if isinstance(value, str)]
        if field.kind in ("number", "band"):
            given = [_COMMA.sub(r"\1.\2", formats.typed_number(value)) for value in given]
        texts[field.key] = ", ".join(given) if any(given) else ""
    return texts


def buses_of(present: PresentFile) -> list[dict[str, Any]]:
    """Return the buses of the file."""
    buses = at(present.data, ("bus",))
    return [bus for bus in buses if isinstance(bus, dict)] if isinstance(buses, list) else []


def _text_in(form: FormData, key: str) -> str:
    value = form.get(key, "")
    return value if isinstance(value, str) else ""


bus_router = APIRouter(prefix="/configuration/bus", include_in_schema=False, route_class=GuardedRoute)

MAX_UNITS_TEXT = 20_000
_DEFAULTS = {"baud": BusSettings.model_fields["baud"].default}
"""The defaults of keys that the form always has: a file without such a key stays so."""
_UNIT = re.compile(r"(\d{1,3})[\s,;:.]+(\S.*)")
Changer = Annotated[Person, CHANGE_PORTS.permitted]
Scan = Annotated[PortScan, service(PortScan)]
Short = Annotated[str, Form(max_length=200)]
Index = Annotated[int, Path(ge=0, le=999)]


@bus_router.get("/{index}")
async def bus_page(request: Request, _: Changer, file: FileOfServer, scan: Scan, index: Index) -> Response:
    """Show the form of a bus; the index after the last one is a new bus."""
    present = await file.present()
    return _bus_form(request, present, scan, index, _texts_of(present, scan, index))


@bus_router.post("/{index}/scan")
async def scan_port(
    _: Changer, file: FileOfServer, scan: Scan, index: Index, act: Short, port: Short = ""
) -> Response:
    """Begin a scan of a port, or end it. The page shows why a scan is refused."""
    present, port = await file.present(), port.strip()
    if act == "stop":
        await scan.stop()
    elif port in _ports_of(present):
        scan.refuse(port, Message.of("port_of_bus", port=port))
    else:
        try:
            check_port(port)
        except ValueError as error:
            scan.refuse(port, error.args[0])
        else:
            scan.start(port)
    return RedirectResponse(f"/configuration/bus/{index}", SEE_OTHER)


@bus_router.get("/{index}/scan")
async def scan_state(_: Changer, scan: Scan, index: Index) -> Response:
    """Send the page to the results once the scan has ended."""
    if scan.is_running:
        return Response(status_code=204)
    return Response(headers={"HX-Redirect": f"/configuration/bus/{index}"})


@bus_router.post("/{index}")
async def change_bus(
    request: Request,
    person: Changer,
    file: FileOfServer,
    scan: Scan,
    index: Index,
    name: Short = "",
    port: Short = "",
    baud: Short = "",
    units: Annotated[str, Form(max_length=MAX_UNITS_TEXT)] = "",
    digest: Digest = "",
    confirmed: Annotated[str, Form(max_length=10)] = "",
    again: Annotated[str, Form(max_length=10)] = "",
    reason_of_change: ReasonOfChange = "",
) -> Response:
    """Review the typed bus; with ``confirmed`` write it, with ``again`` show it in the form once more."""
    texts = {"name": name.strip(), "port": port.strip(), "baud": baud, "units": units}
    present = await file.present()
    _refuse_beyond(present, index)
    if again:
        return _bus_form(request, present, scan, index, texts)
    try:
        listed = units_typed(units)
    except CallerError as error:
        return _bus_form(request, present, scan, index, texts, errors={"units": error.message})
    try:
        edit = bus_edit(index, _values(texts, scan), listed)
        review = await file.review(edit, digest)
    except CallerError as error:
        return _bus_form(request, present, scan, index, texts, (error.message,))
    except Problem as problem:
        if problem.code != "superseded":
            raise
        return _bus_form(request, present, scan, index, texts, (problem.message,), status=409)
    if review.faults or review.text == present.text:
        faults = review.faults or (Message("configuration_nothing_changed"),)
        inner = {str(each.params.get("key", each.code)): each for each in map(_inner, faults)}
        errors = {key: _right_of(inner.pop(f"bus.{key}")) for key in texts if f"bus.{key}" in inner}
        of_units = [inner.pop(key) for key in tuple(inner) if key.startswith("bus.unit.")]
        if of_units:
            errors["units"] = Message.of("unit_line_refused", **of_units[0].params)
        return _bus_form(request, present, scan, index, texts, tuple(inner.values()), errors=errors)
    if not confirmed:
        return review_page(request, file, present, review, f"/configuration/bus/{index}", texts)
    version = await file.save(person, CHANGE_PORTS, edit, digest, reason_of_change)
    return _written(request, version.number, f"bus.{index}")


def bus_edit(index: int, values: Mapping[str, TomlValue], units: list[tuple[int, str]]) -> Edit:
    """Return the edit that gives a bus these values and units: a unit whose address is no longer listed is
    removed, a new unit comes after the last."""

    def edit(text: str) -> str:
        bus = at(tomllib.loads(text), ("bus", index)) or {}
        changes = {key: value for key, value in values.items() if bus.get(key, _DEFAULTS.get(key)) != value}
        text = with_values(text, ("bus", index), changes) if changes else text
        wanted, present = dict(units), [unit.get("id") for unit in bus.get("unit", [])]
        for place in reversed(range(len(present))):
            if present[place] not in wanted:
                text = without(text, ("bus", index, "unit", place))
                del present[place]
        for address, name in units:
            if address not in present:
                text = with_values(text, ("bus", index, "unit", len(present)), {"id": address, "name": name})
                present.append(address)
            elif at(tomllib.loads(text), (*(path := _unit(index, present, address)), "name")) != name:
                text = with_values(text, path, {"name": name})
        return text

    return edit


def units_typed(text: str) -> list[tuple[int, str]]:
    """Return address and name of each line that is not empty. Raise CallerError for a line without both, and
    for a repeated address."""
    found: dict[int, str] = {}
    for line in filter(None, map(str.strip, text.splitlines())):
        match = _UNIT.fullmatch(line)
        if match is None or int(match[1]) in found:
            code = "unit_line_malformed" if match is None else "unit_line_repeated"
            raise CallerError(Message.of(code, line=line[:80]))
        found[int(match[1])] = match[2].strip()
    return list(found.items())


def _unit(index: int, present: list[int], address: int) -> tuple[str | int, ...]:
    return ("bus", index, "unit", present.index(address))


def _inner(fault: Message) -> Message:
    """Return a fault of the file without the number of its line."""
    inner = fault.params.get("fault")
    return inner if isinstance(inner, Message) else fault


def _right_of(fault: Message) -> Message:
    """Return what is right, without the key and value of the file, which stand in the field."""
    right = fault.params.get("right")
    return right if isinstance(right, Message) else fault


def _values(texts: Mapping[str, str], scan: PortScan) -> dict[str, TomlValue]:
    """Return the typed values with the settings that a scan of this port has shown."""
    found = scan.found if scan.found is not None and scan.port == texts["port"] else {}
    settings = {key: value for key, value in found.items() if key != "unit"}
    baud = int(texts["baud"]) if texts["baud"].isdecimal() else texts["baud"]
    return {**settings, "name": texts["name"], "port": texts["port"], "baud": baud}


def _ports_of(present: PresentFile) -> list[str]:
    return [str(bus.get("port")) for bus in buses_of(present)]


def _refuse_beyond(present: PresentFile, index: int) -> None:
    if index > len(buses_of(present)):
        raise Problem(404, "not_found", Message.of("configuration_no_table", name=f"bus.{index}"))


def _texts_of(present: PresentFile, scan: PortScan, index: int) -> dict[str, str]:
    """Return the texts of the form; for a new bus the next name, and the results of the scan."""
    buses = buses_of(present)
    names = {bus.get("name") for bus in buses}
    new = {"name": next(f"line-{n}" for n in range(1, len(names) + 2) if f"line-{n}" not in names)}
    bus = buses[index] if index < len(buses) else {**(scan.found or {}), **new, "port": scan.port}
    units = "\n".join(f"{unit.get('id')} {unit.get('name')}" for unit in bus.get("unit", []))
    return {
        "name": str(bus.get("name", "")),
        "port": str(bus.get("port", "")),
        "baud": str(bus.get("baud", _DEFAULTS["baud"])),
        "units": units,
    }


def _bus_form(
    request: Request,
    present: PresentFile,
    scan: PortScan,
    index: int,
    texts: Mapping[str, str],
    faults: tuple[Message, ...] = (),
    status: int = 422,
    errors: Mapping[str, Message] | None = None,
) -> Response:
    _refuse_beyond(present, index)
    taken = _ports_of(present)
    return render(
        request,
        "configuration/bus.html",
        part=is_fragment(request),
        status=status if faults or errors else 200,
        action=f"/configuration/bus/{index}",
        is_new=index == len(taken),
        digest=present.digest,
        faults=(*present.faults, *faults),
        errors=errors or {},
        texts=texts,
        scan=scan,
        ports=[port for port in ports() if port not in taken],
        bauds=[(str(each), str(each)) for each in sorted(BAUDS, reverse=True)],
    )


def make(services: Services) -> None:
    settings = services.settings
    store = VersionStore(settings.server.data)
    file = services.add(ConfigurationFile(settings, store, services[EventLog]))
    services.add(Restart(file, services[EventLog]))
    scan = services.add(PortScan())
    services.lifespan.add("configuration", start=file.begin, end=scan.stop)


FEATURE = Feature(make, (api.router, router, bus_router), ACTS)
