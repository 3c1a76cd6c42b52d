"""What people are told on the pages while the audit log proves less than it should."""

from __future__ import annotations

from collections.abc import Callable

from app.audit.anchoring import AnchorStatus
from app.web.formats import Formats


def anchor_notice(status: AnchorStatus, t: Callable[..., str], formats: Formats, now: float) -> str:
    """A sentence in the reader's language; empty while the log is anchored and whole. ``now``: Unix time in
    seconds."""
    if status.altered:
        return t("The audit log was altered after it was anchored. Run lineside audit verify.")
    if status.unwritten:
        since, why = formats.since(status.since, now), t(status.unwritten)
        return t("The audit log is not anchored since {time}. Cause: {why}", time=since, why=why)
    return ""
