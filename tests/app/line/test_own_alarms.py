"""The site's own alarms, added, changed and removed while the app runs, and across restarts. 10 s."""

from __future__ import annotations

import json
import re
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.core.database import Database
from app.core.web.access import Role
from app.errors import StoreError
from app.line.alarms.alarm import Alarm
from app.line.alarms.line_alarms import LineAlarms
from app.line.alarms.own_alarms import MAX_OWN, OwnAlarmBook
from app.line.live.bus_live import LiveState
from app.people.audit.log import EventLog
from app.settings import Settings
from bus.contract import BusLink, ParameterValue, Reading, UnitLink
from bus.instants import UnixTime
from bus.messages import Message
from bus.settings import UnitLabels
from tests.app.complete_app import House, complete_app
from tests.for_each import for_each

BUS = "dry-end"
PATH = "/api/v1/alarms/own"
FAST = {"name": "Too fast", "bus": BUS, "unit": 1, "value": "actual", "above": "105.0"}


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        connect(house)
        yield house


def connect(house: House) -> None:
    """Unit 1 responds and has one decimal."""
    live = house.services[LiveState].buses[BUS]
    live.worker_lost = None
    now = UnixTime(time.time())
    live.apply([BusLink(at=now, link="open"), UnitLink(unit=1, at=now, link="online")])
    live.apply([ParameterValue(1, 3, now, 1)])


def read(house: House, actual: int) -> None:
    """A reading of unit 1, now."""
    now = UnixTime(time.time())
    house.services[LiveState].buses[BUS].apply([Reading(1, now, 1000, actual, 51, 0xC0, 3)])


def alarm_of(house: House, key: str) -> Alarm:
    return house.services[LineAlarms].buses[BUS].list.alarms[key]


async def added(client: httpx.AsyncClient, **body: Any) -> dict[str, Any]:
    response = await client.post(PATH, json={**FAST, **body})
    assert response.status_code == 201, response.text
    found: dict[str, Any] = response.json()
    return found


async def removed(client: httpx.AsyncClient, own: dict[str, Any]) -> httpx.Response:
    params = {"version": own["version"], "reason": "no longer needed"}
    return await client.delete(f"{PATH}/{own['id']}", params=params)


async def test_an_alarm_is_detected_as_soon_as_it_was_added(house: House) -> None:
    engineer = await house.program(Role.ENGINEER)
    own = await added(engineer, deadband="0.5")
    assert (own["origin"], own["above"], own["version"]) == ("page", "105.0", 1)
    read(house, 1060)
    assert alarm_of(house, own["id"]).facts.state == "unack_active"
    shown = (await engineer.get(f"/api/v1/alarms/{own['id']}.1")).json()
    assert (shown["alarm"]["name"], shown["alarm"]["value"]) == ("Too fast", "106.0")
    (event,) = await house.events("alarm")
    assert (event["what"], event["old"]) == ("Alarm added: Too fast", None)
    assert 'above = "105.0"' in event["new"]
    assert [each["id"] for each in (await engineer.get(PATH)).json()["alarms"]] == [own["id"]]


async def test_a_changed_alarm_ends_and_comes_again_by_the_next_reading(house: House) -> None:
    engineer = await house.program(Role.ENGINEER)
    own = await added(engineer)
    read(house, 1060)
    body = {**FAST, "above": "103.0", "version": own["version"], "reason": "earlier"}
    changed = await engineer.put(f"{PATH}/{own['id']}", json=body)
    assert (changed.status_code, changed.json()["above"]) == (200, "103.0")
    assert alarm_of(house, own["id"]).facts.state == "normal"
    read(house, 1040)
    alarm = alarm_of(house, own["id"])
    assert (alarm.facts.state, alarm.facts.occurrence) == ("unack_active", 2)
    await house.services[LineAlarms].write()
    entries = await house.services[LineAlarms].store.journal(10, alarm=own["id"])
    assert [each.trigger for each in reversed(entries)] == ["rise", "remove", "clear", "return", "rise"]
    event = (await house.events("alarm"))[0]
    assert event["what"] == "Alarm changed: Too fast"
    assert ("105.0" in event["old"], "103.0" in event["new"]) == (True, True)
    stale = await engineer.put(f"{PATH}/{own['id']}", json=body)
    assert (stale.status_code, stale.json()["code"]) == (409, "superseded")
    other = {**body, "name": "Other", "version": changed.json()["version"]}
    assert (await engineer.put(f"{PATH}/{own['id']}", json=other)).status_code == 422


async def test_a_removed_alarm_is_gone_from_every_list(house: House) -> None:
    engineer = await house.program(Role.ENGINEER)
    own = await added(engineer)
    read(house, 1060)
    services = house.services
    of_unit = services[LineAlarms].unit_alarms(BUS, 1)
    assert [alarm.definition.key for alarm in of_unit] == [own["id"]]
    response = await removed(engineer, own)
    assert response.status_code == 204, response.text
    assert services[LineAlarms].unit_alarms(BUS, 1) == []
    assert own["id"] not in {each.definition.key for each in services[LineAlarms].every()}
    read(house, 1070)
    assert own["id"] not in {each.definition.key for each in services[LineAlarms].present()}
    assert (await engineer.get(f"/api/v1/alarms/{own['id']}.1")).status_code == 404
    assert (await removed(engineer, own)).status_code == 404
    again = await added(engineer)
    assert again["version"] > own["version"]
    read(house, 1070)
    assert alarm_of(house, own["id"]).facts.occurrence == 2


@for_each(
    ("body", "words"),
    [
        ({"unit": 9}, "bus dry-end has no unit 9"),
        ({"above": "10", "deadband": "11"}, "deadband is wider than the limits leave room for"),
        ({"name": ""}, "name = ''"),
        ({"cause": "x" * 301}, ""),
    ],
)
async def test_what_the_configuration_would_refuse_is_refused(
    house: House, body: dict[str, Any], words: str
) -> None:
    engineer = await house.program(Role.ENGINEER)
    response = await engineer.post(PATH, json={**FAST, **body})
    assert (response.status_code, words in response.json()["detail"]) == (422, True)
    assert (await engineer.get(PATH)).json()["alarms"] == []


async def test_a_name_is_given_once_and_a_request_adds_once(house: House) -> None:
    engineer = await house.program(Role.ENGINEER)
    headers = {"Idempotency-Key": "first"}
    first = await engineer.post(PATH, json=FAST, headers=headers)
    again = await engineer.post(PATH, json=FAST, headers=headers)
    assert (again.status_code, again.json()) == (201, first.json())
    other = await engineer.post(PATH, json={**FAST, "above": "1"}, headers=headers)
    assert other.status_code == 422
    taken = await engineer.post(PATH, json={**FAST, "unit": 2})
    assert (taken.status_code, taken.json()["code"]) == (409, "taken")


async def test_the_number_of_added_alarms_is_bounded(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    assert MAX_OWN == 500
    monkeypatch.setattr("app.line.alarms.own_alarms.MAX_OWN", 1)
    engineer = await house.program(Role.ENGINEER)
    await added(engineer)
    response = await engineer.post(PATH, json={**FAST, "name": "Second"})
    assert (response.status_code, response.json()["code"]) == (409, "too_many")


async def test_an_act_that_cannot_be_recorded_did_not_happen(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    engineer = await house.program(Role.ENGINEER)
    own = await added(engineer)
    read(house, 1060)

    async def fails(**_: Any) -> int:
        raise StoreError(Message("own_alarm_unreadable"))

    with monkeypatch.context() as patched:
        patched.setattr(house.services[EventLog], "record", fails)
        assert (await removed(engineer, own)).status_code == 503
        assert (await engineer.post(PATH, json={**FAST, "name": "Second"})).status_code == 503
    assert alarm_of(house, own["id"]).facts.state == "unack_active"
    read(house, 1000)
    assert alarm_of(house, own["id"]).facts.state == "rtn_unack"
    assert (await engineer.get(PATH)).json()["alarms"] == [own]


async def test_a_restart_keeps_added_alarms_and_leaves_aside_what_no_longer_fits(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        connect(house)
        engineer = await house.program(Role.ENGINEER)
        own = await added(engineer)
        await added(engineer, name="Of a unit that goes")
        read(house, 1060)
        gone = json.dumps({**FAST, "name": "Of a unit that goes", "unit": 9})
        statement = "UPDATE own_alarm SET settings = ? WHERE version = 2"
        await house.services[Database].write(lambda connection: connection.execute(statement, (gone,)))
    async with complete_app(tmp_path) as house:
        assert alarm_of(house, own["id"]).facts.state == "unack_active"
        engineer = await house.signed_in(Role.ENGINEER)
        found = (await engineer.get(PATH)).json()
        assert found["alarms"] == [own]
        (aside,) = (await engineer.get(PATH)).json()["left_aside"]
        assert (aside["name"], "has no unit 9" in aside["reason"]["detail"]) == ("Of a unit that goes", True)
        assert (await removed(engineer, aside)).status_code == 204
        assert (await engineer.get(PATH)).json()["left_aside"] == []


FORM = {"name": "Too fast", "place": f"{BUS}/1", "value": "actual", "above": "105.0", "days": "1"}


async def test_the_page_adds_changes_and_removes_without_script(house: House) -> None:
    engineer = await house.signed_in(Role.ENGINEER)
    simulated = (await engineer.get("/alarms/own", params=FORM)).text
    assert 'name="above" value="105.0"' in simulated
    assert "Add alarm" in simulated
    added = await engineer.post("/alarms/own", data=FORM)
    assert added.status_code == 303
    assert "watched from now on" in (await engineer.get(added.headers["location"])).text
    book = house.services[OwnAlarmBook]
    (own,) = book.added.values()
    page = (await engineer.get("/alarms/own")).text
    assert f'name="change" value="{own.key}"' in page
    german = {"Accept-Language": "de"}
    change = {**FORM, "above": "103,5", "change": own.key, "version": str(own.version)}
    assert (await engineer.post("/alarms/own", data=change, headers=german)).status_code == 303
    assert str(book.added[own.key].settings.above) == "103.5"
    stale = await engineer.post("/alarms/own", data=change, headers=german)
    assert (stale.status_code, "seither geändert" in stale.text) == (409, True)
    hidden = (await engineer.post("/alarms/own", data={**FORM, "name": "Nip\u202eevil"})).text
    assert "Nip\\u202eevil" in hidden, "a refusal is read from left to right"
    form = {"alarm": own.key, "version": str(book.added[own.key].version)}
    assert (await engineer.post("/alarms/own/remove", data=form)).status_code == 422
    assert (await engineer.post("/alarms/own/remove", data=form | {"reason": "done"})).status_code == 303
    assert "There are no custom alarms." in (await engineer.get("/alarms/own")).text


async def test_a_change_on_the_page_keeps_what_the_form_has_no_field_for(house: House) -> None:
    program, engineer = await house.program(Role.ENGINEER), await house.signed_in(Role.ENGINEER)
    own = await added(program, latch=True, response="Slow down.")
    page = (await engineer.get("/alarms/own")).text
    assert 'name="response" value="Slow down."' in page
    assert "actual speed is above 105.0" in page
    texts = {"cause": "A worn felt.", "consequence": "The web breaks.", "response": "Slow down now."}
    change = {**FORM, **texts, "change": own["id"], "version": str(own["version"]), "above": "110"}
    assert (await engineer.post("/alarms/own", data=change)).status_code == 303
    (after,) = (await program.get(PATH)).json()["alarms"]
    assert (after["above"], after["latch"]) == ("110", True)
    assert {name: after[name] for name in texts} == texts


async def test_the_values_of_the_form_have_the_labels_of_the_chosen_unit(house: House) -> None:
    labels = UnitLabels(input={"run": "Web break"}, analog="Felt tension", analog_unit="bar")
    bus = next(bus for bus in house.services[Settings].bus if bus.name == BUS)
    bus.unit[0].__dict__["labels"] = labels
    engineer, operator = await house.signed_in(Role.ENGINEER), await house.signed_in(Role.OPERATOR)
    program = await house.program(Role.ENGINEER)
    await added(program, name="Loose", value="analog", above=None, below="1.5", on_delay_s=5)
    await added(program, name="Broke", value="run", above=None, state="off")
    page = (await engineer.get("/alarms/own")).text
    assert "Felt tension (analog input) is below 1.5 bar for longer than 5 s" in page
    assert "Web break (run) is off" in page
    place = {"place": f"{BUS}/1"}
    assert "Web break (run)" in (await engineer.get("/alarms/own/values", params=place)).text
    other = (await engineer.get("/alarms/own/values", params={"place": f"{BUS}/2"})).text
    assert ("Web break" in other, "run" in other) == (False, True)
    assert (await operator.get("/alarms/own/values", params=place)).status_code == 403


async def test_the_page_states_why_an_alarm_is_refused(house: House) -> None:
    engineer = await house.signed_in(Role.ENGINEER)
    refused = await engineer.post("/alarms/own", data=FORM | {"on_delay_s": "-1"})
    assert (refused.status_code, "On-delay, s = -1:" in refused.text) == (422, True)
    assert (await engineer.post("/alarms/own", data=FORM | {"name": " "})).status_code == 422
    assert not house.services[OwnAlarmBook].added


async def test_a_refusal_names_the_fields_of_the_page_and_what_was_typed_and_marks_the_field(
    house: House,
) -> None:
    engineer = await house.signed_in(Role.ENGINEER)
    typed = (await engineer.get("/alarms/own", params=FORM | {"above": "119,x"})).text
    nothing = (await engineer.get("/alarms/own", params=FORM | {"above": ""})).text
    assert "Above = 119,x: it must be a finite number" in typed
    assert "fill in one condition: Above, Below or both, or Change per second" in nothing
    for text in (typed, nothing):
        field = re.search(r'<input[^>]*name="above"[^>]*>', text)
        assert field is not None
        for mark in ('aria-invalid="true"', 'aria-describedby="fault-above"', "autofocus"):
            assert mark in field[0]
        assert 'id="simulation"' not in text, "which an address would have the focus go to"


ACTS = st.lists(
    st.tuples(st.sampled_from(("add", "change", "remove", "read")), st.integers(0, 3), st.integers(90, 110)),
    min_size=20,
    max_size=20,
)


@settings(
    max_examples=settings.default.max_examples // 8,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(acts=ACTS)
async def test_random_acts_between_readings_leave_the_alarms_that_a_model_has(
    tmp_path_factory: pytest.TempPathFactory, acts: list[tuple[str, int, int]]
) -> None:
    async with complete_app(tmp_path_factory.mktemp("house")) as house:
        connect(house)
        engineer = await house.program(Role.ENGINEER)
        there: dict[int, dict[str, Any]] = {}
        limits: dict[int, int] = {}
        active: dict[int, bool] = {}
        rises = [0, 0, 0, 0]
        for word, number, value in acts:
            name = {"name": f"Alarm {number}", "above": str(value)}
            if word == "add" and number not in there:
                there[number] = await added(engineer, **name)
                limits[number], active[number] = value, False
            elif word == "change" and number in there:
                own = there[number]
                body = {**FAST, **name, "version": own["version"]}
                there[number] = (await engineer.put(f"{PATH}/{own['id']}", json=body)).json()
                limits[number], active[number] = value, False
            elif word == "remove" and number in there:
                assert (await removed(engineer, there.pop(number))).status_code == 204
                del limits[number], active[number]
            elif word == "read":
                read(house, 10 * value)
                for each, limit in limits.items():
                    rises[each] += value > limit and not active[each]
                    active[each] = value > limit
        for number, own in there.items():
            facts = alarm_of(house, own["id"]).facts
            assert (facts.active, facts.occurrence) == (active[number], rises[number])
        await house.services[LineAlarms].write()
        entries = await house.services[LineAlarms].store.journal(1000, None)
        risen = [sum(e.trigger == "rise" and e.name == f"Alarm {n}" for e in entries) for n in range(4)]
        cleared = [sum(e.trigger == "clear" and e.name == f"Alarm {n}" for e in entries) for n in range(4)]
        assert risen == rises
        assert [a - b for a, b in zip(risen, cleared, strict=True)] == [
            active.get(number, False) for number in range(4)
        ]
