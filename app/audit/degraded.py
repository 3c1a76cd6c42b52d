"""The notice on the pages while the audit log is verifiable only in part."""

from __future__ import annotations

from app.audit.anchoring import AnchorStatus
from app.web.formats import Formats
from bus.instants import UnixTime
from bus.messages import Message


def anchor_notice(status: AnchorStatus, formats: Formats, now: UnixTime) -> Message | None:
    """None while the log is anchored and intact. ``now``: Unix time in seconds."""
    if status.altered is not None:
        return Message("audit_altered_after_anchor")
    if status.unwritten is not None:
        since = formats.since(status.since, now)
        return Message.of("audit_anchor_missed", time=since, reason=status.unwritten)
    return None
