"""The pages of the line and of a unit as the server sends them, and the first steps on a bus without a
response."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from app.core.web.access import Role
from app.line.live.bus_live import LiveState
from app.line.live.pages import digits_of, next_step, view_for
from bus.contract import BusFigures, BusLink, ParameterValue, UnitFigures
from bus.instants import UnixTime, unix_now
from tests.app.complete_app import House, complete_app
from tests.app.played_commands import a_bus, responding
from tests.app.played_line import BUS, played_line
from tests.app.screens import line
from tests.for_each import for_each


def test_the_steps_in_their_order() -> None:
    live = a_bus()
    bus = live.buses["dry-end"]
    assert next_step(bus) == "worker"
    bus.worker_lost = None
    bus.apply([BusLink(at=1.0, link="closed")])
    assert next_step(bus) == "port"
    bus.apply([BusLink(at=1.0, link="open")])
    assert next_step(bus) == "scan"
    responding(live)
    assert next_step(bus) is None


def test_a_unit_that_responded_before_the_server_started_ends_them() -> None:
    bus = a_bus().buses["dry-end"]
    bus.units[2].last_response = UnixTime(1.0)
    assert next_step(bus) is None


@pytest.mark.parametrize("link", ["worker", "port", "scan"])
async def test_an_engineer_is_guided_and_others_are_not(tmp_path: Path, link: str) -> None:
    async with complete_app(tmp_path) as house:
        engineer, operator = await house.signed_in(Role.ENGINEER), await house.signed_in(Role.OPERATOR)
        live = house.services[LiveState]
        bus = live.buses["dry-end"]
        bus.worker_lost = bus.worker_lost if link == "worker" else None
        bus.apply([BusLink(at=UnixTime(1.0), link="open" if link == "scan" else "closed")])
        page = (await engineer.get("/")).text
        assert f'data-first-step="{link}"' in page
        assert "First steps" not in (await operator.get("/")).text
        assert (await operator.get("/bus/dry-end/first-steps")).status_code == 403
        fragment = await engineer.get("/bus/dry-end/first-steps")
        assert ("No unit has responded yet" in fragment.text, "HX-Redirect" in fragment.headers) == (
            True,
            False,
        )
        responding(live)
        assert (await engineer.get("/bus/dry-end/first-steps")).headers["HX-Redirect"] == "/"


PAGES = ["/", "/units/dry-end/1", "/units/dry-end/1/parameters", "/setpoints", "/bus/dry-end"]


@pytest.mark.parametrize(("units", "view"), [(0, "tiles"), (24, "tiles"), (25, "matrix"), (255, "matrix")])
def test_the_view_follows_the_number_of_units(units: int, view: str) -> None:
    assert view_for(units) == view


@pytest.mark.parametrize(("decimals", "span", "digits"), [(0, 2000, 4), (1, 2000, 5), (4, 99, 6), (2, 0, 6)])
def test_a_number_has_room_for_the_highest_speed(decimals: int, span: int, digits: int) -> None:
    live = line()
    values = [ParameterValue(unit=1, number=n, at=1, raw=raw) for n, raw in ((2, span), (3, decimals))]
    live.buses["dry"].apply(list(values))
    assert digits_of(live.buses["dry"].units[1]) == digits


@for_each("path", PAGES)
async def test_nothing_is_called_stop(house: House, path: str) -> None:
    page = await (await house.program(Role.ENGINEER)).get(path)
    buttons = re.findall(r"<button[^>]*>(.*?)</button>", page.text, re.DOTALL)
    assert buttons
    assert not [button for button in buttons if re.search(r"\bstop\b", button, re.IGNORECASE)]


async def test_bounds_without_decimals_are_numbers_of_the_wire_and_have_no_unit(house: House) -> None:
    client = await house.program(Role.VIEWER)
    live = house.services[LiveState].buses["dry-end"].units[1]
    unit = live.settings.labels.unit
    assert unit
    unread = (await client.get("/units/dry-end/1")).text
    assert "raw</span>" in unread
    assert f"raw {unit}</span>" not in unread
    values = [ParameterValue(unit=1, number=n, at=1, raw=raw) for n, raw in ((2, 2000), (3, 1))]
    house.services[LiveState].buses["dry-end"].apply(list(values))
    assert f"200.0 {unit}</span>" in (await client.get("/units/dry-end/1")).text


async def test_the_faceplate_is_a_part_of_the_line_with_what_the_role_may_do(house: House) -> None:
    for role, may_set in ((Role.VIEWER, False), (Role.OPERATOR, True)):
        part = await (await house.program(role)).get("/units/dry-end/1/faceplate")
        assert part.status_code == 200
        assert "<html" not in part.text
        assert 'class="lamp' in part.text
        assert ('name="value"' in part.text) is may_set


async def test_the_figures_of_a_bus_outlast_its_worker_and_promise_nothing(house: House) -> None:
    bus, client = house.services[LiveState].buses["dry-end"], await house.signed_in(Role.VIEWER)

    async def says(*texts: str) -> bool:
        page = (await client.get("/bus/dry-end")).text
        return all(text in page for text in texts)

    silent = "because the bus worker does not respond."
    assert await says(silent, "There are no figures yet.")
    bus.worker_lost = None
    bus.apply([BusLink(at=UnixTime(1.0), link="closed")])
    assert await says("Nothing is requested.", "There are no figures yet.")
    bus.apply([BusFigures(unix_now(), 1.0, 1.0, 0.5, 1.3, units=[UnitFigures(unit=2, responses=987)])])
    bus.lose_worker(unix_now())
    assert await says(silent, "up to then", ">987<")


async def test_the_view_is_remembered(house: House) -> None:
    client = await house.program(Role.VIEWER)
    response = await client.get("/?view=matrix")
    assert response.cookies["lineside_view"] == "matrix"
    assert (await client.get("/?view=nonsense")).status_code == 422


async def test_the_matrix_has_a_former_name_in_stored_home_pages_and_cookies(house: House) -> None:
    client = await house.program(Role.VIEWER)
    response = await client.get("/?view=board")
    assert (response.status_code, response.cookies["lineside_view"]) == (200, "matrix")
    client.cookies.set("lineside_view", "board")
    assert 'class="line line--matrix"' in (await client.get("/")).text


async def test_the_manifest_names_the_app(house: House) -> None:
    manifest = (await house.client().get("/manifest.webmanifest")).json()
    assert (manifest["start_url"], manifest["display"]) == ("/", "standalone")
    for icon in manifest["icons"]:
        assert (await house.client().get(icon["src"])).status_code == 200


async def test_the_service_worker_keeps_only_the_offline_page(house: House) -> None:
    worker = await house.client().get("/sw.js")
    assert worker.headers["content-type"].startswith("text/javascript")
    kept = re.search(r"const KEPT = (\[.*?\]);", worker.text)
    assert kept is not None
    of_the_page = re.compile(r"/css/|/icons/|/js/(theme|offline)\.js$")
    assert all(of_the_page.search(name) for name in json.loads(kept[1]))


async def test_refused_limits_are_explained_at_their_place_on_the_page(house: House) -> None:
    client = await house.program(Role.ENGINEER)
    typed = {"lowest": "5", "highest": "4", "largest_step": "", "per_minute": ""}
    refused = await client.post("/units/dry-end/1/limits", data=typed)
    assert (refused.status_code, refused.headers["hx-retarget"]) == (422, "#limits-result")
    assert 'id="limits-result"' in (await client.get("/units/dry-end/1")).text


async def test_limits_stay_where_a_form_lacks_one(house: House) -> None:
    client = await house.program(Role.ENGINEER)
    limits = "/api/v1/buses/dry-end/units/1/limits"
    await client.put(limits, json={"highest": 1200})
    for body in ({"json": {"highest": 1400}}, {"content": b""}, {"data": {"highest": "140"}}):
        refused = await client.post("/units/dry-end/1/limits", **body)
        assert (refused.status_code, "lacks the field lowest" in refused.text) == (422, True)
    assert (await client.get(limits)).json()["highest"] == 1200


@for_each("header", ["Lineside-Clicked-At", "Lineside-Asked-At"])
async def test_an_old_click_sends_nothing_and_reports_it(house: House, header: str) -> None:
    client = await house.program(Role.OPERATOR)
    form = {"raw": "100", "id": "a1", "how": "now", "reviewed_at": "1.0", "was": "", "scale": "-"}
    late = await client.post("/units/dry-end/1/speed", data=form, headers={header: "1.0"})
    assert (late.status_code, "too late" in late.text) == (503, True)
    expired = await client.post("/units/dry-end/1/speed", data=form)
    assert (expired.status_code, "expired" in expired.text) == (409, True)


async def test_a_viewer_is_refused_where_the_line_is_set_to_zero(house: House) -> None:
    viewer = await house.signed_in(Role.VIEWER)
    for path in ("/", "/units/dry-end/1", "/trends", "/account"):
        assert 'hx-get="/line/zero"' in (await viewer.get(path)).text, path
    refused = await viewer.get("/line/zero")
    assert "Setting the line to zero needs the role operator" in refused.text
    assert "data-review-act" not in refused.text
    assert (await viewer.post("/line/zero", data={"id": "a", "reviewed_at": "1"})).status_code == 403


async def test_the_trends_page_offers_parquet_only_where_it_can_be_written(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer = await house.program(Role.VIEWER)
    assert 'id="export-parquet"' in (await viewer.get("/trends")).text
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    page = (await viewer.get("/trends")).text
    assert ('id="export-parquet"' in page, 'id="export-csv"' in page) == (False, True)


async def test_a_raw_value_and_a_choice_are_in_the_readers_language(house: House) -> None:
    client = await house.signed_in(Role.ENGINEER)
    client.headers["Accept-Language"] = "de"
    read = [ParameterValue(unit=1, number=n, at=1, raw=raw) for n, raw in ((8, 0), (20, 1234))]
    house.services[LiveState].buses["dry-end"].apply(list(read))
    page = (await client.get("/units/dry-end/1/parameters")).text
    assert "1234 roh" in page
    assert "1234 raw" not in page
    review = await client.post("/units/dry-end/1/parameters/16/review", data={"value": "1"})
    assert "Einrichten im Lauf (Parameter 16) schreiben: Ja" in review.text
    speed = await client.post("/units/dry-end/1/parameters/1/review", data={"value": "1750"})
    assert "<small>1/min</small>" in speed.text


@pytest.mark.parametrize(
    ("typed", "reason", "offered"),
    [
        ("abc", "not a number: &#39;abc&#39;; write it like 123.4", ""),
        ("-3", "-3 is below 0, the minimum", "0.0"),
        ("12.55", "12.55 has 2 decimals; this value has at most 1", "12.6"),
        ("99999", "out of range", "999.9"),
    ],
)
async def test_a_refused_parameter_has_one_pattern(
    house: House, typed: str, reason: str, offered: str
) -> None:
    client = await house.signed_in(Role.ENGINEER)
    answer = await client.post("/units/dry-end/1/parameters/6/review", data={"value": typed})
    nearest = f"; the nearest allowed value is {offered}" if offered else ""
    assert f"{reason}{nearest}; nothing was sent<" in answer.text
    assert ("data-use" in answer.text) == bool(offered)


UNIT = f"/units/{BUS}/1"
PROTOCOL = re.compile(r"\b8[0-9]h\b|#\d+\b")


@pytest.fixture
async def running(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as running:
        await played_line(running.services)
        yield running


async def test_the_neighbors_are_those_of_the_floor_and_open_in_the_same_view(running: House) -> None:
    client = await running.signed_in(Role.VIEWER)
    first, second = (await client.get(UNIT)).text, (await client.get(f"/units/{BUS}/2/parameters")).text
    assert ('rel="prev"' in first, f'href="/units/{BUS}/2" rel="next"' in first) == (False, True)
    assert f'href="/units/{BUS}/1/parameters" rel="prev"' in second


async def test_words_of_the_protocol_are_under_details_alone(running: House) -> None:
    page = (await (await running.signed_in(Role.ENGINEER)).get(UNIT)).text
    shown, details = page[page.index("<main") :].split('<details class="card plate__more">')
    assert PROTOCOL.findall(re.sub(r"<[^>]*>", " ", shown)) == []
    assert "84h" in details


async def test_who_may_replace_a_unit_finds_it_before_every_other_button(running: House) -> None:
    for role, may in ((Role.VIEWER, False), (Role.ENGINEER, True)):
        page = (await (await running.signed_in(role)).get(UNIT)).text
        plate = page[page.index('class="plate"') :]
        assert ("Replace this unit" in plate) is may
        first = re.search(r'class="button[^>]*>([^<]*)', plate)
        assert (first is not None and first[1] == "Replace this unit") is may


async def test_a_stored_baud_rate_that_no_unit_uses_yet_stays_on_the_page_of_the_bus(house: House) -> None:
    bus = house.services[LiveState].buses["dry-end"]
    client = await house.signed_in(Role.ADMIN)
    assert "used from the next power-up" not in (await client.get("/bus/dry-end")).text
    bus.apply([ParameterValue(unit=1, number=18, at=1, raw=48)])
    page = (await client.get("/bus/dry-end")).text
    assert f"Stored: 4800 baud, used from the next power-up, in {bus.units[1].settings.name}." in page
