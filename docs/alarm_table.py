"""``python -m docs.alarm_table``: write the table of docs/alarms.md, from the rows of the conditions."""

from __future__ import annotations

from pathlib import Path

from app.line.conditions.catalogue import PLACES

DOCUMENT = Path(__file__).parent / "alarms.md"
HEAD = "| code | of | holds while | delays, s | priority |\n|---|---|---|---|---|\n"


def alarm_table() -> str:
    """A row for each built-in alarm."""
    rows = [(place, row) for place, rows in PLACES.items() for row in rows if row.is_alarm]
    return HEAD + "".join(
        f"| `{row.code}` | {place} | {row.means} "
        f"| {row.tuning.on_delay_s:g}, {row.tuning.off_delay_s:g} | {row.priority} |\n"
        for place, row in rows
    )


def with_table(text: str) -> str:
    """The document with the table as it is now."""
    before, after = text.split(HEAD)
    rest = after[after.index("\n\n") + 1 :]
    return before + alarm_table() + rest


if __name__ == "__main__":
    DOCUMENT.write_text(with_table(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
