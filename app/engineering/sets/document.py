"""A parameter set as a readable TOML file, one line a parameter, fit for version control."""

from __future__ import annotations

import tomllib
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from app.core.web.shape import StrictBody
from app.engineering.sets.model import ParameterRow, ParameterSet, UnitRows, with_unit
from bus.catalogue.parameters import PARAMETERS
from bus.configuration import toml_of
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message, term
from bus.validation import fault_message

_DOCUMENT_FORMAT = "lineside parameter set"
_DOCUMENT_VERSION = 1
MAX_DOCUMENT = 1_500_000
"""Characters of a file; all 255 units of a bus take half of it."""
MAX_LINES, MAX_VALUES = 20_000, 150_000
"""255 units take 12,000 lines and 75,000 values, counted by ``=`` and ``,``. A file of the same length that
is all values takes two seconds of the interpreter."""
MAX_KEY_STEPS = 2_000_000
"""Steps of Python's parser, which takes half a second for them. Without this bound one key of 20,000 parts in
40 kB takes 6 s and 1.5 GB."""
_KEYS = frozenset(str(number) for number in PARAMETERS)
"""The keys of parameters; 06 beside 6 would be one parameter twice."""

THE_FILE = term("the file")


class DocumentError(CallerError):
    """The refusal of a file that is no usable parameter set."""


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
    """Write the set as TOML text; #21 is masked unless ``with_secrets``."""
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
    """Parse and check a file. Raises DocumentError with what is wrong and where.

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
    """Bound the steps of the parser by the dots of each line, those in strings included.

    It follows every part of a key from the root, through all parts of the table that the key is in.
    """
    steps = deepest = 0
    for line in text.split("\n"):
        dots = line.count(".")
        if line.lstrip().startswith("["):
            deepest = max(deepest, dots)
        steps += (dots + 1) * (dots + deepest)
    return steps


def _seconds(moment: datetime, source: str | Message) -> UnixTime:
    """Convert a time to seconds since the epoch. Raises DocumentError for a year out of range."""
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
