"""``lineside backup``: the parameters of a unit or of a bus, read from the units now, into a file."""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import click

from app.cli.api.credentials import TokenFile, TokenOption, bearer_token
from app.cli.api.dashboard import Dashboard, DashboardError, dashboard
from app.cli.ending import report
from app.cli.options import AsJson, Option
from app.database.private import write_file
from app.sets.document import write_document
from app.sets.model import ParameterSet, UnitRows
from app.web.api.shape import message_shown
from bus.errors import CallerError
from bus.instants import unix_now
from bus.messages import Message

MAX_AT_ONCE = 4
"""Reads of several units take turns on the wire, which saves the fence between two reads of one."""

Url = Annotated[str, Option(help="Address of the dashboard.", envvar="LINESIDE_URL")]
Bus = Annotated[str, Option(help="Name of the bus.")]


def backup(
    url: Url,
    bus: Bus,
    out: Annotated[Path, Option(help="The TOML file to write; it must not exist yet.")],
    token: TokenOption = "",
    token_file: TokenFile = None,
    unit: Annotated[int | None, Option(help="One unit; without it, every unit of the bus.")] = None,
    as_json: AsJson = False,
) -> None:
    """Read all parameters from the units and write them to a file (the operator password is masked)."""
    with dashboard(url, bearer_token(token, token_file)) as there:
        _check_place(out)
        wanted = [unit] if unit is not None else list(there.units(bus))
        read, missing = _read(there, bus, wanted)
        if read:
            write_file(out, write_document(_set(bus, read, missing)).encode())
        _report(out, read, missing, as_json)
        if missing:
            raise click.exceptions.Exit(1)


def _check_place(out: Path) -> None:
    """Raises CallerError where no file can be put, or something is there already: for root /dev/null too."""
    if not out.parent.is_dir():
        raise CallerError(Message.of("folder_missing", folder=str(out.parent), file=out.name))
    if os.path.lexists(out):
        raise CallerError(Message.of("backup_exists", file=str(out)))


def _read(there: Dashboard, bus: str, wanted: list[int]) -> tuple[list[UnitRows], dict[int, Message]]:
    """The units that responded, and why the others did not; one offline unit does not prevent the backup."""

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
    comment = str(Message.of("units_not_read", units=list(missing))) if missing else ""
    return ParameterSet(bus, unix_now(), "lineside backup", "by hand", tuple(units), comment=comment)


def _report(out: Path, read: list[UnitRows], missing: dict[int, Message], as_json: bool) -> None:
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
