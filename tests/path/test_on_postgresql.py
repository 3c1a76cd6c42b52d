"""A complete site whose store is PostgreSQL: everything that it stores is there, also after a restart."""

from __future__ import annotations

import shutil
import zlib
from base64 import b64encode
from pathlib import Path
from struct import pack
from typing import Any

import httpx

from app.database.settings import StoreSettings
from tests import fork_server
from tests.e2e.site import PASSWORD, eventually
from tests.path.dashboard import Dashboard, dashboard
from tests.path.independent_unit import Unit
from tests.postgresql import fresh_database, needs_postgresql

pytestmark = needs_postgresql
UNITS = 2
KEY = "lineside.audit.key"


def chunk(kind: bytes, data: bytes) -> bytes:
    return pack(">I", len(data)) + kind + data + pack(">I", zlib.crc32(kind + data))


PICTURE = (
    b"\x89PNG\r\n\x1a\n"
    + chunk(b"IHDR", pack(">IIBBBBB", 2, 2, 8, 0, 0, 0, 0))
    + chunk(b"IDAT", zlib.compress((b"\0" + bytes(2)) * 2))
    + chunk(b"IEND", b"")
)


def test_a_site_stores_everything_in_postgresql(tmp_path: Path) -> None:
    units = [Unit(number, commanded=1000, actual=1000, analog_in=40) for number in range(1, UNITS + 1)]
    with fresh_database() as store:
        first, second = tmp_path / "first", tmp_path / "second"
        first.mkdir()
        second.mkdir()
        with dashboard(first, units, store=store) as plant:
            sign_in(plant)
            set_a_speed(plant, units[0])
            acknowledge_an_alarm(plant, units[1])
            save_a_set(plant)
            write_a_note(plant)
            wait_for_history(plant)
            before = everything(plant)
            names_its_store(plant, store)
        assert not list(first.rglob("*.db")), "nothing is stored beside it"
        shutil.copy(first / KEY, second / KEY)
        with dashboard(second, units, store=store, tokens=plant.tokens) as other:
            assert everything(other) == before
        another_site_is_refused(tmp_path, store)


def sign_in(plant: Dashboard) -> None:
    with httpx.Client(base_url=plant.url, trust_env=False) as browser:
        form = {"name": "operator", "password": PASSWORD}
        assert browser.post("/login", data=form, headers={"Origin": plant.url}).status_code == 303
        assert browser.get("/").status_code == 200
        odd = browser.post("/login", data={**form, "name": "oper\0ator"}, headers={"Origin": plant.url})
        assert 400 <= odd.status_code < 500


def set_a_speed(plant: Dashboard, unit: Unit) -> None:
    response = plant.bus("POST", "/units/1/speed", {"raw": 1234, "execute": True}, "operator")
    assert (response.status_code, response.json()["outcome"]) == (200, "verified")
    assert unit.commanded == 1234


def acknowledge_an_alarm(plant: Dashboard, unit: Unit) -> None:
    unit.off = True

    def find() -> dict[str, Any] | None:
        alarms = plant.call("GET", "/alarms?unit=2", role="viewer").json()["alarms"]
        return next((each for each in alarms if each["code"] == "unit_offline"), None)

    alarm = eventually(find, "the unit is offline")
    done = plant.call("POST", f"/alarms/{alarm['id']}/acknowledge", {"comment": "seen"}, "operator")
    assert done.status_code == 200
    unit.off = False
    plant.see(2, "online again", lambda shown: shown["link"] == "online")


def save_a_set(plant: Dashboard) -> None:
    saved = plant.bus("POST", "/sets", {"name": "Kraft 80", "comment": ""}, "engineer")
    assert saved.status_code == 201, saved.text
    marked = plant.call("POST", f"/sets/{saved.json()['id']}/golden", {"unit": 1}, "engineer")
    assert marked.status_code == 200, marked.text


def write_a_note(plant: Dashboard) -> None:
    start = plant.call("GET", "/shifts", role="viewer").json()["shifts"][0]["start"]
    note = {"text": "Felt changed", "pictures": [b64encode(PICTURE).decode()]}
    written = plant.call("POST", f"/shifts/{start}/notes", note, "operator")
    assert written.status_code == 201, written.text


def wait_for_history(plant: Dashboard) -> None:
    """Readings are stored each second."""

    def drawn() -> bool:
        return any(value is not None for value in history(plant)["avg"])

    eventually(drawn, "a trend")
    assert plant.call("GET", "/history/status", role="viewer").json()["state"] == "ok"


def history(plant: Dashboard) -> dict[str, Any]:
    span = "from=2020-01-01T00:00:00Z&to=2099-01-01T00:00:00Z"
    query = f"/history?bus=dry-end&unit=1&value=commanded&points=100&{span}"
    found: dict[str, Any] = plant.call("GET", query, role="viewer").json()
    return found


def everything(plant: Dashboard) -> dict[str, Any]:
    """What a site has stored that a restart must not change."""

    def read(path: str, role: str = "viewer") -> Any:
        response = plant.call("GET", path, role=role)
        assert response.status_code == 200, (path, response.text)
        return response.json()

    shift = read("/shifts")["shifts"][0]["start"]
    [note] = read(f"/shifts/{shift}")["notes"]
    credentials = {"Authorization": f"Bearer {plant.tokens['viewer']}"}
    picture = plant.client.get(f"/shifts/pictures/{note['pictures'][0]}", headers=credentials)
    commands = read("/events?kind=command&limit=100")["events"]
    found = read("/events?search=set%20speed&limit=10")["events"]
    exported = plant.call("GET", "/events.csv", role="engineer")
    assert exported.status_code == 200
    assert "set speed" in exported.text
    return {
        "commands": commands,
        "found": [event["id"] for event in found],
        "sets": read("/sets"),
        "set": read(f"/sets/{read('/sets')[0]['id']}"),
        "note": note,
        "picture": (picture.status_code, picture.content),
        "acknowledged": [
            entry["who"] for entry in read("/alarms/journal?limit=500")["transitions"] if entry["who"]
        ],
    }


def names_its_store(plant: Dashboard, store: StoreSettings) -> None:
    config = str(plant.folder / "lineside.toml")
    for command in ("status", "check"):
        assert f"store {store.shown}" in fork_server.run(command, "--config", config).stdout
    proof = fork_server.run("audit", "verify", "--config", config)
    assert proof.returncode == 0, proof.stderr
    refused = fork_server.run("backup-store", str(plant.folder / "backup"), "--config", config)
    assert (refused.returncode, "pg_dump" in refused.stderr) == (1, True)


def another_site_is_refused(folder: Path, store: StoreSettings) -> None:
    """A second site in the database by mistake, without a key and with its own."""
    config = folder / "other.toml"
    config.write_text(f"[store]\nurl = '{store.url}'\n")
    refused = fork_server.run("serve", "--config", str(config))
    assert refused.returncode == 1
    assert "a site lives in the database" in refused.stderr
