"""A disk that is filled to its last byte, or refuses the log: what people must do goes on and is kept."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from sqlite3 import Connection
from typing import Any

import httpx
import pytest
from structlog.testing import capture_logs

from app.core.database import Database
from app.core.database.files import SIZE, Reserve
from app.core.web.access import Role
from app.errors import StoreError
from app.line.history.service import History
from app.main import create_app
from app.people.audit.log import EventLog
from tests.app.complete_app import PASSWORD as HOUSE_PASSWORD
from tests.app.complete_app import complete_app, settings_in
from tests.app.history_line import NOON, Shelf, polls
from tests.e2e.limits import CALL_S, PROCEDURE_S
from tests.e2e.site import PASSWORD, eventually
from tests.mounted import mounted
from tests.path.dashboard import Dashboard, dashboard
from tests.path.independent_unit import Unit

DISK_MB = 180


@contextmanager
def small_disk(at: Path) -> Iterator[None]:
    """A disk in memory; the test is left out where this user may not mount one."""
    at.mkdir()
    with mounted("-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", at=at):
        yield


def fill(disk: Path, name: str = "ballast") -> None:
    """Write until there is no space."""
    command = ["dd", "if=/dev/zero", f"of={disk / name}", "bs=64k"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert "No space left" in done.stderr, done.stderr


@pytest.fixture
def plant(tmp_path: Path) -> Iterator[Dashboard]:
    """All of it on a small disk: the data, and the server's log beside them."""
    disk = tmp_path / "disk"
    with small_disk(disk), dashboard(disk, [Unit(1), Unit(2)]) as made:
        yield made


def test_with_the_disk_full_what_people_must_do_works_and_is_recorded(plant: Dashboard) -> None:
    unit = plant.cable.units[1]
    _set_speed(plant, 1000)
    unit.inputs = 0
    alarm = eventually(lambda: _alarm(plant), "the emergency stop as an alarm", within=PROCEDURE_S)
    for attempt in range(3):
        fill(plant.folder, f"ballast{attempt}")
        _set_speed(plant, 1000 + attempt)
        _set_speed(plant, 0)
    fill(plant.folder, "last")
    assert _set_to_zero(plant, "operator").count("verified") == 2
    fill(plant.folder, "very-last")
    with _signed_in(plant) as page:
        acknowledged = page.post(f"/api/v1/alarms/{alarm}/acknowledge", json={"comment": "seen"})
        assert acknowledged.status_code == 200, acknowledged.text
        assert page.post("/logout").status_code == 303
    _is_recorded(plant)


def test_history_notes_and_pictures_give_way_and_the_page_shows_it(plant: Dashboard) -> None:
    fill(plant.folder)
    eventually(lambda: _history_state(plant) == "paused", "history gives way", within=PROCEDURE_S)
    (shift,) = plant.call("GET", "/shifts?limit=1").json()["shifts"]
    note = plant.call("POST", f"/shifts/{shift['start']}/notes", {"text": "Felt changed"}, "operator")
    assert (note.status_code, note.json()["code"]) == (503, "store")
    _set_speed(plant, 500)
    page = plant.client.get("/", headers={"Authorization": f"Bearer {plant.tokens['viewer']}"}).text
    assert "No history, note or picture is stored since" in page
    assert "are recorded in reserved space" in page
    (plant.folder / "ballast").unlink()
    eventually(lambda: _history_state(plant) != "paused", "history again", within=PROCEDURE_S)
    eventually(lambda: _reserve_is_made_again(plant), "the reserve is made again", within=PROCEDURE_S)
    again = plant.call("POST", f"/shifts/{shift['start']}/notes", {"text": "Felt changed"}, "operator")
    assert again.status_code == 201


async def test_a_server_starts_on_a_full_disk_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.core.database.feature.Reserve", Reserve)
    disk = tmp_path / "disk"
    with small_disk(disk):
        async with complete_app(disk) as house:
            await house.add("ann", Role.OPERATOR)
            fill(disk)
        async with complete_app(disk) as house:
            fill(disk, "more")
            client = house.client()
            response = await client.post("/login", data={"name": "ann", "password": HOUSE_PASSWORD})
            assert response.status_code == 303
            assert [event["who"] for event in await house.events("login")] == ["ann"]
            assert len(await house.events("server")) >= 3


def _reserve_is_made_again(plant: Dashboard) -> bool:
    _set_speed(plant, 500)
    return (plant.folder / "data" / "reserve").stat().st_size == SIZE


def _set_speed(plant: Dashboard, raw: int) -> None:
    body = {"raw": raw, "execute": True}
    response = plant.bus("POST", "/units/1/speed", body, "operator")
    assert (response.status_code, response.json()["outcome"]) == (200, "verified"), response.text


def _set_to_zero(plant: Dashboard, role: str) -> str:
    headers = {"Authorization": f"Bearer {plant.tokens[role]}"}
    form = {"id": "zero-on-a-full-disk", "reviewed_at": str(time.time())}
    response = plant.client.post("/line/zero", data=form, headers=headers)
    assert response.status_code == 200, response.text
    return response.text


@contextmanager
def _signed_in(plant: Dashboard) -> Iterator[httpx.Client]:
    own = {"Origin": plant.url}
    with httpx.Client(base_url=plant.url, timeout=CALL_S, trust_env=False, headers=own) as page:
        response = page.post("/login", data={"name": "operator", "password": PASSWORD})
        assert response.status_code == 303, response.text
        yield page


def _alarm(plant: Dashboard) -> str | None:
    alarms: list[dict[str, Any]] = plant.call("GET", "/alarms").json()["alarms"]
    return next((each["id"] for each in alarms if each["code"] == "estop_active"), None)


def _history_state(plant: Dashboard) -> str:
    state: str = plant.call("GET", "/history/status").json()["state"]
    return state


def _is_recorded(plant: Dashboard) -> None:
    events: list[dict[str, Any]] = plant.call("GET", "/events?limit=100").json()["events"]
    assert {"login", "logout", "alarm", "command"} <= {event["kind"] for event in events}
    commands = [event for event in events if event["kind"] == "command"]
    assert {event["outcome"] for event in commands} == {"verified"}
    assert [event["new_raw"] for event in commands if event["unit"] == 1][:1] == [0]


def refuse_events(connection: Connection) -> None:
    connection.execute(
        "CREATE TRIGGER full BEFORE INSERT ON events BEGIN SELECT RAISE(ABORT, 'the disk is full'); END"
    )


async def test_every_store_is_closed_and_every_other_backlog_written(tmp_path: Path) -> None:
    services = create_app(settings_in(tmp_path)).state.services
    with capture_logs() as logs:
        async with services.lifespan.running():
            await services[EventLog].repeated.count("login_refused", "refused", who="ann")
            await services[Database].write(refuse_events)
            await services[EventLog].repeated.count("login_refused", "refused", who="ann")
            services[History].append("dry-end", polls(NOON, NOON + 10))
    with pytest.raises(StoreError, match="closed"):
        await services[Database].read(lambda _: None)
    shelf = Shelf(tmp_path / "data" / "history.db")
    assert len(shelf.query("actual", NOON, NOON + 60).series.at) == 50
    shelf.close()
    failed = [entry for entry in logs if entry["event"] == "not ended"]
    assert [entry["part"] for entry in failed] == ["repeated events", "event log"]
    assert all("the disk is full" in entry["why"] for entry in failed)
