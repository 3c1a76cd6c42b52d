"""The trends page: its saved views, notes written on its chart, and runs of recipes that it compares."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import AsyncIterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.core.web.access import Person, Role
from app.errors import Problem
from app.line.history import feature
from app.line.history.feature import TrendViews, clean
from app.people.audit.log import EventLog
from bus.messages import Message
from tests.app.complete_app import House, complete_app
from tests.app.played_line import BUS, played_line

ANN = Person("ann", Role.OPERATOR, "session")
VIC = Person("vic", Role.VIEWER, "session")
ENGINEER = Person("eve", Role.ENGINEER, "session")
QUERY = f"s={BUS}%2F1%2Factual&span=600"


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path, time_zone="Europe/Berlin") as house:
        await played_line(house.services)
        yield house


def at(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat()


async def names_seen(house: House, person: Person) -> list[tuple[str, bool]]:
    return [(view.name, view.shared) for view in await house.services[TrendViews].seen_by(person)]


async def test_a_view_is_of_its_person_until_it_is_shared(house: House) -> None:
    saved, events = house.services[TrendViews], house.services[EventLog]
    await saved.save(VIC, events, "mine", QUERY, shared=False)
    await saved.save(ANN, events, "Dryers", QUERY, shared=True)
    assert await names_seen(house, VIC) == [("mine", False), ("Dryers", True)]
    assert await names_seen(house, ANN) == [("Dryers", True)]
    with pytest.raises(Problem, match="role operator"):
        await saved.save(VIC, events, "for all", QUERY, shared=True)
    [dryers] = [view for view in await saved.seen_by(ANN) if view.name == "Dryers"]
    with pytest.raises(Problem, match="role engineer"):
        await saved.delete(VIC, events, dryers.id)
    await saved.delete(ENGINEER, events, dryers.id)
    assert await names_seen(house, VIC) == [("mine", False)]
    found = (await (await house.program(Role.VIEWER)).get("/api/v1/events")).json()["events"]
    assert [event["what"] for event in found if event["kind"] == "configuration"][:2] == [
        "shared view Dryers of the trends deleted",
        "view Dryers of the trends shared",
    ]


async def test_a_view_of_another_person_is_none_and_one_saved_again_replaces_it(house: House) -> None:
    saved, events = house.services[TrendViews], house.services[EventLog]
    await saved.save(VIC, events, " mine ", QUERY, shared=False)
    await saved.save(VIC, events, "mine", "s=x&span=60", shared=False)
    [view] = await saved.seen_by(VIC)
    assert view.query == "s=x&span=60"
    with pytest.raises(Problem, match="no such view"):
        await saved.delete(ENGINEER, events, view.id)


async def test_views_are_bounded(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    saved, events = house.services[TrendViews], house.services[EventLog]
    monkeypatch.setattr(feature, "MAX_OF_PERSON", 2)
    monkeypatch.setattr(feature, "MAX_SHARED", 1)
    await saved.save(ANN, events, "one", QUERY, shared=True)
    with pytest.raises(Problem, match="as many saved views"):
        await saved.save(ENGINEER, events, "one", QUERY, shared=True)
    await saved.save(ANN, events, "two", QUERY, shared=False)
    await saved.save(ANN, events, "two", QUERY, shared=False)
    with pytest.raises(Problem, match="which is the most"):
        await saved.save(ANN, events, "three", QUERY, shared=False)


@pytest.mark.parametrize("query", ["", "evil=1", "//example.org", "s=" + "x" * feature.MAX_QUERY])
def test_an_address_that_is_none_of_the_page_is_refused(query: str) -> None:
    with pytest.raises(Problem):
        clean(query)


def test_only_known_members_of_an_address_are_kept() -> None:
    assert clean(f"{QUERY}&a=2026-01-01&next=//example.org&compare=day") == f"{QUERY}&compare=day"


async def test_the_page_lists_saves_and_deletes_views(house: House) -> None:
    operator = await house.program(Role.OPERATOR)
    origin = {"Origin": str(operator.base_url).rstrip("/")}
    form = {"name": '<b>"Dryers"', "query": QUERY, "shared": "true"}
    saved = await operator.post("/trends/views", data=form, headers=origin)
    assert (saved.status_code, saved.headers["location"]) == (303, f"/trends?{QUERY}#trend-save")
    page = (await operator.get("/trends")).text
    assert "&lt;b&gt;&#34;Dryers&#34;</" in page
    assert f'href="/trends?{QUERY.replace("&", "&amp;")}"' in page
    [view] = await house.services[TrendViews].seen_by(VIC)
    gone = await operator.post(f"/trends/views/{view.id}/delete", headers=origin)
    assert gone.status_code == 303
    assert await names_seen(house, VIC) == []


async def notes_of(client: httpx.AsyncClient, start: float, end: float, *units: str) -> list[dict[str, Any]]:
    query = {"from": at(start), "to": at(end), "unit": list(units)}
    response = await client.get("/api/v1/shifts/notes", params=query)
    assert response.status_code == 200, response.text
    found: list[dict[str, Any]] = response.json()["notes"]
    return found


async def test_a_note_on_the_chart_is_one_of_the_shift_of_its_time(house: House) -> None:
    operator, now = await house.program(Role.OPERATOR), time.time()
    for text, moment, place in (
        ("web break", now - 100_000, {}),
        ("felt changed", now - 60, {"bus": BUS, "unit": 2}),
    ):
        body = {"text": text, "time": at(moment), **place}
        written = await operator.post("/api/v1/shifts/notes", json=body)
        assert written.status_code == 201, written.text
    assert [note["text"] for note in await notes_of(operator, now - 200_000, now)] == [
        "web break",
        "felt changed",
    ]
    assert [note["text"] for note in await notes_of(operator, now - 200_000, now, f"{BUS}/1")] == [
        "web break"
    ]
    assert len(await notes_of(operator, now - 200_000, now, f"{BUS}/2")) == 2
    found = (await operator.get("/api/v1/events", params={"kind": "shift"})).json()["events"]
    assert {event["message"] for event in found} == {"web break", "felt changed"}


async def test_a_note_of_the_future_of_long_ago_or_of_a_viewer_is_refused(house: House) -> None:
    operator, viewer = await house.program(Role.OPERATOR), await house.program(Role.VIEWER)
    for client, seconds, status in ((operator, 3600, 422), (operator, -40 * 86_400, 409), (viewer, 0, 403)):
        body = {"text": "web break", "time": at(time.time() + seconds)}
        assert (await client.post("/api/v1/shifts/notes", json=body)).status_code == status


async def test_the_run_of_a_recipe_before_is_found_by_the_events(house: House) -> None:
    viewer, events, now = await house.program(Role.VIEWER), house.services[EventLog], time.time()
    path = f"/api/v1/buses/{BUS}/recipe/runs"
    assert (await viewer.get(path)).json() is None
    for seconds, name in ((900, "Kraft"), (800, "Kraft"), (600, "Liner"), (300, "Kraft"), (200, "Kraft")):
        what = Message.of("event_recipe_loaded", name=name, version=1)
        await events.record(kind="recipe", what=what, at=now - seconds, bus=BUS)  # type: ignore[arg-type]
    found = (await viewer.get(path)).json()
    assert found["name"] == "Kraft"
    assert [round(now - datetime.fromisoformat(found[key]).timestamp()) for key in ("loaded", "before")] == [
        300,
        900,
    ]
    earlier = (await viewer.get(path, params={"at": at(now - 500)})).json()
    assert (earlier["name"], earlier["before"]) == ("Liner", None)


async def test_a_name_in_a_csv_for_people_is_no_formula(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer = await house.program(Role.VIEWER)
    monkeypatch.setattr(
        "app.line.history.export.Table.named", lambda *_: ['=HYPERLINK("x") actual', "Nip actual"]
    )
    query = {"series": [f"{BUS}/1/actual", f"{BUS}/2/actual"], "layout": "table"}
    response = await viewer.get("/api/v1/history/export", params=query)
    [head, *_] = csv.reader(io.StringIO(response.content.decode("utf-8-sig")))
    assert head[2:] == ['\'=HYPERLINK("x") actual', "Nip actual"]
