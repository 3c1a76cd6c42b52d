"""HAProxy as ``docs/deploy`` configures it, before two real servers on one database: pages, sockets and
commands of the bus of each, by keyboard in a browser too; and, last, one server killed."""

from __future__ import annotations

import json
import ssl
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Locator, Page, expect
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from tests import fork_server, unpacked
from tests.certificates import certificates
from tests.e2e.conftest import GERMAN, OpensPages
from tests.e2e.limits import CALL_S, UNIT_MS
from tests.e2e.site import command, eventually
from tests.e2e.test_screen import opened
from tests.free_port import free_port
from tests.path.independent_unit import Unit
from tests.path.test_balancers import DEPLOY, DRY, WET, Balanced
from tests.path.test_two_servers import PASSWORD, TAKE_OVER_S, DeviceServer, end_server
from tests.postgresql import fresh_database, needs_postgresql

HEALTHY = 0b0000_0010
NAMES = ("app-1", "app-2")
HOMES = {"app-1": [DRY, WET], "app-2": [WET]}
"""Which server may be the home of which bus."""


pytestmark = needs_postgresql


def configuration(folder: Path, name: str, port: int, store: str, devices: dict[str, DeviceServer]) -> Path:
    config = folder / name / "lineside.toml"
    config.parent.mkdir()
    buses = "".join(
        f'[[bus]]\nname = "{bus}"\nport = "socket://127.0.0.1:{device.port}"\n'
        f'[[bus.unit]]\nid = 1\nname = "Unit of {bus}"\n'
        for bus, device in devices.items()
    )
    config.write_text(
        f"""\
[server]
id = "{name}"
port = {port}
url = "https://localhost:{port}"
trusted_proxies = ["127.0.0.1"]
data = "data"
home = {json.dumps(HOMES[name])}
[server.tls]
certificate = "{folder}/server.pem"
key = "{folder}/server.key"
client_ca = "{folder}/ca.pem"
[audit]
key_file = "../audit.key"
[store]
url = "{store}"
{buses}"""
    )
    return config


@dataclass
class BalancedSite:
    """``program`` and ``browser`` are clients of the balancer; ``processes`` by the id of the server."""

    balanced: Balanced
    program: httpx.Client
    browser: httpx.Client
    processes: dict[str, fork_server.ForkedProcess]
    devices: dict[str, DeviceServer]
    sessions: dict[str, Any] = field(default_factory=dict)
    """As of a `Site`: by name, with what a browser is signed in."""

    @property
    def url(self) -> str:
        return f"https://localhost:{self.balanced.public}"

    def sign_in(self) -> None:
        """By the balancer, for the client and for browsers."""
        form, origin = {"name": "operator", "password": PASSWORD}, {"Origin": self.url}
        signed_in = self.browser.post("/login", data=form, headers=origin)
        assert signed_in.status_code == 303, signed_in.text
        rest = {"domain": "localhost", "path": "/", "secure": True, "httpOnly": True, "expires": -1}
        cookies = [{"name": name, "value": value, **rest} for name, value in self.browser.cookies.items()]
        self.sessions["operator"] = {"cookies": cookies, "origins": []}

    def homes(self) -> dict[str, str]:
        """The home of each line whose units respond, as the balancer's servers report it."""
        try:
            response = self.program.get("/api/v1/sites")
        except httpx.HTTPError:
            return {}
        lines = response.json()["lines"] if response.status_code == 200 else []
        return {
            line["bus"]: line["home"]
            for line in lines
            if not line["stale"] and line["states"].get("online") == line["units"]
        }

    def command(self, bus: str, raw: int) -> tuple[int, str]:
        sent = self.program.post(f"/api/v1/buses/{bus}/units/1/speed", json={"raw": raw, "execute": True})
        return sent.status_code, sent.json().get("outcome", sent.text)

    @contextmanager
    def page(self, server: str) -> Iterator[ClientConnection]:
        """The socket of a page that a server has made."""
        cookies = "; ".join(f"{name}={value}" for name, value in self.browser.cookies.items())
        url = f"wss://localhost:{self.balanced.public}/live?language=en&home={server}"
        context = ssl.create_default_context(cafile=self.balanced.folder / "ca.pem")
        with connect(url, ssl=context, additional_headers={"Cookie": cookies}, proxy=None) as socket:
            yield socket


@contextmanager
def balanced_site(folder: Path) -> Iterator[BalancedSite]:
    """The first server is the home of `dry-end`, the second of `wet-end`."""
    certificates(folder)
    certificate, key = ((folder / f"server.{kind}").read_text() for kind in ("pem", "key"))
    (folder / "lineside.pem").write_text(certificate + key)
    (folder / "homes.map").write_text((DEPLOY / "homes.map").read_text())
    balanced = Balanced(folder, (free_port(), free_port()), free_port())
    words = balanced.write("haproxy")
    devices = {bus: DeviceServer({1: Unit(1, commanded=1000, actual=1000)}) for bus in (DRY, WET)}
    with fresh_database() as store, ExitStack() as stack:
        for device in devices.values():
            stack.callback(device.close)
        configs = [
            configuration(folder, name, port, store.url, devices)
            for name, port in zip(NAMES, balanced.ports, strict=True)
        ]
        token = command(configs[0], "token", "create", "plc", "--role", "operator").strip()
        person = ("user", "add", "operator", "--role", "operator", "--password-stdin")
        command(configs[0], *person, text=f"{PASSWORD}\n")
        program, browser = (stack.enter_context(balanced.client()) for _ in range(2))
        program.headers["Authorization"] = f"Bearer {token}"
        log = stack.enter_context((folder / "log").open("ab"))
        balancer = subprocess.Popen(words, stdout=log, stderr=log, env=unpacked.environment("haproxy"))
        stack.callback(balancer.wait)
        stack.callback(balancer.kill)
        processes: dict[str, fork_server.ForkedProcess] = {}
        site = BalancedSite(balanced, program, browser, processes, devices)
        homes: dict[str, str] = {}
        for bus, name in ((WET, "app-2"), (DRY, "app-1")):
            words = ["serve", "--config", str(configs[NAMES.index(name)])]
            processes[name] = fork_server.start(*words, stdout=log, stderr=log)
            stack.callback(end_server, processes[name])
            homes[bus] = name
            _eventually_homes(site, folder, homes)
        site.sign_in()
        yield site


def _eventually_homes(site: BalancedSite, folder: Path, homes: dict[str, str]) -> None:
    what = f"{homes}: {(folder / 'log').read_text()[-3000:]}"
    eventually(lambda: site.homes() == homes, what, within=2 * TAKE_OVER_S)


def _worker(socket: ClientConnection, bus: str) -> str:
    snapshot: dict[str, Any] = json.loads(socket.recv(timeout=CALL_S))
    return str(snapshot["f"][bus]["worker"])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BalancedSite]:
    """One for all tests here, since the start of two servers takes most of the time."""
    with balanced_site(tmp_path_factory.mktemp("site")) as site:
        yield site


@pytest.mark.soak
def test_a_line_of_another_server_is_a_press_away(
    site: BalancedSite, browser_page: OpensPages, flaws: Callable[..., list[str]]
) -> None:
    """By keyboard alone, on a phone."""
    phone: dict[str, Any] = {"viewport": {"width": 360, "height": 740}, "ignore_https_errors": True}
    page = opened(browser_page("operator", locale=GERMAN, **phone), "/lines")
    expect(page.locator("[data-line]")).to_have_count(2)
    _press(page, page.get_by_role("link", name=WET, exact=True))
    expect(page.locator(f"#bus-{WET}")).to_be_visible()
    site.devices[DRY].units[1].inputs = 0
    try:
        head = page.get_by_role("link", name="1 Linie eines anderen Servers hat einen Alarm")
        expect(head).to_have_attribute("href", "/lines", timeout=UNIT_MS)
        _press(page, page.get_by_role("link", name="Alarme", exact=True).first)
        elsewhere = page.locator("[data-elsewhere]")
        expect(elsewhere).to_contain_text(f"An anderen Servern, nicht auf dieser Seite: {DRY} (app-1)")
        assert flaws(page, GERMAN) == []
        expect(page.locator("#alarms")).not_to_contain_text(f"Unit of {DRY}")
        _press(page, elsewhere.get_by_role("link", name=DRY))
        expect(page.locator("#alarms")).to_contain_text(f"Unit of {DRY}")
        expect(page.locator("[data-elsewhere]")).to_contain_text(f"{WET} (app-2)")
    finally:
        site.devices[DRY].units[1].inputs = HEALTHY


def _press(page: Page, link: Locator) -> None:
    link.focus()
    page.keyboard.press("Enter")


@pytest.mark.soak
def test_two_servers_behind_haproxy(site: BalancedSite) -> None:
    """The last here, since it kills one of them."""
    browser = site.browser
    for bus, server, other, of_other in ((DRY, "app-1", WET, "app-2"), (WET, "app-2", DRY, "app-1")):
        assert f"Unit of {bus}" in browser.get(f"/bus/{bus}").text
        assert browser.cookies["lineside_home"] == server
        page = browser.get("/setpoints").text
        assert f"Unit of {bus}" in page
        assert f"Unit of {other}" not in page
        assert f'href="/setpoints?bus={other}">{other}</a> ({of_other})' in page
        with site.page(server) as socket:
            assert _worker(socket, bus) == "1"
        assert site.command(bus, 1200) == (200, "verified")
        assert site.devices[bus].units[1].commanded == 1200
    line = site.program.get("/api/v1/line").json()
    assert [(bus["name"], bus["worker"]) for bus in line["buses"]] == [(DRY, True), (WET, True)]
    journal = site.program.get("/api/v1/alarms/journal?limit=1000").json()["transitions"]
    assert [each for each in journal if each["code"] == "unit_offline"] == []
    with site.page("app-2") as socket:
        site.processes["app-2"].kill()
        _ends(socket)
    _eventually_homes(site, site.balanced.folder, {DRY: "app-1", WET: "app-1"})
    assert site.command(WET, 1300) == (200, "verified")
    assert site.devices[WET].units[1].commanded == 1300
    assert f"Unit of {DRY}" in browser.get("/setpoints").text


def _ends(socket: ClientConnection) -> None:
    try:
        while True:
            socket.recv(timeout=TAKE_OVER_S)
    except ConnectionClosed:
        return
