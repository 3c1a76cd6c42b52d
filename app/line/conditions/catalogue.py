"""The conditions of a bus and of the server, and all conditions by code. Pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from app.line.conditions.condition import (
    BusFacts,
    BusPredicate,
    Condition,
    ConditionEvent,
    CountPredicate,
    StatePredicate,
    Tuning,
)
from app.line.conditions.unit import BY_READING, MIN_FAULTS, OF_UNIT
from bus.instants import DAY_S, UnixTime
from bus.messages import TEXTS, Message, ParamValue, term

SCAN_BUDGET = 1.5
"""The multiple of a full scan's time (every unit polled once, with its full turnaround) beyond which the wire
is overloaded."""
CONTROL_IDLE_S = 120.0


def _wire_overloaded(bus: BusFacts) -> bool | None:
    """Return whether a scan takes longer than the cable and its units explain."""
    if not bus.is_readable or bus.scan_s is None:
        return None
    return bus.scan_s > SCAN_BUDGET * bus.longest_scan_s


PORT_LOST: Condition[BusPredicate] = Condition(
    "port_lost",
    ("severe", "minutes"),
    holds=lambda bus: None if bus.worker_is_lost else bus.port_is_closed,
    means="the port of the bus is closed",
    group="bus",
    suppresses=("cable", "unit", "speed"),
    tiles=("port_lost",),
    event=ConditionEvent("bus", "event_port_closed", "event_port_opened", term("open"), term("closed")),
)
NO_UNIT_RESPONDS: Condition[BusPredicate] = Condition(
    "no_unit_responds",
    ("severe", "minutes"),
    holds=lambda bus: bus.has_no_response and bus.lost > 0 if bus.is_readable else None,
    means="no unit of several responds",
    tuning=Tuning(on_delay_s=3, off_delay_s=5),
    group="cable",
    suppresses=("unit", "speed"),
    tiles=("no_unit_responds",),
)
BY_BUS: tuple[Condition[BusPredicate], ...] = (
    Condition(
        "worker_lost",
        ("severe", "minutes"),
        holds=lambda bus: bus.worker_is_lost,
        means="no bus worker is connected, or it reports nothing",
        # A worker that ends is restarted and linked within seconds, as at the start of the server.
        tuning=Tuning(on_delay_s=10),
        suppresses=("bus", "cable", "unit", "speed"),
        tiles=("worker_lost", "worker_silent"),
    ),
    PORT_LOST,
    NO_UNIT_RESPONDS,
    Condition(
        "wire_overloaded",
        ("minor", "shift"),
        holds=_wire_overloaded,
        means="a scan takes longer than one and a half times the polls of all units with their full"
        " turnaround",
        tuning=Tuning(on_delay_s=60, off_delay_s=60),
        group="unit",
    ),
)
"""Conditions that time alone can change."""
SECOND_MASTER: Condition[CountPredicate] = Condition(
    "second_master",
    ("severe", "half_hour"),
    holds=lambda _, unrequested: unrequested >= MIN_FAULTS,
    means="three responses in a minute that Lineside had not requested",
    tuning=Tuning(off_delay_s=60),
    group="bus",
)
CONTROL_LEFT: Condition[Callable[[float, bool], bool]] = Condition(
    "control_left",
    ("minor", "shift"),
    about="drive",
    holds=lambda idle_s, has_page: idle_s > CONTROL_IDLE_S and not has_page,
    means="the holder of control has no page open and has sent no command for two minutes",
    tuning=Tuning(off_delay_s=5),
)
NO_UNIT_YET: Condition[BusPredicate] = Condition(
    "no_unit_yet",
    ("minor", "shift"),
    holds=lambda bus: bus.has_no_response and bus.lost == 0,
    is_alarm=False,
    tiles=("no_unit_yet",),
)

OF_BUS: tuple[Condition[Any], ...] = (*BY_BUS, SECOND_MASTER, CONTROL_LEFT, NO_UNIT_YET)


CERTIFICATE_S = 30 * DAY_S
TOKEN_S = 14 * DAY_S
TOKEN_SHARE = 0.1
"""The last part of a token's life, in which its end raises an alarm: a token for one day raises none at
first."""
BACKUP_S = 26 * 3600.0
"""The seconds after which a nightly backup is overdue: a day, and the time that a large one takes."""
PUBLISHER_S = 300.0
"""The seconds without the plant's database that raise no alarm, because it may be restarting."""
IN_USE_S = 30 * DAY_S
"""The seconds without use after which an expiring token raises no alarm."""


def certificate_expires(ends_at: UnixTime, now: UnixTime) -> bool:
    """Return whether a certificate ends soon, or has ended."""
    return ends_at - now < CERTIFICATE_S


def token_expires(
    created_at: UnixTime, expires_at: UnixTime | None, used_at: UnixTime | None, now: UnixTime
) -> bool:
    """Return whether a token that is in use ends soon, or has ended."""
    if expires_at is None or used_at is None or now - used_at > IN_USE_S:
        return False
    return expires_at - now < min(TOKEN_S, TOKEN_SHARE * (expires_at - created_at))


def backup_is_overdue(newest: UnixTime | None, now: UnixTime, after_s: float = BACKUP_S) -> bool:
    """Return whether a backup is overdue. ``newest``: the time of the newest one; None if none are
    configured. A time in the future comes from a clock that was wrong, and counts as overdue too."""
    return newest is not None and abs(now - newest) > after_s


HISTORY_DEGRADED: Condition[StatePredicate] = Condition(
    "history_degraded",
    ("major", "half_hour"),
    holds=lambda state: state in ("paused", "failed"),
    means="readings are not stored",
    tuning=Tuning(on_delay_s=5),
)
DISK_LOW: Condition[StatePredicate] = Condition(
    "disk_low",
    ("major", "shift"),
    holds=lambda state: state in ("low", "scarce", "paused"),
    means="the disk of the server is nearly full",
    tuning=Tuning(on_delay_s=5),
)
AUDIT_DEGRADED: Condition[Callable[[object], bool]] = Condition(
    "audit_degraded",
    ("major", "shift"),
    holds=bool,
    means="the end of the audit log cannot be anchored, or the log was altered",
)
NOTIFICATION_FAILED: Condition[Callable[[object], bool]] = Condition(
    "notification_failed",
    ("severe", "half_hour"),
    holds=bool,
    means="two attempts for one address failed in succession",
)
CLOCK_STEPPED: Condition[Callable[[float], bool]] = Condition(
    "clock_stepped",
    ("major", "shift"),
    holds=bool,
    means="the clock of the server was set by a second or more; clears a minute later",
    tuning=Tuning(off_delay_s=60),
)
CERTIFICATE_EXPIRING: Condition[Callable[[UnixTime, UnixTime], bool]] = Condition(
    "certificate_expiring",
    ("major", "shift"),
    holds=certificate_expires,
    means="the `certificate` or `client_ca` of `[server.tls]` or a `ca_file` of `[notify]` ends within 30"
    " days, or has ended; of several authorities in a file the last one counts",
)
TOKEN_EXPIRING: Condition[Callable[[UnixTime, UnixTime | None, UnixTime | None, UnixTime], bool]] = Condition(
    "token_expiring",
    ("major", "shift"),
    holds=token_expires,
    means="a token that was used in the last 30 days ends within 14 days, or within the last tenth of its"
    " life",
)
BACKUP_OVERDUE: Condition[Callable[..., bool]] = Condition(
    "backup_overdue",
    ("major", "shift"),
    holds=backup_is_overdue,
    means="the newest backup of `[backup]` is older than 26 hours, with `every` than an hour"
    " and two and a half of its periods, or there is none so long after the last change of the configuration",
    tuning=Tuning(on_delay_s=600),  # A server that starts first makes the backup of a night that was missed.
)
EVENTS_NOT_ARCHIVED: Condition[Callable[[object], bool]] = Condition(
    "events_not_archived",
    ("minor", "shift"),
    holds=bool,
    means="old events could not be written into `archive` of `[audit]`; they stay in the store",
)
PUBLISHER_BEHIND: Condition[Callable[[float], bool]] = Condition(
    "publisher_behind",
    ("minor", "shift"),
    holds=lambda lag_s: lag_s > PUBLISHER_S,
    means="the plant's database of `[postgresql]` lacks what was stored in the last five minutes, or longer",
)
PUBLISHER_DAY_BEHIND: Condition[Callable[[float], bool]] = Condition(
    "publisher_day_behind",
    ("severe", "half_hour"),
    holds=lambda lag_s: lag_s > DAY_S,
    means="the plant's database of `[postgresql]` has lacked what was stored for a day",
)
LINK_ON_DELAY_S = 60.0
"""The delay before a lost connection is an alarm: a broker or a process that restarts is back by then."""
BROKER_LOST: Condition[Callable[[object], bool]] = Condition(
    "broker_lost",
    ("minor", "shift"),
    holds=bool,
    means="a line, or the overview of the lines, has no connection to the broker of `[mqtt]`",
    tuning=Tuning(on_delay_s=LINK_ON_DELAY_S),
)
OPCUA_LOST: Condition[Callable[[object], bool]] = Condition(
    "opcua_lost",
    ("minor", "shift"),
    holds=bool,
    means="the OPC UA server of `[opcua]` does not serve",
    tuning=Tuning(on_delay_s=LINK_ON_DELAY_S),
)

OF_SERVER = (
    HISTORY_DEGRADED,
    AUDIT_DEGRADED,
    DISK_LOW,
    NOTIFICATION_FAILED,
    CLOCK_STEPPED,
    CERTIFICATE_EXPIRING,
    TOKEN_EXPIRING,
    BACKUP_OVERDUE,
    EVENTS_NOT_ARCHIVED,
    PUBLISHER_BEHIND,
    PUBLISHER_DAY_BEHIND,
    BROKER_LOST,
    OPCUA_LOST,
)


Place = Literal["unit", "bus", "server"]
PLACES: dict[Place, tuple[Condition[Any], ...]] = {"unit": OF_UNIT, "bus": OF_BUS, "server": OF_SERVER}
CONDITIONS = {row.code: row for rows in PLACES.values() for row in rows}
TILES = {cause: row for row in CONDITIONS.values() for cause in row.tiles}
STATUS = {row.code: row.status for row in BY_READING if row.status is not None}
"""The conditions that are a single bit of ST1 or ST2 (manual, 81h)."""
UNIT_ALARMS, BUS_ALARMS, SERVER_ALARMS = (
    tuple(row.code for row in rows if row.is_alarm) for rows in PLACES.values()
)


def tile_text(cause: str, **params: ParamValue) -> Message | None:
    """Return the text by which a tile names a cause; None if that has no words in advance."""
    message = Message.of(f"tile_{cause}", **params)
    return message if message.code in TEXTS else None


def tile_check(cause: str) -> Message | None:
    """Return what to check for a cause; None if only time or a decision helps."""
    message = Message(f"tile_{cause}_check")
    return message if message.code in TEXTS else None
