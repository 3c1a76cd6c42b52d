"""``lineside restore``: make a unit equal a file, row by row, each verified."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated, Any

import click

from app.cli.api.backup import Bus, Url
from app.cli.api.credentials import TokenFile, TokenOption, bearer_token
from app.cli.api.dashboard import Dashboard, dashboard
from app.cli.api.diff import load, rows_for
from app.cli.ending import complain, report
from app.cli.options import Argument, AsJson, Option
from app.sets.document import write_document
from app.sets.model import ParameterSet
from bus.messages import Message, ParamValue, listed, parameter_name

_ENDED = ("equal", "different", "stopped")
_LOOK_AGAIN_S = 0.2


def restore(
    file: Annotated[Path, Argument(help="A file of lineside backup.", metavar="FILE")],
    url: Url,
    bus: Bus,
    unit: Annotated[int, Option(min=1, max=255, help="The unit to write to.")],
    token: TokenOption = "",
    token_file: TokenFile = None,
    yes: Annotated[bool, Option("--yes", help="Skip the confirmation.")] = False,
    include: Annotated[
        list[int] | None,
        Option(help="A setpoint (20 or 37) to write too: the machine changes its speed. Repeatable."),
    ] = None,
    exclude: Annotated[list[int] | None, Option(help="A parameter to leave out. Repeatable.")] = None,
    tick: Annotated[list[int] | None, Option(help="A dangerous parameter to write too. Repeatable.")] = None,
    as_json: AsJson = False,
) -> None:
    """Show the differences, confirm, write the rows that differ, verify each row, read all parameters back.

    Exit 0 only when the unit equals the file in every row that was to be written; rows left out are listed.
    """
    with dashboard(url, bearer_token(token, token_file)) as there:
        chosen = {"include": include or [], "exclude": exclude or [], "ticked": tick or []}
        planned = _plan(there, bus, unit, file, chosen)
        click.echo(_plan_text(planned), err=as_json)
        if _selected(planned) and not yes and not _agreed(unit):
            report(Message("nothing_written"), err=True)
            raise click.exceptions.Exit(1)
        ended = _run(there, planned, quiet=as_json)
        click.echo(json.dumps(_results(ended)) if as_json else _ending_text(ended))
        if ended["state"] != "equal":
            complain(Message.of("unit_not_equal", unit=unit, file=str(file), reason=_why(ended)))
            raise click.exceptions.Exit(1)


def _plan(there: Dashboard, bus: str, unit: int, file: Path, chosen: dict[str, list[int]]) -> Any:
    held = load(file)
    rows = rows_for(held, unit, file)
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
    """A result per row, also of those that differ and were left out."""
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
    """The English text of a message of the API; a hyphen where it has none."""
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
