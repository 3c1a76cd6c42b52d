"""Numbers and times in one's own writing."""

from __future__ import annotations

from datetime import UTC, datetime

from hypothesis import given
from hypothesis import strategies as st

from app.core.web.formats import UNKNOWN, Formats
from bus.instants import UnixTime
from tests.for_each import for_each

NOON = datetime(2026, 3, 29, 10, 0, tzinfo=UTC).timestamp()
"""The day on which Berlin's clocks went forward: noon there."""


def test_a_typed_number_is_searched_as_it_is_kept() -> None:
    assert Formats("de").typed_number(" 250,0") == "250.0"
    assert Formats("en").typed_number("250,0") == "250,0"
    assert Formats("de").typed_number("Nip, 2,5") == "Nip, 2,5"


@for_each(
    ("raw", "decimals", "english", "german"),
    [
        (12345, 1, "1234.5", "1234,5"),
        (12345, 0, "12345", "12345"),
        (5, 3, "0.005", "0,005"),
        (0, 2, "0.00", "0,00"),
        (99999, None, "99999", "99999"),
        (-15, 1, "-1.5", "-1,5"),
        (None, 1, UNKNOWN, UNKNOWN),
    ],
)
def test_fixed_decimals(raw: int | None, decimals: int | None, english: str, german: str) -> None:
    assert Formats("en").fixed(raw, decimals) == english
    assert Formats("de").fixed(raw, decimals) == german


@given(st.integers(0, 99999), st.integers(0, 4))
def test_fixed_is_exact(raw: int, decimals: int) -> None:
    text = Formats("en").fixed(raw, decimals)
    assert int(text.replace(".", "")) == raw
    assert len(text.partition(".")[2]) == decimals


def test_numbers() -> None:
    assert Formats("de").number(3.14159, 2) == "3,14"
    assert Formats("de").number(None) == UNKNOWN
    assert [Formats(tag).count(17_280) for tag in ("en", "de")] == ["17,280", "17.280"]


def test_times_are_the_sites() -> None:
    berlin = Formats("de", "Europe/Berlin")
    assert berlin.moment(NOON) == "29.03.2026, 12:00:00"
    assert berlin.clock(NOON) == "12:00:00"
    assert berlin.day(NOON) == "29.03.2026"
    assert berlin.iso(NOON) == "2026-03-29T12:00:00.000+02:00"
    assert berlin.moment(None) == UNKNOWN
    assert "12:00:00" in Formats("en", "Europe/Berlin").moment(datetime.fromtimestamp(NOON, UTC))


def test_a_shift_is_its_date_and_its_hours() -> None:
    english, german = Formats("en_GB", "Europe/Berlin"), Formats("de", "Europe/Berlin")
    assert english.minute(UnixTime(NOON)) == "29 Mar 2026, 12:00"
    assert german.hours(UnixTime(NOON), UnixTime(NOON + 8 * 3600)) == "29.03.2026, 12:00\N{EN DASH}20:00"
    assert english.hours(UnixTime(NOON), UnixTime(NOON + 18 * 3600)) == "29 Mar 2026, 12:00\N{EN DASH}06:00"


def test_a_negative_number_has_a_true_minus_sign() -> None:
    assert Formats("de").number(-0.5, 2) == "\N{MINUS SIGN}0,50"


@for_each(
    ("typed", "iso"),
    [
        ("21.11.2026", "2026-11-21"),
        (" 1. 7. 2026 6:05", "2026-07-01T06:05"),
        ("2026-11-21 06:30:15", "2026-11-21T06:30:15"),
        ("2026-11-21T06:30", "2026-11-21T06:30"),
        ("11/21/2026", "11/21/2026"),
        ("yesterday", "yesterday"),
        ("", ""),
    ],
)
def test_a_time_is_typed_as_it_is_shown_or_as_iso_8601(typed: str, iso: str) -> None:
    assert Formats("de").typed_time(typed) == Formats("en_GB").typed_time(typed) == iso


def test_a_field_shows_a_day_in_which_day_and_month_are_not_mistaken() -> None:
    noon = UnixTime(1_795_262_400.0)
    assert Formats("de", "Europe/Berlin").field_minute(noon) == "21.11.2026 13:00"
    assert Formats("en_GB").field_minute(noon) == "2026-11-21 12:00"
    [today, yesterday, week] = Formats("de").recent_days(noon)
    assert today[1:] == ("21.11.2026", "21.11.2026")
    assert yesterday[1:] == ("20.11.2026", "20.11.2026")
    assert week[1:] == ("15.11.2026", "21.11.2026")
    for first, last in (today[1:], week[1:]):
        assert Formats("de").typed_time(first) <= Formats("de").typed_time(last) == "2026-11-21"
