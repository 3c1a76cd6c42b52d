"""The service that writes a backup when one is due, in another process with low priority."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import structlog

from app.errors import system_error
from app.line.conditions.catalogue import BACKUP_OVERDUE, BACKUP_S
from app.people.audit.log import EventLog
from app.system.backup.folder import next_due, time_of
from app.system.backup.settings import BackupSettings
from bus.errors import LinesideError
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message, joined

LOOK_S = 30.0
"""The seconds between two checks of the clock: setting the clock moves the next backup."""
NICE = 15
log = structlog.get_logger()
Written = tuple[str, Message | None]
"""The name of a backup, and a remark on it, if any."""
WriteBackup = Callable[[], Awaitable[Written]]


class FailedBackup(LinesideError):
    """Raised if a backup could not be written."""


class Backups:
    """The backups of one server. ``write`` makes and verifies one."""

    def __init__(
        self,
        settings: BackupSettings,
        config: Path | None,
        zone: ZoneInfo,
        events: EventLog,
        write: WriteBackup | None = None,
        clock: Clock = unix_now,
    ) -> None:
        self._settings, self._folder = settings, settings.folder or Path()
        self._config, self._zone, self._events = config, zone, events
        self._write = write or self._by_command
        self._clock = clock
        self.failing: Message | None = None
        """The reason why the last attempt failed; None if it succeeded."""
        self._noted_on = ""
        """The day of the last event of a written backup."""
        self._since = _last_change(config) or clock()
        self.written: UnixTime | None = None
        """The start of the newest backup."""
        self._failed: UnixTime | None = None

    @property
    def newest(self) -> UnixTime | None:
        """The start of the newest backup; without one, the last change of the configuration that wants one.
        None: no backup is wanted."""
        return (self.written or self._since) if self._settings.folder is not None else None

    @property
    def missing(self) -> Message | bool:
        """Whether the newest backup is too old; if the last attempt failed, the reason instead."""
        every = self._settings.every_s
        after_s = BACKUP_S if every is None else max(3600.0, 2.5 * every)
        return BACKUP_OVERDUE.holds(self.newest, self._clock(), after_s) and (self.failing or True)

    def next_due(self, now: UnixTime) -> UnixTime:
        """Return when the next backup is due; not after ``now`` if one should begin."""
        return next_due(now, self.written, self._failed, self._settings, self._zone)

    async def follow(self) -> None:
        """Write a backup when one is due, until canceled: at once if there is none or one was missed; later
        after a failure."""
        self.written = await asyncio.to_thread(newest_in, self._folder, self._clock(), self._zone)
        while True:
            await asyncio.sleep(LOOK_S)
            now = self._clock()
            if now >= self.next_due(now):
                await self.back_up()

    async def back_up(self) -> None:
        """Write a backup now. A failure is an event, once for each reason; a success is an event after a
        failure, and for the first backup of a day."""
        begun = self._clock()
        try:
            name, about = await self._write()
        except (LinesideError, OSError) as error:
            reason = error.message if isinstance(error, LinesideError) else system_error(error)
            log.error("backup failed", folder=str(self._folder), reason=str(reason))
            former, self._failed, self.failing = self.failing, begun, reason
            if str(former) != str(reason):
                await self._record(Message.of("event_backup_failed", file=str(self._folder)), reason)
            return
        day = datetime.fromtimestamp(float(begun), self._zone).date().isoformat()
        is_news = self.failing is not None or self._noted_on != day
        self.written, self._failed, self.failing, self._noted_on = begun, None, None, day
        if is_news:
            await self._record(Message.of("event_backup_written", file=name), about or "")

    async def _record(self, what: Message, reason: Message | str = "") -> None:
        await self._events.record(kind="server", what=what, message=reason)

    async def _by_command(self) -> Written:
        """Run ``lineside backup-store``. Raise FailedBackup with its complaint."""
        if not self._folder.is_dir():
            # A missing folder is not created, nor a file in its place: its disk may not be mounted.
            raise FailedBackup(Message.of("backup_folder_missing", folder=str(self._folder)))
        words = (
            sys.executable,
            "-P",
            "-m",
            "app.cli",
            "backup-store",
            str(self._folder),
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
            raise FailedBackup(Message.of("system_error", error=text or f"exit code {process.returncode}"))
        written = json.loads(done)
        return str(written["file"]), left_out_of(written)


def left_out_of(written: Mapping[str, Any]) -> Message | None:
    """Return the lacks of a backup by the JSON of ``lineside backup-store``; None if it has all."""
    lists = (("left_out", "backup_leaves_out"), ("events_absent", "backup_without_events"))
    lacking = [Message(code, {"files": files}) for name, code in lists if (files := written[name])]
    if written["damaged"]:
        lacking.append(Message.of("backup_contents_lost", n=len(written["damaged"])))
    return joined(lacking)


def newest_in(folder: Path, now: UnixTime, zone: ZoneInfo) -> UnixTime | None:
    """Return the start of a folder's newest backup. A future one comes from a wrong clock: ignored."""
    with suppress(OSError):
        times = (time_of(path.name, zone) for path in folder.iterdir())
        return max((begun for begun in times if begun is not None and begun <= now), default=None)
    return None


def _last_change(config: Path | None) -> UnixTime | None:
    with suppress(OSError):
        return None if config is None else UnixTime(config.stat().st_mtime)
    return None
