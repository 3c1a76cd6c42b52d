"""The lines in short: their order, their age, and the words on a tile."""

from __future__ import annotations

import msgspec
import pytest

from app.conditions.priority import PRIORITIES, AlarmPriority
from app.live.diagnosis.cause import Level
from app.sites.board import LineBoard, LineOnBoard
from app.sites.fleet import Fleet
from app.sites.summary import CauseSummary, LineSummary
from app.sites.tile import outline, tile_fields
from bus.instants import UnixTime
from bus.messages import Message
from tests.app.screens import translator


def summary(bus: str, level: Level = "", waiting: int = 0) -> LineSummary:
    cause = CauseSummary("unit_offline", 10.0) if level else None
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


def test_a_line_that_is_no_longer_reported_is_never_well() -> None:
    there = LineOnBoard("there", summary("there"), 5.0, "app-2")
    worse = LineOnBoard("worse", summary("worse", "urgent"), 5.0, "app-2")
    never = LineOnBoard("never")
    here = LineOnBoard("here", summary("here"))
    lines = sorted((here, there, never, worse), key=lambda line: line.rank)
    assert [line.bus for line in lines] == ["worse", "never", "there", "here"]
    fields = tile(there)
    assert (fields["level"], fields["quality"]) == ("high", "stale")
    assert fields["verdict"] == "No report from app-2 for 5 s"
    assert fields["last"] == "Last reported: All 8 units at speed"
    assert tile(worse, "de")["level"] == "urgent"
    assert tile(worse, "de")["verdict"] == "Seit 5 s keine Meldung von app-2"
    assert (tile(never)["level"], tile(never)["quality"]) == ("high", "stale")
    assert tile(never)["verdict"] == "No server reports this line"
    assert tile(here)["quality"] == "live"


@pytest.mark.parametrize(
    ("age_s", "words"),
    [(4, "4 s"), (119.9, "119 s"), (120, "2 min"), (7199, "119 min"), (7200, "2 h"), (80_000, "22 h")],
)
def test_the_age_in_words(age_s: float, words: str) -> None:
    assert (
        tile(LineOnBoard("a", summary("a"), age_s, "app-2"))["verdict"] == f"No report from app-2 for {words}"
    )


def test_the_words_of_a_line() -> None:
    fields = tile(LineOnBoard("a", summary("a", "high", waiting=1), 0.5), "de")
    assert fields["place"] == "Nip"
    assert fields["verdict"].startswith("Keine Antwort seit")
    assert fields["counts"] == "8/8 aktuell · 7 auf Sollwert · 1 in Rampe"
    assert fields["alarm"] == "Nip · Slow"
    assert (fields["alarm_mark"], fields["alarms"]) == ("high", "1 hoch · 1 zu quittieren")
    assert (fields["scan"], fields["speed"]) == ("4,6", "110,5")


def test_the_outline_of_a_speed() -> None:
    assert outline([]) == outline([None]) == ""
    assert outline([5.0, 5.0]).startswith("M236 20.0L240 20.0")
    assert outline([0.0, None, 10.0]).count("M") == 2
    assert outline([1000.0, 1000.5]) == "M236 20.4L240 19.6", "noise does not look like movement"


def test_only_what_has_changed_is_sent_and_put_into_words() -> None:
    lines = [summary(f"line-{number}") for number in range(3)]
    fleet = Fleet(LineBoard(lambda: lines), lambda: UnixTime(100.0))
    assert len(fleet.changes(translator())) == 3
    assert fleet.changes(translator()) == {}
    lines[1] = msgspec.structs.replace(lines[1], speeds=[1.0])
    changed = fleet.changes(translator())
    assert list(changed) == ["line_of/line-1"]
    assert set(changed["line_of/line-1"]) == {"speed", "spark"}
    fleet.forget("en")
    assert len(fleet.changes(translator())) == 3
