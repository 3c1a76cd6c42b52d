"""The stream of the line: what its readers get, and its latest events."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.line.live.api.routes import AWAY_S, PIECE_BYTES, RETRY, TICKS_OF_ALL, LineStream, RecentEvents
from app.line.live.bus_live import LiveState
from bus.contract import BusFigures, BusLink, ParameterValue, UnitLink, Update
from tests.app.screens import line, line_view, reading

BUSES = (None, "dry", "wet")


def recent_events(most_bytes: int = 1_000_000) -> RecentEvents:
    return RecentEvents("a1", most_bytes)


def read(text: bytes) -> list[tuple[str, str, dict[str, object]]]:
    """The id, kind and data of each event, by the rules of WHATWG HTML, 9.2.6."""
    events = []
    for block in text.decode().split("\n\n"):
        fields = dict(line.split(": ", 1) for line in block.split("\n") if line)
        if fields:
            events.append((fields["id"], fields["event"], json.loads(fields["data"])))
    return events


@given(st.lists(st.tuples(st.sampled_from(BUSES), st.booleans()), max_size=60), st.sampled_from(BUSES))
def test_a_reader_gets_each_event_of_its_bus_once_or_learns_of_the_gap(
    steps: list[tuple[str | None, bool]], wanted: str | None
) -> None:
    recent = recent_events(400)
    added: list[tuple[int, str | None]] = []
    number, was_read, since_gap = 0, [], 0
    for bus, reads in steps:
        recent.add("change", bus, {"n": len(added)})
        added.append((len(added), bus))
        if not reads:
            continue
        if not recent.has_all_after(number):
            number, was_read, since_gap = recent.newest, [], len(added)
        while number < recent.newest:
            number, text = recent.after(number, wanted)
            was_read += [data["n"] for _, _, data in read(text)]
    seen = [n for n, bus in added[since_gap:] if wanted is None or bus in (None, wanted)]
    assert was_read == seen[: len(was_read)]
    if recent.has_all_after(number):
        rest = b"".join(text for _, text in _pieces(recent, number, wanted))
        assert was_read + [data["n"] for _, _, data in read(rest)] == seen


def _pieces(recent: RecentEvents, number: int, bus: str | None) -> list[tuple[int, bytes]]:
    pieces = []
    while number < recent.newest:
        number, text = recent.after(number, bus)
        pieces.append((number, text))
    return pieces


def test_an_event_is_one_block_whatever_its_text() -> None:
    recent = recent_events()
    recent.add("alarm", "dry", {"reason": "one\n\ndata: two\r\nid: 7\u2028"})
    assert read(recent.after(0, None)[1]) == [
        ("a1-1", "alarm", {"reason": "one\n\ndata: two\r\nid: 7\u2028"})
    ]
    assert recent.after(0, None)[1].count(b"\n") == 4
    assert b"\r" not in recent.after(0, None)[1]


def test_a_piece_is_bounded() -> None:
    recent = recent_events()
    for _ in range(100):
        recent.add("change", None, {"x": "y" * 2000})
    pieces = _pieces(recent, 0, None)
    assert len(pieces) > 2
    assert max(len(text) for _, text in pieces) < PIECE_BYTES + 2100


def test_the_events_kept_are_bounded() -> None:
    recent = recent_events(1000)
    for _ in range(100):
        recent.add("change", None, {"x": "y" * 90})
    assert not recent.has_all_after(85)
    assert recent.has_all_after(95)
    assert recent.has_all_after(100)
    assert not recent.has_all_after(101)


def test_no_client_resumes_before_an_interruption() -> None:
    recent = recent_events()
    recent.add("change", None, {})
    recent.interrupt()
    assert not recent.has_all_after(1)
    assert recent.has_all_after(recent.newest)


@pytest.mark.parametrize(
    ("id_", "number"), [("a1-7", 7), ("b2-7", None), ("7", None), ("", None), ("a1-", None), ("a1-+7", None)]
)
def test_an_id_of_another_run_or_of_no_run_resumes_nothing(id_: str, number: int | None) -> None:
    assert recent_events().number_of(id_) == number


@dataclass
class World:
    """A line whose stream is read. ``now`` is both clocks."""

    live: LiveState = field(default_factory=line)
    blocks: dict[int, str] = field(default_factory=dict)
    now: float = 100.0

    def __post_init__(self) -> None:
        clock = lambda: self.now  # noqa: E731
        self.view = line_view(self.live, self.blocks)
        self.stream = LineStream(self.view, clock, clock)

    def apply(self, *updates: Update) -> None:
        self.live.buses["dry"].apply(updates)

    def shown(self) -> dict[str, Any]:
        """As GET /line."""
        return self.view.line(self.now)


@dataclass
class Program:
    """A client that keeps the line as the stream describes it."""

    line: dict[str, Any] = field(default_factory=dict)
    last_event_id: str = ""
    text: bytes = b""
    ended: bool = False

    async def read(self) -> list[tuple[str, dict[str, Any]]]:
        """Everything that is there now."""
        size = -1
        while size < len(self.text):
            size = len(self.text)
            for _ in range(5):
                await asyncio.sleep(0)
        events, self.text = read(self.text.replace(RETRY, b"")), b""
        for self.last_event_id, kind, data in events:
            self._take(kind, data)
        return [(kind, data) for _, kind, data in events]

    def _take(self, kind: str, data: dict[str, Any]) -> None:
        if kind == "snapshot":
            self.line = data
        elif kind == "change":
            (bus,) = (bus for bus in self.line["buses"] if bus["name"] == data.pop("bus"))
            units = {unit["id"]: unit for unit in bus["units"]}
            (bus if data["unit"] is None else units[data["unit"]]).update(data)


@asynccontextmanager
async def reading_program(
    world: World, bus: str | None = None, before: Program | None = None
) -> AsyncIterator[Program]:
    """``before``: what it goes on from."""
    program = Program(*(before.line, before.last_event_id) if before else ())

    async def collect() -> None:
        async for piece in world.stream.pieces(bus, program.last_event_id):
            program.text += piece
        program.ended = True

    with world.stream.reading():
        task = asyncio.create_task(collect())
        yield program
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


@pytest.fixture(autouse=True, scope="module")
def no_pause() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("app.line.live.api.routes.PAUSE_S", 0.0)
        yield


def settled(shown: dict[str, Any]) -> dict[str, Any]:
    """Without what grows on its own, and in the snapshot alone."""
    shown.pop("time")
    for bus in shown["buses"]:
        bus.pop("unit", None)
        for unit in bus["units"]:
            unit.pop("age_ms", None)
            unit.pop("unit", None)
    return shown


def figures(hz: int) -> BusFigures:
    return BusFigures(100.0, float(hz), 0.1, 0.9, 0.2)


UNITS = st.integers(1, 2)
UPDATES = st.one_of(
    st.builds(lambda unit, raw: reading(unit, actual=raw), UNITS, st.integers(0, 3)),
    st.builds(lambda unit, link: UnitLink(unit, 100.0, link), UNITS, st.sampled_from(("online", "offline"))),
    st.builds(lambda unit, raw: ParameterValue(unit, 3, 100.0, raw), UNITS, st.integers(0, 2)),
    st.builds(figures, st.integers(1, 9)),
    st.builds(lambda link: BusLink(100.0, link), st.sampled_from(("open", "closed"))),
)
STEPS = st.lists(
    st.one_of(UPDATES, st.sampled_from(("read", "tick", "block", "resume", "long"))), max_size=25
)


@given(STEPS)
def test_who_follows_the_stream_has_what_the_line_shows(steps: list[Any]) -> None:
    async def follow() -> None:
        world, program = World(), None
        for part in _parts(steps):
            async with reading_program(world, before=program) as program:
                await program.read()
                for step in part:
                    await take(world, program, step)
                for _ in range(TICKS_OF_ALL):
                    world.stream.tick(with_heartbeat=True)
                await program.read()
                assert settled(program.line | {"time": ""}) == settled(world.shown())

    async def take(world: World, program: Program, step: Any) -> None:
        world.now += 20.0 if step == "long" else 0.5
        if step == "read":
            await program.read()
        elif step == "tick":
            world.stream.tick(with_heartbeat=True)
        elif step == "block":
            world.blocks[1] = f"belt off at {world.now}"
        elif step != "long":
            world.apply(step)

    asyncio.run(follow())


def _parts(steps: list[Any]) -> list[list[Any]]:
    """The steps between one connection and the next."""
    parts: list[list[Any]] = [[]]
    for step in steps:
        if step == "resume":
            parts.append([])
        else:
            parts[-1].append(step)
    return parts


async def test_a_change_names_what_has_changed_and_nothing_else() -> None:
    world = World()
    async with reading_program(world) as program:
        assert [kind for kind, _ in await program.read()] == ["snapshot"]
        world.apply(reading(2, actual=1201))
        ((kind, change),) = await program.read()
        assert kind == "change"
        assert change["unit"] == 2
        assert (change["actual"], change["actual_raw"]) == ("120.1", 1201)
        assert set(change) == {"unit", "actual", "actual_raw", "deviation", "deviation_raw", "draw"}


async def test_who_was_away_for_a_moment_gets_what_was_missed_and_no_snapshot() -> None:
    world = World()
    async with reading_program(world) as program:
        await program.read()
    world.apply(reading(1, actual=1300))
    async with reading_program(world, before=program) as again:
        assert [kind for kind, _ in await again.read()] == ["change"]
        assert again.line["buses"][0]["units"][0]["actual_raw"] == 1300


async def test_who_was_away_for_long_gets_a_snapshot() -> None:
    world = World()
    async with reading_program(world) as program:
        await program.read()
    world.now += AWAY_S + 1
    world.stream.tick(with_heartbeat=False)
    world.apply(reading(1, actual=1300))
    async with reading_program(world, before=program) as again:
        assert [kind for kind, _ in await again.read()] == ["snapshot"]


async def test_nothing_is_noted_while_no_one_reads() -> None:
    world = World()
    world.stream.add("alarm", None, lambda: pytest.fail("no one reads"))
    world.apply(reading(1, actual=1300))
    world.stream.tick(with_heartbeat=True)
    async with reading_program(world) as program:
        assert [kind for kind, _ in await program.read()] == ["snapshot"]


async def test_who_reads_too_slowly_gets_a_snapshot_in_place_of_a_queue(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("app.line.live.api.routes.MAX_BYTES", 2000)
    world = World()
    pieces = world.stream.pieces(None)
    with world.stream.reading():
        assert await anext(pieces) == RETRY
        first = await anext(pieces)
        for step in range(2_000):
            world.apply(reading(1, actual=step % 7))
        world.now += 5
        assert read(first)[0][1] == "snapshot"
        ((_, kind, shown),) = read(await anext(pieces))
    assert kind == "snapshot"
    assert shown["buses"][0]["units"][0]["actual_raw"] == 1_999 % 7
    await pieces.aclose()


async def test_a_bus_has_its_own_and_those_of_the_site() -> None:
    world = World()
    async with reading_program(world, "dry") as program:
        await program.read()
        for bus in ("dry", "wet", None):
            world.stream.add("alarm", bus, lambda bus=bus: {"bus": bus})
        assert [data["bus"] for _, data in await program.read()] == ["dry", None]


async def test_a_heartbeat_comes_while_nothing_changes() -> None:
    world = World()
    async with reading_program(world) as program:
        await program.read()
        world.stream.tick(with_heartbeat=True)
        assert await program.read() == [("heartbeat", {"time": "1970-01-01T00:01:40.000+00:00"})]


async def test_a_response_that_is_overdue_is_a_change_without_a_report() -> None:
    world = World()
    async with reading_program(world) as program:
        await program.read()
        world.now += 5.0
        for _ in range(TICKS_OF_ALL):
            world.stream.tick(with_heartbeat=False)
        changes = [data for _, data in await program.read()]
    assert [(change["unit"], change["link"]) for change in changes] == [(1, "stale"), (2, "stale")]


async def test_it_ends_with_the_server() -> None:
    world = World()
    async with reading_program(world) as program:
        await program.read()
        world.stream.end()
        await program.read()
        assert program.ended
