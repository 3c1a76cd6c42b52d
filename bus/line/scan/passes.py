"""Which address a scan requests next. Pure: addresses out, whether one responded in.

A response may get lost, so no address is absent after one request: addresses without a response get a second
request after all had one, and further ones as long as that finds a unit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

from bus.line.exchange.window import MARGIN_S
from bus.settings import Dialect, wire_seconds
from bus.wire.bodies import encode_request
from bus.wire.commands import ReadStatusRequest

PASSES = 2
MAX_PASSES = 4


def no_response_s(baud: int, turnaround_s: float) -> float:
    """Return the cost of an address without a response: the request, the turnaround, one byte, the margin."""
    request = encode_request(ReadStatusRequest(1), Dialect())
    return wire_seconds(len(request) + 1, baud) + turnaround_s + MARGIN_S


class Passes:
    """Iterates over addresses; ``note`` is called with the result of each before the next one."""

    def __init__(self, addresses: Iterable[int]) -> None:
        self._remaining = deque(addresses)
        self._without_response: deque[int] = deque()
        self._addresses = len(self._remaining)
        self._found = 0
        self._done = 0
        """Complete passes."""

    @property
    def settled(self) -> int:
        """Return how many requests are done or no longer needed."""
        without_response = min(self._done + 1, PASSES) * len(self._without_response)
        return PASSES * self._found + without_response + min(self._done, PASSES) * len(self._remaining)

    @property
    def done(self) -> int:
        """Return the same in complete addresses."""
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
        """Note whether the address that was given last responded."""
        unit = self._remaining.popleft()
        if found:
            self._found += 1
        else:
            self._without_response.append(unit)
