"""A compromised app against a worker: the line goes on being polled, and memory is bounded."""

from __future__ import annotations

import asyncio

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosedOK

from bus.contract import (
    AppMessage,
    ClockSync,
    Command,
    ReadTrace,
    Result,
    SetSpeed,
    WantSnapshot,
    decode_from_app,
    encode,
)
from bus.contract import MalformedMessageError as Malformed
from bus.contract.session import ClockOffset
from bus.worker.outbox import MAX_TRACES, Outbox
from bus.worker.service import MAX_COMMANDS, MAX_RESULTS
from bus.worker.uplink import MAX_MESSAGES_AT_ONCE, MESSAGES_PER_S, Uplink
from tests.attacks.hostile import GARBAGE, broken, encoded, of_type
from tests.bus.fake_app import TOKEN
from tests.bus.test_uplink import FakeReceiver
from tests.bus.virtual_line import EPOCH, VirtualLine, played, run, run_virtually

MESSAGES = of_type(msgspec.inspect.type_info(AppMessage))


@given(st.lists(st.one_of(encoded(MESSAGES), encoded(broken(MESSAGES)), GARBAGE), min_size=5, max_size=20))
def test_no_message_of_the_app_breaks_the_worker(messages: list[bytes]) -> None:
    async def scene(line: VirtualLine) -> None:
        uplink = Uplink(
            ["http://app"], TOKEN, line.worker.outbox, line.worker, line.worker.app_clock, lambda: 0.0
        )
        for data in messages:
            try:
                uplink._take(decode_from_app(data))
            except Malformed:
                continue
        line.worker.app_clock = type(line.worker.app_clock)()
        seen = len(line.readings())
        await line.until(lambda: len(line.readings()) > seen + 3)

    run(scene, 2)


@played(2)
async def test_more_commands_than_the_limit_are_not_taken(line: VirtualLine) -> None:
    await line.until(lambda: line.readings(1))
    requested = [line.command(SetSpeed(1, 640), timeout_s=3600.0) for _ in range(MAX_COMMANDS + 50)]
    ended = [result for each in requested if (result := line.result_of(each)) is not None]
    assert len(ended) == 50
    assert {(result.outcome, "too many commands" in str(result.message)) for result in ended} == {
        ("not_sent", True)
    }


@played(2)
async def test_the_memory_of_commands_is_bounded(line: VirtualLine) -> None:
    await line.until(lambda: line.readings(1))
    for number in range(MAX_RESULTS + 100):
        line.worker.command(Command(f"late-{number}", EPOCH, SetSpeed(1, 640)))
    assert len(line.worker._results) == MAX_RESULTS
    line.command(SetSpeed(1, 640), command_id="kept")
    await line.until(lambda: line.result_of("kept"))
    kept = line.worker._results["kept"]
    assert kept is not None
    assert kept.frames == []


@played(2)
async def test_the_trace_is_read_by_few_at_once_and_remembered_by_none(line: VirtualLine) -> None:
    await line.until(lambda: len(line.readings()) > 20)
    requested = [line.command(ReadTrace(0.0, limit=100)) for _ in range(MAX_TRACES + 5)]
    refused = [result for each in requested if (result := line.result_of(each)) is not None]
    assert [result.outcome for result in refused] == ["not_sent"] * 5
    await line.until(lambda: all(line.result_of(each) for each in requested))
    assert not set(requested) & line.worker._results.keys()


class Flood:
    """A socket that always has one more message."""

    def __init__(self, message: AppMessage, count: int) -> None:
        self._data, self._left = encode(message), count

    async def recv(self) -> bytes:
        if not self._left:
            raise ConnectionClosedOK(None, None)
        self._left -= 1
        return self._data


@pytest.mark.parametrize("message", [WantSnapshot(), ClockSync(app_time=1.0)], ids=["snapshots", "clocks"])
def test_a_flood_is_read_no_faster_than_it_is_meant_to_be(message: AppMessage) -> None:
    """The rest waits in the socket, and the loop is free meanwhile."""

    async def scene() -> float:
        uplink = Uplink(["http://app"], TOKEN, Outbox(), FakeReceiver(), ClockOffset(), lambda: 0.0)
        flood = Flood(message, int(MAX_MESSAGES_AT_ONCE + 10 * MESSAGES_PER_S))
        await uplink._receive(flood)  # type: ignore[arg-type]
        return asyncio.get_running_loop().time()

    assert run_virtually(scene()) == pytest.approx(10.0, rel=0.01)


def test_a_result_is_no_message_of_the_app() -> None:
    with pytest.raises(Malformed):
        decode_from_app(msgspec.msgpack.encode(Result("c", 0.0, "verified")))
