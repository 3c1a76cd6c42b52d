"""Backups of the server: when one is due, what is kept, and what becomes of one that fails."""

from __future__ import annotations

import asyncio
import os
import tomllib
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import Any, cast
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from app.errors import StoreError
from app.line.conditions.catalogue import backup_is_overdue
from app.people.audit.log import EventLog
from app.settings import load
from app.system.backup.folder import CONTENTS, RETRY_S, name_of, next_after, next_due, time_of, too_many
from app.system.backup.service import Backups, WriteBackup, Written, left_out_of, newest_in
from app.system.backup.settings import BackupSettings
from bus.instants import UnixTime
from bus.messages import Message
from tests.e2e.site import add_people
from tests.for_each import for_each

BERLIN = ZoneInfo("Europe/Berlin")


def moment(text: str) -> UnixTime:
    return UnixTime(datetime.fromisoformat(text).replace(tzinfo=BERLIN).timestamp())


@for_each(
    ("now", "at", "due"),
    [
        ("2026-11-26T02:29:59", "02:30", "2026-11-26T02:30"),
        ("2026-11-26T02:30", "02:30", "2026-11-27T02:30"),
        ("2026-12-31T23:59", "00:00", "2027-01-01T00:00"),
        ("2026-03-28T12:00", "02:30", "2026-03-29T02:30"),  # an hour that this day does not have
        ("2026-10-24T12:00", "02:30", "2026-10-25T02:30"),  # an hour that it has twice
    ],
)
def test_a_backup_is_due_when_the_clock_of_the_site_shows_it(now: str, at: str, due: str) -> None:
    assert next_after(moment(now), at, BERLIN) == moment(due)


@given(st.floats(0, 4e9), st.times().map(lambda time: f"{time:%H:%M}"))
def test_the_next_one_is_within_a_day_and_an_hour(now: float, at: str) -> None:
    due = next_after(UnixTime(now), at, BERLIN)
    assert now < float(due) <= now + 25 * 3600


NOW = moment("2026-11-26T12:00")
YEAR = 365 * 86_400.0


@for_each(
    ("newest", "failed", "due"),
    [
        ("2026-11-26T02:30", None, "2026-11-27T02:30"),
        ("2026-11-25T02:30", None, "2026-11-26T02:30"),
        (None, None, "2026-11-26T12:00"),
        ("2027-11-26T02:30", None, "2026-11-26T12:00"),  # the clock was a year ahead
        (None, "2026-11-26T11:30", "2026-11-26T12:30"),
        ("2026-11-25T02:30", "2026-11-26T11:30", "2026-11-26T12:30"),
        ("2026-11-25T02:30", "2027-11-26T11:30", "2026-11-26T02:30"),
    ],
)
def test_one_is_due_at_once_where_none_is_there_and_an_hour_after_one_that_failed(
    newest: str | None, failed: str | None, due: str
) -> None:
    known, lost = (None if each is None else moment(each) for each in (newest, failed))
    assert next_due(NOW, known, lost, BackupSettings(), BERLIN) == moment(due)


@for_each(
    ("every", "newest", "failed", "due"),
    [
        ("10 min", "2026-11-26T11:55", None, "2026-11-26T12:05"),
        ("10 min", "2026-11-26T02:30", None, "2026-11-26T02:40"),
        ("10 min", None, "2026-11-26T11:55", "2026-11-26T12:05"),
        ("4 h", "2026-11-26T11:00", None, "2026-11-26T15:00"),
        ("4 h", "2026-11-26T07:00", "2026-11-26T11:55", "2026-11-26T12:55"),
        ("4 h", "2027-11-26T11:00", None, "2026-11-26T12:00"),
    ],
)
def test_one_is_due_so_long_after_the_last(
    every: str, newest: str | None, failed: str | None, due: str
) -> None:
    known, lost = (None if each is None else moment(each) for each in (newest, failed))
    assert next_due(NOW, known, lost, BackupSettings(every=every), BERLIN) == moment(due)


def kept(times: Iterable[str], written: str, keep: int = 14) -> list[str]:
    """Of backups of these times those that stay, once that of ``written`` is there."""
    names = {name_of(moment(text)): text for text in (*times, written)}
    return sorted(
        {*names.values()} - {names[name] for name in too_many(names, keep, name_of(moment(written)), BERLIN)}
    )


def test_all_of_two_hours_stay_then_one_per_hour_per_day_and_per_month() -> None:
    ten_minutes = [
        f"2026-11-{day:02}T{hour:02}:{m}0" for day in (24, 25) for hour in range(24) for m in range(6)
    ]
    left = kept(ten_minutes, "2026-11-26T00:00", keep=2)
    assert left[-13:] == [*ten_minutes[-12:], "2026-11-26T00:00"]
    assert left[:-13] == [f"2026-11-25T{hour:02}:50" for hour in range(22)]
    months = [f"2026-{month:02}-{day}T02:30" for month in range(1, 11) for day in (10, 28)]
    assert kept(months, "2026-11-05T02:30", keep=3) == [
        *[f"2026-{month:02}-28T02:30" for month in range(1, 10)],
        "2026-10-10T02:30",
        "2026-10-28T02:30",
        "2026-11-05T02:30",
    ]


def test_other_files_stay_and_archives_of_version_02_go_like_manifests() -> None:
    names = ["notes.json", "lineside.tar", *(f"lineside-2026-11-{day}-023000.tar" for day in (20, 21, 22))]
    written = name_of(moment("2026-11-26T02:30"))
    assert too_many([*names, written], 2, written, BERLIN) == [names[2], names[3]]


def test_what_was_just_written_stays_and_files_of_the_future_go_first() -> None:
    years = [f"{year}-11-26T02:30" for year in (2026, 2027, 2028)]
    assert kept(years, "2026-11-26T02:31") == ["2026-11-26T02:30", "2026-11-26T02:31"]


@given(st.lists(st.integers(0, 4_000_000_000), unique=True, min_size=1), st.integers(1, 9), st.data())
def test_the_one_just_written_is_never_too_many(times: list[int], keep: int, data: st.DataObject) -> None:
    names = [name_of(UnixTime(float(time))) for time in times]
    written = data.draw(st.sampled_from(names))
    gone = too_many(names, keep, written, BERLIN)
    assert written not in gone
    left = [time_of(name) for name in {*names} - {*gone}]
    assert all(time is not None and time <= (time_of(written) or 0) for time in left)


@for_each(
    ("newest", "overdue"),
    [(None, False), (NOW - 3600, False), (NOW - 27 * 3600, True), (NOW + 3600, False), (NOW + YEAR, True)],
)
def test_a_backup_of_a_time_far_away_is_missing(newest: UnixTime | None, overdue: bool) -> None:
    assert backup_is_overdue(newest, NOW) is overdue


class Recorded:
    """An event log that keeps what it is given."""

    def __init__(self) -> None:
        self.codes: list[str] = []
        self.reasons: list[str] = []

    async def record(self, *, what: Message, message: Message | str, **_: Any) -> None:
        self.codes.append(what.code)
        self.reasons.append(str(message))


class Night:
    """Backups whose clock and whose way of writing are the test's."""

    def __init__(self, folder: Path, write: WriteBackup, **settings: Any) -> None:
        self.now, self.events = moment("2026-11-26T02:29"), Recorded()
        self.config = folder / "lineside.toml"
        self.config.write_text("[site]\n")
        os.utime(self.config, (0, float(moment("2026-11-01T12:00"))))
        self.folder = folder / "backups"
        self.folder.mkdir()
        events = cast(EventLog, self.events)
        self.tick_s = 0.0
        """By how much the clock goes on at each look at it."""
        chosen = BackupSettings(folder=self.folder, **settings)
        self.backups = Backups(chosen, self.config, BERLIN, events, write, self._clock)

    def _clock(self) -> UnixTime:
        self.now += self.tick_s
        return self.now


async def write_one() -> Written:
    return "a backup", None


async def fail() -> Written:
    raise StoreError(Message.of("system_error", error="disk is full"))


async def test_one_that_is_written_is_an_event_once_a_day(tmp_path: Path) -> None:
    night = Night(tmp_path, write_one, every="1 h")
    for time in ("26T02:30", "26T03:30", "26T04:30", "27T02:30"):
        night.now = moment(f"2026-11-{time}")
        await night.backups.back_up()
        assert night.backups.newest == night.now
    assert night.events.codes == ["event_backup_written"] * 2


async def test_the_event_names_the_files_that_it_lacks(tmp_path: Path) -> None:
    lacking = {"left_out": ["audit.key", "cert.key"], "events_absent": ["line-2025-01.gz"], "damaged": ["0"]}

    async def write() -> Written:
        return "a backup", left_out_of(lacking)

    night = Night(tmp_path, write)
    await night.backups.back_up()
    assert night.events.reasons == [
        "not in it, as [backup] names no key_file to encrypt them; copy them elsewhere: audit.key, cert.key; "
        "not in it, as they are not in the archive of events; copy them elsewhere: line-2025-01.gz; "
        "1 content in the folder was damaged and is lost for older backups"
    ]
    assert left_out_of({key: [] for key in lacking}) is None


async def test_one_that_fails_is_an_event_with_its_reason_until_one_is_written(tmp_path: Path) -> None:
    night = Night(tmp_path, write_one, every="10 min")
    await night.backups.back_up()
    newest = night.backups.newest
    night.backups._write = fail
    for minute in (40, 50):
        night.now = moment(f"2026-11-26T02:{minute}")
        await night.backups.back_up()
    assert night.backups.newest == newest
    assert night.events.codes == ["event_backup_written", "event_backup_failed"]
    assert "disk is full" in night.events.reasons[-1]
    assert night.backups.missing is False
    night.now = moment("2026-11-26T03:40")
    assert "disk is full" in str(night.backups.missing)
    night.backups._write = write_one
    await night.backups.back_up()
    assert night.events.codes[-1] == "event_backup_written"
    assert night.backups.missing is False


@pytest.mark.parametrize(("settings", "hours"), [({}, 26), ({"every": "10 min"}, 1), ({"every": "4 h"}, 10)])
async def test_backups_are_missing_by_how_often_they_are_to_be(
    tmp_path: Path, settings: dict[str, Any], hours: int
) -> None:
    night = Night(tmp_path, write_one, **settings)
    await night.backups.back_up()
    night.now += hours * 3600.0
    assert night.backups.missing is False
    night.now += 1.0
    assert night.backups.missing is True


def test_without_a_backup_the_configuration_states_since_when_there_is_to_be_one(tmp_path: Path) -> None:
    night = Night(tmp_path, write_one)
    assert night.backups.newest == moment("2026-11-01T12:00")
    assert newest_in(night.folder, night.now, BERLIN) is None


async def looks_at(night: Night, monkeypatch: pytest.MonkeyPatch, *times: str) -> None:
    """Let the backups look at the clock at these times."""
    looked, left, former = asyncio.Event(), iter(times), ""
    night.tick_s = 0.001

    async def sleep(_seconds: float) -> None:
        nonlocal former
        if (now := next(left, None)) is None:
            looked.set()
            await asyncio.Event().wait()
        elif now != former:
            night.now, former = moment(now), now

    monkeypatch.setattr("app.system.backup.service.asyncio.sleep", sleep)
    following = asyncio.create_task(night.backups.follow())
    looking = asyncio.create_task(looked.wait())
    await asyncio.wait((following, looking), return_when=asyncio.FIRST_COMPLETED)
    assert not following.done(), following.exception()
    following.cancel()


@pytest.mark.parametrize(
    ("former", "after", "written"),
    [
        (None, "2026-11-26T02:29:40", 1),
        ("2026-11-25T02:30", "2026-11-26T02:29:40", 0),
        ("2026-11-24T02:30", "2026-11-26T02:29:40", 1),
    ],
)
async def test_it_is_written_at_its_time_and_a_missed_one_is_made_up_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, former: str | None, after: str, written: int
) -> None:
    night = Night(tmp_path, write_one)
    if former is not None:
        (night.folder / name_of(moment(former))).touch()
    await looks_at(night, monkeypatch, after, after, after)
    assert night.events.codes == ["event_backup_written"] * written


async def test_one_that_failed_is_tried_again_each_hour(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    night = Night(tmp_path, fail)
    times = [f"2026-11-26T{time}" for time in ("12:00", "12:30", "12:59", "13:01", "13:02", "14:02")]
    await looks_at(night, monkeypatch, *times)
    assert night.events.codes == ["event_backup_failed"]
    due = night.backups.next_due(night.now)
    assert float(due) == pytest.approx(float(moment("2026-11-26T14:02") + RETRY_S), abs=1)


async def test_a_clock_that_jumps_by_a_year_and_back_ends_no_backups(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    night = Night(tmp_path, write_one)
    times = ("2026-11-26T12:00", "2027-11-26T12:00", "2026-11-26T12:10", "2025-11-26T12:10")
    await looks_at(night, monkeypatch, *times, "2025-11-26T12:11")
    assert night.events.codes == ["event_backup_written"] * 4
    newest = night.backups.newest
    assert newest is not None
    assert float(newest) == pytest.approx(float(moment("2025-11-26T12:10")), abs=1)


async def test_the_command_writes_what_restore_store_takes(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text('[server]\ndata = "./data"\n[backup]\nfolder = "copies"\n')
    await asyncio.to_thread(add_people, config)
    (tmp_path / "copies").mkdir()
    settings, events = load(config), Recorded()
    backups = Backups(settings.backup, config, BERLIN, cast(EventLog, events))
    await backups.back_up()
    assert events.codes == ["event_backup_written"], events.reasons
    [manifest] = (tmp_path / "copies").glob("lineside-2*.json")
    written = [manifest, *(tmp_path / "copies" / CONTENTS).iterdir()]
    assert [path for path in written if path.stat().st_mode & 0o077] == []
    assert events.reasons[0].startswith("not in it, as [backup] names no key_file to encrypt them")
    assert "audit.key" in events.reasons[0]
    (tmp_path / "copies").rename(tmp_path / "not mounted")
    await backups.back_up()
    assert events.codes[-1] == "event_backup_failed"
    assert "mount its disk" in events.reasons[-1]
    assert not (tmp_path / "copies").exists()


def test_a_bad_setting_is_refused() -> None:
    for text in ('at = "24:00"', 'at = "2:30"', "keep = 0", 'every = "0 min"', 'every = "10"', "every = 10"):
        with pytest.raises(ValidationError):
            BackupSettings.model_validate(tomllib.loads(text))
