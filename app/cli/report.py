"""The command ``lineside report``: the report of a shift or span from the stores."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import click

from app.cli.command import config_option, json_option, typed_time
from app.cli.site import open_history, reading_site
from app.core.database import StoreConnection
from app.core.database.connection import snapshot
from app.core.web.csv_file import FOR_PROGRAMS
from app.core.web.formats import lasting
from app.core.web.shape import iso
from app.line.history.query import stored_tail
from app.line.history.report import UnitReport
from app.records.handover.figures import reported_buses
from app.records.handover.rules import EVERYTHING, Shift, shift_at, site_time
from app.records.handover.signatures import signed_between
from app.records.reports.report import ReportedUnit, span_report
from app.records.reports.rules import MAX_DAYS
from app.records.reports.service import stops_text, units_text
from app.settings import Settings, load
from bus.errors import CallerError
from bus.instants import DAY_S, UnixTime, unix_now
from bus.messages import Message, ParamValue, number
from bus.settings import BusSettings

MAX_LINES = 50
"""The most lines of a section of the printed report; the JSON has all."""


@click.command
@click.option(
    "--shift",
    default="last",
    help="When the shift starts, such as 2026-11-26T06:00; or 'now', or 'last' for the one before.",
)
@click.option(
    "--since",
    default="",
    show_default=False,
    help="Instead of a shift, the span from this time on, such as 2026-11-26T06:00.",
)
@click.option("--until", default="", show_default=False, help="End of the span; without it, now.")
@config_option
@json_option
@click.option("--csv", "as_csv", is_flag=True, help="The units as CSV, one in a row.")
@click.option("--stops", is_flag=True, help="The stops of all units as CSV, one in a row.")
def report(
    shift: str, since: str, until: str, config: Path, as_json: bool, as_csv: bool, stops: bool
) -> None:
    """Show the report of a shift, or of a span: run time, time at speed, stops with their causes, length and
    draw of each unit, alarms, drift, changes and notes. It is read from the stores of this machine, also from
    a copy of them."""
    settings, now = load(config), unix_now()
    with ExitStack() as opened:
        connection = opened.enter_context(reading_site(settings))
        history = open_history(settings, opened)
        opened.enter_context(snapshot(connection))
        span = (
            _span_of(settings, since, until, now)
            if since or until
            else _shift_of(connection, settings, shift, now)
        )
        figures = [] if history is None else _figures(history, settings, span, now)
        found = span_report(connection, settings, span, now, EVERYTHING, figures)
    if as_json:
        click.echo(json.dumps(found, ensure_ascii=False))
        return
    if as_csv or stops:
        click.echo((stops_text if stops else units_text)(found, FOR_PROGRAMS), nl=False)
        return
    for line in _lines(found, ZoneInfo(settings.site.zone)):
        click.echo(line)


def _figures(
    history: StoreConnection, settings: Settings, span: Shift, now: UnixTime
) -> list[tuple[BusSettings, UnitReport]]:
    tail = stored_tail(history)
    return [
        (bus, figures.read(history, tail, unit))
        for bus, figures in reported_buses(settings, EVERYTHING, span, now)
        for unit in figures.units
    ]


def _shift_of(connection: StoreConnection, settings: Settings, named: str, now: UnixTime) -> Shift:
    """Return the shift of a name. Raise CallerError if no shift starts then, or it has not begun."""
    starts, zone = settings.shift.minutes, ZoneInfo(settings.site.zone)
    present = shift_at(now, starts, zone)
    if named in ("now", "last"):
        return present if named == "now" else shift_at(present.start - 1.0, starts, zone)
    at = _moment(named, zone)
    if not UnixTime(0.0) < at <= now:
        raise CallerError(Message("shift_not_begun"))
    if signed := signed_between(connection, at, at):
        return signed[0]
    shift = shift_at(at, starts, zone)
    if shift.start != at:
        raise CallerError(Message.of("shift_unknown", time=site_time(at, zone), start=iso(shift.start)))
    return shift


def _span_of(settings: Settings, since: str, until: str, now: UnixTime) -> Shift:
    """Return the span of two times. Raise CallerError if it ends before it begins, begins in the future, or
    is too long."""
    zone = ZoneInfo(settings.site.zone)
    end = _moment(until, zone) if until else now
    if not since or not UnixTime(0.0) < (start := _moment(since, zone)) < min(end, now):
        raise CallerError(Message("report_span_reversed"))
    if end - start > MAX_DAYS * DAY_S:
        raise CallerError(Message.of("report_span_too_long", days=MAX_DAYS))
    return Shift(start, end)


def _moment(text: str, zone: ZoneInfo) -> UnixTime:
    return typed_time(text, zone, "report_shift_malformed")


def _lines(found: dict[str, Any], zone: ZoneInfo) -> Iterator[str]:
    start, until = (datetime.fromisoformat(found[each]).astimezone(zone) for each in ("start", "until"))
    form = "%H:%M" if until - start < timedelta(days=1) else "%Y-%m-%d %H:%M"

    def clock(instant: str) -> str:
        return datetime.fromisoformat(instant).astimezone(zone).strftime(form)

    span = {"site": found["site"], "start": f"{start:%Y-%m-%d %H:%M}", "end": clock(found["until"])}
    yield str(Message("report_head", {**span, "zone": found["time_zone"]}))
    for unit in found["units"]:
        yield from map(str, _unit_lines(unit, clock))
    yield from _section("report_alarms", [_alarm(each, clock) for each in found["alarms"]])
    yield from _section("report_standing", [_alarm(each, clock) for each in found["standing"]])
    yield from _section("report_drift", [_alarm(each, clock) for each in found["drift"]])
    changes = [*found["limits"]["events"], *found["recipes"]["events"], *found["done"]["events"]]
    changes.sort(key=lambda event: int(event["id"]))
    yield from _section("report_changes", [_change(each, clock) for each in changes])
    notes = [each for each in found["notes"] if each["corrected_by"] is None]
    yield from _section(
        "report_notes", [f"{clock(each['time'])} {each['who']}: {each['text']}" for each in notes]
    )
    yield from _section("report_omissions", [each["detail"] for each in found["omissions"]])


def _section(code: str, lines: list[str]) -> Iterator[str]:
    """Yield the newest lines of a section, after a head with their number."""
    yield str(Message.of(code, n=len(lines)))
    yield from (f"  {line}" for line in lines[-MAX_LINES:])


def _unit_lines(unit: ReportedUnit, clock: Callable[[str], str]) -> Iterator[Message]:
    place: dict[str, ParamValue] = {"bus": unit["bus"], "unit": unit["unit"], "name": unit["name"]}
    if "running_s" not in unit:
        yield Message("report_unit_ratio", place)
        return
    stops = unit["stops"]
    place |= {"ran": lasting(unit["running_s"]), "known": lasting(unit["known_s"]), "n": len(stops)}
    if unit["length"] is None:
        yield Message("report_unit", place)
    else:
        length = number(f"{unit['length']:.1f}")
        yield Message(
            "report_unit_length", place | {"length": length, "length_unit": unit["length_unit"] or ""}
        )
    draw = unit["draw"]
    yield Message.of(
        "report_unit_at_speed", at_speed=lasting(unit["at_speed_s"]), unread=lasting(unit["unread_s"])
    )
    if draw is not None:
        average, least, greatest = (
            number(f"{each:.2f}") for each in (draw["average"], draw["least"], draw["greatest"])
        )
        yield Message.of("report_unit_draw", average=average, least=least, greatest=greatest)
    for stop in stops[-MAX_LINES:]:
        yield Message.of(
            "report_stop",
            start=clock(stop["start"]),
            end=clock(stop["end"]),
            lasted=lasting(stop["seconds"]),
            cause=Message(f"report_stop_{stop['cause']}"),
        )


def _alarm(each: dict[str, Any], clock: Any) -> str:
    place = f"{each['bus']}/{each['unit']} " if each["unit"] is not None else f"{each['bus'] or ''} ".lstrip()
    return f"{clock(each.get('came') or each['time'])} {place}{each['name']} ({each['priority']})"


def _change(event: dict[str, Any], clock: Any) -> str:
    place = "/".join(str(each) for each in (event["bus"], event["unit"]) if each is not None)
    values = " → ".join(each for each in (event["old"], event["new"]) if each)
    parts = (clock(event["time"]) if event["time"] else "", event["who"], place, event["what"], values)
    return " ".join(part for part in (*parts, event["outcome"] or "") if part)
