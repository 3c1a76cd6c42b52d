"""The commands ``lineside backup``, ``diff`` and ``restore``: unit parameters as files, by a dashboard."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import click

from app.cli.command import (
    ADDRESS,
    PATH,
    bearer_token,
    bus_option,
    complain,
    json_option,
    report,
    token_file_option,
    token_option,
    url_option,
    yes_option,
)
from app.cli.dashboard import Dashboard, DashboardError, dashboard
from app.core.database.files import write_file
from app.core.web.shape import maybe_shown, message_shown
from app.engineering.sets.model import ParameterDifference, ParameterSet, UnitRows, differences
from app.engineering.sets.store import MAX_DOCUMENT, read_document, write_document
from app.errors import system_error
from bus.errors import CallerError
from bus.instants import unix_now
from bus.messages import Message, ParamValue, in_english, listed, parameter_name

MAX_AT_ONCE = 4
"""The units that are read at once: taking turns saves the fence between two reads of one unit."""
Pair = tuple[UnitRows, UnitRows]
_ENDED = ("equal", "different", "stopped")
_LOOK_AGAIN_S = 0.2


@click.command
@url_option
@bus_option
@click.option("--out", type=PATH, required=True, help="The TOML file to write; it must not exist yet.")
@token_option
@token_file_option
@click.option("--unit", type=int, help="One unit; without it, every unit of the bus.")
@json_option
def backup(
    url: str, bus: str, out: Path, token: str, token_file: Path | None, unit: int | None, as_json: bool
) -> None:
    """Read all parameters from the units and write them to a file (the operator password is masked)."""
    with dashboard(url, bearer_token(token, token_file)) as there:
        _check_place(out)
        wanted = [unit] if unit is not None else list(there.units(bus))
        read, missing = _read(there, bus, wanted)
        if read:
            write_file(out, write_document(_set(bus, read, missing)).encode())
        _report_backup(out, read, missing, as_json)
        if missing:
            raise click.exceptions.Exit(1)


def _check_place(out: Path) -> None:
    """Raise CallerError if no file can be made there, or a file exists already (for root also /dev/null)."""
    if not out.parent.is_dir():
        raise CallerError(Message.of("folder_missing", folder=str(out.parent), file=out.name))
    if os.path.lexists(out):
        raise CallerError(Message.of("backup_exists", file=str(out)))


def _read(there: Dashboard, bus: str, wanted: list[int]) -> tuple[list[UnitRows], dict[int, Message]]:
    """Return the units that responded, and why the others did not; an offline unit does not prevent the
    backup."""

    def read(unit: int) -> UnitRows | Message:
        try:
            return there.read_unit(bus, unit, gaps=True)
        except DashboardError as error:
            return error.message

    with ThreadPoolExecutor(MAX_AT_ONCE) as together:
        found = dict(zip(wanted, together.map(read, wanted), strict=True))
    rows = [given for given in found.values() if isinstance(given, UnitRows)]
    return rows, {unit: why for unit, why in found.items() if isinstance(why, Message)}


def _set(bus: str, units: list[UnitRows], missing: dict[int, Message]) -> ParameterSet:
    comment = str(Message.of("units_not_read", n=len(missing), units=list(missing))) if missing else ""
    return ParameterSet(bus, unix_now(), "lineside backup", "by hand", tuple(units), comment=comment)


def _report_backup(out: Path, read: list[UnitRows], missing: dict[int, Message], as_json: bool) -> None:
    for unit, reason in missing.items():
        report(Message.of("unit_not_read", unit=unit, reason=reason), err=True)
    if as_json:
        units = [unit.unit for unit in read]
        why = {unit: str(reason) for unit, reason in missing.items()}
        whys = {unit: message_shown(reason) for unit, reason in missing.items()}
        done = {"file": str(out) if read else None, "units": units}
        click.echo(json.dumps({**done, "missing": why, "missing_messages": whys}))
    elif read:
        report(Message.of("units_backed_up", n=len(read), file=str(out)))


@click.command
@click.argument(
    "files",
    type=PATH,
    nargs=-1,
    required=True,
    metavar="FILE [FILE]",
    help="One file and a live unit, or two files.",
)
@click.option(
    "--url", default="", show_default=False, envvar="LINESIDE_URL", help="Address of the dashboard."
)
@token_option
@token_file_option
@click.option("--bus", default="", show_default=False, help="Name of the bus.")
@click.option("--unit", type=int, help="The unit to compare with.")
@click.option(
    "--tolerance", type=click.IntRange(0), default=0, help="Difference in raw counts that counts as equal."
)
@json_option
def diff(
    files: Sequence[Path],
    url: str,
    token: str,
    token_file: Path | None,
    bus: str,
    unit: int | None,
    tolerance: int,
    as_json: bool,
) -> None:
    """Show the rows that differ. Exit 0 when equal, 1 when different, 2 on wrong use."""
    if len(files) == 2:
        pairs, lone = _two_files(files)
    else:
        pairs, lone = [_with_live(files, url, (token, token_file), bus, unit)], []
    found = [(right.unit, row) for left, right in pairs for row in differences(left, right, tolerance)]
    if as_json:
        click.echo(json.dumps([_difference_shown(*each) for each in found]))
    elif found or not lone:
        click.echo(_table(found))
    if lone:
        units = ", ".join(map(str, lone))
        report(Message.of("files_differ_in_units", n=len(lone), units=units), err=True)
    if found or lone:
        raise click.exceptions.Exit(1)


def load(path: Path) -> ParameterSet:
    """Read a parameter set from a file. Raise CallerError."""
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


def _rows_for(parameter_set: ParameterSet, unit: int, path: Path) -> UnitRows:
    """Return the rows meant for a unit: its own, or those of the only unit in the file (a spare or
    similar)."""
    own = parameter_set.unit(unit)
    if own is not None:
        return own
    if len(parameter_set.units) == 1:
        return parameter_set.units[0]
    held = ", ".join(str(rows.unit) for rows in parameter_set.units)
    raise CallerError(Message.of("file_lacks_unit", file=str(path), held=held, unit=unit))


def _with_live(
    files: Sequence[Path], url: str, token: tuple[str, Path | None], bus: str, unit: int | None
) -> Pair:
    if len(files) != 1 or not url or not bus or unit is None:
        raise CallerError(Message("diff_sides_missing"))
    wanted = _rows_for(load(files[0]), unit, files[0])
    with dashboard(url, bearer_token(*token)) as there:
        return wanted, there.read_unit(bus, unit)


def _two_files(files: Sequence[Path]) -> tuple[list[Pair], list[int]]:
    """Return the units of both files, and the numbers of those in only one. Two files with one unit each are
    compared whatever the numbers: one may be a spare."""
    left, right = load(files[0]), load(files[1])
    if len(left.units) == len(right.units) == 1:
        return [(left.units[0], right.units[0])], []
    lone = {rows.unit for rows in left.units} ^ {rows.unit for rows in right.units}
    pairs = [(rows, other) for rows in left.units if (other := right.unit(rows.unit)) is not None]
    return pairs, sorted(lone)


def _difference_shown(unit: int, row: ParameterDifference) -> dict[str, Any]:
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
    return "\n".join([head, *(_difference_text(*each) for each in found)])


def _difference_text(unit: int, row: ParameterDifference) -> str:
    values = f"{row.left!s:>14}  {row.right!s:>14}"
    address = Message.of("unit_address", unit=unit)
    return f"{address}  #{row.number:<3}{row.name:<32}{values}  {in_english(row.meaning)}"


@click.command
@click.argument("file", type=PATH, metavar="FILE", help="A file of lineside backup.")
@url_option
@bus_option
@click.option("--unit", type=ADDRESS, required=True, help="The unit to write to.")
@token_option
@token_file_option
@yes_option
@click.option(
    "--include",
    type=int,
    multiple=True,
    help="A setpoint (20 or 37) to write too: the machine changes its speed. Repeatable.",
)
@click.option("--exclude", type=int, multiple=True, help="A parameter to leave out. Repeatable.")
@click.option("--tick", type=int, multiple=True, help="A dangerous parameter to write too. Repeatable.")
@json_option
def restore(
    file: Path,
    url: str,
    bus: str,
    unit: int,
    token: str,
    token_file: Path | None,
    yes: bool,
    include: Sequence[int],
    exclude: Sequence[int],
    tick: Sequence[int],
    as_json: bool,
) -> None:
    """Show the differences, confirm, write the rows that differ, verify each row, read all parameters back.

    Exit 0 only when the unit equals the file in every row that was to be written; rows left out are listed.
    """
    with dashboard(url, bearer_token(token, token_file)) as there:
        planned = _plan(there, bus, unit, file, {"include": include, "exclude": exclude, "ticked": tick})
        click.echo(_plan_text(planned), err=as_json)
        if _selected(planned) and not yes and not _agreed(unit):
            report(Message("nothing_written"), err=True)
            raise click.exceptions.Exit(1)
        ended = _run(there, planned, quiet=as_json)
        click.echo(json.dumps(_results(ended)) if as_json else _ending_text(ended))
        if ended["state"] != "equal":
            complain(Message.of("unit_not_equal", unit=unit, file=str(file), reason=_why(ended)))
            raise click.exceptions.Exit(1)


def _plan(there: Dashboard, bus: str, unit: int, file: Path, chosen: Mapping[str, Sequence[int]]) -> Any:
    held = load(file)
    rows = _rows_for(held, unit, file)
    there.check_unit(bus, unit)
    document = write_document(
        ParameterSet(held.bus, held.taken_at, held.who, "from a file", (rows,)), with_secrets=True
    )
    return there.post(f"/buses/{bus}/units/{unit}/restores", {"document": document, **chosen})


def _selected(planned: Any) -> list[Any]:
    return [row for row in planned["rows"] if row["selected"]]


def _agreed(unit: int) -> bool:
    try:
        return click.confirm(str(Message.of("write_rows", unit=unit)), err=True)
    except click.Abort:
        return False


def _run(there: Dashboard, planned: Any, *, quiet: bool) -> Any:
    there.post(f"/restores/{planned['id']}/start")
    shown = 0
    while True:
        now = there.get(f"/restores/{planned['id']}")
        fresh = [row for row in now["rows"] if row["outcome"] is not None][shown:]
        shown += len(fresh)
        if not quiet:
            for row in fresh:
                click.echo(_row_text(row))
        if now["state"] in _ENDED:
            return now
        time.sleep(_LOOK_AGAIN_S)


def _results(ended: Any) -> list[Any]:
    """Return a result for each row, also for rows that differ and were left out."""
    left_out = [
        {**left, "outcome": "left_out", "message": left["reason"]}
        for left in ended["left_out"]
        if left["differs"]
    ]
    return [*ended["rows"], *left_out]


def _plan_text(planned: Any) -> str:
    rows = _selected(planned)
    head = str(Message.of("rows_to_write", n=len(rows), equal=planned["equal"]))
    notes = [str(Message.of("restore_note", remark=remark["detail"])) for remark in planned["remarks"]]
    return "\n".join([*notes, head, *map(_planned_text, rows), *map(_left_out_text, planned["left_out"])])


def _detail(message: Any) -> str:
    """Return the English text of a message of the API; a hyphen if there is none."""
    return str(message["detail"]) if message else "-"


def _planned_text(row: Any) -> str:
    change = f"{_detail(row['present']):>14} → {_detail(row['wanted'])}  {_detail(row['meaning'])}"
    warning = f"  ({_detail(row['warning'])})" if row["warning"] else ""
    return f"#{row['number']:<3}{row['name']:<32}{change}{warning}"


def _left_out_text(left: Any) -> str:
    values: dict[str, ParamValue] = {name: _detail(left[name]) for name in ("present", "wanted", "reason")}
    text = Message("row_left_out_differs" if left["differs"] else "row_left_out", values)
    return f"#{left['number']:<3}{left['name']:<32}{text}"


def _row_text(row: Any) -> str:
    suffix = f": {_detail(row['message'])}" if row["message"] else ""
    return f"#{row['number']:<3}{row['name']:<32}{row['outcome']}{suffix}"


def _ending_text(ended: Any) -> str:
    verified = sum(row["outcome"] == "verified" for row in ended["rows"])
    end = str(Message.of("rows_verified", verified=verified, n=len(ended["rows"]), state=ended["state"]))
    return "\n".join([end, *(_left_out_text(left) for left in ended["left_out"] if left["differs"])])


def _why(ended: Any) -> str | Message:
    if ended["cause"]:
        return _detail(ended["cause"])
    rows = [parameter_name(row["number"]) for row in ended["remaining"] or []]
    return Message.of("rows_still_differ", n=len(rows), rows=listed(rows)) if rows else Message("see_rows")
