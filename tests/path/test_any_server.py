"""Two servers as processes on one database: each shows the bus of the other, sends its commands there, and
ends what the other withdraws."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.e2e.limits import CALL_S
from tests.e2e.site import command, eventually
from tests.path.test_two_servers import TAKE_OVER_S, Host, two_servers
from tests.postgresql import needs_postgresql

SPEED = "/api/v1/buses/dry-end/units/1/speed"


def line_of(host: Host) -> dict[str, Any]:
    """The only line, as a server knows it."""
    found = host.get("/api/v1/sites")
    line: dict[str, Any] = found["lines"][0] if found else {"home": None, "stale": None}
    return line


def is_at(host: Host, home: str) -> bool:
    """Whether a server knows the line to be at this home now."""
    line = line_of(host)
    return line["home"] == home and not line["stale"]


def units_at(host: Host) -> list[str]:
    """The links of the units, wherever their home is."""
    line = host.get("/api/v1/line")
    return [unit["link"] for bus in line["buses"][:1] for unit in bus["units"]] if line else []


@pytest.mark.soak
@needs_postgresql
def test_each_server_shows_and_commands_the_bus_of_the_other(tmp_path: Path) -> None:
    with two_servers(tmp_path) as (a, b, device):
        eventually(lambda: is_at(b, "a"), "b knows the line of a", within=TAKE_OVER_S)
        eventually(lambda: units_at(b) == ["online"] * 2, "the units of a at b", within=TAKE_OVER_S)
        with httpx.Client(base_url=b.url, timeout=CALL_S, trust_env=False) as client:
            client.headers["Authorization"] = f"Bearer {b.token}"
            sent = client.post(SPEED, json={"raw": 1100, "execute": True})
        assert (sent.status_code, sent.json()["outcome"]) == (200, "verified"), sent.text
        assert device.units[1].commanded == 1100
        assert device.writers() == [1], "one worker, that of the home"

        reader = command(b.config, "token", "create", "reader", "--role", "viewer").strip()
        with reading(a, reader) as ended:
            command(b.config, "token", "revoke", "reader")
            eventually(ended.is_set, "the stream of the token at a ends", within=TAKE_OVER_S)

        epoch, seen = line_of(b)["epoch"], set[tuple[str | None, bool | None]]()
        a.process.kill()

        def is_taken() -> bool:
            line = line_of(b)
            seen.add((line["home"], line["stale"]))
            return b.shows_live()

        eventually(is_taken, "b has the line", within=TAKE_OVER_S)
        assert ("a", True) in seen
        assert line_of(b)["epoch"] > epoch


@contextmanager
def reading(host: Host, token: str) -> Iterator[threading.Event]:
    """While a program reads the stream of a server; the event is set once the server has ended it."""
    begun, ended = threading.Event(), threading.Event()

    def read() -> None:
        headers = {"Authorization": f"Bearer {token}"}
        url = f"{host.url}/api/v1/stream"
        with (
            suppress(httpx.HTTPError),
            httpx.stream("GET", url, headers=headers, timeout=CALL_S, trust_env=False) as response,
        ):
            for _ in response.iter_bytes():
                begun.set()
        ended.set()

    threading.Thread(target=read, daemon=True).start()
    eventually(begun.is_set, "the stream begins")
    yield ended
