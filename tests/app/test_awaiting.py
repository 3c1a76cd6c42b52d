"""A start before its database: it waits without an end, and each request gets a response in words."""

from __future__ import annotations

import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from app.cli.serving import awaiting
from app.cli.serving.listening import listen
from app.database.settings import StoreSettings
from app.errors import StoreError, StoreUnavailableError
from app.server.service_manager import ServiceManager
from app.settings import Settings, load
from bus.messages import Message
from bus.tls import TlsFileError
from tests import fork_server
from tests.certificates import certificates
from tests.e2e.limits import CALL_S, START_S
from tests.e2e.site import add_people, end, eventually, wait_until_it_serves
from tests.free_port import free_port
from tests.own_postgresql import own_postgresql
from tests.postgresql import needs_postgresql

NO_MANAGER = ServiceManager({})
GERMAN = {"Accept": "text/html,*/*", "Accept-Language": "de-AT,de;q=0.9"}
REASONS = [Message("store_no_response"), Message("store_no_response"), Message("store_is_standby")]


class Away:
    """A database that does not respond until ``is_back``; each look has the next reason."""

    def __init__(self) -> None:
        self.is_back = threading.Event()
        self.looks = 0

    def look_at(self, _store: StoreSettings) -> None:
        if self.is_back.is_set():
            return
        reason = REASONS[min(self.looks, len(REASONS) - 1)]
        self.looks += 1
        raise StoreUnavailableError(reason)


@pytest.fixture
def away(monkeypatch: pytest.MonkeyPatch) -> Away:
    made = Away()
    monkeypatch.setattr(awaiting, "look_at", made.look_at)
    monkeypatch.setattr(awaiting, "RETRY_S", 0.01)
    return made


def settings_of(folder: Path, server: str = "") -> Settings:
    config = folder / "lineside.toml"
    config.write_text(f"[store]\nurl = 'postgresql://lineside@db-1.plant.example/lineside'\n{server}")
    return load(config)


@contextmanager
def waiting(settings: Settings, away: Away) -> Iterator[int]:
    """The port of a start that waits; afterwards it has gone on."""
    with listen("127.0.0.1", 0, Message("choose_port")) as port:
        start = threading.Thread(
            target=awaiting.await_database, args=(settings, port, NO_MANAGER), daemon=True
        )
        start.start()
        try:
            eventually(lambda: away.looks > len(REASONS), "it looks again and again")
            yield port.getsockname()[1]
        finally:
            away.is_back.set()
            start.join(START_S)
        assert not start.is_alive()


def get(url: str, context: ssl.SSLContext | bool = True, **headers: str) -> httpx.Response:
    return httpx.get(url, headers=headers, trust_env=False, timeout=CALL_S, verify=context)


def test_programs_and_people_get_words_while_it_waits(
    tmp_path: Path, away: Away, capsys: pytest.CaptureFixture[str]
) -> None:
    with waiting(settings_of(tmp_path), away) as port:
        health = get(f"http://127.0.0.1:{port}/healthz")
        assert (health.status_code, health.json()["code"]) == (503, "waits_for_store")
        assert "db-1" not in health.text, "strangers learn nothing of the plant"
        page = get(f"http://127.0.0.1:{port}/", **GERMAN)
        assert (page.status_code, page.headers["cache-control"]) == (503, "no-store")
        assert page.headers["refresh"] == awaiting.RETRY_AFTER_S
        assert '<html lang="de">' in page.text
        assert "Die Datenbank antwortet nicht." in page.text
    printed = capsys.readouterr()
    assert printed.err.count("Waiting for the database.") == 2, "each reason once"
    assert "The database responds." in printed.out


def test_a_client_that_is_slow_holds_the_start_up_no_longer_than_another(tmp_path: Path, away: Away) -> None:
    with (
        waiting(settings_of(tmp_path), away) as port,
        socket.create_connection(("127.0.0.1", port)),
        socket.create_connection(("127.0.0.1", port)) as unfinished,
    ):
        unfinished.send(b"GET / HTTP/1.1\r\nAccept: ")
        assert get(f"http://127.0.0.1:{port}/healthz").status_code == 503


def test_over_tls_as_the_server_will(tmp_path: Path, away: Away) -> None:
    folder = certificates(tmp_path)
    tls = f"[server.tls]\ncertificate = '{folder / 'server.pem'}'\nkey = '{folder / 'server.key'}'\n"
    context = ssl.create_default_context(cafile=folder / "ca.pem")
    with waiting(settings_of(tmp_path, tls), away) as port:
        with socket.create_connection(("127.0.0.1", port)) as plain:
            plain.send(b"GET / HTTP/1.1\r\n\r\n")
        assert get(f"https://localhost:{port}/healthz", context).status_code == 503
    (folder / "server.pem").write_text((folder / "server.pem").read_text()[:300])
    away.is_back.clear()
    with listen("127.0.0.1", 0, Message("choose_port")) as taken, pytest.raises(TlsFileError):
        awaiting.await_database(settings_of(tmp_path, tls), taken, NO_MANAGER)


def test_what_waiting_does_not_change_ends_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_store: StoreSettings) -> None:
        raise StoreError(Message("store_lacks_driver"))

    monkeypatch.setattr(awaiting, "look_at", refused)
    with listen("127.0.0.1", 0, Message("choose_port")) as port, pytest.raises(StoreError):
        awaiting.await_database(settings_of(tmp_path), port, NO_MANAGER)


@needs_postgresql
def test_a_server_that_starts_before_its_database_serves_once_it_is_there(tmp_path: Path) -> None:
    """As after a failure of power."""
    url, log = f"http://127.0.0.1:{free_port()}", tmp_path / "serve.log"
    with own_postgresql() as postgresql:
        config = tmp_path / "lineside.toml"
        server = f"[server]\nport = {url.rpartition(':')[2]}\n"
        config.write_text(f"[store]\nurl = '{postgresql.url}'\n{server}")
        add_people(config)
        postgresql.kill()
        with log.open("ab") as output:
            process = fork_server.start("serve", "--config", config, stdout=output, stderr=output)
        try:
            wait_until_it_serves(process, log, lambda: _status(url) == 503)
            postgresql.start()
            wait_until_it_serves(process, log, lambda: _status(url) == 200)
        finally:
            end(process)
    assert "Waiting for the database.\n" in log.read_text()


def _status(url: str) -> int:
    try:
        return get(f"{url}/healthz").status_code
    except httpx.TransportError:
        return 0
