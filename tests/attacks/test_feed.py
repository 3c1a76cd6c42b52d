"""A compromised worker against the app: whatever it sends, nothing fails, and every page still responds."""

from __future__ import annotations

import asyncio
import gc
import inspect
import time
import tracemalloc
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import AsyncExitStack
from functools import wraps
from itertools import pairwise
from pathlib import Path
from typing import Any
from uuid import uuid4

import httpx
import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from structlog.testing import capture_logs

from app.core.web.access import Role
from app.line.feed.bus_feed import BusFeed, Credential, WorkerLeft
from app.line.feed.socket import MAX_HELLOS_AT_ONCE, TOO_OFTEN, Workers
from app.line.live.browser import Browser
from app.line.live.change_recorder import ChangeRecorder
from app.line.live.hub import Hub
from app.people.audit.log import EventLog, Filter
from bus.contract import (
    MAX_UPDATES,
    AppMessage,
    Batch,
    Frame,
    Frames,
    ParameterValue,
    Snapshot,
    Update,
    encode,
)
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import hello, reading, snapshot
from tests.attacks.hostile import GARBAGE, batches, broken, encoded, of_type

BUS = "dry-end"
PAGES = (
    *("/", "/units/dry-end/1", "/units/dry-end/1/parameters", "/setpoints", "/bus/dry-end", "/events"),
    *("/trends", "/sets", "/recipes", "/users", "/metrics", "/api/v1/line", "/api/v1/events"),
    *("/api/v1/events.csv", "/api/v1/buses/dry-end/units/1", "/api/v1/buses/dry-end/units/1/parameters"),
    "/api/v1/buses/dry-end/figures",
    "/api/v1/history?bus=dry-end&unit=1&value=actual&from=2020-01-01T00:00:00Z&to=2100-01-01T00:00:00Z",
)
SNAPSHOTS = of_type(msgspec.inspect.type_info(Snapshot))
BATCHES = batches(2**53)
PLAUSIBLE = st.tuples(encoded(SNAPSHOTS), *(encoded(batches(2**53 - seq)) for seq in (3, 2, 1)))
MESSAGES = st.one_of(
    encoded(BATCHES), encoded(SNAPSHOTS), encoded(broken(BATCHES)), encoded(broken(SNAPSHOTS)), GARBAGE
)


class HostileSocket:
    """Gives what it was made with, and then leaves."""

    def __init__(self, messages: Sequence[bytes]) -> None:
        self._messages = list(messages)
        self.sent: list[AppMessage] = []
        self.reason: str | None = None
        self.is_admitted = False

    async def receive(self) -> bytes:
        if self.reason is not None:
            raise ConnectionError("closed")
        if not self._messages:
            raise WorkerLeft
        return self._messages.pop(0)

    async def send(self, message: AppMessage) -> None:
        self.sent.append(message)

    def admit(self) -> None:
        self.is_admitted = True

    async def close(self, reason: str) -> None:
        self.reason = reason


class Scene:
    """The complete app with an open page in German that follows the trace, and an admin who reads every
    page.
    """

    def __init__(self, house: House, admin: httpx.AsyncClient) -> None:
        self.house = house
        self.admin = admin
        self.page = Browser("ada", "admin", "de", units=frozenset({(BUS, 1)}), trace=BUS)
        house.services[Hub].join(self.page)
        self._skipped_s = 0.0
        for timed in (house.services[Workers], house.services.buses[BUS][BusFeed]):
            timed.monotonic = lambda: time.monotonic() + self._skipped_s

    async def attack(self, *messages: bytes) -> HostileSocket:
        """One connection that sends them after a hello; the worker before is gone for long."""
        return await self.serve(HostileSocket([encode(hello(uuid4().hex)), *messages]))

    async def serve(self, socket: HostileSocket) -> HostileSocket:
        """One connection, by another token each time; nothing behind it fails unnoticed."""
        self._skipped_s += 60.0
        with capture_logs() as logs:
            await self.house.services[Workers].serve(socket, Credential(uuid4().hex, BUS, "192.0.2.66"))
        assert [entry for entry in logs if entry["log_level"] == "error"] == []
        return socket

    async def look_at_everything(self) -> None:
        """An exception in a page comes through to the test."""
        self.house.services[Hub].tick()
        for path in PAGES:
            response = await self.admin.get(path)
            assert response.status_code == 200, (path, response.status_code, response.text[:500])


@pytest.fixture(scope="module")
def runner() -> Iterator[asyncio.Runner]:
    with asyncio.Runner() as runner:
        yield runner


@pytest.fixture(scope="module")
def scene(runner: asyncio.Runner, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scene]:
    async def begin(folder: Path) -> tuple[AsyncExitStack, Scene]:
        stack = AsyncExitStack()
        house = await stack.enter_async_context(complete_app(folder))
        return stack, Scene(house, await house.signed_in(Role.ADMIN, "ada"))

    stack, scene = runner.run(begin(tmp_path_factory.mktemp("attack")))
    yield scene
    runner.run(stack.aclose())


def on_scene(attack: Callable[..., Awaitable[None]]) -> Callable[..., None]:
    """Run an async test in the loop of the app that all of them attack."""

    @wraps(attack)
    def test(runner: asyncio.Runner, **given: Any) -> None:
        runner.run(attack(**given))  # type: ignore[arg-type]

    signature = inspect.signature(attack)
    runner = inspect.Parameter("runner", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    test.__signature__ = signature.replace(parameters=[runner, *signature.parameters.values()])  # type: ignore[attr-defined]
    return test


@settings(suppress_health_check=[HealthCheck.too_slow], max_examples=settings.default.max_examples // 6)
@given(plausible=PLAUSIBLE, messages=st.lists(MESSAGES, max_size=3))
def test_no_message_of_a_worker_breaks_the_app_or_a_page(
    runner: asyncio.Runner, scene: Scene, plausible: tuple[bytes, ...], messages: list[bytes]
) -> None:
    async def attack() -> None:
        await scene.attack(*plausible, *messages)
        await scene.look_at_everything()

    runner.run(attack())


@given(first=st.one_of(encoded(BATCHES), GARBAGE))
def test_no_first_message_does_either(runner: asyncio.Runner, scene: Scene, first: bytes) -> None:
    async def attack() -> None:
        socket = await scene.serve(HostileSocket([first]))
        assert (socket.sent, socket.is_admitted) == ([], False)

    runner.run(attack())


@pytest.mark.parametrize(("bus", "is_admitted"), [(BUS, True), ("wet-end", False)])
@on_scene
async def test_large_messages_may_follow_a_hello_that_is_accepted(
    scene: Scene, bus: str, is_admitted: bool
) -> None:
    socket = await scene.serve(HostileSocket([encode(hello(uuid4().hex, bus=bus))]))
    assert socket.is_admitted is is_admitted


@pytest.mark.parametrize("decimals", [10, 255, 2**32 - 1])
@on_scene
async def test_decimals_that_no_value_can_have_are_not_believed(scene: Scene, decimals: int) -> None:
    """Ten to the power of #3 did not finish."""
    now = time.time()
    values: list[Update] = [ParameterValue(1, 3, now, decimals), ParameterValue(1, 2, now, 2**32 - 1)]
    await scene.attack(encode(snapshot()), encode(Batch(1, now, [*values, reading(1, 2**32 - 1)])))
    await scene.look_at_everything()


@on_scene
async def test_a_batch_larger_than_any_worker_makes_is_no_message(scene: Scene) -> None:
    many = Batch(1, time.time(), [reading(1)] * (MAX_UPDATES + 1))
    socket = await scene.attack(encode(snapshot()), encode(many))
    assert socket.reason is not None
    assert f"length <= {MAX_UPDATES}" in socket.reason


@on_scene
async def test_a_flood_of_events_is_summed_up(scene: Scene) -> None:
    """Every reading with another mode, run input and e-stop: three events each into a log that is kept."""
    events = scene.house.services[EventLog]
    before = (await events.page(Filter(), 1))[0][0]["id"]
    flips: list[Update] = [
        msgspec.structs.replace(reading(1), outputs=0x40 * (n % 2), inputs=3 * (n % 2))
        for n in range(MAX_UPDATES)
    ]
    batches = [encode(Batch(seq, time.time(), flips)) for seq in range(1, 7)]
    await scene.attack(encode(snapshot()), *batches)
    await scene.house.services.buses[BUS][ChangeRecorder].recorded()
    found, _ = await events.page(Filter(), 1000)
    fresh = [event for event in found if event["id"] > before]
    assert len(fresh) < 100
    summary = next(event for event in fresh if event["kind"] == "estop" and event["message"])
    assert summary["message"].startswith("the last of 29")


@on_scene
async def test_a_token_sends_hello_only_so_often(scene: Scene) -> None:
    workers, credential = scene.house.services[Workers], Credential("busy", BUS, "192.0.2.66")
    sockets = [HostileSocket([b"no hello"]) for _ in range(int(MAX_HELLOS_AT_ONCE) + 5)]
    for socket in sockets:
        await workers.serve(socket, credential)
    assert [socket.reason for socket in sockets].count(TOO_OFTEN) == 5
    other = HostileSocket([b"no hello"])
    await workers.serve(other, Credential("other", BUS, "192.0.2.66"))
    assert other.reason not in (None, TOO_OFTEN)


def test_memory_does_not_grow_with_what_a_worker_sends(tmp_path: Path) -> None:
    async def attack(scene: Scene) -> None:
        frames = [Frame(time.time(), "in", bytes(1024), []) for _ in range(100)]
        batches = (encode(Batch(seq, time.time(), [Frames(frames)])) for seq in range(1, 20))
        await scene.attack(encode(snapshot()), *batches)
        gc.collect()

    async def kept_after_attacks() -> list[int]:
        # A separate app: the recorder of the one above may still be storing what the tests before sent.
        async with complete_app(tmp_path) as house:
            scene = Scene(house, await house.signed_in(Role.ADMIN, "ada"))
            scene.page.trace = ""  # unread, so it would keep some of it
            tracemalloc.start()
            kept = []
            for _ in range(4):
                await attack(scene)
                kept.append(tracemalloc.get_traced_memory()[0])
            return kept

    try:
        kept = asyncio.run(kept_after_attacks())
    finally:
        tracemalloc.stop()
    # An attack whose memory is kept adds some each time; the app reads a part of itself only once.
    assert min(after - before for before, after in pairwise(kept)) < 1_000_000, f"each sent 2 MB: {kept}"
