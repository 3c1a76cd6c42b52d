"""The description of every call is half a megabyte: it is made once, and sent as it is."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from app.core.web import api as schema
from app.core.web.access import Role
from tests.app.complete_app import House

PATH = "/api/v1/openapi.json"


async def test_it_is_made_once_for_all_who_request_it_and_who_has_it_gets_no_second_one(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, make = list[dict[str, Any]](), schema.openapi_document

    def counted(app: Any) -> dict[str, Any]:
        made.append(make(app))
        return made[-1]

    monkeypatch.setattr(schema, "openapi_document", counted)
    client = await house.program(Role.VIEWER)
    responses = await asyncio.gather(*(client.get(PATH) for _ in range(5)))
    assert [response.json() == made[0] for response in responses] == [True] * 5
    assert len(made) == 1
    first = responses[0]
    assert (first.status_code, first.headers["content-encoding"]) == (200, "gzip")
    again = await client.get(PATH, headers={"if-none-match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    plain = await client.get(PATH, headers={"accept-encoding": "identity", "if-none-match": 'W/"other"'})
    assert (plain.status_code, plain.json()) == (200, first.json())
    assert "content-encoding" not in plain.headers
