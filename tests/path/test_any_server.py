"""Two servers as processes on one database: each shows the bus of the other, sends its commands there, and
ends what the other withdraws."""

from __future__ import annotations

import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx

from tests.e2e.limits import CALL_S
from tests.e2e.site import command, eventually
from tests.path.test_two_servers import TAKE_OVER_S, Host, two_servers
from tests.postgresql import needs_postgresql


def line_of(host: Host) -> dict[str, Any]:
    """The only line, as a server knows it."""
    found = host.get("/api/v1/sites")
    return found["lines"][0] if found else {}


def is_at(host: Host, home: str) -> bool:
    """Whether a server knows the line to be at this home now."""
    line = line_of(host)
    return line.get("home") == home and not line["stale"]


@needs_postgresql
def test_each_server_shows_and_commands_the_bus_of_the_other(tmp_path: Path) -> None:
    with two_servers(tmp_path) as (a, b, device):
        eventually(lambda: is_at(b, "a"), "b knows the line of a", within=TAKE_OVER_S)
        eventually(b.shows_live, "the values of a at b", within=TAKE_OVER_S)
        with httpx.Client(base_url=b.url, timeout=CALL_S, trust_env=False) as client:
            client.headers["Authorization"] = f"Bearer {b.token}"
            sent = client.post("/api/v1/buses/dry-end/units/1/speed", json={"raw": 1100, "execute": True})
            assert (sent.status_code, sent.json()["outcome"]) == (200, "verified"), sent.text
            assert device.units[1].commanded == 1100
            assert device.writers() == [1], "one worker, that of the home"
        with _stream(a) as ended:
            command(b.config, "token", "revoke", "test")
            eventually(ended.is_set, "the stream of the token at a ends", within=TAKE_OVER_S)
            assert a.get("/api/v1/line") is None
            assert b.get("/api/v1/line") is None


class _stream:
    """A program that reads a server without end."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._ended, self._begun = threading.Event(), threading.Event()

    def __enter__(self) -> threading.Event:
        threading.Thread(target=self._read, daemon=True).start()
        eventually(self._begun.is_set, "the stream begins")
        return self._ended

    def __exit__(self, *_: object) -> None:
        self._ended.set()

    def _read(self) -> None:
        headers = {"Authorization": f"Bearer {self._host.token}"}
        url = f"{self._host.url}/api/v1/stream"
        with (
            suppress(httpx.HTTPError),
            httpx.stream("GET", url, headers=headers, timeout=CALL_S, trust_env=False) as response,
        ):
            for _ in response.iter_bytes():
                self._begun.set()
        self._ended.set()


@needs_postgresql
def test_a_line_is_stale_until_the_other_server_has_taken_it(tmp_path: Path) -> None:
    with two_servers(tmp_path) as (a, b, _):
        eventually(lambda: is_at(b, "a"), "b knows the line of a", within=TAKE_OVER_S)
        epoch = line_of(b)["epoch"]
        a.process.kill()
        seen: list[tuple[str, bool]] = []

        def is_taken() -> bool:
            line = line_of(b)
            seen.append((line["home"], line["stale"]))
            return is_at(b, "b")

        eventually(is_taken, "b has the line", within=TAKE_OVER_S)
        assert ("a", True) in seen
        assert line_of(b)["epoch"] > epoch
