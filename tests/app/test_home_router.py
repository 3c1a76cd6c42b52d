"""A request of another server's bus is passed on to the home of that bus, and nothing is added to its
rights."""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections.abc import AsyncIterator

import httpx
import pytest
import pytest_asyncio
from fastapi import APIRouter
from fastapi.routing import APIRoute
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from app.alarms.monitor.line_alarms import LineAlarms
from app.audit.events.store import Filter
from app.audit.log import EventLog
from app.live.api.line_stream import LineStream
from app.live.browsers.hub import Hub
from app.live.state.bus_live import LiveState
from app.main import FEATURES
from app.routing.forwarding.target import COOKIE
from app.routing.store_clock import StoreClock
from app.web.admission.access import Role
from bus.contract import Reading
from tests.app.complete_app import EVERY_ROLE
from tests.app.played_commands import HEALTHY, REMOTE
from tests.app.stage import until
from tests.app.two_servers import FIRST, SECOND, TwoServers, two_servers
from tests.free_port import free_port

BUS = "/api/v1/buses/dry-end"
PARAMETER = f"{BUS}/units/1/parameters/6"
BUS_NAME = "dry-end"
WITHIN_S = 20
pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def served(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[TwoServers]:
    async with two_servers(tmp_path_factory.mktemp("site"), control=True) as site:
        yield site


@pytest_asyncio.fixture(loop_scope="module")
async def site(served: TwoServers) -> TwoServers:
    """The bus is at the second server, controlled by the engineer's program, and nothing was sent to it."""
    served.move(SECOND, served.second.url)
    taken = await served.program(Role.ENGINEER, served.second).post(f"{BUS}/control")
    assert taken.status_code == 200
    served.line.written.clear()
    return served


async def test_a_command_at_any_server_is_sent_by_the_home(site: TwoServers) -> None:
    program = site.program(Role.ENGINEER)
    assert (await program.get(BUS)).json()["worker"] is True
    sent = await program.put(PARAMETER, json={"raw": 70}, headers={"Idempotency-Key": "once"})
    assert (sent.status_code, sent.json()["outcome"]) == (200, "verified")
    again = await program.put(PARAMETER, json={"raw": 70}, headers={"Idempotency-Key": "once"})
    assert again.json()["id"] == sent.json()["id"]
    assert site.line.written == [(1, 6, 70)]
    events, _ = await site.second.services[EventLog].page(Filter(kind="command"), 10)
    assert [(event["who"], event["outcome"]) for event in events] == [("key-engineer", "verified")]
    assert (await site.first.services[EventLog].page(Filter(kind="command"), 10))[0] == []


async def test_each_route_refuses_as_the_home_does(site: TwoServers) -> None:
    """The proxy grants nothing: for every role the response is that of the home itself."""
    routes = _routes_of_a_bus()
    assert len(routes) > 50
    roles = (Role.VIEWER, Role.OPERATOR, Role.WORKER, None)
    here = {role: site.client(headers=site.credential(role)) for role in roles}
    there = {role: site.client(site.second, headers=site.credential(role)) for role in roles}
    for method, path in routes:
        # A write by one who may is in the other tests: without a body it might still be sent.
        is_read = method == "GET" and path.startswith("/api/")
        roles_of = [role for role in roles if is_read or role is not Role.OPERATOR]
        passed = await asyncio.gather(*(_status(here[role], method, path) for role in roles_of))
        direct = await asyncio.gather(*(_status(there[role], method, path) for role in roles_of))
        assert passed == direct, (method, path)
        assert passed[roles_of.index(None)] in (303, 401)
        assert passed[roles_of.index(Role.WORKER)] == 403
    assert site.line.written == []


def _routes_of_a_bus() -> list[tuple[str, str]]:
    router = APIRouter()
    for feature in FEATURES:
        for each in feature.routers:
            router.routes.extend(each.routes)
    found = [route for route in router.routes if isinstance(route, APIRoute) and "{bus}" in route.path]
    return sorted(
        (method, re.sub(r"\{[^}]*\}", "1", route.path.replace("{bus}", BUS_NAME)))
        for route in found
        for method in route.methods
    )


async def _status(client: httpx.AsyncClient, method: str, path: str) -> int:
    return (await client.request(method, path)).status_code


async def test_a_late_command_is_late_at_the_home(site: TwoServers) -> None:
    program = site.program(Role.ENGINEER)
    sent_at = {"Lineside-Sent-At": "2026-11-25T00:00:00Z"}
    refused = await program.put(PARAMETER, json={"raw": 70}, headers=sent_at)
    assert (refused.status_code, refused.json()["code"]) == (503, "not_sent")
    assert site.line.written == []


@pytest.mark.parametrize("path", ["/bus/dry-end", "/units/dry-end/1", "/?bus=dry-end"])
async def test_a_page_of_a_bus_is_that_of_its_home_which_the_browser_looks_at_then(
    site: TwoServers, path: str
) -> None:
    browser = site.browser(Role.VIEWER)
    shown = await browser.get(path)
    assert shown.status_code == 200
    assert shown.cookies[COOKIE] == SECOND
    assert shown.headers["content-security-policy"]
    assert "set-cookie" not in (await browser.get("/events")).headers
    assert browser.cookies[COOKIE] == SECOND
    site.move(FIRST, site.first.url)
    await browser.get(path)
    assert browser.cookies[COOKIE] == FIRST


async def test_a_request_of_a_page_goes_to_the_server_of_the_page(site: TwoServers) -> None:
    """Another tab has looked at another home since: a form that has its bus in the body is not sent there."""
    site.first.homes.put("other", FIRST)
    servers = site.first.servers
    servers.buses = (*servers.buses, "other")
    browser = site.browser(Role.ENGINEER)
    browser.cookies[COOKIE] = FIRST
    form = {"bus": "dry-end", "new-1": "10"}
    try:
        here = await browser.post("/setpoints/review", data=form, headers={"HX-Request": "true"})
        page = {"HX-Request": "true", "Lineside-Home": SECOND}
        there = await browser.post("/setpoints/review", data=form, headers=page)
    finally:
        servers.buses = servers.buses[:-1]
        site.first.homes.homes.pop("other")
    assert "not connected" in here.text
    assert "not connected" not in there.text


async def test_the_socket_of_a_page_is_that_of_the_home(site: TwoServers) -> None:
    cookies = site.cookies[Role.VIEWER] | {COOKIE: SECOND}
    headers = {"Cookie": "; ".join(f"{name}={value}" for name, value in cookies.items())}
    url = site.first.url.replace("http", "ws")
    async with asyncio.timeout(WITHIN_S), connect(f"{url}/live", additional_headers=headers) as page:
        snapshot = json.loads(await page.recv())
        assert snapshot["is"] == "snapshot"
        assert snapshot["f"]["dry-end"]["worker"] == "1"
        await page.send(json.dumps({"want": "snapshot", "units": ["dry-end/1"]}))
        while json.loads(await page.recv())["is"] != "snapshot":
            pass
        await page.send("no JSON")
        await page.wait_closed()
    with pytest.raises(InvalidStatus) as refused:
        await connect(f"{url}/live?home={SECOND}", additional_headers={"Cookie": f"{COOKIE}={SECOND}"})
    assert refused.value.response.status_code == 401


@pytest.mark.parametrize("role", [*EVERY_ROLE, None])
async def test_a_socket_admits_whom_the_home_admits(site: TwoServers, role: Role | None) -> None:
    statuses = []
    for url in (f"{site.first.url}/live?home={SECOND}", f"{site.second.url}/live"):
        try:
            async with connect(url.replace("http", "ws"), additional_headers=site.credential(role)) as page:
                assert json.loads(await page.recv())["f"]["dry-end"]["worker"] == "1"
                statuses.append(101)
        except InvalidStatus as refused:
            statuses.append(refused.response.status_code)
    assert statuses == [{Role.WORKER: 403, None: 401}.get(role, 101)] * 2


async def test_a_stream_is_passed_on_as_it_comes_and_ends_with_its_reader(site: TwoServers) -> None:
    program = site.program(Role.VIEWER)
    async with (
        asyncio.timeout(WITHIN_S),
        program.stream("GET", "/api/v1/stream", params={"bus": "dry-end"}) as stream,
    ):
        assert stream.headers["content-type"].startswith("text/event-stream")
        text = ""
        async for piece in stream.aiter_text():
            text += piece
            if "event: snapshot" in text:
                break
    readers = site.second.services[LineStream]
    await until(lambda: not readers._readers, "the end of the stream at the home")


async def test_the_line_has_the_buses_of_all_homes(site: TwoServers) -> None:
    line = (await site.program(Role.VIEWER).get("/api/v1/line")).json()
    assert [(bus["name"], bus["worker"]) for bus in line["buses"]] == [("dry-end", True)]
    assert line["elsewhere"] == []
    site.move(SECOND, f"http://127.0.0.1:{free_port()}")
    line = (await site.program(Role.VIEWER).get("/api/v1/line")).json()
    assert (line["buses"], line["elsewhere"]) == ([], ["dry-end"]), "this server knows nothing of it"


async def test_the_alarms_of_all_homes_are_those_of_their_homes(site: TwoServers) -> None:
    """The first server has an alarm of the time before: a bus without a worker."""
    there = site.second.services[LineAlarms]
    live = site.second.services[LiveState].buses[BUS_NAME]
    live.apply([Reading(2, time.time(), 0, 0, 0, REMOTE, 0)])
    await until(lambda: there.of_unit(BUS_NAME, 2), "the alarm at the home")
    expected = (await site.program(Role.VIEWER, site.second).get("/api/v1/alarms")).json()
    of_bus = [alarm for alarm in expected["alarms"] if alarm["bus"] == BUS_NAME]
    assert [alarm["code"] for alarm in of_bus] == ["estop_active"]
    for client in (site.program(Role.VIEWER), site.browser(Role.VIEWER)):
        client.cookies[COOKIE] = SECOND
        merged = (await client.get("/api/v1/alarms")).json()
        assert [alarm for alarm in merged["alarms"] if alarm["bus"] == BUS_NAME] == of_bus
        assert merged["elsewhere"] == []
    filtered = (await site.program(Role.VIEWER).get("/api/v1/alarms?priority=low")).json()
    assert [alarm for alarm in filtered["alarms"] if alarm["bus"] == BUS_NAME] == []
    live.apply([Reading(2, time.time(), 0, 0, 0, REMOTE, HEALTHY)])


async def test_a_page_has_the_buses_of_the_server_that_shows_it(site: TwoServers) -> None:
    """A bus of another home would be one without a worker here."""
    browser = site.browser(Role.VIEWER)
    assert "/units/dry-end/1" not in (await browser.get("/account")).text
    here = (await browser.get("/")).text
    assert "/units/dry-end/1" in here, "the only home there is"
    site.first.homes.put("other", FIRST)
    servers = site.first.servers
    servers.buses = (*servers.buses, "other")
    try:
        assert "/units/dry-end/1" not in (await site.browser(Role.VIEWER).get("/")).text
        screen = site.first.services[Hub].screen("en")
        assert screen.shown["line_summary"]["verdict"] == "No unit is configured"
    finally:
        servers.buses = servers.buses[:-1]
        site.first.homes.homes.pop("other")


async def test_a_home_that_is_away_is_named_and_nothing_is_sent(site: TwoServers) -> None:
    site.move(SECOND, f"http://127.0.0.1:{free_port()}")
    program, browser = site.program(Role.ENGINEER), site.browser(Role.VIEWER)
    refused = await program.put(PARAMETER, json={"raw": 70})
    assert refused.status_code == 503
    assert (refused.json()["code"], refused.json()["outcome"]) == ("bus_closed", "not_sent")
    assert (await program.get(BUS)).json()["code"] == "home_away"
    page = await browser.get("/bus/dry-end")
    assert page.status_code == 503
    assert "The home of dry-end, app-2, does not respond" in page.text
    assert 'href="/lines"' in page.text
    cookie = "; ".join(f"{name}={value}" for name, value in site.cookies[Role.VIEWER].items())
    url = f"{site.first.url.replace('http', 'ws')}/live?home="
    with pytest.raises(InvalidStatus) as away:
        await connect(url + SECOND, additional_headers={"Cookie": cookie})
    assert away.value.response.status_code == 503
    async with connect(f"{url}here", additional_headers={"Cookie": cookie}) as page:
        assert json.loads(await page.recv())["is"] == "snapshot"
    assert (await browser.get("/lines")).status_code == 200
    assert site.line.written == []


async def test_a_loop_ends_at_the_second_server(site: TwoServers) -> None:
    """Each believes the other to be the home."""
    site.second.homes.put("dry-end", FIRST, site.first.url)
    program = site.program(Role.ENGINEER)
    assert (await program.get(BUS)).json()["reason"] == "home_changes"
    refused = await program.put(PARAMETER, json={"raw": 70})
    assert (refused.status_code, refused.json()["code"]) == (503, "bus_closed")
    assert site.line.written == []


async def test_without_the_time_of_the_store_no_command_is_passed_on(
    site: TwoServers, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its age could not be stated."""
    monkeypatch.setattr(StoreClock, "is_known", lambda _clock, _now: False)
    refused = await site.program(Role.ENGINEER).put(PARAMETER, json={"raw": 70})
    assert (refused.status_code, refused.json()["code"]) == (503, "bus_closed")
    assert site.line.written == []


async def test_control_of_the_line_is_at_its_home(site: TwoServers) -> None:
    """It is held at all servers by the same user."""
    first, second = site.program(Role.OPERATOR), site.program(Role.ENGINEER, site.second)
    taken = await first.post(f"{BUS}/control")
    assert (taken.status_code, taken.json()["code"]) == (409, "controlled")
    assert (await second.delete(f"{BUS}/control")).status_code == 200
    assert (await first.post(f"{BUS}/control")).status_code == 200
    assert (await second.get(f"{BUS}/control")).json()["holder"] == "key-operator"
    refused = await second.put(PARAMETER, json={"raw": 70})
    assert (refused.status_code, refused.json()["code"]) == (409, "controlled")
    assert site.line.written == []
    assert (await first.delete(f"{BUS}/control")).status_code == 200
    assert (await site.program(Role.ENGINEER).post(f"{BUS}/control")).status_code == 200
    assert (await second.put(PARAMETER, json={"raw": 70})).status_code == 200


async def test_a_body_is_bounded_and_passed_on_in_pieces(site: TwoServers) -> None:
    async def pieces(size: int) -> AsyncIterator[bytes]:
        for _ in range(0, size, 1024):
            yield b" " * 1024

    program = site.program(Role.ENGINEER)
    content = {"Content-Type": "application/json"}
    small = await program.put(PARAMETER, content=_with_value(pieces(4096)), headers=content)
    assert (small.status_code, site.line.written) == (200, [(1, 6, 71)])
    large = await program.put(PARAMETER, content=_with_value(pieces(100_000)), headers=content)
    assert large.status_code == 413
    assert site.line.written == [(1, 6, 71)]


async def _with_value(pieces: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    yield b'{"raw": 71'
    async for piece in pieces:
        yield piece
    yield b"}"
