"""The command ``lineside publish``: past data for the plant's database."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from zoneinfo import ZoneInfo

import click

from app.cli.command import config_option, report, typed_time
from app.cli.site import open_history, reading_site
from app.line.history.series.runs import SECOND, micros
from app.records.handover.rules import site_time
from app.settings import load
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
    """Write past readings, minutes, events and alarms to the plant's database of [postgresql]. It may be
    repeated while the dashboard runs: data that is there already is not written again."""
    settings = load(config)
    to = settings.postgresql
    if to is None:
        raise CallerError(Message.of("publish_not_configured", config=str(config)))
    zone = ZoneInfo(settings.site.zone)
    code = "publish_time_malformed"
    begins, ends = typed_time(since, zone, code), typed_time(until, zone, code) if until else unix_now()
    span = micros(begins), micros(ends)
    if span[0] >= span[1]:
        raise CallerError(Message("publish_span_reversed"))
    with ExitStack() as opened:
        site = opened.enter_context(reading_site(settings))
        history = open_history(settings, opened)
        destination = Destination(to, settings.site.name, read_identity(site), settings.bus)
        opened.callback(destination.abandon)
        destination.connect()
        rows = HistoryRows(settings.bus, to.step)
        sent = sum(_shown(fill(site, history, destination, rows, span), zone))
    start, end = (site_time(UnixTime(at / SECOND), zone) for at in span)
    report(Message.of("published_past", n=sent, rows=number(str(sent)), start=start, end=end, place=to.place))
    if rows.damaged:
        report(Message.of("published_without", n=len(rows.damaged)))


def _shown(progress: Iterator[tuple[int, int]], zone: ZoneInfo) -> Iterator[int]:
    """Yield the rows of each batch, and show the progress to a person at a terminal."""
    for until, count in progress:
        if sys.stderr.isatty():
            click.echo(f"\r{site_time(UnixTime(until / SECOND), zone)}", err=True, nl=False)
        yield count
    if sys.stderr.isatty():
        click.echo("\r", err=True, nl=False)
