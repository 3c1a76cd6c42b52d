"""Whether a port is as slow as its baud rate, learned from its responses. Pure."""

from __future__ import annotations

EARLY = 0.95
"""A frame that is there in less than this part of the least time cannot be the response: no unit's clock is
so fast that its UART could still be understood."""
EARLY_TO_BELIEVE = 3
ON_TIME_TO_BELIEVE = 50


class PortPace:
    """A port may be faster than its baud rate (an unpaced simulator, a device server that buffers): that
    shows at its first response, and then no response of it is too early.
    """

    def __init__(self) -> None:
        self.paced: bool | None = None
        self._against = 0

    def on_time(self, took_s: float, least_s: float) -> bool:
        """Whether a response on a port that is known to be slow is taken whatever came before."""
        return self.paced is True and took_s >= least_s * EARLY

    def believes(self, took_s: float, least_s: float) -> bool:
        """Whether a response that took ``took_s`` may be taken; ``least_s``: what it takes on the wire."""
        early = took_s < least_s * EARLY
        if self.paced is None:
            self.paced = not early
        if early != self.paced:
            self._against = 0
            return True
        self._against += 1
        if self._against >= (EARLY_TO_BELIEVE if self.paced else ON_TIME_TO_BELIEVE):
            self.paced, self._against = not self.paced, 0
            return True
        return not early
