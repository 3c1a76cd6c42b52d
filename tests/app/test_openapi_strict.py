"""Strict programs: a TypeScript client made from the document, and every member of real responses."""

from __future__ import annotations

import re
import subprocess
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from jsonschema_rs import Draft202012Validator

from app.core.web.access import Role
from app.core.web.api import openapi_document
from app.line.live.bus_live import LiveState
from tests.app.complete_app import Api, House, complete_app, served
from tests.app.fake_worker import snapshot
from tests.app.strict_schema import strict
from tests.app.typescript_client import client_of

TSC = Path(__file__).resolve().parents[2] / "node_modules" / ".bin" / "tsc"
PROGRAM = """
import { get_line, get_unit, list_events, set_speed, type Send, type Unit } from "./client.js";

declare const process: { env: Record<string, string> };
const send: Send = async (method, path, query, body) => {
  const headers = { authorization: `Bearer ${process.env.TOKEN}`, "content-type": "application/json" };
  const words = new URLSearchParams(Object.entries(query).map(([name, value]) => [name, String(value)]));
  const content = body === undefined ? null : JSON.stringify(body);
  return (await fetch(`${process.env.SITE}${path}?${words}`, { method, headers, body: content })).json();
};
const line = await get_line(send);
const names: string[] = line.buses.flatMap((bus) => bus.units.map((unit: Unit) => unit.name));
const unit = await get_unit(send, "dry-end", 1);
const speed: number | null = unit.actual_raw;
// @ts-expect-error A value may be null.
const certain: number = unit.actual_raw;
// @ts-expect-error It has no such member.
unit.velocity;
// @ts-expect-error A setpoint is a number on the wire.
export const wrong = () => set_speed(send, "dry-end", 1, { raw: "1" });
const page = await list_events(send, { limit: 1 });
console.log([...names, speed, certain, page.events.length].join());
"""
SETTINGS = ("--strict", "--skipLibCheck", "--target", "es2022", "--module", "es2022")
RESOLUTION = ("--moduleResolution", "bundler")

VALUES: dict[str, str] = {
    "bus": "dry-end",
    "unit": "1",
    "value": "actual",
    "series": "dry-end/1/actual",
    "from": "2026-11-21T03:00:00Z",
    "to": "2026-11-21T04:00:00Z",
    "points": "100",
}
"""For the parameters of a call, by name."""
NOT_THERE = (
    *("get_trace", "get_parameter_set", "compare_parameter_sets", "get_restore"),
    *("get_signed_shift_sheet", "get_configuration", "get_configuration_version"),
)
"""What a new site does not have, and other tests make."""


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    with served(tmp_path_factory.mktemp("strict")) as api:
        yield api


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        house.services[LiveState].buses["dry-end"].connect_worker(snapshot())
        yield house


def test_a_typescript_client_is_compiled_and_used(api: Api, tmp_path: Path) -> None:
    document = httpx.get(f"{api.url}/api/v1/openapi.json", headers=api.headers, trust_env=False, timeout=60)
    (tmp_path / "client.ts").write_text(client_of(document.json()), encoding="utf-8")
    (tmp_path / "main.ts").write_text(PROGRAM, encoding="utf-8")
    (tmp_path / "package.json").write_text('{"type": "module"}', encoding="utf-8")
    words = [str(TSC), *SETTINGS, *RESOLUTION, "main.ts"]
    compiled = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    assert compiled.stdout == ""
    environment = {"SITE": api.url, "TOKEN": api.token}
    ran = subprocess.run(["node", "main.js"], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (ran.stdout, ran.stderr) == ("Unwind,Nip,,,1\n", "")


async def test_every_member_of_a_response_is_described(house: House) -> None:
    document = openapi_document(house.app)
    components = strict(document["components"])
    program = await house.program(Role.ADMIN)
    (shift, *_) = (await program.get("/api/v1/shifts")).json()["shifts"]
    values = {**VALUES, "start": shift["start"]}
    alarm = (await program.get("/api/v1/alarms?state=normal")).json()["alarms"][0]
    values["alarm_id"] = alarm["id"]
    recipe = {"name": "A", "setpoints": {"1": 100}}
    saved = await program.post("/api/v1/buses/dry-end/recipes", json=recipe)
    values["recipe_id"] = str(saved.json()["id"])
    checked, refused = [], set()
    for path, methods in document["paths"].items():
        operation = methods.get("get", {})
        content = operation.get("responses", {}).get("200", {}).get("content", {})
        if "application/json" not in content:
            continue
        response = await program.get(filled(path, values), params=query_of(operation, values))
        if response.status_code != 200:
            refused.add(operation["operationId"])
            continue
        schema = {**content["application/json"]["schema"], "components": components}
        faults = [str(each) for each in Draft202012Validator(schema).iter_errors(response.json())]
        assert faults == [], path
        checked.append(path)
    assert sorted(refused) == sorted(NOT_THERE)
    assert len(checked) > 20


async def test_a_number_is_no_time(house: House) -> None:
    """Nowhere in the API: seconds and milliseconds look alike."""
    program, tried = await house.program(Role.ADMIN), []
    for path, methods in openapi_document(house.app)["paths"].items():
        operation = methods.get("get", {})
        for parameter in operation.get("parameters", ()):
            if "date-time" not in str(parameter["schema"]):
                continue
            for number in ("1764400000", "1764400000.5", "1764400000000"):
                values = {**VALUES, parameter["name"]: number}
                query = query_of(operation, values) | (
                    {parameter["name"]: number} if parameter["in"] == "query" else {}
                )
                response = await program.get(filled(path, values), params=query)
                assert response.status_code == 422, (path, parameter["name"], number)
            tried.append(path)
    assert len(tried) > 20
    note = {"text": "Web break", "bus": "dry-end", "unit": 1}
    for at in (1764400000, "1764400000", 1764400000.5):
        refused = await program.post("/api/v1/shifts/notes", json={**note, "time": at})
        assert (refused.status_code, refused.json()["code"]) == (422, "invalid"), refused.text


def filled(path: str, values: dict[str, str]) -> str:
    """The path with its places filled."""
    return re.sub(r"{(\w+)}", lambda match: values.get(match[1], "1"), path)


def query_of(operation: dict[str, Any], values: dict[str, str]) -> dict[str, str]:
    """What a call requires."""
    return {
        each["name"]: values[each["name"]]
        for each in operation.get("parameters", ())
        if each["in"] == "query" and each.get("required")
    }
