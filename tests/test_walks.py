"""The two walks of docs/architecture.md, one reading and one click, are what the code does."""

from __future__ import annotations

import asyncio
import importlib
import re
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import chain
from pathlib import Path
from types import FrameType
from typing import Any, cast

import pytest
from websockets.asyncio.client import ClientConnection

from app.core.web.access import Role
from app.core.web.routes import GuardedRoute
from app.line.feed.bus_feed import BusFeed
from app.line.feed.channel import Channel
from app.line.feed.ingest import FeedQuota, Ingest, IngestPosition
from app.line.live.browser import Browser
from app.line.live.hub import Hub
from app.line.pipeline import Pipeline
from bus.contract import AppMessage, Batch, Command, Result, SetSpeed, Update, encode
from bus.worker.outbox import Outbox
from bus.worker.uplink import Uplink
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import hello, reading, snapshot
from tests.bus.virtual_line import VirtualLine, run
from tests.test_architecture import ROOT, text_of

PAGE = text_of(ROOT / "docs" / "architecture.md")
READING, CLICK = "## A reading becomes a pixel", "## A click becomes a byte"
BUS, UNIT = "dry-end", 1
MAX_STATIONS = {READING: 15, CLICK: 12}
MIN_CALLS, MAX_CALLS = 15, 25


def section(heading: str) -> str:
    """The text below a heading, up to the next of its level."""
    return PAGE.partition(f"{heading}\n")[2].partition("\n## ")[0]


def stations(heading: str) -> list[str]:
    """The stations of a walk, in order."""
    return re.findall(r"^\| \d+ \| `([\w./]+)`", section(heading), re.M)


def named(text: str) -> list[str]:
    """Each file, and each function by the path of its module."""
    return sorted(set(re.findall(r"`((?:app|bus|static)[./][\w./]+)`", text)))


class Calls:
    """The functions of app and bus in the order in which each was first called or went on after an
    ``await``, and how often each was called."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def note(self, frame: FrameType, event: str, _argument: Any) -> None:
        module = frame.f_globals.get("__name__", "")
        if event == "call" and module.partition(".")[0] in ("app", "bus"):
            self.counts[f"{module}.{frame.f_code.co_qualname}"] += _begins(frame)

    @contextmanager
    def watched(self) -> Iterator[None]:
        sys.setprofile(self.note)
        try:
            yield
        finally:
            sys.setprofile(None)

    def of(self, names: Sequence[str]) -> list[str]:
        """Those of ``names`` that were called, in the order of their calls."""
        return [name for name in self.counts if name in names]


def _begins(frame: FrameType) -> bool:
    """Whether a function begins, and does not go on after an ``await``: the argument of RESUME tells."""
    return frame.f_code.co_code[frame.f_lasti + 1] == 0


class PlayedConnection:
    """A worker's connection: what the app sends is kept, and a command gets its result."""

    def __init__(self) -> None:
        self.ingest: Ingest | None = None
        self.command: Command | None = None
        self.seq = 0

    async def send(self, message: AppMessage) -> None:
        if isinstance(message, Command):
            self.command = message
            await self.report(Result(message.id, time.time(), "verified"))

    async def report(self, *updates: Update) -> None:
        assert self.ingest is not None
        self.seq += 1
        await self.ingest.receive(encode(Batch(self.seq, time.time(), list(updates), live=True)))


async def connected(house: House) -> PlayedConnection:
    bus, connection = house.services.buses[BUS], PlayedConnection()
    followed = (FeedQuota(), bus[BusFeed].coverage)
    connection.ingest = Ingest(
        hello(), IngestPosition("w1"), bus[Channel], bus[Pipeline], connection, *followed
    )
    await connection.ingest.receive(encode(snapshot()))
    return connection


class PlayedSocket:
    """The worker's end of the WebSocket to the app."""

    def __init__(self) -> None:
        self.is_used = asyncio.Event()

    async def send(self, _message: bytes) -> None:
        self.is_used.set()


def worker_calls_of_a_reading(calls: Calls) -> None:
    """From the bytes of a response to the batch on the socket."""

    async def scene(line: VirtualLine) -> None:
        put = partial(Outbox.put, line.worker.outbox)
        line.worker.outbox.put = put  # type: ignore[method-assign]
        await line.until(lambda: len(line.worker.outbox) > 2)
        before, socket = len(line.worker.outbox), PlayedSocket()
        worker = line.worker
        uplink = Uplink(["ws://app"], "", worker.outbox, worker, worker.app_clock, time.time)
        with calls.watched():
            await line.until(lambda: len(worker.outbox) > before)
            sending = asyncio.create_task(uplink._send(cast(ClientConnection, socket)))
            await line.until(socket.is_used.is_set)
        sending.cancel()

    run(scene, 2)


def worker_calls_of_a_click(calls: Calls) -> None:
    """From the command of the app to the request on the wire."""

    async def scene(line: VirtualLine) -> None:
        await line.until(lambda: all(line.readings(unit) for unit in line.units))
        with calls.watched():
            await line.perform(SetSpeed(UNIT, 1234))

    run(scene, 2)


async def app_calls_of_a_reading(house: House, connection: PlayedConnection, calls: Calls) -> None:
    """From the message of the worker to the slot of a page."""
    house.services[Hub].join(Browser("anna", "viewer", "en"))
    with calls.watched():
        await connection.report(reading(UNIT, 1234))


async def app_calls_of_a_click(house: House, calls: Calls) -> None:
    """From the POST of the page to the command for the worker."""
    client = await house.signed_in(Role.OPERATOR)
    form = {"raw": "1500", "was": "1000", "how": "now", "id": "0" * 32, "reviewed_at": str(time.time())}
    form["scale"] = "-"
    with calls.watched():
        page = await client.post(f"/units/{BUS}/{UNIT}/speed", data=form)
    assert page.status_code == 200, page.text


@pytest.mark.parametrize("name", named(section(READING) + section(CLICK)))
def test_what_the_walks_name_exists(name: str) -> None:
    if name.endswith((".py", ".js")):
        assert (ROOT / name).is_file()
        return
    if name.startswith("static/"):
        path, _, function = name.rpartition(".")
        source = text_of(ROOT / f"{path}.js")
        assert re.search(rf"\bfunction {function}\(", source)
        return
    parts = name.split(".")
    depth = max(n for n in range(len(parts)) if ROOT.joinpath(*parts[:n]).with_suffix(".py").is_file())
    found: Any = importlib.import_module(".".join(parts[:depth]))
    for part in parts[depth:]:
        found = getattr(found, part)
    assert callable(found)


async def test_the_walk_of_a_click_names_the_middleware_it_passes(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        route = next(route for route in house.app.routes if getattr(route, "name", "") == "set_speed")
        passed: list[Any] = [middleware.cls for middleware in house.app.user_middleware]
        passed.append(type(cast(GuardedRoute, route).guard))
    assert re.findall(
        r"`([\w.]+)`", section(CLICK).partition("Every request passes")[2].partition("\n\n")[0]
    ) == [f"{each.__module__}.{each.__qualname__}" for each in passed]


@pytest.mark.parametrize("heading", [READING, CLICK])
def test_a_walk_is_short(heading: str) -> None:
    walk = stations(heading)
    assert len(walk) == len(set(walk)) == len(re.findall(r"^\| \d+ \|", section(heading), re.M))
    assert 5 < len(walk) <= MAX_STATIONS[heading]


async def test_a_reading_takes_the_walk(tmp_path: Path) -> None:
    calls = Calls()
    await asyncio.to_thread(worker_calls_of_a_reading, calls)
    async with complete_app(tmp_path) as house:
        await app_calls_of_a_reading(house, await connected(house), calls)
    walk = [name for name in stations(READING) if not name.startswith("static/")]
    assert calls.of(walk) == walk


async def test_browsers_learn_of_a_reading_before_what_judges_and_stores_it(tmp_path: Path) -> None:
    """The order that `app.line.pipeline` states."""
    calls = Calls()
    async with complete_app(tmp_path) as house:
        await app_calls_of_a_reading(house, await connected(house), calls)
    learning = [
        "app.line.live.hub.Hub._on_updates",
        "app.line.live.browser.Browser.send_diff",
        "app.line.live.api.routes.LineStream._on_updates",
        "app.engineering.sets.drift.BusDrift._see",
        "app.line.alarms.bus_alarms.BusAlarms._see",
        "app.line.history.service.History.append",
        "app.line.live.change_recorder.ChangeDetector.detect",
    ]
    assert calls.of(learning) == learning


async def test_a_write_requires_its_role_its_key_and_its_turn_once(tmp_path: Path) -> None:
    calls = Calls()
    async with complete_app(tmp_path) as house:
        await connected(house)
        await app_calls_of_a_click(house, calls)
    required_once = [
        "app.line.commands.service.CommandService.look_up",
        "app.line.commands.record.CommandRecord.look_up",
        "app.line.commands.service.RequiresWrite.grant",
        "app.line.commands.service.CommandService.reserve",
        "app.line.commands.control.Control.use",
    ]
    assert [calls.counts[name] for name in required_once] == [1] * len(required_once)


async def test_a_click_takes_the_walk(tmp_path: Path) -> None:
    calls = Calls()
    async with complete_app(tmp_path) as house:
        connection = await connected(house)
        await app_calls_of_a_click(house, calls)
        assert connection.command is not None
    await asyncio.to_thread(worker_calls_of_a_click, calls)
    walk = [name for name in stations(CLICK) if not name.startswith("static/")]
    assert calls.of(walk) == walk


class OpenCalls(Calls):
    """The calls that have begun and not ended when a function is called: on its own stack, and in the tasks
    of commands, which wait for it. ``of``: how the names of their modules begin."""

    def __init__(self, at: str, *of: str) -> None:
        super().__init__()
        self._at = at
        self._of = of
        self.open: set[str] = set()

    def note(self, frame: FrameType, event: str, argument: Any) -> None:
        super().note(frame, event, argument)
        if not self.open and event == "call" and name_of(frame) == self._at:
            tasks = [[*map(name_of, awaiting(task))] for task in asyncio.all_tasks()]
            of_commands = [names for names in tasks if any(".commands." in name for name in names)]
            names = chain(map(name_of, callers(frame)), *of_commands)
            self.open = {name for name in names if name.startswith(self._of)}


def name_of(frame: FrameType) -> str:
    return f"{frame.f_globals.get('__name__', '')}.{frame.f_code.co_qualname}"


def callers(frame: FrameType | None) -> Iterator[FrameType]:
    while frame is not None:
        yield frame
        frame = frame.f_back


def awaiting(task: asyncio.Task[Any]) -> Iterator[FrameType]:
    coroutine: Any = task.get_coro()
    while (frame := getattr(coroutine, "cr_frame", None)) is not None:
        yield frame
        coroutine = coroutine.cr_await


async def test_a_click_takes_few_calls(tmp_path: Path) -> None:
    """From the middleware to the request on the wire, each within the one before or sent by it."""
    in_app = OpenCalls("app.line.feed.channel.Channel.send", "app.")
    async with complete_app(tmp_path) as house:
        await connected(house)
        await app_calls_of_a_click(house, in_app)
    to_line = OpenCalls("bus.line.line_loop.LineLoop.submit", "bus.")
    await asyncio.to_thread(worker_calls_of_a_click, to_line)
    loop = ("bus.line.line_loop.", "bus.line.arbiter.", "bus.line.commands.")
    on_line = OpenCalls("bus.line.commands.procedure.CommandRun.next_request", *loop)
    await asyncio.to_thread(worker_calls_of_a_click, on_line)
    calls = [*in_app.open, *to_line.open, *on_line.open]
    assert MIN_CALLS < len(calls) <= MAX_CALLS, calls
