"""``lineside diff``: a file against a unit as it is now, or a file against a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import click

from app.cli.api.credentials import TokenFile, TokenOption, bearer_token
from app.cli.api.dashboard import dashboard
from app.cli.options import Argument, AsJson, Option
from app.errors import system_error
from app.sets.comparison.compare import ParameterDifference, differences
from app.sets.document import MAX_DOCUMENT, read_document
from app.sets.model import ParameterSet, UnitRows
from app.web.api.shape import maybe_shown
from bus.errors import CallerError
from bus.messages import Message, in_english

Pair = tuple[UnitRows, UnitRows]


def diff(
    files: Annotated[
        list[Path], Argument(help="One file and a live unit, or two files.", metavar="FILE [FILE]")
    ],
    url: Annotated[str, Option(help="Address of the dashboard.", envvar="LINESIDE_URL")] = "",
    token: TokenOption = "",
    token_file: TokenFile = None,
    bus: Annotated[str, Option(help="Name of the bus.")] = "",
    unit: Annotated[int | None, Option(help="The unit to compare with.")] = None,
    tolerance: Annotated[int, Option(min=0, help="Difference in raw counts that counts as equal.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Show the rows that differ. Exit 0 when equal, 1 when different, 2 on wrong use."""
    live = len(files) != 2
    pairs = [_with_live(files, url, (token, token_file), bus, unit)] if live else _two_files(files)
    found = [(right.unit, row) for left, right in pairs for row in differences(left, right, tolerance)]
    click.echo(json.dumps([_as_json(*each) for each in found]) if as_json else _table(found))
    if found:
        raise click.exceptions.Exit(1)


def load(path: Path) -> ParameterSet:
    """A parameter set from a file; raises CallerError (DocumentError) in words."""
    try:
        if path.stat().st_size > MAX_DOCUMENT:
            raise CallerError(Message.of("source_too_long", source=str(path)))
        return read_document(path.read_text(encoding="utf-8-sig"), str(path))
    except OSError as error:
        raise CallerError(Message.of("file_unreadable", file=str(path), error=system_error(error))) from error
    except UnicodeDecodeError as error:
        raise CallerError(
            Message.of("source_not_utf8", source=str(path), why=error.reason, n=error.start)
        ) from error


def rows_for(parameter_set: ParameterSet, unit: int, path: Path) -> UnitRows:
    """The rows meant for a unit: its own, or those of the only unit in the file (a spare, a sister)."""
    own = parameter_set.unit(unit)
    if own is not None:
        return own
    if len(parameter_set.units) == 1:
        return parameter_set.units[0]
    held = ", ".join(str(rows.unit) for rows in parameter_set.units)
    raise CallerError(Message.of("file_lacks_unit", file=str(path), held=held, unit=unit))


def _with_live(
    files: list[Path], url: str, token: tuple[str, Path | None], bus: str, unit: int | None
) -> Pair:
    if len(files) != 1 or not url or not bus or unit is None:
        raise CallerError(Message("diff_sides_missing"))
    wanted = rows_for(load(files[0]), unit, files[0])
    with dashboard(url, bearer_token(*token)) as there:
        return wanted, there.read_unit(bus, unit)


def _two_files(files: list[Path]) -> list[Pair]:
    left, right = load(files[0]), load(files[1])
    if len(left.units) == len(right.units) == 1:
        return [(left.units[0], right.units[0])]
    lone = {rows.unit for rows in left.units} ^ {rows.unit for rows in right.units}
    if lone:
        numbers = ", ".join(str(unit) for unit in sorted(lone))
        raise CallerError(Message.of("files_differ_in_units", units=numbers))
    return [(rows, other) for rows in left.units if (other := right.unit(rows.unit)) is not None]


def _as_json(unit: int, row: ParameterDifference) -> dict[str, Any]:
    return {
        "unit": unit,
        "number": row.number,
        "name": row.name,
        "left_raw": row.left_raw,
        "right_raw": row.right_raw,
        "left": str(row.left),
        "right": str(row.right),
        "meaning": in_english(row.meaning),
        "meaning_message": maybe_shown(row.meaning),
    }


def _table(found: list[tuple[int, ParameterDifference]]) -> str:
    if not found:
        return str(Message("sides_equal"))
    head = str(Message.of("rows_differ", n=len(found)))
    return "\n".join([head, *(_line(*each) for each in found)])


def _line(unit: int, row: ParameterDifference) -> str:
    values = f"{row.left!s:>14}  {row.right!s:>14}"
    address = Message.of("unit_address", unit=unit)
    return f"{address}  #{row.number:<3}{row.name:<32}{values}  {in_english(row.meaning)}"
