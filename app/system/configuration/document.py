"""The text of the configuration file: changes of it, comparisons, and versions.

Only the requested lines change: comments, order and blank lines stay. Each result is read again and compared
with the wanted content. A comparison goes line by line and leaves secrets out. Each version is a file of the
data folder that only the server's user can read.
"""

from __future__ import annotations

import re
import secrets
import tomllib
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from datetime import date
from difflib import SequenceMatcher
from hashlib import blake2b
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from pydantic import Field

from app.core.database.files import make_folder, write_file
from app.core.web.shape import InstantObject
from bus.configuration import HOLDS_SECRET, KeyPath, lines_of, statements, toml_of
from bus.errors import CallerError
from bus.messages import Message

TomlValue = str | bool | int | float | date | list[Any]
Edit = Callable[[str], str]
"""A function that makes the new text of the file from the present one; it may raise CallerError."""
_BARE = re.compile(r"[A-Za-z0-9_-]+")


class WrittenOtherwiseError(CallerError):
    """Raised for a correct file in a notation that is not changed here, such as an inline table."""

    def __init__(self) -> None:
        super().__init__(Message("configuration_written_otherwise"))


def content_of(text: str) -> Any:
    """Return the content of a text; None if it is not TOML."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError):
        return None


def at(data: Any, path: KeyPath) -> Any:
    """Return the value at a path; None if there is none."""
    for step in path:
        try:
            data = data[step]
        except (KeyError, IndexError, TypeError):
            return None
    return data


def with_values(text: str, table: KeyPath, changes: Mapping[str, TomlValue | None]) -> str:
    """Set keys of a table, by their dotted names; None removes a key. A missing table is added: to an array
    if the path ends with the number of its elements. Raise WrittenOtherwiseError."""
    data = tomllib.loads(text)
    wanted = _data_with(data, table, changes)
    if at(data, table) is None and isinstance(table[-1], int):
        text = _with_element(text, table, changes)
    else:
        for key, value in changes.items():
            text = _with_value(text, table, tuple(key.split(".")), value)
    return _checked(text, wanted)


def without(text: str, table: KeyPath) -> str:
    """Remove an element of an array, with the comment directly above it. Raise WrittenOtherwiseError."""
    wanted = tomllib.loads(text)
    array, index = at(wanted, table[:-1]), table[-1]
    if not isinstance(array, list) or not isinstance(index, int) or at(wanted, table) is None:
        raise WrittenOtherwiseError
    del array[index]
    if not array:
        del at(wanted, table[:-2])[table[-2]]
    lines = lines_of(text)
    start, end = _block(lines, text, table)
    while end < len(lines) and not lines[end].strip():
        end += 1
    return _checked("".join(lines[:start] + lines[end:]), wanted)


def moved_up(text: str, table: KeyPath) -> str:
    """Exchange an element of an array with the element before it, each with its comment. Raise
    WrittenOtherwiseError."""
    data = tomllib.loads(text)
    array, index = at(data, table[:-1]), table[-1]
    if not isinstance(array, list) or not isinstance(index, int) or not 0 < index < len(array):
        raise WrittenOtherwiseError
    array[index - 1], array[index] = array[index], array[index - 1]
    lines = lines_of(text)
    first, first_end = _block(lines, text, (*table[:-1], index - 1))
    second, second_end = _block(lines, text, table)
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += _newline(lines)
    swapped = (
        *lines[:first],
        *lines[second:second_end],
        *lines[first_end:second],
        *lines[first:first_end],
        *lines[second_end:],
    )
    return _checked("".join(swapped), data)


def _checked(text: str, wanted: Any) -> str:
    try:
        found = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise WrittenOtherwiseError from error
    if _without_empty(found) != _without_empty(wanted):
        raise WrittenOtherwiseError
    return text


def _without_empty(value: Any) -> Any:
    """Leave out empty tables: a header alone counts as none."""
    if isinstance(value, dict):
        inner = {key: _without_empty(each) for key, each in value.items()}
        return {key: each for key, each in inner.items() if each != {}}
    return [_without_empty(each) for each in value] if isinstance(value, list) else value


def _data_with(data: Any, table: KeyPath, changes: Mapping[str, TomlValue | None]) -> Any:
    wanted = deepcopy(data)
    for key, value in changes.items():
        steps: list[str | int] = [*table, *key.split(".")]
        inside, last = wanted, steps[-1]
        for step, following in pairwise(steps):
            if isinstance(step, int):
                if step == len(inside):
                    inside.append({})
                inside = at(inside, (step,))
            else:
                inside = inside.setdefault(step, [] if isinstance(following, int) else {})
            if not isinstance(inside, dict | list):
                raise WrittenOtherwiseError
        if value is None:
            inside.pop(last, None)
        else:
            inside[last] = value
    return wanted


def _with_value(text: str, table: KeyPath, key: tuple[str, ...], value: TomlValue | None) -> str:
    path, found, lines = table + key, list(statements(text)), lines_of(text)
    there = next((each for each in found if not each.is_header and path in each.paths), None)
    if there is not None:
        old = "".join(lines[there.first - 1 : there.last])
        new = "" if value is None else _replaced(old, value)
        return "".join((*lines[: there.first - 1], new, *lines[there.last :]))
    if value is None:
        return text
    headers = [each for each in found if each.is_header and path[: len(each.paths[0])] == each.paths[0]]
    owner = max(headers, key=lambda each: len(each.paths[0]), default=None)
    if owner is None or len(owner.paths[0]) < len(table):
        block = [*_gap(lines), f"[{_dotted(table)}]", f"{_dotted(key)} = {toml_of(value)}"]
        return _inserted(lines, len(lines), block)
    index = found.index(owner)
    last = owner.last
    for each in found[index + 1 :]:
        if each.is_header:
            break
        last = each.last
    return _inserted(lines, last, [f"{_dotted(path[len(owner.paths[0]) :])} = {toml_of(value)}"])


def _with_element(text: str, table: KeyPath, values: Mapping[str, TomlValue | None]) -> str:
    """Put a new element of an array after its last one, else after the enclosing table, else at the end."""
    lines, end = lines_of(text), None
    if table[-1]:
        end = _block(lines, text, (*table[:-1], int(table[-1]) - 1))[1]
    elif len(table) > 2 and any(each.paths[0][: len(table) - 2] == table[:-2] for each in statements(text)):
        end = _block(lines, text, table[:-2])[1]
    end = len(lines) if end is None else end
    pairs = [
        f"{_dotted(key.split('.'))} = {toml_of(value)}" for key, value in values.items() if value is not None
    ]
    return _inserted(lines, end, [*_gap(lines[:end]), f"[[{_dotted(table)}]]", *pairs])


def _block(lines: list[str], text: str, table: KeyPath) -> tuple[int, int]:
    """Return the lines (from 0, the last excluded) of a table with its content, the comment directly above
    its header, and the comment directly below its last key if only a blank line follows."""
    within = [each for each in statements(text) if each.paths[0][: len(table)] == table]
    if not within or not within[0].is_header:
        raise WrittenOtherwiseError
    start, end = within[0].first - 1, within[-1].last
    while start and lines[start - 1].lstrip().startswith("#"):
        start -= 1
    below = end
    while below < len(lines) and lines[below].lstrip().startswith("#"):
        below += 1
    return start, below if below == len(lines) or not lines[below].strip() else end


def _inserted(lines: list[str], position: int, new: list[str]) -> str:
    newline = _newline(lines)
    before = "".join(lines[:position])
    if before and not before.endswith("\n"):
        before += newline
    return before + "".join(f"{line}{newline}" for line in new) + "".join(lines[position:])


def _gap(lines: list[str]) -> list[str]:
    return [""] if lines and lines[-1].strip() else []


def _newline(lines: list[str]) -> str:
    return "\r\n" if lines and lines[0].endswith("\r\n") else "\n"


def _replaced(statement: str, value: TomlValue) -> str:
    """Return a statement with another value: its key and the comment after it stay. The text before that
    comment is a statement by itself, unlike the text before any other number sign."""
    content, newline = tomllib.loads(statement), statement[len(statement.rstrip("\r\n")) :]
    for place in (index for index, sign in enumerate(statement) if sign == "#"):
        try:
            is_all = tomllib.loads(statement[:place]) == content
        except tomllib.TOMLDecodeError:
            # Here an array is still open: a comment in it would be lost.
            if "\n" in statement[:place]:
                raise WrittenOtherwiseError from None
            continue
        if is_all:
            code = statement[:place]
            behind = code[len(code.rstrip()) :] + statement[place:]
            return f"{_key_of(statement)}{toml_of(value)}{behind}"
    if "#" in statement and "\n" in statement.rstrip():
        raise WrittenOtherwiseError
    return f"{_key_of(statement)}{toml_of(value)}{newline}"


def _key_of(statement: str) -> str:
    key, sign, rest = statement.partition("=")
    return f"{key}{sign}{rest[: len(rest) - len(rest.lstrip(' '))]}"


def _dotted(path: Any) -> str:
    names = [step for step in path if isinstance(step, str)]
    return ".".join(name if _BARE.fullmatch(name) else toml_of(name) for name in names)


CONTEXT = 2
"""The number of lines that are shown around a change."""
_IN_URL = re.compile(r"(\w+://)[^\s/@\"']*@")
_KEY = secrets.token_bytes(16)
"""A new key in each run, so that the digest of a simple password cannot be looked up."""


@dataclass(frozen=True, slots=True)
class DifferenceLine:
    """A line of a difference; a ``gap`` stands for lines that are left out."""

    kind: Literal["same", "gone", "new", "gap"]
    number: Annotated[int, Field(description="In the new text; of a line that is gone, in the old one.")]
    text: Annotated[str, Field(description="Secrets are masked.")]


def masked(text: str) -> str:
    """Return the text for people: of each key that may hold a secret they only see whether it changes, also
    in a comment. A secret's file name is no secret."""
    lines, open_statement = [], ""
    for line in _bare_lines(text):
        statement = f"{open_statement}{line}\n"
        hides = HOLDS_SECRET.search(statement) is not None
        lines.append(
            _masked_line(line, follows=bool(open_statement)) if hides else _IN_URL.sub(r"\1…@", line)
        )
        open_statement = "" if _is_complete(statement) else statement
    return "".join(f"{line}\n" for line in lines)


def difference(before: str, now: str) -> list[DifferenceLine]:
    """Return the differing lines with the lines around them; of secrets, only that they differ."""
    return list(_lines(_bare_lines(masked(before)), _bare_lines(masked(now))))


def _bare_lines(text: str) -> list[str]:
    return [line.rstrip("\r\n") for line in lines_of(text)]


def _lines(old: list[str], new: list[str]) -> Iterator[DifferenceLine]:
    for number, group in enumerate(
        SequenceMatcher(None, old, new, autojunk=False).get_grouped_opcodes(CONTEXT)
    ):
        if number:
            yield DifferenceLine("gap", 0, "")
        for tag, i1, i2, j1, j2 in group:
            if tag == "equal":
                yield from (DifferenceLine("same", j1 + n + 1, each) for n, each in enumerate(new[j1:j2]))
                continue
            yield from (DifferenceLine("gone", i1 + n + 1, each) for n, each in enumerate(old[i1:i2]))
            yield from (DifferenceLine("new", j1 + n + 1, each) for n, each in enumerate(new[j1:j2]))


def _masked_line(line: str, *, follows: bool) -> str:
    mark = f"*** {blake2b(line.encode(), key=_KEY, digest_size=3).hexdigest()}"
    key, sign, _ = line.partition("=")
    return mark if follows or not sign else f"{key}{sign} {mark}"


def _is_complete(statement: str) -> bool:
    try:
        tomllib.loads(statement)
    except tomllib.TOMLDecodeError:
        return False
    return True


FOLDER = "configuration"
"""The folder of versions in the data folder."""
MAX_VERSIONS = 100
"""The number of newest versions that are kept."""
VersionOrigin = Literal["found", "by_hand", "changed", "rolled_back"]


@dataclass(frozen=True, slots=True)
class ConfigurationVersion:
    """A version without its text. ``origin``: the first version was ``found``; ``by_hand``: changed in the
    file itself, at this time or before. ``who`` and ``reason``: empty for these two."""

    number: Annotated[int, Field(description="From 1.")]
    at: InstantObject
    origin: VersionOrigin
    digest: Annotated[str, Field(description="Identifies its text.")]
    who: str = ""
    reason: str = ""


@dataclass(frozen=True, slots=True)
class StoredVersion:
    """A version with its text, secrets included: never published."""

    version: ConfigurationVersion
    text: str


class VersionStore:
    """The store of versions, in a folder. Its methods raise OSError if a version cannot be written."""

    def __init__(self, data: Path) -> None:
        self._folder = data / FOLDER

    def newest(self) -> StoredVersion | None:
        """Return the last version; None if there is none."""
        numbers = self._numbers()
        return self.one(numbers[0]) if numbers else None

    def every(self) -> list[StoredVersion]:
        """Return the kept versions that can be read, newest first."""
        found = (self.one(number) for number in self._numbers())
        return [each for each in found if each is not None]

    def one(self, number: int) -> StoredVersion | None:
        """Return a version; None if it is not kept, or cannot be read."""
        try:
            return msgspec.json.decode(self._file(number).read_bytes(), type=StoredVersion)
        except (OSError, msgspec.MsgspecError):
            return None

    @property
    def files(self) -> list[Path]:
        """The files of the versions, oldest first."""
        return [self._file(number) for number in reversed(self._numbers())]

    def next_number(self) -> int:
        """Return the number of the next version."""
        return max(self._numbers(), default=0) + 1

    def add(self, stored: StoredVersion) -> None:
        """Write a version, on disk when this returns; remove the oldest beyond `MAX_VERSIONS`."""
        make_folder(self._folder)
        write_file(self._file(stored.version.number), msgspec.json.encode(stored))
        for number in self._numbers()[MAX_VERSIONS:]:
            self._file(number).unlink(missing_ok=True)

    def withdraw(self, number: int) -> None:
        """Remove a version that did not become the file."""
        self._file(number).unlink(missing_ok=True)

    def _numbers(self) -> list[int]:
        names = [path.stem for path in self._folder.glob("*.json")] if self._folder.is_dir() else []
        return sorted((int(name) for name in names if name.isdecimal()), reverse=True)

    def _file(self, number: int) -> Path:
        return self._folder / f"{number:06d}.json"
