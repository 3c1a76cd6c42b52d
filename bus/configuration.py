"""The reading of lineside.toml; errors name the file, the line and a correct value."""

from __future__ import annotations

import difflib
import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from datetime import date
from io import StringIO
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar, cast, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from bus.errors import LinesideError
from bus.messages import Message
from bus.settings import BusSettings
from bus.validation import MASK, fault_message, without_credentials

KeyStep = str | int
KeyPath = tuple[KeyStep, ...]
Model = TypeVar("Model", bound=BaseModel)

SECRET_KEYS = ("url", "password", "token", "secret")
HOLDS_SECRET = re.compile(rf"(?i)(?:^|[\s{{,.#\"'])(?:{'|'.join(SECRET_KEYS)})[\"']?\s*=")
"""A pattern for TOML text with a key whose value may be a secret."""
_DECIMAL_COMMA = re.compile(r"[\w.]+\s*=\s*[+-]?\d+,\d+")
_SYNTAX_PLACE = re.compile(r"\(at (?:line (\d+), column \d+|end of document)\)")


class ConfigurationError(LinesideError):
    """Raised for a configuration that cannot be used; each fault names its place and a correct value."""

    def __init__(self, *faults: Message) -> None:
        super().__init__(Message.of("several", messages=list(faults)))
        self.faults = faults

    def __str__(self) -> str:
        return "\n".join(dict.fromkeys(map(str, self.faults)))


class _OnlyBuses(BaseModel):
    """The part of the file that a worker reads: the buses. The rest belongs to the dashboard."""

    bus: tuple[BusSettings, ...] = ()


def load(path: Path, model: type[Model]) -> Model:
    """Load the file as ``model``. Raise ConfigurationError ``FILE:LINE: fault, and a correct value``."""
    return parse(read(path), path, model)


def parse(text: str, path: Path, model: type[Model]) -> Model:
    """Parse ``text``, the present or a future content of the file at ``path``. Raise ConfigurationError."""
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(_syntax(path, text, error)) from error
    except (ValueError, RecursionError) as error:  # for thousands of digits or brackets
        raise ConfigurationError(Message.of("configuration_beyond_bounds", file=str(path))) from error
    try:
        return model.model_validate(data)
    except ValidationError as error:
        lines = LineNumbers(text)
        faults = [_fault(path, lines, model, details) for details in error.errors()]
        raise ConfigurationError(*faults) from error


def load_bus(path: Path, name: str) -> BusSettings:
    """Load one ``[[bus]]`` of the file, for its worker. Raise ConfigurationError."""
    buses = {bus.name: bus for bus in load(path, _OnlyBuses).bus}
    if name not in buses:
        raise ConfigurationError(
            Message.of("configuration_lacks_bus", file=str(path), bus=name, known=", ".join(buses) or "none")
        )
    return buses[name]


def read(path: Path) -> str:
    """Read the text of a configuration, with its line ends as they are. Raise ConfigurationError."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise ConfigurationError(Message.of("configuration_missing", file=str(path))) from None
    except PermissionError as error:
        raise ConfigurationError(Message.of("configuration_not_permitted", file=str(path))) from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(Message.of("configuration_not_utf8", file=str(path))) from error
    except OSError as error:
        raise ConfigurationError(
            Message.of("configuration_unreadable", file=str(path), error=error.strerror or str(error))
        ) from error


def _syntax(path: Path, text: str, error: tomllib.TOMLDecodeError) -> Message:
    place = _SYNTAX_PLACE.search(str(error))
    lines = lines_of(text) or [""]
    line = int(place[1]) if place and place[1] else len(lines)
    message = _SYNTAX_PLACE.sub("", str(error)).strip()
    written = lines[max(0, line - 1)].strip()
    before = max((each.last for each in statements("".join(lines[: line - 1]))), default=0)
    if _DECIMAL_COMMA.fullmatch(written):
        right = written.replace(",", ".")
        return Message.of("configuration_decimal_comma", file=str(path), line=line, text=written, right=right)
    hides = HOLDS_SECRET.search("".join(lines[before:line])) is not None
    shown = MASK if hides else without_credentials(repr(written))
    return Message.of("configuration_not_toml", file=str(path), line=line, error=message, text=shown)


class LineNumbers:
    """The line of each key of a TOML text. A value inside an array or an inline table is found by the line of
    the nearest key around it."""

    def __init__(self, text: str) -> None:
        self._places = {path: each.first for each in statements(text) for path in each.paths}

    def line_of(self, path: KeyPath) -> int:
        """Return the line (from 1) of a key, or of the key or table that would contain it."""
        for length in range(len(path), 0, -1):
            if path[:length] in self._places:
                return self._places[path[:length]]
        return 1


class TomlStatement(NamedTuple):
    """A statement of TOML: the header of a table, or a key with its value. Lines count from 1."""

    paths: tuple[KeyPath, ...]
    is_header: bool
    first: int
    last: int


def toml_of(value: Any) -> str:
    """Return a value on one line of TOML. JSON strings are TOML strings, except for one control character."""
    match value:
        case dict():
            return "{" + ", ".join(f"{toml_of(key)} = {toml_of(each)}" for key, each in value.items()) + "}"
        case list() | tuple():
            return f"[{', '.join(map(toml_of, value))}]"
        case str():
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        case bool():
            return "true" if value else "false"
        case date():
            return value.isoformat()
    return repr(value)


def bus_lines(bus: Mapping[str, Any]) -> list[str]:
    """Return the lines of a ``[[bus]]`` as a person would write them: a ``[[bus.unit]]`` for each of its
    ``unit``, and a ``[bus.unit.labels]`` where that has labels."""
    tables = [("[[bus]]", bus)]
    for unit in bus["unit"]:
        tables.append(("\n[[bus.unit]]", unit))
        if "labels" in unit:
            tables.append(("[bus.unit.labels]", unit["labels"]))
    return [line for head, table in tables for line in (head, *_table_lines(table))]


def _table_lines(table: Mapping[str, Any]) -> Iterator[str]:
    for key, value in table.items():
        if key in ("unit", "labels") and not isinstance(value, str):
            continue  # a table of its own
        if isinstance(value, dict):
            yield from (f"{key}.{inner} = {toml_of(each)}" for inner, each in value.items())
        else:
            yield f"{key} = {toml_of(value)}"


def lines_of(text: str) -> list[str]:
    """Return the lines of a TOML text with their ends. ``splitlines`` would also split at separators that may
    be inside of a string or a comment."""
    return StringIO(text, newline="\n").readlines()


def statements(text: str) -> Iterator[TomlStatement]:
    """Yield each header and key of a TOML text, which is parsed statement by statement."""
    counts: dict[KeyPath, int] = {}
    table: KeyPath = ()
    statement, begins = "", 1
    for number, line in enumerate(lines_of(text), 1):
        statement += line
        try:
            parsed = tomllib.loads(statement)
        except tomllib.TOMLDecodeError:
            continue  # A value of several lines.
        if statement.lstrip().startswith("["):
            table = _table(parsed, counts)
            yield TomlStatement((table,), True, begins, number)
        elif parsed:
            yield TomlStatement(tuple(table + path for path in _keys_in(parsed)), False, begins, number)
        statement, begins = "", number + 1


def _table(header: dict[str, Any], counts: dict[KeyPath, int]) -> KeyPath:
    """Return the path of a header, with the index of the present element after each name of an array."""
    path: KeyPath = ()
    while header:
        [(name, inside)] = header.items()
        path += (name,)
        if isinstance(inside, list):
            counts[path] = counts.get(path, -1) + 1
            inside = inside[0]
        if path in counts:
            path += (counts[path],)
        header = inside
    return path


def _keys_in(table: dict[str, Any]) -> Iterator[KeyPath]:
    for name, value in table.items():
        yield (name,)
        if isinstance(value, dict):
            yield from ((name, *rest) for rest in _keys_in(value))


def _fault(path: Path, lines: LineNumbers, model: type[BaseModel], details: ErrorDetails) -> Message:
    place = tuple(details["loc"]) + tuple(details.get("ctx", {}).get("at", ()))
    fault = _fault_message(model, place, details)
    return Message.of("configuration_fault", file=str(path), line=lines.line_of(place), fault=fault)


def _fault_message(model: type[BaseModel], place: KeyPath, details: ErrorDetails) -> Message:
    key = str(place[-1]) if place else "the file"
    if details["type"] == "extra_forbidden":
        return _unknown_key(model, place)
    if details["type"] == "missing":
        return Message.of("configuration_needs_key", table=_inside(place), key=key)
    if "at" in details.get("ctx", {}):
        return cast(Message, details["ctx"]["message"])
    steps = [step for step in place if isinstance(step, str) and step != "[key]"]
    names = ".".join(steps)
    if details["type"] == "tuple_type" and isinstance(details["input"], dict):
        return Message.of("configuration_needs_array", table=names)
    is_slug = details["type"] == "string_pattern_mismatch"
    right = Message("configuration_slug") if is_slug else fault_message(details)
    value = without_credentials(repr(details["input"])) if set(steps).isdisjoint(SECRET_KEYS) else MASK
    return Message.of("configuration_value", key=names, value=value, right=right)


def _inside(place: KeyPath) -> str:
    names = ".".join(step for step in place[:-1] if isinstance(step, str))
    if not names:
        return "the file"
    return f"[[{names}]]" if isinstance(place[-2], int) else f"[{names}]"


def _unknown_key(model: type[BaseModel], place: KeyPath) -> Message:
    known = _keys(model, place[:-1])
    near = difflib.get_close_matches(str(place[-1]), known, 1)
    right = (
        Message.of("configuration_key_near", key=near[0])
        if near
        else Message.of("configuration_keys_known", keys=list(known))
    )
    return Message.of("configuration_key_unknown", key=str(place[-1]), table=_inside(place), right=right)


def _keys(annotation: Any, place: KeyPath) -> list[str]:
    """Return the keys that are valid at a place of a model."""
    if get_origin(annotation) is Annotated:
        return _keys(get_args(annotation)[0], place)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        fields = annotation.model_fields
        if not place:
            return list(fields)
        return _keys(fields[str(place[0])].annotation, place[1:])
    return _keys(get_args(annotation)[0], place[1:])
