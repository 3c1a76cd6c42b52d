"""The pages of alarms: the summary, one alarm, the journal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Form, Query
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.alarms.alarm import Alarm
from app.alarms.api import MOST_MINUTES, Alarms
from app.alarms.group import GROUPS, group_of
from app.alarms.line_alarms import LineAlarms
from app.alarms.performance import measure
from app.alarms.rules.performance import DAY_S, Figure
from app.alarms.rules.states import PRESENT_STATES
from app.alarms.shown import present_value, recorded_name
from app.alarms.store import JournalEntry
from app.errors import Problem
from app.live.browsers.hub import Hub
from app.live.screen.screen import ALARM_GROUP
from app.web.access import Engineer, Operator, Viewer
from app.web.formats import UNKNOWN, Formats
from app.web.services import service_of
from app.web.templating import render, templates_of
from bus.instants import UnixTime, unix_now
from bus.messages import Message
from bus.text import OneLine

router = APIRouter(include_in_schema=False)

MOST_ROWS = 100
"""In the summary: as many as are acknowledged together at most."""
ON_A_PAGE = 100
SEE_OTHER = 303
TypedReason = Annotated[OneLine, Form(max_length=200)]
AlarmFilter = Annotated[str, Query(max_length=80)]


async def chosen_filters(
    state: AlarmFilter = "", priority: AlarmFilter = "", place: AlarmFilter = "", group: AlarmFilter = ""
) -> dict[str, str]:
    """What a person filters by; empty: by nothing."""
    return {"state": state, "priority": priority, "place": place, "group": group}


ChosenFilters = Annotated[dict[str, str], Depends(chosen_filters)]


@dataclass(frozen=True, slots=True)
class AlarmRow:
    """One alarm as a page shows it."""

    id: str
    name: str | Message
    bus: str | None
    unit: int | None
    place: str
    priority: str
    code_of_state: str
    state: Message
    waiting: bool
    sounds: bool
    silenced: bool
    since: UnixTime | None
    unknown_since: UnixTime | None
    shelved_until: UnixTime | None
    value: Message | None
    first_out: bool
    hidden_by: str
    reason: str


@dataclass(frozen=True, slots=True)
class TransitionRow:
    """One transition as a page shows it."""

    at: UnixTime
    name: str | Message
    place: str
    priority: str
    before: Message
    after: Message
    who: str
    reason: str


@dataclass(frozen=True, slots=True)
class FigureRow:
    """One figure as the page shows it."""

    name: Message
    value: str
    target: str
    met: bool | None


@dataclass(frozen=True, slots=True)
class FrequentRow:
    """One of the most frequent alarms."""

    name: str | Message
    place: str
    times: int


@router.get("/alarms")
async def alarms_page(
    request: Request,
    _: Viewer,
    alarms: Alarms,
    chosen: ChosenFilters,
    left_out: Annotated[int, Query(ge=0, le=MOST_ROWS)] = 0,
) -> Response:
    """The present alarms, filtered; the list draws itself again when one changes."""
    screen = service_of(request, Hub).screen(templates_of(request).language_of(request).tag)
    return render(
        request,
        "alarms/page.html",
        **_listed(alarms, chosen),
        chosen=chosen,
        query=urlencode(chosen),
        states=[(each, _state(each)) for each in PRESENT_STATES],
        places=_places(alarms),
        groups=GROUPS,
        changed=screen.shown[ALARM_GROUP]["changed"],
        left_out=left_out,
    )


@router.get("/alarms/list")
async def alarms_list(request: Request, _: Viewer, alarms: Alarms, chosen: ChosenFilters) -> Response:
    """The rows alone."""
    return render(request, "alarms/_list.html", **_listed(alarms, chosen))


@router.get("/alarms/journal")
async def journal_page(
    request: Request, _: Viewer, alarms: Alarms, before: Annotated[int | None, Query(ge=1, le=2**62)] = None
) -> Response:
    """Every transition, newest first."""
    entries = await alarms.store.journal(ON_A_PAGE + 1, before)
    return render(
        request,
        "alarms/journal.html",
        transitions=[_transition(alarms, entry) for entry in entries[:ON_A_PAGE]],
        older=entries[ON_A_PAGE - 1].id if len(entries) > ON_A_PAGE else None,
        before=before,
    )


@router.get("/alarms/performance")
async def performance_page(
    request: Request, _: Viewer, alarms: Alarms, days: Literal["1", "7", "31"] = "7"
) -> Response:
    """The figures of the alarm system over the last days."""
    end = unix_now()
    found = await measure(alarms, end - int(days) * DAY_S, end)
    formats = templates_of(request).formats(templates_of(request).language_of(request).tag)
    span = urlencode({"from": formats.iso(end - int(days) * DAY_S), "to": formats.iso(end)})
    return render(
        request,
        "alarms/performance.html",
        found=found,
        hours=(formats.number(found.observed_s / 3600, 1), formats.number(found.span_s / 3600)),
        days=int(days),
        spans=(1, 7, 31),
        csv=f"/api/v1/alarms/performance.csv?{span}",
        figures=[_figure(figure, formats) for figure in found.figures],
        frequent=[
            FrequentRow(
                recorded_name(each.alarm, each.code, each.name), alarms.place(each.bus, each.unit), each.times
            )
            for each in found.most_frequent
        ],
    )


@router.get("/alarms/{alarm_id}")
async def one_page(request: Request, _: Viewer, alarms: Alarms, alarm_id: str) -> Response:
    """One alarm: its state, its record, its transitions, and what a person can do."""
    try:
        alarm = alarms.find(alarm_id).alarm
    except Problem as problem:
        if problem.code != "superseded":
            raise
        return RedirectResponse(f"/alarms/{problem.extra['id']}", SEE_OTHER)
    entries = await alarms.store.journal_of(alarm.definition.key, ON_A_PAGE)
    return render(
        request,
        "alarms/one.html",
        row=_row(alarms, alarm),
        record=alarm.definition.record,
        transitions=[_transition(alarms, entry) for entry in entries],
    )


@router.post("/alarms/acknowledge")
async def acknowledge_shown(
    person: Operator,
    alarms: Alarms,
    id: Annotated[list[str], Form(max_length=MOST_ROWS)],
    back: Annotated[str, Form(max_length=300)] = "",
) -> Response:
    """Those that the person saw. One that has changed since is left as it is, and the page reports it."""
    left_out = 0
    for alarm_id in id:
        try:
            await alarms.acknowledge(person, alarm_id)
        except Problem:
            left_out += 1
    query = f"{back}&left_out={left_out}" if left_out else back
    return RedirectResponse(f"/alarms?{query}", SEE_OTHER)


@router.post("/alarms/silence")
async def silence_sounding(
    person: Operator, alarms: Alarms, until: Annotated[float, Form(allow_inf_nan=False)]
) -> Response:
    """Those that sounded at the press: not one that came since."""
    await alarms.silence_sounding(person, UnixTime(until))
    return Response(status_code=204)


@router.post("/alarms/{alarm_id}/silence")
async def silence(person: Operator, alarms: Alarms, alarm_id: str) -> Response:
    """End its sound."""
    await alarms.silence(person, alarm_id)
    return _to(alarm_id)


@router.post("/alarms/{alarm_id}/reset")
async def reset(person: Operator, alarms: Alarms, alarm_id: str) -> Response:
    """End a latch."""
    await alarms.reset(person, alarm_id)
    return _to(alarm_id)


@router.post("/alarms/{alarm_id}/shelve")
async def shelve(
    person: Operator,
    alarms: Alarms,
    alarm_id: str,
    minutes: Annotated[int, Form(ge=1, le=MOST_MINUTES)],
    reason: TypedReason = "",
) -> Response:
    """Hide it for a time."""
    await alarms.shelve(person, alarm_id, given_reason(reason), minutes)
    return _to(alarm_id)


@router.post("/alarms/{alarm_id}/unshelve")
async def unshelve(person: Operator, alarms: Alarms, alarm_id: str) -> Response:
    """Annunciate it again."""
    await alarms.unshelve(person, alarm_id)
    return _to(alarm_id)


@router.post("/alarms/{alarm_id}/out-of-service")
async def remove(person: Engineer, alarms: Alarms, alarm_id: str, reason: TypedReason = "") -> Response:
    """Take it out of service."""
    await alarms.remove(person, alarm_id, given_reason(reason))
    return _to(alarm_id)


@router.post("/alarms/{alarm_id}/in-service")
async def return_to_service(person: Engineer, alarms: Alarms, alarm_id: str) -> Response:
    """Return it to service."""
    await alarms.return_(person, alarm_id)
    return _to(alarm_id)


def given_reason(reason: str) -> str:
    """Raises Problem 422 where it is blank."""
    if not reason.strip():
        raise Problem(422, "invalid", Message("alarm_needs_reason"))
    return reason.strip()


def _to(alarm_id: str) -> Response:
    return RedirectResponse(f"/alarms/{alarm_id}", SEE_OTHER)


def _listed(alarms: LineAlarms, chosen: dict[str, str]) -> dict[str, Any]:
    found = [alarm for alarm in alarms.present() if _matches(alarm, chosen)]
    rows = [_row(alarms, alarm) for alarm in found[:MOST_ROWS]]
    return {
        "rows": rows,
        "waiting": [row.id for row in rows if row.waiting],
        "more": max(0, len(found) - MOST_ROWS),
        "back": urlencode(chosen),
        "is_filtered": any(chosen.values()),
    }


def _matches(alarm: Alarm, chosen: dict[str, str]) -> bool:
    definition = alarm.definition
    bus, _, unit = chosen["place"].partition("/")
    filters: tuple[tuple[str, Callable[[], object]], ...] = (
        (chosen["state"], lambda: alarm.facts.state),
        (chosen["priority"], lambda: definition.priority),
        (chosen["group"], lambda: group_of(definition)),
        (bus, lambda: definition.bus),
        (unit, lambda: str(definition.unit)),
    )
    return all(not wanted or wanted == value() for wanted, value in filters)


def _places(alarms: LineAlarms) -> list[tuple[str, str]]:
    """Each bus and each of its units."""
    places: list[tuple[str, str]] = []
    for name, bus in alarms.buses.items():
        places.append((name, name))
        places += [(f"{name}/{unit}", f"{name} · {text}") for unit, text in bus.unit_names().items()]
    return places


def _row(alarms: LineAlarms, alarm: Alarm) -> AlarmRow:
    definition, facts = alarm.definition, alarm.facts
    by_person = facts.state in ("shelved", "out_of_service")
    return AlarmRow(
        id=alarm.id,
        name=definition.name,
        bus=definition.bus,
        unit=definition.unit,
        place=alarms.place(definition.bus, definition.unit),
        priority=definition.priority,
        code_of_state=facts.state,
        state=_state(facts.state),
        waiting=alarm.is_unacknowledged,
        sounds=facts.sounds,
        silenced=facts.silenced,
        since=facts.since,
        unknown_since=facts.unknown_since,
        shelved_until=facts.shelved_until,
        value=present_value(alarms, alarm),
        first_out=alarm.first_out,
        hidden_by=alarm.hidden_by if by_person else "",
        reason=alarm.reason if by_person else "",
    )


def _transition(alarms: LineAlarms, entry: JournalEntry) -> TransitionRow:
    return TransitionRow(
        at=entry.at,
        name=recorded_name(entry.alarm, entry.code, entry.name),
        place=alarms.place(entry.bus, entry.unit),
        priority=entry.priority,
        before=_state(entry.before),
        after=Message("alarm_silenced") if entry.trigger == "silence" else _state(entry.after),
        who=entry.who,
        reason=entry.reason,
    )


def _figure(figure: Figure, formats: Formats) -> FigureRow:
    name = Message(f"alarm_figure_{figure.code}")

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
    return FigureRow(name, shown(figure.value), target, figure.is_met)


def _state(state: str) -> Message:
    return Message(f"alarm_state_{state}")
