"""``lineside serve`` on a cable of independent units, called over HTTP as other programs do."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from tests import fork_server
from tests.e2e.limits import CALL_S
from tests.e2e.site import end, eventually, people, run_in_time, wait_until_it_serves
from tests.fork_server import ForkedProcess
from tests.free_port import free_port
from tests.path.independent_unit import Cable, Unit, plugged


@dataclass
class Dashboard:
    """A served line. ``cable`` is the other side of the port."""

    folder: Path
    url: str
    cable: Cable
    client: httpx.Client
    tokens: dict[str, str] = field(default_factory=dict)
    server: ForkedProcess | None = None

    def call(
        self, method: str, path: str, body: Any = None, role: str = "admin", **more: Any
    ) -> httpx.Response:
        """One call under /api/v1; ``path`` that begins with "/units" or the like is of the bus."""
        headers = {"Authorization": f"Bearer {self.tokens[role]}"} if role else {}
        headers |= more.pop("headers", {})
        return self.client.request(method, f"/api/v1{path}", json=body, headers=headers, **more)

    def bus(
        self, method: str, path: str, body: Any = None, role: str = "admin", **more: Any
    ) -> httpx.Response:
        """One call of the bus."""
        return self.call(method, f"/buses/dry-end{path}", body, role, **more)

    def unit(self, number: int) -> dict[str, Any]:
        """A unit as it is shown now."""
        response = self.bus("GET", f"/units/{number}")
        assert response.status_code == 200, response.text
        shown: dict[str, Any] = response.json()
        return shown

    def line(self) -> dict[str, Any]:
        """The one bus as it is shown now."""
        shown: dict[str, Any] = self.call("GET", "/line", role="viewer").json()["buses"][0]
        return shown

    def workers(self) -> list[int]:
        """The processes that hold the port: what the server has started and what has not ended."""
        assert self.server is not None
        children = Path(f"/proc/{self.server.pid}/task/{self.server.pid}/children").read_text().split()
        return [int(child) for child in children if Path(f"/proc/{child}/cmdline").read_bytes()]

    def see(self, number: int, what: str, holds: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """Wait until a unit is shown so; the unit."""

        def look() -> dict[str, Any] | None:
            unit = self.unit(number)
            return unit if holds(unit) else None

        seen: dict[str, Any] = eventually(look, f"unit {number} {what}; it is {self.unit(number)}")
        return seen


@contextmanager
def dashboard(
    folder: Path,
    units: list[Unit],
    *,
    site_toml: str = "",
    bus_toml: str = "max_scan_hz = 10",
    cable_of: type[Cable] = Cable,
    **options: Any,
) -> Iterator[Dashboard]:
    """Serve these units; every one has been read, with its parameters, when this begins. ``options``: of
    `fork_server.start`. The cable has no baud rate: without a limit of the scan, the units are polled as fast
    as the machine can."""
    url = f"http://127.0.0.1:{free_port()}"
    with (
        plugged(folder / "tty", units, cable_of) as cable,
        httpx.Client(base_url=url, timeout=CALL_S, trust_env=False, verify=False) as client,
    ):
        made = Dashboard(folder, url, cable, client)
        config = folder / "lineside.toml"
        config.write_text(_configuration(made, site_toml, bus_toml), encoding="utf-8")
        data, new = people()
        shutil.copytree(data, folder / "data")
        made.tokens.update(new)
        with (folder / "serve.log").open("ab") as log:
            called = ("serve", "--config", config)
            made.server = server = fork_server.start(*called, stdout=log, stderr=log, **options)
            try:
                run_in_time(server)
                wait_until_it_serves(server, folder / "serve.log", lambda: _serves(made))
                for unit in units:
                    if not unit.off:
                        made.see(unit.address, "read", lambda shown: shown["analog"] is not None)
                yield made
            finally:
                end(server)


def _serves(made: Dashboard) -> bool:
    try:
        return made.client.get("/healthz").json() == {"status": "ok"}
    except httpx.HTTPError:
        return False


def _configuration(made: Dashboard, site_toml: str, bus_toml: str) -> str:
    units = "".join(
        f'[[bus.unit]]\nid = {unit.address}\nname = "Unit {unit.address}"\n'
        for unit in made.cable.units.values()
    )
    return f"""\
[site]
name = "Paper machine 2"
{site_toml}
[server]
port = {made.url.rpartition(":")[2]}
data = "./data"

[[bus]]
name = "dry-end"
port = "{made.cable.port}"
turnaround_ms = 300  # the units are played by a thread, which a busy machine may keep waiting
{bus_toml}
{units}"""
