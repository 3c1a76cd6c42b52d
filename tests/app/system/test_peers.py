"""The lines of other servers: read over the network, and what is said of one that cannot be read."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from app.cli import cli
from app.cli.check import peers as peer_findings
from app.core.web.access import Role
from app.feature import Services
from app.settings import ConfigurationError, load
from app.system.peers import client
from app.system.peers.board import LineBoard, LineTiles, Peer
from app.system.peers.client import fault_of, read_report
from app.system.peers.settings import PeerSettings
from app.version import VERSION
from bus.messages import TEXTS
from tests.app.complete_app import House, complete_app, served
from tests.app.served_tls import served as served_with_tls
from tests.for_each import for_each

PATIENCE_S = 60.0
EMPTY = {
    "time": "2026-11-29T06:00:00.000+00:00",
    "version": VERSION,
    "instance": "x",
    "lines": [],
    "peers": [],
}
Serve = Callable[[asyncio.StreamWriter], Awaitable[None]]


def peer(url: str, folder: Path, token: str = "secret", name: str = "Mill 2") -> PeerSettings:
    file = folder / f"{name}.token"
    file.write_text(f"{token}\n")
    return PeerSettings(name=name, url=url, token_file=file)


@asynccontextmanager
async def answered(serve: Serve) -> AsyncIterator[str]:
    """The URL of a server that does not speak as a Lineside does."""

    async def respond(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        serving.append(asyncio.current_task())
        with suppress(ConnectionError, asyncio.IncompleteReadError):
            await reader.readuntil(b"\r\n\r\n")
            await serve(writer)
            await writer.drain()
        writer.close()
        with suppress(ConnectionError):
            await writer.wait_closed()

    serving: list[Any] = []
    server = await asyncio.start_server(respond, "127.0.0.1", 0)
    async with server:
        yield f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    await asyncio.gather(*serving)


def with_body(body: bytes, status: str = "200 OK", more: str = "") -> Serve:
    """Always the same response."""

    async def serve(writer: asyncio.StreamWriter) -> None:
        head = f"HTTP/1.1 {status}\r\nContent-Length: {len(body)}\r\nConnection: close\r\n{more}\r\n"
        writer.write(head.encode() + body)

    return serve


async def endless(writer: asyncio.StreamWriter) -> None:
    writer.write(b"HTTP/1.1 200 OK\r\n\r\n")
    while True:
        writer.write(b" " * 65536)
        await writer.drain()


async def dripping(writer: asyncio.StreamWriter) -> None:
    """A byte now and then: each in time by itself."""
    writer.write(b"HTTP/1.1 200 OK\r\n\r\n")
    while True:
        writer.write(b" ")
        await writer.drain()
        await asyncio.sleep(0.01)


def report(**line: Any) -> bytes:
    """A report of one line, as a server might send it."""
    text = {"code": "line_at_zero", "params": {"n": 2}, "detail": "All 2 units at zero"}
    names = ("peer", "url", "age_s", "level", "place", "cause", "scan_hz", "speeds", "measure", "recipe")
    alarms = {"active": {}, "unacknowledged": {}, "first": None, "first_priority": None}
    known = {"bus": "wet-end", "site": "Mill 2", "stale": False, "verdict": text, "alarms": alarms}
    more = {"units": 2, "states": {"online": 2}, "event": None}
    made = {**dict.fromkeys(names), **known, **more, **line}
    return json.dumps(EMPTY | {"lines": [made]}).encode()


# --- what is said of a peer ----------------------------------------------------------------------------


@for_each(
    ("serve", "code"),
    [
        (with_body(b"<html>"), "peer_sends_other"),
        (with_body(b'{"lines": []}'), "peer_sends_other"),
        (with_body(json.dumps(EMPTY | {"version": "9.0", "lines": [{}]}).encode()), "peer_of_other_version"),
        (with_body(report(bus="../users")), "peer_of_other_version"),
        (with_body(report(speeds=[0.0] * 61)), "peer_of_other_version"),
        (with_body(report(event={"at": "9999-12-31T23:59:59", "text": {}})), "peer_of_other_version"),
        (with_body(b"", "401 Unauthorized"), "peer_token_refused"),
        (with_body(b"", "403 Forbidden"), "peer_token_role"),
        (with_body(b"", "422 Unprocessable"), "peer_of_earlier_version"),
        (with_body(b"", "500 Internal"), "peer_status"),
        (with_body(b"", "503 Unavailable"), "peer_busy"),
        (with_body(b"", "302 Found", "Location: http://127.0.0.1:1/\r\n"), "peer_redirects"),
        (endless, "peer_too_large"),
        (dripping, "peer_timed_out"),
    ],
)
async def test_a_peer_that_is_no_such_server(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, serve: Serve, code: str
) -> None:
    if serve is dripping:
        monkeypatch.setattr(client, "WITHIN_S", 0.5)
    async with answered(serve) as url:
        fault = await fault_of(peer(url, tmp_path))
    assert fault is not None
    assert fault.code == code
    assert code in TEXTS


async def test_a_peer_that_is_not_there(tmp_path: Path) -> None:
    async with answered(dripping) as url:
        settings = peer(url, tmp_path)
    fault = await fault_of(settings)
    assert fault is not None
    assert fault.code == "peer_not_reached"
    missing = settings.model_copy(update={"token_file": tmp_path / "missing"})
    assert str(tmp_path / "missing") in str(await fault_of(missing))
    authority = settings.model_copy(update={"ca_file": tmp_path / "missing.pem"})
    assert "its ca_file" in str(await fault_of(authority))


def test_what_a_peer_says_is_text_and_nothing_else() -> None:
    hostile = {"code": "no_such_text", "params": {"x": 1}, "detail": "<script>{0.__class__}"}
    cause = {"code": "new_cause", "since": None, "exact": True, "motion": "", "mode": "", "why": None}
    lines, *_ = read_report(report(verdict=hostile, cause=cause, place="Nip"))
    summary = lines["wet-end"]
    assert str(summary.verdict) == "<script>{0.__class__}"
    assert (summary.cause, summary.place) == (None, "")


# --- two servers -----------------------------------------------------------------------------------------


def configured(folder: Path, *peers: PeerSettings, bus: bool = True) -> Path:
    """A site with these peers, with a bus or without."""
    folder.mkdir(exist_ok=True)
    config = folder / "lineside.toml"
    text = '[site]\nname = "Mill 7"\n'
    if bus:
        text += '[[bus]]\nname = "dry-end"\nport = "/dev/null"\nunit = [{id = 1, name = "Unwind"}]\n'
    for each in peers:
        text += f'[[peer]]\nname = "{each.name}"\nurl = "{each.url}"\ntoken_file = "{each.token_file}"\n'
    config.write_text(text)
    return config


async def until(find: Callable[[], Any]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not find():  # noqa: ASYNC110 - the state of a peer has no event
            await asyncio.sleep(0.05)


def board_of(services: Services) -> LineBoard:
    return services[LineTiles].board


async def seen(house: House) -> Peer:
    """The first peer, once it is read or has a fault."""
    first = board_of(house.services).peers[0]
    await until(lambda: first.reported_at or first.fault)
    return first


async def test_the_lines_of_a_peer_are_beside_the_own(tmp_path: Path) -> None:
    with served(tmp_path / "other") as other:
        settings = peer(other.url, tmp_path, other.token)
        async with complete_app(tmp_path, config=configured(tmp_path / "own", settings)) as house:
            await seen(house)
            viewer = await house.program(Role.VIEWER)
            shown = (await viewer.get("/api/v1/sites")).json()
            lines = {(line["peer"], line["bus"]): line for line in shown["lines"]}
            assert lines.keys() == {(None, "dry-end"), ("Mill 2", "dry-end")}
            theirs = lines["Mill 2", "dry-end"]
            assert theirs["url"] == f"{other.url}/?bus=dry-end"
            assert (theirs["verdict"]["code"], theirs["level"]) == ("worker_lost", "urgent")
            assert (theirs["measure"], theirs["units"], theirs["stale"]) == ("m/min", 2, False)
            assert shown["peers"] == [{**shown["peers"][0], "name": "Mill 2", "fault": None}]
            own = (await viewer.get("/api/v1/sites", params={"own": "true"})).json()
            assert ([line["peer"] for line in own["lines"]], own["peers"]) == ([None], [])
            page = (await (await house.signed_in(Role.VIEWER)).get("/lines")).text
            assert f'href="{other.url}/?bus=dry-end"' in page
            wall = (
                await house.clients[-1].get("/wallboard", params={"bus": "dry-end", "peer": "Mill 2"})
            ).text
            assert 'data-line="line_of/1/dry-end"' in wall
            assert 'data-wall="one"' in wall


async def test_a_server_without_a_bus_is_the_overview_of_its_peers(tmp_path: Path) -> None:
    with served(tmp_path / "other") as other:
        settings = peer(other.url, tmp_path, other.token)
        async with complete_app(tmp_path, config=configured(tmp_path / "own", settings, bus=False)) as house:
            await seen(house)
            viewer = await house.signed_in(Role.VIEWER)
            home = await viewer.get("/")
            assert (home.status_code, home.headers["location"]) == (303, "/lines")
            page = (await viewer.get("/lines")).text
            assert f'href="{other.url}/?bus=dry-end"' in page
            assert 'href="/setpoints"' not in page
            assert 'href="/events"' in page
            assert (await viewer.get("/wallboard")).status_code == 200


async def test_a_peer_that_refuses_the_token_is_named_on_the_page(tmp_path: Path) -> None:
    with served(tmp_path / "other") as other:
        settings = peer(other.url, tmp_path, "wrong")
        async with complete_app(tmp_path, config=configured(tmp_path / "own", settings)) as house:
            assert (await seen(house)).fault is not None
            page = (await (await house.signed_in(Role.VIEWER)).get("/lines")).text
            assert "Mill 2 is not read: it refuses the token in " in page
            line = (await house.clients[-1].get("/api/v1/sites")).json()["lines"][-1]
            assert (line["peer"], line["bus"], line["level"], line["stale"]) == ("Mill 2", "", "high", True)


async def test_one_server_by_two_names_is_shown_once(tmp_path: Path) -> None:
    with served(tmp_path / "other") as other:
        first = peer(other.url, tmp_path, other.token)
        second = peer(other.url.replace("127.0.0.1", "localhost"), tmp_path, other.token, "Again")
        async with complete_app(tmp_path, config=configured(tmp_path / "own", first, second)) as house:
            peers = board_of(house.services).peers
            await until(lambda: all(each.reported_at or each.fault for each in peers))
            assert [each.fault.code for each in peers if each.fault] == ["peer_is_other"]
            assert sorted(line.bus for line in board_of(house.services).lines()) == ["", "dry-end", "dry-end"]


async def test_a_peer_that_dies_is_away_and_comes_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "EVERY_S", 0.05)
    alive = True

    async def serve(writer: asyncio.StreamWriter) -> None:
        body = report().replace(EMPTY["time"].encode(), datetime.now(UTC).isoformat().encode())
        await (with_body(body) if alive else with_body(b"", "503 Unavailable"))(writer)

    async with answered(serve) as url:
        settings = peer(url, tmp_path)
        async with complete_app(tmp_path, config=configured(tmp_path / "own", settings)) as house:
            first = await seen(house)
            assert list(first.lines) == ["wet-end"]
            alive = False
            await until(lambda: first.fault)
            assert list(first.lines) == ["wet-end"], "the last report stays, with its age"
            before, alive = first.reported_at, True
            await until(lambda: first.fault is None and first.reported_at != before)


# --- from the command line ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("token", "code", "words"),
    [("", 0, "peer Mill 2 (http://127.0.0.1:"), ("wrong", 1, "Mill 2 is not read: it refuses the token in ")],
)
def test_check_and_status_read_each_peer(tmp_path: Path, token: str, code: int, words: str) -> None:
    with served(tmp_path / "other") as other:
        settings = peer(other.url, tmp_path, token or other.token)
        settings.token_file.chmod(0o600)
        config = configured(tmp_path / "own", settings, bus=False)
        found = [*peer_findings(load(config))]
        status = CliRunner().invoke(cli, ["status", "--config", str(config)])
        as_json = CliRunner().invoke(cli, ["status", "--config", str(config), "--json"])
    assert [finding.is_fault for finding in found] == [bool(code)]
    assert str(found[0].message).startswith(words)
    assert words in status.stdout
    (shown,) = json.loads(as_json.stdout)["peers"]
    assert (shown["name"], shown["fault"] is not None) == ("Mill 2", bool(code))


def test_a_certificate_that_is_not_trusted_is_named(tmp_path: Path) -> None:
    with served_with_tls(tmp_path) as site:
        settings = peer(site.url, tmp_path, site.tokens["viewer"])
        fault = asyncio.run(fault_of(settings))
        assert fault is not None
        assert fault.code == "peer_not_reached"
        assert "certificate" in str(fault)
        trusted = settings.model_copy(update={"ca_file": site.folder / "ca.pem"})
        assert asyncio.run(fault_of(trusted)) is None
        elsewhere = trusted.model_copy(update={"url": site.url.replace("localhost", "127.0.0.2")})
        assert "127.0.0.2" in str(asyncio.run(fault_of(elsewhere)))


# --- configuration ---------------------------------------------------------------------------------------


@for_each(
    ("url", "words"),
    [
        ("https://mill2:8443/lines", "without a path"),
        ("https://user:secret@mill2", "password"),
        ("ftp://mill2", "http"),
    ],
)
def test_the_url_of_a_peer_is_that_of_a_server(tmp_path: Path, url: str, words: str) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text(f'[[peer]]\nname = "Mill 2"\nurl = "{url}"\ntoken_file = "t"\n')
    with pytest.raises(ConfigurationError, match=words):
        load(config)


def test_two_peers_of_one_name_or_address_are_refused(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    for other in ('name = "Mill 2"\nurl = "https://b"', 'name = "Mill 3"\nurl = "https://A/"'):
        first = 'name = "Mill 2"\nurl = "https://a"'
        config.write_text("".join(f'[[peer]]\n{each}\ntoken_file = "t"\n' for each in (first, other)))
        with pytest.raises(ConfigurationError, match="is given twice"):
            load(config)


def test_the_files_of_a_peer_are_relative_to_the_configuration(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text('[[peer]]\nname = "Mill 2"\nurl = "https://a/"\ntoken_file = "t"\nca_file = "ca.pem"\n')
    (found,) = load(config).peer
    assert (found.token_file, found.ca_file) == (tmp_path / "t", tmp_path / "ca.pem")
    assert found.url == "https://a"
    assert not found.is_in_clear
    assert found.model_copy(update={"url": "http://a"}).is_in_clear
