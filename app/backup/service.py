"""Writes a backup each night, in another process, which gives way to all others."""

from __future__ import annotations

import asyncio
import os
import shutil
import sys
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from zoneinfo import ZoneInfo

import structlog

from app.audit.log import EventLog
from app.backup.schedule import NAME, name_of, next_after, too_many
from app.backup.settings import BackupSettings
from app.database.private import make_folder
from app.errors import system_error
from bus.errors import LinesideError
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message

LOOK_S = 30.0
"""How often the clock is looked at: one that is set moves the next backup."""
NICE = 15
log = structlog.get_logger()
WriteBackup = Callable[[Path], Awaitable[None]]


class BackupError(LinesideError):
    """A backup could not be written."""


class Backups:
    """The backups of one server. ``write`` makes one file, and verifies it."""

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
        self.newest: UnixTime | None = None if settings.folder is None else clock()
        """When the newest backup was made, or since when there is to be one; None: there are to be none."""

    async def follow(self) -> None:
        """Write a backup whenever one is due, without end; at once where that of last night is missing."""
        self.newest = await asyncio.to_thread(self._newest_file) or self._clock()
        due = next_after(self.newest, self._at, self._zone)
        while True:
            await asyncio.sleep(LOOK_S)
            now = self._clock()
            if now >= due:
                await self.back_up()
            due = next_after(now, self._at, self._zone)

    async def back_up(self) -> None:
        """Write one now; its result is an event."""
        begun = self._clock()
        file = self._folder / name_of(begun, self._zone)
        try:
            await asyncio.to_thread(self._prepare)
            await self._write(file)
            await asyncio.to_thread(self._complete, file)
        except (LinesideError, OSError) as error:
            reason = error.message if isinstance(error, LinesideError) else system_error(error)
            log.error("backup failed", file=str(file), reason=str(reason))
            await self._record("event_backup_failed", file, reason)
            return
        self.newest = begun
        await self._record("event_backup_written", file)

    async def _record(self, code: str, file: Path, reason: Message | str = "") -> None:
        await self._events.record(kind="server", what=Message.of(code, file=file.name), message=reason)

    def _prepare(self) -> None:
        make_folder(self._folder)

    def _complete(self, file: Path) -> None:
        """Beside the stores their configuration; then the oldest file gives way."""
        if self._config is not None:
            beside = file.with_suffix(".toml")
            shutil.copyfile(self._config, beside)
            beside.chmod(0o600)
        for name in too_many((path.name for path in self._folder.iterdir()), self._keep):
            for old in (self._folder / name, (self._folder / name).with_suffix(".toml")):
                with suppress(FileNotFoundError):
                    old.unlink()

    def _newest_file(self) -> UnixTime | None:
        """When the newest backup of the folder was written."""
        with suppress(OSError):
            times = [path.stat().st_mtime for path in self._folder.iterdir() if NAME.fullmatch(path.name)]
            return UnixTime(max(times)) if times else None
        return None

    async def _by_command(self, file: Path) -> None:
        """By ``lineside backup-store``. Raises BackupError with what it complained of."""
        words = (
            sys.executable,
            "-P",
            "-m",
            "app.cli",
            "backup-store",
            str(file),
            "--config",
            str(self._config),
        )
        process = await asyncio.create_subprocess_exec(
            *words,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
            preexec_fn=lambda: os.nice(NICE),
        )
        try:
            _, complaint = await process.communicate()
        except asyncio.CancelledError:
            process.kill()
            raise
        if process.returncode:
            text = complaint.decode(errors="replace").strip().removeprefix("lineside: ")
            raise BackupError(Message.of("system_error", error=text or f"exit code {process.returncode}"))
