"""The conditions of the server, by what its services report. Pure."""

from __future__ import annotations

from collections.abc import Callable

from app.line.conditions.condition import Condition, Tuning
from app.line.conditions.evidence import StatePredicate
from bus.instants import UnixTime

DAY_S = 86_400.0
CERTIFICATE_S = 30 * DAY_S
TOKEN_S = 14 * DAY_S
TOKEN_SHARE = 0.1
"""Share of its life: a token for a day is no alarm from the start."""
BACKUP_S = 26 * 3600.0
"""A day, and time for one that is large."""
PUBLISHER_S = 300.0
"""A restart of a database is no alarm."""
IN_USE_S = 30 * DAY_S
"""A token that no program has used for so long is not missed."""


def certificate_expires(ends_at: UnixTime, now: UnixTime) -> bool:
    """Whether a certificate ends soon, or has ended."""
    return ends_at - now < CERTIFICATE_S


def token_expires(
    created_at: UnixTime, expires_at: UnixTime | None, used_at: UnixTime | None, now: UnixTime
) -> bool:
    """Whether a token that is in use ends soon, or has ended."""
    if expires_at is None or used_at is None or now - used_at > IN_USE_S:
        return False
    return expires_at - now < min(TOKEN_S, TOKEN_SHARE * (expires_at - created_at))


def backup_is_overdue(newest: UnixTime | None, now: UnixTime, after_s: float = BACKUP_S) -> bool:
    """Whether backups are missing; ``newest``: None where there are to be none. A time in the future is of a
    clock that was wrong, and proves as little as one long past."""
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
    tuning=Tuning(on_delay_s=600),  # of a start, which first makes up for a night that was missed
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
)
