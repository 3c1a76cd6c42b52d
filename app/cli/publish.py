"""``lineside publish``: fill a past into the plant's database."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

import click

from app.cli.options import config_option
from app.cli.process import report
from app.cli.site import reading_site
from app.core.database import StoreConnection
from app.core.database.connection import examining
from app.line.history.series.runs import SECOND, micros
from app.line.history.service import FILE as HISTORY
from app.records.handover.rules.shifts import site_time
from app.settings import Settings, load
from app.system.postgresql.destination import Destination
from app.system.postgresql.outbox import HistoryRows, fill, read_identity
from bus.errors import CallerError
from bus.instants import UnixTime, unix_now
from bus.messages import Message, number


@click.command
@click.option(
    "--from",
    "since",
    required=True,
    help="From when on, such as 2026-01-01 or 2026-01-01T06:00, in local time.",
)
@click.option("--to", "until", default="", show_default=False, help="Up to when; without it, now.")
@config_option
def publish(since: str, until: str, config: Path) -> None:
    """Fill a past into the plant's database of [postgresql]: readings, minutes, events and alarms. It may be
    repeated, and the dashboard may run: what is there already is not written again."""
    settings = load(config)
    to = settings.postgresql
    if to is None:
        raise CallerError(Message.of("publish_not_configured", config=str(config)))
    zone = ZoneInfo(settings.site.zone)
    span = _instant(since, zone), _instant(until, zone) if until else micros(unix_now())
    if span[0] >= span[1]:
        raise CallerError(Message("publish_span_reversed"))
    with ExitStack() as opened:
        site = opened.enter_context(reading_site(settings))
        history = _history(settings, opened)
        destination = Destination(to, settings.site.name, read_identity(site), settings.bus)
        opened.callback(destination.abandon)
        destination.connect()
        rows = HistoryRows(settings.bus, to.step)
        sent = sum(_shown(fill(site, history, destination, rows, span), zone))
    start, end = (site_time(UnixTime(at / SECOND), zone) for at in span)
    report(Message.of("published_past", rows=number(str(sent)), start=start, end=end, place=to.place))
    if rows.damaged:
        report(Message.of("published_without", n=len(rows.damaged)))


def _history(settings: Settings, opened: ExitStack) -> StoreConnection | None:
    file = settings.server.data / HISTORY
    return opened.enter_context(examining(file)) if file.exists() else None


def _instant(text: str, zone: ZoneInfo) -> int:
    try:
        at = datetime.fromisoformat(text.strip())
    except ValueError:
        raise CallerError(Message.of("publish_time_malformed", text=text)) from None
    return micros(UnixTime((at if at.tzinfo else at.replace(tzinfo=zone)).timestamp()))


def _shown(progress: Iterator[tuple[int, int]], zone: ZoneInfo) -> Iterator[int]:
    """The rows of each batch; a person at a terminal sees how far it is."""
    for until, count in progress:
        if sys.stderr.isatty():
            click.echo(f"\r{site_time(UnixTime(until / SECOND), zone)}", err=True, nl=False)
        yield count
    if sys.stderr.isatty():
        click.echo("\r", err=True, nl=False)
