"""``lineside serve`` with ``[server.tls]`` as a process: HTTPS, WSS, its own workers and those elsewhere."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from pathlib import Path
from socket import create_connection
from typing import Any

import httpx
import pytest
from click.testing import CliRunner
from structlog.testing import capture_logs
from websockets.asyncio.client import ClientConnection, connect
from websockets.sync.client import connect as plain_connect

from app.cli import cli
from app.core.web.access import Role
from app.settings import ServerSettings
from tests import fork_server
from tests.app.complete_app import complete_app
from tests.app.served_tls import CONFIG, PATIENCE_S, Served, seen, served
from tests.certificates import certificates, renew
from tests.e2e.site import end, eventually
from tests.for_each import for_each
from tests.free_port import free_port

SOCKETS = 200


def test_https_its_own_worker_and_a_hint_for_http(tmp_path: Path) -> None:
    with served(tmp_path) as made:
        with made.client() as client:
            assert client.get("/healthz").json() == {"status": "ok"}
            form = {"name": "viewer", "password": "wrong"}
            assert client.post("/login", data=form, headers={"origin": made.url}).status_code == 401
        eventually(lambda: "linked to the dashboard" in made.log(), "its own worker connects")
        plain = httpx.get(f"http://localhost:{made.port}/", trust_env=False, timeout=PATIENCE_S)
        assert (plain.status_code, plain.json()["code"]) == (400, "tls_required")
        status = CliRunner().invoke(cli, ["status", "--config", str(tmp_path / "lineside.toml")])
        assert f"serving at https://127.0.0.1:{made.port}" in status.stdout
        own = own_port(made)
        login = f"http://127.0.0.1:{own}/login"
        assert httpx.get(login, trust_env=False, timeout=PATIENCE_S).status_code == 400
        with pytest.raises(Exception, match="403"), plain_connect(f"ws://127.0.0.1:{own}/live"):
            pass


def own_port(made: Served) -> int:
    lines = (line for line in made.log().splitlines() if "linked to the dashboard" in line)
    return int(json.loads(next(lines))["url"].split(":")[2].split("/")[0])


@pytest.mark.soak
async def test_200_sockets_stay_while_the_certificate_is_renewed(tmp_path: Path) -> None:
    with served(tmp_path) as made:
        async with AsyncExitStack() as stack:
            sockets = [await stack.enter_async_context(live_socket(made)) for _ in range(SOCKETS)]
            await asyncio.to_thread(renewed_and_refused, made)
            for socket in sockets:
                async with asyncio.timeout(PATIENCE_S):
                    await (await socket.ping())
        whats = [event["what"] for event in events(made)]
    assert any(what.startswith("new certificate in use") for what in whats)
    assert "the changed certificate is not used; the former one stays in use" in whats


@asynccontextmanager
async def live_socket(made: Served) -> AsyncIterator[ClientConnection]:
    """A page's socket that takes what it is sent. Its client is that of asyncio: a TLS socket that two
    threads use may lose what one of them sends (CPython before 3.13)."""
    headers = {"Authorization": f"Bearer {made.tokens['viewer']}", "Origin": made.url}
    address = f"wss://localhost:{made.port}/live?language=en"
    options: dict[str, Any] = {"ping_interval": None, "max_queue": None, "open_timeout": PATIENCE_S}
    async with connect(
        address, additional_headers=headers, ssl=made.context, proxy=None, **options
    ) as socket:
        await socket.send("{}")
        async with asyncio.timeout(PATIENCE_S):
            await socket.recv()
        yield socket


def renewed_and_refused(made: Served) -> None:
    """Renew the certificate; then put a key there that is not its own."""
    before = shown(made)
    renew(made.folder)
    eventually(lambda: shown(made) != before, "the new certificate")
    (made.folder / "server.key").write_bytes((made.folder / "worker.key").read_bytes())
    assert eventually(lambda: "is not that of the certificate" in users_page(made), "the fault")
    assert shown(made) != before


def shown(made: Served) -> str:
    """The serial number of the certificate that a new client gets."""
    with (
        create_connection(("localhost", made.port)) as connection,
        made.context.wrap_socket(connection, server_hostname="localhost") as tls,
    ):
        return str((tls.getpeercert() or {})["serialNumber"])


def users_page(made: Served) -> str:
    with made.client("admin") as client:
        return client.get("/users").text


def events(made: Served) -> list[dict[str, Any]]:
    with made.client("viewer") as client:
        found: list[dict[str, Any]] = client.get("/api/v1/events?limit=50").json()["events"]
    return found


@contextmanager
def worker(made: Served, *options: str | Path, name: str = "") -> Iterator[Path]:
    """A worker elsewhere; its log."""
    token, log = made.folder / "token", made.folder / f"worker{len(options)}{name}.log"
    config = made.folder / "lineside.toml"
    if not token.exists():
        words = ["token", "create", "cabinet", "--role", "worker", "--bus", "dry-end"]
        token.write_text(fork_server.run(*words, "--config", config).stdout)
        token.chmod(0o600)
    words = ["worker", "--config", str(config), "--bus", "dry-end", "--app", made.url]
    with log.open("wb") as file:
        process = fork_server.start(*words, "--token-file", token, *options, stdout=file, stderr=file)
    try:
        yield log
    finally:
        end(process)


def test_workers_elsewhere_must_show_a_certificate(tmp_path: Path) -> None:
    with served(tmp_path, 'client_ca = "ca.pem"') as made:
        ca = ("--ca", tmp_path / "ca.pem")
        eventually(lambda: "linked to the dashboard" in made.log(), "its own worker connects, without one")
        with worker(made, *ca) as log:
            seen(log, "demands a certificate of every worker")
        pair = ("--certificate", tmp_path / "worker.pem", "--key", tmp_path / "worker.key")
        with worker(made, *ca, *pair) as log:
            seen(log, "linked to the dashboard", "another worker has this bus")
        foreign = tmp_path / "other"
        pair = ("--certificate", foreign / "worker.pem", "--key", foreign / "worker.key")
        with worker(made, *ca, *pair, name="foreign") as log:
            seen(log, "has not signed it")


@for_each(
    ("app", "options", "words"),
    [
        ("https://localhost:1", ("--certificate", "a.pem"), "--certificate and --key are given together"),
        ("https://localhost:1", ("--ca", "none.pem"), "none.pem cannot be read: No such file or directory"),
        ("https://localhost:1", ("--ca", "server.key"), "server.key holds no certificate"),
        (
            "https://localhost:1",
            ("--certificate", "server.pem", "--key", "worker.key"),
            "is not that of the certificate",
        ),
        ("http://localhost:1", ("--ca", "ca.pem"), "begin it with https://"),
    ],
)
def test_files_that_a_worker_cannot_use(folder: Path, app: str, options: tuple[str, ...], words: str) -> None:
    assert folder
    call = ["worker", "--bus", "dry-end", "--app", app, "--token", "x" * 43, "--config", "lineside.toml"]
    ended = CliRunner().invoke(cli, [*call, *options])
    assert (ended.exit_code, words in ended.stderr) == (2, True), ended.stderr


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the call, with certificates and a configuration."""
    certificates(tmp_path)
    (tmp_path / "lineside.toml").write_text(CONFIG.format(port=free_port(), more=""))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_certificate_that_cannot_be_used_stops_the_start(folder: Path) -> None:
    config = folder / "lineside.toml"
    config.write_text(config.read_text().replace("server.pem", "worker.pem"))
    ended = fork_server.run("serve", "--config", config)
    assert (ended.returncode, "is not that of the certificate" in ended.stderr) == (2, True), ended.stderr


async def test_a_server_in_clear_for_other_machines_warns(tmp_path: Path) -> None:
    server = ServerSettings(data=tmp_path / "data", host="0.0.0.0")
    with capture_logs() as logs:
        async with complete_app(tmp_path, server=server) as house:
            page = await (await house.signed_in(Role.ADMIN)).get("/users")
    assert "cross the network in clear" in str(logs)
    assert "cross the network in clear" in page.text
