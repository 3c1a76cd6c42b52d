"""The page of the site's own alarms: those configured, and a simulation of another."""

from __future__ import annotations

from typing import Annotated, Any, get_args

from fastapi import APIRouter, Depends, Query
from starlette.requests import Request
from starlette.responses import Response

from app.alarm_settings import AlarmSettings, OwnValue
from app.alarms.api import Alarms
from app.alarms.line_alarms import LineAlarms
from app.alarms.rules.performance import DAY_S
from app.alarms.simulation.api import SimulatorOf
from app.alarms.simulation.outcome import Simulated
from app.alarms.simulation.proposal import in_toml, proposed
from app.errors import Problem
from app.history.api.spans import HistoryOf
from app.settings import Settings
from app.web.access import Engineer
from app.web.services import service
from app.web.shape import parse_integer
from app.web.templating import render, templates_of
from bus.instants import unix_now
from bus.messages import Message

router = APIRouter(include_in_schema=False)

SPANS = (1, 7, 31)
_NUMBERS = ("above", "below", "deadband", "change_per_s")
_DELAYS = ("on_delay_s", "off_delay_s")
SettingsOf = Annotated[Settings, service(Settings)]
WrittenField = Annotated[str, Query(max_length=80)]


async def written_alarm(
    name: WrittenField = "",
    place: WrittenField = "",
    value: WrittenField = "actual",
    above: WrittenField = "",
    below: WrittenField = "",
    deadband: WrittenField = "",
    change_per_s: WrittenField = "",
    state: WrittenField = "",
    on_delay_s: WrittenField = "",
    off_delay_s: WrittenField = "",
    priority: WrittenField = "medium",
    days: WrittenField = "7",
) -> dict[str, str]:
    """The form as it was filled in; without ``place``: not at all."""
    return {
        "name": name,
        "place": place,
        "value": value,
        "above": above,
        "below": below,
        "deadband": deadband,
        "change_per_s": change_per_s,
        "state": state,
        "on_delay_s": on_delay_s,
        "off_delay_s": off_delay_s,
        "priority": priority,
        "days": days if days in map(str, SPANS) else "7",
    }


@router.get("/alarms/own")
async def own_alarms_page(
    request: Request,
    person: Engineer,
    alarms: Alarms,
    simulator: SimulatorOf,
    history: HistoryOf,
    configured: SettingsOf,
    written: Annotated[dict[str, str], Depends(written_alarm)],
) -> Response:
    """The alarms of the configuration, the form, and what its alarm would have done."""
    fault: Message | None = None
    settings: AlarmSettings | None = None
    found: Simulated | None = None
    if written["place"]:
        try:
            settings = proposed(_keys(request, written), configured.bus)
        except Problem as problem:
            fault = problem.message
        else:
            end, bus = unix_now(), history.buses[settings.bus]
            start = end - int(written["days"]) * DAY_S
            found = await simulator.run(bus, settings, start, end, person.account)
    return render(
        request,
        "alarms/own.html",
        configured=[(each, _place(alarms, each)) for each in configured.alarm],
        places=_places(configured),
        values=get_args(OwnValue),
        spans=SPANS,
        written=written,
        fault=fault,
        found=found,
        toml=in_toml(settings) if settings else "",
        status=422 if fault else 200,
    )


def _places(configured: Settings) -> list[tuple[str, str]]:
    return [
        (f"{bus.name}/{unit.id}", f"{bus.name} · {unit.name}") for bus in configured.bus for unit in bus.unit
    ]


def _keys(request: Request, written: dict[str, str]) -> dict[str, Any]:
    """The keys of ``[[alarm]]``; a number may have the decimal comma of the reader."""
    formats = templates_of(request).formats(templates_of(request).language_of(request).tag)
    bus, _, unit = written["place"].partition("/")
    keys: dict[str, Any] = {
        "name": written["name"].strip() or "Proposed",
        "bus": bus,
        "unit": parse_integer(unit) or 0,
        "value": written["value"],
        "priority": written["priority"],
    }
    keys |= {key: formats.typed_number(written[key]) for key in _NUMBERS if written[key].strip()}
    keys |= {key: _delay(formats.typed_number(written[key])) for key in _DELAYS if written[key].strip()}
    return keys | ({"state": written["state"]} if written["state"] else {})


def _delay(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _place(alarms: LineAlarms, settings: AlarmSettings) -> str:
    return f"{settings.bus} · {alarms.place(settings.bus, settings.unit)}"
