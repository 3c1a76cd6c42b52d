"""An operator who fills the disk with notes and pictures: of long ago, without end, by one person, in all."""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path
from typing import Any

import httpx

from app.core.web.access import Role
from app.records.handover.notes import MAX_AGE_DAYS, MAX_PER_HOUR
from app.records.handover.rules import Shift, ShiftSettings
from app.records.handover.service import Handover
from app.settings import ServerSettings
from tests.app.complete_app import House, complete_app
from tests.app.records.test_shift_pictures import png

API = "/api/v1/shifts"


async def present(client: httpx.AsyncClient) -> str:
    """The start of the shift under way."""
    start: str = (await client.get(API)).json()["shifts"][0]["start"]
    return start


async def write(client: httpx.AsyncClient, key: str = "", **more: Any) -> httpx.Response:
    """A note in the shift under way."""
    headers = {"Idempotency-Key": key} if key else {}
    body = {"text": "Felt changed", **more}
    return await client.post(f"{API}/{await present(client)}/notes", json=body, headers=headers)


def picture(number: int) -> str:
    """In base64, each another one."""
    return b64encode(png(2 + number)).decode()


async def test_a_shift_of_long_ago_gets_no_note_and_no_signature(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    quota_of_site = house.services[Handover].quota
    for before in ("1971-06-01T00:00:00Z", "2026-01-01T00:00:00Z"):
        old = (await operator.get(API, params={"before": before})).json()["shifts"][0]
        note = await operator.post(f"{API}/{old['start']}/notes", json={"text": "x", "time": old["start"]})
        signed = await operator.post(f"{API}/{old['start']}/sign", json={"part": "leaving"})
        for refused in (note, signed):
            assert (refused.status_code, refused.json()["code"]) == (409, "not_in_state")
            assert f"more than {MAX_AGE_DAYS} days ago" in refused.json()["detail"]
        page = (await operator.get(f"/shifts/{old['start']}")).text
        assert 'method="post"' not in page.partition("<main")[2], "the page offers neither"
    shifts = await house.services[Handover].summaries(None, 100)
    recent = [each for each in shifts if quota_of_site.is_recent(Shift(each.start, each.end))]
    assert 3 * MAX_AGE_DAYS <= len(recent) < len(shifts)
    assert await house.events("shift") == []


def left_of(response: httpx.Response) -> tuple[int, int]:
    """The limit, and the rest of it."""
    return int(response.headers["RateLimit-Limit"]), int(response.headers["RateLimit-Remaining"])


async def test_one_person_stores_so_much_an_hour_and_others_their_own(house: House) -> None:
    flooder, other = await house.signed_in(Role.OPERATOR), await house.signed_in(Role.ENGINEER)
    for number in range(10):
        assert (await write(flooder, pictures=[picture(number)])).status_code == 201
    stored = 10
    while (response := await write(flooder)).status_code == 201:
        stored += 1
    assert stored == MAX_PER_HOUR - 10, "ten of them with a picture"
    assert (response.status_code, response.json()["code"]) == (429, "too_many")
    assert 30 <= int(response.headers["Retry-After"]) <= 60
    assert left_of(response) == (MAX_PER_HOUR, 0)
    response = await write(other)
    assert (response.status_code, left_of(response)) == (201, (MAX_PER_HOUR, MAX_PER_HOUR - 1))
    assert 1 <= int(response.headers["RateLimit-Reset"]) <= 60
    assert len(await house.events("shift")) == stored + 1


async def test_a_note_that_is_sent_again_costs_nothing(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    sent = [(await write(operator, key="the-same")).status_code for _ in range(MAX_PER_HOUR + 5)]
    assert set(sent) == {201}
    assert (await write(operator, key="another")).status_code == 201


async def test_the_pictures_of_a_site_are_bounded(tmp_path: Path) -> None:
    server, shift = ServerSettings(data=tmp_path / "data"), ShiftSettings(pictures_mb=0)
    async with complete_app(tmp_path, server=server, shift=shift) as house:
        operator = await house.signed_in(Role.OPERATOR)
        refused = await write(operator, pictures=[picture(1)])
        assert (refused.status_code, refused.json()["code"]) == (409, "too_many")
        assert "pictures_mb" in refused.json()["detail"]
        assert (await write(operator)).status_code == 201, "a note without one has room"
