"""What people and programs are sent: texts in the language of the site, and JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from app.alarms.notification.notice import AlarmNotice, OutboxItem
from app.alarms.notification.store import Delivery
from app.alarms.rules.priority import PRIORITIES
from app.messages.language import Language
from app.web.formats import Formats
from app.web.message_shown import message_shown
from app.web.shape import iso
from bus.instants import UnixTime
from bus.messages import Message, term

LinkMaker = Callable[[str], str]
"""From the id of an alarm to the link that acknowledges it; empty where no link can be made."""


@dataclass(frozen=True, slots=True)
class Letter:
    """A message for people. ``subject`` is one line."""

    id: str
    subject: str
    body: str
    at: datetime
    is_urgent: bool = False


@dataclass(frozen=True, slots=True)
class Composer:
    """``link``: see LinkMaker."""

    site: str
    language: Language
    formats: Formats
    link: LinkMaker

    def letter(self, delivery: Delivery, now: UnixTime) -> Letter:
        """One message of all items of a delivery."""
        items = sorted(delivery.items, key=_rank)
        parts = [self._paragraph(item) for item in items]
        return Letter(
            id=delivery.message_id,
            subject=_one_line(self.language.t(self._subject(items))),
            body="\n\n".join((*parts, self._text("notify_footer", site=self.site, id=delivery.message_id)))
            + "\n",
            at=datetime.fromtimestamp(float(now), UTC),
            is_urgent=any(
                item.kind == "alarm" and item.notice is not None and item.notice.priority == "urgent"
                for item in items
            ),
        )

    def _subject(self, items: Sequence[OutboxItem]) -> Message:
        if len(items) == 1 or items[0].notice is None:
            return self._subject_of(items[0])
        urgent = sum(item.notice is not None and item.notice.priority == "urgent" for item in items)
        return Message.of("notify_subject_digest", site=self.site, n=len(items), urgent=urgent)

    def _subject_of(self, item: OutboxItem) -> Message:
        notice = item.notice
        if notice is None:
            return Message.of(f"notify_subject_{item.kind}", site=self.site)
        code = "escalated" if notice.escalated and item.kind == "alarm" else item.kind
        return Message.of(
            f"notify_subject_{code}",
            priority=term(notice.priority),
            place=self._place(notice),
            name=notice.name,
        )

    def _paragraph(self, item: OutboxItem) -> str:
        notice = item.notice
        if notice is None:
            return self._text(f"notify_body_{item.kind}", site=self.site)
        at = self.formats.moment(UnixTime(notice.at))
        lines = [self.language.t(self._subject_of(item)), self._text(f"notify_line_{item.kind}", time=at)]
        if item.kind == "alarm":
            lines += [self._text("notify_line_cause", text=notice.cause)]
            lines += [self._text("notify_line_response", text=notice.response)]
        link = self.link(notice.id)
        if link and (item.kind == "alarm" or notice.state in ("rtn_unack", "latched_unack")):
            lines.append(self._text("notify_line_link", link=link))
        return "\n".join(_one_line(line) for line in lines)

    def _place(self, notice: AlarmNotice) -> str:
        return notice.place or self.site

    def _text(self, code: str, **params: Any) -> str:
        return self.language.t(Message.of(code, **params))


def hook_body(site: str, delivery: Delivery, now: UnixTime) -> dict[str, Any]:
    """The body of a webhook; its texts are English, as those of the API."""
    item = delivery.items[0]
    notice = item.notice
    body: dict[str, Any] = {"id": delivery.message_id, "kind": item.kind, "time": iso(now), "site": site}
    if notice is not None:
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
            "acknowledged": notice.state not in ("unack_active", "rtn_unack", "latched_unack"),
            "since": iso(UnixTime(notice.at)),
            "message": f"{notice.name}. {notice.response}",
            "reason": message_shown(notice.name),
        }
    return body


def _rank(item: OutboxItem) -> tuple[int, bool, int]:
    """Alarms by priority, then what is about none, then all-clears."""
    priority = len(PRIORITIES) if item.notice is None else PRIORITIES.index(item.notice.priority)
    return priority if item.kind != "clear" else len(PRIORITIES) + 1, item.kind == "clear", item.id


def _one_line(text: str) -> str:
    """A name with a line break must not become a header or a line that looks like ours."""
    return " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())
