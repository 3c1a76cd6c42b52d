"""The lifespan of the server: parts start in order and end in reverse, each even where another fails."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from functools import partial

import structlog

from app.errors import system_error
from bus.errors import LinesideError
from bus.messages import Message

RESTART_AFTER_S = 1.0
MAX_FINISH_S = 1.0
"""How long the end waits for backlogs to be written, all of them together."""
Step = Callable[[], Awaitable[None]]
log = structlog.get_logger()


class StartError(LinesideError):
    """A part of the server could not start; the message names it."""


@dataclass(frozen=True, slots=True)
class Part:
    """What a service does in the lifespan of the server. ``works`` run from the last start to the end and are
    restarted where they fail; ``once`` runs beside them and is not restarted.

    ``finish`` waits, while the works still run, until they have written their backlog. ``end`` is called
    after the works, if the part has started; what was added earlier still runs then.
    """

    name: str
    works: tuple[Step, ...] = ()
    start: Step | None = None
    once: Step | None = None
    finish: Step | None = None
    end: Step | None = None


class Lifespan:
    """The parts of the server, each added where its service is made, after those that it needs."""

    def __init__(self) -> None:
        self._parts: list[Part] = []

    def add(
        self,
        name: str,
        *works: Step,
        start: Step | None = None,
        once: Step | None = None,
        finish: Step | None = None,
        end: Step | None = None,
    ) -> None:
        """Add a :class:`Part`; its errors are logged with ``name``."""
        self._parts.append(Part(name, works, start, once, finish, end))

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """From the first start to the last end. Raises StartError; the parts that have started are ended."""
        async with AsyncExitStack() as stack:
            for part in self._parts:
                if part.start is not None:
                    await _start(part.name, part.start)
                if part.end is not None:
                    stack.push_async_callback(_ended, part.name, part.end)
            stack.push_async_callback(_cancel, self._begin_works())
            stack.push_async_callback(self._finish)
            yield

    def _begin_works(self) -> list[asyncio.Task[None]]:
        works = [_restarted(part.name, work) for part in self._parts for work in part.works]
        works += [_run_once(part.name, part.once) for part in self._parts if part.once is not None]
        return [asyncio.create_task(work) for work in works]

    async def _finish(self) -> None:
        """Wait for every backlog, together: one that cannot be written takes no time from the others."""
        finishing = [(part.name, part.finish) for part in self._parts if part.finish is not None]
        await asyncio.gather(*(_ended(name, partial(_within, finish)) for name, finish in finishing))


async def _start(name: str, start: Step) -> None:
    try:
        await start()
    except LinesideError as error:
        raise StartError(Message.of("part_not_started", part=name, reason=error.message)) from error
    except Exception as error:
        log.exception("not started", part=name)
        raise StartError(Message.of("part_not_started", part=name, reason=system_error(error))) from error


async def _ended(name: str, end: Step) -> None:
    """Run a step of the end; a failure is logged, and the other steps follow."""
    try:
        await end()
    except Exception as error:
        log.error("not ended", part=name, why=str(error) or type(error).__name__)


async def _within(finish: Step) -> None:
    async with asyncio.timeout(MAX_FINISH_S):
        await finish()


async def _cancel(tasks: list[asyncio.Task[None]]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def _restarted(name: str, work: Step) -> None:
    """Run ``work``; a failure is logged, and it starts again."""
    while True:
        await _run_once(name, work)
        await asyncio.sleep(RESTART_AFTER_S)


async def _run_once(name: str, work: Step) -> None:
    try:
        await work()
    except Exception:
        log.exception("work failed", part=name)
