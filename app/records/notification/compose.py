"""The texts that people and programs receive: letters in the language of the site, JSON, and links to
alarms."""

from __future__ import annotations

import hmac
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlencode

from app.core.messages.languages import Language
from app.core.web.formats import Formats
from app.core.web.shape import iso, message_shown
from app.errors import Problem
from app.line.conditions.condition import PRIORITIES
from app.records.notification.outbox import Attachment, NotificationDelivery, OutboxItem, ReportNotice
from app.records.notification.rules import UNACKNOWLEDGED
from bus.instants import UnixTime, unix_now
from bus.messages import Message, term

PATH = "/notifications/acknowledge"
VALID_S = 7 * 86_400


@dataclass(frozen=True, slots=True)
class Letter:
    """A message for people, whose ``subject`` is one line."""

    id: str
    subject: str
    body: str
    at: datetime
    is_urgent: bool = False
    pages: tuple[Attachment, ...] = ()


@dataclass(frozen=True, slots=True)
class Composer:
    """The composer, which writes letters in the language of the site. ``link``: makes the link to an
    occurrence, or an empty text."""

    site: str
    language: Language
    formats: Formats
    link: Callable[[str], str]

    def letter(
        self, delivery: NotificationDelivery, now: UnixTime, pages: Sequence[Attachment] = ()
    ) -> Letter:
        """Write one message of all items of a delivery. ``pages``: the pages of its reports."""
        items = sorted(delivery.items, key=_rank)
        summary = [
            "\n".join((page.name, *(_one_line(self.language.t(line)) for line in page.summary)))
            for page in pages
        ]
        footer = Message.of("notify_footer", site=self.site, id=delivery.message_id)
        return Letter(
            id=delivery.message_id,
            subject=_one_line(self.language.t(self._subject(items))),
            body="\n\n".join((*map(self._paragraph, items), *summary, self.language.t(footer))) + "\n",
            at=datetime.fromtimestamp(float(now), UTC),
            is_urgent=any(map(_is_urgent, items)),
            pages=tuple(pages),
        )

    def _subject(self, items: Sequence[OutboxItem]) -> Message:
        if len(items) == 1:
            return self._subject_of(items[0])
        urgent = sum(map(_is_urgent, items))
        return Message.of("notify_subject_digest", site=self.site, n=len(items), urgent=urgent)

    def _subject_of(self, item: OutboxItem) -> Message:
        notice = item.alarm_notice
        if isinstance(item.notice, ReportNotice):
            return item.notice.name
        if notice is None:
            return Message.of(f"notify_subject_{item.kind}", site=self.site)
        code = "escalated" if notice.escalated and item.kind == "alarm" else item.kind
        return Message.of(
            f"notify_subject_{code}",
            priority=term(notice.priority),
            place=notice.place or self.site,
            name=notice.name,
        )

    def _paragraph(self, item: OutboxItem) -> str:
        lines = [self._subject_of(item), *self._lines(item)]
        return "\n".join(_one_line(self.language.t(line)) for line in lines)

    def _lines(self, item: OutboxItem) -> Iterator[Message]:
        notice = item.alarm_notice
        if notice is None:
            yield Message.of(f"notify_body_{item.kind}", site=self.site)
            return
        yield Message.of(f"notify_line_{item.kind}", time=self.formats.moment(UnixTime(notice.at)))
        if item.kind == "alarm":
            yield Message.of("notify_line_cause", text=notice.cause)
            yield Message.of("notify_line_response", text=notice.response)
        link = self.link(notice.id) if notice.state in UNACKNOWLEDGED else ""
        if link:
            yield Message.of("notify_line_link", link=link)


def hook_body(site: str, delivery: NotificationDelivery, now: UnixTime) -> dict[str, Any]:
    """Return the body of a webhook, with English texts as in the API."""
    item = delivery.items[0]
    notice = item.alarm_notice
    body: dict[str, Any] = {"id": delivery.message_id, "kind": item.kind, "time": iso(now), "site": site}
    if notice is not None:
        text = Message.of("alarm_text", name=notice.name, response=notice.response)
        body["escalated"] = notice.escalated
        body["alarm"] = {
            "id": notice.id,
            "name": str(notice.name),
            "code": notice.code,
            "bus": notice.bus,
            "unit": notice.unit,
            "place": notice.place,
            "priority": notice.priority,
            "state": notice.state,
            "active": notice.active,
            "acknowledged": notice.state not in UNACKNOWLEDGED,
            "since": iso(UnixTime(notice.at)),
            "message": str(text),
            "alarm_message": message_shown(text),
        }
    return body


def _rank(item: OutboxItem) -> tuple[int, bool, int]:
    """Return the place of an item: alarms by priority, then items without an alarm, then all-clears."""
    notice = item.alarm_notice
    priority = len(PRIORITIES) if notice is None else PRIORITIES.index(notice.priority)
    return priority if item.kind != "clear" else len(PRIORITIES) + 1, item.kind == "clear", item.id


def _is_urgent(item: OutboxItem) -> bool:
    # The all-clear of an urgent alarm is not urgent.
    return item.kind == "alarm" and item.alarm_notice is not None and item.alarm_notice.priority == "urgent"


def _one_line(text: str) -> str:
    """Return a text on one line: a line break in a name must not start a new line or a mail header."""
    return " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())


class AcknowledgeLinks:
    """The maker of signed links, each to acknowledge one occurrence. A link signs no one in, and opening it
    changes nothing. ``base``: the address of the dashboard; None: no link can be made."""

    def __init__(self, base: str | None) -> None:
        self.key = b""
        """The key that signs links; set before the first link is made."""
        self._base = base

    def make(self, alarm_id: str) -> str:
        """Return the link for an occurrence; empty if no link can be made."""
        if self._base is None:
            return ""
        until = int(float(unix_now())) + VALID_S
        query = {"alarm": alarm_id, "until": until, "signature": self._signature(alarm_id, until)}
        return f"{self._base.rstrip('/')}{PATH}?{urlencode(query)}"

    def check(self, alarm_id: str, until: int, signature: str) -> None:
        """Raise Problem 403 for a link that this dashboard did not make, or that has expired."""
        if not hmac.compare_digest(self._signature(alarm_id, until).encode(), signature.encode()):
            raise Problem(403, "forbidden", Message("notify_link_invalid"))
        if float(unix_now()) > until:
            raise Problem(403, "forbidden", Message("notify_link_expired"))

    def _signature(self, alarm_id: str, until: int) -> str:
        return hmac.new(self.key, f"{until} {alarm_id}".encode(), "sha256").hexdigest()
