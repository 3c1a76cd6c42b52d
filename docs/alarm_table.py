"""``python -m docs.alarm_table``: write the tables of docs/alarms.md and of its translations, from the rows
of the conditions and the catalogs of the screen."""

from __future__ import annotations

from pathlib import Path

from app.core.messages import Languages
from app.line.conditions.catalogue import PLACES
from bus.messages import Message

DOCS = Path(__file__).parent
DOCUMENTS = {"en": DOCS / "alarms.md", "de": DOCS / "alarms.de.md"}
"""The chapter in each language."""
LINE = "\n|---|---|---|---|---|\n"
HEADS = {
    "en": f"| alarm | holds while | of | delays, s | priority |{LINE}",
    "de": f"| Alarm | Bedingung | betrifft | Verzögerungen, s | Priorität |{LINE}",
}


def alarm_table(language: str) -> str:
    """A row for each built-in alarm."""
    translator = Languages()[language]
    rows = [(place, row) for place, rows in PLACES.items() for row in rows if row.is_alarm]
    return HEADS[language] + "".join(
        f"| {translator.t(Message(f'alarm_{row.code}'))} `{row.code}` | {translator.t(row.means)} "
        f"| {translator.t(place)} | {row.tuning.on_delay_s:g}, {row.tuning.off_delay_s:g} "
        f"| {translator.t(row.priority)} |\n"
        for place, row in rows
    )


def with_table(text: str, language: str) -> str:
    """The document with the table as it is now."""
    before, after = text.split(HEADS[language])
    rest = after[after.index("\n\n") + 1 :]
    return before + alarm_table(language) + rest


if __name__ == "__main__":
    for tag, document in DOCUMENTS.items():
        document.write_text(with_table(document.read_text(encoding="utf-8"), tag), encoding="utf-8")
