"""A server that is not the home of a bus shows nothing of it that it does not know, raises no alarm of it,
and leads to the server that knows."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path

import pytest
import pytest_asyncio

from app.alarms.monitor.bus_alarms import BusAlarms
from app.alarms.settings import BuiltInAlarmSettings
from app.audit.settings import Audit
from app.database import Database
from app.feature import Services
from app.live.api.line_stream import LineStream
from app.live.browsers.hub import Hub
from app.main import create_app
from app.notification.settings import NotifySettings, WebhookSettings
from app.recipes.rules import Recipe, RecipeSetpoint
from app.recipes.store import RecipeStore
from app.routing.site_servers import SiteServers
from app.settings import ServerSettings, Settings
from app.sites.fleet import Fleet
from app.sites.summary import notices
from app.web.admission.access import Role
from bus.instants import unix_now
from bus.settings import BusSettings, UnitSettings
from tests.app.complete_app import House, settings_in
from tests.app.played_line import BUS, played_line
from tests.app.played_site import PlayedHomes
from tests.app.stage import until
from tests.app.test_line_board import summary
from tests.free_port import free_port
from tests.postgresql import fresh_database, needs_postgresql

pytestmark = pytest.mark.asyncio(loop_scope="module")
WET = "wet-end"
WITHIN_S = 60
PAGES = ("/", "/alarms", "/setpoints", "/recipes", "/sets")


def two_buses(folder: Path) -> Settings:
    wet = BusSettings(name=WET, port="/dev/null", unit=(UnitSettings(id=7, name="Couch roll"),))
    settings = settings_in(folder)
    lost = BuiltInAlarmSettings(code="worker_lost", bus=WET, on_delay_s=0)
    return settings.model_copy(update={"bus": (*settings.bus, wet), "built_in_alarm": (lost,)})


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def house(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[House]:
    """`dry-end` is here; `wet-end` was, with an alarm, and is at another server now that does not respond."""
    app = create_app(two_buses(tmp_path_factory.mktemp("site")))
    house = House(app, app.state.services)
    async with house.services.lifespan.running():
        await until(lambda: _is_present(house.services), "the alarm of the time when it was here")
        await played_line(house.services)
        servers, homes = house.services[SiteServers], PlayedHomes("app-1")
        homes.put(BUS, "app-1")
        homes.put(WET, "app-2", f"http://127.0.0.1:{free_port()}")
        servers.homes = homes
        house.services[Fleet].board._own = list
        for text in notices("app-2", [summary(WET, "high", waiting=1)]):
            house.services[Fleet].board.take(text)
        yield house
        for client in house.clients:
            await client.aclose()


def _is_present(services: Services) -> bool:
    alarms = services.buses[WET][BusAlarms].list.alarms.values()
    return any(alarm.definition.code == "worker_lost" and alarm.facts.active for alarm in alarms)


async def test_no_page_shows_it_and_each_leads_to_its_home(house: House) -> None:
    person = await house.signed_in(Role.ENGINEER)
    for path in PAGES:
        page = (await person.get(path)).text
        assert re.findall(r'href="([^"]*)\?bus=wet-end">wet-end</a> \(app-2\)', page) == [path], path
        assert "Couch roll" not in page, path
        assert "No bus worker" not in page, path
    zero = (await person.get("/line/zero")).text
    assert "Unwind" in zero
    assert "Couch roll" not in zero
    assert 'href="/?bus=wet-end"' in zero, "that it is not set to zero"
    assert 'href="/bus/wet-end"' in (await person.get("/bus/dry-end")).text
    assert (await person.get("/bus")).headers["location"] == "/bus/dry-end"
    screen = house.services[Hub].screen("en")
    line = dict(screen.shown["line_summary"])
    assert line.pop("elsewhere") == "wet-end (app-2)"
    assert "wet-end" not in str(line)
    assert screen.shown["alarms_present"]["text"] == ""


async def test_an_open_page_follows_a_bus_to_another_server(house: House) -> None:
    """Each page has what it was drawn of as the field by which it is loaded again."""
    person = await house.signed_in(Role.ENGINEER, "follower")
    screen, servers = house.services[Hub].screen("en"), house.services[SiteServers]
    of_page = {
        "/": ("line_summary", "elsewhere"),
        f"/bus/{BUS}": (BUS, "home"),
        f"/units/{BUS}/1": (BUS, "home"),
    }
    drawn_of = {}
    for path, (group, field) in of_page.items():
        reload = re.escape(f"{group}.{field}")
        page = (await person.get(path)).text
        [drawn_of[path]] = re.findall(rf'data-reload="{reload}" data-drawn-of="([^"]*)"', page)
        assert drawn_of[path] == screen.shown[group][field], path
    assert isinstance(servers.homes, PlayedHomes)
    servers.homes.put(BUS, "app-3", "http://127.0.0.1:9")
    try:
        shown = house.services[Hub].screen("en").shown
        assert [shown[group][field] == drawn_of[path] for path, (group, field) in of_page.items()] == [
            False
        ] * 3
    finally:
        servers.homes.put(BUS, "app-1")


async def test_the_store_is_shown_of_every_bus(house: House) -> None:
    person = await house.signed_in(Role.ENGINEER, "reader")
    assert "wet-end" in (await person.get("/alarms/journal")).text
    figures = (await person.get("/api/v1/alarms/performance")).json()["figures"]
    standing = next((each["value"] for each in figures if each["code"] == "standing"), None)
    assert standing in (None, 1), figures
    assert "Couch roll" in (await person.get("/trends")).text
    form = await person.get("/shifts/present?place=wet-end/7", follow_redirects=True)
    assert "Couch roll" in form.text


async def test_no_side_of_a_comparison_is_what_was_read_before(house: House) -> None:
    person = await house.signed_in(Role.ENGINEER, "comparer")
    page = (await person.get("/sets/compare")).text
    assert f"live:{BUS}:1" in page
    assert f"live:{WET}:7" not in page
    refused = await person.get("/sets/compare", params={"left": f"live:{WET}:7"})
    assert refused.status_code == 409
    assert "Save a set there" in refused.text


async def test_the_head_names_an_alarm_of_another_server(house: House) -> None:
    person = await house.signed_in(Role.VIEWER)
    page = (await person.get("/events", headers={"Accept-Language": "de"})).text
    assert "1 Linie eines anderen Servers hat einen Alarm der Priorität dringend oder hoch" in page
    assert house.services[Hub].screen("en").shown["line_summary"]["others_mark"] == "high"


async def test_programs_get_no_sample_and_no_alarm_of_it(house: House) -> None:
    program = await house.program(Role.VIEWER)
    metrics = (await program.get("/metrics")).text
    assert f'bus="{BUS}"' in metrics
    assert WET not in metrics
    alarms = (await program.get("/api/v1/alarms")).json()
    assert alarms["elsewhere"] == [WET]
    assert [alarm for alarm in alarms["alarms"] if alarm["bus"] == WET] == []
    line = (await program.get("/api/v1/line")).json()
    assert ([bus["name"] for bus in line["buses"]], line["elsewhere"]) == ([BUS], [WET])


async def test_a_stream_follows_the_homes(house: House) -> None:
    stream, homes = house.services[LineStream], house.services[SiteServers].homes
    assert isinstance(homes, PlayedHomes)

    async def snapshot(pieces: AsyncIterator[bytes]) -> bytes:
        while b"event: snapshot" not in (piece := await anext(pieces)):
            pass
        return piece

    with stream.reading():
        pieces = stream.pieces(None)
        assert b'"elsewhere":["wet-end"]' in await snapshot(pieces)
        away = homes.of(WET)
        homes.put(WET, "app-1")
        try:
            assert b'"elsewhere":[]' in await snapshot(pieces)
        finally:
            homes.homes[WET] = away
        assert b'"elsewhere":["wet-end"]' in await snapshot(pieces)
        await pieces.aclose()  # type: ignore[attr-defined]


async def test_what_has_its_bus_in_the_store_or_the_body_is_repeated_at_the_home(house: House) -> None:
    stored = RecipeStore(house.services[Database])
    recipe = await stored.save(
        Recipe(WET, "Tissue", "", "anna", unix_now(), (RecipeSetpoint(7, 100, "speed"),))
    )
    person = await house.signed_in(Role.ENGINEER, "cook")
    page = await person.get(f"/recipes/{recipe.id}?from=list")
    assert (page.status_code, page.headers["location"]) == (307, f"/recipes/{recipe.id}?from=list&bus={WET}")
    assert (await person.get(page.headers["location"])).status_code == 503, "its home does not respond"
    sent = await person.post(f"/api/v1/recipes/{recipe.id}/load", json={})
    assert (sent.status_code, sent.json()["code"]) == (307, "bus_elsewhere")
    for path, form in (
        ("/sets/take", {}),
        ("/sets/schedule", {"at": "06:00"}),
        ("/recipes/save", {}),
    ):
        posted = await person.post(path, data={"bus": WET, **form})
        assert (posted.status_code, posted.headers["location"]) == (307, f"{path}?bus={WET}")


@needs_postgresql
async def test_its_alarms_and_notifications_are_those_of_its_home_alone(tmp_path: Path) -> None:
    """Both servers have the bus in their configuration, and no worker of it is connected to any."""
    (tmp_path / "secret").write_text("correct horse battery")
    hook = WebhookSettings(url=f"http://127.0.0.1:{free_port()}", secret_file=tmp_path / "secret")
    with fresh_database() as store:
        async with AsyncExitStack() as stack:

            async def started(name: str, **server: object) -> Services:
                data = tmp_path / name
                more = {
                    "server": ServerSettings(id=name, data=data, **server),  # type: ignore[arg-type]
                    "store": store,
                    "notify": NotifySettings(webhook=(hook,)),
                    "audit": Audit(key_file=tmp_path / "audit.key"),
                }
                app = create_app(two_buses(data).model_copy(update=more))
                services: Services = app.state.services
                await stack.enter_async_context(services.lifespan.running())
                return services

            other = await started("app-2", home=())
            home = await started("app-1")
            database = home[Database]
            await until(lambda: _is_present(home), "the alarm at the home")

            async def count(table: str, column: str) -> int:
                query = f"SELECT count(*) FROM {table} WHERE {column} = ?"
                found = await database.read(lambda c: c.execute(query, (f"{WET}.worker_lost",)).fetchone())
                return int(found[0])

            async with asyncio.timeout(WITHIN_S):
                while not await count("notification_episode", "alarm"):  # noqa: ASYNC110 - of the store
                    await asyncio.sleep(0.02)
            await until(lambda: other[SiteServers].is_elsewhere(WET), "a look of the other at the homes")
            assert not _is_present(other)
            assert await count("alarm_journal", "alarm") == 1
