"""Which address a scan asks next. Pure: addresses out, whether somebody answered in.

An answer may get lost, so nobody is called absent after one question: the silent addresses are asked once
more when all have been asked, and again as long as that finds somebody.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

from bus.line.exchange.window import MARGIN_S
from bus.settings import Dialect, wire_seconds
from bus.wire.bodies import encode_request
from bus.wire.commands import ReadStatusRequest

PASSES = 2
MOST_PASSES = 4


def no_response_s(baud: int, turnaround_s: float) -> float:
    """What an address costs where nothing answers: the request, the turnaround, one byte, the margin."""
    request = encode_request(ReadStatusRequest(1), Dialect())
    return wire_seconds(len(request) + 1, baud) + turnaround_s + MARGIN_S


class Passes:
    """Iterated over, it gives address after address; whether it answered is said before the next."""

    def __init__(self, addresses: Iterable[int]) -> None:
        self._to_ask = deque(addresses)
        self._unanswered: deque[int] = deque()
        self._addresses = len(self._to_ask)
        self._found = 0
        self._done = 0
        """Whole passes."""

    @property
    def questions(self) -> int:
        """How many questions the scan has, where no address answers."""
        return PASSES * self._addresses

    @property
    def settled(self) -> int:
        """How many of ``questions`` need not be asked any more."""
        asked, to_ask = min(self._done + 1, PASSES), min(self._done, PASSES)
        return PASSES * self._found + asked * len(self._unanswered) + to_ask * len(self._to_ask)

    @property
    def done(self) -> int:
        """The same in whole addresses."""
        return self.settled // PASSES

    def __iter__(self) -> Iterator[int]:
        while self._to_ask:
            found_before = self._found
            while self._to_ask:
                yield self._to_ask[0]
            self._done += 1
            if self._done < (MOST_PASSES if self._found > found_before else PASSES):
                self._to_ask, self._unanswered = self._unanswered, deque()

    def found(self) -> None:
        """The address that was given last answered."""
        self._to_ask.popleft()
        self._found += 1

    def no_response(self) -> None:
        """The address that was given last did not."""
        self._unanswered.append(self._to_ask.popleft())
