"""The OPC UA process of this server: start it, feed it with the live state, watch it, start it again.

The server only writes into its pipe, and never waits for it: a process that does not read, or is silent, is
killed.
"""

from __future__ import annotations

import asyncio
import importlib.util
import os
import random
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import partial

import structlog

from app.core.database import Database, StoreConnection
from app.core.lifespan import cancel
from app.core.web.access import Role
from app.errors import StoreError
from app.line.alarms.alarm import Alarm
from app.line.live.bus_live import Audience, BusLive
from app.people.auth import store
from app.people.auth.rules import USE_NOTED_EVERY_S
from app.system.opcua.link import (
    Begin,
    Changes,
    Frames,
    Key,
    Keys,
    StandingAlarm,
    Status,
    ToProcess,
    UnitAlarms,
    followed,
    frame,
    from_process,
    state_of,
)
from bus.contract import Update
from bus.errors import LinesideError
from bus.instants import UnixTime, monotonic_now, unix_now
from bus.messages import Message, in_english, number
from bus.pacing import ReconnectDelay

MODULE = "app.cli.opcua"
NICE = 5
"""The process yields to the server and the bus workers."""
FLUSH_S = 0.1
"""The span of changes that are sent together: clients get none more often."""
KEYS_EVERY_S = 5.0
SILENT_S, SILENT_AT_START_S = 30.0, 180.0
"""The seconds without a status after which the process is killed; it sends one each second once its code is
imported, which takes long on a busy machine."""
MAX_UNREAD = 32_000_000
"""The most bytes that wait for the process; if more wait, it hangs."""
END_S = 1.0
log = structlog.get_logger()


class ProcessError(LinesideError):
    """Raised if the OPC UA process ended or does not work; the message has the reason."""


def require_package() -> None:
    """Raise ProcessError if asyncua is not installed. It is not imported here."""
    if importlib.util.find_spec("asyncua") is None:
        raise ProcessError(Message("opcua_no_package"))


class OpcuaProcess:
    """The runner of the OPC UA process: starts it, feeds it with the live state, watches it, starts it again.
    ``alarms_of``: the standing alarms of a unit."""

    def __init__(
        self,
        begin: Begin,
        buses: Sequence[BusLive],
        alarms_of: Callable[[str, int], list[Alarm]],
        database: Database,
    ) -> None:
        self._begin, self._buses, self._alarms_of = begin, buses, alarms_of
        self._database = database
        self.status = Status()
        self.fault: Message | None = None
        self.restarts = -1
        self._updates: dict[str, list[Update]] = {bus.settings.name: [] for bus in buses}
        self._changed_alarms: set[tuple[str, int]] = set()
        self._is_fed = False
        self._process: Process | None = None
        for bus in buses:
            bus.subscribe(Audience.STREAM, partial(self._note, bus.settings.name))

    @property
    def place(self) -> str:
        """The address at which the process listens, for people."""
        return f"{self._begin.host}:{self._begin.port}"

    # --- reports of the line ---

    def _note(self, bus: str, updates: Sequence[Update]) -> None:
        if self._is_fed:
            self._updates[bus] += updates

    def note_alarm(self, alarm: Alarm) -> None:
        """Note that an alarm of a unit changed, for the next message to the process."""
        definition = alarm.definition
        if self._is_fed and definition.bus in self._updates and definition.unit is not None:
            self._changed_alarms.add((definition.bus, definition.unit))

    # --- one process after the other ---

    async def follow(self) -> None:
        """Keep a process running until canceled."""
        delay = ReconnectDelay(random.random)
        while True:
            began = monotonic_now()
            self.restarts += 1
            try:
                await self._run()
            except LinesideError as error:
                if error.message != self.fault:
                    log.warning("OPC UA does not serve", why=in_english(error.message))
                self.fault = error.message
            await self.end()
            self.status = Status(refused=self.status.refused, certificate_ends=self.status.certificate_ends)
            await asyncio.sleep(delay.ended(monotonic_now() - began))

    async def _run(self) -> None:
        """Run one process until it ends. Raise ProcessError or StoreError."""
        require_package()
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-P", "-m", MODULE), stdin=PIPE, stdout=PIPE, preexec_fn=_begin_group
        )
        self._process = process
        works = (self._feed(process), self._listen(process), self._send_keys(process))
        tasks = [asyncio.create_task(work) for work in works]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            self._is_fed = False
            await cancel(tasks)

    async def end(self) -> None:
        """End the process by closing its input, and by SIGKILL if it does not end."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        process.stdin.close()
        with suppress(TimeoutError):
            async with asyncio.timeout(END_S):
                await process.wait()
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()

    async def _feed(self, process: Process) -> None:
        """Send the process the complete state of each bus, then the changes."""
        self._send(process, self._begin)
        for bus in self._buses:
            self._send(process, state_of(bus))
            self._send(process, self._standing(bus.settings.name, bus.units))
        self._is_fed = True
        try:
            while True:
                await asyncio.sleep(FLUSH_S)
                for message in self._changes():
                    self._send(process, message)
        finally:
            self._changes()

    def _changes(self) -> list[ToProcess]:
        found: list[ToProcess] = []
        for bus, updates in self._updates.items():
            if updates:
                found.append(Changes(bus, followed(updates)))
                self._updates[bus] = []
        alarms, self._changed_alarms = self._changed_alarms, set()
        for bus in {bus for bus, _ in alarms}:
            found.append(self._standing(bus, [unit for place, unit in alarms if place == bus]))
        return found

    def _standing(self, bus: str, units: Iterable[int]) -> UnitAlarms:
        return UnitAlarms(
            bus,
            {
                unit: [_standing(alarm) for alarm in self._alarms_of(bus, unit) if alarm.is_annunciated]
                for unit in units
            },
        )

    def _send(self, process: Process, message: ToProcess) -> None:
        """Write a message to the process without waiting. Raise ProcessError if the process does not read."""
        pipe = process.stdin
        assert pipe is not None
        if pipe.transport.get_write_buffer_size() > MAX_UNREAD:
            raise ProcessError(Message("opcua_hangs"))
        pipe.write(frame(message))

    async def _listen(self, process: Process) -> None:
        """Keep the newest status of the process. Raise ProcessError once it ends or is silent."""
        assert process.stdout is not None
        frames, patience_s = Frames(from_process), SILENT_AT_START_S
        while True:
            try:
                async with asyncio.timeout(patience_s):
                    data = await process.stdout.read(65_536)
                statuses = list(frames.feed(data))
            except (TimeoutError, ValueError):
                raise ProcessError(Message("opcua_hangs")) from None
            patience_s = SILENT_S
            for self.status in statuses:
                if self.status.fault is not None:
                    raise ProcessError(self.status.fault)
                if self.status.is_serving:
                    self.fault = None
            if not data:
                raise ProcessError(Message.of("opcua_ended", code=await process.wait()))

    # --- accounts ---

    async def _send_keys(self, process: Process) -> None:
        """Send the tokens with which programs may sign in, whenever they have changed."""
        sent: list[Key] | None = None
        while True:
            with suppress(StoreError):
                keys = await self._database.read(_keys)
                if keys != sent:
                    self._send(process, Keys(keys))
                    sent = keys
                await self._note_use()
            await asyncio.sleep(KEYS_EVERY_S)

    async def _note_use(self) -> None:
        """Store the time at which the tokens of open sessions were last used."""
        now, used = unix_now(), set(self.status.accounts)
        if not used:
            return
        tokens = await self._database.read(store.tokens)
        old = [
            each.id
            for each in tokens
            if each.id in used and (each.used_at is None or now - each.used_at > USE_NOTED_EVERY_S)
        ]
        for id_ in old:
            await self._database.write(partial(store.note_token_used, number=id_, now=now))

    # --- status ---

    @property
    def to_do(self) -> Message | None:
        """The action by which an engineer makes OPC UA work; None if it works."""
        if self.fault is not None:
            return Message("opcua_check")
        if self.status.waiting:
            return Message.of("opcua_trust", n=self.status.waiting, folder=f"{self._begin.folder}/rejected")
        return None

    def state(self) -> Message:
        """Return a sentence about whether OPC UA is served, and to how many sessions."""
        if self.fault is not None:
            return Message.of("opcua_lacks", reason=self.fault)
        if not self.status.is_serving:
            return Message("opcua_starts")
        return Message.of(
            "opcua_serves",
            place=self.place,
            sessions=number(str(self.status.sessions)),
            refused=number(str(self.status.refused)),
        )


def _standing(alarm: Alarm) -> StandingAlarm:
    """Return an alarm in the form for clients."""
    facts, definition = alarm.facts, alarm.definition
    name = definition.name if isinstance(definition.name, str) else in_english(definition.name)
    since = facts.came or facts.since or UnixTime(0.0)
    return StandingAlarm(name, definition.priority, facts.active, facts.acknowledged, since)


def _keys(connection: StoreConnection) -> list[Key]:
    return [
        Key(token.id, token.name, hash_, token.expires_at)
        for hash_, token in store.token_hashes(connection)
        if token.role is not Role.WORKER
    ]


def _begin_group() -> None:
    """Lower the priority of the new process, and take it out of the terminal's process group, so that Ctrl-C
    reaches it through the server."""
    os.setpgrp()
    os.nice(NICE)
