"""The form that begins a swap: what a spare is made from."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from app.core.web.admission.access import Role
from app.engineering.sets.restore_service import RestoreService
from app.engineering.sets.store import SetStore
from app.engineering.swap.service import SwapService
from tests.app.complete_app import House, complete_app
from tests.app.played_line import BUS, played_line

SWAP = f"/swap/{BUS}/2"


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        await played_line(house.services)
        yield house


@pytest.fixture
async def client(house: House) -> httpx.AsyncClient:
    return await house.signed_in(Role.ENGINEER)


async def stored(client: httpx.AsyncClient) -> int:
    return int((await client.post(f"/api/v1/buses/{BUS}/sets", json={"units": [2]})).json()["id"])


async def test_a_stored_set(house: House, client: httpx.AsyncClient) -> None:
    number = await stored(client)
    begun = await client.post(SWAP, data={"source": f"set:{number}:2"})
    assert (begun.status_code, begun.headers["location"]) == (303, SWAP)
    swap = house.services[SwapService].find_or_404(BUS, 2)
    assert swap.source is not None
    assert swap.source.set == number


async def test_a_file_replaces_the_selection(house: House, client: httpx.AsyncClient) -> None:
    number = await stored(client)
    document = (await client.get(f"/api/v1/sets/{number}/document")).content
    data = {"source": f"set:{number}:2"}
    begun = await client.post(SWAP, data=data, files={"file": ("nip.toml", document)})
    assert begun.status_code == 303
    source = house.services[SwapService].find_or_404(BUS, 2).source
    assert source is not None
    kept = await house.services[SetStore].load(source.set)
    assert kept is not None
    assert (kept.id > number, kept.name, kept.origin) == (True, "nip.toml", "from a file")


async def test_the_sheet(house: House, client: httpx.AsyncClient) -> None:
    # As a browser does: the field of a file that was not chosen is sent, empty.
    begun = await client.post(SWAP, data={"source": "sheet"}, files={"file": ("", b"")})
    assert begun.status_code == 303
    assert house.services[SwapService].find_or_404(BUS, 2).source is None


@pytest.mark.parametrize("source", ["", "set:99:2", "set:1", "nonsense"])
async def test_what_names_no_source_begins_nothing(
    house: House, client: httpx.AsyncClient, source: str
) -> None:
    refused = await client.post(SWAP, data={"source": source})
    assert refused.status_code in (404, 422)
    assert house.services[SwapService].find(BUS, 2) is None


async def test_the_restore_of_a_spare_leads_back_to_the_swap_and_no_other_does(
    house: House, client: httpx.AsyncClient
) -> None:
    number = await stored(client)
    await client.post(SWAP, data={"source": f"set:{number}:2"})
    planned = await client.post(f"{SWAP}/restore")
    again = await client.post(f"{planned.headers['location']}/again")
    other = await client.post(f"/units/{BUS}/2/restore", data={"source": f"set:{number}:2"})
    links = []
    for review in (planned, again, other):
        path = review.headers["location"]
        assert (await client.post(f"/api/v1{path}/start")).status_code == 202
        await house.services[RestoreService].background.settled()
        links.append(f'href="{SWAP}"' in (await client.get(path)).text)
    assert links == [True, True, False]


async def test_a_spare_with_a_set_is_not_called_verified_by_the_sheet(
    house: House, client: httpx.AsyncClient
) -> None:
    await client.post(SWAP, data={"source": f"set:{await stored(client)}:2"})
    refused = await client.post(f"{SWAP}/entered", headers={"accept": "application/json"})
    assert (refused.status_code, refused.json()["code"]) == (409, "not_in_state")
    assert not house.services[SwapService].find_or_404(BUS, 2).proven
