"""Following a log from entry to entry, to verify it. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import ConfigDict, Field

from app.audit.chain import Head, confirms_head, entry_hash, notes_altered_end
from app.audit.keyring import KeyRing
from app.web.shape import MessageObject
from bus.messages import Message


@dataclass(frozen=True)
class AuditVerification:
    """Whether the log is intact; ``broken``: the first altered entry; ``fault``: the cause. Entries that are
    older than the key are verified to be as they were when it was made, and no further back."""

    entries: int
    broken: Annotated[int | None, Field(description="Number of the first broken entry; null: none.")] = None
    fault: Annotated[MessageObject | None, Field(description="Why it is not intact; null: it is.")] = None
    unsealed: Annotated[int, Field(description="Entries up to this one are older than the key; 0: none.")] = 0
    anchored: Annotated[int, Field(description="The newest entry that the anchor names; 0: none.")] = 0

    __pydantic_config__ = ConfigDict(json_schema_serialization_defaults_required=True)


class Walk:
    """Follows a log entry by entry, from its beginning or from an entry that is known to be good, and stops
    at the first that is broken. ``anchors``: hashes, by the id of the entry, that were noted elsewhere."""

    def __init__(self, ring: KeyRing, anchors: Mapping[int, str] | None = None, start: Head | None = None):
        self._ring = ring
        self._anchors = anchors or {}
        self._start = start or Head()
        self.last = self._start
        self.broken: AuditVerification | None = None

    def follow(self, entries: Iterable[Mapping[str, Any]]) -> None:
        """The next entries, in order. After the first that is broken nothing more is looked at."""
        for entry in entries:
            if self.broken is not None:
                return
            fault = self._fault(entry)
            if fault is not None:
                self._break(self.last.id + 1, fault)
            else:
                self.last = Head(entry["id"], entry["hash"], entry.get("key") or "")

    def end(self, head: Head | None) -> AuditVerification:
        """The verdict once every entry was followed; ``head`` is what was noted apart as the newest."""
        if self.broken is None:
            self._check_end(head or Head())
        if self.broken is not None:
            return self.broken
        unsealed = min(self.last.id, self._ring.origin.id)
        return AuditVerification(self.last.id, unsealed=unsealed, anchored=max(self._anchors, default=0))

    def _fault(self, entry: Mapping[str, Any]) -> Message | None:
        number = entry["id"]
        if number != self.last.id + 1:
            return Message.of(
                "audit_entry_missing", entry=self.last.id + 1, before=self.last.id, found=number
            )
        if entry.get("previous") != self.last.hash:
            return Message.of("audit_entry_apart", entry=number)
        if entry.get("hash") != entry_hash(self.last.hash, entry):
            return Message.of("audit_entry_changed", entry=number)
        if number in self._anchors and entry["hash"] != self._anchors[number]:
            return not_anchored(number)
        return self._fault_of_seal(entry)

    def _fault_of_seal(self, entry: Mapping[str, Any]) -> Message | None:
        number, key, origin = entry["id"], entry.get("key") or "", self._ring.origin
        if number < origin.id:
            return None
        if number == origin.id:
            is_noted = entry["hash"] == origin.hash
            return None if is_noted else Message.of("audit_entry_not_original", entry=number)
        rank, before = self._ring.rank(key), self._ring.rank(self.last.key)
        if rank is None:
            return Message.of("audit_entry_without_key", entry=number)
        if before is not None and rank < before:
            return Message.of("audit_entry_older_key", entry=number)
        if not self._ring.confirms(entry.get("seal") or "", key, "entry", entry["hash"]):
            return Message.of("audit_entry_not_sealed", entry=number)
        if notes_altered_end(entry):
            return Message.of("audit_entry_notes_alteration", entry=number)
        return None

    def _check_end(self, head: Head) -> None:
        last, origin = self.last, self._ring.origin
        if last.id < head.id:
            self._break(last.id + 1, Message.of("audit_end_before_newest", entry=last.id, written=head.id))
        elif (last.id, last.hash) != (head.id, head.hash):
            self._break(last.id, Message.of("audit_entry_not_newest", entry=last.id))
        elif last.id < origin.id:
            self._break(last.id + 1, Message.of("audit_end_before_key", entry=last.id, written=origin.id))
        elif (cut := max(self._anchors, default=0)) > last.id:
            self._break(last.id + 1, Message.of("audit_end_before_anchor", entry=last.id, named=cut))
        elif last.id > origin.id and not confirms_head(head, self._ring):
            self._break(last.id, Message.of("audit_end_not_sealed", entry=last.id))
        elif last.id > origin.id and last.key != self._ring.newest:
            self._break(last.id + 1, Message("audit_newest_key_unused"))

    def _break(self, number: int, fault: Message) -> None:
        self.broken = AuditVerification(self.last.id, number, fault)


def cut_off(number: int, path: str) -> Message:
    """The fault of a log that has no entry of a number that the file ``path`` names."""
    return Message.of("audit_log_cut_off", entry=number, path=path)


def not_anchored(number: int) -> Message:
    """The fault of an entry that has another hash than the anchor names."""
    return Message.of("audit_entry_not_anchored", entry=number)
