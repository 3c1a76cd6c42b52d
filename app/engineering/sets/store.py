"""The store of parameter sets, which never change, of golden marks and the daily schedule; and a set as a
readable TOML file with one line for each parameter, fit for version control."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from app.core.database import StoreConnection
from app.core.database.connection import upsert
from app.core.database.database import Tables, reading, writing
from app.core.web.shape import StrictBody
from app.engineering.sets.model import (
    ParameterRow,
    ParameterSet,
    ParameterSetSummary,
    SetOrigin,
    UnitRows,
    with_unit,
)
from bus.catalogue.parameters import PARAMETERS
from bus.configuration import toml_of
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message, term
from bus.validation import fault_message

MAX_SETS = 2**62
"""A limit that no list reaches."""
_HEAD = "bus, name, comment, taken_at, who, origin"


class SetStore(Tables):
    """The tables of parameter sets."""

    @writing
    def save(self, connection: StoreConnection, parameter_set: ParameterSet) -> ParameterSet:
        """Store a new set and return it with its id."""
        one = parameter_set
        [(set_id,)] = connection.execute(
            f"INSERT INTO parameter_set ({_HEAD}) VALUES (?, ?, ?, ?, ?, ?) RETURNING id",
            (one.bus, one.name, one.comment, one.taken_at, one.who, one.origin),
        )
        connection.executemany(
            "INSERT INTO parameter_set_unit VALUES (?, ?, ?)",
            [(set_id, unit.unit, unit.name) for unit in one.units],
        )
        connection.executemany(
            "INSERT INTO parameter_set_row VALUES (?, ?, ?, ?, ?, ?, ?)",
            [
                (set_id, unit.unit, row.number, row.raw, row.available, row.read_at, row.frame)
                for unit in one.units
                for row in unit.rows.values()
            ],
        )
        return replace(one, id=set_id)

    @reading
    def load(self, connection: StoreConnection, set_id: int) -> ParameterSet | None:
        """Return a complete set, None if it does not exist."""
        head = connection.execute(f"SELECT {_HEAD} FROM parameter_set WHERE id = ?", (set_id,)).fetchone()
        if head is None:
            return None
        bus, name, comment, taken_at, who, origin = head
        found = connection.execute(
            "SELECT unit, name FROM parameter_set_unit WHERE set_id = ? ORDER BY unit", (set_id,)
        ).fetchall()
        units = tuple(UnitRows(unit, section, _rows(connection, set_id, unit)) for unit, section in found)
        marks = connection.execute("SELECT unit FROM golden_set WHERE set_id = ? ORDER BY unit", (set_id,))
        golden_for = tuple(unit for (unit,) in marks)
        return ParameterSet(bus, taken_at, who, origin, units, name, comment, set_id, golden_for)

    @reading
    def summaries(
        self,
        connection: StoreConnection,
        bus: str | None = None,
        unit: int | None = None,
        *,
        before: int | None = None,
        text: str = "",
        limit: int = MAX_SETS,
    ) -> list[ParameterSetSummary]:
        """Return the newest sets stored before the set ``before``, filtered by bus, unit, or a ``text`` in
        name, comment or user."""
        found = connection.execute(
            f"SELECT id, {_HEAD},"
            " (SELECT group_concat(unit) FROM parameter_set_unit WHERE set_id = id),"
            " (SELECT group_concat(unit) FROM golden_set WHERE set_id = id)"
            " FROM parameter_set WHERE (bus = :bus OR :bus IS NULL) AND (EXISTS"
            " (SELECT 1 FROM parameter_set_unit WHERE set_id = id AND unit = :unit) OR :unit IS NULL)"
            " AND instr(lower(name || char(10) || comment || char(10) || who), lower(:text))"
            " AND (id < :before OR :before IS NULL) ORDER BY id DESC LIMIT :limit",
            {"bus": bus, "unit": unit, "before": before, "text": text, "limit": limit},
        )
        return [
            ParameterSetSummary(
                set_id, of_bus, name, comment, taken_at, who, origin, _numbers(golden_for), _numbers(units)
            )
            for set_id, of_bus, name, comment, taken_at, who, origin, units, golden_for in found
        ]

    @writing
    def mark_golden(
        self,
        connection: StoreConnection,
        bus: str,
        units: Iterable[int],
        set_id: int,
        who: str,
        now: UnixTime,
    ) -> None:
        """Make a set the golden set of the units. ``now``: seconds since the epoch."""
        for unit in units:
            connection.execute(
                upsert("golden_set", ("bus", "unit"), ("set_id", "marked_by", "marked_at")),
                (bus, unit, set_id, who, now),
            )

    @reading
    def golden(self, connection: StoreConnection, bus: str) -> dict[int, UnitRows]:
        """Return the golden rows of the units of a bus by address."""
        marks = connection.execute(
            "SELECT golden_set.unit, golden_set.set_id, parameter_set_unit.name FROM golden_set"
            " JOIN parameter_set_unit USING (set_id, unit) WHERE golden_set.bus = ?",
            (bus,),
        ).fetchall()
        return {unit: UnitRows(unit, name, _rows(connection, set_id, unit)) for unit, set_id, name in marks}

    @reading
    def has_set_since(
        self,
        connection: StoreConnection,
        bus: str,
        unit: int,
        since: UnixTime,
        origin: SetOrigin | None = None,
    ) -> bool:
        """Return whether a set of this unit (of ``origin`` if given) was stored at or after ``since``."""
        found = connection.execute(
            "SELECT 1 FROM parameter_set JOIN parameter_set_unit ON id = set_id"
            " WHERE bus = ?1 AND unit = ?2 AND taken_at >= ?3 AND origin = coalesce(?4, origin) LIMIT 1",
            (bus, unit, since, origin),
        )
        return found.fetchone() is not None

    @reading
    def schedule(self, connection: StoreConnection) -> dict[str, int]:
        """Return the minute of the local day at which each bus is saved, by bus."""
        return dict(connection.execute("SELECT bus, minute_of_day FROM set_schedule"))

    @writing
    def set_schedule(self, connection: StoreConnection, bus: str, minute_of_day: int | None) -> None:
        """Save the units of a bus daily at a minute of the day; None ends this."""
        connection.execute("DELETE FROM set_schedule WHERE bus = ?", (bus,))
        if minute_of_day is not None:
            connection.execute("INSERT INTO set_schedule VALUES (?, ?)", (bus, minute_of_day))


def _rows(connection: StoreConnection, set_id: int, unit: int) -> dict[int, ParameterRow]:
    found = connection.execute(
        "SELECT number, raw, available, read_at, frame FROM parameter_set_row"
        " WHERE set_id = ? AND unit = ? ORDER BY number",
        (set_id, unit),
    )
    return {
        number: ParameterRow(number, raw, bool(available), read_at, frame)
        for number, raw, available, read_at, frame in found
    }


def _numbers(joined: str | None) -> tuple[int, ...]:
    return tuple(sorted(int(part) for part in joined.split(","))) if joined else ()


_DOCUMENT_FORMAT = "lineside parameter set"
_DOCUMENT_VERSION = 1
MAX_DOCUMENT = 1_500_000
"""The most characters of a file; all 255 units of a bus take half of them."""
MAX_LINES, MAX_VALUES = 20_000, 150_000
"""255 units take 12,000 lines and 75,000 values, counted by ``=`` and ``,``. A file of the same length that
has only values takes two seconds of the interpreter."""
MAX_KEY_STEPS = 2_000_000
"""The most steps of Python's parser, which takes half a second for them. Without this limit one key of 20,000
parts in 40 kB takes 6 s and 1.5 GB."""
_KEYS = frozenset(str(number) for number in PARAMETERS)
"""The valid keys of parameters: 06 beside 6 would be one parameter twice."""

THE_FILE = term("the file")


class DocumentError(CallerError):
    """Raised for a file that is not a usable parameter set."""


class _Parameter(StrictBody):
    name: str = ""
    raw: int | None = None
    value: str = ""
    available: bool = True
    masked: bool = False


class _Unit(StrictBody):
    id: Annotated[int, Field(ge=1, le=255)]
    name: str = ""
    read_at: datetime | None = None
    parameters: Annotated[dict[str, _Parameter], Field(max_length=len(PARAMETERS))]


class _Document(StrictBody):
    format: Literal["lineside parameter set"]
    version: Annotated[int, Field(ge=1)]
    bus: str = ""
    name: str = ""
    comment: str = ""
    taken_at: datetime
    by: str = ""
    unit: Annotated[list[_Unit], Field(min_length=1, max_length=255)]


def write_document(parameter_set: ParameterSet, *, with_secrets: bool = False) -> str:
    """Return the set as TOML text; #21 is masked unless ``with_secrets``."""
    lines = [
        f"format = {toml_of(_DOCUMENT_FORMAT)}",
        f"version = {_DOCUMENT_VERSION}",
        f"bus = {toml_of(parameter_set.bus)}",
        f"name = {toml_of(parameter_set.name)}",
        f"comment = {toml_of(parameter_set.comment)}",
        f"taken_at = {_time(parameter_set.taken_at)}",
        f"by = {toml_of(parameter_set.who)}",
    ]
    for unit in parameter_set.units:
        lines += ["", *_unit_lines(unit, with_secrets)]
    return "\n".join(lines) + "\n"


def _unit_lines(unit: UnitRows, with_secrets: bool) -> list[str]:
    lines = ["[[unit]]", f"id = {unit.unit}", f"name = {toml_of(unit.name)}"]
    times = [row.read_at for row in unit.rows.values() if row.read_at is not None]
    if times:
        lines.append(f"read_at = {_time(max(times))}")
    lines.append("[unit.parameters]")
    return lines + [_row_line(row, unit, with_secrets) for _, row in sorted(unit.rows.items())]


def _row_line(row: ParameterRow, unit: UnitRows, with_secrets: bool) -> str:
    parameter = PARAMETERS[row.number]
    fields = [f"name = {toml_of(parameter.name)}"]
    if not row.available:
        fields.append("available = false")
    elif parameter.secret and not with_secrets:
        fields.append("masked = true")
    elif row.raw is not None:
        shown = str(with_unit(parameter, row.raw, unit))
        fields += [f"raw = {row.raw}", f"value = {toml_of(shown)}"]
    return f"{row.number} = {{ {', '.join(fields)} }}"


def read_document(text: str, source: str | Message = THE_FILE) -> ParameterSet:
    """Parse and check a file. Raise DocumentError with the fault and its place.

    Only ``raw`` counts; ``value`` and ``name`` are for people.
    """
    document = _parse(text, source)
    units = tuple(_unit_rows(unit, source) for unit in document.unit)
    if len({unit.unit for unit in units}) < len(units):
        raise DocumentError(Message.of("source_takes_unit_twice", source=source))
    return ParameterSet(
        bus=document.bus,
        taken_at=_seconds(document.taken_at, source),
        who=document.by,
        origin="from a file",
        units=units,
        name=document.name,
        comment=document.comment,
    )


def _parse(text: str, source: str | Message) -> _Document:
    content = _content(text, source)
    if content.get("format") != _DOCUMENT_FORMAT:
        wanted = toml_of(_DOCUMENT_FORMAT)
        raise DocumentError(Message.of("source_no_parameter_set", source=source, format=wanted))
    version = content.get("version")
    if isinstance(version, int) and version > _DOCUMENT_VERSION:
        raise DocumentError(Message.of("source_of_newer_version", source=source, version=version))
    try:
        return _Document.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        where, fault = ".".join(map(str, first["loc"])), fault_message(first)
        raise DocumentError(Message.of("source_fault", source=source, where=where, fault=fault)) from error


def _content(text: str, source: str | Message) -> dict[str, Any]:
    is_long = len(text) > MAX_DOCUMENT or text.count("\n") > MAX_LINES
    if is_long or text.count("=") + text.count(",") > MAX_VALUES:
        raise DocumentError(Message.of("source_too_long", source=source))
    if _key_steps(text) > MAX_KEY_STEPS:
        raise DocumentError(Message.of("source_key_too_deep", source=source))
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        why = Message("nested_too_deeply") if isinstance(error, RecursionError) else str(error)
        cut_off = "end of document" in str(error)
        code = "source_cut_off" if cut_off else "source_not_toml"
        raise DocumentError(Message.of(code, source=source, why=why)) from error


def _key_steps(text: str) -> int:
    """Return an upper bound of the parser's steps by the dots of each line, also those in strings.

    The parser follows every part of a key from the root, through all parts of the table of the key.
    """
    steps = deepest = 0
    for line in text.split("\n"):
        dots = line.count(".")
        if line.lstrip().startswith("["):
            deepest = max(deepest, dots)
        steps += (dots + 1) * (dots + deepest)
    return steps


def _seconds(moment: datetime, source: str | Message) -> UnixTime:
    """Convert a time to seconds since the epoch. Raise DocumentError if the year is out of range."""
    try:
        return UnixTime(moment.timestamp())
    except (ValueError, OverflowError, OSError) as error:
        unknown = Message.of("source_time_unknown", source=source, time=moment.isoformat())
        raise DocumentError(unknown) from error


def _unit_rows(unit: _Unit, source: str | Message) -> UnitRows:
    read_at = None if unit.read_at is None else _seconds(unit.read_at, source)
    rows: dict[int, ParameterRow] = {}
    for key, given in unit.parameters.items():
        if key not in _KEYS:
            raise DocumentError(Message.of("source_no_such_parameter", source=source, unit=unit.id, key=key))
        number = int(key)
        _check_range(number, given.raw, unit.id, source)
        rows[number] = ParameterRow(number, given.raw if given.available else None, given.available, read_at)
    return UnitRows(unit.id, unit.name, rows)


def _check_range(number: int, raw: int | None, unit: int, source: str | Message) -> None:
    parameter = PARAMETERS[number]
    if raw is None or parameter.minimum <= raw <= parameter.maximum:
        return
    outside = Message.of(
        "source_value_outside",
        source=source,
        unit=unit,
        number=number,
        name=parameter.name,
        raw=term("hidden") if parameter.secret else raw,
        lowest=parameter.minimum,
        highest=parameter.maximum,
    )
    raise DocumentError(outside)


def _time(at: UnixTime) -> str:
    return datetime.fromtimestamp(round(float(at)), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
