"""What a mail has attached to it: made when it is sent, by the feature that it is about."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from app.notification.message.notice import ReportNotice
from bus.messages import Message


@dataclass(frozen=True, slots=True)
class Attachment:
    """A page as a file. ``summary``: lines of the text of the mail."""

    name: str
    page: str
    summary: tuple[Message, ...] = ()


@dataclass(frozen=True, slots=True)
class ReportAttachments:
    """``of`` makes the page of a report; it raises LinesideError where it cannot."""

    of: Callable[[ReportNotice], Awaitable[Attachment]]
