"""What a person does to alarms is checked where it is done, whether or not a route was passed."""

from __future__ import annotations

import pytest

from app.core.database import Database
from app.core.web.access import Person, Role
from app.errors import Problem
from app.line.alarms.acts import (
    ACKNOWLEDGE,
    ALARM_ACTS,
    REMOVE,
    RESET,
    RETURN,
    SHELVE,
    SILENCE,
    UNSHELVE,
    ActBody,
    AlarmAct,
    AlarmShelveRequest,
)
from app.line.alarms.line_alarms import LineAlarms
from app.line.alarms.site_alarms import SiteAlarms
from app.people.audit.queries import Filter
from bus.instants import UnixTime
from tests.app.alarm_bus import BUS, RUN, AlarmBus
from tests.app.complete_app import EVERY_ROLE

ESTOP = f"{BUS}.1.estop_active"


class ActiveAlarm:
    """An emergency stop that is active."""

    def __init__(self, database: Database) -> None:
        self.bus = AlarmBus(database)
        self.bus.connect()
        self.alarm = self.bus.alarm("1.estop_active")
        self.events = self.bus.events
        site = SiteAlarms(self.bus.store, lambda: UnixTime(self.bus.now))
        self.alarms = LineAlarms({BUS: self.bus.alarms}, site, self.bus.store, self.events, self.clock)
        self.bus.now += 1
        self.bus.read(1, inputs=RUN)

    def clock(self) -> UnixTime:
        return UnixTime(self.bus.now)

    async def recorded(self) -> list[str]:
        return [event["what"] for event in (await self.events.page(Filter(kind="alarm"), 100))[0]]


def body_of(act: AlarmAct) -> ActBody:
    fields = {"reason": "chatters", "minutes": 5, "comment": "seen"}
    return act.body(**{name: fields[name] for name in fields.keys() & act.body.model_fields.keys()})


@pytest.mark.parametrize(
    ("act", "role"),
    [(act, role) for act in ALARM_ACTS for role in EVERY_ROLE if not role.includes(act.role)],
)
async def test_a_caller_without_a_route_needs_the_role_too(
    database: Database, act: AlarmAct, role: Role
) -> None:
    active = ActiveAlarm(database)
    before = active.alarm.facts
    with pytest.raises(Problem, match=f"role {act.role}") as refused:
        await active.alarms.act(Person("ben", role, "session"), act, f"{ESTOP}.1", body_of(act))
    assert (refused.value.status, refused.value.code) == (403, "forbidden")
    assert active.alarm.facts is before
    assert await active.recorded() == []


@pytest.mark.parametrize("role", [Role.VIEWER, Role.WORKER])
async def test_silencing_all_that_sounds_needs_the_role_too(database: Database, role: Role) -> None:
    active = ActiveAlarm(database)
    with pytest.raises(Problem, match="role operator"):
        await active.alarms.silence_sounding(Person("ben", role, "session"), active.clock())
    assert active.alarms.sounding() == [active.alarm]
    assert await active.recorded() == []


async def test_each_act_follows_from_its_row(database: Database) -> None:
    active, anna = ActiveAlarm(database), Person("anna", Role.ENGINEER, "session")
    expected = [
        (SILENCE, "unack_active"),
        (ACKNOWLEDGE, "ack_active"),
        (SHELVE, "shelved"),
        (UNSHELVE, "unack_active"),
        (REMOVE, "out_of_service"),
        (RETURN, "unack_active"),
    ]
    for act, state in expected:
        await active.alarms.act(anna, act, f"{ESTOP}.1", body_of(act))
        assert active.alarm.facts.state == state
    assert active.alarm.hidden_by == "anna"
    assert await active.recorded() == [
        "Alarm returned to service: Emergency stop",
        "Alarm taken out of service: Emergency stop",
        "Alarm unshelved: Emergency stop",
        "Alarm shelved: Emergency stop",
        "Alarm acknowledged: Emergency stop",
        "Alarm silenced: Emergency stop",
    ]
    with pytest.raises(Problem, match="Nothing was changed"):
        await active.alarms.act(anna, RESET, f"{ESTOP}.1")


async def test_a_shelf_ends_after_its_minutes(database: Database) -> None:
    active, anna = ActiveAlarm(database), Person("anna", Role.OPERATOR, "session")
    await active.alarms.act(anna, SHELVE, f"{ESTOP}.1", AlarmShelveRequest(reason="chatters", minutes=5))
    assert active.alarm.facts.shelved_until == UnixTime(active.bus.now + 300)
