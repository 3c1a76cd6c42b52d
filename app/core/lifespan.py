"""The lifespan of the server: its parts start in order, and end in reverse order even if one of them fails.

Works run as tasks of their own, not in a TaskGroup: one that fails is restarted and never ends the others. A
blocking call may run in a thread that ends with the process.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Coroutine
from concurrent.futures import Future
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial
from typing import Any, TypeVar

import structlog

from app.errors import system_error
from bus.errors import LinesideError
from bus.messages import Message

RESTART_AFTER_S = 1.0
MAX_FINISH_S = 1.0
"""The seconds that the end of the server waits for all backlogs to be written."""
CANCEL_AGAIN_S = 0.5
Step = Callable[[], Awaitable[object]]
Running = Callable[[], Coroutine[Any, Any, None]]
log = structlog.get_logger()


class StartError(LinesideError):
    """Raised when a part of the server could not start; the message names the part."""


class Lifespan:
    """The parts of the server, each added where its service is made, after the parts that it needs."""

    def __init__(self) -> None:
        self._parts: list[tuple[str, Step | None, Step | None]] = []
        self._works: list[Running] = []
        self._finishing: list[Running] = []

    def add(
        self,
        name: str,
        *works: Step,
        start: Step | None = None,
        once: Step | None = None,
        finish: Step | None = None,
        end: Step | None = None,
    ) -> None:
        """Add the works of a service; their errors are logged with ``name``. ``works`` run from the last
        start to the end and are restarted when they fail; ``once`` runs beside them and is not restarted.
        ``finish`` waits, while the works still run, until they have written their backlog. ``end`` is called
        after the works, if the part has started; parts that were added earlier still run then."""
        self._parts.append((name, start, end))
        self._works += [partial(_restarted, name, work) for work in works]
        if once is not None:
            self._works.append(partial(_run_once, name, once))
        if finish is not None:
            self._finishing.append(partial(_ended, name, partial(_within, finish)))

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Run from the first start to the last end. Raise StartError; the parts that have started are
        ended."""
        async with AsyncExitStack() as stack:
            for name, start, end in self._parts:
                if start is not None:
                    await _start(name, start)
                if end is not None:
                    stack.push_async_callback(_ended, name, end)
            stack.push_async_callback(cancel, [asyncio.create_task(work()) for work in self._works])
            stack.push_async_callback(self._finish)
            yield

    async def _finish(self) -> None:
        """Wait for every backlog, all together: one that cannot be written takes no time from the others."""
        await asyncio.gather(*(finish() for finish in self._finishing))


async def _start(name: str, start: Step) -> None:
    try:
        await start()
    except LinesideError as error:
        raise StartError(Message.of("part_not_started", part=name, reason=error.message)) from error
    except Exception as error:
        log.exception("not started", part=name)
        raise StartError(Message.of("part_not_started", part=name, reason=system_error(error))) from error


async def _ended(name: str, end: Step) -> None:
    """Run a step of the end; log a failure, so that the other steps follow."""
    try:
        await end()
    except Exception as error:
        log.error("not ended", part=name, why=str(error) or type(error).__name__)


async def _within(finish: Step) -> None:
    async with asyncio.timeout(MAX_FINISH_S):
        await finish()


async def cancel(tasks: Collection[asyncio.Task[None]]) -> None:
    """Cancel tasks and wait until all have ended. A task is canceled again while it runs: Python 3.11's
    `asyncio.wait_for`, which libraries use, loses a cancellation that comes as its future is done."""
    left = set(tasks)
    while left:
        for task in left:
            task.cancel()
        _, left = await asyncio.wait(left, timeout=CANCEL_AGAIN_S)


async def _restarted(name: str, work: Step) -> None:
    """Run ``work``; log a failure and start it again."""
    while True:
        await _run_once(name, work)
        await asyncio.sleep(RESTART_AFTER_S)


async def _run_once(name: str, work: Step) -> None:
    """Run ``work``; log a failure."""
    try:
        await work()
    except Exception:
        log.exception("work failed", part=name)


class Background:
    """Tasks that outlive the request that began them, and end with the server."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[None]] = set()

    def begin(self, work: Coroutine[Any, Any, None], name: str) -> None:
        """Begin a task in the background."""
        task = asyncio.create_task(work, name=name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def settled(self) -> None:
        """Wait until no task runs."""
        while self._tasks:
            await asyncio.gather(*self._tasks)

    async def close(self) -> None:
        """Cancel the tasks that still run."""
        await cancel(list(self._tasks))


T = TypeVar("T")


async def in_thread(work: Callable[[], T], *, stop: Callable[[], None] | None = None) -> T:
    """Run ``work`` in a thread of its own and return its result. ``stop`` is called when the wait is
    canceled, and has to make it return. A thread that hangs nevertheless is abandoned: it delays neither the
    loop nor the end of the process, as a thread of a pool would."""
    done: Future[T] = Future()
    done.set_running_or_notify_cancel()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:
            done.set_exception(error)

    threading.Thread(target=run, name="detached", daemon=True).start()
    try:
        return await asyncio.wrap_future(done)
    except asyncio.CancelledError:
        if stop is not None:
            stop()
        raise
