"""The rules of a scan, with made-up outcomes: what one address is taken for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from bus.line.scan.examination import Probe, ProbeOutcome, examine, number_for_checksum_10h
from bus.line.scan.found import Found, conclude, settings_seen
from bus.line.scan.passes import no_response_s
from bus.messages import Message
from bus.settings import Dialect
from bus.wire.bodies import encode_request
from bus.wire.commands import (
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    StatusReply,
    is_write,
)

Answering = Callable[[Probe], ProbeOutcome]
SILENCE = ProbeOutcome()
GARBAGE = ProbeOutcome(garbled=True)


def unit(address: int = 5, *, last: int = 40, bcd: bool = False, twice: bool = False) -> Answering:
    """A unit as the manual has it, but for what is asked otherwise."""

    def answer(question: Probe) -> ProbeOutcome:
        request = question.request
        if isinstance(request, ReadStatusRequest):
            return ProbeOutcome(StatusReply(address, 0, 0, 0, 0x40, 2), answered_after_s=0.002)
        assert isinstance(request, ReadParameterRequest)
        if encode_request(request, Dialect())[-1] == 0x10 and question.doubled is not twice:
            return SILENCE
        number = request.number // 16 * 10 + request.number % 16 if bcd else request.number
        if number > last:
            return ProbeOutcome(Nak(address, 0x82))
        return ProbeOutcome(ParameterReply(address, address if number == 17 else 0, 4))

    return answer


def outcome_of(answering: Answering, address: int = 5) -> tuple[Found | None, list[Probe]]:
    examination = examine(address, 9600)
    asked: list[Probe] = []
    try:
        question = next(examination)
        while True:
            asked.append(question)
            question = examination.send(answering(question))
    except StopIteration as end:
        return end.value, asked


def found(answering: Answering, address: int = 5) -> Found:
    one, asked = outcome_of(answering, address)
    assert one is not None
    assert not any(is_write(question.request) for question in asked)
    assert all(getattr(question.request, "number", 0) != 21 for question in asked)
    return one


def test_a_silent_address_is_asked_once() -> None:
    one, asked = outcome_of(lambda _: SILENCE)
    assert one is None
    assert asked == [Probe(ReadStatusRequest(5))]


def test_a_unit() -> None:
    one = found(unit())
    assert (one.kind, one.parameters, one.remarks) == ("digimax", tuple(range(1, 41)), ())
    assert (one.own_address, one.counts_in_bcd, one.remote, one.reply_bytes) == (5, False, True, (4,))
    assert one.checksum_10h == "once"
    assert one.answered_within_s == 0.002


@pytest.mark.parametrize("last", [1, 16, 19, 20, 22, 33, 39, 40])
def test_how_far_the_list_goes(last: int) -> None:
    one = found(unit(last=last))
    assert one.parameters == tuple(range(1, last + 1))
    assert (Message.of("found_parameters", last=last) in one.remarks) == (last < 40)


def test_between_two_parameters_81h_is_asked() -> None:
    """So that no answer to 85h, late or doubled, can pass for another one's."""
    _, asked = outcome_of(unit(last=20))
    commands = [question.request.COMMAND for question in asked]
    assert all(not (a == b == ReadParameterRequest.COMMAND) for a, b in pairwise(commands))


def test_a_unit_that_counts_in_bcd() -> None:
    one = found(unit(bcd=True))
    assert one.counts_in_bcd
    assert one.own_address == 5
    assert one.parameters == tuple(range(1, 41))
    assert one.remarks[0] == Message("found_bcd")


def test_a_unit_that_answers_for_another_address() -> None:
    def answer(question: Probe) -> ProbeOutcome:
        outcome = unit(5)(question)
        wrong = isinstance(outcome.reply, ParameterReply) and outcome.reply.raw == 5
        return replace(outcome, reply=ParameterReply(5, 9, 4)) if wrong else outcome

    one = found(answer)
    assert one.own_address == 9
    assert one.remarks[0] == Message.of("found_other_address", own=9, unit=5)


def test_a_unit_that_wants_a_checksum_of_10h_twice() -> None:
    assert found(unit(twice=True)).checksum_10h == "twice"


def test_the_unit_whose_81h_has_the_checksum_10h() -> None:
    """Unit 111, where it takes that twice only, hears nothing that is sent plainly."""
    plain = unit(111, twice=True)
    one = found(lambda asked: plain(asked) if asked.doubled else SILENCE, 111)
    assert (one.kind, one.checksum_10h) == ("digimax", "twice")
    assert outcome_of(lambda _: SILENCE, 111)[0] is None


def test_a_unit_that_sends_a_checksum_of_10h_twice() -> None:
    one = found(lambda question: replace(unit()(question), checksum_10h="twice"))
    assert one.checksum_10h == "twice"
    assert Message("found_checksum_twice") in one.remarks


def test_two_units_that_garble_every_answer() -> None:
    one = found(lambda _: GARBAGE)
    assert one.kind == "garbled"
    assert one.remarks[0] == Message("found_garbled")


def test_two_units_that_let_some_answers_through() -> None:
    turns = iter(range(1000))
    one = found(lambda question: unit()(question) if next(turns) % 2 == 0 else GARBAGE)
    assert one.kind == "garbled"


def test_a_response_that_comes_after_its_window_is_late_and_not_doubled() -> None:
    """Of each two requests, the response to the first comes in the window of the second."""
    owed = False

    def answer(question: Probe) -> ProbeOutcome:
        nonlocal owed
        owed, was_owed = not owed and isinstance(question.request, ReadParameterRequest), owed
        return SILENCE if owed else replace(unit()(question), surplus=int(was_owed))

    one = found(answer)
    assert (one.kind, one.late) == ("digimax", True)


def test_two_units_that_answer_one_after_the_other() -> None:
    one = found(lambda question: replace(unit()(question), surplus=1))
    assert one.kind == "garbled"


def test_a_little_noise_makes_a_remark_only() -> None:
    turns = iter(range(1000))
    one = found(lambda question: replace(unit()(question), garbled=next(turns) == 2))
    assert one.kind == "digimax"
    assert "1 of " in str(one.remarks[0])


def test_noise_that_does_not_come_again_is_nobody() -> None:
    outcomes = iter([GARBAGE])
    assert outcome_of(lambda _: next(outcomes, SILENCE))[0] is None


def test_what_refuses_81h_is_no_digimax() -> None:
    one = found(lambda _: ProbeOutcome(Nak(5, 0x89)))
    assert one.kind == "foreign"
    assert one.remarks[0] == Message.of("found_refuses", error="89")


def test_what_answers_in_frames_of_another_shape_is_no_digimax() -> None:
    one = found(lambda _: ProbeOutcome(unexpected=True))
    assert one.kind == "foreign"


def test_a_unit_that_answers_81h_only() -> None:
    def answer(question: Probe) -> ProbeOutcome:
        return unit()(question) if isinstance(question.request, ReadStatusRequest) else SILENCE

    one = found(answer)
    assert one.kind == "digimax"
    assert one.parameters == ()
    assert Message("found_no_address") in one.remarks
    assert one.checksum_10h is None


@pytest.mark.parametrize("address", [address for address in range(1, 256) if address != 107])
def test_every_address_but_one_has_a_read_whose_checksum_is_10h(address: int) -> None:
    request = ReadParameterRequest(address, number_for_checksum_10h(address))
    assert encode_request(request, Dialect())[-1] == 0x10


def test_the_address_whose_read_would_be_of_parameter_0() -> None:
    assert number_for_checksum_10h(107) == 0
    assert found(unit(107), 107).checksum_10h is None


def test_the_read_of_the_password_is_left_out() -> None:
    assert number_for_checksum_10h(86) == 21
    assert found(unit(86), 86).kind == "digimax"


def test_a_silent_address_costs_the_request_the_turnaround_and_a_byte() -> None:
    assert no_response_s(9600, 0.050) == pytest.approx(8 * 10 / 9600 + 0.050 + 0.010)
    assert no_response_s(300, 0.0) == pytest.approx(8 * 10 / 300 + 0.010)


def test_one_unit_behind_many_addresses() -> None:
    strays = [Found(address, 9600, "digimax", own_address=7) for address in (5, 6, 7, 8)]
    assert conclude(strays) == [Message.of("found_many_addresses", unit=7, count=3)]
    assert conclude(strays[2:]) == []


def test_the_dialect_of_the_bus() -> None:
    found = [Found(5, 9600, "digimax", checksum_10h="twice", own_address=5), Found(6, 9600, "digimax")]
    assert conclude(found) == []
    assert settings_seen(found) == {
        "checksum_10h": "twice",
        "parameter_numbers": "binary",
        "parameter_reply_bytes": None,
        "estop_healthy": None,
    }


def test_units_that_differ_in_their_dialect() -> None:
    found = [Found(5, 9600, "digimax", estop_healthy=1), Found(6, 9600, "digimax", estop_healthy=0)]
    (remark,) = conclude(found)
    assert remark == Message.of("found_settings_differ", settings=["estop_healthy"])
    assert settings_seen(found)["estop_healthy"] is None


@pytest.mark.parametrize(
    ("actual", "outputs", "inputs", "healthy"),
    [
        (500, 0xC0, 0b11, 1),
        (500, 0xC0, 0b01, 0),
        (0, 0xC0, 0b01, None),
        (500, 0x40, 0b01, None),
        (500, 0xC0, 0b10, None),
    ],
    ids=["turns", "turns the other way round", "stands", "slows down", "coasts"],
)
def test_what_turns_at_speed_has_no_emergency_stop(
    actual: int, outputs: int, inputs: int, healthy: int | None
) -> None:
    status = StatusReply(5, 500, actual, 0, outputs, inputs)

    def answer(question: Probe) -> ProbeOutcome:
        outcome = unit()(question)
        return replace(outcome, reply=status) if isinstance(outcome.reply, StatusReply) else outcome

    assert found(answer).estop_healthy == healthy
