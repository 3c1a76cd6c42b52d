"""Texts that would write more into the configuration file than one value, or that no one could read there."""

from __future__ import annotations

import json
import tomllib
from itertools import cycle
from typing import Any
from urllib.parse import urlencode

import httpx
import pytest

from app.core.web.access import Role
from tests.app.complete_app import House
from tests.app.configuration_file import TEXT, UNIT, PlantFile, form_of, house_with_file, plant_file
from tests.attacks.test_free_texts import HOSTILE, SOME
from tests.for_each import for_each

TABLE = "/api/v1/configuration/tables/bus.0.unit.0"
FIELDS = ("name", "group", "labels.output.1", "labels.input.run", "labels.analog_unit")
INJECTED = ['x"\n[server]\nhost = "0.0.0.0"', 'x" #', "x\\", "'''", "x\\u000a"]

house = pytest.fixture(house_with_file)
file = pytest.fixture(plant_file)


async def put(client: httpx.AsyncClient, values: dict[str, str], reason: str = "") -> httpx.Response:
    digest = (await client.get("/api/v1/configuration")).json()["digest"]
    body = json.dumps({"digest": digest, "values": values, "reason": reason})
    content = body.replace('"HALF"', '"\\ud800"')
    return await client.put(TABLE, content=content, headers={"content-type": "application/json"})


async def type_in(client: httpx.AsyncClient, **typed: str) -> httpx.Response:
    form = urlencode({**await form_of(client), **typed, "confirmed": "true"}, errors="surrogatepass")
    headers = {"content-type": "application/x-www-form-urlencoded"}
    return await client.post(UNIT, content=form, headers=headers)


def unit_in(text: str) -> dict[str, Any]:
    unit: dict[str, Any] = tomllib.loads(text)["bus"][0]["unit"][0]
    return unit


@for_each("text", INJECTED)
async def test_a_text_stays_one_value(house: House, file: PlantFile, text: str) -> None:
    client = await house.signed_in(Role.ENGINEER)
    refused = "\n" in text
    assert (await put(client, {"name": text})).status_code == (422 if refused else 200)
    assert (await type_in(client, group=text)).status_code == (422 if refused else 303)
    found, before = tomllib.loads(file.text), tomllib.loads(TEXT)
    if not refused:
        assert (unit_in(file.text)["name"], unit_in(file.text)["group"]) == (text, text)
        found["bus"], before["bus"] = [], []
    assert found == before


async def test_a_text_that_hides_is_refused_by_its_character(house: House, file: PlantFile) -> None:
    client = await house.signed_in(Role.ENGINEER)
    for (name, text), field in zip(HOSTILE.items(), cycle(FIELDS)):
        refused = await put(client, {field: text})
        assert (refused.status_code, refused.json()["code"]) == (422, "invalid"), name
        assert refused.json()["reason"] == "configuration_not_valid", name
    assert file.text == TEXT


async def test_a_text_that_hides_is_refused_at_its_field(house: House, file: PlantFile) -> None:
    client = await house.signed_in(Role.ENGINEER)
    for name in SOME:
        text = HOSTILE[name]
        page = await type_in(client, name=text.replace("HALF", "x" * 61))
        assert page.status_code == 422, name
        assert 'aria-invalid="true"' in page.text, name
    assert file.text == TEXT


async def test_a_reason_forges_no_line_of_the_audit_log(house: House, file: PlantFile) -> None:
    client = await house.signed_in(Role.ENGINEER)
    for name in SOME:
        text = HOSTILE[name]
        assert (await put(client, {"name": "Nip 1"}, reason=text)).status_code == 422, name
        hostile = text.replace("HALF", "x" * 201)
        assert (await type_in(client, name="Nip 1", reason_of_change=hostile)).status_code == 422, name
    assert file.text == TEXT
    assert await house.events("configuration") == []


SECRET = '"https://hooks.plant.example/s3cret"'
SLIPS = {
    "unterminated": SECRET[:-1],
    "more behind it": f"{SECRET} x",
    "twice": f"{SECRET}\nurl = {SECRET}",
    "a list": f"[{SECRET}]",
    "another scheme": SECRET.replace("https", "ftp"),
    "lines": SECRET.replace('"', '"""').replace("/s3", "/\ns3").removesuffix('"'),
}


@for_each("slip", SLIPS)
async def test_a_slip_in_the_file_shows_no_secret(house: House, file: PlantFile, slip: str) -> None:
    file.write(TEXT.replace(SECRET, SLIPS[slip]))
    client = await house.signed_in(Role.ENGINEER)
    shown = await client.get("/api/v1/configuration")
    assert shown.json()["faults"]
    pages = ["/configuration", "/configuration/versions/1", "/configuration/versions/2"]
    texts = [shown.text, *[(await client.get(page)).text for page in pages]]
    texts += [str(await house.events("configuration"))]
    assert not [text for text in texts if "s3cret" in text]


SEPARATORS = "\u2028\u2029\u0085"


async def test_a_separator_by_hand_moves_no_line(house: House, file: PlantFile) -> None:
    """Python splits lines at more places than TOML does."""
    odd = f"# a{SEPARATORS}b\n" + TEXT.replace('"Mill 7"', f'"Mill{SEPARATORS}"')
    file.write(TEXT.replace("# The plant.", f"# The{SEPARATORS}plant."))
    client = await house.signed_in(Role.ENGINEER)
    before = file.text
    assert (await put(client, {"name": "Unwinder"})).status_code == 200
    assert file.text == before.replace('"Unwind" ', '"Unwinder" ')
    file.write(odd)
    [fault] = (await client.get("/api/v1/configuration")).json()["faults"]
    assert "lineside.toml:4: " in fault["detail"]
