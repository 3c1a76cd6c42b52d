"""A site on PostgreSQL whose database is stopped in three ways, while people and programs go on."""

from __future__ import annotations

import signal
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from app.database.settings import StoreSettings
from tests import fork_server
from tests.e2e.site import eventually
from tests.own_postgresql import OwnPostgresql, own_postgresql
from tests.path.dashboard import Dashboard, dashboard
from tests.path.independent_unit import Unit
from tests.postgresql import needs_postgresql

SPEED = 1000


@pytest.mark.soak
@needs_postgresql
def test_a_site_goes_on_without_its_database(tmp_path: Path) -> None:
    units = [Unit(number, commanded=SPEED, actual=SPEED) for number in (1, 2)]
    with (
        own_postgresql() as postgresql,
        dashboard(tmp_path, units, store=StoreSettings(url=postgresql.url)) as plant,
    ):
        ways: list[tuple[Callable[[], None], Callable[[], None]]] = [
            (lambda: postgresql.signal(signal.SIGSTOP), lambda: postgresql.signal(signal.SIGCONT)),
            (postgresql.kill, postgresql.start),
            (postgresql.stop_immediately, postgresql.start),
        ]
        for leave, come_back in ways:
            _without_its_database(plant, units, leave, come_back)
        _everything_followed(plant, len(ways))
        _it_ends_without_its_database(plant, postgresql)
    assert (tmp_path / "data" / "local-log").exists(), "the end of the server waits to follow"


def _site(folder: Path, units: list[Unit], postgresql: OwnPostgresql) -> AbstractContextManager[Dashboard]:
    return dashboard(folder, units, store=StoreSettings(url=postgresql.url))


def _without_its_database(
    plant: Dashboard, units: list[Unit], leave: Callable[[], None], come_back: Callable[[], None]
) -> None:
    assert plant.bus("POST", "/units/1/speed", {"raw": SPEED, "execute": True}).status_code == 200
    plant.see(1, "at its speed", lambda unit: unit["commanded_raw"] == SPEED)
    leave()
    # The first one after the failure, which is not noticed yet.
    stop = plant.bus("POST", "/units/1/speed", {"raw": 0, "execute": True}, "operator")
    assert (stop.status_code, stop.json()["outcome"]) == (200, "verified"), stop.text
    assert units[0].commanded == 0
    faster = plant.bus("POST", "/units/1/speed", {"raw": SPEED, "execute": True}, "operator")
    assert (faster.status_code, faster.json()["code"]) == (503, "store"), faster.text
    lower = plant.bus("POST", "/units/2/speed", {"raw": SPEED - 1, "execute": True}, "operator")
    assert lower.json()["outcome"] == "verified", lower.text
    assert plant.call("GET", "/alarms", role="viewer").status_code == 200
    (worker,) = plant.workers()
    come_back()
    eventually(lambda: _is_back(plant), "the database noticed")
    assert plant.bus("POST", "/units/2/speed", {"raw": SPEED, "execute": True}).status_code == 200
    plant.see(2, "at its speed", lambda unit: unit["commanded_raw"] == SPEED)
    assert plant.workers() == [worker]


def _is_back(plant: Dashboard) -> bool:
    return plant.call("GET", "/events?limit=1", role="viewer").status_code == 200


def _everything_followed(plant: Dashboard, ways: int) -> None:
    events = plant.call("GET", "/events?kind=command&limit=100", role="viewer").json()["events"]
    late = [event for event in events if event["entered_at"] is not None]
    stops = [event for event in late if event["new_raw"] == 0]
    assert [event["outcome"] for event in stops] == ["verified"] * ways
    assert all(event["entered_at"] > event["time"] for event in late)
    assert len([event for event in events if event["outcome"] == "store"]) == ways
    assert not [event for event in events if event["outcome"] is None]
    verified = fork_server.run("audit", "verify", "--config", plant.folder / "lineside.toml")
    assert verified.returncode == 0, verified.stdout + verified.stderr


def _it_ends_without_its_database(plant: Dashboard, postgresql: OwnPostgresql) -> None:
    postgresql.signal(signal.SIGSTOP)
    stop = plant.bus("POST", "/units/2/speed", {"raw": 0, "execute": True}, "operator")
    assert stop.json()["outcome"] == "verified", stop.text
