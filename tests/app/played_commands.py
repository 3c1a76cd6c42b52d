"""A scripted command service: units with a parameter memory, which respond, refuse or stop responding."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from app.core.database import Database
from app.core.web.access import Person, Role
from app.engineering.sets.drift import BusDrift
from app.engineering.sets.saving import ParameterReader, SetKeeper
from app.engineering.sets.store import SetStore
from app.errors import Problem
from app.line.commands import catalogue
from app.line.commands.limits import NO_LIMITS
from app.line.commands.record import CommandKey
from app.line.commands.rules import RuleContext
from app.line.commands.service import BeforeWrite
from app.line.live.bus_live import LiveState
from bus.catalogue.parameters import PARAMETERS
from bus.contract import (
    Action,
    BusLink,
    ParameterValue,
    Reading,
    ReadParameters,
    Result,
    SetLine,
    SetSpeed,
    UnitLink,
    WriteParameter,
)
from bus.messages import Message, term
from bus.settings import BusSettings
from tests.app.played_rights import PlayedRights

ANNA = Person("anna", Role.ENGINEER, "session")
REMOTE, HEALTHY, RUN = 0b0100_0000, 0b0000_0010, 0b0000_0001


@dataclass
class PlayedCommands:
    """``memory``: unit → number → raw. ``timeout_after``: writes after which no unit responds; ``dead``:
    units whose parameters cannot be read; ``hangs_after``: writes after which the next one gets no result;
    ``objects``: by parameter the Problem with which a write of it is not sent; ``before_write``: called as
    each write arrives.
    """

    live: LiveState
    memory: dict[int, dict[int, int]]
    refuses: dict[int, int] = field(default_factory=dict)
    objects: dict[int, Problem] = field(default_factory=dict)
    before_write: Callable[[WriteParameter], None] = lambda _: None
    lacks: frozenset[int] = frozenset()
    timeout_after: int | None = None
    dead: set[int] = field(default_factory=set)
    hangs_after: int | None = None
    hanging: asyncio.Event = field(default_factory=asyncio.Event)
    written: list[tuple[int, int, int]] = field(default_factory=list)
    write_subscribers: list[BeforeWrite] = field(default_factory=list)
    sent: list[Action] = field(default_factory=list)

    def on_write(self, subscriber: BeforeWrite) -> None:
        """As the real one; a test calls it itself."""
        self.write_subscribers.append(subscriber)

    async def send(self, person: Person, action: Action, **_: Any) -> Result:
        assert person.name
        self.sent.append(action)
        match action:
            case ReadParameters():
                return self._read(action)
            case WriteParameter() if len(self.written) == self.hangs_after:
                self.hanging.set()
                await asyncio.Event().wait()
            case WriteParameter():
                self.before_write(action)
                return self._write(action)
            case SetLine():
                return Result(id="x", at=time.time(), outcome="verified")
        raise AssertionError(action)

    async def look_up(self, _: Person, id: str) -> CommandKey:
        """As the real one of a server that was just started; it remembers no command."""
        return CommandKey(id)

    def check(self, person: Person, action: Action, *, confirm: bool = False) -> None:
        assert (person.name, confirm) == ("anna", True)
        assert isinstance(action, SetSpeed)
        now = RuleContext(
            self.live.buses["dry-end"], lambda _: NO_LIMITS, lambda _: None, lambda _: 0, confirm=confirm
        )
        catalogue.check(action, now)

    @property
    def _timed_out(self) -> bool:
        return self.timeout_after is not None and len(self.written) >= self.timeout_after

    def _read(self, action: ReadParameters) -> Result:
        if self._timed_out or action.unit in self.dead:
            return Result(id="r", at=time.time(), outcome="unverified", message=term("no response"))
        values = [self._value(action.unit, number) for number in action.numbers]
        return Result(id="r", at=time.time(), outcome="verified", values=values)

    def _value(self, unit: int, number: int) -> ParameterValue:
        if number in self.lacks:
            return ParameterValue(unit=unit, number=number, at=1.0, raw=None, available=False)
        return ParameterValue(unit=unit, number=number, at=1.0, raw=self.memory[unit][number], frame=b"\x10")

    def _write(self, action: WriteParameter) -> Result:
        if action.number in self.objects:
            raise self.objects[action.number]
        if self._timed_out:
            return Result(id="w", at=time.time(), outcome="unverified", message=term("no response"))
        if action.number in self.refuses:
            return Result(id="w", at=time.time(), outcome="refused", unit_error=self.refuses[action.number])
        self.written.append((action.unit, action.number, action.raw))
        self.memory[action.unit][action.number] = action.raw
        return Result(id="w", at=time.time(), outcome="verified", read_back=action.raw)


@dataclass
class Noted:
    """The events, as a list."""

    events: list[dict[str, Any]] = field(default_factory=list)
    noted: asyncio.Event = field(default_factory=asyncio.Event)

    async def record(self, **fields: Any) -> int:
        self.events.append(
            {name: str(value) if isinstance(value, Message) else value for name, value in fields.items()}
        )
        self.noted.set()
        return len(self.events)

    async def page(self, _wanted: Any, _limit: int) -> tuple[list[dict[str, Any]], int | None]:
        """No command was written down."""
        return [], None


def a_bus() -> LiveState:
    settings = BusSettings.model_validate(
        {
            "name": "dry-end",
            "port": "/dev/null",
            "unit": [{"id": 1, "name": "Unwind"}, {"id": 2, "name": "Nip"}],
        }
    )
    return LiveState([settings], started_at=0.0)


def responding(live: LiveState, commanded: int = 1000, *, run: bool = False, remote: bool = True) -> None:
    """Give both units a reading and all parameters that are needed to show them."""
    outputs, inputs = REMOTE if remote else 0, HEALTHY | (RUN if run else 0)
    live.buses["dry-end"].apply([BusLink(at=1.0, link="open")])
    for unit in (1, 2):
        needed = {2: 20000, 3: 1, 6: 100, 7: 50, 8: 0}
        live.buses["dry-end"].apply([UnitLink(unit=unit, at=1.0, link="online")])
        live.buses["dry-end"].apply(
            [Reading(unit, fresh(), commanded, commanded, 0, outputs, inputs)]
            + [ParameterValue(unit=unit, number=number, at=1.0, raw=raw) for number, raw in needed.items()]
        )


def fresh() -> float:
    """The time of a reading that no slow test lets grow old."""
    return time.time() + 600


def factory() -> dict[int, int]:
    """A unit as it comes out of its box, in REMOTE."""
    return {number: row.minimum for number, row in PARAMETERS.items()} | {17: 1, 18: 96, 19: 1}


class SetScene:
    """A keeper of sets with two units that respond, and its store in ``folder``."""

    def __init__(self, folder: Path) -> None:
        self.live = a_bus()
        self.commands = PlayedCommands(self.live, {1: factory(), 2: factory()})
        self.events = Noted()
        self.database = Database(folder / "store.db")
        self.store = SetStore(self.database)
        self.rights = PlayedRights()
        bus = self.live.buses["dry-end"]
        reader = ParameterReader(bus, self.commands)  # type: ignore[arg-type]
        self.drift = BusDrift(bus, self.store, self.events)  # type: ignore[arg-type]
        self.keeper = SetKeeper(bus, reader, self.drift, self.store, self.events, self.rights)  # type: ignore[arg-type]

    def report(self, unit: int, *numbers: int, raw: int = 30, at: float = 1.0) -> None:
        """Report ``raw`` for these parameters of a unit."""
        values = [ParameterValue(unit=unit, number=number, at=at, raw=raw) for number in numbers]
        self.live.buses["dry-end"].apply(values)
