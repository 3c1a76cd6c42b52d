"""The difference of two texts of the file, line by line, without their secrets."""

from __future__ import annotations

import re
import secrets
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import SequenceMatcher
from hashlib import blake2b
from typing import Annotated, Literal

from pydantic import Field

from bus.configuration import HOLDS_SECRET, lines_of

CONTEXT = 2
"""Lines that are shown around a change."""
_IN_URL = re.compile(r"(\w+://)[^\s/@\"']*@")
_KEY = secrets.token_bytes(16)
"""Another one in each run, so that the digest of a simple password cannot be looked up."""


@dataclass(frozen=True, slots=True)
class DifferenceLine:
    """A line of a difference; of a ``gap`` lines are left out."""

    kind: Literal["same", "gone", "new", "gap"]
    number: Annotated[int, Field(description="In the new text; of a line that is gone, in the old one.")]
    text: Annotated[str, Field(description="Secrets are masked.")]


def masked(text: str) -> str:
    """The text as people see it: of each key that may hold a secret only whether it changes, also in a
    comment. The file of a secret is no secret."""
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
    """The lines that differ, each with those around it; of secrets, that they differ."""
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
