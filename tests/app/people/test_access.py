"""Access is denied by default, to each route and WebSocket, and each refusal is recorded."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from fastapi import APIRouter, FastAPI
from fastapi.routing import APIRoute, APIWebSocketRoute
from starlette.requests import HTTPConnection
from starlette.testclient import TestClient, WebSocketDenialResponse
from starlette.types import Message, Receive, Scope, Send
from starlette.websockets import WebSocketDisconnect
from structlog.testing import capture_logs
from uvicorn.protocols.utils import ClientDisconnected

from app.core.database import Database
from app.core.server.connections import CONNECTION, ClientConnection
from app.core.web.access import PEOPLE_ROLES, SESSION, Person, Requires, Role, public
from app.core.web.routes import GuardedRoute, calls_of, refuse_unguarded
from app.main import create_app
from app.people.audit.log import EventLog
from app.people.auth import identify as access
from app.people.auth import rules
from app.people.auth.accounts import Accounts
from app.people.auth.identify import PUBLIC_PATHS, Identity
from tests.administrator import BY
from tests.app.complete_app import EVERY_ROLE, HOST, PASSWORD, House, complete_app, settings_in
from tests.for_each import for_each

FILLED = {"bus": "dry-end", "unit": "1", "number": "1", "name": "nobody", "version": "x"}


HAS = {
    Role.VIEWER: {Role.VIEWER},
    Role.OPERATOR: {Role.VIEWER, Role.OPERATOR},
    Role.ENGINEER: {Role.VIEWER, Role.OPERATOR, Role.ENGINEER},
    Role.ADMIN: {Role.VIEWER, Role.OPERATOR, Role.ENGINEER, Role.ADMIN},
    Role.WORKER: {Role.WORKER},
}
"""Which rights each role includes. A worker has only the feed, and is the only role that has it."""


ENDLESS = "/api/v1/stream"
"""Its headers come at once, and its body has no end."""


SIGNING_IN = {"/login", "/login/panel", "/setup"}
"""They refuse an empty form by 401."""


def filled(path: str) -> str:
    return re.sub(r"\{(\w+)(?::\w+)?\}", lambda found: FILLED.get(found[1], "1"), path)


def demands(app: FastAPI) -> Iterator[tuple[APIRoute | APIWebSocketRoute, set[Role | None]]]:
    """Each route with the roles that it requires; ``None`` stands for public."""
    for route in app.routes:
        assert isinstance(route, GuardedRoute | APIWebSocketRoute), route
        declared = [call for call in calls_of(route) if isinstance(call, Requires) or call is public]
        yield route, {getattr(each, "role", None) for each in declared}


def http_calls(app: FastAPI) -> Iterator[tuple[str, str, set[Role | None]]]:
    for route, roles in demands(app):
        for method in sorted(getattr(route, "methods", None) or ()):
            if method != "HEAD":
                yield method, filled(route.path), roles


def sockets(app: FastAPI) -> list[tuple[str, set[Role | None]]]:
    return [
        (filled(route.path), roles) for route, roles in demands(app) if isinstance(route, APIWebSocketRoute)
    ]


def may(role: Role, roles: set[Role | None]) -> bool:
    return roles <= {None, *HAS[role]}


def is_refusal_for_role(response: httpx.Response) -> bool:
    if response.status_code != 403:
        return False
    return "this needs the role" in response.text


async def test_an_anonymous_client_gets_only_public_routes(house: House) -> None:
    client = house.client(accept="text/html")
    seen = 0
    for method, path, roles in http_calls(house.app):
        response = await client.request(method, path)
        seen += 1
        if None in roles:
            assert path in SIGNING_IN or response.status_code not in (401, 403), path
            assert path in PUBLIC_PATHS or path.startswith("/static/"), path
        elif path.startswith("/api/") or path == "/metrics":
            assert response.status_code == 401, (method, path)
            assert response.headers["www-authenticate"] == "Bearer"
            assert response.json()["code"] == "unauthorized"
        else:
            assert response.status_code == 303, (method, path)
            assert response.headers["location"].startswith("/login"), path
    assert seen > 50


async def test_each_role_gets_what_it_may_and_nothing_else(house: House) -> None:
    """Each call as the least role that may, and the greatest that may not, which is a worker where all people
    may: the roles of people include one another."""
    programs = {role: await house.program(role) for role in EVERY_ROLE}
    for method, path, roles in http_calls(house.app):
        if path in SIGNING_IN:
            continue
        may_people = [role for role in PEOPLE_ROLES if may(role, roles)]
        may_not = [role for role in PEOPLE_ROLES if not may(role, roles)]
        for role in (*may_people[:1], *(may_not[-1:] or (Role.WORKER,))):
            used = "HEAD" if path == ENDLESS and may(role, roles) else method
            response = await programs[role].request(used, path, headers={"accept": "application/json"})
            where = (method, path, role, response.text)
            assert response.status_code != 401, where
            assert response.status_code < 500 or response.status_code in (503, 504), where
            assert is_refusal_for_role(response) is not may(role, roles), where


def test_the_roles_of_people_include_one_another() -> None:
    assert {role: {other for other in EVERY_ROLE if role.includes(other)} for role in EVERY_ROLE} == HAS


@pytest.mark.parametrize("role", [None, *EVERY_ROLE])
def test_each_websocket(tmp_path: Path, role: Role | None) -> None:
    app = create_app(settings_in(tmp_path))
    with TestClient(app) as client:
        headers = {}
        if role:
            make = app.state.services[Accounts].create_token
            bus = "dry-end" if role is Role.WORKER else ""
            token = client.portal.call(lambda: make("t", role, bus=bus, **BY))  # type: ignore[union-attr]
            headers["authorization"] = f"Bearer {token}"
        paths = sockets(app)
        assert {path for path, _ in paths} >= {"/live", "/feed"}
        for path, roles in paths:
            if role and may(role, roles):
                with client.websocket_connect(path, headers=headers):
                    pass
                continue
            with (
                pytest.raises(WebSocketDenialResponse) as refused,
                client.websocket_connect(path, headers=headers),
            ):
                pass
            assert refused.value.status_code == (403 if role else 401), path


async def test_the_server_learns_whose_a_connection_is(house: House) -> None:
    """Connections of accounts, the workers' among them, are counted apart from those of strangers."""
    seen: list[str] = []

    class Noting(ClientConnection):
        def identify(self, account: str) -> None:
            seen.append(account)

    async def offering(scope: Scope, receive: Receive, send: Send) -> None:
        await house.app({**scope, "state": {CONNECTION: Noting()}}, receive, send)

    page = await house.signed_in(Role.ENGINEER, "ann")
    transport = httpx.ASGITransport(offering)
    async with httpx.AsyncClient(transport=transport, base_url=f"http://{HOST}") as client:
        await client.get("/login")
        assert seen == []
        await client.get(
            "/api/v1/line", headers={"authorization": f"Bearer {await house.token(Role.VIEWER)}"}
        )
        client.cookies = page.cookies
        await client.get("/")
    assert seen == ["key-viewer (token)", "ann"]
    coming = [{"type": "websocket.disconnect", "code": 1000}, {"type": "websocket.connect"}]

    async def receive() -> Message:
        return coming.pop()

    async def send(message: Message) -> None:
        assert message["type"] != "websocket.http.response.start"

    bearer = f"Bearer {await house.token(Role.WORKER)}"
    headers = [(b"host", HOST.encode()), (b"authorization", bearer.encode())]
    scope = {"type": "websocket", "path": "/feed", "query_string": b"", "headers": headers, "scheme": "ws"}
    await offering(scope, receive, send)
    assert seen[2:] == ["key-worker (token)"]


async def test_a_page_that_has_gone_ends_its_socket_without_an_error(house: House) -> None:
    coming = [{"type": "websocket.disconnect", "code": 1005}, {"type": "websocket.connect"}]

    async def receive() -> Message:
        return coming.pop()

    async def send(message: Message) -> None:
        if message["type"] == "websocket.close":
            raise ClientDisconnected

    bearer = f"Bearer {await house.token(Role.VIEWER)}"
    headers = [(b"host", HOST.encode()), (b"authorization", bearer.encode())]
    scope = {"type": "websocket", "path": "/live", "query_string": b"", "headers": headers, "scheme": "ws"}
    await house.app(scope, receive, send)
    assert coming == []


async def test_an_app_guards_no_routes_of_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The features' routes are of the process, and a process may have several apps."""
    checked: list[Role] = []
    check = Requires.__call__

    async def counting(self: Requires, connection: HTTPConnection) -> Person:
        checked.append(self.role)
        return await check(self, connection)

    monkeypatch.setattr(Requires, "__call__", counting)
    async with complete_app(tmp_path / "one") as one:
        viewer = await one.program(Role.VIEWER)
        await viewer.get("/api/v1/line")
        once = len(checked)
        async with complete_app(tmp_path / "other"):
            await viewer.get("/api/v1/line")
    assert once > 0
    assert len(checked) == 2 * once


async def test_an_unknown_path_reveals_nothing(house: House) -> None:
    assert (await house.client().get("/api/v1/nowhere")).status_code == 401
    assert (await house.client(accept="text/html").get("/nowhere")).status_code == 303


def test_every_route_declares_a_role_or_that_it_is_public(tmp_path: Path) -> None:
    declared = list(demands(create_app(settings_in(tmp_path))))
    assert len(declared) > 200
    assert [route.path for route, roles in declared if not roles] == []


async def test_a_route_that_declares_nothing_is_never_served() -> None:
    app, router = FastAPI(openapi_url=None), APIRouter(route_class=GuardedRoute)

    @router.get("/forgotten")
    def forgotten() -> None: ...

    app.router.routes.extend(router.routes)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://line") as client:
        for _ in range(2):
            with pytest.raises(RuntimeError, match="/forgotten declares no role"):
                await client.get("/forgotten")


def test_a_route_without_a_guard_stops_the_start() -> None:
    app, router = FastAPI(openapi_url=None), APIRouter()

    @router.get("/forgotten")
    def forgotten() -> None: ...

    app.router.routes.extend(router.routes)
    with pytest.raises(RuntimeError, match="/forgotten has no guard"):
        refuse_unguarded(app)


@for_each("header", ["Bearer nonsense", "bearer ", "Bearer", "BEARER \tx", "Bearer " + "x" * 9000])
async def test_a_bad_token_is_refused_even_with_a_good_cookie(house: House, header: str) -> None:
    client = await house.signed_in(Role.ADMIN)
    response = await client.get("/api/v1/line", headers={"authorization": header})
    assert (response.status_code, response.json()["code"]) == (401, "unauthorized")


async def test_a_token_opens_pages_and_a_cookie_the_api(house: House) -> None:
    program, browser = await house.program(Role.VIEWER), await house.signed_in(Role.VIEWER)
    assert (await program.get("/events")).status_code == 200
    assert (await browser.get("/api/v1/line")).status_code == 200


async def test_a_session_that_is_over(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    client = await house.signed_in(Role.OPERATOR)
    now = house.services[Identity]._clock() + 12 * rules.HOUR
    monkeypatch.setattr(house.services[Identity], "_clock", lambda: now)
    assert (await client.get("/api/v1/line")).status_code == 401
    page = await client.get("/events?unit=1", headers={"accept": "text/html"})
    assert (page.status_code, page.headers["location"]) == (303, "/login?next=/events%3Funit%3D1")
    fragment = {"hx-request": "true", "hx-current-url": f"http://{HOST}/units/dry-end/1?x=1"}
    swapped = await client.post("/line/zero", headers=fragment)
    assert (swapped.status_code, swapped.headers["hx-redirect"]) == (
        401,
        "/login?next=/units/dry-end/1%3Fx%3D1&refused=true",
    )
    assert "nothing was sent" in (await client.get(swapped.headers["hx-redirect"])).text
    fetched = await client.get("/bus/line/tray/strip", headers=fragment)
    assert fetched.headers["hx-redirect"] == "/login?next=/units/dry-end/1%3Fx%3D1"
    assert "nothing was sent" not in (await client.get(page.headers["location"])).text
    posted = await client.post("/account/language", data={"language": "de"}, headers={"accept": "text/html"})
    assert (posted.status_code, posted.headers["location"]) == (303, "/login?refused=true")
    own_page = {"accept": "text/html", "referer": f"http://{HOST}/account"}
    posted = await client.post("/account/language", data={"language": "de"}, headers=own_page)
    assert posted.headers["location"] == "/login?next=/account&refused=true"


async def test_the_demo_signs_in_this_machine_only_and_keeps_its_language(tmp_path: Path) -> None:
    async with complete_app(tmp_path, demo=True) as house:
        for address, host, is_let_in in (
            ("127.0.0.1", "127.0.0.1:8000", True),
            ("127.0.0.1", "localhost:8000", True),
            ("::1", "[::1]:8000", True),
            ("192.0.2.7", "127.0.0.1:8000", False),
            ("127.0.0.1", "evil.example:8000", False),
            ("127.0.0.1", "127.0.0.1.evil.example", False),
        ):
            house.address = address
            response = await house.client(host=host).get("/api/v1/me")
            assert response.status_code == (200 if is_let_in else 401), host
            wrong = await house.client(host=host, authorization="Bearer x").get("/api/v1/me")
            assert wrong.status_code == 401
        house.address = "127.0.0.1"
        client = house.client(host="127.0.0.1:8000")
        chosen = {"language": "de", "back": "/events?limit=5"}
        answer = await client.post("/account/language", data=chosen)
        assert (answer.status_code, answer.headers["location"]) == (303, "/events?limit=5")
        assert '<html lang="de"' in (await client.get("/account")).text
        for foreign in ("//evil.example", "https://evil.example/"):
            answer = await client.post("/account/language", data=chosen | {"back": foreign})
            assert answer.headers["location"] == "/"


async def test_signing_in_and_out(house: House) -> None:
    house.address = "127.0.0.1"
    assert (await house.client(host="127.0.0.1").get("/api/v1/me")).status_code == 401, "no demo"
    client = await house.signed_in(Role.VIEWER, "ann")
    assert (await client.get("/api/v1/me")).json() == {"name": "ann", "role": "viewer", "via": "session"}
    cookie = client.cookies[SESSION]
    out = await client.post("/logout")
    assert (out.status_code, out.headers["location"]) == (303, "/login")
    assert SESSION not in client.cookies
    again = house.client(cookie=f"{SESSION}={cookie}")
    assert (await again.get("/api/v1/me")).status_code == 401


async def test_signing_in_over_a_session_ends_it(house: House) -> None:
    client = await house.signed_in(Role.VIEWER, "ann")
    await house.add("bert", Role.VIEWER)
    for name in ("ann", "bert"):
        before = client.cookies[SESSION]
        assert (await client.post("/login", data={"name": name, "password": "wrong"})).status_code == 401
        assert (await client.get("/api/v1/me")).status_code == 200
        assert (await client.post("/login", data={"name": name, "password": PASSWORD})).status_code == 303
        old = house.client(cookie=f"{SESSION}={before}")
        assert (await old.get("/api/v1/me")).status_code == 401
        assert (await client.get("/api/v1/me")).json()["name"] == name
    assert [event["who"] for event in await house.events("logout")] == ["ann", "ann"]


async def test_two_dashboards_on_one_host_keep_their_cookies_apart(tmp_path: Path, house: House) -> None:
    async with complete_app(tmp_path / "second") as second:
        browser = await signed_in_at(house, 8000)
        other = await signed_in_at(second, 8100)
        other.cookies.update(browser.cookies)
        browser.cookies.update(other.cookies)
        for client, name in ((browser, "ann-8000"), (other, "ann-8100")):
            assert (await client.get("/?view=rows")).status_code == 200
            assert (await client.get("/api/v1/me")).json()["name"] == name
        names = set(browser.cookies) | set(other.cookies)
        assert all(name.endswith(("_8000", "_8100")) for name in names), names
        assert (await other.post("/logout")).status_code == 303
        assert (await browser.get("/api/v1/me")).status_code == 200


async def signed_in_at(house: House, port: int) -> httpx.AsyncClient:
    """A browser that has signed in at a port of the host."""
    await house.add(f"ann-{port}", Role.VIEWER)
    client = house.client()
    client.base_url = f"http://{HOST}:{port}"
    typed = {"name": f"ann-{port}", "password": PASSWORD}
    assert (await client.post("/login", data=typed)).status_code == 303
    return client


async def test_a_session_of_before_names_had_a_port_stays(house: House) -> None:
    session = (await house.signed_in(Role.VIEWER, "ann")).cookies[SESSION]
    client = house.client(host=f"{HOST}:8000", cookie=f"{SESSION}={session}")
    assert (await client.get("/api/v1/me")).json()["name"] == "ann"
    out = await client.post("/logout")
    assert out.headers["set-cookie"].startswith(f'{SESSION}=""')
    assert (await client.get("/api/v1/me")).status_code == 401


async def test_cookies_are_kept_from_scripts_and_other_sites_and_by_https_bound_to_the_host(
    house: House,
) -> None:
    await house.add("ann", Role.VIEWER)
    client, typed = house.client(), {"name": "ann", "password": PASSWORD}
    [cookie, *_] = (await client.post("/login", data=typed)).headers.get_list("set-cookie")
    assert {"HttpOnly", "SameSite=lax"} <= set(cookie.split("; "))
    assert "Secure" not in cookie
    client = house.client()
    client.base_url = f"https://{HOST}"
    response = await client.post("/login", data=typed)
    for cookie in response.headers.get_list("set-cookie"):
        assert cookie.startswith("__Host-lineside_")
        assert {"HttpOnly", "SameSite=lax", "Secure", "Path=/"} <= set(cookie.split("; "))
        assert "Domain" not in cookie
    assert (await client.get("/api/v1/me")).status_code == 200
    new = {"present": PASSWORD, "password": "a new long one", "again": "a new long one"}
    assert (await client.post("/account/password", data=new)).status_code == 303
    out = await client.post("/logout")
    assert "Secure" in out.headers["set-cookie"]
    assert (await client.get("/api/v1/me")).status_code == 401


async def test_a_cookie_of_http_does_not_sign_in_over_https(house: House) -> None:
    """A page in clear could plant one."""
    client = await house.signed_in(Role.VIEWER, "ann")
    session = client.cookies[SESSION]
    for scheme, name, status in (
        ("https", SESSION, 401),
        ("https", f"__Host-{SESSION}", 200),
        ("http", f"__Host-{SESSION}", 401),
    ):
        other = house.client(cookie=f"{name}={session}")
        other.base_url = f"{scheme}://{HOST}"
        assert (await other.get("/api/v1/me")).status_code == status


async def test_no_header_of_a_proxy_signs_anyone_in(tmp_path: Path) -> None:
    proxy = '[server]\ndata = "data"\ntrusted_proxies = ["127.0.0.1"]\n'
    (tmp_path / "lineside.toml").write_text(proxy)
    named = ("Remote-User", "X-Remote-User", "X-Forwarded-User", "X-Auth-Request-User", "X-SSL-Client-CN")
    async with complete_app(tmp_path, config=tmp_path / "lineside.toml") as house:
        await house.add("anna", Role.ADMIN)
        for header in named:
            found = await house.client(**{header: "anna"}).get("/api/v1/buses")
            assert found.status_code == 401, header


SPEED = "/api/v1/buses/dry-end/units/1/speed"


async def recorded(house: House) -> list[tuple[str, str, str, str, int]]:
    await house.services[EventLog].repeated.record_due(everything=True)
    events = await house.events("access_refused")
    names = ("what", "who", "origin", "message")
    return [(*(event[name] for name in names), event["count"] or 1) for event in reversed(events)]


async def test_requests_beyond_the_role_and_bad_tokens_are_one_event_a_minute(house: House) -> None:
    client = await house.signed_in(Role.VIEWER, "vera")
    for number in range(5):
        assert (await client.post(SPEED, json={"raw": 1})).status_code == 403
        stranger = house.client(Authorization=f"Bearer guess-{number}")
        assert (await stranger.get("/api/v1/line")).status_code == 401
    beyond = ("access refused", "vera", "192.0.2.7", "POST /api/v1/buses/{bus}/units/{unit}/speed")
    guessed = ("token refused", "unknown token", "192.0.2.7", "")
    assert await recorded(house) == [(*beyond, 1), (*guessed, 1), (*beyond, 4), (*guessed, 4)]


async def test_a_token_that_has_expired_is_named(house: House) -> None:
    accounts = house.services[Accounts]
    token = await accounts.create_token("report", Role.VIEWER, expires_days=1, **BY)
    await house.services[Database].write(lambda c: c.execute("UPDATE tokens SET expires_at = 1.0"))
    response = await house.client(Authorization=f"Bearer {token}").get("/api/v1/line")
    assert (response.status_code, "expired on 1970-01-01" in response.json()["detail"]) == (401, True)
    assert await recorded(house) == [("token refused", "report (token)", "192.0.2.7", "", 1)]


async def test_many_addresses_are_recorded_as_many(house: House) -> None:
    for number in range(100):
        house.address = f"198.51.100.{number}"
        await house.client(Authorization="Bearer guess").get("/api/v1/line")
    events = await recorded(house)
    assert len(events) < 30
    assert events[-1] == ("token refused", "unknown token", "several addresses", "", 79)


async def test_a_subnet_of_ipv6_is_one_sender(house: House) -> None:
    for number in range(5):
        house.address = f"2001:db8::{number:x}"
        await house.client(Authorization="Bearer guess").get("/api/v1/line")
    assert {origin for _, _, origin, *_ in await recorded(house)} == {"2001:db8::/64"}


async def test_a_foreign_page_is_on_record(house: House) -> None:
    await house.client(origin="http://evil.example").post("/login", data={"name": "ann"})
    assert await recorded(house) == [("request from a page of another site refused", "", "192.0.2.7", "", 1)]


async def test_a_request_without_sign_in_is_not_recorded(house: House) -> None:
    assert (await house.client().get("/api/v1/line")).status_code == 401
    assert (await house.client(cookie="lineside_session=old").get("/api/v1/line")).status_code == 401
    assert await recorded(house) == []


async def test_responses_that_refuse_are_logged_by_address(house: House) -> None:
    requests = [
        (None, "GET", "/healthz", 200),
        (Role.VIEWER, "GET", "/nowhere", 404),
        (None, "GET", "/api/v1/line", 401),
        (None, "POST", "/login", 413),
        (Role.VIEWER, "POST", SPEED, 403),
    ]
    with capture_logs() as logs:
        for number, (role, method, path, status) in enumerate(requests):
            house.address = f"192.0.2.{number}"
            client = house.client() if role is None else await house.signed_in(role, f"vera{number}")
            content = b"x" * 100_000 if status == 413 else b""
            assert (await client.request(method, path, content=content)).status_code == status
    refused = [entry for entry in logs if entry["event"] == "request refused"]
    assert [(entry["address"], entry["reason"], entry["request"]) for entry in refused] == [
        ("192.0.2.3", "413", "/login"),
        ("192.0.2.4", "403", SPEED),
    ]


async def test_a_client_that_leaves_its_handshake_is_a_refused_request(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def leave(*_: object) -> None:
        raise WebSocketDisconnect(1006)

    async def receive() -> Message:
        return {"type": "websocket.disconnect"}

    async def send(_: Message) -> None: ...

    monkeypatch.setattr(access, "refuse", leave)
    scope: Scope = {"type": "websocket", "path": "/feed", "headers": [], "client": ("192.0.2.7", 1)}
    with capture_logs() as logs:
        await house.app(scope | {"query_string": b"", "scheme": "ws"}, receive, send)
    assert [(entry["address"], entry["reason"]) for entry in logs] == [("192.0.2.7", "incomplete")]
