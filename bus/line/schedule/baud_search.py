"""At which rate a line without responses may be found. Pure: time in seconds is passed in.

Units take a new baud rate (#18) when they are switched off and on, one after the other and without notice.
Therefore a line without any response is polled at its old rate and at its new one in turn, until it responds
at the new one: no unit returns to the old rate, so from then on a timeout is just a timeout.
"""

from __future__ import annotations

from bus.instants import Monotonic

LOOK_ELSEWHERE_S = 3.0
"""How long a line without any response is polled at one baud rate before the other."""


class BaudSearch:
    """Call ``turn`` between two requests."""

    def __init__(self, now: Monotonic) -> None:
        self._expected: int | None = None
        self._old: int | None = None
        self._tuned_at = now

    def expect(self, baud: int, present: int) -> None:
        """Units that respond at ``present`` come up at ``baud`` once they have been switched off and on; the
        same twice: no former expectation applies any more.
        """
        self._expected, self._old = (None, None) if baud == present else (baud, present)

    def tuned(self, now: Monotonic) -> None:
        """The port goes at another rate from now on."""
        self._tuned_at = now

    def turn(self, now: Monotonic, baud: int, *, responds: bool) -> int | None:
        """Return the rate to continue at where it is time to leave ``baud``, else None; ``responds``: whether
        any unit does at ``baud``."""
        if responds and baud == self._expected:
            self._expected = self._old = None
        if responds or now - self._tuned_at <= LOOK_ELSEWHERE_S:
            return None
        return self._old if baud == self._expected else self._expected
