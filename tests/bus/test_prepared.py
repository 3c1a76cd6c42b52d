"""Requests prepared beforehand: the very bytes of the codec, in each dialect, and no secret kept."""

from __future__ import annotations

import pytest

from bus.errors import CallerError
from bus.settings import Dialect
from bus.wire.bodies import encode_request
from bus.wire.commands import (
    ExecuteSpeedRequest,
    ReadParameterRequest,
    ReadStatusRequest,
    Request,
    SetAndExecuteSpeedRequest,
    WriteParameterRequest,
)
from bus.wire.lengths import least_reply_bytes, longest_reply_bytes
from bus.wire.prepared import _prepare_read, prepare

DIALECTS = [
    Dialect(),
    Dialect(checksum_10h="twice"),
    Dialect(parameter_numbers="bcd", parameter_reply_bytes=2),
]


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize(
    "request_",
    [
        ReadStatusRequest(111),
        ReadParameterRequest(1, 16),
        SetAndExecuteSpeedRequest(4, 4096),
        ExecuteSpeedRequest(0),
    ],
)
def test_it_equals_the_codecs_output(request_: Request, dialect: Dialect) -> None:
    for _ in range(2):
        prepared = prepare(request_, dialect)
        assert prepared.wire == encode_request(request_, dialect)
        assert prepared.least_reply_bytes == least_reply_bytes(request_, dialect)
        assert prepared.longest_reply_bytes == longest_reply_bytes(request_, dialect)


def test_how_short_a_response_can_be() -> None:
    plain = Dialect()
    assert least_reply_bytes(ReadStatusRequest(1), plain) == 18
    assert least_reply_bytes(ReadParameterRequest(1, 3), plain) == 8
    assert least_reply_bytes(ReadParameterRequest(1, 3), Dialect(parameter_reply_bytes=4)) == 11
    assert least_reply_bytes(WriteParameterRequest(1, 3, 1), plain) == 7
    assert least_reply_bytes(ExecuteSpeedRequest(0), plain) == 0


def test_writes_are_not_kept_for_one_of_them_may_carry_a_password() -> None:
    _prepare_read.cache_clear()
    assert prepare(WriteParameterRequest(1, 21, 4711), Dialect()).secret
    assert _prepare_read.cache_info().currsize == 0
    assert not prepare(ReadParameterRequest(1, 20), Dialect()).secret
    assert _prepare_read.cache_info().currsize == 1


def test_what_no_frame_can_carry() -> None:
    for request in (ReadStatusRequest(0), ReadStatusRequest(256), ReadParameterRequest(1, 0)):
        with pytest.raises(CallerError):
            prepare(request, Dialect())
