"""The rules of a scan, with made-up outcomes: what an address is taken for, and which comes next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from bus.line.examination import (
    PASSES,
    Examination,
    Found,
    Passes,
    Probe,
    ProbeOutcome,
    conclude,
    no_response_s,
    number_for_checksum_10h,
    settings_seen,
)
from bus.line.send import LineNoise
from bus.messages import Message
from bus.settings import Dialect
from bus.wire.commands import (
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    StatusReply,
    encode_request,
    is_write,
)
from tests.for_each import for_each

Responder = Callable[[Probe], ProbeOutcome]
NO_RESPONSE = ProbeOutcome()
GARBAGE = ProbeOutcome(noise=LineNoise(garbled=True))


def unit(address: int = 5, *, last: int = 40, bcd: bool = False, twice: bool = False) -> Responder:
    """Return a unit as in the manual, except for the given traits."""

    def respond(probe: Probe) -> ProbeOutcome:
        request = probe.request
        if isinstance(request, ReadStatusRequest):
            return ProbeOutcome(StatusReply(address, 0, 0, 0, 0x40, 2), responded_after_s=0.002)
        assert isinstance(request, ReadParameterRequest)
        if encode_request(request, Dialect())[-1] == 0x10 and probe.doubled is not twice:
            return NO_RESPONSE
        number = request.number // 16 * 10 + request.number % 16 if bcd else request.number
        if number > last:
            return ProbeOutcome(Nak(address, 0x82))
        return ProbeOutcome(ParameterReply(address, address if number == 17 else 0, 4))

    return respond


def outcome_of(respond: Responder, address: int = 5) -> tuple[Found | None, list[Probe]]:
    examination = Examination(address, 9600).run()
    probes: list[Probe] = []
    try:
        probe = next(examination)
        while True:
            probes.append(probe)
            probe = examination.send(respond(probe))
    except StopIteration as end:
        return end.value, probes


def found(respond: Responder, address: int = 5) -> Found:
    one, probes = outcome_of(respond, address)
    assert one is not None
    assert not any(is_write(probe.request) for probe in probes)
    assert all(getattr(probe.request, "number", 0) != 21 for probe in probes)
    return one


def test_an_address_without_a_response_is_probed_once() -> None:
    one, probes = outcome_of(lambda _: NO_RESPONSE)
    assert one is None
    assert probes == [Probe(ReadStatusRequest(5))]


def test_a_unit() -> None:
    one = found(unit())
    assert (one.kind, one.parameters, one.remarks) == ("digimax", tuple(range(1, 41)), ())
    assert (one.own_address, one.counts_in_bcd, one.remote, one.reply_bytes) == (5, False, True, (4,))
    assert one.checksum_10h == "once"
    assert one.responds_within_s == 0.002


@pytest.mark.parametrize("last", [1, 16, 19, 20, 22, 33, 39, 40])
def test_how_far_the_list_goes(last: int) -> None:
    one = found(unit(last=last))
    assert one.parameters == tuple(range(1, last + 1))
    assert (Message.of("found_parameters", last=last) in one.remarks) == (last < 40)


def test_between_two_parameters_81h_is_sent() -> None:
    """Otherwise a late or duplicate response to 85h could pass for that to the next one."""
    _, probes = outcome_of(unit(last=20))
    commands = [probe.request.COMMAND for probe in probes]
    assert all(not (a == b == ReadParameterRequest.COMMAND) for a, b in pairwise(commands))


def test_a_unit_that_counts_in_bcd() -> None:
    one = found(unit(bcd=True))
    assert one.counts_in_bcd
    assert one.own_address == 5
    assert one.parameters == tuple(range(1, 41))
    assert one.remarks[0] == Message("found_bcd")


def test_a_unit_that_responds_for_another_address() -> None:
    def respond(probe: Probe) -> ProbeOutcome:
        outcome = unit(5)(probe)
        wrong = isinstance(outcome.reply, ParameterReply) and outcome.reply.raw == 5
        return replace(outcome, reply=ParameterReply(5, 9, 4)) if wrong else outcome

    one = found(respond)
    assert one.own_address == 9
    assert one.remarks[0] == Message.of("found_other_address", own=9, unit=5)


def test_a_unit_that_wants_a_checksum_of_10h_twice() -> None:
    assert found(unit(twice=True)).checksum_10h == "twice"


def test_the_unit_whose_81h_has_the_checksum_10h() -> None:
    """Unit 111, where it accepts such a checksum only doubled, receives nothing that is sent plainly."""
    plain = unit(111, twice=True)
    one = found(lambda probe: plain(probe) if probe.doubled else NO_RESPONSE, 111)
    assert (one.kind, one.checksum_10h) == ("digimax", "twice")
    assert outcome_of(lambda _: NO_RESPONSE, 111)[0] is None


def test_a_unit_that_sends_a_checksum_of_10h_twice() -> None:
    one = found(lambda probe: replace(unit()(probe), checksum_10h="twice"))
    assert one.checksum_10h == "twice"
    assert Message("found_checksum_twice") in one.remarks


def test_two_units_that_garble_every_response() -> None:
    one = found(lambda _: GARBAGE)
    assert one.kind == "garbled"
    assert one.remarks[0] == Message("found_garbled")


def test_two_units_that_garble_some_responses() -> None:
    turns = iter(range(1000))
    one = found(lambda probe: unit()(probe) if next(turns) % 2 == 0 else GARBAGE)
    assert one.kind == "garbled"


def test_a_response_that_comes_after_its_window_is_late_and_not_doubled() -> None:
    """Of each two requests, the response to the first comes in the window of the second."""
    lost = False

    def respond(probe: Probe) -> ProbeOutcome:
        nonlocal lost
        lost, was_late = not lost and isinstance(probe.request, ReadParameterRequest), lost
        return NO_RESPONSE if lost else replace(unit()(probe), noise=LineNoise(late=int(was_late)))

    one = found(respond)
    assert (one.kind, one.late) == ("digimax", True)


def test_two_units_that_respond_one_after_the_other() -> None:
    one = found(lambda probe: replace(unit()(probe), noise=LineNoise(late=1)))
    assert one.kind == "garbled"


def test_noise_that_is_not_repeated_is_no_unit() -> None:
    outcomes = iter([GARBAGE])
    assert outcome_of(lambda _: next(outcomes, NO_RESPONSE))[0] is None


def test_what_refuses_81h_is_no_digimax() -> None:
    one = found(lambda _: ProbeOutcome(Nak(5, 0x89)))
    assert one.kind == "foreign"
    assert one.remarks[0] == Message.of("found_refuses", error="89")


def test_a_unit_that_responds_to_81h_only() -> None:
    def respond(probe: Probe) -> ProbeOutcome:
        return unit()(probe) if isinstance(probe.request, ReadStatusRequest) else NO_RESPONSE

    one = found(respond)
    assert one.kind == "digimax"
    assert one.parameters == ()
    assert Message("found_no_address") in one.remarks
    assert one.checksum_10h is None


@for_each("address", [address for address in range(1, 256) if address != 107])
def test_every_address_but_one_has_a_read_whose_checksum_is_10h(address: int) -> None:
    request = ReadParameterRequest(address, number_for_checksum_10h(address))
    assert encode_request(request, Dialect())[-1] == 0x10


def test_the_address_whose_read_would_be_of_parameter_0() -> None:
    assert number_for_checksum_10h(107) == 0
    assert found(unit(107), 107).checksum_10h is None


def test_the_read_of_the_password_is_left_out() -> None:
    assert number_for_checksum_10h(86) == 21
    assert found(unit(86), 86).kind == "digimax"


def test_an_address_without_a_response_costs_the_request_the_turnaround_and_a_byte() -> None:
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

    def respond(probe: Probe) -> ProbeOutcome:
        outcome = unit()(probe)
        return replace(outcome, reply=status) if isinstance(outcome.reply, StatusReply) else outcome

    assert found(respond).estop_healthy == healthy


def requested(addresses: range, responses: dict[int, int]) -> tuple[list[int], list[int]]:
    """Return the requested addresses, and the progress after each; ``responses``: unit -> the try that it
    responds to.
    """
    passes, seen, settled = Passes(addresses), list[int](), list[int]()
    for unit in passes:
        seen.append(unit)
        passes.note(found=seen.count(unit) == responses.get(unit))
        settled.append(passes.settled)
    assert settled == sorted(settled)
    assert settled[-1] == PASSES * len(addresses)
    assert passes.done == len(addresses)
    return seen, settled


def test_addresses_without_a_response_are_probed_twice() -> None:
    assert requested(range(1, 4), {2: 1}) == ([1, 2, 3, 1, 3], [1, 3, 4, 5, 6])


def test_passes_repeat_while_they_find_a_unit() -> None:
    assert requested(range(1, 3), {1: 2})[0] == [1, 2, 1, 2, 2]
    assert requested(range(1, 4), {1: 2, 2: 3})[0] == [1, 2, 3, 1, 2, 3, 2, 3, 3]


def test_four_times_at_the_most() -> None:
    assert requested(range(1, 5), {1: 2, 2: 3, 3: 4})[0].count(4) == 4
