"""What is said of history: what is asked of it."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
    "history_disk_low": "the disk with the history is nearly full: free some space soon",
    "history_disk_scarce": ("the disk with the history is nearly full: the oldest values are being deleted"),
    "history_disk_full": "the disk is full: no values are stored until space is free",
    "history_failed": "no history is stored; everything else works",
    "history_because": "{notice}: {cause}",
    "history_damaged": (
        "History: stored values were damaged. The events list the values that are missing; all "
        "others are intact. Check the disk."
    ),
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
