"""``lineside home``: which server is the home of each bus, and taking one to this server."""

from __future__ import annotations

import getpass
import json
import time
from contextlib import closing
from datetime import UTC, datetime
from typing import Annotated, Any

import click

from app.cli.config_option import LINESIDE_TOML, Config
from app.cli.ending import report
from app.cli.options import Argument, AsJson, CommandGroup, Option
from app.cli.setup.rights import become_owner_of
from app.cli.site.reading import has_store, reading_site
from app.database import Database
from app.home.lease import HomeRow
from app.home.store import Beat, read_homes, request_home
from app.settings import Settings, load
from bus.errors import CallerError, LinesideError
from bus.instants import unix_now
from bus.messages import Message

MAX_TAKE_S = 20.0
"""A lease lapses within 6 s, its holder gives it up within 4, and the taker looks every second."""
LOOK_S = 0.2


class HomeNotTakenError(LinesideError):
    """The home of a bus was not taken by this server."""


def show(
    config: Config = LINESIDE_TOML,
    as_json: AsJson = False,
) -> None:
    """Show which server is the home of each bus, its epoch, and until when."""
    settings = load(config)
    beat = known_homes(settings)
    found = [_shown(bus.name, beat, is_shared=False) for bus in settings.bus]
    if as_json:
        click.echo(json.dumps({"homes": found}))
        return
    for each in found:
        report(_line(each))


home = CommandGroup("Show which server is the home of each bus; take one to this server: take.", alone=show)


@home.add("take")
def take(
    bus: Annotated[str, Argument(help="Name of the bus.")],
    reason: Annotated[str, Option(help="Why; it is in the event.")],
    config: Config = LINESIDE_TOML,
) -> None:
    """Make this server the home of a bus. A holder that runs gives it up; where the bus has a local port,
    first make sure that a holder that does not respond is off or its cable is unplugged."""
    settings = load(config)
    _check(settings, bus, reason)
    if True:
        report(Message.of("home_is_only_server", bus=bus))
        return
    become_owner_of(settings.server.data)
    with closing(Database(settings.server.store)) as database:
        epoch = _take(settings, database, bus, reason.strip())
    report(Message.of("home_was_taken", bus=bus, server=settings.server.id, epoch=epoch))


def _check(settings: Settings, bus: str, reason: str) -> None:
    """Raises CallerError for what can never be taken here."""
    known = [each.name for each in settings.bus]
    if bus not in known:
        raise CallerError(Message.of("home_bus_unknown", bus=bus, known=", ".join(known) or "-"))
    if not reason.strip():
        raise CallerError(Message("home_without_reason"))
    if not settings.server.may_be_home(bus):
        raise CallerError(Message.of("home_not_permitted", bus=bus, server=settings.server.id))


def _take(settings: Settings, database: Database, bus: str, reason: str) -> int:
    """Request it of the servers, and wait; its epoch here."""
    server, before = settings.server.id, database.read_now(read_homes)
    row = before.rows.get(bus)
    if row is not None and is_held(row, before) and row.holder == server:
        return row.epoch
    if row is None or not request_home(database, bus, server, who=_person(), reason=reason):
        raise HomeNotTakenError(Message.of("home_never_held", bus=bus))
    end = time.monotonic() + MAX_TAKE_S
    while time.monotonic() < end:
        time.sleep(LOOK_S)
        now = database.read_now(read_homes).rows.get(bus)
        if now is not None and now.holder == server and now.epoch > row.epoch:
            return now.epoch
    raise HomeNotTakenError(
        Message.of("home_not_taken", bus=bus, server=server, holder=row.holder, seconds=round(MAX_TAKE_S))
    )


def _person() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "-"


def known_homes(settings: Settings) -> Beat:
    """The rows; none where there is no store yet."""
    if not has_store(settings):
        return Beat(unix_now(), {}, {})
    with reading_site(settings) as connection:
        return read_homes(connection)


def is_held(row: HomeRow, beat: Beat) -> bool:
    """Whether a server has the lease of its bus."""
    return not row.is_released and row.until > beat.now


def _shown(bus: str, beat: Beat, *, is_shared: bool) -> dict[str, Any]:
    row = beat.rows.get(bus)
    if row is None:
        return {
            "bus": bus,
            "server": None,
            "url": None,
            "epoch": 0,
            "until": None,
            "held": False,
            "why": None,
        }
    return {
        "bus": bus,
        "server": row.holder,
        "url": row.url,
        "epoch": row.epoch,
        "until": datetime.fromtimestamp(float(row.until), UTC).isoformat() if is_shared else None,
        "held": is_held(row, beat) if is_shared else True,
        "why": row.reason or None,
    }


def _line(each: dict[str, Any]) -> Message:
    if each["server"] is None:
        return Message.of("home_line_none", bus=each["bus"])
    values = {name: each[name] for name in ("bus", "server", "url", "epoch")}
    if each["until"] is None:
        return Message("home_line_alone", values)
    return Message(
        "home_line_held" if each["held"] else "home_line_lapsed", {**values, "until": each["until"]}
    )
