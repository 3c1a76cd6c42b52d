"""What every server knows of a line, within the bounds of a notification."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.live.state.bus_live import BusLive
from app.sites.summarize import LineOrigin, SpeedTrace, summary_of, view_of
from app.sites.summary import (
    MAX_NOTICE_BYTES,
    MAX_POINTS,
    POINT_S,
    CauseSummary,
    LineSummary,
    end_notice,
    notices,
    read_line,
    read_notice,
)
from bus.contract import BusFigures, UnitLink
from bus.messages import Message
from tests.app.screens import HEALTHY, line, reading

ORIGIN = LineOrigin("Mill 7", "app-1", 3)


def summarized(bus: BusLive, now: float, blocked: Message | None = None, drifted: str = "") -> LineSummary:
    views = [view_of(bus, number, blocked, drifted, now) for number in bus.units]
    return summary_of(bus, views, (), [], ORIGIN, now)


def test_a_line_at_speed() -> None:
    bus = line().buses["dry"]
    bus.apply([BusFigures(at=100.0, scan_hz=4.5, scan_s=0.2, scan_s_with_one_more=0.3, wire_utilisation=0.9)])
    found = summarized(bus, 100.5)
    assert (found.bus, found.site, found.server, found.epoch) == ("dry", "Mill 7", "app-1", 3)
    assert (found.level, found.cause, str(found.verdict)) == ("", None, "All 2 units at speed")
    assert (found.units, found.states) == (2, {"online": 2, "at_speed": 2})
    assert found.scan_hz == 4.5


def test_the_worst_unit_is_named() -> None:
    bus = line().buses["dry"]
    bus.apply([reading(2, inputs=HEALTHY - 2), UnitLink(unit=1, at=100.0, link="online")])
    found = summarized(bus, 100.5)
    assert (found.level, found.place) == ("urgent", "Unit 2")
    assert found.cause is not None
    assert found.cause.code == "estop_active"
    assert found.cause.cause("urgent").params["motion"] == "stopping"


def test_a_cause_of_the_bus_comes_before_its_units() -> None:
    bus = line().buses["dry"]
    bus.lose_worker(101.0)
    found = summarized(bus, 110.0)
    assert (found.place, found.cause and found.cause.code) == ("dry", "worker_lost")
    assert found.scan_hz is None


def test_a_block_has_its_reason_and_a_drift_another_text() -> None:
    bus = line().buses["dry"]
    blocked = summarized(bus, 100.5, blocked=Message.of("block_by", reason="knife change", who="anna"))
    assert blocked.cause is not None
    assert "knife change" in str(blocked.cause.why)
    drifted = summarized(bus, 100.5, drifted="#3 differs")
    assert drifted.cause is not None
    assert drifted.cause.why == Message("line_drifted")


def test_the_speed_has_a_point_each_ten_seconds_and_gaps() -> None:
    bus, trace = line().buses["dry"], SpeedTrace()
    for second in range(25):
        bus.apply([reading(1, at=100.0 + second)])
        trace.note(bus, 100.0 + second)
    assert list(trace.points) == [120.0, 120.0, 120.0]
    bus.apply([reading(1, at=125.0, actual=1180)])
    trace.note(bus, 125.0)
    assert list(trace.points) == [120.0, 120.0, 118.0], "the newest is of the present"
    trace.note(bus, 130.0)
    assert list(trace.points)[-1] is None, "the reading is old"
    trace.note(bus, 130.0 + 5 * POINT_S)
    assert list(trace.points)[4:] == [None] * 5
    trace.note(bus, 1e9)
    assert len(trace.points) == MAX_POINTS


def of_size(bus: str, reason: str = "", speeds: int = 0) -> LineSummary:
    cause = CauseSummary("blocked", why=Message.of("block_by", reason=reason, who="anna"))
    points = [1234.5] * speeds
    verdict = Message("line_no_units")
    return LineSummary(bus, "Mill", "app-1", 1, "low", verdict, 1, {}, {}, {}, "", cause, speeds=points)


@settings(max_examples=15)
@given(st.lists(st.tuples(st.text(max_size=3000), st.integers(0, MAX_POINTS)), max_size=30))
def test_lines_of_any_size_fit_into_notifications(sizes: list[tuple[str, int]]) -> None:
    lines = [of_size(f"b{number}", *size) for number, size in enumerate(sizes)]
    texts = list(notices("app-1", lines))
    assert all(len(text.encode()) <= MAX_NOTICE_BYTES for text in texts)
    found = [read_line(bytes(each)) for text in texts for each in read_notice(text).lines]
    assert [each.bus for each in found] == [each.bus for each in lines]
    short = [
        (each, line) for each, line in zip(found, lines, strict=True) if len(msgspec.json.encode(line)) < 3000
    ]
    assert all(each == line for each, line in short)


def test_200_lines_take_few_notifications() -> None:
    lines = [of_size(f"line-{number}", "", MAX_POINTS) for number in range(200)]
    assert len(list(notices("app-1", lines))) <= 25


def test_no_line_is_no_notification() -> None:
    assert list(notices("app-1", [])) == []
    assert read_notice(end_notice("app-1")).ends


@pytest.mark.parametrize(
    "text", ["", "x", "{}", '{"server": 1, "lines": []}', '{"server": "a", "lines": {}}']
)
def test_what_no_server_sent_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        read_notice(text)


@pytest.mark.parametrize("text", [b"", b"{}", b'{"bus": "a"}', b"\xff"])
def test_a_line_that_no_server_sent_is_refused(text: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        read_line(text)
