"""What a foreign page may make a browser do: nothing. And what our own pages are forbidden."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from starlette.testclient import TestClient, WebSocketDenialResponse

from app.core.web.access import Role
from app.core.web.request_rules import MAX_BODY_BYTES, same_origin
from app.main import create_app
from app.people.auth.accounts import Accounts
from tests.administrator import BY
from tests.app.complete_app import HOST, House, settings_in
from tests.for_each import for_each


@for_each(
    ("origin", "host", "same"),
    [
        ("http://plant:8000", "plant:8000", True),
        ("http://PLANT:8000", "plant:8000", True),
        ("http://plant", "plant:80", True),
        ("https://plant", "plant", True),
        ("http://[::1]:8000", "[::1]:8000", True),
        ("http://plant:8001", "plant:8000", False),
        ("http://evil", "plant", False),
        ("http://plant.evil", "plant", False),
        ("https://plant", "plant:80", False),
        ("null", "plant", False),
        ("", "", False),
        ("http://plant:x", "plant", False),
        ("http://[", "plant", False),
    ],
)
def test_whether_an_origin_is_ours(origin: str, host: str, same: bool) -> None:
    assert same_origin(origin, host) is same


async def test_what_changes_something_must_come_from_our_own_page(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    evil = ("http://evil.example", "null", f"http://{HOST}:81")
    foreign = [*({"origin": each} for each in evil), *({"sec-fetch-site": f"{each}-site"} for each in SITES)]
    for headers in foreign:
        response = await client.post("/account/language", data={"language": "de"}, headers=headers)
        assert response.status_code == 403, headers
    [user] = await house.services[Accounts].users()
    assert user.language == ""
    for headers in ({}, {"origin": f"http://{HOST}"}, {"sec-fetch-site": "same-origin"}):
        response = await client.post("/account/language", data={"language": "de"}, headers=headers)
        assert response.status_code == 303, headers
    [user] = await house.services[Accounts].users()
    assert user.language == "de"


SITES = ("cross", "same")
"""Where a browser says that a request of another origin came from."""


async def test_a_foreign_page_cannot_sign_a_user_in(house: House) -> None:
    await house.add("ann", Role.VIEWER)
    response = await house.client(origin="http://evil.example").post("/login", data={"name": "ann"})
    assert (response.status_code, response.json()["code"]) == (403, "foreign_origin")


@for_each(
    ("headers", "words"),
    [
        ({"origin": "https://line.plant"}, "the header Host names this server plant.example"),
        ({"origin": f"http://{HOST}:81"}, "the header Host names this server plant.example"),
        (
            {"origin": "https://line.plant", "x-forwarded-host": "line.plant"},
            "name the proxy&#39;s address in trusted_proxies",
        ),
        (
            {"origin": "https://line.plant", "x-forwarded-host": HOST},
            "the header X-Forwarded-Host names this server plant.example",
        ),
        ({"origin": "null"}, "the request came from a page of null"),
        ({"sec-fetch-site": "cross-site"}, "the request came from a page of another site"),
    ],
)
async def test_a_person_behind_a_proxy_gets_a_page_that_names_the_header(
    house: House, headers: dict[str, str], words: str
) -> None:
    client = house.client(accept="text/html,*/*;q=0.8", **headers)
    response = await client.post("/login", data={"name": "ann"})
    assert response.status_code == 403
    assert response.headers["content-type"] == "text/html; charset=utf-8"
    assert words in response.text
    german = await client.post("/login", data={}, headers={"accept-language": "de"})
    assert "die Anfrage kam von einer Seite von" in german.text


async def test_looking_is_free(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    assert (await client.get("/events", headers={"origin": "http://evil.example"})).status_code == 200


@pytest.mark.parametrize("path", ["/live", "/feed"])
def test_a_websocket_of_a_foreign_page_is_refused_even_with_a_good_token(tmp_path: Path, path: str) -> None:
    app = create_app(settings_in(tmp_path))
    with TestClient(app) as client:
        make = app.state.services[Accounts].create_token
        role, bus = (Role.WORKER, "dry-end") if path == "/feed" else (Role.ENGINEER, "")
        token = client.portal.call(lambda: make("t", role, bus=bus, **BY))  # type: ignore[union-attr]
        headers = {"authorization": f"Bearer {token}", "origin": "http://evil.example"}
        with (
            pytest.raises(WebSocketDenialResponse) as refused,
            client.websocket_connect(path, headers=headers),
        ):
            pass
        assert refused.value.status_code == 403
        headers["origin"] = "http://testserver"
        with client.websocket_connect(path, headers=headers):
            pass


@for_each("path", ["/login", "/healthz", "/api/v1/line", "/static/x/nothing"])
async def test_every_document_forbids_unused_browser_features(house: House, path: str) -> None:
    headers = (await house.client().get(path)).headers
    policy = headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "same-origin"


@for_each("name", ["js/main.js", "css/lineside.css", "vendor/inter.woff2", "icons/lineside-192.png"])
async def test_a_file_that_is_no_document_has_the_headers_of_a_file_only(house: House, name: str) -> None:
    headers = (await house.client().get(f"/static/x/{name}")).headers
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["cross-origin-resource-policy"] == "same-origin"
    assert not {"content-security-policy", "referrer-policy", "permissions-policy"} & set(headers)


@for_each("path", ["/static/x/icons/sprite.svg", "/static/x/js/nothing.js", "/sw.js"])
async def test_documents_and_workers_have_a_policy_wherever_they_are(house: House, path: str) -> None:
    headers = (await house.client().get(path)).headers
    assert "default-src 'self'" in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"


async def test_no_page_is_kept_by_a_cache(house: House) -> None:
    client = await house.signed_in(Role.ADMIN)
    for path in ("/events", "/users", "/account", "/api/v1/line", "/metrics"):
        assert (await client.get(path)).headers["cache-control"] == "no-store"


async def test_head_of_whatever_can_be_read(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    for path in ("/healthz", "/", "/api/v1/line", "/metrics"):
        head, got = await client.head(path), await client.get(path)
        assert (head.status_code, head.headers["content-type"]) == (200, got.headers["content-type"])
    assert (await client.head("/api/v1/nothing")).status_code == 404
    assert (await house.client().head("/api/v1/line")).status_code == 401
    assert (await client.head("/logout")).status_code == 405


async def test_requests_cannot_fill_the_memory(house: House) -> None:
    client, much = house.client(), MAX_BODY_BYTES + 1
    program = {"accept": "application/json"}
    response = await client.post("/login", content=b"x" * much, headers=program)
    assert (response.status_code, response.json()["code"]) == (413, "too_large")

    async def pieces() -> AsyncIterator[bytes]:
        for _ in range(much // 1024 + 1):
            yield b"x" * 1024

    form = {"content-type": "application/x-www-form-urlencoded"}
    unsaid = await client.post("/login", content=pieces(), headers=form | program)
    assert unsaid.status_code in (413, 422)
    sender = await house.program(Role.OPERATOR)
    unsaid = await sender.post("/api/v1/buses/dry-end/units/1/speed", content=pieces())
    assert (unsaid.status_code, unsaid.json()["code"]) == (413, "too_large")
    page = await client.post("/login", content=b"x" * much, headers={"accept": "text/html"})
    assert (page.status_code, "more than 64 kB were sent" in page.text) == (413, True)
    assert page.headers["content-type"].startswith("text/html")
    long_name = await client.post("/login", content=b"name=" + b"x" * 60_000, headers=form)
    assert long_name.status_code == 401
    assert "x" * 100 not in long_name.text
