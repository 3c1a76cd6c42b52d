"""Faults of a machine that affect the history of a running server: a disk on which nothing can be written.

The server and its workers are the processes of a real plant. The line goes on in every case, and the fault is
shown.
"""

from __future__ import annotations

import resource
import subprocess
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import pytest

from app.line.history.status import NOTICES
from tests.e2e.limits import PROCEDURE_S
from tests.e2e.site import Site, eventually
from tests.mounted import mounted

NOTHING_WRITTEN = (0, resource.RLIM_INFINITY)


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    return line_server(2, line_options=("--no-script",))


def response_of(site: Site, path: str, **query: Any) -> Any:
    with site.api("viewer") as client:
        response = client.get(path, params=query)
    assert response.status_code == 200, response.text
    return response.json()


def readings(site: Site, since: float, until: float) -> list[float]:
    """Return when unit 1 responded within a span."""
    span = {name: datetime.fromtimestamp(t, UTC).isoformat() for name, t in (("from", since), ("to", until))}
    found = response_of(site, "/history", bus="line", unit=1, value="actual", points=20_000, **span)
    return [datetime.fromisoformat(t).timestamp() for t in found["t"]]


def set_speed(site: Site, by: int) -> int:
    """The status of a command."""
    raw = site.unit(1)["commanded_raw"] + by
    with site.api("operator") as client:
        return client.post("/buses/line/units/1/speed", json={"raw": raw, "execute": True}).status_code


def goes_on(site: Site) -> None:
    """The line is read as ever."""
    before = site.unit(1)["read_at"]
    eventually(lambda: site.unit(1)["read_at"] != before, "a new reading")
    eventually(lambda: site.unit(1)["link"] == "online", "a reading by the clock as it is now")


def state(site: Site) -> str:
    return str(response_of(site, "/history/status")["state"])


def notice(site: Site) -> str:
    """Return the notice about the history on the pages."""
    return str((response_of(site, "/line")["history"] or {"detail": ""})["detail"])


@pytest.mark.soak
def test_a_disk_on_which_nothing_can_be_written_stops_commands_and_nothing_else(site: Site) -> None:
    """No file may grow, from one moment to the next: as a full disk or one that was mounted read-only."""
    assert site.server is not None
    eventually(
        lambda: readings(site, time.time() - 600, time.time()), "something is kept", within=PROCEDURE_S
    )
    before = site.unit(1)["commanded_raw"]
    resource.prlimit(site.server.pid, resource.RLIMIT_FSIZE, NOTHING_WRITTEN)
    try:
        eventually(lambda: state(site) == "failed", "the page shows the fault", within=PROCEDURE_S)
        assert str(NOTICES["failed"]) in notice(site)
        goes_on(site)
        assert set_speed(site, 20) >= 500
        assert site.unit(1)["commanded_raw"] == before
        assert readings(site, time.time() - 600, time.time()), "what was kept can still be read"
    finally:
        resource.prlimit(site.server.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
    eventually(lambda: set_speed(site, 20) == 200, "commands again", within=PROCEDURE_S)
    eventually(lambda: state(site) == "ok", "history again", within=PROCEDURE_S)
    assert notice(site) == ""
    site.command("audit", "verify")


@pytest.mark.soak
def test_a_history_that_is_read_only_at_the_start_is_reported(site: Site) -> None:
    store = site.folder / "data" / "history.db"
    site.stop()
    with mounted("--bind", str(store), at=store):
        subprocess.run(["mount", "-o", "remount,ro,bind", str(store)], check=True)
        site.start()
        site.wait_for_units()
        assert state(site) == "failed"
        assert "read-only" in notice(site) or "cannot be" in notice(site)
        assert set_speed(site, 10) == 200
        site.stop()
    site.start()
    site.wait_for_units()
    eventually(lambda: state(site) == "ok", "history again", within=PROCEDURE_S)
