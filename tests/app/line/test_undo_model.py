"""Undo, judged by an independent model: the history of the values of two units, and nothing beside it."""

from __future__ import annotations

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from app.line.commands.undo import SentCommand, UndoStack, ValuePlace

SPEED_1, SPEED_2, OUTPUT = ValuePlace("setpoint", 1), ValuePlace("setpoint", 2), ValuePlace("output", 1, 3)
PLACES = st.sampled_from([SPEED_1, SPEED_2, OUTPUT])
GROUPS = st.lists(PLACES, min_size=1, max_size=3, unique=True)
LASTS_S = 60.0
Entry = tuple[float, str, str, dict[ValuePlace, int], dict[ValuePlace, int], bool]


class UndoModel(RuleBasedStateMachine):
    """``self.log``: time, id, who, the value of each place before and after, whether the former is known."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.values: dict[ValuePlace, int] = dict.fromkeys(
            (ValuePlace("setpoint", 1), ValuePlace("setpoint", 2), ValuePlace("output", 1, 3)), 0
        )
        self.log: list[Entry] = []
        self.stack = UndoStack(lambda values: all(self.values[place] == raw for place, raw in values.items()))

    def expected(self, who: str) -> dict[str, dict[ValuePlace, int]]:
        """By the id of each command that this person can undo now: what was there before it."""
        found = {}
        mine = [entry for entry in self.log if entry[2] == who]
        for position, (at, id, _, before, new, known) in enumerate(mine):
            superseded = any(new.keys() & later[4].keys() for later in mine[position + 1 :])
            present = {place: self.values[place] for place in new}
            if known and present == new and not superseded and self.now < at + LASTS_S:
                found[id] = before
        return found

    @rule(seconds=st.sampled_from([1.0, 29.0, 30.0, 59.0, 60.0]))
    def time_passes(self, seconds: float) -> None:
        self.now += seconds

    @rule(who=st.sampled_from(["anna", "ben"]), places=GROUPS, raw=st.integers(0, 2), known=st.booleans())
    def command(self, who: str, places: list[ValuePlace], raw: int, known: bool) -> None:
        before, new = {place: self.values[place] for place in places}, dict.fromkeys(places, raw)
        self.values |= new
        id = f"{len(self.log)}"
        self.log.append((self.now, id, who, before, new, known))
        self.stack.push(who, SentCommand(id, new, before if known else {}, self.now))

    @rule(place=PLACES, raw=st.integers(0, 2))
    def keypad(self, place: ValuePlace, raw: int) -> None:
        self.values[place] = raw

    @precondition(lambda self: self.expected("anna"))
    @rule(data=st.data())
    def undo(self, data: st.DataObject) -> None:
        can = self.expected("anna")
        id = data.draw(st.sampled_from(sorted(can)))
        found = self.stack.find("anna", id, self.now)
        assert found is not None
        self.values |= found.before
        self.stack.undone("anna", id)
        self.log = [entry for entry in self.log if entry[1] != id]

    @rule(who=st.sampled_from(["anna", "ben"]))
    def line_is_set_to_zero(self, who: str) -> None:
        self.stack.clear(who)
        self.log = [entry for entry in self.log if entry[2] != who]

    @invariant()
    def offers_go_back_to_the_former_values(self) -> None:
        for who in ("anna", "ben"):
            can = self.expected(who)
            for _, id, *_ in self.log:
                found = self.stack.find(who, id, self.now)
                assert (None if found is None else dict(found.before)) == can.get(id)
            newest = self.stack.newest(who, self.now, {1, 2})
            assert (newest.id if newest else None) == (max(can, key=int) if can else None)


TestUndo = UndoModel.TestCase
