"""The pages of alarms: the summary, the journal, the figures, and one alarm."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import timedelta
from typing import Annotated, Any, Literal, NamedTuple
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Form, Query
from pydantic import BaseModel, Field, StringConstraints
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.core.messages import Language
from app.core.messages.languages import day_begins
from app.core.web.access import Person, Viewer
from app.core.web.formats import UNKNOWN, Formats
from app.core.web.routes import SEARCH, GuardedRoute
from app.core.web.services import service_of
from app.core.web.templating import formats_of, render, templates_of
from app.errors import Problem
from app.line.alarms.acts import ACKNOWLEDGE, ALARM_ACTS, MAX_MINUTES, SILENCE_SOUNDING, AlarmAct
from app.line.alarms.alarm import Alarm, state_text
from app.line.alarms.api import Alarms, present_value
from app.line.alarms.journal import JournalEntry, JournalFilter
from app.line.alarms.line_alarms import LineAlarms, rank
from app.line.alarms.performance import AlarmFigure
from app.line.alarms.rules import PRESENT_STATES, AlarmState
from app.line.conditions.condition import GROUPS
from app.line.live.hub import Hub
from app.line.live.screen import ALARM_GROUP
from bus.instants import DAY_S, UnixTime, unix_now
from bus.messages import Message
from bus.validation import OneLine, TypedText

MAX_ROWS = 100
"""Rows of the summary: as many as can be acknowledged together."""


class AlarmRow(NamedTuple):
    """An alarm as a page shows it: with its place, its present value, and whether it came three times within
    a minute."""

    alarm: Alarm
    place: str
    value: Message | None
    chatters: bool


def _list_fields(
    alarms: LineAlarms,
    chosen: dict[str, str],
    now: UnixTime,
    shown: Sequence[str] = (),
    came: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the fields of the list of alarms. ``shown``: the keys of the rows that a person sees. These stay
    in their places, even if they match no longer, and new alarms come after them; ``came``: which of the rows
    came so since the list was sorted. They may be out of sight: what acknowledges all leaves them out."""
    known = (alarms.known(key) for key in shown)
    kept = dict.fromkeys(alarm for alarm in known if alarm is not None)
    new = [alarm for alarm in alarms.present() if alarm not in kept and _matches(alarm, chosen)]
    found = [*kept, *new]
    rows = [_row(alarms, alarm, now) for alarm in found[:MAX_ROWS]]
    late = {*came, *(alarm.definition.key for alarm in new)} if shown else set()
    waiting = [row for row in rows if row.alarm.is_unacknowledged]
    return {
        "rows": rows,
        "late": late,
        "waiting_late": [row for row in waiting if row.alarm.definition.key in late],
        "waiting": [row.alarm.id for row in waiting if row.alarm.definition.key not in late],
        "more": max(0, len(found) - MAX_ROWS),
        "query": _query(chosen),
        "is_filtered": any(chosen.values()),
        "is_sorted": found == sorted(found, key=rank),
        "flood": alarms.rates.flood(now),
    }


def _query(chosen: dict[str, str]) -> str:
    """Return the filters of a person as the query of a link."""
    return urlencode({name: value for name, value in chosen.items() if value})


def _matches(alarm: Alarm, chosen: dict[str, str]) -> bool:
    definition = alarm.definition
    bus, _, unit = chosen["place"].partition("/")
    return (
        chosen["state"] in ("", alarm.facts.state)
        and chosen["priority"] in ("", definition.priority)
        and chosen["group"] in ("", definition.about)
        and bus in ("", definition.bus)
        and unit in ("", str(definition.unit))
    )


def _row(alarms: LineAlarms, alarm: Alarm, now: UnixTime) -> AlarmRow:
    """Make the row of an alarm as it is now."""
    definition = alarm.definition
    place = alarms.place(definition.bus, definition.unit)
    chatters = alarms.rates.chatters(definition.key, now)
    return AlarmRow(alarm, place, present_value(alarms, alarm), chatters)


router = APIRouter(include_in_schema=False, route_class=GuardedRoute)

ON_A_PAGE = 100
MAX_FOUND = 5000
"""The most alarms that a search may find: their keys are values of one statement."""
AFTER: tuple[AlarmState, ...] = (
    "unack_active",
    "ack_active",
    "rtn_unack",
    "normal",
    "shelved",
    "suppressed",
    "out_of_service",
)
"""The states by which the journal is filtered."""
TypedFilter = Annotated[TypedText, Query(max_length=80)]


@router.get("/alarms/journal", dependencies=[SEARCH])
async def journal_page(
    request: Request,
    _: Viewer,
    alarms: Alarms,
    search: TypedFilter = "",
    place: TypedFilter = "",
    priority: TypedFilter = "",
    state: TypedFilter = "",
    day: TypedFilter = "",
    before: Annotated[int | None, Query(ge=1, le=2**62)] = None,
) -> Response:
    """Show the transitions that a person chose, newest first; ``day``: by the clock of the site."""
    zone, formats, now = templates_of(request).site.zone, formats_of(request), unix_now()
    bus, _slash, unit = place.partition("/")
    chosen = {"search": search.strip(), "place": place, "priority": priority, "state": state, "day": day}
    found = JournalFilter(
        alarms=_named(alarms, chosen["search"], templates_of(request).language_of(request)),
        bus=bus or None,
        unit=int(unit) if unit.isascii() and unit.isdecimal() and len(unit) < 4 else None,
        priority=priority or None,
        after=state or None,
        start=day_begins(formats.typed_time(day), zone),
        end=day_begins(formats.typed_time(day), zone, timedelta(days=1)),
    )
    fault = formats.malformed_day(day, now) if day and found.start is None else None
    chosen |= {"day": formats.field_day(found.start)} if found.start is not None else {}
    wanted = found if any(chosen.values()) else None
    entries = await alarms.store.journal(ON_A_PAGE + 1, before, chosen=wanted) if fault is None else []
    query = _query(chosen)
    older = f"before={entries[ON_A_PAGE - 1].id}" if len(entries) > ON_A_PAGE else ""
    return render(
        request,
        "alarms/journal.html",
        status=200 if fault is None else 422,
        fault=fault,
        days=[
            (text, f"/alarms/journal?{_query(chosen | {'day': first})}")
            for text, first, last in formats.recent_days(now)
            if first == last
        ],
        transitions=entries[:ON_A_PAGE],
        place_of=alarms.place,
        chosen=chosen,
        states=[(each, state_text(each)) for each in AFTER],
        places=alarms.places(),
        older="&".join(filter(None, (query, older))) if older else "",
        newest=query if before else None,
    )


def _named(alarms: LineAlarms, search: str, language: Language) -> list[str] | None:
    """Return the keys of the alarms whose place or name has each word of a search; None without a search."""
    words = search.casefold().split()
    if not words:
        return None
    names: dict[str, str] = {}
    found: list[str] = []
    for alarm in alarms.every():
        definition = alarm.definition
        name = names.setdefault(str(definition.name), language.t(definition.name))
        text = f"{alarms.place(definition.bus, definition.unit)} {name}".casefold()
        if all(word in text for word in words):
            found.append(definition.key)
    return found[:MAX_FOUND]


SEE_OTHER = 303
TypedReason = Annotated[OneLine, Form(max_length=200)]
ShownKeys = Sequence[Annotated[str, StringConstraints(max_length=200)]]


async def chosen_filters(
    state: TypedFilter = "", priority: TypedFilter = "", place: TypedFilter = "", group: TypedFilter = ""
) -> dict[str, str]:
    """Return the filters of a person; an empty text filters nothing."""
    return {"state": state, "priority": priority, "place": place, "group": group}


ChosenFilters = Annotated[dict[str, str], Depends(chosen_filters)]


@router.get("/alarms")
async def alarms_page(
    request: Request,
    _: Viewer,
    alarms: Alarms,
    chosen: ChosenFilters,
    left_out: Annotated[int, Query(ge=0, le=MAX_ROWS)] = 0,
) -> Response:
    """Show the present alarms, filtered. The list draws itself again when one changes."""
    screen = service_of(request, Hub).screen(templates_of(request).language_of(request).tag)
    return render(
        request,
        "alarms/page.html",
        **_list_fields(alarms, chosen, unix_now()),
        chosen=chosen,
        states=[(each, state_text(each)) for each in PRESENT_STATES],
        places=alarms.places(),
        groups=GROUPS,
        changed=screen.shown[ALARM_GROUP]["changed"],
        left_out=left_out,
    )


@router.get("/alarms/list")
async def alarms_list(
    request: Request,
    _: Viewer,
    alarms: Alarms,
    chosen: ChosenFilters,
    shown: Annotated[ShownKeys, Query(max_length=MAX_ROWS)] = (),
    came: Annotated[ShownKeys, Query(max_length=MAX_ROWS)] = (),
) -> Response:
    """Show only the rows of the list; alarms that are shown keep their places."""
    return _list(request, alarms, chosen, shown, came)


def _list(
    request: Request,
    alarms: LineAlarms,
    chosen: dict[str, str],
    shown: Sequence[str],
    came: Sequence[str],
    left_out: int = 0,
    acknowledged: int = 0,
) -> Response:
    return render(
        request,
        "alarms/_list.html",
        **_list_fields(alarms, chosen, unix_now(), shown, came),
        left_out=left_out,
        acknowledged=acknowledged,
    )


@router.get("/alarms/performance")
async def performance_page(
    request: Request, _: Viewer, alarms: Alarms, days: Literal["1", "7", "31"] = "7"
) -> Response:
    """Show the figures of the alarm system over the last days."""
    end, span_s = unix_now(), int(days) * DAY_S
    found = await alarms.measure(end - span_s, end)
    formats = templates_of(request).formats(templates_of(request).language_of(request).tag)
    span = urlencode({"from": formats.iso(end - span_s), "to": formats.iso(end)})
    return render(
        request,
        "alarms/performance.html",
        found=found,
        is_complete=found.covers(span_s),
        hours=(formats.number(found.observed_s / 3600, 1), formats.number(span_s / 3600)),
        days=int(days),
        spans=(1, 7, 31),
        csv=f"/api/v1/alarms/performance.csv?{span}",
        figures=[_figure(figure, formats, found.observed_s) for figure in found.figures],
        place_of=alarms.place,
    )


@router.get("/alarms/{alarm_id}")
async def one_page(request: Request, _: Viewer, alarms: Alarms, alarm_id: str) -> Response:
    """Show one alarm: its state, its record, its transitions, and what a person can do."""
    try:
        alarm = alarms.find(alarm_id).alarm
    except Problem as problem:
        if problem.code != "superseded":
            raise
        return RedirectResponse(f"/alarms/{problem.extra['id']}", SEE_OTHER)
    entries = await alarms.store.journal(ON_A_PAGE, alarm=alarm.definition.key)
    return render(
        request,
        "alarms/one.html",
        row=_row(alarms, alarm, unix_now()),
        record=alarm.definition.record,
        beside=_beside(alarms, alarm),
        transitions=entries,
        formerly_acknowledged=_formerly_acknowledged(alarm, entries),
        place_of=alarms.place,
    )


def _formerly_acknowledged(alarm: Alarm, entries: Iterable[JournalEntry]) -> JournalEntry | None:
    """Return the last acknowledgement of an occurrence that has to be acknowledged again. ``entries``: the
    newest first."""
    if alarm.again_since is None:
        return None
    occurrence = alarm.facts.occurrence
    return next(
        (each for each in entries if (each.occurrence, each.trigger) == (occurrence, "acknowledge")), None
    )


def _beside(alarms: LineAlarms, alarm: Alarm) -> list[Alarm]:
    """Return the other alarms of the same unit."""
    bus, unit = alarm.definition.bus, alarm.definition.unit
    if bus is None or unit is None:
        return []
    return [each for each in alarms.unit_alarms(bus, unit) if each is not alarm]


@router.post("/alarms/acknowledge")
async def acknowledge_shown(
    request: Request,
    person: Annotated[Person, ACKNOWLEDGE.permitted],
    alarms: Alarms,
    chosen: ChosenFilters,
    id: Annotated[list[str], Form(max_length=MAX_ROWS)],
    shown: Annotated[ShownKeys, Form(max_length=MAX_ROWS)] = (),
    came: Annotated[ShownKeys, Form(max_length=MAX_ROWS)] = (),
) -> Response:
    """Acknowledge the alarms that the person saw. An alarm that has changed since is left as it is, and the
    page reports it. A list keeps the places of its rows."""
    left_out = 0
    for alarm_id in id:
        try:
            await alarms.act(person, ACKNOWLEDGE, alarm_id)
        except Problem:
            left_out += 1
    if shown:
        response = _list(request, alarms, chosen, shown, came, left_out, len(id) - left_out)
        response.headers["HX-Retarget"], response.headers["HX-Reswap"] = "#alarms", "innerMorph"
        return response
    query = _query(chosen | ({"left_out": str(left_out)} if left_out else {}))
    return RedirectResponse(f"/alarms?{query}", SEE_OTHER)


@router.post("/alarms/silence")
async def silence_sounding(
    person: Annotated[Person, SILENCE_SOUNDING.permitted],
    alarms: Alarms,
    until: Annotated[float, Form(allow_inf_nan=False)],
) -> Response:
    """Silence the alarms that sounded at the press, and none that came since."""
    await alarms.silence_sounding(person, UnixTime(until))
    return Response(status_code=204)


class WrittenAct(BaseModel):
    """The form of an act as it was filled in."""

    reason: Annotated[OneLine, Field(max_length=200)] = ""
    minutes: Annotated[int, Field(ge=1, le=MAX_MINUTES)] = 30


def _add_form(act: AlarmAct) -> None:
    async def perform(
        alarms: Alarms, alarm_id: str, written: Annotated[WrittenAct, Form()], person: Person = act.permitted
    ) -> Response:
        fields = written.model_dump(include=set(act.body.model_fields))
        if act.hides:
            given_reason(written.reason)
        await alarms.act(person, act, alarm_id, act.body.model_validate(fields))
        return RedirectResponse(f"/alarms/{alarm_id}", SEE_OTHER)

    router.post(f"/alarms/{{alarm_id}}/{act.path}", name=act.name)(perform)


for alarm_act in ALARM_ACTS:
    if alarm_act is not ACKNOWLEDGE:
        _add_form(alarm_act)


def given_reason(reason: str) -> str:
    """Return a reason without the blanks around it. Raise Problem 422 for a blank one."""
    if not reason.strip():
        raise Problem(422, "invalid", Message("alarm_needs_reason"))
    return reason.strip()


def _figure(
    figure: AlarmFigure, formats: Formats, observed_s: float
) -> tuple[Message, str, str, bool | None]:
    """Return the name, the value and the target of a figure as the page shows them, and whether the target is
    met. A figure per day is not known before a day was observed."""

    def shown(value: float | None) -> str:
        if value is None:
            return UNKNOWN
        if figure.code.endswith("share") or figure.code == "windows_over_10":
            return f"{formats.number(100 * value, 1)} %"
        if figure.code.endswith("_s"):
            return f"{formats.number(value)} s"
        return formats.number(value, 2 if figure.code == "per_10_minutes" else 0)

    if figure.at_most is not None:
        target = f"≤ {shown(figure.at_most)}"
    else:
        target = "" if figure.at_least is None else f"≥ {shown(figure.at_least)}"
    if figure.code == "per_day" and observed_s < DAY_S:
        return Message("alarm_figure_per_day_of_less"), UNKNOWN, target, None
    return Message(f"alarm_figure_{figure.code}"), shown(figure.value), target, figure.met
