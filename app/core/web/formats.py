"""Numbers and times as a reader of one language expects them."""

from __future__ import annotations

import re
from datetime import datetime, timedelta
from decimal import Decimal
from zoneinfo import ZoneInfo

from babel.dates import format_skeleton, format_time
from babel.numbers import format_decimal, get_decimal_symbol

from app.core.messages.languages import UTC, day, locale_of, minute, moment
from bus.instants import UnixTime
from bus.messages import Message, term

HALF_DAY_S = 43_200
UNKNOWN = "\N{EN DASH}"
"""The text in place of a value that was never read."""
MINUS = "\N{MINUS SIGN}"
"""A minus that is as wide as a plus, which the hyphen is not."""


def lasting(seconds: float) -> str:
    """Format a duration in hours, minutes and seconds, such as 7:05:00, the same in every language."""
    all_minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(all_minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"


def length_shown(length: float, measure: str) -> tuple[str, str]:
    """Return a length with one decimal, with a point, and its measure: metres from a kilometre on as
    kilometres."""
    return (f"{length / 1000:.1f}", "km") if measure == "m" and length >= 1000 else (f"{length:.1f}", measure)


_TYPED_TIME = re.compile(
    r"(?:(\d{4})-(\d\d?)-(\d\d?)|(\d\d?)\. ?(\d\d?)\. ?(\d{4}))(?:(?:T|,? +)(\d\d?:\d\d(?::\d\d)?))?",
    re.ASCII,
)


_RECENT = ((term("Today"), 0, 0), (term("Yesterday"), 1, 1), (term("Last 7 days"), 6, 0))
"""Spans of days; each begins and ends a number of days ago."""


class Formats:
    """Formatting for one locale and one time zone."""

    def __init__(self, locale: str, time_zone: str = UTC) -> None:
        self.locale = locale_of(locale)
        self.decimal_sign = get_decimal_symbol(self.locale)
        self._zone = ZoneInfo(time_zone)
        # Dates with strokes may be mistaken in day and month: their locales get ISO 8601 instead.
        has_dots = "." in self.locale.date_formats["short"].pattern
        self._field_day = "%d.%m.%Y" if has_dots else "%Y-%m-%d"

    def point(self, text: str) -> str:
        """Replace the point of a number by this locale's decimal sign."""
        return text.replace(".", self.decimal_sign)

    def typed_number(self, text: str) -> str:
        """Return user input, with a point if it is a number in this locale's format."""
        number = re.fullmatch(rf"\s*(-?\d+){re.escape(self.decimal_sign)}(\d+)\s*", text)
        return f"{number[1]}.{number[2]}" if number else text

    def typed_time(self, text: str) -> str:
        """Return a date as people type it (21.11.2026, 2026-11-21), with or without a time, as ISO 8601; any
        other text unchanged."""
        typed = _TYPED_TIME.fullmatch(text.strip())
        if typed is None:
            return text
        year, month, day = typed.group(1, 2, 3) if typed[1] else typed.group(6, 5, 4)
        return f"{year}-{month:0>2}-{day:0>2}" + (f"T{typed[7].rjust(5, '0')}" if typed[7] else "")

    def field_day(self, at: UnixTime | datetime) -> str:
        """Format a day for a field of a form."""
        return f"{self.local(at):{self._field_day}}"

    def field_minute(self, at: UnixTime | datetime) -> str:
        """Format date and time as a field takes them."""
        return f"{self.local(at):{self._field_day} %H:%M}"

    def recent_days(self, now: UnixTime) -> list[tuple[Message, str, str]]:
        """Return the spans that are chosen most, each with its name, and its first and last day as
        :meth:`field_day`."""
        today = self.local(now)
        return [
            (
                name,
                self.field_day(today - timedelta(days=first)),
                self.field_day(today - timedelta(days=last)),
            )
            for name, first, last in _RECENT
        ]

    def malformed_day(self, text: str, now: UnixTime) -> Message:
        """Return the refusal of a typed day."""
        return Message.of("typed_time_malformed", text=text, example=self.field_day(now))

    def fixed(self, raw: int | None, decimals: int | None) -> str:
        """Format an integer of display units with implied decimals: (12345, 1) → ``1234.5``; no grouping."""
        if raw is None:
            return UNKNOWN
        return self.point(f"{Decimal(raw).scaleb(-(decimals or 0)):f}")

    def count(self, number: int) -> str:
        """Format a number of things, with the separator of thousands of this locale."""
        return format_decimal(number, locale=self.locale)

    def number(self, value: float | Decimal | None, digits: int = 0) -> str:
        """Format a measured value with a fixed number of decimals."""
        return UNKNOWN if value is None else self.point(f"{value:.{digits}f}").replace("-", MINUS)

    def local(self, at: UnixTime | datetime) -> datetime:
        """Return an instant (seconds since the epoch, or aware) in the time zone of the site."""
        if isinstance(at, datetime):
            return at.astimezone(self._zone)
        return datetime.fromtimestamp(float(at), self._zone)

    def moment(self, at: UnixTime | datetime | None) -> str:
        """Format date and time to the second."""
        if at is None:
            return UNKNOWN
        return moment(self.local(at), self.locale)

    def minute(self, at: UnixTime | datetime) -> str:
        """Format date and time to the minute."""
        return minute(self.local(at), self.locale)

    def hours(self, start: UnixTime | datetime, end: UnixTime | datetime) -> str:
        """Format a span of less than a day: its date, and the time of day to the minute at each end."""
        return f"{self.minute(start)}\N{EN DASH}{self.local(end):%H:%M}"

    def day(self, at: UnixTime | datetime) -> str:
        return day(self.local(at), self.locale)

    def clock(self, at: UnixTime | datetime) -> str:
        """Format the time of day to the second."""
        return format_time(self.local(at).time(), "medium", locale=self.locale)

    def since(self, at: UnixTime, now: UnixTime) -> str:
        """Format the time of day to the minute, with the date unless it was today or less than half a day
        ago."""
        then, today = self.local(at), self.local(now)
        clock = f"{then:%H:%M}"
        if then.date() == today.date() or 0 <= now - at < HALF_DAY_S:
            return clock
        day = format_skeleton("MMMd" if then.year == today.year else "yMMMd", then, locale=self.locale)
        return f"{day}, {clock}"

    def lasting(self, seconds: float | None) -> str:
        """Format a duration as :func:`lasting` does."""
        return UNKNOWN if seconds is None else lasting(seconds)

    def length(self, length: float, measure: str) -> str:
        """Format a length with its measure."""
        figure, shown = length_shown(length, measure)
        return f"{self.point(figure)}\N{NO-BREAK SPACE}{shown}"

    def span(self, start: UnixTime | datetime, end: UnixTime | datetime) -> str:
        """Format two moments to the minute, the second with its date if they are a day or more apart."""
        is_short = (self.local(end) - self.local(start)).total_seconds() < 2 * HALF_DAY_S
        return self.hours(start, end) if is_short else f"{self.minute(start)} \N{EN DASH} {self.minute(end)}"

    def iso(self, at: UnixTime | datetime) -> str:
        """Format an instant for ``<time datetime>``: ISO 8601 with its zone."""
        return self.local(at).isoformat(timespec="milliseconds")
