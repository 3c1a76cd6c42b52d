"""At which rate a silent line may be found. Pure: time in seconds is passed in.

Units take a new baud rate (#18) when they are switched off and on, one before the other and nobody says when.
So a line that is wholly silent is asked at its old rate and at its new one in turn, until it answers at the
new one: no unit goes back to the old rate by itself, so from then on a silence is just a silence.
"""

from __future__ import annotations

from bus.instants import Monotonic

LOOK_ELSEWHERE_S = 3.0
"""How long a wholly silent line is asked at one baud rate before it is asked at the other."""


class BaudSearch:
    """``look`` now and then, ``turn`` between two questions: a silent line gets one after the other."""

    def __init__(self, now: Monotonic) -> None:
        self._expected: int | None = None
        self._old: int | None = None
        self._tuned_at = now
        self._turns = False

    def expect(self, baud: int, present: int) -> None:
        """Units that answer at ``present`` come up at ``baud`` once they have been switched off and on; the
        same twice: nothing that was expected before holds any more."""
        self._expected, self._old = (None, None) if baud == present else (baud, present)

    def tuned(self, now: Monotonic) -> None:
        """The port goes at another rate from now on."""
        self._tuned_at = now

    def look(self, now: Monotonic, baud: int, *, responds: bool) -> bool:
        """Whether the other rate is to be tried next; ``answers``: whether any unit does at ``baud``."""
        if self._expected is None:
            return False
        if responds:
            if baud == self._expected:
                self._expected = self._old = None
            return False
        if now - self._tuned_at > LOOK_ELSEWHERE_S:
            self._turns = True
        return self._turns

    def turn(self, baud: int, *, responds: bool) -> int | None:
        """The rate to go on at, where it is time to leave ``baud`` and nobody has answered there since."""
        turns, self._turns = self._turns, False
        if not turns or responds:
            return None
        return self._old if baud == self._expected else self._expected
