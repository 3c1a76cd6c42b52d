"""How many bytes a response has: the lengths of the manual's command pages, in each dialect."""

from __future__ import annotations

import pytest

from bus.settings import Dialect, wire_seconds
from bus.wire.commands import (
    ExecuteSpeedRequest,
    ReadParameterRequest,
    ReadStatusRequest,
    Request,
    SetAndExecuteSpeedRequest,
    StageSpeedRequest,
    WriteAnalogOutputRequest,
    WriteOutputRequest,
    WriteParameterRequest,
)
from bus.wire.lengths import (
    acknowledged_lengths,
    least_reply_bytes,
    longest_reply_bytes,
    usual_reply_bytes,
)

PLAIN, TWO_BYTES, DOUBLED = Dialect(), Dialect(parameter_reply_bytes=2), Dialect(checksum_10h="twice")


@pytest.mark.parametrize(
    ("request_", "lengths"),
    [
        (ReadStatusRequest(1), {11}),
        (StageSpeedRequest(1, 5), {0}),
        (ExecuteSpeedRequest(1), {0}),
        (SetAndExecuteSpeedRequest(1, 5), {0}),
        (ReadParameterRequest(1, 3), {1, 2, 4}),
        (WriteParameterRequest(1, 3, 4), {0, 1, 2, 4}),
        (WriteOutputRequest(1, 1, True), {0}),
        (WriteAnalogOutputRequest(1, 3), {0}),
    ],
)
def test_data_of_an_acknowledgement(request_: Request, lengths: set[int]) -> None:
    assert acknowledged_lengths(request_, PLAIN) == lengths


def test_a_dialect_may_fix_the_width_of_a_read_parameter_and_of_nothing_else() -> None:
    assert acknowledged_lengths(ReadParameterRequest(1, 3), TWO_BYTES) == {2}
    assert acknowledged_lengths(WriteParameterRequest(1, 3, 4), TWO_BYTES) == {0, 1, 2, 4}


@pytest.mark.parametrize(
    ("request_", "dialect", "least", "usual", "longest"),
    [
        # 10 02 UID ACK, data, 10 03 checksum; the longest has every byte of its body doubled.
        (ReadStatusRequest(1), PLAIN, 18, 18, 31),
        (ReadParameterRequest(1, 3), PLAIN, 8, 11, 17),
        (ReadParameterRequest(1, 3), TWO_BYTES, 9, 9, 13),
        (ReadParameterRequest(1, 3), Dialect(parameter_reply_bytes=4), 11, 11, 17),
        (StageSpeedRequest(1, 5), PLAIN, 7, 8, 11),
        (WriteParameterRequest(1, 3, 1), PLAIN, 7, 11, 17),
        (StageSpeedRequest(1, 5), DOUBLED, 7, 8, 12),
        (ExecuteSpeedRequest(0), DOUBLED, 0, 0, 0),
    ],
)
def test_bytes_on_the_wire(request_: Request, dialect: Dialect, least: int, usual: int, longest: int) -> None:
    assert least_reply_bytes(request_, dialect) == least
    assert usual_reply_bytes(request_, dialect) == usual
    assert longest_reply_bytes(request_, dialect) == longest


def test_a_byte_is_ten_bits() -> None:
    assert wire_seconds(960, 9600) == 1.0
