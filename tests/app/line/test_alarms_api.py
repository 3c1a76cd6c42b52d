"""Alarms over HTTP, as data and as pages: who may do what, which occurrence is meant, and what is
recorded."""

from __future__ import annotations

import re
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import msgspec
import pytest

from app.core.web.access import Role
from app.errors import StoreError
from app.line.alarms.bus_alarms import BusAlarms
from app.line.alarms.line_alarms import AlarmBanner, LineAlarms
from app.line.alarms.performance import ObservedSpan
from app.line.alarms.rules import AlarmFacts
from app.line.live.browser import Browser
from app.line.live.bus_live import LiveState
from app.line.live.hub import Hub
from app.people.audit.log import EventLog
from app.records.handover.rules import EVERYTHING, Shift
from app.records.reports.service import Reports
from bus.contract import BusLink, Reading
from bus.instants import UnixTime, unix_now
from bus.messages import Message
from tests.app.complete_app import House, complete_app
from tests.app.played_line import BUS, HEALTHY, estop, played_line
from tests.app.screens import translator
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
    came, before = (
        page.partition(f'<h2 id="{title}">')[2].partition("</section>")[0] for title in ("alarms", "standing")
    )
    assert "active, acknowledged" in came
    assert "cleared, not acknowledged" in came
    assert "active, not acknowledged" not in came
    assert "No earlier alarm was active" in before, "each is listed once"


async def test_a_report_keeps_what_was_active_in_its_span_and_says_what_came_again(house: House) -> None:
    operator = await house.program(Role.OPERATOR)
    estop(house.services, active=True)
    await house.services[LineAlarms].write()
    start = unix_now()
    await act(operator, f"{BUS}.1.estop_active.1", "acknowledge")
    estop(house.services, active=False)
    for active in (True, False, True):
        estop(house.services, active=active, unit=2)
    await act(operator, f"{BUS}.2.estop_active.2", "shelve", reason="fitter at work", minutes=5)
    estop(house.services, active=False, unit=2)
    await house.services[LineAlarms].write()
    report = await house.services[Reports].report(Shift(start, UnixTime(unix_now() + 60)), EVERYTHING)
    assert [(each["alarm"], each["after"]) for each in report["before"]] == [
        (f"{BUS}.1.estop_active.1", "normal")
    ]
    assert [(each["alarm"], "again_at" in each) for each in report["alarms"]] == [
        (f"{BUS}.2.estop_active.1", True),
        (f"{BUS}.2.estop_active.2", False),
    ]
    (shelved,) = report["shelved"]
    assert (shelved["who"], shelved["reason"]) == ("key-operator", "fitter at work")
    assert shelved["shelved_until"] > shelved["came"]
    assert "shelved: condition cleared" in (await operator.get("/alarms/journal")).text
    page = (await operator.get("/shifts/present", follow_redirects=True)).text
    assert re.search(r"shelved until \d\d:\d\d", page)


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
    listed = await page(operator, f"/alarms/list?shown={ESTOP}")
    cell = r'data-head="(?:Came|Cleared|Acknowledged)">(?:<span>)?<time datetime="([^"]+)"'
    assert len(set(re.findall(cell, listed))) == 3


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
    await house.services[LineAlarms].write()
    drawn = (await operator.get(f"{API}/occurrences")).json()["occurrences"]
    assert [each["to"] for each in drawn if each["alarm"] == alarm["id"]] == [None], "it is still active"
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


@for_each("alarm", ["nothing", f"{BUS}.1.estop_active", f"{BUS}.1.estop_active.x", "..", "a.²"])
async def test_an_unknown_alarm_is_not_found(house: House, alarm: str) -> None:
    viewer = await house.program(Role.VIEWER)
    missing = await viewer.get(f"{API}/{alarm}")
    assert missing.status_code == 404


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


ESTOP = f"{BUS}.1.estop_active"


async def page(client: httpx.AsyncClient, path: str) -> str:
    response = await client.get(path)
    assert response.status_code == 200, response.text
    return response.text


def state(house: House, key: str = ESTOP) -> str:
    return house.services[LineAlarms].buses[BUS].list.alarms[key].facts.state


async def test_the_summary_has_the_present_alarms_and_only_an_operator_may_act(house: House) -> None:
    estop(house.services, active=True)
    viewer, operator = await house.signed_in(Role.VIEWER), await house.signed_in(Role.OPERATOR)
    for_viewer, for_operator = await page(viewer, "/alarms"), await page(operator, "/alarms")
    assert "Emergency stop" in for_viewer
    assert "Acknowledge alarm" not in for_viewer
    assert f'name="id" value="{ESTOP}.1"' in for_operator


async def test_the_alarms_shown_are_acknowledged_but_not_one_that_came_again(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    estop(house.services, active=True)
    estop(house.services, active=True, unit=2)
    shown = re.findall(rf'name="id" value="({BUS}[^"]+)"', await page(operator, "/alarms"))
    estop(house.services, active=False)
    estop(house.services, active=True)
    done = await operator.post("/alarms/acknowledge", data={"id": sorted(set(shown))})
    assert "left_out=1" in done.headers["location"]
    assert (state(house), state(house, f"{BUS}.2.estop_active")) == ("unack_active", "ack_active")
    assert "had changed and was not acknowledged" in await page(operator, done.headers["location"])


def rows(text: str) -> list[str]:
    """The alarms of the list, in their order."""
    return re.findall(r'name="shown" value="([^"]+)"', text)


async def test_no_row_moves_until_the_list_is_opened_again(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    estop(house.services, active=True)
    remote_off(house, unit=2)
    shown = rows(await page(operator, "/alarms"))
    local = f"{BUS}.2.not_in_remote"
    assert shown == [ESTOP, local]
    done = await operator.post("/alarms/acknowledge", data={"id": f"{ESTOP}.1", "shown": shown})
    assert "1 alarm acknowledged</hx-partial>" in done.text, "a screen reader hears it"
    assert (done.status_code, done.headers["hx-retarget"]) == (200, "#alarms")
    assert rows(done.text) == shown
    estop(house.services, active=False)
    estop(house.services, active=True, unit=2)
    redrawn = await operator.get("/alarms/list", params={"shown": shown})
    assert rows(redrawn.text) == [ESTOP, local, f"{BUS}.2.estop_active"]
    assert "normal" in redrawn.text
    said = redrawn.text
    assert re.search(r"1 new alarm is last in the list: .* · Emergency stop", said)
    assert re.findall(r'name="came" value="([^"]+)"', redrawn.text) == [f"{BUS}.2.estop_active"]
    query = {"shown": rows(redrawn.text), "came": [f"{BUS}.2.estop_active"]}
    again = await operator.get("/alarms/list", params=query)
    together = again.text[again.text.index("alarm-order") : again.text.index("alarms-result")]
    assert f"{BUS}.2.estop_active" not in together, "what acknowledges all leaves out who came out of sight"
    assert rows(await page(operator, "/alarms")) == [f"{BUS}.2.estop_active", local]


async def test_a_row_that_was_never_an_alarm_is_not_listed(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    assert "No alarm is present." in await page(operator, "/alarms/list?shown=nowhere.9.estop_active")
    too_many = await operator.get("/alarms/list", params={"shown": ["x"] * 101})
    assert too_many.status_code == 422


async def test_the_list_is_filtered_by_place_priority_state_and_group(house: House) -> None:
    viewer = await house.signed_in(Role.VIEWER)
    assert "No alarm is present." in await page(viewer, "/alarms/list")
    assert "No alarm matches the filter." in await page(viewer, "/alarms/list?priority=low")
    estop(house.services, active=True)
    for query, is_in in (
        (f"place={BUS}/1", True),
        (f"place={BUS}/2", False),
        ("priority=low", False),
        ("state=unack_active", True),
        ("state=shelved", False),
        ("group=drive", True),
        ("group=communication", False),
    ):
        assert ("Emergency stop" in await page(viewer, f"/alarms/list?{query}")) is is_in


async def test_one_page_has_the_record_and_shelves_with_a_reason(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    estop(house.services, active=True)
    text = await page(operator, f"/alarms/{ESTOP}.1")
    assert "Go to the machine, find the reason" in text
    assert "Take alarm out of service" not in text
    refused = await operator.post(f"/alarms/{ESTOP}.1/shelve", data={"minutes": "30", "reason": " "})
    assert (refused.status_code, state(house)) == (422, "unack_active")
    await operator.post(f"/alarms/{ESTOP}.1/shelve", data={"minutes": "30", "reason": "chatters"})
    assert state(house) == "shelved"
    assert "the-operator: chatters" in await page(operator, f"/alarms/{ESTOP}.1")
    await operator.post(f"/alarms/{ESTOP}.1/unshelve")
    assert state(house) == "unack_active"


async def test_an_alarm_to_acknowledge_again_says_who_had_acknowledged_it(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    estop(house.services, active=True)
    await operator.post("/alarms/acknowledge", data={"id": f"{ESTOP}.1"})
    assert "Was acknowledged" not in await page(operator, f"/alarms/{ESTOP}.1")
    await operator.post(f"/alarms/{ESTOP}.1/shelve", data={"minutes": "30", "reason": "chatters"})
    await operator.post(f"/alarms/{ESTOP}.1/unshelve")
    assert "by the-operator. Acknowledge it again" in await page(operator, f"/alarms/{ESTOP}.1")
    assert "active, not acknowledged" in await page(operator, "/alarms/list")


async def test_a_link_to_a_former_occurrence_leads_to_the_present_one(house: House) -> None:
    viewer = await house.signed_in(Role.VIEWER)
    estop(house.services, active=True)
    moved = await viewer.get(f"/alarms/{ESTOP}.0")
    assert (moved.status_code, moved.headers["location"]) == (303, f"/alarms/{ESTOP}.1")


async def test_the_journal_is_found_by_unit_priority_state_day_and_the_names_people_use(house: House) -> None:
    viewer = await house.signed_in(Role.VIEWER)
    estop(house.services, active=True)
    remote_off(house, unit=2)
    await house.services[LineAlarms].write()
    first, second = (house.services[LineAlarms].place(BUS, unit) for unit in (1, 2))
    for query, of_first, of_second in (
        ("", True, True),
        (f"place={BUS}/2", False, True),
        (f"place={BUS}", True, True),
        ("priority=urgent", True, False),
        ("state=unack_active", True, True),
        ("state=shelved", False, False),
        ("day=2020-01-01", False, False),
        (f"search={first.upper()}", True, False),
        (f"search={second} remote", False, True),
        ("search=nowhere", False, False),
        ("place=nowhere/999999&before=1", False, False),
    ):
        text = await page(viewer, f"/alarms/journal?{query}")
        found = (">Emergency stop</th>" in text, ">Not in REMOTE</th>" in text)
        assert found == (of_first, of_second), query
    viewer.headers["Accept-Language"] = "de"
    assert ">Not-Halt</th>" in await page(viewer, f"/alarms/journal?search=not-halt {first}")


HEAD = re.compile(
    r'class="button top__alarm alarm-priority".*?data-is="([^"]*)".*?"alarms_present.active"[^>]*>([^<]*)<'
    r'.*?"alarms_present.waiting"[^>]*>([^<]*)<',
    re.S,
)


def head(text: str) -> tuple[str, ...]:
    """The mark of the first alarm in the head of a page, and how many are active and wait."""
    found = HEAD.search(text)
    assert found is not None
    return found.groups()


async def test_every_page_counts_the_alarms_before_a_script_runs(house: House) -> None:
    viewer = await house.signed_in(Role.VIEWER)
    assert head(await page(viewer, "/events")) == ("", "No alarms", "")
    estop(house.services, active=True)
    for path in ("/", "/events", "/alarms"):
        assert head(await page(viewer, path)) == ("urgent waiting", "1 alarm active", "1 to acknowledge")
    viewer.headers["Accept-Language"] = "de"
    assert head(await page(viewer, "/events"))[1:] == ("1 Alarm aktiv", "1 zu quittieren")
    line = await page(viewer, "/?view=tiles")
    assert f'data-live-is="{BUS}/1.worn" data-is="urgent waiting"' in line
    assert f'class="tile__blocked"\n  data-live-is="{BUS}/1.blocked"' in line
    row = await page(viewer, "/setpoints")
    assert re.search(rf'class="setpoints__alarm"\s+data-live-is="{BUS}/1.words"', row), "as on the tile"
    words = re.search(r'class="tile__why"[^>]*><b[^>]*>([^<]*)</b>\s*<span><span[^>]*>([^<]*)<', line)
    assert words is not None
    assert words[1] == "Not-Halt"
    assert words[2].startswith("aktiv seit")


def facts_of(house: House, unit: int = 1, code: str = "estop_active") -> AlarmFacts:
    return house.services[LineAlarms].buses[BUS].list.alarms[f"{BUS}.{unit}.{code}"].facts


async def test_the_head_has_active_alarms_before_cleared_ones_whatever_the_priority(house: House) -> None:
    banner, now = AlarmBanner(house.services[LineAlarms]), unix_now()
    operator = await house.signed_in(Role.OPERATOR)

    def shown() -> tuple[str, ...]:
        return tuple(banner.banner(translator())[field] for field in ("mark", "active", "waiting"))

    estop(house.services, active=True)
    estop(house.services, active=False)
    assert shown() == ("urgent cleared waiting", "No alarm active", "1 to acknowledge")
    at = translator().formats.since(facts_of(house).cleared or now, now)
    assert banner.unit_fields(BUS, 1, translator(), now) == {
        "alarm": "urgent cleared waiting",
        "alarm_text": "Emergency stop",
        "alarm_said": "Emergency stop, urgent",
        "alarm_state": f"cleared {at}",
        "alarm_more": "",
        "alarm_at": f"/alarms/{ESTOP}.1",
    }
    assert banner.delay_s(f"{BUS}/2", "not_in_remote") == 5
    remote_off(house, unit=2)
    assert banner.delay_s(f"{BUS}/2", "not_in_remote") == 0, "it is in the list"
    assert banner.since(f"{BUS}/2", "not_in_remote") == facts_of(house, 2, "not_in_remote").came
    assert banner.since(f"{BUS}/1", "estop_active") is None, "it has cleared"
    assert (banner.delay_s(BUS, "worker_lost"), banner.delay_s(BUS, "no_unit_yet")) == (10, 0)
    assert shown() == ("low waiting", "1 alarm active", "2 to acknowledge")
    await operator.post("/alarms/acknowledge", data={"id": f"{BUS}.2.not_in_remote.1"})
    assert shown() == ("low", "1 alarm active", "1 to acknowledge")
    await operator.post("/alarms/acknowledge", data={"id": f"{ESTOP}.1"})
    assert shown() == ("low", "1 alarm active", "")
    assert set(banner.unit_fields(BUS, 1, translator(), now).values()) == {""}


async def test_an_acknowledged_emergency_stop_stays_first_and_does_not_blink(house: House) -> None:
    banner = AlarmBanner(house.services[LineAlarms])
    operator = await house.signed_in(Role.OPERATOR)
    estop(house.services, active=True)
    remote_off(house, unit=2)
    assert banner.banner(translator())["mark"] == "urgent waiting"
    await operator.post("/alarms/acknowledge", data={"id": f"{ESTOP}.1"})
    assert banner.banner(translator())["mark"] == "urgent"
    text = await page(operator, "/alarms")
    assert text.index(">Emergency stop</a>") < text.index(">Not in REMOTE</a>")


def remote_off(house: House, unit: int) -> None:
    """A unit is in LOCAL, for longer than the delay of its alarm."""
    live = house.services[LiveState].buses[BUS]
    live.apply([Reading(unit, time.time(), 0, 0, 0, 0, HEALTHY)])
    house.services[LineAlarms].buses[BUS].list.advance(unix_now() + 10)


async def test_an_unknown_condition_is_not_shown_as_active(house: House) -> None:
    estop(house.services, active=True)
    alarm = house.services[LineAlarms].buses[BUS].list.alarms[ESTOP]
    alarm.facts = replace(alarm.facts, unknown_since=unix_now())
    banner = AlarmBanner(house.services[LineAlarms])
    fields = banner.unit_fields(BUS, 1, translator(), unix_now())
    assert fields["alarm_state"].startswith("unknown since")
    assert banner.banner(translator())["active"] == "1 alarm unknown"
    remote_off(house, unit=2)
    assert banner.banner(translator())["active"] == "1 active, 1 unknown"


async def test_an_alarm_unknown_since_its_port_closed_stays_on_its_unit_and_before_cleared_ones(
    house: House,
) -> None:
    engineer = await house.signed_in(Role.ENGINEER)
    estop(house.services, unit=2, active=True)
    estop(house.services, unit=2, active=False)
    remote_off(house, unit=1)
    house.services[LiveState].buses[BUS].apply([BusLink(at=time.time(), link="closed")])
    house.services[LineAlarms].tick()
    fields = AlarmBanner(house.services[LineAlarms]).unit_fields(BUS, 1, translator(), unix_now())
    assert (fields["alarm_text"], fields["alarm_state"][:13]) == ("Not in REMOTE", "unknown since")
    text = await page(engineer, "/alarms")
    assert text.index(">Not in REMOTE</a>") < text.index(">Emergency stop</a>")


async def test_a_beat_of_the_pages_learns_that_nobody_reads_a_unit_any_more(house: House) -> None:
    hub, live = house.services[Hub], house.services[LiveState].buses[BUS]
    estop(house.services, active=True)
    hub.join(Browser("ann", "viewer", "en"))
    hub.tick()
    assert not facts_of(house).unknown_since
    live.units[1].reading = msgspec.structs.replace(live.units[1].reading, at=unix_now() - 5)
    hub.tick()
    assert facts_of(house).unknown_since


async def test_pages_learn_when_it_is_not_known_any_more_and_when_it_is_again(house: House) -> None:
    estop(house.services, active=True)
    alarms = house.services[LineAlarms].buses[BUS].list
    published: list[bool] = []
    alarms.subscribe(lambda changed: published.append(changed.facts.unknown_since is not None))
    for holds in (None, True):
        alarms.observe(alarms.alarms[ESTOP], holds, unix_now())
    assert published == [True, False]


async def test_the_figures_are_a_page_and_data_and_a_file(house: House) -> None:
    viewer = await house.signed_in(Role.VIEWER)
    estop(house.services, active=True)
    await house.services[LineAlarms].write()
    assert "observed for less than 10 minutes" in await page(viewer, "/alarms/performance")
    now = unix_now()
    await house.services[LineAlarms].store.write_observed(BUS, ObservedSpan(now - 3600, now))
    assert "observed for 1.0 of 24 hours" in await page(viewer, "/alarms/performance?days=1")
    text = await page(viewer, "/alarms/performance?days=1")
    assert "Alarms in 10 minutes, peak" in text
    assert "Emergency stop" in text
    found = (await viewer.get("/api/v1/alarms/performance")).json()
    figures = {figure["code"]: figure for figure in found["figures"]}
    assert figures["annunciated"]["value"] == figures["standing"]["value"] == 1
    assert (figures["urgent_share"]["at_most"], figures["urgent_share"]["met"]) == (0.01, False)
    assert [top["alarm"] for top in found["most_frequent"]] == [ESTOP]
    rows = (await page(viewer, "/api/v1/alarms/performance.csv")).splitlines()
    assert rows[0] == "code,value,at_most,at_least,met,from,to,observed_s"
    assert rows[1].startswith(f"annunciated,1,,,,{found['from']},")
    assert 3600 <= found["observed_s"] < 4000
    assert len(rows) == len(figures) + 1
    metrics = await page(viewer, "/metrics")
    assert 'lineside_alarms{priority="urgent",state="unack_active"} 1.0' in metrics
    assert 'lineside_alarms{priority="low",state="shelved"} 0.0' in metrics
    for figure in ("active", "unacknowledged", "annunciated_total"):
        assert f'lineside_alarm_{figure}{{bus="{BUS}",priority="urgent"}} 1.0' in metrics
    assert 'lineside_alarm_out_of_service{bus="",priority="low"} 0.0' in metrics


async def test_figures_are_of_a_month_at_most(house: House) -> None:
    viewer = await house.signed_in(Role.VIEWER)
    refused = await viewer.get(
        "/api/v1/alarms/performance", params={"from": "2026-01-01T00:00:00Z", "to": "2026-03-01T00:00:00Z"}
    )
    assert (refused.status_code, refused.json()["detail"]) == (422, "at most 31 days at once")
