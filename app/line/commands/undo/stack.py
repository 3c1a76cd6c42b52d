"""The commands of each sender that can be undone, the newest first. Pure: time is passed in.

A command can be undone for a minute, while every value that it set is still there and no newer command of
this sender has set one of them. A command that was undone makes room for the one before it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Set
from dataclasses import dataclass, field

from app.line.commands.review import REVIEW_LASTS_S
from app.line.commands.undo.changes import ValuePlace, Values
from bus.instants import Monotonic

LASTS_S = 60.0
MAX_OF_A_SENDER, MAX_SENDERS = 20, 200


@dataclass(frozen=True, slots=True)
class SentCommand:
    """``new``: what it set; ``before``: what was there. An empty ``before`` is not known: the command cannot
    be undone, and no earlier one of the same values."""

    id: str
    new: Values
    before: Values
    at: Monotonic
    scale: Values = field(default_factory=dict)
    """The parameters that the values before and after it were shown with: with others the same numbers are
    other values."""

    def ends_at(self) -> Monotonic:
        return self.at + LASTS_S


@dataclass(slots=True)
class UndoStack:
    """Of one bus. ``holds``: whether these values are all still there."""

    holds: Callable[[Values], bool]
    _sent: OrderedDict[str, list[SentCommand]] = field(default_factory=OrderedDict)

    def push(self, sender: str, command: SentCommand) -> None:
        """The newest command of this sender, which has changed its values."""
        mine = self._sent.setdefault(sender, [])
        mine.append(command)
        oldest = command.at - REVIEW_LASTS_S
        self._sent[sender] = [each for each in mine if each.ends_at() > oldest][-MAX_OF_A_SENDER:]
        self._sent.move_to_end(sender)
        while len(self._sent) > MAX_SENDERS:
            self._sent.popitem(last=False)

    def clear(self, sender: str) -> None:
        """Nothing that this sender has sent is undone any more."""
        self._sent.pop(sender, None)

    def undone(self, sender: str, id: str) -> None:
        """The values from before this command are back."""
        if sender in self._sent:
            self._sent[sender] = [each for each in self._sent[sender] if each.id != id]

    def find(self, sender: str, id: str, now: Monotonic) -> SentCommand | None:
        """The command with this id, if it can be undone now."""
        return next((each for each in self._undoable(sender, now) if each.id == id), None)

    def reviewed(self, sender: str, id: str, now: Monotonic) -> SentCommand | None:
        """The same for one whose undo is confirmed now, in a review that began in time."""
        return self.find(sender, id, now - REVIEW_LASTS_S)

    def newest(self, sender: str, now: Monotonic, units: Set[int]) -> SentCommand | None:
        """The newest command to any of these units that can be undone now."""
        return next(
            (each for each in self._undoable(sender, now) if any(place.unit in units for place in each.new)),
            None,
        )

    def _undoable(self, sender: str, now: Monotonic) -> Iterator[SentCommand]:
        newer: set[ValuePlace] = set()
        for each in reversed(self._sent.get(sender, ())):
            is_open = newer.isdisjoint(each.new) and each.ends_at() > now
            if is_open and each.before and self.holds({**each.new, **each.scale}):
                yield each
            newer |= each.new.keys()
