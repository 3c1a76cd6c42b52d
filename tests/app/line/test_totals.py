from __future__ import annotations

import pytest

from app.line.live.diagnosis import abnormal
from app.line.live.fields import name_on_site
from app.line.live.screen import MAX_ENTRIES, NamedCause, entries_of, holders, line_fields
from bus.instants import UnixTime
from tests.app.screens import translator


@pytest.mark.parametrize(
    ("held_by", "english", "german"),
    [
        ({"line": ""}, "", ""),
        ({"line": "anna"}, "anna", "anna"),
        ({"line": "", "wet": ""}, "", ""),
        ({"line": "anna", "wet": "anna"}, "anna, every bus", "anna, jeder Bus"),
        ({"line": "anna", "wet": "ben"}, "line: anna, wet: ben", "line: anna, wet: ben"),
        ({"line": "", "wet": "ben"}, "line: free, wet: ben", "line: frei, wet: ben"),
        (
            {"line": "", "wet": "ben", "dry": ""},
            "wet: ben, the others: free",
            "wet: ben, die anderen: frei",
        ),
        ({"line": "a (token)", "wet": ""}, "line: a (token), wet: free", "line: a (token), wet: frei"),
    ],
)
def test_the_holder_of_control_is_shown_with_the_bus(
    held_by: dict[str, str], english: str, german: str
) -> None:
    texts = [holders(held_by, translator(tag)).replace("\u00a0", " ") for tag in ("en", "de")]
    assert texts == [english, german]


def test_a_unit_is_named_with_its_bus_where_there_are_several() -> None:
    assert name_on_site("wet", "Nip", ["wet"]) == "Nip"
    assert name_on_site("wet", "Nip", ["wet", "dry"]) == "wet · Nip"


def test_what_the_strip_has_no_room_for_is_counted_and_a_bus_is_named() -> None:
    now, english = UnixTime(1_000_000.0), translator("en")
    units = [NamedCause(f"dry/{n}", f"Unit {n}", abnormal("estop_active")) for n in range(1, 41)]
    found = [*units, NamedCause("wet", "wet", abnormal("no_unit_yet"))]
    entries = entries_of(found, english, now)
    assert [entry.key for entry in entries] == [each.key for each in units[: 1 + MAX_ENTRIES]]
    fields = line_fields({}, {}, found, entries, english, now)
    assert (fields["abnormal"], len(fields["strip"])) == ("41", MAX_ENTRIES)
    assert fields["counts"] == "41 abnormal"
    assert fields["named"] == "wet: No unit has responded yet"
