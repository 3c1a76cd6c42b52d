"""Notices that the holder of control has left without releasing it."""

from __future__ import annotations

from collections.abc import Collection

from app.conditions.of_bus import CONTROL_LEFT
from app.web.admission.access import account_shown
from bus.instants import Monotonic
from bus.messages import Message


def control_left_by(
    holder: str, used_at: Monotonic, present: Collection[str], now: Monotonic
) -> Message | None:
    """The holder who has left control without releasing it; None while that is not so. ``used_at``: when the
    holder last sent a command; ``present``: the accounts with an open page."""
    if not CONTROL_LEFT.holds(now - used_at, holder in present):
        return None
    return Message.of("alarm_control_left_by", who=account_shown(holder))
