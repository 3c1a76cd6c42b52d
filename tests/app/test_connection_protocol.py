"""The input of connections is parsed in turns, each of few bytes and few pieces."""

from __future__ import annotations

import asyncio

import pytest

from app.server.admission.refusal_log import RefusalLog
from app.server.admission.turns import LoopTurns
from app.server.connection.connections import Connection, Connections
from app.server.connection.protocol import (
    MAX_BYTES_A_TURN,
    MAX_PIECES_A_TURN,
    SLICE_BYTES,
    ConnectionProtocol,
)


class Transport(asyncio.Transport):
    """Notes whether it is read."""

    def __init__(self) -> None:
        super().__init__()
        self.is_read = True

    def pause_reading(self) -> None:
        self.is_read = False

    def resume_reading(self) -> None:
        self.is_read = True


class Parser(ConnectionProtocol):
    """Finds ``pieces`` in each slice; ``turns_taken`` has the bytes that were parsed in each turn."""

    def __init__(self, turns: LoopTurns, key: str, pieces: int = 0) -> None:
        super().__init__(open_connections=Connections(), turns=turns, refusals=RefusalLog())
        self.connection = Connection("192.0.2.1", None, account=key)
        self.transport = self.fake = Transport()
        self._pieces_a_slice = pieces
        self.parsed: list[bytes] = []
        self.turns_taken: list[int] = []
        self.is_ready = True

    def _parse(self, data: bytes) -> None:
        self.parsed.append(data)
        self._pieces += self._pieces_a_slice

    def _takes_input(self, size: int) -> bool:
        return size > 0

    def _is_ready(self) -> bool:
        return self.is_ready

    def _take_turn(self) -> None:
        before = len(self._unparsed)
        super()._take_turn()
        self.turns_taken.append(before - len(self._unparsed))

    def allow(self) -> None:
        self.is_ready = True
        self._go_on()

    @property
    def waiting(self) -> int:
        return len(self._unparsed)


async def parsed(*parsers: Parser) -> None:
    async with asyncio.timeout(60):
        while any(parser.waiting for parser in parsers):  # noqa: ASYNC110
            await asyncio.sleep(0)


async def test_a_short_request_is_parsed_at_once() -> None:
    parser = Parser(LoopTurns(), "a")
    parser.data_received(b"GET")
    assert (parser.parsed, parser.fake.is_read) == ([b"GET"], True)


@pytest.mark.parametrize(("pieces", "most"), [(0, MAX_BYTES_A_TURN), (50, 2 * SLICE_BYTES)])
async def test_a_turn_has_few_bytes_and_few_pieces(pieces: int, most: int) -> None:
    parser = Parser(LoopTurns(), "a", pieces)
    sent = bytes(range(256)) * 800
    parser.data_received(sent)
    assert not parser.fake.is_read
    await parsed(parser)
    assert b"".join(parser.parsed) == sent
    assert max(map(len, parser.parsed)) == SLICE_BYTES
    assert max(parser.turns_taken) == most
    assert MAX_PIECES_A_TURN < 100
    assert parser.fake.is_read


async def test_one_connection_has_a_turn_in_each_iteration_and_senders_alternate() -> None:
    turns = LoopTurns()
    flood = [Parser(turns, "a", MAX_PIECES_A_TURN) for _ in range(40)]
    other = Parser(turns, "b")
    for parser in flood:
        parser.data_received(b"x" * 2 * SLICE_BYTES)
    assert sum(len(parser.parsed) for parser in flood) == 1
    other.data_received(b"GET")
    while not other.parsed:  # noqa: ASYNC110
        await asyncio.sleep(0)
    assert sum(len(parser.parsed) for parser in flood) < 5
    await parsed(*flood)


async def test_a_short_request_does_not_wait_for_floods_of_the_same_sender() -> None:
    turns = LoopTurns()
    flood = [Parser(turns, "a", MAX_PIECES_A_TURN) for _ in range(40)]
    for parser in flood:
        parser.data_received(b"x" * 20 * SLICE_BYTES)
    async with asyncio.timeout(60):
        while not all(parser.parsed for parser in flood):  # noqa: ASYNC110
            await asyncio.sleep(0)
    before = sum(len(parser.parsed) for parser in flood)
    other = Parser(turns, "a")
    other.data_received(b"GET")
    while not other.parsed:  # noqa: ASYNC110
        await asyncio.sleep(0)
    assert sum(len(parser.parsed) for parser in flood) - before < 5
    for parser in flood:
        parser._drop_input()


async def test_what_the_parser_is_not_ready_for_waits_unread() -> None:
    parser = Parser(LoopTurns(), "a")
    parser.is_ready = False
    parser.data_received(b"GET")
    await asyncio.sleep(0)
    assert (parser.parsed, parser.fake.is_read) == ([], False)
    parser.allow()
    await parsed(parser)
    assert (parser.parsed, parser.fake.is_read) == ([b"GET"], True)


async def test_a_connection_that_is_read_before_its_turn_is_held_back_again() -> None:
    turns = LoopTurns()
    Parser(turns, "a").data_received(b"GET")
    parser = Parser(turns, "a")
    parser.data_received(b"G")
    parser.fake.resume_reading()
    parser.data_received(b"ET")
    assert (parser.parsed, parser.fake.is_read) == ([], False)
    await parsed(parser)
    assert (parser.parsed, parser.fake.is_read) == ([b"GET"], True)


async def test_input_that_is_dropped_is_not_parsed() -> None:
    turns = LoopTurns()
    Parser(turns, "a").data_received(b"GET")
    parser = Parser(turns, "a")
    parser.data_received(b"GET")
    parser._drop_input()
    await turns.turn("a")
    await asyncio.sleep(0)
    assert (parser.parsed, parser.fake.is_read) == ([], True)
