"""The pages of alarms as the server sends them, in both languages."""

from __future__ import annotations

import re
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import httpx
import pytest

from app.core.web.access import Role
from app.line.alarms.bus_alarms import BusAlarms
from app.line.alarms.line_alarms import AlarmBanner, LineAlarms
from app.line.alarms.performance import ObservedSpan
from app.line.alarms.rules import AlarmFacts
from app.line.live.bus_live import LiveState
from app.line.live.hub import Hub
from app.line.live.screen import ALARM_GROUP
from bus.contract import Reading
from bus.instants import UnixTime, unix_now
from tests.app.complete_app import House, complete_app
from tests.app.played_line import BUS, HEALTHY, estop, played_line
from tests.app.screens import translator

ESTOP = f"{BUS}.1.estop_active"


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        await played_line(house.services)
        house.services.buses[BUS][BusAlarms].tick()
        yield house


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


async def test_an_alarm_is_acknowledged_from_the_list(house: House) -> None:
    estop(house.services, active=True)
    operator = await house.signed_in(Role.OPERATOR)
    done = await operator.post("/alarms/acknowledge?priority=urgent", data={"id": f"{ESTOP}.1"})
    assert (done.status_code, done.headers["location"]) == (303, "/alarms?priority=urgent")
    assert state(house) == "ack_active"


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
    assert (done.status_code, done.headers["hx-retarget"]) == (200, "#alarms")
    assert rows(done.text) == shown
    estop(house.services, active=False)
    estop(house.services, active=True, unit=2)
    redrawn = await operator.get("/alarms/list", params={"shown": shown})
    assert rows(redrawn.text) == [ESTOP, local, f"{BUS}.2.estop_active"]
    assert "normal" in redrawn.text
    assert rows(await page(operator, "/alarms")) == [f"{BUS}.2.estop_active", local]


async def test_a_row_that_was_never_an_alarm_is_not_listed(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    assert "No alarm is present." in await page(operator, "/alarms/list?shown=nowhere.9.estop_active")
    too_many = await operator.get("/alarms/list", params={"shown": ["x"] * 101})
    assert too_many.status_code == 422


async def test_the_list_reports_what_had_changed_before_it_was_acknowledged(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    estop(house.services, active=True)
    estop(house.services, active=False)
    estop(house.services, active=True)
    done = await operator.post("/alarms/acknowledge", data={"id": f"{ESTOP}.1", "shown": ESTOP})
    assert "had changed and was not acknowledged" in done.text
    assert state(house) == "unack_active"


async def test_the_list_has_the_three_times_and_an_acknowledgement_leaves_the_first(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    estop(house.services, active=True)

    async def times() -> list[str]:
        text = await page(operator, f"/alarms/list?shown={ESTOP}")
        cell = r'data-head="(?:Came|Cleared|Acknowledged)">(?:<span>)?(?:<time datetime="([^"]+)")?'
        return re.findall(cell, text)

    came, *others = await times()
    assert (bool(came), others) == (True, ["", ""])
    await operator.post("/alarms/acknowledge", data={"id": f"{ESTOP}.1"})
    estop(house.services, active=False)
    after = await times()
    assert after[0] == came
    assert all(after)


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


async def test_an_engineer_takes_it_out_of_service_and_returns_it(house: House) -> None:
    engineer = await house.signed_in(Role.ENGINEER)
    await engineer.post(f"/alarms/{ESTOP}.0/out-of-service", data={"reason": "rebuilt"})
    assert state(house) == "out_of_service"
    await engineer.post(f"/alarms/{ESTOP}.0/in-service")
    assert state(house) == "normal"


async def test_a_link_to_a_former_occurrence_leads_to_the_present_one(house: House) -> None:
    viewer = await house.signed_in(Role.VIEWER)
    estop(house.services, active=True)
    moved = await viewer.get(f"/alarms/{ESTOP}.0")
    assert (moved.status_code, moved.headers["location"]) == (303, f"/alarms/{ESTOP}.1")


async def test_the_journal_is_in_the_language_of_the_reader(house: House) -> None:
    viewer = await house.signed_in(Role.VIEWER)
    estop(house.services, active=True)
    await house.services[LineAlarms].write()
    viewer.headers["Accept-Language"] = "de"
    text = await page(viewer, "/alarms/journal")
    assert "Not-Halt" in text
    assert "aktiv, nicht quittiert" in text
    assert "Alarmjournal" in text


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
    assert f'data-live-is="{BUS}/1.alarm" data-is="urgent waiting"' in line
    words = re.search(r'class="tile__why"><b[^>]*>([^<]*)</b>\s*<span[^>]*>([^<]*)<', line)
    assert words is not None
    assert words[1] == "Not-Halt"
    assert words[2].startswith("aktiv seit")


def facts_of(house: House, unit: int = 1) -> AlarmFacts:
    return house.services[LineAlarms].buses[BUS].list.alarms[f"{BUS}.{unit}.estop_active"].facts


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
        "alarm_state": f"cleared {at}",
        "alarm_more": "",
        "alarm_at": f"/alarms/{ESTOP}.1",
    }
    assert banner.delay_s(f"{BUS}/2", "not_in_remote") == 5
    remote_off(house, unit=2)
    assert banner.delay_s(f"{BUS}/2", "not_in_remote") == 0, "it is in the list"
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
    fields = AlarmBanner(house.services[LineAlarms]).unit_fields(BUS, 1, translator(), unix_now())
    assert fields["alarm_state"].startswith("unknown since")


async def test_an_alarm_of_another_day_shows_its_date(house: House) -> None:
    estop(house.services, active=True)
    banner, came = AlarmBanner(house.services[LineAlarms]), facts_of(house).came or unix_now()
    later = UnixTime(came + 3 * 86_400.0)
    state = banner.unit_fields(BUS, 1, translator(), later)["alarm_state"]
    assert state == f"active since {translator().formats.since(came, later)}"
    assert "," in state


async def test_an_open_page_gets_the_alarm_without_a_request(house: House) -> None:
    hub = house.services[Hub]
    assert isinstance(hub, Hub)
    screen = hub.screen("en")
    before = screen.shown[ALARM_GROUP]["changed"]
    estop(house.services, active=True)
    assert hub.screen("en").shown[ALARM_GROUP]["changed"] != before


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
