"""The examples of nginx and Caddy in ``docs/tls.md``, run before a dashboard: pages, sign-in, WebSockets and
streams pass, and a proxy that does not pass the host name gets a page that names the header."""

from __future__ import annotations

import asyncio
import re
import shutil
import ssl
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from tests import fork_server, unpacked
from tests.app.served_tls import PATIENCE_S
from tests.certificates import certificates
from tests.e2e.site import PASSWORD, end, eventually, people
from tests.free_port import free_port

ROOT = Path(__file__).resolve().parents[2]
NGINX = """\
daemon off;
master_process off;
pid {folder}/nginx.pid;
error_log stderr;
events {{}}
http {{
    access_log off;
    client_body_temp_path {folder}/body;
    proxy_temp_path {folder}/proxy;
    fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi;
    scgi_temp_path {folder}/scgi;
    {example}
}}
"""
CADDY = "{{\n admin off\n auto_https off\n}}\n{example}"


def example(kind: str) -> str:
    text = (ROOT / "docs" / "tls.md").read_text(encoding="utf-8")
    (found,) = re.findall(rf"```{kind}\n(.*?)```", text, re.S)
    return str(found)


@dataclass
class Proxied:
    """A dashboard on ``port`` behind a proxy on ``public``."""

    folder: Path
    port: int
    public: int
    token: str

    @property
    def url(self) -> str:
        return f"https://localhost:{self.public}"

    @property
    def context(self) -> ssl.SSLContext:
        return ssl.create_default_context(cafile=self.folder / "ca.pem")

    def client(self) -> httpx.Client:
        return httpx.Client(base_url=self.url, verify=self.context, trust_env=False, timeout=PATIENCE_S)

    def filled(self, text: str) -> str:
        """The example with the places of this test."""
        text = text.replace("/etc/lineside/certificates", str(self.folder)).replace(":8000", f":{self.port}")
        text = text.replace("listen 443", f"listen 127.0.0.1:{self.public}")
        return text.replace("line.plant.example {", f"https://localhost:{self.public} {{")


@pytest.fixture(scope="module")
def behind(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Proxied]:
    """The dashboard alone; each test starts its proxy."""
    folder, port = certificates(tmp_path_factory.mktemp("proxied")), free_port()
    config = folder / "lineside.toml"
    config.write_text(f'[server]\nport = {port}\ndata = "data"\ntrusted_proxies = ["127.0.0.1"]\n')
    data, tokens = people()
    shutil.copytree(data, folder / "data")
    with (folder / "serve.log").open("wb") as log:
        server = fork_server.start("serve", "--config", config, stdout=log, stderr=log)
    try:
        eventually(lambda: "Lineside: http" in (folder / "serve.log").read_text(), "it serves")
        yield Proxied(folder, port, free_port(), tokens["admin"])
    finally:
        end(server)


@contextmanager
def running(behind: Proxied, name: str, change: tuple[str, str] = ("", "")) -> Iterator[None]:
    kind, frame = ("nginx", NGINX) if name == "nginx" else ("caddyfile", CADDY)
    text = behind.filled(example(kind)).replace(*change)
    config = behind.folder / name
    config.write_text(frame.format(folder=behind.folder, example=text))
    words = {
        "nginx": ["-p", str(behind.folder), "-c", str(config)],
        "caddy": ["run", "--adapter", "caddyfile", "--config", str(config)],
    }
    log = behind.folder / f"{name}.log"
    with log.open("wb") as output:
        process = subprocess.Popen(
            [unpacked.program(name), *words[name]],
            stdout=output,
            stderr=output,
            env={"HOME": str(behind.folder), "PATH": "/usr/bin"},
        )
    try:
        with behind.client() as client:
            deadline = time.monotonic() + PATIENCE_S
            while not _responds(client):
                assert process.poll() is None, log.read_text()
                assert time.monotonic() < deadline, log.read_text()
                time.sleep(0.05)
        yield
    finally:
        process.kill()  # Caddy would wait for its WebSockets
        process.wait()


def _responds(client: httpx.Client) -> bool:
    try:
        return client.get("/healthz").status_code == 200
    except httpx.HTTPError:
        return False


@pytest.mark.parametrize("name", ["nginx", "caddy"])
def test_pages_sockets_and_streams_pass(behind: Proxied, name: str) -> None:
    origin = {"origin": behind.url, "accept": "text/html"}
    with running(behind, name), behind.client() as client:
        form = {"name": "admin", "password": PASSWORD}
        signed_in = client.post("/login", data=form, headers=origin)
        assert signed_in.status_code == 303
        for cookie in signed_in.headers.get_list("set-cookie"):
            assert cookie.startswith("__Host-")
            assert "; Secure" in cookie
        assert client.get("/users").status_code == 200
        (event,) = (each for each in client.get("/api/v1/events?kind=login").json()["events"][:1])
        assert event["who"] == "admin"
        with client.stream("GET", "/api/v1/stream") as stream:
            assert next(stream.iter_lines())
        assert asyncio.run(first_of_live(behind))


async def first_of_live(behind: Proxied) -> str | bytes:
    """What a page is sent first."""
    headers = {"Authorization": f"Bearer {behind.token}", "Origin": behind.url}
    address = f"wss://localhost:{behind.public}/live?language=en"
    async with (
        connect(address, additional_headers=headers, ssl=behind.context, proxy=None) as socket,
        asyncio.timeout(PATIENCE_S),
    ):
        await socket.send("{}")
        return await socket.recv()


def test_a_proxy_that_does_not_pass_websockets_is_named_once(behind: Proxied) -> None:
    with running(behind, "nginx", ("proxy_set_header Upgrade           $http_upgrade;", "")):
        for _ in range(2):
            with pytest.raises(InvalidStatus) as refused:
                asyncio.run(first_of_live(behind))
            assert refused.value.response.status_code == 426
            assert (
                b"the proxy does not pass WebSockets; in nginx add: proxy_http" in refused.value.response.body
            )
    log = (behind.folder / "serve.log").read_text()
    assert log.count("the proxy does not pass WebSockets") == 1


def test_a_proxy_that_serves_it_below_a_path_is_met_with_words(behind: Proxied) -> None:
    server = f"proxy_pass http://127.0.0.1:{behind.port}"
    below = f"location = /healthz {{ {server}; }} location /lineside/ {{ {server};"
    change = (f"location / {{\n        {server};", below)
    with running(behind, "nginx", change), behind.client() as client:
        shown = client.get("/lineside/", headers={"accept": "text/html"}, follow_redirects=True)
        assert "Lineside needs a host name or a port of its own" in shown.text
        named = client.get("/lineside/", headers={"accept": "text/html", "x-forwarded-prefix": "/lineside"})
        assert "there is no page at /lineside: behind a proxy" in named.text


def test_a_host_name_that_is_not_passed_is_named_on_a_page(behind: Proxied) -> None:
    with running(behind, "nginx", ("$http_host", "$host")), behind.client() as client:
        headers = {"origin": behind.url, "accept": "text/html,*/*"}
        refused = client.post("/login", data={"name": "admin"}, headers=headers)
    assert refused.status_code == 403
    assert refused.headers["content-type"].startswith("text/html")
    assert "the header X-Forwarded-Host names this server" in refused.text
