"""The conditions of the server, by what its services report. Pure."""

from __future__ import annotations

from collections.abc import Callable

from app.conditions.condition import Condition, Tuning
from app.conditions.evidence import StatePredicate
from app.conditions.expiry import certificate_expires, token_expires
from bus.instants import UnixTime

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
    means="a `ca_file` of `[notify]` ends within 30 days, or has ended; of several certificates in a file the"
    " last one counts",
)
TOKEN_EXPIRING: Condition[Callable[[UnixTime, UnixTime | None, UnixTime | None, UnixTime], bool]] = Condition(
    "token_expiring",
    ("major", "shift"),
    holds=token_expires,
    means="a token that was used in the last 30 days ends within 14 days, or within the last tenth of its"
    " life",
)

OF_SERVER = (
    HISTORY_DEGRADED,
    AUDIT_DEGRADED,
    DISK_LOW,
    NOTIFICATION_FAILED,
    CLOCK_STEPPED,
    CERTIFICATE_EXPIRING,
    TOKEN_EXPIRING,
)
