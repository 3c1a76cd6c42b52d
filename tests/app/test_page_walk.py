"""Every page with several lines for every role, and that the frame of a page leaves its names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import AsyncIterator
from html import unescape
from urllib.parse import urljoin

import httpx
import pytest
import pytest_asyncio
from fastapi.routing import APIRoute
from starlette.requests import Request

from app.core.database import Database
from app.core.web.access import PEOPLE_ROLES, Role
from app.core.web.templating import render
from app.engineering.recipes.book import RecipeStore
from app.engineering.recipes.rules import Recipe, RecipeSetpoint
from app.engineering.sets.model import ParameterSet, UnitRows
from app.engineering.sets.store import SetStore
from app.line.alarms.settings import BuiltInAlarmSettings
from app.main import create_app
from app.people.auth.accounts import Accounts
from bus.instants import unix_now
from bus.settings import BusSettings, UnitSettings
from tests.administrator import BY
from tests.app.complete_app import House, settings_in
from tests.app.played_line import BUS, played_line
from tests.for_each import for_each

pytestmark = pytest.mark.asyncio(loop_scope="module")
LINES = 3
OF_A_KIND = 2
"""Addresses that differ in a number or a name alone."""
STARTS = (
    "/",
    "/?view=rows",
    "/?view=matrix",
    "/find?typed=a",
    "/nowhere",
    "/alarms/list",
    "/wallboard",
    "/docs",
)
BY_SCRIPT = (
    *(
        f"/bus/{BUS}/undo",
        "/tray/strip",
        "/tray",
        "/alarms/own/values",
        f"/bus/{BUS}/first-steps",
        "/control",
    ),
    *(f"/units/{BUS}/1/faceplate", f"/bus/{BUS}/control/bus", f"/batch/{BUS}", f"/swap/{BUS}/1/look"),
    *("/login", "/configuration/tables/store", "/users/the-admin/remove"),
    *("/configuration/bus/0", "/configuration/bus/0/scan", f"/bus/{BUS}/scan"),
)
LINK = re.compile(r'(?:href|hx-get)="(/[^"#]*)')
NO_PAGE = re.compile(r"/(static|api|help/pictures|shifts/pictures|metrics|healthz|favicon|manifest|sw\.js)")
NEEDS_MORE = {
    "/setup": "no user",
    "/login/oidc": "a provider",
    "/login/oidc/callback": "a provider",
    "/restores/{restore_id}": "a restore that has been started",
    "/sets/taking/{taking_id}": "a reading that has been started",
    "/bus/{bus}/undo/{id}": "a command that can be undone",
    "/bus/{bus}/tray/review": "a change in the tray",
    "/bus/{bus}/staged/review": "a staged setpoint",
    "/units/{bus}/{unit:int}/unblock": "a command block",
    "/configuration/versions/{number}": "a change of the configuration",
    "/notifications/acknowledge": "the link of a mail",
    "/offline": "no link: the service worker",
    "/live": "no link: a script, where no socket opens",
}


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def house(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[House]:
    """As many lines, of which one has a worker."""
    settings = settings_in(tmp_path_factory.mktemp("site"), control=True)
    more = [
        BusSettings(name=f"line-{n}", port=f"/dev/null{n}", unit=(UnitSettings(id=7, name="Couch roll"),))
        for n in range(1, LINES)
    ]
    lost = BuiltInAlarmSettings(code="worker_lost", bus="line-1", on_delay_s=0)
    app = create_app(settings.model_copy(update={"bus": (*settings.bus, *more), "built_in_alarm": (lost,)}))
    house = House(app, app.state.services)
    async with house.services.lifespan.running():
        await played_line(house.services)
        database = house.services[Database]
        recipe = Recipe(BUS, "Tissue", "", "anna", unix_now(), (RecipeSetpoint(1, 100, "speed"),))
        await RecipeStore(database).save(recipe)
        for bus in (BUS, "line-1"):
            await SetStore(database).save(
                ParameterSet(
                    bus, unix_now(), "anna", "by hand", (UnitRows(1, "Unwind", {}), UnitRows(2, "Nip", {}))
                )
            )
        await house.services[Accounts].create_token("press", Role.VIEWER, **BY)
        yield house
        for client in house.clients:
            await client.aclose()


def kind_of(path: str) -> str:
    kind = re.sub(r"[0-9]+", "0", path.partition("?")[0]).replace("line-0", BUS)
    return re.sub("^/help/.*", "/help/a", kind)


async def walk(client: httpx.AsyncClient) -> dict[str, httpx.Response]:
    """Every page that links lead to, a few of each kind, by its address."""
    waiting, found, seen = [*STARTS, *BY_SCRIPT], {}, Counter[str]()
    while waiting:
        path = waiting.pop()
        if path in found or NO_PAGE.match(path) or (seen[kind_of(path)] >= OF_A_KIND and path not in STARTS):
            continue
        seen[kind_of(path)] += 1
        response = found[path] = await client.get(path, headers={"Accept": "text/html"})
        waiting += map(unescape, LINK.findall(response.text))
        if "location" in response.headers:
            waiting.append(urljoin(path, response.headers["location"]))
    return found


@for_each("role", PEOPLE_ROLES)
async def test_every_page_with_several_lines(house: House, role: Role) -> None:
    found = await walk(await house.signed_in(role))
    failed = {path: page.status_code for path, page in found.items() if page.status_code >= 500}
    assert failed == {}
    routes = [
        route for route in house.app.routes if isinstance(route, APIRoute) and "GET" in (route.methods or ())
    ]
    pages = [route for route in routes if not route.include_in_schema and not NO_PAGE.match(route.path)]
    walked = {
        route.path for route in pages for path in found if route.path_regex.match(path.partition("?")[0])
    }
    if role is Role.ADMIN:
        assert {route.path for route in pages} - walked - NEEDS_MORE.keys() == set()
    always = ("/", "/lines", f"/sets/1?bus={BUS}", "/sets/2?bus=line-1")
    assert {found[path].status_code for path in always} == {200}


async def test_control_is_handed_over_to_persons_alone(house: House) -> None:
    """And not to the fields of other lines."""
    person = await house.signed_in(Role.OPERATOR, "alone")
    await person.post(f"/bus/{BUS}/control", data={"do": "take", "place": "bus"})
    page = (await person.get(f"/bus/{BUS}")).text
    assert "No other user with a page open can take control." in page
    assert 'name="to"' not in page


async def test_a_page_replaces_no_name_of_the_frame(house: House) -> None:
    request = Request({"type": "http", "method": "GET", "path": "/", "headers": [], "app": house.app})
    with pytest.raises(TypeError, match="now"):
        render(request, "find/_found.html", now=1)
