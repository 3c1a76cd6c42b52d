"""The site's own alarms over HTTP: listed, simulated over stored history, added, changed and removed."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query
from pydantic import ConfigDict, Field
from typing_extensions import TypedDict

from app.core.web.admission.access import Engineer, Person
from app.core.web.api.route import ApiRoute, RequestKey
from app.core.web.api.shape import InstantObject, StrictBody, ZonedTime
from app.core.web.services import service
from app.line.alarms.acts import ADD_OWN, CHANGE_OWN, REMOVE_OWN, ActReason, Comment
from app.line.alarms.alarm import own_key
from app.line.alarms.api import AlarmPriorityShown
from app.line.alarms.journal.performance import month_at_most
from app.line.alarms.own.book import OwnAlarm, OwnAlarmBook, OwnAlarmLeftAside
from app.line.alarms.own.definition import proposed
from app.line.alarms.settings import AlarmSettings, OwnValue
from app.line.alarms.simulation.replay import AlarmSimulation
from app.line.alarms.simulation.simulator import Simulator
from app.line.conditions.priority import AlarmPriority
from app.line.history.spans import HistoryOf

router = APIRouter(prefix="/api/v1/alarms", tags=["alarms"], route_class=ApiRoute)

OwnBook = Annotated[OwnAlarmBook, service(OwnAlarmBook)]
OwnAlarmKey = Annotated[str, Path(max_length=200, description="The `id` of the list.")]
WrittenText = Annotated[str, Field(max_length=300)]
Version = Annotated[int, Field(ge=1, le=2**62, description="That the change was made from.")]
SimulatorOf = Annotated[Simulator, service(Simulator)]
WrittenLimit = Annotated[str | int | float, Field(description='As the unit displays it: "80.0" or 80.')]
WrittenDelay = Annotated[float | int, Field(description="Seconds, up to a day.")]


class OwnAlarmRequest(StrictBody):
    """An alarm as ``[[alarm]]`` of lineside.toml has it."""

    model_config = ConfigDict(str_strip_whitespace=True)

    name: Annotated[str, Field(max_length=200)]
    bus: Annotated[str, Field(max_length=80)]
    unit: Annotated[int, Field(description="Address of the unit (#17), 1 to 255.")]
    value: OwnValue
    above: WrittenLimit | None = None
    below: WrittenLimit | None = None
    deadband: WrittenLimit = 0
    change_per_s: WrittenLimit | None = None
    state: Annotated[str | None, Field(description="on or off, for an input or an output.")] = None
    on_delay_s: WrittenDelay = 0
    off_delay_s: WrittenDelay = 0
    priority: AlarmPriority = "medium"
    latch: bool = False
    realarm_s: WrittenDelay | None = None
    cause: WrittenText = ""
    consequence: WrittenText = ""
    response: WrittenText = ""

    def written(self) -> dict[str, Any]:
        """The keys of ``[[alarm]]`` that were given."""
        beside = {"since", "until", "version", "reason"}
        return self.model_dump(exclude_unset=True, exclude_none=True, exclude=beside)


class AlarmSimulationRequest(OwnAlarmRequest):
    """An alarm as ``[[alarm]]`` of lineside.toml has it, and a span; the last week by default."""

    model_config = ConfigDict(populate_by_name=True)

    name: Annotated[str, Field(max_length=200)] = "New alarm"
    since: Annotated[ZonedTime | None, Field(alias="from", strict=False)] = None
    until: Annotated[ZonedTime | None, Field(alias="to", strict=False)] = None


class OwnAlarmChangeRequest(OwnAlarmRequest):
    """The new definition; name, bus and unit stay."""

    version: Version
    reason: Comment = ""


class OwnAlarmShown(AlarmSettings):
    """One of them, with the keys of ``[[alarm]]``."""

    model_config = ConfigDict(extra="ignore", json_schema_serialization_defaults_required=True)

    priority: AlarmPriorityShown
    id: Annotated[str, Field(description="With its occurrence after a dot it is the id of an alarm.")]
    origin: Annotated[
        Literal["configuration", "page"], Field(description="Only those of the page are changed here.")
    ]
    version: Annotated[int | None, Field(description="Another one after each change; null: configuration.")]
    changed_by: Annotated[str | None, Field(description="null: configuration.")]
    changed_at: Annotated[InstantObject | None, Field(description="ISO 8601 in UTC; null: configuration.")]


class OwnAlarmsShown(TypedDict):
    """Those of the configuration, those that were added, and those that do not fit."""

    alarms: list[OwnAlarmShown]
    left_aside: list[OwnAlarmLeftAside]


@router.get("/own")
async def get_own_alarms(_: Engineer, own: OwnBook) -> OwnAlarmsShown:
    """The alarms of the site, with their origin."""
    return {
        "alarms": [own_alarm_shown(*each) for each in own.every()],
        "left_aside": list(own.left_aside.values()),
    }


@router.post("/own", status_code=201)
async def add_own_alarm(
    person: Annotated[Person, ADD_OWN.permitted],
    own: OwnBook,
    body: OwnAlarmRequest,
    key: RequestKey = None,
) -> OwnAlarmShown:
    """Add an alarm. It is detected from the next reading on."""
    added = await own.add(person, body.written(), key)
    return own_alarm_shown(added.settings, added)


@router.put("/own/{own_id}")
async def change_own_alarm(
    person: Annotated[Person, CHANGE_OWN.permitted],
    own: OwnBook,
    own_id: OwnAlarmKey,
    body: OwnAlarmChangeRequest,
) -> OwnAlarmShown:
    """Change an alarm that was added. One that is active ends, and comes again by the next reading."""
    changed = await own.change(person, own_id, body.version, body.written(), body.reason)
    return own_alarm_shown(changed.settings, changed)


@router.delete("/own/{own_id}", status_code=204)
async def remove_own_alarm(
    person: Annotated[Person, REMOVE_OWN.permitted],
    own: OwnBook,
    own_id: OwnAlarmKey,
    version: Annotated[int, Query(ge=1, le=2**62, description="That was seen.")],
    reason: Annotated[ActReason, Query(description="For the journal and the audit log.")],
) -> None:
    """Remove an alarm that was added. One that is active ends."""
    await own.remove(person, own_id, version, reason)


@router.post("/simulate")
async def simulate_alarm(
    person: Engineer, simulator: SimulatorOf, history: HistoryOf, body: AlarmSimulationRequest
) -> AlarmSimulation:
    """What an alarm of the site would have done over stored history. Nothing is changed."""
    buses = list(history.buses.values())
    settings = proposed({"name": body.name, **body.written()}, buses)
    span = month_at_most(body.since, body.until)
    return await simulator.run(history.buses[settings.bus], settings, *span, person.account)


def own_alarm_shown(settings: AlarmSettings, own: OwnAlarm | None) -> OwnAlarmShown:
    """One of the site; ``own``: as it was added, None for one of the configuration."""
    return OwnAlarmShown.model_construct(
        **dict(settings),
        id=own_key(settings.bus, settings.unit, settings.name),
        origin="configuration" if own is None else "page",
        version=None if own is None else own.version,
        changed_by=None if own is None else own.who,
        changed_at=None if own is None else own.at,
    )
