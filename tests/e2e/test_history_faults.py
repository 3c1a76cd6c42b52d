"""Faults of a machine that affect the history of a running server: its clock set, its disk full, broken or
locked.

The server and its workers are the processes of a real plant. The line goes on in every case, and the fault is
shown.
"""

from __future__ import annotations

import os
import resource
import sqlite3
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from app.line.history.status import DAMAGED, NOTICES
from tests.e2e.limits import PROCEDURE_S
from tests.e2e.site import Site, eventually
from tests.e2e.site import site as one_site
from tests.mounted import mounted

CLOCK = """\
import os, time
from pathlib import Path
real, said = time.time, Path(os.environ["TEST_CLOCK_SET_BY"])
time.time = lambda: real() + float(said.read_text() or 0)
"""
"""sitecustomize.py: Python runs it before the server and before each worker. A file sets their clock."""
HOUR = 3600.0
NOTHING_WRITTEN = (0, resource.RLIM_INFINITY)


@pytest.fixture(scope="module")
def clock(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Sets the clock of every site that is started afterwards, by so many seconds."""
    folder = tmp_path_factory.mktemp("clock")
    (folder / "sitecustomize.py").write_text(CLOCK)
    result = folder / "seconds"
    result.write_text("0")
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("PYTHONPATH", str(folder))
        environment.setenv("TEST_CLOCK_SET_BY", str(result))
        yield result


@pytest.fixture(scope="module")
def site(clock: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    clock.write_text("0")
    # A forked server has begun before: its clock is that of the machine.
    folder = tmp_path_factory.mktemp("troubled")
    with one_site(folder, 2, line_options=("--no-script",), installed=True) as made:
        yield made


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
def test_a_clock_that_is_set_back_and_forward_is_noticed_and_everything_goes_on(
    site: Site, clock: Path
) -> None:
    for step, result in ((-HOUR, "-"), (0.0, "+")):
        set_clock(site, clock, step)
        assert result in app_steps(site)[0]


def set_clock(site: Site, clock: Path, step: float) -> None:
    """Step it and see everything go on by the new time."""
    before = time.time() + float(clock.read_text())
    eventually(lambda: readings(site, before - 10, before + 60), "readings before", within=PROCEDURE_S)
    steps = len(app_steps(site))
    clock.write_text(str(step))
    now = time.time() + step
    eventually(lambda: len(app_steps(site)) > steps, "the step in the events", within=PROCEDURE_S)
    goes_on(site)
    # What the worker takes for late while it learns the new clock is refused, not sent.
    eventually(lambda: set_speed(site, 10) == 200, "a command", within=PROCEDURE_S)
    assert site.unit(1)["age_ms"] < 10_000
    eventually(lambda: readings(site, now, now + 60), "readings by the new clock", within=PROCEDURE_S)
    assert readings(site, before - 10, before + 1), "readings from before the step are still there"
    assert state(site) == "ok"


def app_steps(site: Site) -> list[str]:
    """The steps of the app's clock, the newest first; its worker reports its own."""
    events = response_of(site, "/events", kind="clock")["events"]
    return [event["what"] for event in events if event["what"].startswith("clock of the app stepped")]


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
def test_pages_overwritten_while_it_runs_are_detected_and_reported(site: Site) -> None:
    """Those of the readings: at the next look at them."""
    store = site.folder / "data" / "history.db"
    begun = time.time()
    eventually(lambda: blocks(store), "a minute that is folded", within=150)
    with closing(sqlite3.connect(store, timeout=30)) as connection, connection:
        connection.execute("UPDATE raw SET data = zeroblob(length(data))")
    requested_at = time.time()
    readings(site, begun - 7200, requested_at + 60)
    eventually(lambda: str(DAMAGED) in notice(site), "the notice", within=PROCEDURE_S)
    result = [event["what"] for event in response_of(site, "/events", kind="server")["events"]]
    assert any(
        "a block of the history is damaged, it is missing: every value of line/" in text for text in result
    )
    goes_on(site)
    eventually(lambda: readings(site, requested_at, time.time() + 60), "history goes on", within=PROCEDURE_S)


def blocks(store: Path) -> int:
    with closing(sqlite3.connect(store, timeout=30)) as connection:
        return int(connection.execute("SELECT count(*) FROM raw").fetchone()[0])


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


@pytest.mark.soak
def test_on_a_disk_that_fills_the_events_are_the_last_to_suffer(tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    with (
        mounted("-t", "tmpfs", "-o", "size=180m", "tmpfs", at=data),
        one_site(tmp_path, 2, line_options=("--no-script",)) as site,
    ):
        eventually(
            lambda: state(site) == "scarce", "the page shows that the disk is nearly full", within=PROCEDURE_S
        )
        assert str(NOTICES["scarce"]) in notice(site)
        fill(data, leave=60_000_000)
        eventually(lambda: state(site) == "paused", "history pauses", within=PROCEDURE_S)
        assert str(NOTICES["paused"]) in notice(site)
        goes_on(site)
        assert set_speed(site, 10) == 200
        fill(data, leave=0)
        goes_on(site)
        assert set_speed(site, 20) == 200, "in the space that is reserved for commands"
        goes_on(site)
        for ballast in data.glob("ballast*"):
            ballast.unlink()
        eventually(lambda: set_speed(site, 10) == 200, "commands again", within=PROCEDURE_S)
        eventually(lambda: state(site) == "scarce", "history again", within=PROCEDURE_S)
        site.command("audit", "verify")


def fill(folder: Path, leave: int) -> None:
    """Until so many bytes are free."""
    left = os.statvfs(folder)
    with suppress(OSError), (folder / f"ballast{leave}").open("wb") as ballast:
        os.posix_fallocate(ballast.fileno(), 0, left.f_bavail * left.f_frsize - leave)
