"""The lines in short: their order, their age, and the words on a tile."""

from __future__ import annotations

import msgspec

from app.core.web.formats import UNKNOWN
from app.line.conditions.condition import PRIORITIES, AlarmPriority
from app.line.live.diagnosis import Level
from app.system.peers.board import (
    STALE_AFTER_S,
    LineBoard,
    LineOnBoard,
    LineTiles,
    Peer,
    outline,
    tile_fields,
)
from app.system.peers.summary import CauseSummary, LineSummary
from bus.instants import Monotonic, UnixTime
from bus.messages import Message
from tests.app.screens import translator
from tests.for_each import for_each


def summary(bus: str, level: Level = "", waiting: int = 0) -> LineSummary:
    cause = CauseSummary("unit_offline", 10.0, alarm_in_s=3) if level else None
    counts: dict[AlarmPriority, int] = {"high": waiting} if waiting else {}
    return LineSummary(
        bus,
        "Mill 7",
        level,
        Message.of("line_at_speed", n=8),
        8,
        {"online": 8, "at_speed": 7, "ramping": 1},
        counts,
        counts,
        place="Nip" if level else "",
        cause=cause,
        alarm=Message.of("line_alarm_at", place="Nip", name="Slow") if waiting else None,
        alarm_priority="high" if waiting else "",
        scan_hz=4.56,
        speeds=[None, 100.0, 110.5],
    )


def tile(line: LineOnBoard, language: str = "en") -> dict[str, str]:
    return tile_fields(line, translator(language), UnixTime(100.0))


def test_the_worst_line_comes_first() -> None:
    lines = [summary(name, name) for name in PRIORITIES]
    board = LineBoard(lambda: [summary("well"), summary("alarmed", waiting=2), *reversed(lines)])
    assert [line.bus for line in board.lines()] == [*PRIORITIES, "alarmed", "well"]


def peer(fault: Message | None = None, number: int = 2) -> Peer:
    return Peer(number, "Mill 2", "https://mill2:8443", fault=fault)


def test_a_line_that_is_no_longer_reported_is_never_well() -> None:
    other = peer()
    there = LineOnBoard("there", summary("there"), 7.0, other)
    worse = LineOnBoard("worse", summary("worse", "urgent"), 7.0, other)
    never = LineOnBoard("", None, None, other)
    here = LineOnBoard("here", summary("here"))
    lines = sorted((here, there, never, worse), key=lambda line: line.rank)
    assert [line.bus for line in lines] == ["worse", "", "there", "here"]
    fields = tile(there)
    assert (fields["level"], fields["quality"]) == ("high", "stale")
    assert fields["verdict"] == "No report from Mill 2 for 7 s"
    assert fields["last"] == "Last reported: All 8 units at speed"
    assert fields["speed"] == "110.5"
    assert tile(worse, "de")["level"] == "urgent"
    assert tile(worse, "de")["verdict"] == "Seit 7 s keine Meldung von Mill 2"
    assert (tile(never)["level"], tile(never)["quality"]) == ("high", "stale")
    assert tile(never)["verdict"] == "Waiting for the first report of Mill 2"
    assert tile(here)["quality"] == "live"


def test_a_peer_that_is_away_says_why_and_shows_no_old_figures() -> None:
    away = peer(Message.of("peer_not_reached", reason="Connection refused"))
    fields = tile(LineOnBoard("a", summary("a", waiting=1), 70.0, away))
    assert fields["verdict"] == "No report from Mill 2 for 70 s: Connection refused"
    assert fields["last"] == "Last reported: All 8 units at speed"
    assert (fields["speed"], fields["alarms"], fields["counts"]) == (UNKNOWN, "", "")
    never = tile(LineOnBoard("", None, None, away))
    assert never["verdict"] == "Mill 2 is not read: Connection refused"
    away.fault, away.reported_at = None, Monotonic(1.0)
    assert tile(LineOnBoard("", None, 1.0, away))["verdict"] == "Mill 2 has no lines of its own"


@for_each(
    ("age_s", "words"),
    [(7, "7 s"), (119.9, "119 s"), (120, "2 min"), (7199, "119 min"), (7200, "2 h"), (80_000, "22 h")],
)
def test_the_age_in_words(age_s: float, words: str) -> None:
    line = LineOnBoard("a", summary("a"), age_s, peer())
    assert tile(line)["verdict"] == f"No report from Mill 2 for {words}"


def test_a_line_is_on_the_board_once_and_not_by_way_of_itself() -> None:
    first, second = peer(number=1), peer(number=2)
    board = LineBoard(lambda: [summary("own")], (first, second), lambda: Monotonic(5.0))
    assert board.put(first, {"a": summary("a")}, "instance", "1") is None
    assert board.put(second, {"a": summary("a")}, "instance", "2") == Message.of(
        "peer_is_other", name="Mill 2"
    )
    assert board.put(second, {"a": summary("a")}, board.instance, "3") == Message("peer_is_this_server")
    assert board.put(first, {"b": summary("b")}, "instance", "4") is None, "it may report again"
    assert [line.key for line in board.lines()] == ["line_of/2/", "line_of/own", "line_of/1/b"]
    assert [line.key for line in board.lines(own=True)] == ["line_of/own"]


def test_a_copy_of_a_report_makes_no_line_younger() -> None:
    now = [5.0]
    board = LineBoard(list, [peer()], lambda: Monotonic(now[0]))
    [read] = board.peers
    assert board.put(read, {"a": summary("a")}, "instance", "1") is None
    now[0] += STALE_AFTER_S + 1
    assert board.put(read, {"a": summary("a")}, "instance", "1") == Message("peer_report_copied")
    assert [line.is_stale for line in board.lines()] == [True]
    assert board.put(read, {"a": summary("a")}, "instance", "2") is None
    assert [line.is_stale for line in board.lines()] == [False]


def test_the_words_of_a_line() -> None:
    fields = tile(LineOnBoard("a", summary("a", "high", waiting=1), 0.5), "de")
    assert fields["place"] == "Nip"
    assert fields["verdict"].startswith("Keine Antwort seit")
    assert fields["last"] == "Alarm nach 3 s"
    assert fields["counts"] == "8/8 aktuell · 7 auf Sollwert · 1 in Rampe"
    assert (fields["alarm_mark"], fields["alarms"]) == ("high", "1 Alarm aktiv · 1 zu quittieren")
    assert (fields["scan"], fields["speed"]) == ("0,22 s", "110,5")


def test_a_cleared_alarm_is_never_drawn_as_one_that_is_active() -> None:
    cleared = msgspec.structs.replace(summary("a", waiting=1), active={})
    fields = tile(LineOnBoard("a", cleared))
    assert (fields["alarm_mark"], fields["alarms"]) == ("high cleared", "No alarm active · 1 to acknowledge")
    assert tile(LineOnBoard("a", summary("a")))["alarms"] == "No alarms"


def test_an_alarm_that_may_have_ended_is_unknown_and_not_active() -> None:
    unknown = msgspec.structs.replace(summary("a", waiting=1), active={}, unknown=1)
    fields = tile(LineOnBoard("a", unknown))
    assert (fields["alarm_mark"], fields["alarms"]) == ("high", "1 alarm unknown · 1 to acknowledge")


def test_the_outline_of_a_speed() -> None:
    assert outline([]) == outline([None]) == ""
    assert outline([5.0, 5.0]).startswith("M236 20.0L240 20.0")
    assert outline([0.0, None, 10.0]).count("M") == 2
    assert outline([1000.0, 1000.5]) == "M236 20.4L240 19.6", "noise does not look like movement"


def test_a_speed_has_the_decimals_of_its_unit() -> None:
    at_rest = msgspec.structs.replace(summary("here"), speeds=[0.0], decimals=1)
    assert tile(LineOnBoard("here", at_rest))["speed"] == "0.0"


def test_only_what_has_changed_is_sent() -> None:
    lines = [summary(f"line-{number}") for number in range(3)]
    tiles = LineTiles(LineBoard(lambda: lines), lambda: UnixTime(100.0))
    assert len(tiles.changes(translator())) == 3
    assert tiles.changes(translator()) == {}
    lines[1] = msgspec.structs.replace(lines[1], speeds=[1.0])
    changed = tiles.changes(translator())
    assert list(changed) == ["line_of/line-1"]
    assert set(changed["line_of/line-1"]) == {"speed", "spark"}
    del lines[2]
    assert tiles.changes(translator()) == {"line_of/line-2": {"quality": "gone"}}
    tiles.forget("en")
    assert len(tiles.changes(translator())) == 2


@for_each(
    "tag, names, shown",
    [
        ("en", ["Nip"], ""),
        ("en", ["Nip", "Coater"], "Abnormal: Nip, Coater"),
        ("de", list("abcdefgh"), "Auffällig: a, b, c, d, e, f und 2 weitere"),
    ],
)
def test_several_abnormal_units_are_named(tag: str, names: list[str], shown: str) -> None:
    """On a wallboard whose sections are as small as dots."""
    line = msgspec.structs.replace(summary("dry", "high"), abnormal=names)
    assert tile_fields(LineOnBoard("dry", line), translator(tag), UnixTime(100.0))["abnormal"] == shown
