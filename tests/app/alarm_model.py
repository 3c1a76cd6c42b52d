"""A second model of one alarm, written from ISA-18.2-2016, clause 5.6, in another style than the app's.

It keeps nothing. Each look-up goes over the complete history: when was it detected, what hid it then, which
was the last reason to annunciate it and which the last to see it as settled.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import groupby

FOREVER = float("inf")


@dataclass
class ModelAlarm:
    """``observed``: (time, True, False or None). ``acts``: (time, word, end of a shelving, one-shot)."""

    on_delay: float
    off_delay: float
    realarm: float
    latching: bool
    observed: list[tuple[float, bool | None]] = field(default_factory=list)
    acts: list[tuple[float, str, float, bool]] = field(default_factory=list)

    def detections(self, until: float) -> list[tuple[float, bool]]:
        """Each rise (True) and clear (False): a run of equal observations that outlasts its delay."""
        runs = [
            (next(members)[0], holds)
            for holds, members in groupby([o for o in self.observed if o[0] <= until], lambda each: each[1])
        ]
        ends = [*(start for start, _ in runs[1:]), until]
        found: list[tuple[float, bool]] = []
        for (start, holds), end in zip(runs, ends, strict=False):
            is_active = bool(found) and found[-1][1]
            due = start + (self.on_delay if holds else self.off_delay)
            if holds is not None and holds != is_active and due <= end:
                found.append((due, holds))
        return found

    def hidden(self, until: float) -> list[tuple[float, float, str]]:
        """The spans in which something hid it."""
        words = {"shelve": "unshelve", "suppress": "unsuppress", "remove": "return"}
        spans = []
        for number, (at, word, end, once) in enumerate(self.acts):
            if word not in words or at > until:
                continue
            ends = [end] + [a for a, other, *_ in self.acts[number:] if other == words[word]]
            if once:
                ends += [time for time, rises in self.detections(until) if not rises and time > at]
            spans.append((at, min(ends), word))
        return spans

    def returns(self, until: float) -> list[float]:
        """When it came out of all that hid it."""
        spans = self.hidden(until)
        return [
            end
            for _, end, _ in spans
            if end <= until and not any(start <= end < other for start, other, _ in spans)
        ]

    def is_active(self, at: float) -> bool:
        found = self.detections(at)
        return bool(found) and found[-1][1]

    def is_latched(self, at: float) -> bool:
        marks = [(t, "rise" if rises else "clear") for t, rises in self.detections(at)]
        marks += [(t, "reset") for t, word, *_ in self.acts if word == "reset" and t <= at]
        return self.latching and bool(marks) and max(marks)[1] == "clear"

    def is_acknowledged(self, at: float) -> bool:
        """By the newest of all reasons for and against."""
        reasons = [(t, False) for t, rises in self.detections(at) if rises]
        reasons += [(t, True) for t, word, *_ in self.acts if word == "acknowledge" and t <= at]
        for t in self.returns(at):
            reasons.append((t, not (self.is_active(t) or self.is_latched(t))))
        reasons.sort()
        if not reasons:
            return True
        since, settled = reasons[-1]
        if not (settled and self.is_active(since) and not any(s <= at < e for s, e, _ in self.hidden(at))):
            return settled
        cleared = any(since < t <= since + self.realarm and not r for t, r in self.detections(at))
        was_hidden = any(since < s <= since + self.realarm for s, _, _ in self.hidden(at))
        return cleared or was_hidden or at < since + self.realarm

    def state(self, at: float) -> str:
        hiding = {word for start, end, word in self.hidden(at) if start <= at < end}
        for word, state in (("remove", "out_of_service"), ("shelve", "shelved"), ("suppress", "suppressed")):
            if word in hiding:
                return state
        match self.is_active(at), self.is_latched(at), self.is_acknowledged(at):
            case True, _, acknowledged:
                return "ack_active" if acknowledged else "unack_active"
            case False, True, acknowledged:
                return "latched_ack" if acknowledged else "latched_unack"
            case _, _, acknowledged:
                return "normal" if acknowledged else "rtn_unack"

    def allows(self, word: str, at: float) -> bool:
        """Whether the standard has this transition from the state at ``at``."""
        state = self.state(at)
        hiding = {hidden for start, end, hidden in self.hidden(at) if start <= at < end}
        match word:
            case "acknowledge":
                return state in ("unack_active", "rtn_unack", "latched_unack")
            case "silence":
                return state in ("unack_active", "latched_unack") and not self.is_silenced(at)
            case "reset":
                return state == "latched_ack"
            case "shelve":
                return not hiding & {"shelve", "remove"}
            case "remove" | "suppress":
                return word not in hiding
            case _:
                return {"unshelve": "shelve", "return": "remove", "unsuppress": "suppress"}[word] in hiding

    def is_silenced(self, at: float) -> bool:
        """Nothing has happened since that makes it sound again, or settles it."""
        silenced = max((t for t, word, *_ in self.acts if word == "silence" and t <= at), default=FOREVER)
        later = [t for t, rises in self.detections(at) if rises]
        later += [start for start, _, _ in self.hidden(at)]
        later += [t for t, word, *_ in self.acts if word == "acknowledge" and t <= at]
        return silenced <= at and not any(t > silenced for t in later)

    def occurrences(self, at: float) -> int:
        return sum(rises for _, rises in self.detections(at))
