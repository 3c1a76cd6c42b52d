"""The clocks of a line, and the time that a response may take.

The clock is injected, so that tests run on a virtual one. The window of a response ends when the unit's
turnaround is over and nothing is coming in any more, or at the latest when the longest response would be
complete, so endless bytes cannot hold it open. Before the response can be complete bytes may be left to
gather: one wake-up instead of one for every few bytes. A process that was kept from running reads the port
before it reports a timeout, because the response may be waiting.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from bus.instants import Monotonic, UnixTime, monotonic_now

if TYPE_CHECKING:
    from bus.line.port import OpenPort

SLEW_S = 0.001
"""The most seconds by which one ``settle`` follows the wall clock's drift; a step beyond STEP_S is followed
fully."""
STEP_S = 1.0
NEVER = Monotonic(math.inf)


class Timer(Protocol):
    """A scheduled call."""

    def cancel(self) -> None:
        """Cancel the call."""


class LineClock(Protocol):
    """The clock of a line, in seconds: ``now`` never goes back, ``epoch`` is what other machines use."""

    def now(self) -> Monotonic:
        """Return the line's own time."""

    def epoch(self, now: Monotonic) -> UnixTime:
        """Return the moment ``now`` in seconds since 1970."""

    def settle(self) -> None:
        """Follow the wall clock a little; called about once a second."""

    def call_at(self, when: Monotonic, callback: Callable[[], None]) -> Timer:
        """Schedule ``callback`` to run at ``when`` (of ``now``), or as soon as possible after it."""


class RealClock:
    """The machine's clocks, a fixed offset apart: frames stay in order when the wall clock is set."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._offset = time.time() - time.monotonic()

    def now(self) -> Monotonic:
        return monotonic_now()

    def epoch(self, now: Monotonic) -> UnixTime:
        return UnixTime(float(now) + self._offset)

    def settle(self) -> None:
        error = time.time() - time.monotonic() - self._offset
        self._offset += error if abs(error) > STEP_S else max(-SLEW_S, min(SLEW_S, error))

    def call_at(self, when: Monotonic, callback: Callable[[], None]) -> Timer:
        return self._loop.call_later(max(0.0, when - self.now()), callback)


QUIET_BYTES = 4
"""The pause of a response, in byte times, after which it is over."""
MIN_QUIET_S = 0.005
MIN_FRAME_GAP_S = 0.020
"""The least pause in seconds that ends a frame: an FTDI adapter whose latency timer cannot be set delivers
received bytes every 16 ms (FTDI AN232B-04, 3.3)."""
MARGIN_S = 0.010
"""The time in seconds that the machine and the adapter may add to a unit's turnaround."""
TIMER_SLACK_S = 0.0005
LATE_S = 0.002
"""The delay of an alarm in seconds from which on the process was kept from running."""
RECHECK_S = 0.001


class Window:
    """The window of a response. ``over`` is called once for each ``open``, with the present moment, unless
    ``close`` comes before. Times are seconds on the line's own clock."""

    def __init__(self, clock: LineClock, over: Callable[[Monotonic], None]) -> None:
        self._clock = clock
        self._over = over
        self._port: OpenPort | None = None
        self._alarm: Timer | None = None
        self._alarm_at = Monotonic(0.0)
        self._ends: Monotonic | None = None
        self._last_moment = Monotonic(0.0)
        self._listen_at: Monotonic | None = None
        self._looked = False
        self._quiet_s = MIN_QUIET_S
        self._quiet_at = Monotonic(0.0)

    def attach(self, port: OpenPort | None, byte_s: float) -> None:
        """Use another port, or none. ``byte_s``: the seconds of a byte on the wire."""
        self._port = port
        self._ends = self._listen_at = None
        self._quiet_s = max(QUIET_BYTES * byte_s, MIN_QUIET_S)

    def open(self, ends: Monotonic, last_moment: Monotonic, listen_at: Monotonic | None = None) -> None:
        """Open the window of an exchange. Until ``listen_at`` bytes may gather."""
        self._ends, self._last_moment, self._looked = ends, last_moment, False
        self._listen_from(listen_at)
        self._ring_at(ends if listen_at is None else listen_at)

    def received(self, now: Monotonic, *, inside_frame: bool) -> None:
        """Note that bytes came in; ``inside_frame``: whether they end amid what may be a frame."""
        self._quiet_at = now + (max(self._quiet_s, MIN_FRAME_GAP_S) if inside_frame else self._quiet_s)

    def shorten(self, ends: Monotonic) -> None:
        """End the window at ``ends`` or as soon as the line is quiet after it."""
        if self._ends is not None and ends < self._ends:
            self._ends = ends
            self._ring_at(ends)

    def close(self) -> None:
        """End the window. Its timer may still expire, without effect: most windows are opened again
        before."""
        self._ends = None
        self._listen_from(None)

    def _listen_from(self, when: Monotonic | None) -> None:
        if self._port is not None and (when is None) != (self._listen_at is None):
            self._port.listen(now=when is None)
        self._listen_at = when

    def _ring_at(self, when: Monotonic) -> None:
        if self._alarm is not None:
            if self._alarm_at <= when:
                return
            self._alarm.cancel()
        self._alarm, self._alarm_at = self._clock.call_at(when, self._ring), when

    def _ring(self) -> None:
        self._alarm = None
        if self._ends is None:
            return
        now = self._clock.now()
        if self._listen_at is not None:
            if now < self._listen_at - TIMER_SLACK_S:
                self._ring_at(self._listen_at)
            else:
                self._listen_from(None)
                self._ring_at(max(self._ends, now + RECHECK_S))
            return
        ends = max(self._ends, min(self._quiet_at, self._last_moment))
        if now < ends - TIMER_SLACK_S:
            self._ends = ends
            self._ring_at(ends)
        elif now > ends + LATE_S and not self._looked:
            self._looked = True
            self._ring_at(now + RECHECK_S)
        else:
            self._over(now)


EARLY = 0.95
"""The part of the least time within which a frame cannot be the response: no unit's clock is so fast that its
UART could still be understood."""
EARLY_TO_BELIEVE = 3
ON_TIME_TO_BELIEVE = 50


class PortPace:
    """The pace of a port: as slow as its baud rate or faster (an unpaced simulator, a device server that
    buffers). The first response shows it, and on a faster port no response is too early."""

    def __init__(self) -> None:
        self.paced: bool | None = None
        self._against = 0

    def on_time(self, took_s: float, least_s: float) -> bool:
        """Return whether a response on a port that is known to be slow is taken whatever came before."""
        return self.paced is True and took_s >= least_s * EARLY

    def believes(self, took_s: float, least_s: float) -> bool:
        """Return whether a response that took ``took_s`` may be taken. ``least_s``: its least time on the
        wire."""
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
