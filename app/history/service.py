"""History as the rest of the app uses it: readings in, answers out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from app.errors import StoreError
from app.history import store
from app.history.query import Answer, Question, answer
from app.history.runs import SECOND
from app.history.status import Status
from app.history.tail import Tail
from app.history.upkeep import Keep
from app.history.writer import ClockStepped, Writer
from app.settings import Settings
from bus.contract import Update

FILE = "history.db"
T = TypeVar("T")


def _nobody(_step_s: float, _at: float) -> None:
    """Nobody wants to hear of clock steps."""


class History:
    """One for the app. Opening never fails: a store that cannot be used is said by :attr:`status`."""

    def __init__(self, settings: Settings, on_clock_step: ClockStepped = _nobody) -> None:
        self.path = settings.server.data / FILE
        self.buses = {bus.name: bus for bus in settings.bus}
        self.time_zone = settings.site.time_zone
        keep = Keep(settings.history.raw_days, settings.history.years)
        self._writer = Writer(self.path, keep, on_clock_step)

    def start(self) -> None:
        """Open the store and begin to write."""
        self._writer.start()

    def close(self) -> None:
        """What was taken in is on disk when this returns."""
        self._writer.close()

    def append(self, bus: str, updates: Sequence[Update]) -> None:
        """Take in what a worker reported; never waits, and costs the event loop a microsecond."""
        self._writer.take((bus, updates))

    @property
    def status(self) -> Status:
        """Whether history is well, and if not, why."""
        return self._writer.status

    async def ask(self, questions: Sequence[Question]) -> list[Answer]:
        """What each value was. Raises StoreError when the store cannot be read."""
        return await self.read(lambda c, tail: [answer(c, tail, question) for question in questions])

    async def read(self, work: Callable[[store.Connection, Tail], T]) -> T:
        """``work`` on a read-only connection and the tail, in a thread. Raises StoreError."""
        tail = self._writer.tail
        try:
            return await self._writer.database.read(lambda connection: work(connection, tail))
        except ValueError as error:
            raise StoreError(f"the store {self.path}: {error}; restore a backup of it") from error


def seconds(at: int) -> float:
    """µs as seconds since the epoch."""
    return at / SECOND
