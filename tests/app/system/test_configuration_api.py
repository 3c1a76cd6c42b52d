"""The configuration for programs: the same checks as on the pages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
import pytest

from app.core.web.access import Role
from tests.app.complete_app import House, complete_app
from tests.app.configuration_file import TEXT, PlantFile, house_with_file, plant_file

API = "/api/v1/configuration"
UNIT = f"{API}/tables/bus.0.unit.0"

house = pytest.fixture(house_with_file)
file = pytest.fixture(plant_file)


@pytest.fixture
async def engineer(house: House) -> httpx.AsyncClient:
    return await house.program(Role.ENGINEER)


async def digest_of(client: httpx.AsyncClient) -> str:
    return str((await client.get(API)).json()["digest"])


async def put(
    client: httpx.AsyncClient, values: dict[str, Any], path: str = UNIT, **more: Any
) -> httpx.Response:
    body = {"digest": await digest_of(client), "values": values, **more}
    return await client.put(path, json=body)


async def test_the_tables_of_the_file(engineer: httpx.AsyncClient) -> None:
    shown = (await engineer.get(API)).json()
    assert (shown["writable"], shown["running"], shown["faults"], shown["waiting"]) == (True, True, [], [])
    tables = {each["name"]: (each["kind"], each["values"]) for each in shown["tables"]}
    assert tables["bus.0.unit.1"] == ("unit", {"name": "Nip"})
    assert "notify.webhook.0" not in tables


async def test_a_change_is_reviewed_then_written(engineer: httpx.AsyncClient, file: PlantFile) -> None:
    values = {"name": "Unwinder", "labels.output.1": "Brake", "group": None}
    review = (await put(engineer, values, review=True)).json()
    assert review["version"] is None
    assert [each["text"] for each in review["difference"] if each["kind"] == "new"] == [
        'name = "Unwinder"   # as people call it',
        'labels.output.1 = "Brake"',
    ]
    assert file.text == TEXT
    done = (await put(engineer, values, reason="as drawn")).json()
    assert (done["version"]["number"], done["version"]["reason"]) == (2, "as drawn")
    assert 'name = "Unwinder"   # as people call it\nlabels.output.1 = "Brake"\n' in file.text
    shown = (await engineer.get(API)).json()
    assert not shown["running"]
    assert [each["text"] for each in shown["waiting"] if each["kind"] == "new"] == [
        'name = "Unwinder"   # as people call it',
        'labels.output.1 = "Brake"',
    ]


async def test_lists_and_numbers_have_their_types(engineer: httpx.AsyncClient, file: PlantFile) -> None:
    values = {"name": "Slow", "bus": "dry-end", "unit": 1, "value": "actual", "below": 80.5, "latch": True}
    assert (await put(engineer, values, f"{API}/tables/alarm.0")).status_code == 200
    assert "unit = 1\n" in file.text
    assert "below = 80.5\nlatch = true\n" in file.text
    banded = await put(engineer, {"draw_percent": [-0.2, 0.8]}, f"{API}/tables/bus.0.unit.1")
    assert banded.status_code == 200
    assert 'name = "Nip"\ndraw_percent = [-0.2, 0.8]\n' in file.text


async def test_what_cannot_be_done_with_a_table(engineer: httpx.AsyncClient, file: PlantFile) -> None:
    for path, act in ((UNIT, "remove"), (f"{API}/tables/built_in_alarm.0", "up")):
        refused = await put(engineer, {}, path, act=act)
        assert (refused.status_code, refused.json()["reason"]) == (422, "configuration_no_such_change")
    assert file.text == TEXT


async def test_refusals(engineer: httpx.AsyncClient, file: PlantFile) -> None:
    unknown = await put(engineer, {"id": 7})
    assert (unknown.status_code, unknown.json()["reason"]) == (422, "configuration_no_key")
    invalid = await put(engineer, {"name": "x" * 61}, review=True)
    assert (invalid.status_code, invalid.json()["reason"]) == (422, "configuration_not_valid")
    assert "at most 60 characters" in invalid.json()["detail"]
    same = await put(engineer, {"name": "Unwind"})
    assert (same.status_code, same.json()["reason"]) == (409, "configuration_nothing_changed")
    began = await digest_of(engineer)
    file.write(f"# By hand.\n{TEXT}")
    late = await engineer.put(UNIT, json={"digest": began, "values": {"name": "Unwinder"}})
    assert (late.status_code, late.json()["code"]) == (409, "superseded")
    assert late.json()["digest"] == await digest_of(engineer)
    assert file.text == f"# By hand.\n{TEXT}"


async def test_where_mails_and_their_links_lead_is_for_admins(
    house: House, engineer: httpx.AsyncClient
) -> None:
    admin = await house.program(Role.ADMIN)
    for table, values in (
        ("notify.smtp", {"host": "mail.example", "sender": "a@b.example"}),
        ("notify", {"dashboard_url": "https://elsewhere.example"}),
    ):
        path = f"{API}/tables/{table}"
        assert (await put(engineer, values, path)).status_code == 403
        assert (await put(admin, values, path)).status_code == 200


async def test_versions_and_the_way_back(house: House, engineer: httpx.AsyncClient, file: PlantFile) -> None:
    await put(engineer, {"name": "Unwinder"})
    listed = (await engineer.get(f"{API}/versions")).json()
    assert [each["origin"] for each in listed["versions"]] == ["changed", "found"]
    assert listed["next"] is None
    since = (await engineer.get(f"{API}/versions/1")).json()
    assert "text" not in since["version"]
    assert "s3cret" not in str(since)
    back = f"{API}/versions/1/roll-back"
    body = {"digest": await digest_of(engineer), "reason": "wrong"}
    assert (await engineer.post(back, json=body)).status_code == 403
    admin = await house.program(Role.ADMIN)
    assert (await admin.post(back, json={**body, "review": True})).json()["version"] is None
    assert file.text != TEXT
    assert (await admin.post(back, json=body)).json()["version"]["origin"] == "rolled_back"
    assert file.text == TEXT
    assert (await admin.post(f"{API}/versions/9/roll-back", json=body)).status_code == 404


async def test_without_a_file(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        client = await house.program(Role.ENGINEER)
        assert (await client.get(API)).status_code == 404
        assert (await client.get(f"{API}/versions")).json() == {"versions": [], "next": None}
