"""The service that reads, reviews and writes this server's configuration file, and restarts it."""

from __future__ import annotations

import asyncio
import os
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import structlog

from app.core.database.files import fresh_file, sync_folder
from app.core.web.access import Person, Role
from app.errors import Problem, StoreError, or_404, system_error
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from app.settings import Settings, parse
from app.system.configuration.document import (
    ConfigurationVersion,
    DifferenceLine,
    Edit,
    StoredVersion,
    VersionOrigin,
    VersionStore,
    content_of,
    difference,
)
from bus.configuration import ConfigurationError, read
from bus.errors import LinesideError
from bus.instants import unix_now
from bus.messages import Message, term

NO_REASON = term("no reason given")
CHANGE = Act("change_configuration", Role.ENGINEER, "configuration", "event_configuration_edited")
CHANGE_MAIL = Act("change_mail_server", Role.ADMIN, "configuration", "event_configuration_edited")
"""The server sends its password to the mail server that is named here, and the links in its mails lead people
to the address of the dashboard."""
CHANGE_PORTS = Act("change_ports", Role.ADMIN, "configuration", "event_configuration_edited")
"""The server opens the devices and hosts that are named here."""
ROLL_BACK = Act("roll_back_configuration", Role.ADMIN, "configuration", "event_configuration_rolled_back")
"""A version may change everything, also keys that only the file has."""
RESTART = Act("restart_server", Role.ADMIN, "server", "event_restart_requested")
"""For a few seconds no drive of the server is monitored."""
ACTS = (CHANGE, CHANGE_MAIL, CHANGE_PORTS, ROLL_BACK, RESTART)


MAX_EVENT = 2000
"""The most characters of a difference in the audit log."""
log = structlog.get_logger()


class FileChangedError(LinesideError):
    """Raised if the file was changed by hand just before it was replaced."""


class PresentFile(NamedTuple):
    """The present file. ``data``: its content, None if it is not TOML; ``faults``: why the server would not
    start with it; ``is_running``: whether the server runs with it."""

    text: str
    digest: str
    data: Any
    faults: tuple[Message, ...]
    is_writable: bool
    is_running: bool


class ConfigurationReview(NamedTuple):
    """The file as it would become; with ``faults`` it is not written."""

    text: str
    lines: list[DifferenceLine]
    faults: tuple[Message, ...]


class ConfigurationFile:
    """The configuration file, changed by one person at a time. Nothing is written if the file differs from
    the one from which a change began; a change by hand becomes a version before it is replaced."""

    def __init__(
        self,
        settings: Settings,
        store: VersionStore,
        events: EventLog,
    ) -> None:
        self._store = store
        self._settings = settings
        self._events = events
        self._one_at_a_time = asyncio.Lock()

    @property
    def path(self) -> Path:
        """The path of the file. Raises Problem 404 if the server was started without one."""
        return or_404(self._settings._file, "not_found", Message("configuration_no_file"))

    @property
    def owner(self) -> str:
        """The user who may change the file if the server may not."""
        try:
            return self.path.owner()
        except (OSError, KeyError):
            return "root"

    async def present(self) -> PresentFile:
        """Return the present file; a change by hand becomes a version. Raise Problem 404, or 409 if the file
        cannot be read."""
        async with self._one_at_a_time:
            return await self._present()

    async def is_waiting(self) -> bool:
        """Return whether the file would change something at the next start. Nothing is stored by this. Raise
        Problem as `present` does."""
        text = await self._text()
        return not (await asyncio.to_thread(self._judged, self.path, text)).is_running

    async def begin(self) -> None:
        """Make a version of changes since the last version, at the start."""
        if self._settings._file is not None:
            with suppress(Problem):
                await self.present()

    async def versions(self) -> list[ConfigurationVersion]:
        """List the versions, newest first."""
        return [each.version for each in await asyncio.to_thread(self._store.every)]

    def waiting(self, present: PresentFile) -> list[DifferenceLine]:
        """Return the lines of the file that take effect at the next start."""
        return [] if present.is_running else difference(self._settings._text, present.text)

    async def version(self, number: int) -> StoredVersion:
        """Return one version. Raise Problem 404."""
        found = await asyncio.to_thread(self._store.one, number)
        return or_404(found, "not_found", Message.of("configuration_no_version", n=number))

    async def version_of(self, digest: str) -> StoredVersion | None:
        """Return the newest version whose text has this digest; None if none is kept."""
        every = await asyncio.to_thread(self._store.every)
        return next((each for each in every if each.version.digest == digest), None)

    async def review(self, edit: Edit, digest: str) -> ConfigurationReview:
        """Return the file as a change would make it. Raise Problem 409 if the file is another one by now."""
        present = await self.present()
        self.refuse_superseded(present, digest)
        return await asyncio.to_thread(self._reviewed, present, edit)

    async def save(
        self, person: Person, act: Act, edit: Edit, digest: str, reason: str
    ) -> ConfigurationVersion:
        """Write the file as changed. Raise Problem 403, 409 or 422; then nothing was written."""
        act.check(person)
        async with self._one_at_a_time:
            present = await self._present()
            self.refuse_superseded(present, digest)
            review = await asyncio.to_thread(self._reviewed, present, edit)
            self.refuse_faults(review)
            if review.text == present.text:
                raise Problem(409, "not_in_state", Message("configuration_nothing_changed"))
            if not present.is_writable:
                message = Message.of("configuration_read_only", file=str(self.path), owner=self.owner)
                raise Problem(409, "not_in_state", message)
            return await self._stored(person, act, present, review, reason)

    def refuse_superseded(self, present: PresentFile, digest: str) -> None:
        """Raise Problem 409 if a change began from another text of the file."""
        if present.digest != digest:
            raise Problem(409, "superseded", Message("configuration_superseded"), digest=present.digest)

    def refuse_faults(self, review: ConfigurationReview) -> None:
        """Raise Problem 422 for a text with which the server would not start."""
        if review.faults:
            faults = Message.of("several", messages=list(review.faults))
            raise Problem(422, "invalid", Message.of("configuration_not_valid", faults=faults))

    def _not_written(self, error: Exception) -> Problem:
        if isinstance(error, FileChangedError):
            return Problem(409, "superseded", error.message)
        message = Message.of("configuration_not_replaced", file=str(self.path), error=system_error(error))
        return Problem(409, "not_in_state", message)

    async def _present(self) -> PresentFile:
        text = await self._text()
        await self._adopt(text)
        return await asyncio.to_thread(self._judged, self.path, text)

    async def _text(self) -> str:
        try:
            return await asyncio.to_thread(read, self.path)
        except ConfigurationError as error:
            raise Problem(409, "not_in_state", error.message) from error

    async def _adopt(self, text: str) -> None:
        """Make a version of the text if it was not written here."""
        newest = await asyncio.to_thread(self._store.newest)
        digest = digest_of(text)
        if newest is not None and newest.version.digest == digest:
            return
        number = await asyncio.to_thread(self._store.next_number)
        origin: VersionOrigin = "found" if newest is None else "by_hand"
        version = ConfigurationVersion(number, unix_now(), origin, digest)
        try:
            await asyncio.to_thread(self._store.add, StoredVersion(version, text))
        except OSError as error:
            log.warning("a version of the configuration is not kept", error=str(error))
            return
        if newest is not None:
            what = Message.of("event_configuration_by_hand", version=number)
            lines = difference(newest.text, text)
            try:
                await self._events.record(kind="configuration", what=what, message=_in_short(lines))
            except StoreError:
                # With the version in the store, the event would count as recorded.
                await asyncio.to_thread(self._store.withdraw, number)
                raise

    def _judged(self, path: Path, text: str) -> PresentFile:
        faults: tuple[Message, ...] = ()
        running, is_running = self._settings._text, text == self._settings._text
        try:
            parsed = parse(text, path)
            is_running = is_running or parsed.model_dump() == parse(running, path).model_dump()
        except ConfigurationError as error:
            faults = error.faults
        is_writable = os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)
        return PresentFile(text, digest_of(text), content_of(text), faults, is_writable, is_running)

    def _reviewed(self, present: PresentFile, edit: Edit) -> ConfigurationReview:
        text = edit(present.text)
        faults: tuple[Message, ...] = ()
        try:
            parse(text, self.path)
        except ConfigurationError as error:
            faults = error.faults
        return ConfigurationReview(text, difference(present.text, text), faults)

    async def _stored(
        self, person: Person, act: Act, present: PresentFile, review: ConfigurationReview, reason: str
    ) -> ConfigurationVersion:
        number = await asyncio.to_thread(self._store.next_number)
        origin: VersionOrigin = "rolled_back" if act is ROLL_BACK else "changed"
        digest = digest_of(review.text)
        version = ConfigurationVersion(number, unix_now(), origin, digest, person.account, reason)
        try:
            await asyncio.to_thread(self._store.add, StoredVersion(version, review.text))
            performed = act.by(person, version=number, reason=reason or NO_REASON)
            await self._events.record(**performed, message=_in_short(review.lines))
            await asyncio.to_thread(replace_file, self.path, present.text, review.text)
        except (OSError, FileChangedError) as error:
            await asyncio.to_thread(self._store.withdraw, number)
            problem = self._not_written(error)
            await self._events.record(kind="configuration", **person.author, what=problem.message)
            raise problem from error
        except Exception:
            await asyncio.to_thread(self._store.withdraw, number)
            raise
        return version


def digest_of(text: str) -> str:
    """Return the digest that identifies a text of the file."""
    return sha256(text.encode()).hexdigest()[:16]


def replace_file(path: Path, before: str, text: str) -> None:
    """Write all of a file or nothing, with its mode and, if permitted, its owner. It is on disk when this
    returns. Raise OSError, or FileChangedError if its text is not ``before`` at the last moment."""
    found = path.stat()
    with fresh_file(path, text.encode()) as fresh:
        with suppress(PermissionError):
            os.chown(fresh, found.st_uid, found.st_gid)
        fresh.chmod(found.st_mode & 0o7777)
        if read(path) != before:
            raise FileChangedError(Message("configuration_superseded"))
        fresh.replace(path)
    sync_folder(path.parent)


def _in_short(lines: list[DifferenceLine]) -> str:
    """Return the lines that differ, for the audit log."""
    signs = {"gone": "-", "new": "+"}
    return "; ".join(f"{signs[each.kind]} {each.text.strip()}" for each in lines if each.kind in signs)[
        :MAX_EVENT
    ]


DELAY_S = 1.0
"""The time for a browser to load the page to which it is sent, which then follows the restart."""


class Restart:
    """The restart of the server, if its host offers that: a demonstration does not, nor does a server that
    was started with rights or at a port that it would not get again."""

    def __init__(self, file: ConfigurationFile, events: EventLog) -> None:
        self._file = file
        self._events = events
        self._requested: asyncio.Event | None = None

    @property
    def is_offered(self) -> bool:
        return self._requested is not None

    def offer(self) -> asyncio.Event:
        """Let a person restart the server from now on; return the event that is set a moment after a person
        has."""
        self._requested = asyncio.Event()
        return self._requested

    async def request(self, person: Person, digest: str, reason: str) -> None:
        """Restart within a second. Raise Problem 403, or 409 if the file is another one by now, if the server
        would not start with it, or if it cannot restart."""
        RESTART.check(person)
        if self._requested is None:
            raise Problem(409, "not_in_state", Message("restart_not_offered"))
        present = await self._file.present()
        self._file.refuse_superseded(present, digest)
        if present.faults:
            faults = Message.of("several", messages=list(present.faults))
            raise Problem(409, "not_in_state", Message.of("restart_refused", faults=faults))
        await self._events.record(**RESTART.by(person, reason=reason or NO_REASON))
        asyncio.get_running_loop().call_later(DELAY_S, self._requested.set)
