"""CSV (RFC 4180) in two forms, for programs and for the spreadsheet of a reader. Every download of CSV is
written here."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime, tzinfo
from io import StringIO
from typing import Annotated, Any, Literal, NamedTuple
from zoneinfo import ZoneInfo

from fastapi import Depends, Query, Request

from app.core.messages import Language
from app.core.web.templating import templates_of
from bus.messages import Message

BYTE_ORDER_MARK = "\ufeff"
"""The mark by which alone spreadsheets take text for UTF-8."""
CSV: dict[int | str, dict[str, Any]] = {200: {"content": {"text/csv": {"schema": {"type": "string"}}}}}
"""The response in the OpenAPI document."""
_NUMBER = re.compile(r"-?[\d.,]+")
_PLAIN_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
_FORMULA = re.compile(r"^(?=[\t\r\n])|(?:^|(?<=[;\t\r\n]))(?=[ \"]*[=+\-@\uff1d\uff0b\uff0d\uff20])")
"""Places from which on a spreadsheet takes text for a formula: the beginning of a cell, after a semicolon
too, which separates cells in most of Europe; the wide signs count in Japanese."""
_UTC_OFFSET = slice(16, None)


class Number(str):
    """A number as text, with a point."""

    __slots__ = ()


Cell = str | int | float | datetime | Message | None


class Column(NamedTuple):
    """A heading: its name for programs, its text for readers; ``is_time``: readers get the offset from UTC in
    a column of its own, so that a spreadsheet recognizes the time."""

    name: str
    text: Message | str
    is_time: bool = False


@dataclass(frozen=True, slots=True)
class CsvForm:
    """The form in which the cells of a file are written. ``language``: that of its reader, None for
    programs."""

    language: Language | None = None
    zone: tzinfo = field(default_factory=lambda: ZoneInfo("UTC"))
    decimal_sign: str = "."

    @property
    def _separator(self) -> str:
        # In languages with a decimal comma, spreadsheets expect semicolons.
        return ";" if self.decimal_sign == "," else ","

    def head(self, columns: Sequence[Column]) -> str:
        """Return the beginning of a file, with its line of headings."""
        if self.language is None:
            return self._text([[guarded(column.name) for column in columns]])
        return BYTE_ORDER_MARK + self._text([list(self._headings(columns, self.language))])

    def rows(self, columns: Sequence[Column], rows: Iterable[Sequence[Cell]]) -> str:
        """Return the rows as lines of the CSV file."""
        return self._text(self._cells(columns, row) for row in rows)

    def _headings(self, columns: Sequence[Column], language: Language) -> Iterator[str]:
        for column in columns:
            yield guarded(language.t(column.text))
            if column.is_time:
                yield language.t("UTC offset")

    def _cells(self, columns: Sequence[Column], row: Sequence[Cell]) -> Iterator[str]:
        for column, cell in zip(columns, row, strict=True):
            if self.language is None or not column.is_time:
                yield self._cell(cell)
            elif isinstance(cell, datetime):
                at = cell.astimezone(self.zone)
                yield f"{at:%Y-%m-%d %H:%M:%S}"
                yield at.isoformat(timespec="minutes")[_UTC_OFFSET]
            else:
                yield from ("", "")

    def _cell(self, cell: Cell) -> str:
        match cell:
            case None:
                return ""
            case datetime():
                return cell.isoformat(timespec="milliseconds")
            case bool() if self.language is not None:
                return self.language.t("yes") if cell else self.language.t("no")
            case bool():
                return str(cell)
            case int() | float() | Number():
                return str(cell).replace(".", self.decimal_sign)
            case Message() if self.language is not None:
                return guarded(self.language.t(cell))
            case _:
                return guarded(str(cell))

    def _text(self, rows: Iterable[Iterable[str]]) -> str:
        buffer = StringIO()
        csv.writer(buffer, delimiter=self._separator).writerows(rows)
        return buffer.getvalue()


def guarded(text: str) -> str:
    """Mark a text as text if a spreadsheet would take it for a formula (OWASP, CSV injection)."""
    return text if _NUMBER.fullmatch(text) else _FORMULA.sub("'", text)


def number_or_text(text: str | None) -> Cell:
    """Return text as a number if it is one."""
    return Number(text) if text is not None and _PLAIN_NUMBER.fullmatch(text) else text


FOR_PROGRAMS = CsvForm()


async def _wanted_form(
    request: Request,
    form: Annotated[Literal["data", "reader"], Query()] = "data",
) -> CsvForm:
    """Return the form that a request names: ``reader`` is for the spreadsheet of the person who downloads
    it."""
    templates = templates_of(request)
    if form == "data":
        return FOR_PROGRAMS
    return reader_form(templates.language_of(request), templates.site.zone)


def reader_form(language: Language, zone: str) -> CsvForm:
    """Return the form with the separator, decimal sign, headings and times that the spreadsheet of a reader
    expects."""
    return CsvForm(language, ZoneInfo(zone), language.point)


WantedCsv = Annotated[CsvForm, Depends(_wanted_form)]
