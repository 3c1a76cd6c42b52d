"""A program whose clocks run fast: ``python -m tests.fast_clock CLOCK PROGRAM …``.

``CLOCK`` is `FastClock` as JSON, the same for all programs of one site. ``serve CONFIG`` is ``lineside
serve`` without its workers, ``feed URL UNITS RATE`` what `benchmarks.feeder` sends, for each bus with a token
that is a line of standard input. Everything that waits by the event loop or by an event of a thread waits
shorter by the same factor; calls of the system are as slow as they are.
"""

from __future__ import annotations

import asyncio
import json
import selectors
import signal
import sys
import threading
import time
from collections.abc import Coroutine
from contextlib import suppress
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

_monotonic, _sleep = time.monotonic, time.sleep
AHEAD, BACK = signal.SIGUSR1, signal.SIGUSR2
"""Signals that set the clock of a program by a year."""
YEAR_S = 365 * 86_400.0
EVERY = 1000
"""Readings of one bus between two that change an e-stop."""


@dataclass(frozen=True)
class FastClock:
    """Seconds of the line pass ``factor`` times as fast since ``begun`` (monotonic seconds of the machine),
    when it was ``wall`` (Unix time) there."""

    factor: float
    begun: float
    wall: float

    def elapsed(self) -> float:
        """Seconds of the line since the beginning."""
        return (_monotonic() - self.begun) * self.factor

    def argument(self) -> str:
        """For the command of a program."""
        return json.dumps(astuple(self))


def use(clock: FastClock) -> None:
    """Let this process live by a clock. Before anything of Lineside is imported."""
    wait = threading.Event.wait

    def wait_shorter(event: threading.Event, timeout: float | None = None) -> bool:
        return wait(event, None if timeout is None else timeout / clock.factor)

    wall = [clock.wall]

    def step(number: int, _frame: object) -> None:
        wall[0] += YEAR_S if number == AHEAD else -YEAR_S

    for number in (AHEAD, BACK):
        signal.signal(number, step)
    time.time = lambda: wall[0] + clock.elapsed()
    time.monotonic = lambda: clock.begun + clock.elapsed()
    time.sleep = lambda seconds: _sleep(seconds / clock.factor)
    threading.Event.wait = wait_shorter  # type: ignore[method-assign]


def run(clock: FastClock, main: Coroutine[Any, Any, None]) -> None:
    """Run a coroutine in an event loop of a clock."""

    class FastSelector(selectors.EpollSelector):
        def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
            return super().select(timeout and timeout / clock.factor)

    with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(FastSelector())) as runner:
        runner.run(main)


def serve(clock: FastClock, config: str) -> None:
    """Serve a site, for which others stand in as workers."""
    import uvloop

    from app.cli import cli
    from app.cli.hosting import WorkerProcesses

    uvloop.run = lambda main, **_: run(clock, main)  # type: ignore[assignment]
    WorkerProcesses.start = lambda *_: None  # type: ignore[method-assign, assignment]
    cli.main(["serve", "--config", config], prog_name="lineside")


class _Unrest:
    """E-stops that come and go."""

    def __init__(self) -> None:
        self._sent = 0

    def inputs(self, unit: int) -> int:
        """The inputs of the next reading."""
        from benchmarks.feeder import HEALTHY, RUN

        self._sent += 1
        return RUN if unit == 1 and self._sent // EVERY % 2 else RUN | HEALTHY


def feed(clock: FastClock, url: str, units: str, rate: str) -> None:
    """Feed every bus of a site."""
    from websockets.exceptions import InvalidHandshake

    from benchmarks.feeder import feed as feed_bus

    async def one(bus: str, token: str) -> None:
        while True:
            # Sixteen at once need longer than a server gives one, which is short on its clock.
            with suppress(InvalidHandshake, OSError):
                await feed_bus(url, token, int(units), float(rate), _Unrest(), bus)
            await asyncio.sleep(clock.factor)

    async def every() -> None:
        await asyncio.gather(*(one(*line.split()) for line in sys.stdin))

    run(clock, every())


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
    shared = FastClock(*json.loads(sys.argv[1]))
    use(shared)
    {"serve": serve, "feed": feed}[sys.argv[2]](shared, *sys.argv[3:])
