"""Writes a backup each night, in another process, which gives way to all others."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import structlog

from app.audit.log import EventLog
from app.backup.schedule import NAME, name_of, next_due, too_many
from app.backup.settings import BackupSettings
from app.errors import system_error
from bus.errors import LinesideError
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message, joined

LOOK_S = 30.0
"""How often the clock is looked at: one that is set moves the next backup."""
NICE = 15
log = structlog.get_logger()
WriteBackup = Callable[[Path], Awaitable[Message | None]]


class BackupError(LinesideError):
    """A backup could not be written."""


class Backups:
    """The backups of one server. ``write`` makes one file, verifies it, and returns what
    is not in it."""

    def __init__(
        self,
        settings: BackupSettings,
        config: Path | None,
        zone: ZoneInfo,
        events: EventLog,
        write: WriteBackup | None = None,
        clock: Clock = unix_now,
    ) -> None:
        self._folder, self._keep, self._at = settings.folder or Path(), settings.keep, settings.at
        self._config, self._zone, self._events = config, zone, events
        self._write = write or self._by_command
        self._clock = clock
        self._is_wanted = settings.folder is not None
        self._since = _last_change(config) or clock()
        self._written: UnixTime | None = None
        self._failed: UnixTime | None = None

    @property
    def newest(self) -> UnixTime | None:
        """When the newest backup was begun; while there is none, when the configuration that requests it was
        last changed. None: there are to be none."""
        return (self._written or self._since) if self._is_wanted else None

    def next_due(self, now: UnixTime) -> UnixTime:
        """When the next backup is due; not after ``now`` where it is to begin."""
        return next_due(now, self._written, self._failed, self._at, self._zone)

    async def follow(self) -> None:
        """Write a backup whenever one is due, without end: at once where there is none, or that of last night
        is missing; an hour later where one failed."""
        self._written = await asyncio.to_thread(newest_in, self._folder, self._clock())
        while True:
            await asyncio.sleep(LOOK_S)
            now = self._clock()
            if now >= self.next_due(now):
                await self.back_up()

    async def back_up(self) -> None:
        """Write one now; its result is an event."""
        begun = self._clock()
        file = self._folder / name_of(begun, self._zone)
        try:
            await asyncio.to_thread(self._prepare)
            left_out = await self._write(file)
            await asyncio.to_thread(self._remove_older, file)
        except (LinesideError, OSError) as error:
            reason = error.message if isinstance(error, LinesideError) else system_error(error)
            log.error("backup failed", file=str(file), reason=str(reason))
            self._failed = begun
            await self._record("event_backup_failed", file, reason)
            return
        self._written, self._failed = begun, None
        await self._record("event_backup_written", file, left_out or "")

    async def _record(self, code: str, file: Path, reason: Message | str = "") -> None:
        await self._events.record(kind="server", what=Message.of(code, file=file.name), message=reason)

    def _prepare(self) -> None:
        """A folder that is not there is not made: it may be that of a disk that is not mounted."""
        if not self._folder.is_dir():
            raise BackupError(Message.of("backup_folder_missing", folder=str(self._folder)))

    def _remove_older(self, file: Path) -> None:
        for name in too_many((path.name for path in self._folder.iterdir()), self._keep, file.name):
            (self._folder / name).unlink(missing_ok=True)

    async def _by_command(self, file: Path) -> Message | None:
        """By ``lineside backup-store``. Raises BackupError with what it complained of."""
        words = (
            sys.executable,
            "-P",
            "-m",
            "app.cli",
            "backup-store",
            str(file),
            "--share-events",
            "--config",
            str(self._config),
            "--json",
        )
        process = await asyncio.create_subprocess_exec(
            *words,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            preexec_fn=lambda: os.nice(NICE),
        )
        try:
            done, complaint = await process.communicate()
        except asyncio.CancelledError:
            process.kill()
            raise
        if process.returncode:
            text = complaint.decode(errors="replace").strip().removeprefix("lineside: ")
            raise BackupError(Message.of("system_error", error=text or f"exit code {process.returncode}"))
        return left_out_of(json.loads(done))


def left_out_of(written: Mapping[str, Any]) -> Message | None:
    """What a backup lacks, by what ``lineside backup-store --json`` prints; None where all is."""
    lists = (("left_out", "backup_leaves_out"), ("events_absent", "backup_without_events"))
    return joined(Message(code, {"files": files}) for name, code in lists if (files := written[name]))


def newest_in(folder: Path, now: UnixTime) -> UnixTime | None:
    """When the newest backup of a folder was written. One of the future is of a clock that was wrong."""
    with suppress(OSError):
        backups = (path for path in folder.iterdir() if NAME.fullmatch(path.name))
        times = (UnixTime(path.stat().st_mtime) for path in backups)
        return max((written for written in times if written <= now), default=None)
    return None


def _last_change(config: Path | None) -> UnixTime | None:
    with suppress(OSError):
        return None if config is None else UnixTime(config.stat().st_mtime)
    return None
