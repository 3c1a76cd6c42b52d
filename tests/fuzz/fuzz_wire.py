"""Coverage-guided fuzzing of framing, commands and the exchange. Run: python fuzz_wire.py -runs=N -seed=1

Whatever the bytes: nothing raises, the cut does not matter, the bytes of the events are the bytes that came,
a good frame encodes back to itself, and a response is the addressed unit's.
"""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["bus.wire"]):
    from bus.errors import CallerError
    from bus.settings import Dialect
    from bus.wire.commands import (
        IllegalRequest,
        ReadParameterRequest,
        ReadStatusRequest,
        Request,
        SetAndExecuteSpeedRequest,
        WriteParameterRequest,
        encode_reply,
        parse_reply,
        parse_request,
        request_body,
    )
    from bus.wire.describe import describe_bytes
    from bus.wire.exchange import Exchange, Responded
    from bus.wire.framing import FrameDecoder, Received, ReceivedFrame, encode_frame

DIALECTS = (Dialect(), Dialect(checksum_10h="twice", parameter_numbers="bcd", parameter_reply_bytes=2))
REQUESTS: tuple[Request, ...] = (
    ReadStatusRequest(16),
    ReadParameterRequest(1, 16),
    WriteParameterRequest(2, 3, 4),
    SetAndExecuteSpeedRequest(6, 528),
)


def fuzz(data: bytes) -> None:
    """One input: a byte that chooses dialect, request and cut, then the stream."""
    choice, stream = (data[0], data[1:]) if data else (0, b"")
    dialect, request = DIALECTS[choice & 1], REQUESTS[choice >> 1 & 3]
    joined = _events(stream, dialect, len(stream) or 1)
    assert joined == _events(stream, dialect, 1 + (choice >> 3))
    assert b"".join(_wire(event) for event in joined) == stream
    for event in joined:
        if isinstance(event, ReceivedFrame):
            _check_frame(event, request, dialect)
    _check_exchange(stream, request, dialect)
    describe_bytes(stream, dialect)


def _events(stream: bytes, dialect: Dialect, step: int) -> list[Received]:
    decoder = FrameDecoder(dialect)
    events = []
    for at in range(0, len(stream), step):
        events += decoder.feed(stream[at : at + step])
        assert decoder.pending <= 64
    return events + decoder.flush()


def _wire(event: Received) -> bytes:
    return event.wire if isinstance(event, ReceivedFrame) else event.data


def _check_frame(frame: ReceivedFrame, request: Request, dialect: Dialect) -> None:
    assert encode_frame(frame.body, DIALECTS[0]) == frame.wire
    reply = parse_reply(request, frame.body, dialect)
    if reply is not None:
        assert reply.unit == request.unit == frame.body[0]
        assert FrameDecoder(dialect).feed(encode_reply(reply, dialect))
    try:
        again = request_body(parse_request(frame.body, dialect), dialect)
    except (IllegalRequest, CallerError):
        return
    assert again == frame.body


def _check_exchange(stream: bytes, request: Request, dialect: Dialect) -> None:
    exchange = Exchange(request, dialect)
    responses = [event for event in exchange.receive(stream, 0.0) if isinstance(event, Responded)]
    assert len(responses) <= 1
    assert exchange.awaiting == (not responses)


def main() -> None:
    """Fuzz with the arguments of libFuzzer."""
    atheris.Setup(sys.argv, fuzz)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
