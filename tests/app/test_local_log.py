"""Entries of the time without the database come into the audit log in order, once, also after a kill."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import closing, suppress
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.audit.events.store import Filter
from app.audit.local_log.file import LocalFile
from app.audit.local_log.transaction import LoggedEvent, LoggedTransaction
from app.audit.local_log.writing import forget_old
from app.audit.log import EventLog
from app.database import SqliteDatabase
from app.errors import StoreError, StoreUnavailableError
from bus.instants import unix_now
from bus.messages import Message
from tests.app.away_store import KEYS, AwayDatabase, event_log
from tests.app.stage import until


@pytest.fixture
def away(tmp_path: Path) -> Iterator[AwayDatabase]:
    with closing(AwayDatabase(tmp_path / "store.db")) as database:
        yield database


@pytest.fixture
def events(away: AwayDatabase, tmp_path: Path) -> EventLog:
    return event_log(away, tmp_path)


async def stored(events: EventLog, kind: str = "server") -> list[dict[str, Any]]:
    return (await events.page(Filter(kind=kind), 1000))[0][::-1]


async def log_event(events: EventLog, what: str) -> Any:
    return await events.record(kind="server", what=what, locally=True)


async def test_entries_follow_in_order_and_state_both_times(away: AwayDatabase, events: EventLog) -> None:
    await log_event(events, "before")
    away.leave()
    for number in range(3):
        assert isinstance(await log_event(events, f"while away {number}"), LoggedEvent)
    with pytest.raises(StoreUnavailableError):
        await events.record(kind="server", what="not locally")
    await away.come_back()
    await log_event(events, "after")
    found = await stored(events)
    assert [event["what"] for event in found] == [
        "before",
        *(f"while away {number}" for number in range(3)),
        "after",
    ]
    assert [event["entered_at"] is not None for event in found] == [False, True, True, True, False]
    assert all(event["time"] <= event["entered_at"] for event in found[1:4])
    assert (await events.proof.verify({})).fault is None
    [note] = await stored(events, "audit")
    assert note["messages"]["what"] == Message.of("event_local_log_followed", n=3)
    assert events.local is not None
    assert not events.local.is_needed


async def test_a_commit_whose_confirmation_is_lost_is_stored_once(
    away: AwayDatabase, events: EventLog
) -> None:
    away.loses_commit = True
    await log_event(events, "unconfirmed")
    assert away.availability is not None
    assert away.availability.is_away
    await away.come_back()
    assert [event["what"] for event in await stored(events)] == ["unconfirmed"]


async def test_references_of_direct_transactions_are_forgotten(
    away: AwayDatabase, events: EventLog, monkeypatch: pytest.MonkeyPatch
) -> None:
    await log_event(events, "direct")
    away.leave()
    await log_event(events, "late")
    await away.come_back()
    monkeypatch.setattr("app.audit.local_log.writing.MAX_AGE_S", -1.0)
    await away.write(lambda connection: forget_old(connection, unix_now()))
    query = "SELECT count(*) FROM local_transaction WHERE entered_at IS NULL"
    assert await away.read(lambda connection: connection.execute(query).fetchone()[0]) == 0
    query = "SELECT count(*) FROM local_transaction"
    assert await away.read(lambda connection: connection.execute(query).fetchone()[0]) == 1


async def test_subscribers_learn_of_what_has_followed(away: AwayDatabase, events: EventLog) -> None:
    seen: list[tuple[str, str | None]] = []
    events.subscribe(lambda event: seen.append((event["what"], event["outcome"])))
    away.leave()
    [intent] = await events.intend_together([{"what": "stop"}], locally=True)
    await events.conclude(intent, "verified")
    assert seen == []
    await away.come_back()
    assert seen == [("stop", None), ("stop", "verified")]


async def test_an_outcome_finds_its_intent_wherever_that_is(away: AwayDatabase, events: EventLog) -> None:
    [direct] = await events.intend_together([{"what": "direct"}])
    away.leave()
    [local] = await events.intend_together([{"what": "local"}], locally=True)
    await events.conclude(direct, "verified")
    await away.come_back()
    await events.conclude(local, "refused")
    found = {event["what"]: event["outcome"] for event in await stored(events, "command")}
    assert found == {"direct": "verified", "local": "refused"}
    assert await events.close_open_intents(None) == 0


async def test_an_outcome_that_comes_after_another_is_a_remark_on_its_unit(
    away: AwayDatabase, events: EventLog, tmp_path: Path
) -> None:
    [intent] = await events.intend_together([{"what": "stop", "bus": "dry-end", "unit": 3}])
    away.leave()
    await events.conclude(intent, "verified")
    with closing(SqliteDatabase(tmp_path / "store.db")) as other:
        assert await EventLog(other, keys=KEYS).close_open_intents("dry-end") == 1
    await away.come_back()
    [command] = await stored(events, "command")
    assert command["outcome"] == "unverified"
    [remark, _followed] = await stored(events, "audit")
    late = Message.of("event_outcome_came_late", event=command["id"], outcome="verified")
    assert (remark["messages"]["what"], remark["bus"], remark["unit"]) == (late, "dry-end", 3)
    assert (await events.proof.verify({})).fault is None


async def test_an_unconfirmed_intent_that_was_not_sent_ends_as_not_sent(
    away: AwayDatabase, events: EventLog
) -> None:
    away.loses_commit = True
    with pytest.raises(StoreUnavailableError):
        await events.intend_together([{"what": "faster"}])
    await away.come_back()
    [event] = await stored(events, "command")
    assert (event["what"], event["outcome"]) == ("faster", "not_sent")


async def test_an_intent_that_never_arrived_leaves_nothing(away: AwayDatabase, events: EventLog) -> None:
    away.is_away = True
    with pytest.raises(StoreUnavailableError):
        await events.intend_together([{"what": "faster"}])
    await away.come_back()
    assert await stored(events, "command") == []


async def test_waiting_ends_when_the_database_hangs(away: AwayDatabase, events: EventLog) -> None:
    away.responds.clear()
    assert away.availability is not None
    watch = asyncio.create_task(away.availability.watch(away.probe))
    try:
        async with asyncio.timeout(8):
            await log_event(events, "while it hangs")
        assert away.availability.is_away
        away.responds.set()
        await until(lambda: not away.availability.is_away, "the database noticed")  # type: ignore[union-attr]
        assert [event["what"] for event in await stored(events)] == ["while it hangs"]
    finally:
        away.responds.set()
        watch.cancel()


class KilledError(BaseException):
    """The server is gone."""


class Fragile:
    """A server that is killed at a chosen step; every write of a file or of the database is two steps."""

    def __init__(self, away: AwayDatabase, folder: Path, survives: int) -> None:
        self.events = event_log(away, folder)
        self._left = survives
        self._append, self._attempt, self._write = LocalFile.append, away.attempt, away.write
        self._clear = LocalFile.clear

    def step(self) -> None:
        self._left -= 1
        if self._left < 0:
            raise KilledError

    def patch(self, away: AwayDatabase, monkeypatch: pytest.MonkeyPatch) -> None:
        def append(file: LocalFile, transaction: LoggedTransaction, *rest: Any, **options: Any) -> None:
            self.step()
            self._append(file, transaction, *rest, **options)
            self.step()

        def clear(file: LocalFile) -> None:
            self.step()
            self._clear(file)
            self.step()

        def doing(work: Any) -> Any:
            async def run(*args: Any) -> Any:
                self.step()
                result = await work(*args)
                self.step()
                return result

            return run

        monkeypatch.setattr(LocalFile, "append", append)
        monkeypatch.setattr(LocalFile, "clear", clear)
        monkeypatch.setattr(away, "attempt", doing(self._attempt))
        monkeypatch.setattr(away, "write", doing(self._write))


_names = count()
OPS = st.lists(st.sampled_from(["log", "log", "log", "leave", "back", "lose", "tear"]), max_size=12)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lives=st.lists(st.tuples(OPS, st.integers(0, 30)), min_size=1, max_size=4))
def test_killed_at_any_moment_nothing_is_lost_or_doubled(
    away: AwayDatabase, tmp_path: Path, lives: list[tuple[list[str], int]]
) -> None:
    folder = tmp_path / f"site-{next(_names)}"
    folder.mkdir()
    logged, confirmed = asyncio.run(_live(away, folder, lives))
    found = asyncio.run(_end(away, folder))
    ours = [what for what in found if what in set(logged)]
    assert len(ours) == len(set(ours)), "doubled"
    assert set(confirmed) <= set(ours), "lost"
    assert ours == [what for what in logged if what in set(ours)], "out of order"


async def _live(
    away: AwayDatabase, folder: Path, lives: list[tuple[list[str], int]]
) -> tuple[list[str], list[str]]:
    logged: list[str] = []
    confirmed: list[str] = []
    for ops, survives in lives:
        away.is_away = False
        away.availability.__init__()  # type: ignore[misc]
        server = Fragile(away, folder, survives)
        with pytest.MonkeyPatch.context() as monkeypatch:
            server.patch(away, monkeypatch)
            with suppress(KilledError, StoreError):
                await server.events.local.load()  # type: ignore[union-attr]
                for op in ops:
                    await _do(op, away, server, folder, logged, confirmed)
    return logged, confirmed


async def _do(
    op: str, away: AwayDatabase, server: Fragile, folder: Path, logged: list[str], confirmed: list[str]
) -> None:
    match op:
        case "log":
            logged.append(f"{folder.name} {len(logged)}")
            await log_event(server.events, logged[-1])
            confirmed.append(logged[-1])
        case "leave":
            away.leave()
        case "back":
            if away.is_away:
                await away.come_back()
        case "lose":
            away.loses_commit = not away.is_away
        case "tear":
            # The machine failed in the middle of a line, before anything was sent.
            with (folder / "local-log").open("ab") as file:
                file.write(b"0123456789abcdef 00ff")
            raise KilledError


async def _end(away: AwayDatabase, folder: Path) -> list[str]:
    away.is_away = away.loses_commit = False
    away.availability.__init__()  # type: ignore[misc]
    events = event_log(away, folder)
    assert events.local is not None
    await events.local.load()
    assert not (folder / "local-log").exists()
    assert (await events.proof.verify({})).fault is None
    return [event["what"] for event in await stored(events)]


def test_a_torn_line_is_cut_off_before_the_next(tmp_path: Path) -> None:
    file = LocalFile(tmp_path)
    first, second = (LoggedTransaction(f"{number:032x}", 1.0) for number in (1, 2))
    file.append(first, KEYS.ring, is_urgent=True)
    with file.path.open("ab") as torn:
        torn.write(b"0123456789abcdef 00ff")
    again = LocalFile(tmp_path)
    found = again.read(KEYS.ring)
    assert (found.transactions, found.fault) == ([first], None)
    again.append(second, KEYS.ring, is_urgent=True)
    assert LocalFile(tmp_path).read(KEYS.ring).transactions == [first, second]


async def test_a_log_that_is_cut_off_is_followed_as_far_as_it_goes(
    away: AwayDatabase, events: EventLog, tmp_path: Path
) -> None:
    away.leave()
    for number in range(3):
        await log_event(events, f"while away {number}")
    away.is_away = False
    away.availability.__init__()  # type: ignore[misc]
    log = tmp_path / "local-log"
    log.write_bytes(log.read_bytes()[:-5])
    next_server = event_log(away, tmp_path)
    assert next_server.local is not None
    await next_server.local.load()
    assert [event["what"] for event in await stored(next_server)] == ["while away 0", "while away 1"]
    notes = [event["messages"]["what"] for event in await stored(next_server, "audit")]
    assert Message.of("event_local_log_cut_off", n=2) in notes
    await next_server.local.load()
    assert len(await stored(next_server, "audit")) == len(notes), "it is reported once"
