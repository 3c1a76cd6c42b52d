"""The examination of the addresses of a scan, by reads only. Pure: requests out, outcomes in.

An address is sent 81h. A timeout ends its examination, which makes a scan as fast as the wire allows. A
device that responds is read further, always 81h and 85h in turn, so that no late or duplicate response can
pass for another: its address (#17, which also shows whether it counts parameters in BCD), the last parameter
that it has (the older list ends at #20), the width of a value, and how it takes and sends a checksum of 10h.
A unit that turns at speed meanwhile shows the healthy level of its e-stop.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from bus.catalogue.parameters import OWN_ADDRESS, PARAMETERS
from bus.catalogue.values import status_bits
from bus.line.send import NO_NOISE, LineNoise
from bus.line.timing import MARGIN_S
from bus.messages import Message
from bus.settings import Dialect, wire_seconds
from bus.wire.commands import (
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    Reply,
    Request,
    StatusReply,
    encode_request,
)
from bus.wire.framing import DLE, checksum

Checksum10h = Literal["once", "twice"]
Setting = int | float | str | None

TWO_UNITS = Message("found_two_units")
TWO_UNITS_OR_ELSE = Message("found_garbled")
LATE = Message("found_late")
STRANGE = Message("found_strange")
_HIGHEST = max(PARAMETERS)


@dataclass(frozen=True, slots=True)
class Found:
    """The device found at one address. ``own_address``: the value of its #17, None if it was not read."""

    unit: int
    baud: int
    kind: Literal["digimax", "garbled", "foreign", "late"]
    parameters: tuple[int, ...] = ()
    remarks: tuple[Message, ...] = ()
    remote: bool | None = None
    own_address: int | None = None
    counts_in_bcd: bool = False
    checksum_10h: Checksum10h | None = None
    reply_bytes: tuple[int, ...] = ()
    estop_healthy: Literal[0, 1] | None = None
    """The level of its e-stop bit while it turns at speed; None if it never did."""
    responds_within_s: float | None = None
    late: bool = False
    """Whether some of its responses came after their window."""


def remarks_on(one: Found, *, garbled: int, requests: int, uncertain: bool) -> tuple[Message, ...]:
    """Return remarks about a DIGIMAX IV. ``garbled``: the number of ``requests`` with noise; ``uncertain``:
    whether some had no response."""
    remarks = _on_its_address(one)
    last = len(one.parameters)
    if last < _HIGHEST:
        remarks.append(Message.of("found_parameters", last=last) if last else Message("found_no_parameter"))
    if uncertain:
        remarks.append(Message("found_uncertain"))
    if garbled:
        remarks.append(Message.of("found_noise", n=garbled, all=requests))
    if one.checksum_10h == "twice":
        remarks.append(Message("found_checksum_twice"))
    if one.estop_healthy == 0:
        remarks.append(Message("found_estop_low"))
    return tuple(remarks)


def _on_its_address(one: Found) -> list[Message]:
    if one.counts_in_bcd:
        return [Message("found_bcd")]
    if one.own_address is None:
        return [Message("found_no_address")]
    if one.own_address == one.unit:
        return []
    return [Message.of("found_other_address", own=one.own_address, unit=one.unit)]


def conclude(found: Sequence[Found]) -> list[Message]:
    """Return the remarks that only all addresses together show."""
    remarks = [LATE] if any(one.late for one in found) else []
    owners = [one.own_address for one in found if one.own_address not in (None, one.unit)]
    for owner in sorted({owner for owner in owners if owner is not None}):
        if owners.count(owner) > 1:
            remarks.append(Message.of("found_many_addresses", unit=owner, count=owners.count(owner)))
    differ = [name for name, values in _seen(found).items() if len(values) > 1]
    if differ:
        remarks.append(Message.of("found_settings_differ", settings=differ))
    return remarks


def settings_seen(found: Sequence[Found]) -> dict[str, Setting]:
    """Return the keys of ``[[bus]]`` that suit these units; None if nothing showed the value or units
    differ."""
    return {name: values.pop() if len(values) == 1 else None for name, values in _seen(found).items()}


def _seen(found: Sequence[Found]) -> dict[str, set[Setting]]:
    units = [one for one in found if one.kind == "digimax"]
    return {
        "checksum_10h": {one.checksum_10h for one in units if one.checksum_10h is not None},
        "parameter_numbers": {
            "bcd" if one.counts_in_bcd else "binary"
            for one in units
            if one.counts_in_bcd or one.own_address == one.unit
        },
        # 0 stands for a value that is as wide as its type.
        "parameter_reply_bytes": {
            one.reply_bytes[0] if len(one.reply_bytes) == 1 else 0 for one in units if one.reply_bytes
        },
        "estop_healthy": {one.estop_healthy for one in units if one.estop_healthy is not None},
    }


STATUS_READS = 4
"""The reads of an address that responds, but not as a unit does."""
TRIES = 2
"""The reads of a unit after which it counts as having no response."""
GARBLED_SHARE = 0.25
"""The part of damaged or duplicate responses above which the cause is more than noise."""
OWN_ADDRESS_IN_BCD = 0x17
FIRST_OF_EACH_TYPE = tuple({row.type: number for number, row in reversed(list(PARAMETERS.items()))}.values())
_PLAIN, _DOUBLED = Dialect(), Dialect(checksum_10h="twice")
_READABLE = [number for number, parameter in PARAMETERS.items() if not parameter.secret]


@dataclass(frozen=True, slots=True)
class Probe:
    """A read of a scan. ``doubled``: whether a checksum of 10h is sent twice."""

    request: Request
    doubled: bool = False

    @property
    def dialect(self) -> Dialect:
        return _DOUBLED if self.doubled else _PLAIN


@dataclass(frozen=True, slots=True)
class ProbeOutcome:
    """Everything that came within the window of one probe."""

    reply: Reply | None = None
    noise: LineNoise = NO_NOISE
    checksum_10h: Checksum10h | None = None
    """The way in which a checksum of 10h was sent; None for any other checksum."""
    responded_after_s: float | None = None
    """Seconds from the request's last byte to the response's first."""

    @property
    def no_response(self) -> bool:
        """Whether no byte came."""
        return self.reply is None and self.noise == NO_NOISE


Examining = Generator[Probe, ProbeOutcome, Found | None]
Probing = Generator[Probe, ProbeOutcome, ProbeOutcome]


@dataclass
class Examination:
    """The examination of one address: ``run`` yields probes and returns what was found, or None."""

    unit: int
    baud: int
    outcomes: list[ProbeOutcome] = field(default_factory=list)
    uncertain: bool = False
    doubles: bool = False
    """Whether the unit accepts a checksum of 10h only doubled, so requests are sent that way."""

    def run(self) -> Examining:
        status = yield from self._first_status()
        if status is None:
            return self._no_unit()
        takes = yield from self._takes_checksum_10h()
        self.doubles = takes == "twice"
        own, counts_in_bcd = yield from self._own_address()
        last = yield from self._last_parameter(counts_in_bcd)
        # The width of a value shows only if types have different widths.
        for number in FIRST_OF_EACH_TYPE:
            if number <= last:
                yield from self._read(_number_byte(number, counts_in_bcd))
        garbled, requests = sum(outcome.noise.garbled for outcome in self.outcomes), len(self.outcomes)
        late, doubled = self._surplus()
        if (garbled + doubled) / requests > GARBLED_SHARE:
            return Found(self.unit, self.baud, "garbled", remarks=(TWO_UNITS,))
        replies = [outcome.reply for outcome in self.outcomes]
        one = Found(
            self.unit,
            self.baud,
            "digimax",
            parameters=tuple(range(1, last + 1)),
            remote=status_bits(status.outputs, status.inputs).remote,
            own_address=own,
            counts_in_bcd=counts_in_bcd,
            checksum_10h=self._sends_checksum_10h() or takes,
            reply_bytes=tuple(
                sorted({reply.width for reply in replies if isinstance(reply, ParameterReply)})
            ),
            estop_healthy=self._estop_healthy(),
            late=late > 0,
            responds_within_s=max(
                (o.responded_after_s for o in self.outcomes if o.responded_after_s is not None), default=None
            ),
        )
        remarks = remarks_on(one, garbled=garbled, requests=requests, uncertain=self.uncertain)
        return replace(one, remarks=remarks)

    # --- requests ------------------------------------------------------------------------------

    def _probe(self, request: Request) -> Probing:
        outcome = yield Probe(request, self.doubles)
        self.outcomes.append(outcome)
        return outcome

    def _first_status(self) -> Generator[Probe, ProbeOutcome, StatusReply | None]:
        """Send the first 81h. For unit 111 its checksum is 10h, which some units accept only doubled, so it
        is tried both ways."""
        status = yield from self._status(STATUS_READS)
        if self.outcomes[-1].no_response and checksum(bytes((self.unit, ReadStatusRequest.COMMAND))) == DLE:
            self.doubles = True
            status = yield from self._status(STATUS_READS)
        return status

    def _status(self, looks: int) -> Generator[Probe, ProbeOutcome, StatusReply | None]:
        """Send 81h up to ``looks`` times until a unit's status comes; give up if nothing comes at first."""
        for look in range(looks):
            outcome = yield from self._probe(ReadStatusRequest(self.unit))
            if isinstance(outcome.reply, StatusReply):
                return outcome.reply
            if look == 0 and outcome.no_response:
                return None
        return None

    def _read(self, number: int) -> Generator[Probe, ProbeOutcome, Reply | None]:
        """Send 85h for parameter ``number``, each time after an 81h as the fence."""
        for _ in range(TRIES):
            yield from self._status(TRIES)
            outcome = yield from self._probe(ReadParameterRequest(self.unit, number))
            if outcome.reply is not None:
                return outcome.reply
        return None

    def _own_address(self) -> Generator[Probe, ProbeOutcome, tuple[int | None, bool]]:
        reply = yield from self._read(OWN_ADDRESS)
        if not isinstance(reply, ParameterReply):
            return None, False
        if reply.raw == self.unit:
            return reply.raw, False
        in_bcd = yield from self._read(OWN_ADDRESS_IN_BCD)
        if isinstance(in_bcd, ParameterReply) and in_bcd.raw == self.unit:
            return in_bcd.raw, True
        return reply.raw, False

    def _last_parameter(self, counts_in_bcd: bool) -> Generator[Probe, ProbeOutcome, int]:
        """Search by halving, taking the parameters to be a run from #1 on. The password is not read."""
        low, high = -1, len(_READABLE)
        probe = high - 1
        while high - low > 1:
            reply = yield from self._read(_number_byte(_READABLE[probe], counts_in_bcd))
            if isinstance(reply, ParameterReply):
                low = probe
            else:
                high = probe
                self.uncertain = self.uncertain or reply is None
            probe = (low + high) // 2
        return _READABLE[low] if low >= 0 else 0

    def _takes_checksum_10h(self) -> Generator[Probe, ProbeOutcome, Checksum10h | None]:
        """Send a read whose checksum is 10h, plainly, then doubled; return which one was accepted."""
        number = number_for_checksum_10h(self.unit)
        if number == 0 or (number not in _READABLE and number in PARAMETERS):
            return None
        if not self.doubles and (yield from self._read(number)) is not None:
            return "once"
        self.doubles = True
        value = yield from self._read(number)
        return None if value is None else "twice"

    # --- conclusions ---------------------------------------------------------------------------

    def _no_unit(self) -> Found | None:
        with_response = [outcome for outcome in self.outcomes if not outcome.no_response]
        if len(with_response) < min(2, STATUS_READS):
            return None
        refused = [outcome.reply.code for outcome in with_response if isinstance(outcome.reply, Nak)]
        if refused:
            refuses = Message.of("found_refuses", error=f"{refused[0]:02X}")
            return Found(self.unit, self.baud, "foreign", remarks=(refuses,))
        if all(outcome.noise.unexpected for outcome in with_response):
            return Found(self.unit, self.baud, "foreign", remarks=(STRANGE,))
        return Found(self.unit, self.baud, "garbled", remarks=(TWO_UNITS_OR_ELSE,))

    def _surplus(self) -> tuple[int, int]:
        """Return the number of late responses, at most one for each request without one, and the number of
        duplicates."""
        awaited = late = doubled = 0
        for outcome in self.outcomes:
            paid = min(awaited, outcome.noise.late)
            late, doubled = late + paid, doubled + outcome.noise.late - paid
            awaited += (outcome.reply is None and not outcome.noise.garbled) - paid
        return late, doubled

    def _sends_checksum_10h(self) -> Checksum10h | None:
        seen = {outcome.checksum_10h for outcome in self.outcomes}
        return "twice" if "twice" in seen else "once" if "once" in seen else None

    def _estop_healthy(self) -> Literal[0, 1] | None:
        """Return the healthy e-stop level if the motor turned at speed in every status, since its chain is
        healthy then."""
        replies = [outcome.reply for outcome in self.outcomes]
        statuses = [reply for reply in replies if isinstance(reply, StatusReply)]
        for status in statuses:
            bits = status_bits(status.outputs, status.inputs)
            if not (bits.run and bits.at_speed and status.actual > 0):
                return None
        levels = {status_bits(each.outputs, each.inputs, estop_healthy=0).estop_active for each in statuses}
        return None if len(levels) > 1 else 1 if True in levels else 0


def _number_byte(number: int, in_bcd: bool) -> int:
    """Return the byte PRM for parameter ``number``, to be sent in the plain dialect."""
    return number // 10 * 16 + number % 10 if in_bcd else number


def number_for_checksum_10h(unit: int) -> int:
    """Return the byte PRM that gives an 85h to ``unit`` the checksum 10h; 0 (unreadable) for 107."""
    return (checksum(bytes((unit, ReadParameterRequest.COMMAND))) - DLE) & 0xFF


PASSES = 2
MAX_PASSES = 4


def no_response_s(baud: int, turnaround_s: float) -> float:
    """Return the seconds that an address without a response costs: request, turnaround, one byte, margin."""
    request = encode_request(ReadStatusRequest(1), Dialect())
    return wire_seconds(len(request) + 1, baud) + turnaround_s + MARGIN_S


class Passes:
    """The passes of a scan over addresses; ``note`` is called with the result of each before the next one.

    A response may get lost, so addresses without a response get a second request after all had one, and
    further ones as long as that finds a unit.
    """

    def __init__(self, addresses: Iterable[int]) -> None:
        self._remaining = deque(addresses)
        self._without_response: deque[int] = deque()
        self._addresses = len(self._remaining)
        self._found = 0
        self._done = 0
        """The number of complete passes."""

    @property
    def settled(self) -> int:
        """The number of requests that are done or no longer needed."""
        without_response = min(self._done + 1, PASSES) * len(self._without_response)
        return PASSES * self._found + without_response + min(self._done, PASSES) * len(self._remaining)

    @property
    def done(self) -> int:
        """The number of addresses that are done."""
        return self.settled // PASSES

    def __iter__(self) -> Iterator[int]:
        while self._remaining:
            found_before = self._found
            while self._remaining:
                yield self._remaining[0]
            self._done += 1
            if self._done < (MAX_PASSES if self._found > found_before else PASSES):
                self._remaining, self._without_response = self._without_response, deque()

    def note(self, *, found: bool) -> None:
        """Note whether the address that was yielded last responded."""
        unit = self._remaining.popleft()
        if found:
            self._found += 1
        else:
            self._without_response.append(unit)
