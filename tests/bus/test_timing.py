"""The window of a response: when it ends, with and without bytes, and after a stall of the process."""

from __future__ import annotations

from bus.line.timing import MIN_FRAME_GAP_S, RECHECK_S, Window
from tests.bus.played_clock import PlayedClock

BYTE_S = 0.001
QUIET_S = 0.005


class Bench(PlayedClock):
    """A clock whose alarms may fire late, and a port that only records whether it is read."""

    def __init__(self) -> None:
        super().__init__()
        self.listening: list[tuple[float, bool]] = []
        self.over: list[float] = []
        self.window = Window(self, self.over.append)
        self.window.attach(self, BYTE_S)

    def listen(self, *, now: bool) -> None:
        self.listening.append((round(self.time - 100.0, 4), now))

    def write(self, data: bytes) -> None:
        """Not used."""

    def drop_output(self) -> None:
        """Not used."""

    def retune(self, baud: int) -> None:
        """Not used."""

    def check(self) -> list[str]:
        """Not used."""
        return []

    def close(self) -> None:
        """Not used."""

    def pass_time(self, until: float, stalled_until: float = 0.0) -> None:
        """To ``until``; no alarm rings before ``stalled_until``. Seconds from the beginning."""
        self.pass_to(100.0 + until, 100.0 + stalled_until)

    def ended_at(self) -> list[float]:
        return [round(when - 100.0, 4) for when in self.over]


def test_it_ends_at_its_end_once() -> None:
    bench = Bench()
    bench.window.open(100.05, 100.09)
    bench.pass_time(1.0)
    assert bench.ended_at() == [0.05]


def test_bytes_that_come_hold_it_open_but_not_past_the_last_moment() -> None:
    bench = Bench()
    bench.window.open(100.05, 100.09)
    for step in range(100):
        bench.pass_time(step * BYTE_S)
        bench.window.received(bench.time, inside_frame=False)
    bench.pass_time(1.0)
    assert bench.ended_at() == [0.09]


def test_a_response_that_pauses_is_over() -> None:
    bench = Bench()
    bench.window.open(100.05, 100.09)
    bench.pass_time(0.049)
    bench.window.received(bench.time, inside_frame=False)
    bench.pass_time(1.0)
    assert bench.ended_at() == [0.049 + QUIET_S]


def test_a_closed_one_never_ends_and_the_next_has_its_own_time() -> None:
    bench = Bench()
    bench.window.open(100.05, 100.09)
    bench.pass_time(0.02)
    bench.window.close()
    bench.window.open(100.30, 100.35)
    bench.pass_time(1.0)
    assert bench.ended_at() == [0.30]


def test_it_can_be_shortened_but_not_made_longer() -> None:
    bench = Bench()
    bench.window.open(100.05, 100.09)
    bench.window.shorten(100.08)
    bench.window.shorten(100.03)
    bench.pass_time(1.0)
    assert bench.ended_at() == [0.03]


def test_bytes_gather_until_they_are_wanted() -> None:
    bench = Bench()
    bench.window.open(100.05, 100.09, listen_at=100.02)
    bench.pass_time(0.04)
    assert bench.listening == [(0.0, False), (0.02, True)]
    bench.pass_time(1.0)
    assert bench.ended_at() == [0.05]


def test_gathered_bytes_are_received_when_the_exchange_is_over_before_that() -> None:
    bench = Bench()
    bench.window.open(100.05, 100.09, listen_at=100.02)
    bench.pass_time(0.01)
    bench.window.close()
    assert bench.listening == [(0.0, False), (0.01, True)]


def test_an_earlier_alarm_does_not_wake_the_port() -> None:
    bench = Bench()
    bench.window.open(100.03, 100.03)
    bench.window.close()
    bench.window.open(100.10, 100.14, listen_at=100.06)
    bench.pass_time(0.04)
    assert bench.listening == [(0.0, False)]
    bench.pass_time(1.0)
    assert bench.listening == [(0.0, False), (0.06, True)]
    assert bench.ended_at() == [0.10]


def test_a_stalled_process_reads_the_port_before_a_timeout() -> None:
    bench = Bench()
    bench.window.open(100.05, 100.09)
    bench.pass_time(0.3, stalled_until=0.3)
    assert not bench.over
    bench.pass_time(0.3 + RECHECK_S)
    assert bench.ended_at() == [0.301]


def test_a_process_that_stalled_while_bytes_gathered_receives_them_first() -> None:
    bench = Bench()
    bench.window.open(100.05, 100.09, listen_at=100.02)
    bench.pass_time(0.3, stalled_until=0.3)
    assert bench.listening[-1] == (0.3, True)
    assert not bench.over
    bench.window.received(bench.time, inside_frame=False)
    bench.window.close()
    bench.pass_time(1.0)
    assert not bench.over


def test_without_a_port_nothing_rings() -> None:
    bench = Bench()
    bench.window.open(100.05, 100.09, listen_at=100.02)
    bench.window.attach(None, BYTE_S)
    bench.pass_time(1.0)
    assert not bench.over
    assert bench.listening == [(0.0, False)]


def test_a_frame_may_pause_as_long_as_an_adapter_holds_bytes_back() -> None:
    bench = Bench()
    bench.window.open(100.05, 100.15)
    bench.pass_time(0.048)
    bench.window.received(bench.time, inside_frame=True)
    bench.pass_time(0.064)
    assert bench.ended_at() == []
    bench.window.received(bench.time, inside_frame=True)
    bench.pass_time(1.0)
    assert bench.ended_at() == [round(0.064 + MIN_FRAME_GAP_S, 4)]
