"""A complete bus worker on a virtual clock: no port, no waiting, the same seed gives the same bytes.

``VirtualLoop`` never sleeps: its time jumps to the next timer. ``VirtualLine`` puts the simulator's pure line
behind the worker's injected port and clock; an hour of line time takes seconds.
"""

from __future__ import annotations

import asyncio
import inspect
import selectors
from collections import defaultdict
from collections.abc import Awaitable, Callable, Coroutine, Iterable
from functools import wraps
from typing import Any, TypeVar

from bus.contract import (
    Action,
    Command,
    ParameterValue,
    Reading,
    Result,
    UnitScale,
    Update,
)
from bus.errors import WireError
from bus.line.opener import OpenPort, Receiver
from bus.line.timing import Timer
from bus.messages import Message
from bus.settings import BusSettings, UnitSettings
from bus.simulator.line import Faults, SimulatedLine, WireEventKind
from bus.simulator.plant import demo_line
from bus.worker.service import BusWorker

T = TypeVar("T")
EPOCH = 1_790_000_000.0


class _NoSelector(selectors.BaseSelector):
    """Selects nothing, ever; instead of waiting it moves the clock."""

    def __init__(self) -> None:
        self.now = 0.0
        self._inner = selectors.SelectSelector()

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._inner.register(fileobj, events, data)

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        return self._inner.unregister(fileobj)

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout is None:
            raise RuntimeError("everything waits and nothing will ever happen")
        self.now += timeout
        return []

    def close(self) -> None:
        self._inner.close()

    def get_map(self) -> Any:
        return self._inner.get_map()


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop whose time is a number."""

    def __init__(self) -> None:
        self.virtual = _NoSelector()
        super().__init__(self.virtual)
        self._clock_resolution = 1e-9

    def time(self) -> float:
        return self.virtual.now


class VirtualClock:
    """The loop's time as the line's clock."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop

    def now(self) -> float:
        return self._loop.time()

    def epoch(self, now: float) -> float:
        return EPOCH + now

    def settle(self) -> None:
        """Do nothing: this clock is not adjusted."""

    def call_at(self, when: float, callback: Callable[[], None]) -> Timer:
        return self._loop.call_at(when, callback)


class VirtualPort:
    """The host's end of a simulated line."""

    def __init__(
        self, line: SimulatedLine, receiver: Receiver, loop: asyncio.AbstractEventLoop, baud: int
    ) -> None:
        self._line = line
        self._receiver = receiver
        self._loop = loop
        self._alarm: asyncio.TimerHandle | None = None
        self.gone = False
        self.baud = baud
        self._listens = True
        self._gathered = b""
        self.written: list[tuple[float, bytes]] = []

    def write(self, data: bytes) -> None:
        if self.gone:
            raise WireError(Message.of("adapter_gone", port="/dev/virtual"))
        self.written.append((self._loop.time(), data))
        self._line.receive(self._loop.time(), data, self.baud)
        self._advance_later()

    def listen(self, *, now: bool) -> None:
        self._listens = now
        if now and self._gathered:
            self._loop.call_soon(self._hand_over)

    def drop_output(self) -> None:
        """Nothing is ever held back here."""

    def retune(self, baud: int) -> None:
        self.baud = baud

    def check(self) -> list[str]:
        if self.gone:
            raise WireError(Message.of("adapter_gone", port="/dev/virtual"))
        return []

    def close(self) -> None:
        self.gone = True
        if self._alarm is not None:
            self._alarm.cancel()

    def start(self) -> None:
        self._advance()

    def _advance(self) -> None:
        if self.gone:
            return
        self._gathered += self._line.advance(self._loop.time())
        self._hand_over()
        if not self.gone:
            self._advance_later()

    def _hand_over(self) -> None:
        if self._listens and self._gathered and not self.gone:
            data, self._gathered = self._gathered, b""
            self._receiver.data_received(data)

    def _advance_later(self) -> None:
        if self._alarm is not None:
            self._alarm.cancel()
        self._alarm = self._loop.call_at(self._line.wake().at, self._advance)


class VirtualLine:
    """A worker and its plant. ``updates`` is everything that the worker reported."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        units: int = 8,
        *,
        seed: int = 1,
        script: bool = False,
        configured: int | None = None,
        line: SimulatedLine | None = None,
        **bus: Any,
    ) -> None:
        """``line``: what is on the cable instead of simulated units."""
        demo = demo_line(units, seed=seed, script=script)
        self.plant = demo.plant
        self.faults = Faults(seed=seed)
        self.line = line or SimulatedLine(demo.plant, self.faults, baud=bus.get("baud", 9600))
        settings = demo.settings if configured is None else _named(configured)
        self.bus = BusSettings(name="virtual", port="/dev/virtual", unit=tuple(settings), **bus)
        self.loop = loop
        self.plugged = True
        self.port: VirtualPort | None = None
        self.written: list[tuple[float, bytes]] = []
        self.updates: list[Update] = []
        self.raws: defaultdict[int, dict[int, int | None]] = defaultdict(dict)
        """Of each unit the parameters as they were reported last."""
        self.worker = BusWorker(self.bus, VirtualClock(loop), self._open, seed)
        self._results: defaultdict[str, list[Result]] = defaultdict(list)
        self._came = asyncio.Event()
        self.worker.outbox.put = self._put  # type: ignore[method-assign]
        self._count = 0

    def _put(self, updates: Iterable[Update]) -> None:
        for update in updates:
            self.updates.append(update)
            if isinstance(update, ParameterValue):
                self.raws[update.unit][update.number] = update.raw
            elif isinstance(update, Result):
                self._results[update.id].append(update)
                self._came.set()

    async def _open(self, _port: str, baud: int, receiver: Receiver) -> OpenPort:
        if not self.plugged:
            raise WireError(Message.of("port_missing", port="/dev/virtual"))
        self.port = VirtualPort(self.line, receiver, self.loop, baud)
        self.port.written = self.written
        self.port.start()
        return self.port

    def unplug(self) -> None:
        """Pull the cable."""
        self.plugged = False
        assert self.port is not None
        self.port.gone = True
        self.line.unplug()

    def plug(self) -> None:
        """Put it back."""
        self.plugged = True

    async def until(self, true: Callable[[], object], within_s: float = 60.0) -> None:
        """Look every two milliseconds of the line's time."""
        for _ in range(int(within_s / 0.002)):
            if true():
                return
            await asyncio.sleep(0.002)
        raise AssertionError(f"it did not come about within {within_s} s")

    @property
    def units(self) -> range:
        """The addresses of the configuration."""
        return range(1, len(self.bus.unit) + 1)

    def command(
        self,
        action: Action,
        *,
        timeout_s: float = 2.0,
        command_id: str = "",
        typed_with: dict[int, UnitScale] | None = None,
    ) -> str:
        """Send the worker a command; return its id. ``typed_with``: by unit what its value, typed as the unit
        shows it, was converted with."""
        self._count += 1
        command_id = command_id or f"c{self._count}"
        deadline = EPOCH + self.loop.time() + timeout_s
        self.worker.command(Command(command_id, deadline, action, typed_with or {}, typed_with is not None))
        return command_id

    def result_of(self, command_id: str) -> Result | None:
        """Return the result reported for ``command_id``, if any."""
        results = self._results[command_id]
        assert len(results) <= 1, "one command, one result"
        return results[0] if results else None

    async def perform(
        self,
        action: Action,
        *,
        timeout_s: float = 2.0,
        within_s: float = 60.0,
        typed_with: dict[int, UnitScale] | None = None,
    ) -> Result:
        """Command the worker and wait for the result."""
        command_id = self.command(action, timeout_s=timeout_s, typed_with=typed_with)
        try:
            async with asyncio.timeout(within_s):
                while (result := self.result_of(command_id)) is None:
                    self._came.clear()
                    await self._came.wait()
        except TimeoutError:
            raise AssertionError(f"no result of {action} within {within_s} s") from None
        return result

    def readings(self, unit: int | None = None) -> list[Reading]:
        """Return all reported readings, or those of one unit."""
        return [u for u in self.updates if isinstance(u, Reading) and unit in (None, u.unit)]

    def parameters(self) -> list[ParameterValue]:
        """Return all reported parameter values."""
        return [update for update in self.updates if isinstance(update, ParameterValue)]

    def acted(self, unit: int | None = None) -> list[tuple[float, int, bytes]]:
        """The writes that units carried out: when, which unit, the request's body."""
        entries = self.line.record.since(0, WireEventKind.ACTED)
        return [(e.at, e.unit, e.data) for e in entries if unit in (None, e.unit)]


def _named(count: int) -> list[UnitSettings]:
    return [UnitSettings(id=unit, name=f"Unit {unit}") for unit in range(1, count + 1)]


def run(scene: Callable[[VirtualLine], Awaitable[T]], units: int = 8, **settings: Any) -> T:
    """Play ``scene`` against a running worker on a virtual clock; gives what it gives."""

    async def play() -> T:
        line = VirtualLine(asyncio.get_running_loop(), units, **settings)
        working = asyncio.create_task(line.worker.run())
        try:
            return await scene(line)
        finally:
            if working.done():
                working.result()
            working.cancel()
            await asyncio.gather(working, return_exceptions=True)

    return run_virtually(play())


def played(
    units: int = 8, *, play: Callable[..., None] = run, **settings: Any
) -> Callable[[Callable[..., Awaitable[None]]], Callable[..., None]]:
    """Make a test of a scene, as ``run`` plays it. What else the scene takes are fixtures and parameters."""

    def decorate(scene: Callable[..., Awaitable[None]]) -> Callable[..., None]:
        signature = inspect.signature(scene)

        @wraps(scene)
        def test(**fixtures: Any) -> None:
            play(lambda line: scene(line, **fixtures), units, **settings)

        fixtures = list(signature.parameters.values())[1:]
        test.__signature__ = signature.replace(parameters=fixtures)  # type: ignore[attr-defined]
        return test

    return decorate


def run_virtually(main: Coroutine[Any, Any, T]) -> T:
    """``asyncio.run`` in no time."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(main)
