"""Following a log from entry to entry, to verify it. Pure."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

from pydantic import ConfigDict, Field

from app.audit.proof.chain import SITE, Head, confirms_head, entry_hash, is_sound_alone, notes_altered_end
from app.audit.proof.keyring import KeyRing
from app.web.api.shape import MessageObject
from bus.messages import Message

MAX_CHAINS = 500
"""Chains that are stated: one who can write the store can make up any number of names."""


@dataclass(frozen=True)
class ChainVerification:
    """Whether one chain of the log is intact."""

    bus: Annotated[str | None, Field(description="Of which bus; null: of the site.")]
    entries: Annotated[int, Field(description="Its entries that are intact.")]
    broken: Annotated[int | None, Field(description="Number of its first broken entry; null: none.")] = None
    fault: Annotated[MessageObject | None, Field(description="Why it is not intact; null: it is.")] = None

    __pydantic_config__ = ConfigDict(json_schema_serialization_defaults_required=True)


@dataclass(frozen=True)
class AuditVerification:
    """Whether the log is intact; ``broken``: the first altered entry; ``fault``: the cause. Entries that are
    older than the key are verified to be as they were when it was made, and no further back."""

    entries: int
    broken: Annotated[int | None, Field(description="Number of the first broken entry; null: none.")] = None
    fault: Annotated[MessageObject | None, Field(description="Why it is not intact; null: it is.")] = None
    unsealed: Annotated[int, Field(description="Entries up to this one are older than the key; 0: none.")] = 0
    anchored: Annotated[int, Field(description="The newest entry that the anchor names; 0: none.")] = 0
    archived: Annotated[
        int, Field(description="Entries up to this one are in the archive, not verified here; 0: none.")
    ] = 0
    chains: Annotated[
        tuple[ChainVerification, ...], Field(description="Of the site, then of each bus that has events.")
    ] = ()

    __pydantic_config__ = ConfigDict(json_schema_serialization_defaults_required=True)


class _Fault(NamedTuple):
    number: int
    reason: Message


class _Gap(NamedTuple):
    """Numbers without an entry: those between two entries that are there."""

    before: int
    found: int

    @property
    def fault(self) -> _Fault:
        number = self.before + 1
        missing = Message.of("audit_entry_missing", entry=number, before=self.before, found=self.found)
        return _Fault(number, missing)


def _before(gap: _Gap) -> int:
    return gap.before


class Walk:
    """Follows a log entry by entry, from its beginning or from the ends of its chains that are known to be
    good, and each chain up to the first entry that is broken. ``anchors``: heads, by the number of the entry,
    that were noted elsewhere; ``archived``: up to this number the entries are in the archive, and of those
    that are left each is verified alone."""

    def __init__(
        self,
        ring: KeyRing,
        anchors: Mapping[int, Head] | None = None,
        start: Mapping[str, Head] | None = None,
        archived: int | None = None,
    ):
        self._ring = ring
        self._archived = archived
        self._origins = ring.origin.hashes
        self._anchors = {number: head for number, head in (anchors or {}).items() if number > (archived or 0)}
        self._unmet = set(self._anchors)
        self._ends = dict(start or {})
        self._number = max((head.id for head in self._ends.values()), default=0)
        ranks = (ring.rank(head.key) for head in self._ends.values())
        self._rank = max((rank for rank in ranks if rank is not None), default=0)
        self._counted: Counter[str] = Counter()
        self._gaps: list[_Gap] = []
        self._stated: set[_Gap] = set()
        self._faults: dict[str, _Fault] = {}

    def follow(self, entries: Iterable[Mapping[str, Any]]) -> None:
        """The next entries, in order. Of a chain nothing more is looked at after its first broken entry."""
        for entry in entries:
            number, chain = entry["id"], entry.get("chain") or SITE
            if self._archived is not None and number <= self._archived:
                if not is_sound_alone(entry, self._ring):
                    self._faults.setdefault(chain, _Fault(number, _changed(number)))
                continue
            if number != self._number + 1:
                self._gaps.append(_Gap(self._number, number))
            self._number = max(self._number, number)
            self._unmet.discard(number)
            if chain not in self._faults:
                self._follow(chain, entry)

    @property
    def fault(self) -> Message | None:
        """Why what was followed so far is not intact; None: it is."""
        faults = [*self._faults.values(), *(gap.fault for gap in self._gaps)]
        return min(faults, key=lambda fault: fault.number).reason if faults else None

    @property
    def ends(self) -> Mapping[str, Head]:
        """The ends of the chains so far."""
        return self._ends

    def end(self, heads: Mapping[str, Head]) -> AuditVerification:
        """The verdict once every entry was followed; ``heads``: what was noted apart as the newest of each
        chain."""
        for chain in sorted(self._ends.keys() | heads.keys()):
            if chain not in self._faults:
                self._check_end(chain, heads.get(chain, Head()))
        self._check_missing()
        if self._number < (origin := self._ring.origin.id):
            before_key = Message.of("audit_end_before_key", entry=self._number, written=origin)
            self._faults.setdefault(SITE, _Fault(self._number + 1, before_key))
        chains = self._stated_chains({SITE} | self._ends.keys() | heads.keys() | self._faults.keys())
        if self._faults:
            first = min(self._faults.values(), key=lambda fault: fault.number)
            intact = min(self._number, first.number - 1)
            return AuditVerification(
                intact, first.number, first.reason, chains=chains, archived=self._archived or 0
            )
        unsealed, anchored = min(self._number, origin), max(self._anchors, default=0)
        return AuditVerification(
            self._number, unsealed=unsealed, anchored=anchored, archived=self._archived or 0, chains=chains
        )

    def _stated_chains(self, names: Iterable[str]) -> tuple[ChainVerification, ...]:
        broken_first = sorted(names, key=lambda name: (name not in self._faults, name))
        return tuple(
            ChainVerification(name or None, self._counted[name], *self._faults.get(name, (None, None)))
            for name in sorted(broken_first[:MAX_CHAINS])
        )

    def _follow(self, chain: str, entry: Mapping[str, Any]) -> None:
        end = self._ends.get(chain)
        before = end or self._ends.get(SITE, Head())
        # A chain that begins where that of the site is broken already can be followed from there alone.
        is_continued = end is not None or SITE not in self._faults
        fault = self._fault(entry, before.hash if is_continued else entry.get("previous"))
        if fault is not None:
            gap = self._gap_between(before.id, entry["id"])
            self._faults[chain] = gap.fault if gap else _Fault(entry["id"], fault)
            return
        self._counted[chain] += 1
        self._ends[chain] = head = Head(entry["id"], entry["hash"], entry.get("key") or "")
        if end is None:
            self._ends[SITE] = head

    def _fault(self, entry: Mapping[str, Any], previous: str | None) -> Message | None:
        number = entry["id"]
        if previous is None or entry.get("previous") != previous:
            return Message.of("audit_entry_apart", entry=number)
        if entry.get("hash") != entry_hash(previous, entry):
            return _changed(number)
        if number in self._anchors and entry["hash"] != self._anchors[number].hash:
            return not_anchored(number)
        return self._fault_of_seal(entry)

    def _fault_of_seal(self, entry: Mapping[str, Any]) -> Message | None:
        number, key = entry["id"], entry.get("key") or ""
        if number <= self._ring.origin.id:
            is_noted = entry["hash"] == self._origins.get(number, entry["hash"])
            return None if is_noted else Message.of("audit_entry_not_original", entry=number)
        rank = self._ring.rank(key)
        if rank is None:
            return Message.of("audit_entry_without_key", entry=number)
        if rank < self._rank:
            return Message.of("audit_entry_older_key", entry=number)
        if not self._ring.confirms(entry.get("seal") or "", key, "entry", entry["hash"]):
            return Message.of("audit_entry_not_sealed", entry=number)
        if notes_altered_end(entry):
            return Message.of("audit_entry_notes_alteration", entry=number)
        self._rank = rank
        return None

    def _gap_between(self, last: int, number: int) -> _Gap | None:
        """The first gap behind the last good entry of a chain and before another number of it; all in between
        count as stated."""
        place = bisect_left(self._gaps, last, key=_before)
        gaps = self._gaps[place : bisect_left(self._gaps, max(number, last + 1), key=_before)]
        self._stated.update(gaps)
        return gaps[0] if gaps else None

    def _check_end(self, chain: str, head: Head) -> None:
        last, origin = self._ends.get(chain, Head()), self._ring.origin
        if last.id < head.id:
            gap = self._gap_between(last.id, head.id)
            number = min(head.id, gap.before + 1 if gap else self._number + 1)
            self._break(chain, number, "audit_end_before_newest", entry=last.id, written=head.id)
        elif (last.id, last.hash) != (head.id, head.hash):
            self._break(chain, last.id, "audit_entry_not_newest", entry=last.id)
        elif last.id > origin.id and not confirms_head(head, self._ring):
            self._break(chain, last.id, "audit_end_not_sealed", entry=last.id)
        elif last.id > origin.id and last.key != self._ring.newest:
            self._break(chain, last.id + 1, "audit_newest_key_unused")

    def _check_missing(self) -> None:
        """Break the chain of which an anchor names an entry that is not there, and that of the site for an
        entry that nothing else names."""
        for number in sorted(self._unmet, reverse=True):
            chain = self._anchors[number].chain
            if chain in self._faults:
                continue
            gap = self._gap_between(self._ends.get(chain, Head()).id, number)
            if gap is not None:
                self._faults[chain] = gap.fault
            else:
                ends = {"entry": self._number, "named": number}
                self._break(chain, self._number + 1, "audit_end_before_anchor", **ends)
        for gap in self._gaps:
            if gap not in self._stated:
                self._faults.setdefault(SITE, gap.fault)

    def _break(self, chain: str, number: int, code: str, **params: int) -> None:
        self._faults[chain] = _Fault(number, Message.of(code, **params))


def _changed(number: int) -> Message:
    return Message.of("audit_entry_changed", entry=number)


def cut_off(number: int, path: str) -> Message:
    """The fault of a log that has no entry of a number that the file ``path`` names."""
    return Message.of("audit_log_cut_off", entry=number, path=path)


def not_anchored(number: int) -> Message:
    """The fault of an entry that has another hash than the anchor names."""
    return Message.of("audit_entry_not_anchored", entry=number)
