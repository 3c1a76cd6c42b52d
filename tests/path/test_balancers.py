"""HAProxy and Caddy as ``docs/deploy`` configures them, before two servers: a request goes to the home of the
bus that it names, else to the one of its cookie, and to the other server while that one is away."""

from __future__ import annotations

import ssl
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest
from fastapi.routing import iter_route_contexts
from websockets.utils import accept_key, generate_key

from app.main import create_app
from app.settings import Settings
from tests import unpacked
from tests.app.served_tls import PATIENCE_S, eventually
from tests.certificates import certificates
from tests.free_port import free_port

DEPLOY = Path(__file__).resolve().parents[2] / "docs" / "deploy"
BALANCERS = ("haproxy", "caddy")
CADDY_GLOBAL = "{\n\tadmin off\n\tauto_https disable_redirects\n\tskip_install_trust\n}\n"
DRY, WET = "dry-end", "wet-end"


class _Named(BaseHTTPRequestHandler):
    """Responds with the name of its server and with what it learned of the client."""

    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        if self.path.startswith("/live"):
            return self._upgrade()
        if self.path.startswith("/api/v1/stream"):
            return self._stream()
        learned = [self.headers[f"X-Forwarded-{name}"] for name in ("Host", "Proto", "For")]
        body = "|".join([self.server.name, *map(str, learned)]).encode()  # type: ignore[attr-defined]
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)
        return None

    def _upgrade(self) -> None:
        self.send_response(101)
        self.send_header("Connection", "Upgrade")
        self.send_header("Upgrade", "websocket")
        self.send_header("Sec-WebSocket-Accept", accept_key(self.headers["Sec-WebSocket-Key"]))
        self.end_headers()
        self.wfile.write(self.server.name.encode())  # type: ignore[attr-defined]
        self.rfile.read(1)
        self.close_connection = True

    def _stream(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(b"data: first\n\n")
        self.rfile.read(1)

    def log_message(self, *_: object) -> None:
        """Nothing: the result of each request is judged."""


class NamedServer(ThreadingHTTPServer):
    """An upstream of this name."""

    daemon_threads = True

    def __init__(self, name: str, port: int, context: ssl.SSLContext) -> None:
        super().__init__(("127.0.0.1", port), _Named)
        self.name = name
        self.socket = context.wrap_socket(self.socket, server_side=True, do_handshake_on_connect=False)
        threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()

    def handle_error(self, *_: object) -> None:
        """A connection that ended early, as that of a balancer that is killed."""

    def end(self) -> None:
        self.shutdown()
        self.server_close()


@dataclass
class Balanced:
    """A balancer on ``public`` before the servers at ``ports``."""

    folder: Path
    ports: tuple[int, int]
    public: int

    def client(self) -> httpx.Client:
        context = ssl.create_default_context(cafile=self.folder / "ca.pem")
        url = f"https://localhost:{self.public}"
        return httpx.Client(base_url=url, verify=context, trust_env=False, timeout=PATIENCE_S)

    def filled(self, text: str) -> str:
        """The example with the places of this test."""
        for folder in ("/etc/haproxy", "/etc/caddy"):
            text = text.replace(f"{folder}/", f"{self.folder}/")
        for number, port in enumerate(self.ports, start=1):
            text = text.replace(f"10.0.0.1{number}:8443", f"localhost:{port}")
        text = text.replace("bind :443", f"bind 127.0.0.1:{self.public}")
        return text.replace("line.plant.example {", f"https://localhost:{self.public} {{")

    def write(self, name: str) -> list[str]:
        """Write the configuration; return the command line."""
        source = DEPLOY / {"haproxy": "haproxy.cfg", "caddy": "Caddyfile"}[name]
        config = self.folder / source.name
        text = self.filled(source.read_text(encoding="utf-8"))
        config.write_text(CADDY_GLOBAL + text if name == "caddy" else text)
        program = unpacked.program(name)
        if name == "caddy":
            return [program, "run", "--adapter", "caddyfile", "--config", str(config)]
        return [program, "-db", "-f", str(config)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = certificates(tmp_path_factory.mktemp("balanced"))
    certificate, key = ((made / f"server.{kind}").read_text() for kind in ("pem", "key"))
    (made / "lineside.pem").write_text(certificate + key)
    (made / "lineside.key").write_text(key)
    (made / "homes.map").write_text((DEPLOY / "homes.map").read_text())
    return made


@contextmanager
def running(folder: Path, name: str) -> Iterator[tuple[httpx.Client, list[NamedServer]]]:
    balanced = Balanced(folder, (free_port(), free_port()), free_port())
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(folder / "server.pem", folder / "server.key")
    servers = [NamedServer(f"app-{n}", port, context) for n, port in enumerate(balanced.ports, start=1)]
    log = folder / f"{name}.log"
    words = balanced.write(name)
    with log.open("wb") as output:
        environment = unpacked.environment(name, HOME=str(folder))
        process = subprocess.Popen(words, stdout=output, stderr=output, env=environment)
    try:
        with balanced.client() as client:
            eventually(lambda: _name(client, f"/bus/{WET}") == "app-2", f"{name} serves: {log.read_text()}")
            yield client, servers
    finally:
        process.kill()
        process.wait()
        for server in servers:
            server.end()


def _name(client: httpx.Client, path: str, **headers: str) -> str:
    """The server that responds; empty where none does."""
    try:
        response = client.get(path, headers=headers)
    except httpx.HTTPError:
        return ""
    return response.text.partition("|")[0] if response.status_code == 200 else ""


@pytest.mark.parametrize("name", BALANCERS)
def test_a_request_goes_to_the_home_of_its_bus_or_of_its_cookie(folder: Path, name: str) -> None:
    with running(folder, name) as (client, servers):
        for path in (
            *("/bus/{}", "/bus/{}/trace", "/units/{}/1", "/batch/{}", "/swap/{}/3", "/api/v1/buses/{}"),
            *(
                "/api/v1/buses/{}/units/1/speed",
                "/alarms/{}.1.deviation.4",
                "/api/v1/alarms/{}.1.deviation.4",
            ),
            *("/events?bus={}", "/api/v1/history?value=actual&bus={}&unit=1"),
        ):
            for bus, server, other in ((DRY, "app-1", "app-2"), (WET, "app-2", "app-1")):
                cookie = f"session=1; lineside_home={other}"
                assert _name(client, path.format(bus), cookie=cookie) == server, path
        for server in ("app-1", "app-2"):
            assert _name(client, "/alarms", cookie=f"a=b; lineside_home={server}") == server
        assert _name(client, "/bus/dry-end-2", cookie="lineside_home=app-2") == "app-2"
        learned = client.get(f"/bus/{WET}", headers={"X-Forwarded-For": "10.9.9.9"}).text.split("|")
        assert learned[1:3] == [str(client.base_url.netloc, "ascii"), "https"]
        assert "10.9.9.9" not in learned[3]
        _streams_and_sockets_pass(client)
        servers[0].end()
        eventually(lambda: _name(client, f"/bus/{DRY}") == "app-2", "the other server takes the requests")


def _streams_and_sockets_pass(client: httpx.Client) -> None:
    with client.stream("GET", f"/api/v1/stream?bus={DRY}") as stream:
        assert next(stream.iter_lines()) == "data: first"
    headers = {"connection": "Upgrade", "upgrade": "websocket", "cookie": "lineside_home=app-1"}
    headers |= {"sec-websocket-key": generate_key(), "sec-websocket-version": "13"}
    for server in ("app-1", "app-2"):
        with client.stream("GET", f"/live?language=en&home={server}", headers=headers) as response:
            assert response.status_code == 101
            network = response.extensions["network_stream"]
            assert network.read(64, timeout=PATIENCE_S) == server.encode()


@pytest.mark.parametrize("config", ["haproxy.cfg", "Caddyfile"])
def test_every_path_that_names_a_bus_is_known_to_the_balancer(tmp_path: Path, config: str) -> None:
    app = create_app(Settings.model_validate({"server": {"data": tmp_path}}))
    paths = {
        getattr(route, "path", "") for context in iter_route_contexts(app.routes) for route in [context.route]
    }
    prefixes = {path.partition("{bus}")[0].strip("/") for path in paths if "{bus}" in path}
    assert len(prefixes) > 3
    text = (DEPLOY / config).read_text(encoding="utf-8")
    missing = [prefix for prefix in prefixes if f"/{prefix}/" not in text and f"|{prefix}|" not in text]
    if config == "Caddyfile":
        missing = [prefix for prefix in missing if f"({prefix}|" not in text and f"|{prefix})" not in text]
    assert missing == []
