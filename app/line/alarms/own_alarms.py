"""The alarms that the site defines: those of the configuration, and those that engineers add, change and
remove, with their routes and the simulation of one over stored history."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal

import structlog
from fastapi import APIRouter, Path, Query
from pydantic import ConfigDict, Field
from typing_extensions import TypedDict

from app.core.database import Database, StoreConnection, StoreRow
from app.core.web.access import Engineer, Person
from app.core.web.api import ApiRoute, RequestKey
from app.core.web.services import service
from app.core.web.shape import InstantObject, MessageObject, StrictBody, ZonedTime
from app.errors import Problem, StoreError
from app.line.alarms import rules
from app.line.alarms.acts import ADD_OWN, CHANGE_OWN, REMOVE_OWN, ActReason, Comment
from app.line.alarms.alarm import Alarm, own_key
from app.line.alarms.alarm_list import ActTransaction
from app.line.alarms.api import AlarmPriorityShown, month_at_most
from app.line.alarms.bus_alarms import BusAlarms
from app.line.alarms.line_alarms import LineAlarms
from app.line.alarms.own_condition import in_toml, own_definition, proposed
from app.line.alarms.settings import AlarmSettings, OwnValue
from app.line.alarms.simulation import AlarmSimulation, Simulator
from app.line.conditions.condition import AlarmPriority
from app.line.history.api import HistoryOf
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from bus.instants import UnixTime, unix_now
from bus.messages import Message
from bus.settings import BusSettings

MAX_OWN = 500
"""The most alarms that can be added on the page."""
log = structlog.get_logger()


@dataclass(slots=True)
class OwnAlarm:
    """An alarm that was added on the page; ``request``: the account that added it, and its
    Idempotency-Key."""

    settings: AlarmSettings
    who: str
    at: UnixTime
    request: str
    version: int = 0

    @property
    def key(self) -> str:
        return own_key(self.settings.bus, self.settings.unit, self.settings.name)


@dataclass(frozen=True, slots=True)
class OwnAlarmLeftAside:
    """An alarm that does not fit the configuration, and is not observed."""

    id: str
    name: str
    version: int
    reason: Annotated[MessageObject, Field(description="Why.")]


class OwnAlarmBook:
    """The alarms of the site, configured and added. An act is in the audit log, in the journal, in the store
    and in effect, or nowhere. Call :meth:`load` before the states of the alarms are loaded."""

    def __init__(
        self,
        configured: Iterable[AlarmSettings],
        buses: Sequence[BusSettings],
        alarms: LineAlarms,
        database: Database,
        events: EventLog,
    ) -> None:
        self.configured = {own_key(each.bus, each.unit, each.name): each for each in configured}
        self.added: dict[str, OwnAlarm] = {}
        self.left_aside: dict[str, OwnAlarmLeftAside] = {}
        self._bus_settings = buses
        self._alarms = alarms
        self._database = database
        self._events = events
        self._acting = asyncio.Lock()
        """Held during an act: names and their number are checked before the alarm is stored."""

    async def load(self) -> None:
        """Observe the stored alarms that fit the configuration, and set the others aside."""
        for row in await self._database.read(_stored):
            name = row["alarm"]
            try:
                written = json.loads(row["settings"])
                name = str(written.get("name", name))
                settings = self._fitting(written)
            except (ValueError, AttributeError):
                self._leave_aside(row, name, Message("own_alarm_unreadable"))
            except Problem as problem:
                self._leave_aside(row, name, problem.message)
            else:
                self._bus(settings).add_own(settings, Alarm(own_definition(settings)))
                own = OwnAlarm(settings, row["who"], row["changed_at"], row["request"], row["version"])
                self.added[own.key] = own

    def _leave_aside(self, row: StoreRow, name: str, why: Message) -> None:
        log.warning("alarm of the site does not fit the configuration", alarm=name, why=str(why))
        self.left_aside[row["alarm"]] = OwnAlarmLeftAside(row["alarm"], name, row["version"], why)

    def every(self) -> list[tuple[AlarmSettings, OwnAlarm | None]]:
        """Return every observed alarm, with its `OwnAlarm`, which is None for one of the configuration."""
        configured = [(settings, None) for settings in self.configured.values()]
        added = [(own.settings, own) for own in self.added.values()]
        return [*configured, *added]

    def _fitting(self, written: Mapping[str, Any]) -> AlarmSettings:
        """Read an alarm as a person wrote it. Raise Problem 422, or 409 if its name is taken."""
        settings = proposed(written, self._bus_settings)
        if (settings.bus, settings.name) in {(each.bus, each.name) for each, _ in self.every()}:
            raise Problem(409, "taken", Message.of("own_alarm_taken", name=settings.name, bus=settings.bus))
        return settings

    async def add(
        self, person: Person, written: Mapping[str, Any], key_of_request: str | None = None
    ) -> OwnAlarm:
        """Add an alarm, which is observed from the next reading on. A repeated request adds it once. Raise
        Problem."""
        ADD_OWN.check(person)
        request = f"{person.account}:{key_of_request}" if key_of_request else ""
        async with self._acting:
            earlier = next((own for own in self.added.values() if request and own.request == request), None)
            if earlier is not None:
                return self._repeated(earlier, written)
            own = OwnAlarm(self._fitting(written), person.name, unix_now(), request)
            if len(self.added) + len(self.left_aside) >= MAX_OWN:
                raise Problem(409, "too_many", Message.of("own_alarms_full", n=MAX_OWN))
            bus, settings = self._bus(own.settings), own.settings
            stored = await self._alarms.store.find(own.key)
            writing = partial(_replace, key=own.key, own=own)
            performed = ADD_OWN.by(person, name=settings.name)
            await self._events.record(
                **performed, bus=settings.bus, unit=settings.unit, new=in_words(settings), also=writing
            )
            self.left_aside.pop(own.key, None)
            bus.add_own(settings, Alarm(own_definition(settings)))
            if stored is not None:
                bus.list.load({own.key: stored}, unix_now())
            self.added[own.key] = own
            return own

    def _repeated(self, earlier: OwnAlarm, written: Mapping[str, Any]) -> OwnAlarm:
        if proposed(written, self._bus_settings) != earlier.settings:
            raise Problem(422, "invalid", Message("own_alarm_key_of_other"))
        return earlier

    async def change(
        self, person: Person, key: str, version: int, written: Mapping[str, Any], reason: str = ""
    ) -> OwnAlarm:
        """Replace the definition of an alarm, whose name and unit stay. The alarm ends, and comes again with
        the next reading that fulfills the new definition. ``version``: the one that was changed. Raise
        Problem."""
        CHANGE_OWN.check(person)
        async with self._acting:
            former = self._of_version(key, version)
            settings = proposed(written, self._bus_settings)
            own = OwnAlarm(settings, person.name, unix_now(), former.request)
            if own.key != key:
                raise Problem(422, "invalid", Message.of("own_alarm_other_place", name=former.settings.name))
            alarm = await self._end(person, CHANGE_OWN, former, reason, own)
            self._bus(settings).add_own(settings, Alarm(own_definition(settings), alarm.facts))
            self.added[key] = own
            return own

    async def remove(self, person: Person, key: str, version: int, reason: str) -> None:
        """End an alarm and its definition. Raise Problem."""
        REMOVE_OWN.check(person)
        async with self._acting:
            aside = self.left_aside.get(key)
            if aside is not None and aside.version == version:
                await self._events.record(
                    **REMOVE_OWN.by(person, name=aside.name),
                    message=reason,
                    also=partial(_replace, key=key),
                )
                del self.left_aside[key]
                return
            own = self._of_version(key, version)
            await self._end(person, REMOVE_OWN, own, reason)
            self._bus(own.settings).list.remove(key)
            del self.added[key]

    def _of_version(self, key: str, version: int) -> OwnAlarm:
        own = self.added.get(key)
        if own is None and key in self.configured:
            raise Problem(409, "taken", Message.of("own_alarm_configured", name=self.configured[key].name))
        if own is None and key not in self.left_aside:
            raise Problem(404, "unknown_alarm", Message.of("alarm_unknown", id=key[:200]))
        if own is None or own.version != version:
            name = self.left_aside[key].name if own is None else own.settings.name
            raise Problem(409, "superseded", Message.of("own_alarm_superseded", name=name), id=key)
        return own

    async def _end(
        self, person: Person, act: Act, own: OwnAlarm, reason: str, following: OwnAlarm | None = None
    ) -> Alarm:
        bus = self._bus(own.settings)
        async with bus.list.writing:
            alarm, now = bus.list.alarms[own.key], unix_now()
            bus.list.advance(now)
            bus.end_own(alarm)
            transaction = ActTransaction(person.name, [bus.list])
            ended = rules.withdraw(alarm.facts, alarm.definition.attributes, now)
            transaction.change(bus.list, alarm, ended, reason)
            try:
                await transaction.record(
                    self._events,
                    partial(_replace, key=own.key, own=following),
                    **act.by(person, name=own.settings.name),
                    bus=own.settings.bus,
                    unit=own.settings.unit,
                    old=in_words(own.settings),
                    new=in_words(following.settings) if following else None,
                    message=reason,
                )
            except StoreError:
                bus.add_own(own.settings, alarm)
                raise
        return alarm

    def _bus(self, settings: AlarmSettings) -> BusAlarms:
        return self._alarms.buses[settings.bus]


def _stored(connection: StoreConnection) -> list[StoreRow]:
    query = "SELECT alarm, settings, who, changed_at, request, version FROM own_alarm ORDER BY alarm"
    return connection.execute(query).fetchall()


def _replace(connection: StoreConnection, key: str, own: OwnAlarm | None = None) -> None:
    """Replace the row of ``key`` by ``own``, whose version is set, or remove it. No version is used twice."""
    connection.execute("DELETE FROM own_alarm WHERE alarm = ?", (key,))
    if own is not None:
        statement = (
            "INSERT INTO own_alarm (alarm, settings, who, changed_at, request)"
            " VALUES (?, ?, ?, ?, ?) RETURNING version"
        )
        written = own.settings.model_dump_json(exclude_defaults=True)
        row = (own.key, written, own.who, own.at, own.request)
        [(own.version,)] = connection.execute(statement, row)


def in_words(settings: AlarmSettings) -> str:
    """Write a definition in one line for the audit log, with the keys of ``[[alarm]]``."""
    return "; ".join(in_toml(settings).splitlines()[1:])


router = APIRouter(prefix="/api/v1/alarms", tags=["alarms"], route_class=ApiRoute)

OwnBook = Annotated[OwnAlarmBook, service(OwnAlarmBook)]
OwnAlarmKey = Annotated[str, Path(max_length=200, description="The `id` of the list.")]
WrittenText = Annotated[str, Field(max_length=300)]
Version = Annotated[int, Field(ge=1, le=2**62, description="That the change was made from.")]
SimulatorOf = Annotated[Simulator, service(Simulator)]
WrittenLimit = Annotated[str | int | float, Field(description='As the unit displays it: "80.0" or 80.')]
WrittenDelay = Annotated[float | int, Field(description="Seconds, up to a day.")]


class OwnAlarmRequest(StrictBody):
    """An alarm with the keys of ``[[alarm]]`` in lineside.toml."""

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
        """Return the keys of ``[[alarm]]`` that were given."""
        beside = {"since", "until", "version", "reason"}
        return self.model_dump(exclude_unset=True, exclude_none=True, exclude=beside)


class AlarmSimulationRequest(OwnAlarmRequest):
    """An alarm with the keys of ``[[alarm]]`` in lineside.toml, and a span; the last week by default."""

    model_config = ConfigDict(populate_by_name=True)

    name: Annotated[str, Field(max_length=200)] = "New alarm"
    since: Annotated[ZonedTime | None, Field(alias="from", strict=False)] = None
    until: Annotated[ZonedTime | None, Field(alias="to", strict=False)] = None


class OwnAlarmChangeRequest(OwnAlarmRequest):
    """The new definition; name, bus and unit stay."""

    version: Version
    reason: Comment = ""


class OwnAlarmShown(AlarmSettings):
    """An alarm of the site, with the keys of ``[[alarm]]``."""

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
    """The alarms of the configuration, those that were added, and those that do not fit."""

    alarms: list[OwnAlarmShown]
    left_aside: list[OwnAlarmLeftAside]


@router.get("/own")
async def get_own_alarms(_: Engineer, own: OwnBook) -> OwnAlarmsShown:
    """List the alarms of the site, with their origin."""
    return {
        "alarms": [_shown(*each) for each in own.every()],
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
    return _shown(added.settings, added)


@router.put("/own/{own_id}")
async def change_own_alarm(
    person: Annotated[Person, CHANGE_OWN.permitted],
    own: OwnBook,
    own_id: OwnAlarmKey,
    body: OwnAlarmChangeRequest,
) -> OwnAlarmShown:
    """Change an alarm that was added. One that is active ends, and comes again by the next reading."""
    changed = await own.change(person, own_id, body.version, body.written(), body.reason)
    return _shown(changed.settings, changed)


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
    """Simulate what an alarm of the site would have done over stored history. Nothing is changed."""
    buses = list(history.buses.values())
    settings = proposed({"name": body.name, **body.written()}, buses)
    span = month_at_most(body.since, body.until)
    return await simulator.run(history.buses[settings.bus], settings, *span, person.account)


def _shown(settings: AlarmSettings, own: OwnAlarm | None) -> OwnAlarmShown:
    """Return an alarm of the site in the form of the API; ``own``: None for one of the configuration."""
    return OwnAlarmShown.model_construct(
        **dict(settings),
        id=own_key(settings.bus, settings.unit, settings.name),
        origin="configuration" if own is None else "page",
        version=None if own is None else own.version,
        changed_by=None if own is None else own.who,
        changed_at=None if own is None else own.at,
    )
