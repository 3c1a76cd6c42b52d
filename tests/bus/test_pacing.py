"""How often something is allowed; retries that fail soon slow down, and what worked is retried at once."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace

import pytest
from structlog.testing import capture_logs

from bus.contract.session import ClockOffset
from bus.errors import WireError
from bus.line.opener import Opener
from bus.line.port import EndedWhileOpening, OpenPort, Receiver
from bus.messages import Message
from bus.pacing import JITTER, MAX_PAUSE_S, MAX_USEFUL_PAUSE_S, STABLE_S, Bucket, ReconnectDelay
from bus.worker.outbox import Outbox
from bus.worker.uplink import REFUSED_PAUSE_S, RefusedByAppError, Uplink
from tests.bus.test_uplink import FakeReceiver
from tests.bus.virtual_line import run_virtually


def test_it_is_used_up_and_comes_back() -> None:
    bucket = Bucket(per_s=2.0, capacity=3)
    assert [bucket.take(0.0) for _ in range(4)] == [True, True, True, False]
    assert [bucket.take(0.5) for _ in range(2)] == [True, False]
    assert [bucket.take(100.0) for _ in range(4)] == [True, True, True, False]


def test_an_amount_is_taken_as_one_or_not_at_all() -> None:
    bucket = Bucket(per_s=2.0, capacity=3)
    assert [bucket.take(0.0, 2), bucket.take(0.0, 2), bucket.take(0.0, 1)] == [True, False, True]
    assert bucket.wait_s(0.0, 2) == pytest.approx(1.0)


def test_a_clock_that_steps_back_costs_nothing() -> None:
    bucket = Bucket(per_s=2.0, capacity=3)
    assert all(bucket.take(100.0) for _ in range(3))
    assert [bucket.take(at) for at in (0.0, 0.4, 0.5)] == [False, False, True]


def test_removed_amounts_leave_room_up_to_the_capacity() -> None:
    bucket = Bucket(per_s=1.0, capacity=1)
    bucket.fill(0.0)
    assert not bucket.has_room(0.0)
    bucket.pour(-5.0, 0.0)
    assert [bucket.take(0.0) for _ in range(2)] == [True, False]


DAY_S = 86_400.0
CAUSES = ("connection_refused", "connection_closed")


def middle() -> float:
    """No jitter."""
    return 0.5


def test_the_pause_doubles_up_to_its_longest() -> None:
    backoff = ReconnectDelay(middle)
    assert [backoff.ended(0.0) for _ in range(8)] == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]


def test_what_lasted_has_worked() -> None:
    backoff = ReconnectDelay(middle)
    for _ in range(9):
        backoff.ended(0.0)
    assert backoff.ended(STABLE_S) == 0.0
    assert backoff.ended(0.0) == 0.5


@pytest.mark.parametrize("random", [0.0, 1.0])
def test_many_do_not_come_back_together(random: float) -> None:
    backoff = ReconnectDelay(lambda: random)
    assert backoff.ended(0.0) == pytest.approx(0.5 * (1 - JITTER + 2 * JITTER * random))


def test_a_hundred_thousand_ends_are_worth_a_dozen_and_a_half_lines() -> None:
    backoff = ReconnectDelay(middle)
    lines = 0
    for _ in range(100_000):
        backoff.ended(0.0)
        lines += backoff.is_worth_logging
    assert lines < 20


# --- the port ------------------------------------------------------------------------------------


class Port:
    """Open until it is dropped."""

    def check(self) -> list[str]:
        """It is always there."""
        return []

    def close(self) -> None:
        """Nothing to close."""


class PlayedLoop:
    """The part of the loop that the opener needs. An opening lasts as ``lasts`` states and has
    ``responses``.
    """

    def __init__(
        self,
        lasts: Callable[[int], float | None],
        responses: int = 0,
        failure: Callable[[int], WireError] = lambda _: WireError(Message("port_missing")),
    ) -> None:
        self.lasts = lasts
        self.failure = failure
        self.clock = SimpleNamespace(now=lambda: asyncio.get_running_loop().time())
        self.bus = SimpleNamespace(port="socket://box:4001")
        self.baud = 9600
        self.roster = SimpleNamespace(unresponsive=frozenset())
        self.port_is_back = lambda: None
        self.link = SimpleNamespace(has_responses=responses > 0)
        self.opened: list[float] = []
        self.lost: asyncio.Future[Message]
        self.tried = 0

    async def open(self, _port: str, _baud: int, receiver: Receiver) -> OpenPort:
        self.tried += 1
        lasts = self.lasts(self.tried)
        if lasts is None:
            raise self.failure(self.tried)
        loop = asyncio.get_running_loop()
        self.opened.append(loop.time())
        self.lost = loop.create_future()
        loop.call_later(lasts, receiver.connection_lost, Message("connection_closed"))
        return Port()  # type: ignore[return-value]

    async def run(self, _port: OpenPort) -> Message:
        return await self.lost

    def lose_port(self, cause: Message) -> None:
        self.lost.set_result(cause)

    def still_closed(self, _cause: Message) -> None:
        """It is known."""


def play(line: PlayedLoop, for_s: float) -> list[str]:
    """Keep the port open for so long, in no time; the log."""

    async def scene() -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(for_s):
                await Opener(line, line.open).run()  # type: ignore[arg-type]

    with capture_logs() as logs:
        run_virtually(scene())
    return [entry["event"] for entry in logs]


def test_a_server_that_accepts_and_closes_is_left_in_peace_for_a_day() -> None:
    """It was opened every half second, with two lines each: 57 MB of log a day."""
    line = PlayedLoop(lambda _: 0.001)
    lines = play(line, DAY_S)
    assert DAY_S / (MAX_PAUSE_S * (1 + JITTER)) < len(line.opened) < DAY_S / MAX_PAUSE_S * 1.4
    assert len(lines) < 40


@pytest.mark.parametrize("worked_s", [STABLE_S, 3600.0])
def test_a_cable_that_is_pulled_and_put_back_is_found_within_a_second(worked_s: float) -> None:
    line = PlayedLoop(lambda tried: None if 1 < tried < 20 else worked_s)
    play(line, worked_s + 30.0)
    ended, again = line.opened[0] + worked_s, line.opened[1]
    assert 18 * 0.5 <= again - ended <= 19 * 0.5 + 0.6, "absent, it is looked for twice a second"


def test_a_bad_contact_is_never_waited_for_longer_than_a_second() -> None:
    line = PlayedLoop(lambda _: 4.0, responses=1)
    play(line, 600.0)
    gaps = [later - earlier - 4.0 for earlier, later in zip(line.opened, line.opened[1:], strict=False)]
    assert max(gaps) <= MAX_USEFUL_PAUSE_S * (1 + JITTER) + 0.001 < 1.0


def test_a_server_that_accepts_and_ends_its_negotiation_is_left_in_peace_too() -> None:
    """With RFC 2217 a port opens only after that; it was opened every half second."""
    line = PlayedLoop(lambda _: None, failure=lambda n: EndedWhileOpening(Message(CAUSES[n % 2])))
    lines = play(line, DAY_S)
    assert DAY_S / (MAX_PAUSE_S * (1 + JITTER)) < line.tried < DAY_S / MAX_PAUSE_S * 1.4
    assert len(lines) < 40


# --- the app -------------------------------------------------------------------------------------


class Flapping(Uplink):
    """An app that accepts and then does as scripted."""

    def __init__(self, end: Callable[[], Exception], lasts_s: float) -> None:
        super().__init__("http://app", "t", Outbox(), FakeReceiver(), ClockOffset(), lambda: 0.0)
        self.accepted: list[float] = []
        self._end, self._lasts_s = end, lasts_s

    async def _connect_once(self) -> None:
        loop = asyncio.get_running_loop()
        self._accepted_at = loop.time()
        self.accepted.append(loop.time())
        if self._lasts_s >= 0:
            self._linked()
        await asyncio.sleep(abs(self._lasts_s))
        raise self._end()


def play_uplink(uplink: Flapping, for_s: float) -> list[str]:
    async def scene() -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(for_s):
                await uplink.run()

    with capture_logs() as logs:
        run_virtually(scene())
    return [entry["event"] for entry in logs]


@pytest.mark.parametrize("lasts_s", [0.01, -0.01], ids=["after its welcome", "before it"])
def test_an_app_that_accepts_and_closes_is_left_in_peace_too(lasts_s: float) -> None:
    uplink = Flapping(lambda: ConnectionError("closed"), lasts_s)
    lines = play_uplink(uplink, DAY_S)
    assert len(uplink.accepted) < DAY_S / MAX_PAUSE_S * 1.7
    assert len(lines) < 40


def test_a_refusal_is_retried_without_backoff() -> None:
    uplink = Flapping(lambda: RefusedByAppError("no"), -0.01)
    lines = play_uplink(uplink, 600.0)
    assert len(uplink.accepted) > 600 / (REFUSED_PAUSE_S * (1 + JITTER)) - 1
    assert len(lines) == 1
