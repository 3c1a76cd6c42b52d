"""Alarms over HTTP: who may do what, which occurrence is meant, and what is recorded."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.core.web.access import Role
from app.errors import StoreError
from app.line.alarms.acts import ALARM_ACTS
from app.line.alarms.bus_alarms import BusAlarms
from app.line.alarms.line_alarms import LineAlarms
from app.people.audit.log import EventLog
from bus.messages import Message
from tests.app.complete_app import House, complete_app
from tests.app.played_line import BUS, estop, played_line
from tests.for_each import for_each

API = "/api/v1/alarms"
OWN_FIELDS = {"id", "name", "code", "bus", "unit", "priority", "state", "active", "acknowledged", "since"}


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        await played_line(house.services)
        house.services.buses[BUS][BusAlarms].tick()
        yield house


async def present(client: httpx.AsyncClient, **query: Any) -> list[dict[str, Any]]:
    response = await client.get(API, params=query)
    assert response.status_code == 200, response.text
    return [alarm for alarm in response.json()["alarms"] if alarm["bus"] == BUS]


async def act(client: httpx.AsyncClient, alarm: str, what: str, **body: Any) -> httpx.Response:
    return await client.post(f"{API}/{alarm}/{what}", json=body)


async def test_an_alarm_comes_is_acknowledged_and_goes(house: House) -> None:
    operator = await house.program(Role.OPERATOR)
    estop(house.services, active=True)
    (alarm,) = await present(operator)
    assert set(alarm) >= OWN_FIELDS
    assert (alarm["code"], alarm["state"], alarm["priority"]) == ("estop_active", "unack_active", "urgent")
    assert alarm["message"].startswith("Emergency stop. Go to the machine")
    done = await act(operator, alarm["id"], "acknowledge", comment="seen")
    assert (done.status_code, done.json()["state"]) == (200, "ack_active")
    estop(house.services, active=False)
    assert await present(operator) == []
    await house.services[LineAlarms].write()
    journal = (await operator.get(f"{API}/journal")).json()["transitions"]
    assert [(e["trigger"], e["after"], e["reason"]) for e in journal if e["code"] == "estop_active"] == [
        ("clear", "normal", None),
        ("acknowledge", "ack_active", "seen"),
        ("rise", "unack_active", None),
    ]


async def test_an_acknowledgement_moves_no_active_alarm(house: House) -> None:
    operator = await house.program(Role.OPERATOR)
    for unit in (1, 2):
        estop(house.services, active=True, unit=unit)
    before = [alarm["id"] for alarm in await present(operator)]
    assert len(before) == 2
    await act(operator, before[0], "acknowledge")
    assert [alarm["id"] for alarm in await present(operator)] == before


async def test_sheet_report_and_list_have_the_same_times_and_states(house: House) -> None:
    operator = await house.program(Role.OPERATOR)
    for unit in (1, 2):
        estop(house.services, active=True, unit=unit)
    await act(operator, f"{BUS}.1.estop_active.1", "acknowledge")
    estop(house.services, active=False, unit=2)
    await house.services[LineAlarms].write()
    listed = {alarm["id"]: (alarm["came"], alarm["state"]) for alarm in await present(operator)}
    assert {state for _, state in listed.values()} == {"ack_active", "rtn_unack"}
    report = (await operator.get("/api/v1/report")).json()
    standing = {each["alarm"]: (each["came"], each["after"]) for each in report["standing"] if each["bus"]}
    assert standing == listed
    assert {each["alarm"]: (each["time"], each["at_end"]) for each in report["alarms"]} == listed
    page = (await operator.get("/reports")).text
    for title in ("alarms", "standing"):
        section = page.partition(f'<h2 id="{title}">')[2].partition("</section>")[0]
        assert "active, acknowledged" in section
        assert "cleared, not acknowledged" in section
        assert "active, not acknowledged" not in section


async def test_came_cleared_and_acknowledged_are_three_times(house: House) -> None:
    operator = await house.program(Role.OPERATOR)

    async def shown() -> dict[str, Any]:
        alarm: dict[str, Any] = (await operator.get(f"{API}/{BUS}.1.estop_active.1")).json()["alarm"]
        return alarm

    estop(house.services, active=True)
    came = await shown()
    assert (came["came"], came["cleared"], came["acknowledged_at"]) == (came["since"], None, None)
    await act(operator, came["id"], "acknowledge")
    acknowledged = await shown()
    assert (acknowledged["came"], acknowledged["cleared"]) == (came["came"], None)
    assert acknowledged["acknowledged_at"] == acknowledged["since"] > came["came"]
    estop(house.services, active=False)
    cleared = await shown()
    assert (cleared["came"], cleared["acknowledged_at"]) == (came["came"], acknowledged["acknowledged_at"])
    assert cleared["cleared"] == cleared["since"] > acknowledged["since"]


async def test_an_acknowledgement_names_the_occurrence(house: House) -> None:
    operator = await house.program(Role.OPERATOR)
    estop(house.services, active=True)
    (first,) = await present(operator)
    estop(house.services, active=False)
    estop(house.services, active=True)
    late = await act(operator, first["id"], "acknowledge")
    (second,) = await present(operator)
    assert (late.status_code, late.json()["code"], late.json()["id"]) == (409, "superseded", second["id"])
    assert second["state"] == "unack_active"


async def test_of_two_people_who_acknowledge_at_once_the_second_gets_its_refusal_in_words(
    house: House,
) -> None:
    operator = await house.program(Role.OPERATOR)
    estop(house.services, active=True)
    (alarm,) = await present(operator)
    await act(operator, alarm["id"], "acknowledge")
    again = await act(operator, alarm["id"], "acknowledge")
    assert (again.status_code, again.json()["code"]) == (409, "not_in_state")
    assert "active, acknowledged by now. Nothing was changed." in again.json()["detail"]


async def test_shelving_has_a_reason_and_an_end(house: House) -> None:
    operator = await house.program(Role.OPERATOR)
    estop(house.services, active=True)
    (alarm,) = await present(operator)
    for wrong in (
        {"reason": "", "minutes": 5},
        {"reason": "x", "minutes": -5},
        {"reason": "x", "minutes": 721},
    ):
        assert (await act(operator, alarm["id"], "shelve", **wrong)).status_code == 422
    shelved = (await act(operator, alarm["id"], "shelve", reason="chatters", minutes=5)).json()
    assert (shelved["state"], shelved["reason"]) == ("shelved", "chatters")
    assert shelved["shelved_until"] is not None
    assert await present(operator, state="unack_active") == []
    assert [each["id"] for each in await present(operator, state="shelved")] == [alarm["id"]]
    assert (await act(operator, alarm["id"], "acknowledge")).status_code == 409
    back = await act(operator, alarm["id"], "unshelve")
    assert back.json()["state"] == "unack_active"


async def test_out_of_service_is_for_an_engineer(house: House) -> None:
    operator, engineer = await house.program(Role.OPERATOR), await house.program(Role.ENGINEER)
    (alarm,) = [a for a in await present(operator, state="normal", unit=1) if a["code"] == "estop_active"]
    assert (await act(operator, alarm["id"], "out-of-service", reason="rebuilt")).status_code == 403
    out = await act(engineer, alarm["id"], "out-of-service", reason="rebuilt")
    assert out.json()["state"] == "out_of_service"
    estop(house.services, active=True)
    (hidden,) = await present(operator)
    assert (hidden["state"], hidden["active"]) == ("out_of_service", True)
    back = await act(engineer, hidden["id"], "in-service")
    assert back.json()["state"] == "unack_active"


@for_each("what", [act.path for act in ALARM_ACTS])
async def test_a_viewer_changes_nothing(house: House, what: str) -> None:
    viewer = await house.program(Role.VIEWER)
    estop(house.services, active=True)
    (alarm,) = await present(viewer)
    assert (await act(viewer, alarm["id"], what, reason="x", minutes=5)).status_code == 403


@for_each("alarm", ["nothing", f"{BUS}.1.estop_active", f"{BUS}.1.estop_active.x", "..", "a.²"])
async def test_an_unknown_alarm_is_not_found(house: House, alarm: str) -> None:
    viewer = await house.program(Role.VIEWER)
    missing = await viewer.get(f"{API}/{alarm}")
    assert missing.status_code == 404


async def test_the_detail_has_the_record_and_the_transitions(house: House) -> None:
    viewer = await house.program(Role.VIEWER)
    estop(house.services, active=True)
    (alarm,) = await present(viewer)
    await house.services.buses[BUS][BusAlarms].list.write()
    detail = (await viewer.get(f"{API}/{alarm['id']}")).json()
    assert (detail["record"]["severity"], detail["record"]["time_to_respond"]) == ("severe", "minutes")
    assert all(detail["record"].values())
    assert [each["trigger"] for each in detail["transitions"]] == ["rise"]


async def test_the_list_is_filtered(house: House) -> None:
    viewer = await house.program(Role.VIEWER)
    estop(house.services, active=True)
    estop(house.services, active=True, unit=2)
    assert {each["unit"] for each in await present(viewer)} == {1, 2}
    assert {each["unit"] for each in await present(viewer, unit=2)} == {2}
    assert await present(viewer, priority="low") == []
    assert await present(viewer, bus="other") == []
    assert (await viewer.get(API, params={"state": "odd"})).status_code == 422


async def test_what_cannot_be_recorded_did_not_happen(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    operator = await house.program(Role.OPERATOR)
    estop(house.services, active=True)
    (alarm,) = await present(operator)

    async def fails(**_: Any) -> int:
        raise StoreError(Message("store_closed"))

    with monkeypatch.context() as context:
        context.setattr(house.services[EventLog], "record", fails)
        refused = await act(operator, alarm["id"], "acknowledge")
    assert (refused.status_code, refused.json()["code"]) == (503, "store")
    assert [each["state"] for each in await present(operator)] == ["unack_active"]
    await house.services.buses[BUS][BusAlarms].list.write()
    journal = (await operator.get(f"{API}/journal")).json()["transitions"]
    assert [each["trigger"] for each in journal if each["code"] == "estop_active"] == ["rise"]


async def test_the_journal_goes_on_by_pages(house: House) -> None:
    viewer = await house.program(Role.VIEWER)
    for _ in range(3):
        estop(house.services, active=True)
        estop(house.services, active=False)
    alarms = house.services.buses[BUS][BusAlarms]
    assert isinstance(alarms, BusAlarms)
    await alarms.list.write()
    found, before = [], None
    while True:
        query = {"limit": 2} | ({"before": before} if before else {})
        page = (await viewer.get(f"{API}/journal", params=query)).json()
        found += page["transitions"]
        before = page["next"]
        if before is None:
            break
    assert [each["id"] for each in found] == sorted((each["id"] for each in found), reverse=True)
    assert sum(each["code"] == "estop_active" for each in found) == 6


async def test_occurrences_of_the_units_shown_are_in_the_language_of_the_reader(house: House) -> None:
    viewer = await house.program(Role.VIEWER)
    viewer.headers["Accept-Language"] = "de"
    estop(house.services, active=True)
    await house.services[LineAlarms].write()
    here = (await viewer.get(f"{API}/occurrences", params={"unit": f"{BUS}/1"})).json()
    (mark,) = (each for each in here["occurrences"] if each["unit"] == 1)
    assert (mark["alarm"], mark["to"], here["more"]) == (f"{BUS}.1.estop_active.1", None, False)
    assert mark["shown"] == {"name": "Not-Halt", "place": "Unwind"}
    there = (await viewer.get(f"{API}/occurrences", params={"unit": f"{BUS}/2"})).json()
    assert all(each["unit"] in (2, None) for each in there["occurrences"])


async def test_silence_ends_the_sound_and_nothing_else_until_it_comes_again(house: House) -> None:
    operator, alarms = await house.program(Role.OPERATOR), house.services[LineAlarms]
    estop(house.services, active=True)
    (alarm,) = await present(operator)
    done = (await act(operator, alarm["id"], "silence", comment="on my way")).json()
    assert (done["silenced"], done["state"], done["acknowledged"]) == (True, "unack_active", False)
    assert alarms.sounding() == []
    again = await act(operator, alarm["id"], "silence")
    assert (again.status_code, again.json()["code"]) == (409, "not_in_state")
    (entry,) = [e for e in await house.events("alarm") if "silenced" in e["what"]]
    assert (entry["who"], entry["message"]) == (f"key-{Role.OPERATOR}", "on my way")
    (transition,) = (await operator.get(f"{API}/journal?limit=1")).json()["transitions"]
    assert (transition["trigger"], transition["before"]) == ("silence", transition["after"])
    estop(house.services, active=False)
    estop(house.services, active=True)
    assert [each.id for each in alarms.sounding()] == [f"{BUS}.1.estop_active.2"]


async def test_a_press_silences_what_sounded_and_not_what_came_since(house: House) -> None:
    alarms = house.services[LineAlarms]
    viewer, operator = await house.signed_in(Role.VIEWER), await house.signed_in(Role.OPERATOR)
    estop(house.services, active=True)
    until = {"until": str(float(alarms.sounding()[0].facts.since or 0.0))}
    estop(house.services, active=True, unit=2)
    assert (await viewer.post("/alarms/silence", data=until)).status_code == 403
    assert (await operator.post("/alarms/silence", data=until)).status_code == 204
    assert [each.definition.unit for each in alarms.sounding()] == [2]
    assert "silenced" in (await operator.get(f"/alarms/{BUS}.1.estop_active.1")).text
    await operator.post(f"/alarms/{BUS}.2.estop_active.1/silence")
    assert alarms.sounding() == []
