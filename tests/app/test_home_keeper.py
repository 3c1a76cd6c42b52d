"""Two servers on one store: who is the home of a bus, what runs there, and what ends first."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from app.database import SqliteDatabase
from app.database.availability import NO_RESPONSE, Availability
from app.errors import StoreError
from app.home import lease as rules
from app.home import store as home_store
from app.home.homes import Homes
from app.home.keeping import keeper as keeping
from app.home.keeping.keeper import HomeKeeper, HomeTerms
from app.home.lease import SITE, HomeRow, Lease
from app.home.store import HomeStore, read_homes, request_home
from bus.instants import Monotonic, monotonic_now
from bus.messages import Message

BUS, PATIENCE_S = "dry-end", 30.0
FACTOR = 0.1
"""All times of a lease are a tenth, for a short test; conditions are waited for, never times."""


@pytest.fixture(autouse=True)
def _short_times(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("LEASE_S", "MARGIN_S"):
        monkeypatch.setattr(rules, name, getattr(rules, name) * FACTOR)
    monkeypatch.setattr(home_store, "LEASE_S", rules.LEASE_S)
    for name in ("RENEW_S", "LOOK_S", "BEAT_WITHIN_S"):
        monkeypatch.setattr(keeping, name, getattr(keeping, name) * FACTOR)


class Events:
    """Keeps what is recorded."""

    def __init__(self) -> None:
        self.recorded: list[dict[str, Any]] = []

    async def record(self, **fields: Any) -> int:
        self.recorded.append(fields)
        return len(self.recorded)


class Server:
    """One server on the store: its homes, and in order what began and ended."""

    def __init__(self, path: Path, name: str, *, automatic: bool = True, permitted: bool = True) -> None:
        self.path, self.database = path, SqliteDatabase(path)
        self.happened: list[str] = []
        self.events = Events()
        self.fails_to_start = False
        self.slow_port = asyncio.Event()
        self.slow_port.set()
        self.homes = Homes(name, f"http://{name}", is_shared=True)
        terms = {SITE: HomeTerms(True, True), BUS: HomeTerms(permitted, automatic)}
        self.store = HomeStore(self.database, monotonic_now)
        self.keeper = HomeKeeper(
            self.homes,
            self.store,
            self.events,  # type: ignore[arg-type]
            terms,
            {SITE: lambda: self.living("site"), BUS: lambda: self.living("bus")},
            self,
        )

    @asynccontextmanager
    async def living(self, what: str) -> AsyncIterator[None]:
        if self.fails_to_start:
            raise StoreError(Message("store_is_damaged"))
        self.happened.append(f"{what} loaded")
        yield
        self.happened.append(f"{what} ended")

    def start(self, bus: str) -> None:
        self.happened.append(f"port of {bus or 'site'} opened")

    async def stop(self, bus: str) -> None:
        await self.slow_port.wait()
        self.happened.append(f"port of {bus or 'site'} closed")

    def request(self, reason: str) -> bool:
        """As ``lineside home take`` does at this server, in another process."""
        with closing(SqliteDatabase(self.path, checkpoints=False)) as database:
            return request_home(database, BUS, self.homes.server, who="anna", reason=reason)

    async def row(self) -> HomeRow:
        """What the store has of the bus."""
        return (await self.database.read(read_homes)).rows[BUS]

    def of_bus(self) -> list[str]:
        return [each for each in self.happened if "site" not in each]


Start = Callable[..., Any]


@pytest.fixture
async def start(tmp_path: Path) -> AsyncIterator[Start]:
    async with AsyncExitStack() as stack:

        async def start(name: str, **terms: bool) -> tuple[Server, AsyncExitStack]:
            server = Server(tmp_path / "lineside.db", name, **terms)
            stack.callback(server.database.close)
            life = await stack.enter_async_context(AsyncExitStack())
            await life.enter_async_context(server.keeper.running())
            return server, life

        yield start


async def until(true: Callable[[], object]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while True:
            if true():
                return
            await asyncio.sleep(0.01)


async def test_one_takes_the_bus_and_the_other_when_it_ends(start: Start) -> None:
    a, life = await start("a")
    await until(lambda: a.homes.is_here(BUS) and "port of dry-end opened" in a.happened)
    b, _ = await start("b")
    await until(lambda: b.homes.of(BUS).server == "a")
    assert not b.homes.is_here(BUS)
    assert (b.homes.of(BUS).url, b.homes.of(BUS).epoch) == ("http://a", 1)
    assert b.homes.epoch(BUS) == 0
    await life.aclose()
    assert a.of_bus() == ["bus loaded", "port of dry-end opened", "port of dry-end closed", "bus ended"]
    await until(lambda: b.homes.is_here(BUS))
    assert b.homes.epoch(BUS) > 1
    assert not a.homes.is_here(BUS)
    await until(lambda: any(each["bus"] == BUS for each in b.events.recorded))


async def test_a_lease_that_is_not_renewed_ends_here_before_another_takes_it(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, _ = await start("a")
    await until(lambda: a.homes.is_here(BUS))
    b, _ = await start("b")
    taken_while_held: list[bool] = []
    b.homes.subscribe(lambda _: taken_while_held.append(a.homes.is_here(BUS) and b.homes.is_here(BUS)))

    async def away(*_: object) -> None:
        raise StoreError(Message("store_is_damaged"))

    monkeypatch.setattr(a.store, "beat", away)
    await until(lambda: "port of dry-end closed" in a.happened)
    await until(lambda: b.homes.is_here(BUS))
    assert not any(taken_while_held)
    assert a.of_bus()[-2:] == ["port of dry-end closed", "bus ended"]


async def test_a_lease_that_lapsed_is_free_at_once(start: Start) -> None:
    """As after a halt of the server, in which a renewal that was under way has reached the store."""
    a, _ = await start("a")
    await until(lambda: "port of dry-end opened" in a.happened)
    a.slow_port.clear()
    epoch, held = a.homes.epoch(BUS), a.keeper._leases[BUS]
    a.keeper._leases[BUS] = replace(held, confirmed=Monotonic(0.0))
    a.keeper.look()
    await until(lambda: not a.homes.is_here(BUS))
    assert not (await a.row()).is_released, "its port is open"
    a.slow_port.set()
    await until(lambda: a.homes.is_here(BUS))
    assert a.homes.epoch(BUS) == epoch + 1
    assert (await a.row()).reason == "a gave it up", "it waited for no lease to run out"
    await until(lambda: a.of_bus().count("port of dry-end opened") == 2)


async def test_a_store_that_is_away_is_tried_before_the_next_renewal_is_due(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keeping, "RENEW_S", 10 * PATIENCE_S)
    a, _ = await start("a")
    tried: list[object] = []

    async def away(*_: object) -> None:
        tried.append(None)
        raise StoreError(Message("store_is_damaged"))

    monkeypatch.setattr(a.store, "beat", away)
    a.keeper._wake.set()
    await until(lambda: len(tried) > 2)


async def test_a_renewal_that_comes_as_the_lease_runs_out_is_one(start: Start) -> None:
    a, _ = await start("a")
    await until(lambda: a.homes.is_here(BUS))
    a.homes.hold(BUS, Lease(a.homes.epoch(BUS), Monotonic(0.0)))
    assert not a.homes.is_here(BUS)
    await a.keeper.beat()
    assert a.homes.is_here(BUS), "it is the home in the store, and its worker gets the port"


async def test_a_store_that_does_not_respond_is_one_that_is_away(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, _ = await start("a")
    await until(lambda: a.homes.is_here(BUS))

    async def hang(*_: object) -> None:
        await asyncio.Event().wait()

    monkeypatch.setattr(a.store, "beat", hang)
    await until(lambda: not a.homes.is_here(BUS) and "bus ended" in a.happened)


async def test_homes_are_renewed_and_none_is_taken_while_nothing_else_reaches_the_store(start: Start) -> None:
    a, life = await start("a")
    await until(lambda: a.homes.is_here(BUS))
    b, _ = await start("b")
    renewals = (await a.row()).renewals
    a.database.availability, b.database.availability = Availability(), Availability()
    a.database.availability.lost(NO_RESPONSE)
    b.database.availability.lost(NO_RESPONSE)
    await a.keeper.beat()
    assert a.homes.is_here(BUS)
    await life.aclose()
    for _ in range(3):
        await b.keeper.beat()
    assert not b.homes.is_here(BUS), "its parts could not be loaded"
    b.database.availability = None
    row = await b.row()
    assert row.renewals > renewals
    assert row.is_released
    await until(lambda: b.homes.is_here(BUS))


async def test_a_local_port_is_kept_while_the_store_is_away_and_never_taken_alone(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, life = await start("a", automatic=False)
    await until(lambda: a.homes.is_here(BUS))
    b, _ = await start("b", automatic=False)
    beat = a.store.beat

    async def away(*_: object) -> None:
        raise StoreError(Message("store_is_damaged"))

    monkeypatch.setattr(a.store, "beat", away)
    await until(lambda: b.homes.is_here(SITE))
    assert a.homes.is_here(BUS), "the site's work went, the local port stayed"
    assert not b.homes.is_here(BUS)
    monkeypatch.setattr(a.store, "beat", beat)
    await life.aclose()
    for _ in range(5):
        await b.keeper.beat()
    assert not b.homes.is_here(BUS), "also given up, a local port waits for its server or for a person"


async def test_a_person_has_it_handed_over_by_a_holder_that_lives(start: Start) -> None:
    a, _ = await start("a", automatic=False)
    await until(lambda: "port of dry-end opened" in a.happened)
    b, _ = await start("b", automatic=False)
    assert b.request("the cable is at b now")
    await until(lambda: b.homes.is_here(BUS))
    assert a.of_bus()[-2:] == ["port of dry-end closed", "bus ended"]
    await until(lambda: any(each["bus"] == BUS for each in b.events.recorded))
    event = next(each for each in b.events.recorded if each["bus"] == BUS)
    assert (event["kind"], event["who"], event["message"]) == ("home", "anna", "the cable is at b now")
    for _ in range(5):
        await a.keeper.beat()
    assert not a.homes.is_here(BUS)


async def test_it_is_handed_over_only_once_the_port_is_closed(start: Start) -> None:
    a, _ = await start("a")
    await until(lambda: "port of dry-end opened" in a.happened)
    b, _ = await start("b")
    a.slow_port.clear()
    b.request("maintenance")
    await until(lambda: not a.homes.is_here(BUS))
    for _ in range(5):
        await b.keeper.beat()
    assert not b.homes.is_here(BUS)
    a.slow_port.set()
    await until(lambda: b.homes.is_here(BUS))


async def test_one_that_may_not_be_its_home_never_is(start: Start) -> None:
    a, _ = await start("a", permitted=False)
    await until(lambda: a.homes.is_here(SITE))
    assert not a.homes.is_here(BUS)


@pytest.mark.parametrize(
    "edit",
    [
        "DELETE FROM home",
        "UPDATE home SET holder = 'b'",
        "UPDATE home SET epoch = 1000",
        "UPDATE home SET instance = 'x'",
    ],
)
async def test_a_row_that_is_edited_by_hand_ends_the_home_and_gives_it_to_no_two(
    start: Start, edit: str
) -> None:
    a, _ = await start("a")
    await until(lambda: a.homes.is_here(BUS))
    b, _ = await start("b")
    epoch = a.homes.epoch(BUS)
    both: list[bool] = []
    for server in (a, b):
        server.homes.subscribe(lambda _: both.append(a.homes.is_here(BUS) and b.homes.is_here(BUS)))
    await a.database.write(lambda connection: connection.execute(edit))
    await until(lambda: "bus ended" in a.happened)
    await until(lambda: a.homes.is_here(BUS) or b.homes.is_here(BUS))
    assert not any(both)
    assert max(a.homes.epoch(BUS), b.homes.epoch(BUS)) > epoch, "no epoch comes twice"
    lost = [each for each in a.events.recorded if each["what"].code == "event_home_lost"]
    assert lost[0]["message"] == Message("home_reason_changed")


async def test_a_namesake_is_named_and_takes_nothing(start: Start) -> None:
    a, _ = await start("a")
    await until(lambda: a.homes.is_here(BUS))
    twin, _ = await start("a")
    await until(lambda: twin.homes.faults)
    assert not twin.homes.is_here(BUS)
    assert "Another server has the id a too" in str(twin.homes.faults[0])


async def test_one_that_cannot_start_it_gives_it_up(start: Start, tmp_path: Path) -> None:
    a = Server(tmp_path / "lineside.db", "a")
    a.fails_to_start = True
    b, _ = await start("b", permitted=True)
    await until(lambda: b.homes.is_here(BUS))
    async with a.keeper.running():
        a.request("maintenance")
        await until(lambda: not b.homes.is_here(BUS))
        await until(lambda: b.homes.is_here(BUS))
    a.database.close()


async def test_a_worker_that_has_seen_more_epochs_raises_that_of_its_home(start: Start) -> None:
    a, _ = await start("a")
    await until(lambda: a.homes.is_here(BUS))
    assert await a.homes.outnumber(BUS, 41)
    assert a.homes.epoch(BUS) == 42
    assert not await a.homes.outnumber(BUS, 2**52), "no server can have had so many"
    for _ in range(3):
        await a.keeper.beat()
    assert a.homes.epoch(BUS) == 42


async def test_a_server_alone_is_the_home_of_all_at_once_with_the_next_epoch(tmp_path: Path) -> None:
    for run in (1, 2):
        server = Server(tmp_path / "lineside.db", "a")
        server.homes.is_shared = False
        async with server.keeper.running():
            assert server.homes.is_here(BUS)
            assert (server.homes.epoch(BUS), server.homes.left_s(BUS)) == (run, math.inf)
            assert server.homes.of(BUS)[:4] == (BUS, "a", "http://a", run)
            assert server.happened[:3] == ["site loaded", "port of site opened", "bus loaded"]
        server.database.close()
