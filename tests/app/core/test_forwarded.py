"""The sender of a request: believed of trusted proxies only."""

from __future__ import annotations

import asyncio
from ipaddress import ip_network
from pathlib import Path

import pytest
from starlette.datastructures import Headers
from starlette.types import Message, Receive, Scope, Send

from app.core.server.addresses import (
    MAX_HOPS,
    MAX_UNDER_WAY,
    Forwarded,
    Origin,
    canonical,
    origin_of,
    source_of,
)
from app.core.web.access import Role
from app.core.web.request_rules import host_name
from app.settings import ConfigurationError, load
from tests.app.complete_app import PASSWORD, complete_app, settings_in
from tests.for_each import for_each

PROXIES = (ip_network("10.0.0.0/28"), ip_network("2001:db8::/64"))


def origin(peer: str, **headers: str) -> Origin:
    forwarded_headers = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    return origin_of(peer, Headers(raw=forwarded_headers), PROXIES)


@for_each(
    ("peer", "forwarded_for", "address"),
    [
        ("192.0.2.7", "198.51.100.9", "192.0.2.7"),
        ("127.0.0.1", "198.51.100.9", "127.0.0.1"),
        ("10.0.0.5", "", "10.0.0.5"),
        ("10.0.0.5", "198.51.100.9", "198.51.100.9"),
        ("::ffff:10.0.0.5", "198.51.100.9", "198.51.100.9"),
        ("10.0.0.5", "127.0.0.1, 198.51.100.9", "198.51.100.9"),
        ("10.0.0.5", "198.51.100.9, 10.0.0.6", "198.51.100.9"),
        ("10.0.0.5", "10.0.0.7, 10.0.0.6", "10.0.0.7"),
        ("10.0.0.5", "198.51.100.9:4711", "198.51.100.9"),
        ("10.0.0.5", "[2001:db8:1::9]:4711", "2001:db8:1::9"),
        ("2001:db8::1", "2001:db8:1::9", "2001:db8:1::9"),
        ("10.0.0.5", "admin'; --", "10.0.0.5"),
        ("10.0.0.5", "1.2.3.4, unknown, 10.0.0.6", "10.0.0.6"),
        ("10.0.0.5", "6.6.6.6," + "10.0.0.6," * MAX_HOPS + "10.0.0.7", "10.0.0.6"),
        ("testclient", "198.51.100.9", "testclient"),
    ],
)
def test_the_right_most_address_that_is_no_trusted_proxy(peer: str, forwarded_for: str, address: str) -> None:
    assert origin(peer, x_forwarded_for=forwarded_for).address == address


@for_each(
    ("headers", "scheme", "host"),
    [
        ({"x_forwarded_proto": "https", "x_forwarded_host": "mill.example"}, "https", "mill.example"),
        ({"x_forwarded_proto": "http, HTTPS"}, "https", ""),
        ({"x_forwarded_proto": "javascript"}, "", ""),
        ({"x_forwarded_host": "evil.example, mill.example:8443"}, "", "mill.example:8443"),
        ({"x_forwarded_host": "mill.example/@evil"}, "", ""),
        ({"x_forwarded_host": "mill_2:8443"}, "", "mill_2:8443"),
        ({"x_forwarded_host": "[2001:db8::1]:80"}, "", "[2001:db8::1]:80"),
    ],
)
def test_how_a_client_called_the_proxy(headers: dict[str, str], scheme: str, host: str) -> None:
    parsed = origin("10.0.0.5", **headers)
    assert (parsed.scheme, parsed.host) == (scheme, host)
    assert origin("192.0.2.7", **headers) == Origin("192.0.2.7")


@for_each(
    ("address", "source"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:0db8:1:2::9", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("::1", "::/64"),
        ("", ""),
        ("unix", "unix"),
    ],
)
def test_addresses_counted_as_one_client(address: str, source: str) -> None:
    assert source_of(address) == source


def test_an_address_has_one_form() -> None:
    assert canonical("2001:0DB8:0::7") == "2001:db8::7"


@for_each(
    ("header", "name"),
    [("Mill.Example.:8000", "mill.example"), ("[::1]:80", "::1"), ("x:y", "x"), ("[", ""), ("", "")],
)
def test_the_name_in_a_host_header(header: str, name: str) -> None:
    assert host_name(header) == name


async def test_a_forged_address_reaches_no_log(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        house.address = "127.0.0.1"
        await house.add("ann", Role.VIEWER)
        forged = {"x-forwarded-for": "203.0.113.66", "x-forwarded-host": "evil.example"}
        await house.client(**forged).post("/login", data={"name": "ann", "password": PASSWORD})
        [event] = await house.events("login")
        assert event["origin"] == "127.0.0.1"


async def test_a_trusted_proxy_is_believed(tmp_path: Path) -> None:
    server = settings_in(tmp_path).server.model_copy(update={"trusted_proxies": PROXIES})
    async with complete_app(tmp_path, server=server) as house:
        house.address = "10.0.0.5"
        await house.add("ann", Role.VIEWER)
        forwarded_headers = {
            "x-forwarded-for": "203.0.113.66",
            "x-forwarded-proto": "https",
            "x-forwarded-host": "mill.example",
        }
        client = house.client(origin="https://mill.example", **forwarded_headers)
        response = await client.post("/login", data={"name": "ann", "password": PASSWORD})
        assert (response.status_code, "Secure" in response.headers["set-cookie"]) == (303, True)
        [event] = await house.events("login")
        assert event["origin"] == "203.0.113.66"


async def test_only_under_its_own_names(tmp_path: Path) -> None:
    names = {"allowed_hosts": ("mill.example", "10.0.0.7")}
    server = settings_in(tmp_path).server.model_copy(update=names)
    async with complete_app(tmp_path, server=server) as house:
        for host, path, address, status in (
            ("mill.example", "/login", "192.0.2.7", 200),
            ("MILL.example.:8000", "/login", "192.0.2.7", 200),
            ("10.0.0.7", "/login", "192.0.2.7", 200),
            ("evil.example", "/login", "192.0.2.7", 421),
            ("evil.example", "/healthz", "192.0.2.7", 200),
            ("evil.example", "/login", "127.0.0.1", 421),
            ("127.0.0.1:8000", "/login", "192.0.2.7", 421),
            ("127.0.0.1:8000", "/login", "127.0.0.1", 200),
            ("localhost", "/login", "127.0.0.1", 200),
            ("", "/login", "192.0.2.7", 421),
        ):
            house.address = address
            response = await house.client(accept="application/json").get(path, headers={"host": host})
            assert response.status_code == status, host
            if status != 200:
                assert response.json()["code"] == "wrong_host"
                assert response.headers["x-content-type-options"] == "nosniff"
        headers = [("host", "mill.example"), ("host", "evil.example")]
        response = await house.client().get("/healthz", headers=headers)
        assert (response.status_code, response.json()["code"]) == (400, "malformed")


@for_each(
    ("key", "words"),
    [
        ('trusted_proxies = ["10.0.0.5/8"]', "write the address of a proxy"),
        ('trusted_proxies = ["proxy"]', "write the address of a proxy"),
        ("trusted_proxies = [7]", "write the address of a proxy"),
        ('trusted_proxies = ["0.0.0.0/0"]', "name the proxies"),
        ('allowed_hosts = ["http://mill"]', "without scheme and port"),
        ('allowed_hosts = ["mill:8000"]', "without scheme and port"),
        ('allowed_hosts = [""]', "without scheme and port"),
    ],
)
def test_a_wrong_name_stops_the_start_with_its_line(tmp_path: Path, key: str, words: str) -> None:
    path = tmp_path / "lineside.toml"
    path.write_text(f"[server]\n{key}\n")
    with pytest.raises(ConfigurationError, match=rf"lineside.toml:2: .*{words}"):
        load(path)


def test_addresses_and_names_as_they_are_written(tmp_path: Path) -> None:
    path = tmp_path / "lineside.toml"
    path.write_text(
        '[server]\ntrusted_proxies = ["10.0.0.5", "2001:db8::/64"]\n'
        'allowed_hosts = ["Mill", "[::1]", "mill_2"]\n'
    )
    server = load(path).server
    assert [str(network) for network in server.trusted_proxies] == ["10.0.0.5/32", "2001:db8::/64"]
    assert server.allowed_hosts == ("mill", "::1", "mill_2")


async def test_behind_a_proxy_each_address_has_so_many_requests_under_way() -> None:
    gate, statuses = asyncio.Event(), list[int]()

    async def app(_scope: Scope, _receive: Receive, send: Send) -> None:
        await gate.wait()
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body"})

    async def receive() -> Message:
        return {"type": "http.request"}

    async def send(message: Message) -> None:
        if message["type"] == "http.response.start":
            statuses.append(message["status"])

    noted = list[tuple[str, str, str]]()
    forwarded = Forwarded(app, PROXIES, lambda *refused: noted.append(refused))

    async def request(client: str) -> None:
        headers = [(b"x-forwarded-for", client.encode())]
        scope = {"type": "http", "headers": headers, "client": ("10.0.0.5", 1), "method": "GET", "path": "/"}
        await forwarded(scope, receive, send)

    parsed = [asyncio.create_task(request("198.51.100.9")) for _ in range(MAX_UNDER_WAY + 1)]
    parsed.append(asyncio.create_task(request("198.51.100.10")))
    while not statuses:  # noqa: ASYNC110
        await asyncio.sleep(0)
    assert (statuses, noted) == ([429], [("198.51.100.9", "429", "/")])
    gate.set()
    await asyncio.gather(*parsed)
    assert statuses[1:] == [200] * (MAX_UNDER_WAY + 1)
    assert not forwarded._under_way
