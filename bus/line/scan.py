"""What answers at an address, found out by reading only. Pure: questions out, outcomes in.

An address is asked 81h. Silence ends it there, which makes a scan as quick as the wire allows. What
answers is asked more, always 81h and 85h in turn, so that no late or doubled answer can pass for another:
its own address (#17, which also shows whether it counts parameters in BCD), the last parameter that it
has (the older list ends at #20), how wide a value comes, and how it takes and sends a checksum of 10h.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from typing import Literal

from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.status import status_bits
from bus.contract import FoundUnit
from bus.settings import Dialect
from bus.wire.commands import (
    Nak,
    ParameterReply,
    ReadParameter,
    ReadStatus,
    Reply,
    Request,
    StatusReply,
    encode_request,
    wire_seconds,
)
from bus.wire.framing import DLE, checksum

MARGIN_S = 0.010
"""What the machine and the adapter may add to a unit's turnaround."""
LOOKS = 4
"""How often an address is asked that answers, but not as a unit does."""
TRIES = 2
"""How often a read is asked of a unit before it counts as not answered."""
GARBLED_SHARE = 0.25
"""Above this part of spoilt or doubled answers more than noise is at work."""
OWN_ADDRESS = 17
OWN_ADDRESS_IN_BCD = 0x17
_HIGHEST = max(PARAMETERS)
_READABLE = [number for number, parameter in PARAMETERS.items() if not parameter.secret]

Checksum10h = Literal["once", "twice"]


@dataclass(frozen=True, slots=True)
class Question:
    """One read. ``doubled``: a checksum of 10h is sent twice."""

    request: Request
    doubled: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came within one window."""

    reply: Reply | None = None
    spoilt: bool = False
    """Bytes that are no frame."""
    strange: bool = False
    """Good frames that no unit gives as this answer."""
    twice: bool = False
    """More than one answer."""
    checksum_10h: Checksum10h | None = None
    """How the answer's checksum came, where it was 10h."""
    answered_after_s: float | None = None
    """From the request's last byte to the answer's first."""

    @property
    def silent(self) -> bool:
        """Nothing came at all."""
        return self.reply is None and not (self.spoilt or self.strange or self.twice)


@dataclass(frozen=True, slots=True)
class Found:
    """What is at one address. ``own_address``: what its #17 says, None where it says nothing."""

    unit: int
    baud: int
    kind: Literal["digimax", "garbled", "foreign"]
    parameters: tuple[int, ...] = ()
    remarks: tuple[str, ...] = ()
    remote: bool | None = None
    own_address: int | None = None
    counts_in_bcd: bool = False
    checksum_10h: Checksum10h | None = None
    reply_bytes: tuple[int, ...] = ()
    answered_within_s: float | None = None

    def for_contract(self) -> FoundUnit:
        """The part of it that the app is told."""
        return FoundUnit(self.unit, self.baud, self.kind, list(self.parameters), list(self.remarks))


Examining = Generator[Question, Outcome, Found | None]
Asking = Generator[Question, Outcome, Outcome]


def silent_seconds(baud: int, turnaround_s: float) -> float:
    """What an address costs where nothing answers: the request, the turnaround, one byte, the margin."""
    request = encode_request(ReadStatus(1), Dialect())
    return wire_seconds(len(request) + 1, baud) + turnaround_s + MARGIN_S


def examine(unit: int, baud: int) -> Examining:
    """Everything about one address; None where nobody is. The questions are in the plain dialect."""
    examination = _Examination(unit, baud)
    return (yield from examination.run())


@dataclass
class _Examination:
    unit: int
    baud: int
    outcomes: list[Outcome] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    uncertain: bool = False

    def run(self) -> Examining:
        status = yield from self._status(LOOKS)
        if status is None:
            return self._no_unit()
        own, counts_in_bcd = yield from self._own_address()
        last = yield from self._last_parameter(counts_in_bcd)
        takes = yield from self._takes_checksum_10h()
        if self._garbled_share() > GARBLED_SHARE:
            self.remarks.insert(0, TWO_UNITS)
            return Found(self.unit, self.baud, "garbled", remarks=tuple(self.remarks))
        self._remark_on(own, counts_in_bcd, last)
        return Found(
            self.unit,
            self.baud,
            "digimax",
            parameters=tuple(range(1, last + 1)),
            remarks=tuple(self.remarks),
            remote=status_bits(status.outputs, status.inputs).remote,
            own_address=own,
            counts_in_bcd=counts_in_bcd,
            checksum_10h=self._sends_checksum_10h() or takes,
            reply_bytes=self._reply_bytes(),
            answered_within_s=max(
                (o.answered_after_s for o in self.outcomes if o.answered_after_s is not None), default=None
            ),
        )

    # --- questions -----------------------------------------------------------------------------

    def _ask(self, request: Request, *, doubled: bool = False) -> Asking:
        outcome = yield Question(request, doubled)
        self.outcomes.append(outcome)
        return outcome

    def _status(self, looks: int) -> Generator[Question, Outcome, StatusReply | None]:
        """81h until it is answered as a unit answers; an address that is silent at first is left."""
        for look in range(looks):
            outcome = yield from self._ask(ReadStatus(self.unit))
            if isinstance(outcome.reply, StatusReply):
                return outcome.reply
            if look == 0 and outcome.silent:
                return None
        return None

    def _read(self, number: int, *, doubled: bool = False) -> Generator[Question, Outcome, Reply | None]:
        """85h, with 81h before it as the fence."""
        for _ in range(TRIES):
            yield from self._status(TRIES)
            outcome = yield from self._ask(ReadParameter(self.unit, number), doubled=doubled)
            if outcome.reply is not None:
                return outcome.reply
        return None

    def _own_address(self) -> Generator[Question, Outcome, tuple[int | None, bool]]:
        reply = yield from self._read(OWN_ADDRESS)
        if not isinstance(reply, ParameterReply):
            return None, False
        if reply.raw == self.unit:
            return reply.raw, False
        in_bcd = yield from self._read(OWN_ADDRESS_IN_BCD)
        if isinstance(in_bcd, ParameterReply) and in_bcd.raw == self.unit:
            return in_bcd.raw, True
        return reply.raw, False

    def _last_parameter(self, counts_in_bcd: bool) -> Generator[Question, Outcome, int]:
        """By halving: which exist is taken to be a run from #1 on. The password is not asked for."""
        dialect = Dialect(parameter_numbers="bcd" if counts_in_bcd else "binary")
        low, high = -1, len(_READABLE)
        probe = high - 1
        while high - low > 1:
            reply = yield from self._read(encode_number(_READABLE[probe], dialect))
            if isinstance(reply, ParameterReply):
                low = probe
            else:
                high = probe
                self.uncertain = self.uncertain or reply is None
            probe = (low + high) // 2
        return _READABLE[low] if low >= 0 else 0

    def _takes_checksum_10h(self) -> Generator[Question, Outcome, Checksum10h | None]:
        """A read whose own checksum is 10h, sent once and, if nobody hears it, twice."""
        number = number_for_checksum_10h(self.unit)
        if number == 0 or (number not in _READABLE and number in PARAMETERS):
            return None
        if (yield from self._read(number)) is not None:
            return "once"
        heard = yield from self._read(number, doubled=True)
        return None if heard is None else "twice"

    # --- conclusions ---------------------------------------------------------------------------

    def _no_unit(self) -> Found | None:
        heard = [outcome for outcome in self.outcomes if not outcome.silent]
        if len(heard) < min(2, LOOKS):
            return None
        refused = [outcome.reply.code for outcome in heard if isinstance(outcome.reply, Nak)]
        if refused:
            words = f"refuses 81h with error {refused[0]:02X}h: no DIGIMAX IV, or another protocol (#27)"
            return Found(self.unit, self.baud, "foreign", remarks=(words,))
        if all(outcome.strange for outcome in heard):
            return Found(self.unit, self.baud, "foreign", remarks=(STRANGE,))
        return Found(self.unit, self.baud, "garbled", remarks=(TWO_UNITS_OR_ELSE,))

    def _garbled_share(self) -> float:
        return sum(outcome.spoilt or outcome.twice for outcome in self.outcomes) / len(self.outcomes)

    def _reply_bytes(self) -> tuple[int, ...]:
        replies = [outcome.reply for outcome in self.outcomes]
        return tuple(sorted({reply.width for reply in replies if isinstance(reply, ParameterReply)}))

    def _sends_checksum_10h(self) -> Checksum10h | None:
        seen = {outcome.checksum_10h for outcome in self.outcomes}
        return "twice" if "twice" in seen else "once" if "once" in seen else None

    def _remark_on(self, own: int | None, counts_in_bcd: bool, last: int) -> None:
        if counts_in_bcd:
            self.remarks.append('counts parameters in BCD: set parameter_numbers = "bcd" for this bus')
        elif own is None:
            self.remarks.append("does not say its own address (#17)")
        elif own != self.unit:
            self.remarks.append(
                f"#17 says {own}, not {self.unit}: it counts parameters otherwise, or answers for another"
            )
        if last < _HIGHEST:
            self.remarks.append(
                f"has the parameters 1 to {last} only" if last else "has no parameter to read"
            )
        if self.uncertain:
            self.remarks.append("did not answer every question, so its list may be longer")
        spoilt = sum(outcome.spoilt for outcome in self.outcomes)
        if spoilt:
            self.remarks.append(
                f"{spoilt} of {len(self.outcomes)} answers came with noise: look at the shielding"
            )
        if self._sends_checksum_10h() == "twice":
            self.remarks.append('sends a checksum of 10h twice: set checksum_10h = "twice" for this bus')


TWO_UNITS = "its answers are garbled or come twice: two units at this address? Switch one off and scan again"
TWO_UNITS_OR_ELSE = (
    "every answer is garbled: two units at this address, another protocol, or another baud rate"
)
STRANGE = "answers in whole frames, but not as a DIGIMAX IV does"


def encode_number(number: int, dialect: Dialect) -> int:
    """The PRM byte for ``number``, to be sent in the plain dialect."""
    return number // 10 * 16 + number % 10 if dialect.parameter_numbers == "bcd" else number


def number_for_checksum_10h(unit: int) -> int:
    """The PRM byte that gives an 85h to ``unit`` the checksum 10h; 0, which cannot be asked, for unit 107."""
    return (checksum(bytes((unit, ReadParameter.COMMAND))) - DLE) & 0xFF


def conclude(found: Sequence[Found]) -> list[str]:
    """What only all addresses together show, and what to set for the bus."""
    remarks = []
    owners = [one.own_address for one in found if one.own_address not in (None, one.unit)]
    for owner in sorted({owner for owner in owners if owner is not None}):
        if owners.count(owner) > 1:
            remarks.append(
                f"unit {owner} answers to addresses that are not its own ({owners.count(owner)} of them)"
            )
    if any(one.checksum_10h == "twice" for one in found):
        remarks.append('a checksum of 10h is doubled here: set checksum_10h = "twice"')
    return remarks
