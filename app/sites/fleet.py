"""The lines as pages show them, and their changes for the pages that follow them."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from app.live.screen.diff import Groups, put_fields
from app.live.screen.fields import Fields, Translator
from app.sites.board import LineBoard, LineOnBoard
from app.sites.summary import LineSummary
from app.sites.tile import line_key, tile_fields
from app.web.services import service
from bus.instants import Clock, UnixTime

MINUTE_S = 60.0


class _Worded(NamedTuple):
    """A summary, the minute in which it was put into words, and those."""

    summary: LineSummary | None
    minute: int
    fields: Fields


class Fleet:
    """Most lines are from one second to the next as they were: only the others are put into words again.
    ``clock``: Unix time in seconds."""

    def __init__(self, board: LineBoard, clock: Clock) -> None:
        self.board = board
        self._clock = clock
        self._worded: dict[tuple[str, str], _Worded] = {}
        self._shown: dict[str, Groups] = {}
        self._sent: dict[str, dict[str, tuple[int, Fields]]] = {}

    def shown(self, translator: Translator) -> Groups:
        """The fields of all lines now, the worst first."""
        return self.fields_of(self.board.lines(), translator)

    def fields_of(self, lines: list[LineOnBoard], translator: Translator) -> Groups:
        """The fields of these lines, in their order."""
        now = self._clock()
        return {
            line_key(line.bus): self._fields(line, translator, now) | {"rank": str(rank)}
            for rank, line in enumerate(lines)
        }

    def changes(self, translator: Translator) -> Groups:
        """The fields that are different from those of the last call for this language."""
        shown = self._shown.setdefault(translator.language.tag, {})
        sent = self._sent.setdefault(translator.language.tag, {})
        changed: Groups = {}
        now = self._clock()
        for rank, line in enumerate(self.board.lines()):
            fields = self._fields(line, translator, now)
            before = sent.get(line.bus)
            if before is None or before[0] != rank or before[1] is not fields:
                sent[line.bus] = rank, fields
                changed |= put_fields(shown, line_key(line.bus), fields | {"rank": str(rank)})
        return changed

    def forget(self, tag: str) -> None:
        """No page in this language follows them."""
        self._shown.pop(tag, None)
        self._sent.pop(tag, None)

    def _fields(self, line: LineOnBoard, translator: Translator, now: UnixTime) -> Fields:
        """A time in the words gets its date as the day ends, and the age of a stale one grows."""
        key, minute = (translator.language.tag, line.bus), int(float(now) // MINUTE_S)
        known = self._worded.get(key)
        if known and not line.is_stale and known.minute == minute and known.summary is line.summary:
            return known.fields
        fields = tile_fields(line, translator, now)
        if line.is_stale:
            self._worded.pop(key, None)
        else:
            self._worded[key] = _Worded(line.summary, minute, fields)
        return fields


FleetLookup = Annotated[Fleet, service(Fleet)]
