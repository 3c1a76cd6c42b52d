"""Attacks on entries that are logged on the server's disk while the database is away."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator
from contextlib import closing
from itertools import count
from pathlib import Path

import pytest

from app.audit.events.store import Filter
from app.audit.local_log.file import FILE, LocalFile
from app.audit.local_log.transaction import LoggedTransaction, sealed_line
from app.audit.log import EventLog
from app.audit.proof.keyring import KEY_BYTES, KeyRing
from app.audit.proof.keys import Keys
from app.errors import StoreError
from bus.messages import Message
from tests.app.away_store import KEYS, AwayDatabase, event_log

OTHER_SITE = Keys(KeyRing((b"o" * KEY_BYTES,)))
WORDS = [f"genuine {number}" for number in range(3)]


@pytest.fixture
def away(tmp_path: Path) -> Iterator[AwayDatabase]:
    with closing(AwayDatabase(tmp_path / "store.db")) as database:
        yield database


async def logged(away: AwayDatabase, folder: Path, keys: Keys = KEYS) -> bytes:
    """What a server that was killed has left of three events."""
    events = event_log(away, folder, keys=keys)
    away.leave()
    for what in WORDS:
        await events.record(kind="server", what=what, locally=True)
    away.is_away = False
    assert away.availability is not None
    away.availability.away_since = None
    return (folder / FILE).read_bytes()


async def started(away: AwayDatabase, folder: Path) -> EventLog:
    """The next server."""
    events = event_log(away, folder)
    assert events.local is not None
    await events.local.load()
    return events


async def texts(events: EventLog, kind: str = "server") -> list[str]:
    return [event["what"] for event in (await events.page(Filter(kind=kind), 100))[0]][::-1]


def put_aside(folder: Path) -> list[Path]:
    return [*folder.glob(f"{FILE}.not-followed-*")]


def changed(lines: list[bytes]) -> list[bytes]:
    return [lines[0], lines[1].replace(b"genuine 1", b"forgery 1"), lines[2]]


def left_out(lines: list[bytes]) -> list[bytes]:
    return [lines[0], lines[2]]


def swapped(lines: list[bytes]) -> list[bytes]:
    return [lines[0], lines[2], lines[1]]


def repeated(lines: list[bytes]) -> list[bytes]:
    return [lines[0], lines[0]]


def made_up(lines: list[bytes]) -> list[bytes]:
    forged, _ = sealed_line(LoggedTransaction("0" * 32, 1.0), "0" * 64, OTHER_SITE.ring)
    return [lines[0], forged]


def no_log(lines: list[bytes]) -> list[bytes]:
    return [lines[0], b"\xff\x00\n"]


@pytest.mark.parametrize("forge", [changed, left_out, swapped, repeated, made_up, no_log])
async def test_a_forgery_is_not_believed_and_kept_as_evidence(
    away: AwayDatabase, tmp_path: Path, forge: Callable[[list[bytes]], list[bytes]]
) -> None:
    lines = (await logged(away, tmp_path)).splitlines(keepends=True)
    forged = b"".join(forge(lines))
    (tmp_path / FILE).write_bytes(forged)
    events = await started(away, tmp_path)
    assert await texts(events) == WORDS[:1], "up to the fault it is genuine"
    [aside] = put_aside(tmp_path)
    assert aside.read_bytes() == forged
    [_, refused] = (await events.page(Filter(kind="audit"), 10))[0][::-1]
    assert refused["messages"]["what"] == Message.of("event_local_log_refused", n=1, file=aside.name)
    assert (await events.proof.verify({})).fault is None


async def test_the_log_of_another_site_is_refused(away: AwayDatabase, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (tmp_path / FILE).write_bytes(await logged(away, other, OTHER_SITE))
    events = await started(away, tmp_path)
    assert await texts(events) == []
    [event] = (await events.page(Filter(kind="audit"), 10))[0]
    assert "another site" in event["message"]


async def test_a_log_that_is_put_back_adds_nothing(away: AwayDatabase, tmp_path: Path) -> None:
    genuine = await logged(away, tmp_path)
    await started(away, tmp_path)
    assert not (tmp_path / FILE).exists()
    (tmp_path / FILE).write_bytes(genuine)
    assert await texts(await started(away, tmp_path)) == WORDS


async def test_a_link_in_its_place_is_not_followed(away: AwayDatabase, tmp_path: Path) -> None:
    (tmp_path / "passwords").write_text("root")
    (tmp_path / FILE).symlink_to(tmp_path / "passwords")
    with pytest.raises(StoreError):
        await started(away, tmp_path)
    with pytest.raises(StoreError):
        LocalFile(tmp_path).append(LoggedTransaction("0" * 32, 1.0), KEYS.ring, is_urgent=True)
    assert (tmp_path / "passwords").read_text() == "root"


async def flooded(write: Callable[[], Awaitable[object]]) -> int:
    """Write until there is no room; how often there was."""
    for number in count():
        try:
            await write()
        except StoreError as error:
            return number if "has reached" in str(error) else -1
    raise AssertionError


async def test_a_flood_leaves_room_for_what_stops_a_line(away: AwayDatabase, tmp_path: Path) -> None:
    events = event_log(away, tmp_path, max_bytes=20_000)
    away.leave()
    written = await flooded(lambda: events.record(kind="server", what="flood", locally=True))
    for _ in range(3):
        [intent] = await events.intend_together([{"what": "stop"}], locally=True)
        await events.conclude(intent, "verified")
    await flooded(lambda: events.intend_together([{"what": "stop"}], locally=True))
    assert (tmp_path / FILE).stat().st_size <= 20_000
    await away.come_back()
    assert await texts(events) == ["flood"] * written
    assert (await texts(events, "command"))[:3] == ["stop"] * 3


async def test_a_disk_that_fails_leaves_no_half_line(
    away: AwayDatabase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    events = event_log(away, tmp_path)
    away.leave()
    await events.record(kind="server", what="before", locally=True)

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("app.audit.local_log.file.os.fdatasync", full)
        with pytest.raises(StoreError, match="No space left"):
            await events.record(kind="server", what="lost", locally=True)
    await events.record(kind="server", what="after", locally=True)
    away.is_away = False
    away.availability.away_since = None  # type: ignore[union-attr]
    assert await texts(await started(away, tmp_path)) == ["before", "after"]
