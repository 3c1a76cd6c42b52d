"""Texts about history and its queries."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    "history_disk_low": "the disk with the history is nearly full: free some space soon",
    "history_disk_scarce": ("the disk with the history is nearly full: the oldest values are being deleted"),
    "history_disk_full": "the disk is full: no values are stored until space is free",
    "history_failed": "no history is stored; everything else works",
    "history_failed_since": (
        "Since {time} no history is stored, everything else works. The reason: {reason}"
    ),
    "history_paused_since": ("No history is stored since {time}: the disk is full. Free some space."),
    "history_notice": "History: {notice}",
    "history_because": "{notice}: {cause}",
    "history_damaged": (
        "History: stored values were damaged. The events list the values that are missing; all "
        "others are intact. Check the disk."
    ),
    "event_history_block_lost": (
        "a block of the history is damaged, it is missing: {what} of {unit} from {since} on"
    ),
    "event_history_block_rebuilt": (
        "a block of the history was damaged, it was worked out again: {what} of {unit} from {since} on"
    ),
    "event_history_rebuilt": Plural(
        (
            "the store of the history was damaged and was rebuilt; 1 time span is missing; the "
            "damaged store was saved as {file}"
        ),
        (
            "the store of the history was damaged and was rebuilt; {n} time spans are missing; the "
            "damaged store was saved as {file}"
        ),
    ),
    "event_history_tail_damaged": (
        "the last minutes of the history were damaged before this start, some are missing"
    ),
    "history_readings": "every value",
    "history_minutes": "the minutes",
    "history_hours": "the hours",
    "too_many_sparklines": "series: at most {most}, not {count}",
    "no_parquet": (
        "This server cannot write Parquet: pyarrow is not installed. Export CSV, or install "
        "lineside[parquet]."
    ),
    "series_malformed": "series: write bus/unit/value, such as {example}, not '{text}'",
    "series_count": "series: name from 1 to {most} values, not {count}",
    "time_malformed": "{field}: write an ISO 8601 time with its zone, such as {example}, not '{text}'",
    "year_out_of_range": "{name}: write a year from {lowest} to {highest}, not {year}",
    "span_reversed": "from: the start of the span must be before its end; exchange from and to",
    "points_out_of_range": (
        "points: from 1 to {most}; for every value of a long span, use /api/v1/history/export"
    ),
    "no_such_value": "value: there is no '{value}'; there are: {known}",
}
