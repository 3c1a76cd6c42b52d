"""The sheet of a shift, its notes, and signing it over, as page and API."""

from __future__ import annotations

import asyncio
import hashlib
import html
import re
import sqlite3
import time
from collections.abc import AsyncIterator
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from unittest.mock import AsyncMock

import httpx
import pytest
from click.testing import CliRunner

from app.cli import cli
from app.core.database import Database, StoreConnection
from app.core.database.migration import MIGRATIONS
from app.core.web.access import Person, Role
from app.errors import StoreError
from app.line.alarms.bus_alarms import BusAlarms
from app.line.alarms.line_alarms import LineAlarms
from app.line.commands.limits import Limits
from app.line.commands.safeguards import Safeguards
from app.line.live.bus_live import LiveState
from app.people.audit.log import EventLog
from app.records.handover.rules import Shift
from app.records.handover.service import Handover, Signing
from app.records.handover.sheet import first_gap, write_sheet
from app.records.handover.signatures import missing_signatures
from bus.contract import BusLink, Reading
from bus.instants import UnixTime
from bus.messages import Message
from tests.app.complete_app import PASSWORD, House, complete_app
from tests.app.intents import intend
from tests.app.played_line import BUS, HEALTHY, REMOTE, played_line
from tests.for_each import for_each

API = "/api/v1/shifts"
ANN = Person("ann", Role.ENGINEER, "demo")


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path, time_zone="Europe/Berlin") as house:
        await played_line(house.services)
        house.services.buses[BUS][BusAlarms].tick()
        yield house


async def present(client: httpx.AsyncClient) -> str:
    """The start of the shift under way."""
    start: str = (await client.get(API)).json()["shifts"][0]["start"]
    return start


async def sheet(client: httpx.AsyncClient) -> dict[str, Any]:
    response = await client.get(f"{API}/{await present(client)}")
    assert response.status_code == 200, response.text
    found: dict[str, Any] = response.json()
    return found


async def test_the_figures_of_a_sheet_are_as_new_as_the_sheet(house: House) -> None:
    viewer = await house.program(Role.VIEWER)
    counted = (await sheet(viewer))["line"]["alarms"]
    rise = (time.time(), "a", 1, "estop_active", "", BUS, 1, "urgent", "rise", "", "unack_active", "", "")
    add = f"INSERT INTO alarm_journal VALUES (NULL, {', '.join('?' * len(rise))})"
    await house.services[Database].write(lambda store: store.execute(add, rise))
    assert (await sheet(viewer))["line"]["alarms"] == counted + 1


async def test_the_list_asks_for_figures_again_until_it_has_them(house: House) -> None:
    viewer = await house.signed_in(Role.VIEWER)
    first = (await viewer.get("/shifts")).text
    assert "being read" in first
    assert 'hx-trigger="every 1s"' in first
    for _ in range(100):
        await asyncio.sleep(0.1)
        last = (await viewer.get("/shifts")).text
        if "every 1s" not in last:
            break
    assert "being read" not in last


async def test_the_list_stops_asking_for_figures_that_cannot_be_read(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer = await house.signed_in(Role.VIEWER)
    figures = house.services[Handover].figures
    monkeypatch.setattr(
        figures, "shift", AsyncMock(side_effect=StoreError(Message.of("store_missing", path="/x")))
    )
    for _ in range(100):
        last = (await viewer.get("/shifts")).text
        if "every 1s" not in last:
            break
        await asyncio.sleep(0.1)
    assert ("cannot be read" in last, "being read" in last) == (True, False)
    assert "every 1s" not in last


async def write(client: httpx.AsyncClient, text: str, key: str = "", **more: Any) -> httpx.Response:
    headers = {"Idempotency-Key": key} if key else {}
    body = {"text": text, **more}
    return await client.post(f"{API}/{await present(client)}/notes", json=body, headers=headers)


async def test_the_sheet_is_made_from_the_store(house: House) -> None:
    viewer, guards = await house.program(Role.VIEWER), house.services.buses[BUS][Safeguards]
    house.services[LiveState].buses[BUS].apply([Reading(1, time.time(), 0, 0, 0, REMOTE, 0)])
    await house.services[LineAlarms].write()
    await guards.block(ANN, 1, "bearing")
    await guards.block(ANN, 2, "rebuilt")
    await guards.lift(ANN, 2)
    await guards.set_limits(ANN, 2, Limits(highest=500))
    await guards.take(ANN)
    await house.services[EventLog].record(
        kind="recipe", what=Message.of("event_recipe_loaded", name="Kraft", version=3), who="ann", bus=BUS
    )
    for happened in ("event_port_closed", "event_port_opened"):
        await house.services[EventLog].record(kind="bus", what=Message(happened), bus=BUS)
    for outcome in ("verified", "verified", "unverified"):
        number = await intend(
            house.services[EventLog],
            who="ann",
            origin="page",
            bus=BUS,
            unit=1,
            what=Message("event_set_speed"),
            old="1",
            new="2",
        )
        await house.services[EventLog].conclude(number, outcome)  # type: ignore[arg-type]
    found = await sheet(viewer)
    assert [(each["code"], each["after"]) for each in found["standing"] if each["unit"] == 1] == [
        ("estop_active", "unack_active")
    ]
    assert [(each["unit"], each["new"], each["who"]) for each in found["blocked"]] == [(1, "bearing", "ann")]
    assert [(each["unit"], each["new"]) for each in found["limits"]["events"]] == [(2, "highest 500")]
    assert found["recipes"]["events"][0]["what"] == "recipe Kraft version 3 loaded and verified"
    assert [each["what"] for each in found["control"]["events"]] == ["control taken"]
    assert [each["what"] for each in found["server"]["events"]][-2:] == ["port closed", "port opened"]
    assert found["done"]["outcomes"] == {"": 3, "unverified": 1, "verified": 2}
    assert [each["old"] for each in found["done"]["events"] if each["kind"] == "command"] == ["1"] * 3
    assert {each["code"] for each in found["omissions"]} >= {"shift_omits_drift", "shift_omits_control"}


async def test_active_alarms_come_before_cleared_ones_and_their_number_has_a_noun(house: House) -> None:
    operator, bus = await house.signed_in(Role.OPERATOR), house.services[LiveState].buses[BUS]
    bus.apply([Reading(1, time.time(), 0, 0, 0, REMOTE, 0)])
    bus.apply([Reading(1, time.time(), 0, 0, 0, REMOTE, HEALTHY)])
    bus.apply([Reading(2, time.time(), 0, 0, 0, REMOTE, 0)])
    await house.services[LineAlarms].write()
    standing = [each for each in (await sheet(operator))["standing"] if each["unit"]]
    assert [(each["unit"], each["after"]) for each in standing] == [(2, "unack_active"), (1, "rtn_unack")]
    assert "Alarms active or to acknowledge: <span" in " ".join(
        (await operator.get(f"/shifts/{await present(operator)}")).text.split()
    )


async def test_alarms_that_another_one_hides_are_in_a_section_and_a_note_may_name_them(house: House) -> None:
    operator, live = await house.signed_in(Role.OPERATOR), house.services[LiveState].buses[BUS]
    live.apply([Reading(1, time.time(), 0, 0, 0, REMOTE, 0)])
    live.apply([BusLink(at=time.time(), link="closed")])
    await house.services[LineAlarms].write()
    found = await sheet(operator)
    assert [(each["unit"], each["code"]) for each in found["suppressed"]] == [(1, "estop_active")]
    assert {each["code"] for each in found["standing"]} == {"port_lost"}
    page = (await operator.get(f"/shifts/{await present(operator)}")).text
    section = page.partition('<h2 id="suppressed">')[2].partition("</section>")[0]
    assert "Emergency stop" in section
    form = (await operator.get(f"/shifts/{await present(operator)}/note")).text
    assert f'<option value="{BUS}.1.estop_active.1"' in form
    operator.headers["Accept-Language"] = "de"
    assert (
        "Automatisch unterdrückte Alarme" in (await operator.get(f"/shifts/{await present(operator)}")).text
    )


async def test_the_page_shows_it_in_both_languages(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    await house.services.buses[BUS][Safeguards].block(ANN, 1, "bearing")
    await write(operator, "Felt changed\nat the <b>dryer</b>", bus=BUS, unit=1)
    path = f"/shifts/{await present(operator)}"
    text = (await operator.get(path)).text
    for expected in (
        "Felt changed\nat the &lt;b&gt;dryer",
        "Write note",
        "commands blocked",
        "bearing",
        "Unwind",
    ):
        assert expected in text
    operator.headers["Accept-Language"] = "de"
    text = (await operator.get(path)).text
    for expected in ("Notiz schreiben", "Regler mit gesperrten Befehlen", "Befehle gesperrt"):
        assert expected in text
    shifts = (await operator.get("/shifts")).text
    assert "Schichten" in shifts
    assert "läuft" in shifts
    earlier = (await operator.get("/shifts?day=21.11.2020")).text
    assert "21.11.2020, 22:00" in earlier
    assert "22.11.2020" not in earlier
    assert (await operator.get("/shifts?day=yesterday")).status_code == 422


async def test_a_viewer_reads_and_an_operator_writes(house: House) -> None:
    viewer, operator = await house.signed_in(Role.VIEWER), await house.signed_in(Role.OPERATOR)
    assert (await write(viewer, "x")).status_code == 403
    page = (await viewer.get(f"/shifts/{await present(viewer)}")).text
    assert "Write note" not in page
    written = await write(operator, "Felt changed", unit=1, bus=BUS)
    assert (written.status_code, written.json()["who"], written.json()["unit"]) == (201, "the-operator", 1)
    assert [note["text"] for note in (await sheet(viewer))["notes"]] == ["Felt changed"]
    (event,) = await house.events("shift")
    assert (event["who"], event["message"], event["unit"]) == ("the-operator", "Felt changed", 1)


async def test_the_form_stores_a_note_once_however_often_it_is_sent(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    path = f"/shifts/{await present(operator)}"
    form = {"text": "Felt\r\nchanged", "clock": "", "place": f"{BUS}/2", "alarm": "", "key": "k1"}
    for _ in range(2):
        sent = await operator.post(f"{path}/notes", data=form)
        assert (sent.status_code, sent.headers["location"].partition("#")[2]) == (303, "note-1")
    (note,) = (await sheet(operator))["notes"]
    assert (note["text"], note["bus"], note["unit"]) == ("Felt\nchanged", BUS, 2)
    assert len(await house.events("shift")) == 1


async def test_a_correction_is_a_new_note_and_a_note_has_one(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    first = (await write(operator, "Felt changed")).json()
    second = (await write(operator, "Wire changed", corrects=first["id"])).json()
    assert (second["corrects"], second["time"]) == (first["id"], first["time"])
    again = await write(operator, "Roll changed", corrects=first["id"])
    assert (again.status_code, again.json()["code"], again.json()["id"]) == (409, "superseded", second["id"])
    found = (await sheet(operator))["notes"]
    assert [(note["text"], note["corrected_by"]) for note in found] == [
        ("Felt changed", second["id"]),
        ("Wire changed", None),
    ]
    path = f"/shifts/{await present(operator)}"
    assert "Corrected by note 2." in (await operator.get(path)).text
    form = (await operator.get(f"{path}/note?correct={second['id']}")).text
    assert ">Wire changed</textarea>" in form
    assert (await write(operator, "x", corrects=99)).json()["code"] == "unknown_note"


async def test_a_note_is_about_an_occurrence_that_was(house: House) -> None:
    operator = await house.program(Role.OPERATOR)
    house.services[LiveState].buses[BUS].apply([Reading(1, time.time(), 0, 0, 0, REMOTE, 0)])
    await house.services[LineAlarms].write()
    assert (await write(operator, "x", alarm=f"{BUS}.1.estop_active.1")).status_code == 201
    assert (await write(operator, "x", alarm=f"{BUS}.1.estop_active.2")).json()["code"] == "unknown_alarm"
    assert (await write(operator, "x", bus=BUS, unit=9)).json()["code"] == "unknown_unit"
    assert (await write(operator, "x", bus="wet-end")).json()["code"] == "unknown_bus"
    assert (await write(operator, "x", unit=1)).status_code == 422


def link_to_note(page: str) -> str:
    """The address of the link that leads to the form of a note."""
    (found,) = re.findall(r'href="(/shifts/present[^"]*)"', page)
    return html.unescape(found)


def chosen(page: str) -> dict[str, str]:
    """The choices of the form, by the names of its lists."""
    form = page.partition('id="write"')[2]
    lists = re.findall(r'name="(place|alarm)".*?</select>', form, re.DOTALL)
    values = re.findall(r'<option value="([^"]*)" selected>', form)
    return dict(zip(lists, values, strict=True))


async def test_the_page_of_an_alarm_and_of_a_unit_open_the_form_with_what_they_are_about(
    house: House,
) -> None:
    operator, viewer = await house.signed_in(Role.OPERATOR), await house.signed_in(Role.VIEWER)
    estop = f"{BUS}.1.estop_active.1"
    for status in (0, HEALTHY):
        house.services[LiveState].buses[BUS].apply([Reading(1, time.time(), 0, 0, 0, REMOTE, status)])
    await operator.post("/alarms/acknowledge", data={"id": estop})
    await house.services[LineAlarms].write()
    assert estop not in {each["alarm"] for each in (await sheet(operator))["standing"]}
    for path, expected in (
        (f"/alarms/{estop}", {"place": f"{BUS}/1", "alarm": estop}),
        (f"/units/{BUS}/2", {"place": f"{BUS}/2", "alarm": ""}),
    ):
        shown = await operator.get(link_to_note((await operator.get(path)).text))
        assert "/note?" in shown.headers["location"]
        assert chosen((await operator.get(shown.headers["location"])).text) == expected
        assert "/shifts/present?" not in (await viewer.get(path)).text
    assert "/shifts/present?" not in (await operator.get(f"/alarms/{BUS}.2.estop_active.0")).text


async def test_a_link_to_the_form_names_what_there_is(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    path = f"/shifts/{await present(operator)}/note"
    for wrong, status in (
        ({"alarm": f"{BUS}.1.estop_active.7"}, 404),
        ({"alarm": "no such"}, 404),
        ({"place": "wet-end"}, 404),
        ({"place": f"{BUS}/9"}, 404),
        ({"place": "x" * 101}, 422),
        ({"alarm": "x" * 301}, 422),
        ({"alarm": "left to \u202eright"}, 422),
    ):
        assert (await operator.get(path, params=wrong)).status_code == status, wrong


async def test_a_key_stores_one_note_and_serves_one(house: House) -> None:
    operator = await house.program(Role.OPERATOR)
    first, second = await write(operator, "Felt", key="a"), await write(operator, "Felt", key="a")
    assert first.json() == second.json()
    assert (await write(operator, "Wire", key="a")).status_code == 422
    assert len(await house.events("shift")) == 1


async def test_the_time_of_a_note_is_in_its_shift_and_not_to_come(house: House) -> None:
    operator = await house.program(Role.OPERATOR)
    start = datetime.fromisoformat(await present(operator))
    now = datetime.now(UTC)
    for wrong in (start - timedelta(seconds=1), now + timedelta(minutes=1), start + timedelta(hours=10)):
        refused = await write(operator, "x", time=wrong.isoformat())
        assert (refused.status_code, refused.json()["reason"]) == (422, "shift_note_outside")
    right = await write(operator, "x", time=start.isoformat())
    assert datetime.fromisoformat(right.json()["time"]) == start
    assert datetime.fromisoformat(right.json()["written_at"]) >= now - timedelta(seconds=1)
    assert (await write(operator, "x", time="2026-11-23T06:00:00")).status_code == 422
    assert (await write(operator, "x", written_at=start.isoformat())).status_code == 422


async def test_the_field_of_the_time_of_a_note_knows_what_the_server_refuses(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    now, earlier = (each["start"] for each in (await operator.get(API)).json()["shifts"][:2])
    form = (await operator.get(f"/shifts/{now}/note")).text
    elapsed = (datetime.now(UTC) - datetime.fromisoformat(now)).total_seconds() / 60
    assert float(re.findall('data-minutes="(.*?)"', form)[0]) == pytest.approx(elapsed, abs=0.5)
    assert "not later than now. Nothing was stored." in form
    assert 'data-minutes="479.98"' in (await operator.get(f"/shifts/{earlier}/note")).text


async def test_a_note_of_a_shift_that_is_over_states_its_time(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    earlier = (await operator.get(API)).json()["shifts"][1]
    refused = await operator.post(f"{API}/{earlier['start']}/notes", json={"text": "x"})
    assert refused.json()["reason"] == "shift_note_needs_time"
    stored = await operator.post(
        f"{API}/{earlier['start']}/notes", json={"text": "x", "time": earlier["start"]}
    )
    assert stored.status_code == 201
    clock = datetime.fromisoformat(earlier["start"]).astimezone(house.services[Handover].zone)
    form = {"text": "y", "clock": f"{clock:%H:%M}"}
    assert (await operator.post(f"/shifts/{earlier['start']}/notes", data=form)).status_code == 303
    counts = [each["notes"] for each in (await operator.get(API)).json()["shifts"][:2]]
    assert counts == [0, 2]


@for_each(
    ("start", "status", "code"),
    [
        ("yesterday", 422, "invalid"),
        ("2026-11-22T05:00:01Z", 404, "unknown_shift"),
        ("0001-01-01T00:00:00Z", 404, "unknown_shift"),
        ("9999-12-31T23:59:59-12:00", 404, "unknown_shift"),
    ],
)
async def test_a_start_that_is_none_is_refused(house: House, start: str, status: int, code: str) -> None:
    viewer = await house.program(Role.VIEWER)
    for path in (f"{API}/{start}", f"/shifts/{start}"):
        refused = await viewer.get(path)
        assert refused.status_code == status, refused.text
    assert (await viewer.get(f"{API}/{start}")).json()["code"] == code


async def test_what_happened_before_and_after_a_shift_is_not_on_its_sheet(house: House) -> None:
    viewer = await house.program(Role.VIEWER)
    earlier = (await viewer.get(API)).json()["shifts"][1]["start"]
    await house.services.buses[BUS][Safeguards].block(ANN, 1, "bearing")
    found = (await viewer.get(f"{API}/{earlier}")).json()
    assert (found["standing"], found["blocked"], found["done"]["total"]) == ([], [], 0)
    assert found["until"] == found["end"]
    assert "shift_omits_before_record" in {each["code"] for each in found["omissions"]}


async def test_a_time_without_the_server_is_on_the_sheet(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        yesterday = time.time() - 86_400
        await house.services[EventLog].record(kind="server", what=Message("event_server_ended"), at=yesterday)  # type: ignore[arg-type]
    async with complete_app(tmp_path) as house:
        viewer = await house.program(Role.VIEWER)
        start = (await viewer.get(API)).json()["shifts"][2]["start"]
        found = (await viewer.get(f"{API}/{start}")).json()
        assert "shift_omits_downtime" in {each["code"] for each in found["omissions"]}


def test_a_restart_is_no_time_without_a_record(tmp_path: Path) -> None:
    """The last event may be old, because nothing happened: the server says when it ended."""
    start = UnixTime(1_700_000_000.0)

    async def record(events: EventLog, after_s: float, code: str) -> None:
        await events.record(kind="server", what=Message(code), at=UnixTime(start + after_s))

    async def gap(code: str) -> object:
        with closing(Database(tmp_path / f"{code}.db")) as database:
            events = EventLog(database)
            await record(events, 60.0, "event_server_started")
            await record(events, 1790.0, code)
            await record(events, 1800.0, "event_server_started")
            shift = Shift(UnixTime(start + 100.0), UnixTime(start + 28_800.0))
            return database.read_now(lambda store: first_gap(store, shift))

    assert asyncio.run(gap("event_server_ended")) is None
    assert asyncio.run(gap("event_clock_set")) == (start + 60.0, start + 1800.0)


async def test_a_long_shift_has_the_newest_of_its_commands_and_counts_all(house: House) -> None:
    viewer, events = await house.program(Role.VIEWER), house.services[EventLog]
    intents = [
        {
            "who": "ann",
            "origin": "api",
            "bus": BUS,
            "unit": 1,
            "what": Message("event_set_speed"),
            "new": str(n),
        }
        for n in range(250)
    ]
    numbers = await events.intend_together(intents)
    await events.conclude_together(dict.fromkeys(numbers, ("verified", "")))
    done = (await sheet(viewer))["done"]
    assert (done["total"], done["outcomes"]["verified"], len(done["events"])) == (250, 250, 200)
    assert [done["events"][0]["new"], done["events"][-1]["new"]] == ["50", "249"]
    page = (await viewer.get(f"/shifts/{await present(viewer)}")).text
    assert "The newest 200 of 250." in page


async def test_a_long_note_and_one_too_many_are_refused(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    assert (await write(operator, "x" * 2001)).status_code == 422
    assert (await write(operator, "x" * 3 * 1024**2)).status_code == 413
    assert (await write(operator, "left to \u202eright")).status_code == 422
    path = f"/shifts/{await present(operator)}/notes"
    assert (await operator.post(path, data={"text": "x" * 2001})).status_code == 422
    first = (await write(operator, "Felt")).json()
    columns = "at, written_at, who, text, sender"
    copies = f"INSERT INTO shift_note ({columns}) SELECT {columns} FROM shift_note, generate LIMIT 499"
    numbers = "WITH RECURSIVE generate(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM generate WHERE n < 499)"
    await house.services[Database].write(lambda store: store.execute(f"{numbers} {copies}"))
    full = await write(operator, "one more")
    assert (full.status_code, full.json()["reason"]) == (409, "shift_notes_full")
    assert len((await sheet(operator))["notes"]) == 500
    assert (await operator.get(f"/shifts/{await present(operator)}")).status_code == 200
    assert first["id"] == 1


async def last(client: httpx.AsyncClient) -> str:
    """The shift that ended last."""
    start: str = (await client.get(API)).json()["shifts"][1]["start"]
    return start


async def signed_sheet(client: httpx.AsyncClient) -> dict[str, Any]:
    found: dict[str, Any] = (await client.get(f"{API}/{await last(client)}")).json()
    return found


async def sign(client: httpx.AsyncClient, **body: Any) -> httpx.Response:
    return await client.post(f"{API}/{await last(client)}/sign", json=body)


async def note(client: httpx.AsyncClient, text: str) -> httpx.Response:
    start = await last(client)
    return await client.post(f"{API}/{start}/notes", json={"text": text, "time": start})


def code(response: httpx.Response) -> tuple[int, str]:
    return response.status_code, response.json()["code"]


async def test_two_people_sign_one_after_the_other_and_the_audit_log_names_the_sheet(house: House) -> None:
    ann, bob = await house.signed_in(Role.OPERATOR, "ann"), await house.signed_in(Role.OPERATOR, "bob")
    await note(ann, "Felt changed")
    assert code(await sign(bob, part="coming")) == (409, "not_signed")
    over = await sign(ann, part="leaving")
    assert (over.status_code, over.json()["leaving"]["who"], over.json()["coming"]) == (200, "ann", None)
    assert code(await sign(ann, part="coming")) == (409, "same_person")
    wrong = await sign(bob, part="coming", digest="0" * 64)
    assert code(wrong) == (409, "superseded")
    taken = (await sign(bob, part="coming", digest=over.json()["digest"])).json()
    assert (taken["coming"]["who"], taken["altered"]) == ("bob", False)
    exact = await bob.get(f"{API}/{await last(bob)}/sheet.json")
    assert hashlib.sha256(exact.content).hexdigest() == taken["digest"]
    newest, first, *_ = await house.events("shift")
    assert (newest["who"], first["who"]) == ("bob", "ann")
    assert all(taken["digest"] in event["what"] for event in (newest, first))
    assert (await house.services[EventLog].proof.verify()).broken is None


async def test_a_second_signing_is_refused_with_who_signed_and_when(house: House) -> None:
    ann, bob = await house.signed_in(Role.OPERATOR, "ann"), await house.signed_in(Role.OPERATOR, "bob")
    signed = (await sign(ann, part="leaving")).json()["leaving"]
    for client in (ann, bob):
        refused = await sign(client, part="leaving")
        assert code(refused) == (409, "already_signed")
        assert (refused.json()["who"], refused.json()["time"]) == ("ann", signed["at"])
        assert refused.json()["detail"].startswith("ann signed as the leaving person on ")
    assert len(await house.events("shift")) == 1


async def test_of_two_who_sign_at_once_one_wins_and_the_other_reads_who(house: House) -> None:
    people = [await house.signed_in(Role.OPERATOR, name) for name in ("ann", "bob", "cid", "dan")]
    results = await asyncio.gather(*(sign(each, part="leaving") for each in people))
    (won,) = [each for each in results if each.status_code == 200]
    lost = [each for each in results if each.status_code != 200]
    assert {code(each) for each in lost} == {(409, "already_signed")}
    assert {each.json()["who"] for each in lost} == {won.json()["leaving"]["who"]}
    assert len(await house.events("shift")) == 1


async def test_a_signed_sheet_does_not_change_with_what_it_was_made_from(house: House) -> None:
    ann = await house.signed_in(Role.OPERATOR, "ann")
    await note(ann, "Felt changed")
    await sign(ann)
    before = await signed_sheet(ann)
    late = (await note(ann, "Wire, not felt")).json()
    await house.services[EventLog].record(
        kind="limits", what="limits", bus=BUS, at=UnixTime(house.services[Handover].present().start - 60.0)
    )
    after = await signed_sheet(ann)
    assert [each["text"] for each in after["later_notes"]] == ["Wire, not felt"]
    assert {**after, "later_notes": []} == before
    page = (await ann.get(f"/shifts/{await last(ann)}")).text
    assert "Notes since the signature" in page
    corrected = await ann.post(
        f"{API}/{await last(ann)}/notes", json={"text": "Roll", "corrects": late["id"]}
    )
    assert corrected.status_code == 201


async def test_a_sheet_that_an_earlier_version_signed_states_nothing_of_suppressed_alarms(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    ann = await house.signed_in(Role.OPERATOR, "ann")

    def as_before(*given: Any) -> dict[str, Any]:
        return {name: value for name, value in write_sheet(*given).items() if name != "suppressed"}

    monkeypatch.setattr("app.records.handover.service.write_sheet", as_before)
    await sign(ann)
    monkeypatch.undo()
    found = await signed_sheet(ann)
    assert "suppressed" not in found
    assert found["signed"]["altered"] is False
    page = await ann.get(f"/shifts/{await last(ann)}")
    assert page.status_code == 200
    assert 'id="shelved"' in page.text
    assert 'id="suppressed"' not in page.text
    assert (await ann.get(f"{API}/{await last(ann)}/sheet.html")).status_code == 200


async def test_another_person_signs_at_a_panel_with_name_and_password(house: House) -> None:
    ann, program = await house.signed_in(Role.OPERATOR, "ann"), await house.program(Role.OPERATOR)
    await house.add("bob", Role.ENGINEER)
    await house.add("vic", Role.VIEWER)
    assert code(await sign(program)) == (403, "forbidden")
    assert code(await sign(program, name="ann", password="not it")) == (401, "unauthorized")
    assert code(await sign(program, name="ann")) == (401, "unauthorized")
    assert code(await sign(program, name="vic", password=PASSWORD)) == (403, "forbidden")
    assert (await signed_sheet(ann))["signed"] is None
    assert (await sign(program, name="ann", password=PASSWORD)).json()["leaving"]["who"] == "ann"
    assert code(await sign(ann)) == (409, "same_person")
    form = {"part": "coming", "name": "bob", "password": PASSWORD}
    done = await ann.post(f"/shifts/{await last(ann)}/sign", data=form)
    assert done.status_code == 303
    assert (await signed_sheet(ann))["signed"]["coming"]["who"] == "bob"
    assert "the-viewer" not in str(await house.events("shift"))


async def test_a_wrong_password_is_named_at_its_field_and_the_sheet_stays(house: House) -> None:
    ann = await house.signed_in(Role.OPERATOR)
    form = {"part": "leaving", "name": "bob", "password": "not it", "reason": "early"}
    refused = await ann.post(f"/shifts/{await last(ann)}/sign", data=form)
    assert refused.status_code == 401
    field = refused.text[refused.text.index('id="field-password"') :][:500]
    assert "wrong name or password" in field
    assert 'value="bob"' in refused.text


async def test_who_may_not_sign_signs_nothing(house: House) -> None:
    viewer, operator = await house.signed_in(Role.VIEWER), await house.signed_in(Role.OPERATOR)
    assert (await sign(viewer)).status_code == 403
    foreign = {"Origin": "https://evil.example"}
    start = await last(operator)
    assert (await operator.post(f"{API}/{start}/sign", headers=foreign)).status_code == 403
    present = (await operator.get(API)).json()["shifts"][0]["start"]
    early = await operator.post(f"{API}/{present}/sign", json={"at": "2020-01-01T00:00:00Z"})
    assert early.status_code == 422
    assert (await sign(operator, part="both")).status_code == 422
    assert (await signed_sheet(operator))["signed"] is None


async def test_a_shift_is_signed_from_half_an_hour_before_its_end_on(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    shift, services = house.services[Handover].present(), house.services
    path = f"{API}/{(await operator.get(API)).json()['shifts'][0]['start']}"
    for seconds, status in ((-1801.0, 409), (-1799.0, 200)):
        for each in (services[Handover], services[Signing]):
            monkeypatch.setattr(each, "_clock", lambda seconds=seconds: UnixTime(shift.end + seconds))
        assert (await operator.post(f"{path}/sign")).status_code == status
    found = (await operator.get(path)).json()
    assert found["until"] < found["end"]
    assert found["until"] == found["made_at"]


async def test_a_sheet_that_was_altered_in_the_store_is_reported_and_not_signed(
    house: House, tmp_path: Path
) -> None:
    ann, bob = await house.signed_in(Role.OPERATOR, "ann"), await house.signed_in(Role.OPERATOR, "bob")
    await note(ann, "Felt changed")
    await sign(ann)
    with sqlite3.connect(tmp_path / "data" / "lineside.db") as store:
        with pytest.raises(sqlite3.IntegrityError):
            store.execute("UPDATE shift_sheet SET sheet = x'7b7d'")
        with pytest.raises(sqlite3.IntegrityError):
            store.execute("DELETE FROM shift_signature")
        store.execute("DROP TRIGGER shift_sheet_stays_as_signed")
        altered = (await ann.get(f"{API}/{await last(ann)}/sheet.json")).content.replace(b"Felt", b"Wire")
        store.execute("UPDATE shift_sheet SET sheet = ?", (altered,))
    assert (await signed_sheet(ann))["signed"]["altered"] is True
    assert code(await sign(bob)) == (409, "not_in_state")
    assert "Do not rely on it" in (await bob.get(f"/shifts/{await last(bob)}")).text


@pytest.mark.parametrize("lost", ["both", "coming", "sheet"])
async def test_signatures_that_are_gone_from_the_store_are_found_by_the_log(
    house: House, tmp_path: Path, lost: str
) -> None:
    ann, bob = await house.signed_in(Role.OPERATOR, "ann"), await house.signed_in(Role.OPERATOR, "bob")
    await sign(ann)
    await sign(bob)
    assert (await signed_sheet(ann))["missing_signatures"] == []
    (tmp_path / "data.toml").write_text('[server]\ndata = "data"\n')
    verify = ["audit", "verify", "--config", str(tmp_path / "data.toml")]
    assert (await asyncio.to_thread(CliRunner().invoke, cli, verify)).exit_code == 0
    which = "WHERE part = 'coming'" if lost == "coming" else ""

    def lose(store: StoreConnection) -> None:
        store.execute("DROP TRIGGER shift_signature_stays")
        store.execute("DROP TRIGGER shift_sheet_stays")
        store.execute(f"DELETE FROM shift_signature {which}")
        if lost == "sheet":
            store.execute("DELETE FROM shift_sheet")

    await house.services[Database].write(lose)
    names = ["bob"] if lost == "coming" else ["ann", "bob"]
    found = await signed_sheet(ann)
    assert [each["who"] for each in found["missing_signatures"]] == names
    for client in (ann, bob):
        refused = await sign(client)
        assert code(refused) == (409, "not_in_state")
        assert ", ".join(names) in refused.json()["detail"]
    page = (await ann.get(f"/shifts/{await last(ann)}")).text
    assert "signatures of this shift that are gone from the store" in page
    assert "Not signed." not in page
    assert "gone from the store" in (await ann.get(f"{API}/{await last(ann)}/sheet.html")).text
    done = await asyncio.to_thread(CliRunner().invoke, cli, verify)
    assert done.exit_code == 1
    assert f"states that {names[0]} signed the shift of " in done.stderr


def test_a_store_of_an_earlier_version_lacks_no_signature() -> None:
    with sqlite3.connect(":memory:") as store:
        store.row_factory = sqlite3.Row
        for step in ("0002_events.sql", "0031_audit_seals.sql"):
            store.executescript((MIGRATIONS / step).read_text())
        assert missing_signatures(store) == []
        store.executescript((MIGRATIONS / "0050_event_messages.sql").read_text())
        assert missing_signatures(store) == []


async def test_the_file_needs_no_server_and_is_no_page_of_it(house: House) -> None:
    ann = await house.signed_in(Role.OPERATOR, "ann")
    await note(ann, "<script>alert(1)</script>")
    path = f"{API}/{await last(ann)}/sheet.html"
    assert "Not signed" in (await ann.get(path)).text
    assert (await ann.get(path.replace("html", "json"))).status_code == 409
    await sign(ann)
    file = await ann.get(path)
    assert "&lt;script&gt;alert(1)" in file.text
    assert "<script" not in file.text
    assert not [each for each in (" src=", " href=", "url(", "@import") if each in file.text]
    assert "sandbox" in file.headers["content-security-policy"]
    assert file.headers["content-disposition"].startswith('attachment; filename="shift-')
    assert file.headers["x-content-type-options"] == "nosniff"
    assert "<b>ann</b>" in file.text


@for_each("hour", [3, 10, 15, 23])
async def test_a_signed_shift_keeps_its_times_when_others_are_configured(
    house: House, monkeypatch: pytest.MonkeyPatch, hour: int
) -> None:
    """Also one that began within the shift that is the present one by the new times."""
    yesterday = datetime.now(house.services[Handover].zone) - timedelta(days=1)
    at = UnixTime(yesterday.replace(hour=hour, minute=30).timestamp())
    monkeypatch.setattr(house.services[Handover], "_clock", lambda: at)
    ann = await house.signed_in(Role.OPERATOR, "ann")
    start = await last(ann)
    await sign(ann)
    monkeypatch.setattr(house.services[Handover], "_starts", [1])
    listed = (await ann.get(API)).json()["shifts"]
    (signed,) = [each for each in listed if each["leaving"]]
    assert signed["start"] == start
    assert (await ann.get(f"{API}/{start}")).json()["signed"]["leaving"]["who"] == "ann"


async def test_the_page_signs_for_the_user_of_the_session_in_both_languages(house: House) -> None:
    ann, bob = await house.signed_in(Role.OPERATOR, "ann"), await house.signed_in(Role.OPERATOR, "bob")
    path = f"/shifts/{await last(ann)}"
    assert "Hand over shift: ann" in (await ann.get(path)).text
    assert (await ann.post(f"{path}/sign", data={"part": "leaving"})).status_code == 303
    bob.headers["Accept-Language"] = "de"
    assert "Schicht übernehmen: bob" in (await bob.get(path)).text
    refused = await bob.post(f"{path}/sign", data={"part": "leaving"})
    assert refused.status_code == 409
    assert "ann hat am" in refused.text
    digest = (await signed_sheet(bob))["signed"]["digest"]
    assert (await bob.post(f"{path}/sign", data={"part": "coming", "digest": digest})).status_code == 303
    text = (await bob.get(path)).text
    assert "Schicht übernehmen" not in text
    assert digest in text
    assert "bob" in (await bob.get("/shifts")).text


async def test_a_shift_is_handed_over_early_only_with_a_reason(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    present = (await operator.get(API)).json()["shifts"][0]["start"]
    begun = UnixTime(datetime.fromisoformat(present).timestamp() + 60)
    monkeypatch.setattr(house.services[Signing], "_clock", lambda: begun)
    refused = await operator.post(f"{API}/{present}/sign", json={"reason": " "})
    assert code(refused) == (409, "not_in_state")
    assert "earlier only with a reason" in (await operator.get(f"/shifts/{present}")).text
    assert (await operator.post(f"{API}/{present}/sign", json={"reason": "Ill"})).status_code == 200
    (event,) = await house.events("shift")
    assert event["message"] == "Ill"
    assert "Reason: Ill" in (await operator.get(f"/shifts/{present}")).text
