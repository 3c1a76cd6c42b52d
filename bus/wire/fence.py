"""Which answers can still be late, and what must be asked before the next question can be trusted.

An answer names its unit and nothing else: neither the command nor the parameter. After a timeout the
answer may be lost or on its way, and on its way it could pass for the answer to what is asked next. So
could the second copy of an answer that comes twice.

The *shape* of an answer is all there is to tell it by: ACK with so many data bytes, or NAK with such
an error code. The rules:

1. Every request that was sent and not surely answered is *outstanding*, oldest first. A unit answers in
   order, so an answer ends all that was outstanding before the first request that can have caused it.
2. The *last* answer of a unit may come once more, but only while the very next request is under way.
3. An answer is believed only if nothing outstanding, nor the last one, can be the cause of it. The one
   exception is the same read sent again with no write between, for its late answer says the same thing.
   The same write sent again is no exception: a late refusal of the first is none of the second.
4. A request needs a fence first when the answers it ordinarily gets are among those that may come late or
   twice. The fence is 81h or 85h, whichever leaves less outstanding: their answers have 11 and at most 4
   data bytes, those to writes have none (86h: at most 4).

So after a lost 81h any write or 85h may follow at once; after a lost write 81h may, and 85h too, but for
a lost 86h; after a lost 85h another 85h or an 86h needs 81h before it; after a lost write another write
does. The same holds right after an answer, at the price of an 81h that would soon be due anyway.
"Illegal command" (86h, 89h) can be the answer to anything, so it is no one's ordinary answer: no unit
that knows the commands gives it, and in doubt it is not believed.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import msgspec

from bus.catalogue.numbers import OWN_ADDRESS
from bus.errors import UnitErrorCode
from bus.settings import Dialect
from bus.wire.commands import ReadParameterRequest, ReadStatusRequest, Request, is_write
from bus.wire.describe import is_secret
from bus.wire.framing import ACK, NAK
from bus.wire.lengths import acknowledged_lengths

LONG_RUN = 3
"""Equal reads in a row beyond this are as good as any number of them."""
MOST_OUTSTANDING = 32
"""An answer that is late by more requests than this to one unit is not reckoned with."""

MOST_FENCES_PLANNED = 4
"""Ahead; each may double what is looked at."""

_ILLEGAL_COMMAND = frozenset((UnitErrorCode.ILLEGAL_COMMAND, UnitErrorCode.ILLEGAL_COMMAND_DFS))
_REFUSALS: dict[int, frozenset[int]] = {
    0x81: frozenset(),
    0x82: frozenset((0x80, 0x81)),
    0x83: frozenset((0x80,)),
    0x84: frozenset((0x80, 0x81)),
    0x85: frozenset((0x82,)),
    0x86: frozenset((0x80, 0x82, 0x83)),
    0x87: frozenset((0x80, 0x84, 0x85)),
    0x88: frozenset((0x80, 0x87, 0x88)),
}
"""[ERR] by command, as the manual lists them, without "illegal command"."""


class Shape(NamedTuple):
    """ACK and the number of data bytes, or NAK and the error code."""

    mark: int
    detail: int


def shape_of(body: bytes) -> Shape | None:
    """The shape of a unit's answer; None for a body that no answer has."""
    if len(body) == 3 and body[1] == NAK:
        return Shape(NAK, body[2])
    if len(body) >= 2 and body[1] == ACK:
        return Shape(ACK, len(body) - 2)
    return None


def ordinary_shapes(request: Request, dialect: Dialect) -> frozenset[Shape]:
    """The answers the manual gives to ``request``, without "illegal command"; none to a broadcast."""
    if request.unit == 0:
        return frozenset()
    return _ordinary(request.COMMAND, acknowledged_lengths(request, dialect))


def possible_shapes(request: Request, dialect: Dialect) -> frozenset[Shape]:
    """Every answer that ``request`` can cause."""
    if request.unit == 0:
        return frozenset()
    return _possible(request.COMMAND, acknowledged_lengths(request, dialect))


@cache
def _ordinary(command: int, lengths: frozenset[int]) -> frozenset[Shape]:
    acks = {Shape(ACK, length) for length in lengths}
    return frozenset(acks | {Shape(NAK, code) for code in _REFUSALS[command]})


@cache
def _possible(command: int, lengths: frozenset[int]) -> frozenset[Shape]:
    return _ordinary(command, lengths) | {Shape(NAK, code) for code in _ILLEGAL_COMMAND}


def fence_needed(timed_out: Request, following: Request, dialect: Dialect | None = None) -> bool:
    """Whether a late answer to ``timed_out`` could be taken for the answer to ``following`` (rule 4)."""
    dialect = dialect or Dialect()
    if timed_out.unit != following.unit or _reads_the_same(timed_out, following):
        return False
    return bool(possible_shapes(timed_out, dialect) & ordinary_shapes(following, dialect))


def fence_for(unit: int, timed_out: Request, dialect: Dialect | None = None) -> Request:
    """The read whose answer nobody can take for a late answer to ``timed_out``."""
    return PendingResponses(unit, dialect or Dialect(), (timed_out,)).fence()


class ShapedResponse(NamedTuple):
    """A request and the shape of what it was answered with."""

    request: Request
    shape: Shape


class PendingResponses(msgspec.Struct, frozen=True):
    """What one unit may still answer late or twice. A value: each step gives the next one."""

    unit: int
    dialect: Dialect
    outstanding: tuple[Request, ...] = ()
    last: ShapedResponse | None = None
    """The answer whose second copy may come into the next exchange."""
    fading: ShapedResponse | None = None
    """The answer whose second copy may come into this one."""
    was_copy: bool = False
    """Whether the last answer may itself have been a second copy, and so ended nothing."""

    def sent(self, request: Request) -> PendingResponses:
        """``request`` has gone out (a broadcast changes nothing, for it has no answer)."""
        if request.unit != self.unit or request.unit == 0:
            return self
        outstanding = self.outstanding
        if not self._is_a_long_run(len(outstanding) - LONG_RUN) or outstanding[-1] != request:
            outstanding = (*outstanding, request)[-MOST_OUTSTANDING:]
        was_copy = self.was_copy and self.last is not None
        return PendingResponses(self.unit, self.dialect, outstanding, None, self.last, was_copy)

    def received(self, body: bytes) -> PendingResponses:
        """A frame of this unit came in, awaited or not (rule 1). What may be a second copy ends nothing; but
        of two of them, one after the other, one is no copy, for no answer comes three times."""
        shape = shape_of(body)
        if shape is None:
            return self
        for position, request in enumerate(self.outstanding):
            if shape in possible_shapes(request, self.dialect):
                may_be_copy = self._may_be_a_copy(shape) and not self.was_copy
                ended = 0 if may_be_copy else position + (not self._is_a_long_run(position))
                answer = ShapedResponse(request, shape)
                return PendingResponses(
                    self.unit, self.dialect, self.outstanding[ended:], answer, self.fading, may_be_copy
                )
        return self

    @property
    def may_hold_secret(self) -> bool:
        """Whether an answer that still may come carries what is not to be kept or shown (#21)."""
        last = () if self.last is None else (self.last.request,)
        return any(is_secret(request) for request in (*self.outstanding, *last))

    def moved_on(self) -> PendingResponses:
        """The bus has asked another unit since; the last answer cannot come again."""
        if self.last is None and self.fading is None:
            return self
        return PendingResponses(self.unit, self.dialect, self.outstanding)

    def _is_a_long_run(self, position: int) -> bool:
        """Whether so many equal reads stand at ``position`` that more of them are not kept: that run ends
        only with an answer that none of them can have caused."""
        run = self.outstanding[position : position + LONG_RUN] if position >= 0 else ()
        return len(run) == LONG_RUN and not is_write(run[0]) and all(sent == run[0] for sent in run)

    def believes(self, request: Request, body: bytes) -> bool:
        """Whether ``body``, which fits ``request``, can only be its answer (rule 3)."""
        late = self._may_be_late(request)
        twice = self._may_come_twice(request)
        if not late and not twice:
            return True
        shape = shape_of(body)
        return shape not in late | twice and (not late or shape in ordinary_shapes(request, self.dialect))

    def fence_before(self, request: Request) -> Request | None:
        """What to ask before ``request``; None where it may follow at once (rule 4)."""
        return self._first_of_fences(request) if self._may_mislead(request) else None

    def fence(self) -> Request:
        """Of the two fences the one whose answer would leave less in doubt."""
        return min(self._fences(), key=self._left_pending_by)

    def _may_mislead(self, request: Request) -> bool:
        shapes = self._may_be_late(request) | self._may_come_twice(request)
        return bool(shapes & ordinary_shapes(request, self.dialect))

    def _first_of_fences(self, request: Request) -> Request:
        """The first of the fewest fences after which ``request`` may follow, if each is answered."""
        best_first = sorted(self._fences(), key=self._left_pending_by)
        reached = {self._after(fence): fence for fence in best_first}
        for _ in range(MOST_FENCES_PLANNED):
            for pending, first in reached.items():
                if not pending._may_mislead(request):
                    return first
            reached = {
                pending._after(fence): first for pending, first in reached.items() for fence in self._fences()
            }
        return self.fence()

    def _fences(self) -> tuple[Request, Request]:
        return ReadStatusRequest(self.unit), ReadParameterRequest(self.unit, OWN_ADDRESS)

    def _after(self, fence: Request) -> PendingResponses:
        """Once ``fence`` has got its shortest acknowledgement."""
        data = bytes(min(acknowledged_lengths(fence, self.dialect)))
        return self.sent(fence).received(bytes((self.unit, ACK, *data)))

    def _may_be_late(self, request: Request) -> set[Shape]:
        """Shapes of late answers that would mislead about ``request``; the same read does not, unless
        a write went out after it."""
        shapes: set[Shape] = set()
        written_since = False
        for sent in reversed(self.outstanding):
            if written_since or not _reads_the_same(sent, request):
                shapes |= possible_shapes(sent, self.dialect)
            written_since = written_since or is_write(sent)
        return shapes

    def _may_be_a_copy(self, shape: Shape) -> bool:
        return any(answer is not None and answer.shape == shape for answer in (self.last, self.fading))

    def _may_come_twice(self, request: Request) -> set[Shape]:
        """The shape of the last answer, with the same exception."""
        if self.last is None:
            return set()
        written_since = any(is_write(sent) for sent in self.outstanding)
        harmless = _reads_the_same(self.last.request, request) and not written_since
        return set() if harmless else {self.last.shape}

    def _left_pending_by(self, fence: Request) -> int:
        lengths = acknowledged_lengths(fence, self.dialect)
        answers = (bytes((self.unit, ACK, *bytes(length))) for length in lengths)
        pending = [
            len(self.sent(fence).received(answer).outstanding) + (not self.believes(fence, answer))
            for answer in answers
        ]
        return max(pending)


class PendingByUnit:
    """The doubts about every unit of one bus."""

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self._units: dict[int, PendingResponses] = {}
        self._last_unit = 0

    def about(self, unit: int) -> PendingResponses:
        """What ``unit`` may still answer late or twice if it were asked now."""
        pending = self._units.get(unit) or PendingResponses(unit, self._dialect)
        return pending if unit == self._last_unit else pending.moved_on()

    def fence_before(self, request: Request) -> Request | None:
        """What to ask before ``request``; None where it may follow at once."""
        return self.about(request.unit).fence_before(request) if request.unit else None

    def may_hold_secret(self, unit: int) -> bool:
        """Whether a late or second answer of ``unit`` may carry what is not to be kept or shown (#21)."""
        pending = self._units.get(unit)
        return pending is not None and pending.may_hold_secret

    def after(self, pending: PendingResponses) -> None:
        """An exchange is over; ``pending`` is what it left."""
        if pending.unit:
            self._units[pending.unit] = pending
            self._last_unit = pending.unit


def _reads_the_same(earlier: Request, later: Request) -> bool:
    return earlier == later and not is_write(later)
