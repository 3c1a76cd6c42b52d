"""The configuration in the browser: whom it shows nothing, addresses of no table, a file that is a link."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.core.web.access import Role
from tests.app.complete_app import House, complete_app
from tests.app.configuration_file import TEXT, UNIT, fields_of, form_of, written

API = "/api/v1/configuration"
TABLE = f"{API}/tables/bus.0.unit.0"
READ = (API, f"{API}/versions", f"{API}/versions/1", "/configuration", UNIT, "/configuration/versions/1")


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    """Its file is a link to one in another folder."""
    folder = tmp_path / "kept elsewhere"
    folder.mkdir()
    link = tmp_path / "lineside.toml"
    link.symlink_to(written(folder))
    async with complete_app(tmp_path, config=link) as house:
        yield house


def text_of(folder: Path) -> str:
    return (folder / "kept elsewhere" / "lineside.toml").read_text(encoding="utf-8")


async def put(client: httpx.AsyncClient, table: str = TABLE, **body: Any) -> httpx.Response:
    digest = body.pop("digest", None) or (await client.get(API)).json()["digest"]
    return await client.put(table, json={"digest": digest, "values": {"name": "Unwinder"}, **body})


async def test_a_link_stays_one_and_its_file_is_changed(house: House, tmp_path: Path) -> None:
    client = await house.signed_in(Role.ENGINEER)
    assert (await put(client)).status_code == 200
    assert (tmp_path / "lineside.toml").is_symlink()
    assert text_of(tmp_path) == TEXT.replace('"Unwind" ', '"Unwinder" ')


async def test_nothing_is_shown_to_whom_may_not(house: House, tmp_path: Path) -> None:
    for role in (Role.VIEWER, Role.OPERATOR):
        client = await house.signed_in(role)
        for path in READ:
            refused = await client.get(path)
            assert refused.status_code == 403, path
            assert str(tmp_path) not in refused.text
            assert "lineside.toml" not in refused.text
        assert (await put(client, digest="x")).status_code == 403
        assert (await client.post(UNIT, data={"act": "change", "name": "x"})).status_code == 403
        assert (await client.post("/configuration/versions/1/roll-back")).status_code == 403
    for path in READ:
        refused = await house.client().get(path)
        assert refused.status_code in (303, 401), path
    engineer = await house.signed_in(Role.ENGINEER)
    for path in READ:
        assert "s3cret" not in (await engineer.get(path)).text, path
    assert text_of(tmp_path) == TEXT


OF_NO_TABLE = """server site store audit bus.0 bus.0.port notify.webhook.0 bus.1.unit.0 bus.0.unit.2
bus.0.unit.-1 bus.0.unit.\u0660 bus.0.unit.00001 bus.0.unit.0.labels .. a/b notify.group.0.duty.0 alarm.1
bus..unit.0 0 ."""


async def test_an_address_of_no_table_changes_nothing(house: House, tmp_path: Path) -> None:
    client = await house.signed_in(Role.ADMIN)
    for name in (*OF_NO_TABLE.split(), "x" * 80):
        refused = await put(client, f"{API}/tables/{name}", values={})
        assert refused.status_code in (404, 405, 409), (name, refused.text)
        page = await client.post(f"/configuration/tables/{name}", data={"act": "remove"})
        assert page.status_code in (404, 405, 409), name
    assert text_of(tmp_path) == TEXT


async def test_a_version_that_there_is_not(house: House, tmp_path: Path) -> None:
    client = await house.signed_in(Role.ADMIN)
    for number in ("0", "-1", "9" * 30, "9" * 400, "..%2f..%2fetc%2fpasswd", "\u0662"):
        for path in (f"{API}/versions/{number}", f"/configuration/versions/{number}"):
            assert (await client.get(path)).status_code in (404, 422), path
            assert (await client.post(f"{path}/roll-back")).status_code in (404, 409, 422), path
    assert text_of(tmp_path) == TEXT


async def test_of_two_browsers_at_once_one_writes_and_the_other_is_shown_what_changed(
    house: House, tmp_path: Path
) -> None:
    browsers = [await house.signed_in(Role.ENGINEER, name) for name in ("anna", "ben")]
    forms = [
        {**await form_of(browser, **typed), "confirmed": "true"}
        for browser, typed in zip(browsers, ({"name": "Unwinder"}, {"group": "Wet"}), strict=True)
    ]
    done = await asyncio.gather(
        *(browser.post(UNIT, data=form) for browser, form in zip(browsers, forms, strict=True))
    )
    assert sorted(each.status_code for each in done) == [303, 409]
    late = next(index for index, each in enumerate(done) if each.status_code == 409)
    kept = fields_of(done[late].text)
    assert (kept["name"], kept["group"]) == ("Unwinder", "Wet")
    again = await browsers[late].post(UNIT, data={**kept, "act": "change", "confirmed": "true"})
    assert again.status_code == 303
    assert text_of(tmp_path).count('"Unwinder"') == text_of(tmp_path).count('"Wet"') == 1


async def test_a_form_that_is_sent_twice_is_one_version(house: House) -> None:
    client = await house.signed_in(Role.ENGINEER)
    form = {**await form_of(client, name="Unwinder"), "confirmed": "true"}
    done = await asyncio.gather(*(client.post(UNIT, data=form) for _ in range(3)))
    assert sorted(each.status_code for each in done) == [303, 409, 409]
    assert len((await client.get(f"{API}/versions")).json()["versions"]) == 2
