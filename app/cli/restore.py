"""``lineside restore``: make a unit what a file says, row by row, each proven."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from app.cli.backup import AsJson, Bus, Token, Url
from app.cli.dashboard import Dashboard, dashboard
from app.cli.diff import load, rows_for
from app.cli.ending import ending
from app.sets.document import write_document
from app.sets.model import ParameterSet

_ENDED = ("equal", "different", "stopped")
_LOOK_AGAIN_S = 0.2


def register(cli: typer.Typer) -> None:
    """Add the command."""
    cli.command()(restore)


def restore(
    file: Annotated[Path, typer.Argument(help="A file by lineside backup.", metavar="FILE")],
    url: Url,
    token: Token,
    bus: Bus,
    unit: Annotated[int, typer.Option(min=1, max=255, help="The unit to write to.")],
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
    tick: Annotated[list[int] | None, typer.Option(help="A dangerous parameter to write as well.")] = None,
    as_json: AsJson = False,
) -> None:
    """Show the difference, ask, write only what differs, verify each row, read all again."""
    with ending(), dashboard(url, token) as there:
        planned = _plan(there, bus, unit, file, tick or [])
        typer.echo(_plan_text(planned), err=as_json)
        if planned["rows"] and not yes and not _agreed(unit):
            typer.echo("nothing was written", err=True)
            raise typer.Exit(1)
        ended = _run(there, planned, quiet=as_json)
        typer.echo(json.dumps(_results(ended)) if as_json else _ending_text(ended))
        if ended["state"] != "equal":
            typer.echo(f"lineside: unit {unit} does not equal {file}: {_why(ended)}", err=True)
            raise typer.Exit(1)


def _plan(there: Dashboard, bus: str, unit: int, file: Path, ticked: list[int]) -> Any:
    held = load(file)
    rows = rows_for(held, unit, file)
    there.check_unit(bus, unit)
    document = write_document(
        ParameterSet(held.bus, held.taken_at, held.who, "from a file", (rows,)), with_secrets=True
    )
    return there.post(f"/buses/{bus}/units/{unit}/restores", {"document": document, "ticked": ticked})


def _agreed(unit: int) -> bool:
    try:
        return typer.confirm(f"Write these rows to unit {unit}?", err=True)
    except typer.Abort:
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
                typer.echo(_row_text(row))
        if now["state"] in _ENDED:
            return now
        time.sleep(_LOOK_AGAIN_S)


def _results(ended: Any) -> list[Any]:
    """A result per row, also of those that nothing was sent for because the unit is not in REMOTE."""
    unsent = [
        {key: left[key] for key in ("number", "name")} | {"outcome": "left_out", "message": left["reason"]}
        for left in ended["left_out"]
        if left["later"]
    ]
    return [*ended["rows"], *unsent]


def _plan_text(planned: Any) -> str:
    lines = [
        f"#{row['number']:<3}{row['name']:<32}{row['present']:>14} → {row['wanted']}  {row['meaning']}"
        for row in planned["rows"]
    ]
    lines += [
        f"#{left['number']:<3}{left['name']:<32}left out: {left['reason']}" for left in planned["left_out"]
    ]
    head = f"{len(planned['rows'])} rows to write, {planned['equal']} equal"
    return "\n".join([*(f"note: {remark}" for remark in planned["remarks"]), head, *lines])


def _row_text(row: Any) -> str:
    said = f": {row['message']}" if row["message"] else ""
    return f"#{row['number']:<3}{row['name']:<32}{row['outcome']}{said}"


def _ending_text(ended: Any) -> str:
    verified = sum(row["outcome"] == "verified" for row in ended["rows"])
    return f"{verified} of {len(ended['rows'])} rows verified; read again as a whole: {ended['state']}"


def _why(ended: Any) -> str:
    if ended["cause"]:
        return str(ended["cause"])
    rows = ", ".join(f"#{row['number']}" for row in ended["remaining"] or [])
    return f"{rows} differ; run it again to finish the rest" if rows else "see the rows"
