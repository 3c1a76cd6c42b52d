"""What a change tray holds: also judged by an independent model, a log of what was added and removed."""

from __future__ import annotations

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from app.engineering.tray.contents import LASTS_S, MAX_CHANGES, MAX_TRAYS, Trays, key_of, place_of, steps_of
from app.errors import Problem
from app.line.commands.undo.changes import ValuePlace
from bus.instants import Monotonic

SPEED_1, SPEED_2 = ValuePlace("setpoint", 1), ValuePlace("setpoint", 2)
OUTPUT, ANALOG = ValuePlace("output", 1, 3), ValuePlace("analog", 2)
RAMP_UP, RAMP_DOWN = ValuePlace("parameter", 2, 6), ValuePlace("parameter", 2, 7)
ALL = (SPEED_1, SPEED_2, OUTPUT, ANALOG, RAMP_UP, RAMP_DOWN)
START = Monotonic(100.0)


@pytest.mark.parametrize("place", ALL)
def test_a_place_has_a_key(place: ValuePlace) -> None:
    assert place_of(key_of(place)) == place


@pytest.mark.parametrize(
    "key", ["", "setpoint", "setpoint-1", "valve-1-0", "setpoint-1-0-0", "output-\u0661-3", "output-1-333"]
)
def test_another_text_is_no_key(key: str) -> None:
    assert place_of(key) is None


def test_setpoints_are_sent_together_and_the_rest_one_by_one_as_it_was_added() -> None:
    changes = {RAMP_DOWN: 5, SPEED_2: 20, ANALOG: 7, RAMP_UP: 6, OUTPUT: 1, SPEED_1: 10}
    assert steps_of(changes) == [
        {SPEED_2: 20, SPEED_1: 10},
        {OUTPUT: 1},
        {ANALOG: 7},
        {RAMP_DOWN: 5},
        {RAMP_UP: 6},
    ]
    assert steps_of({OUTPUT: 0}) == [{OUTPUT: 0}]
    assert steps_of({}) == []


def test_a_tray_is_bounded_and_too_much_adds_nothing() -> None:
    trays = Trays()
    full = {ValuePlace("parameter", unit, number): 0 for unit in range(1, 33) for number in range(1, 17)}
    assert len(full) == MAX_CHANGES
    trays.add("anna", full, START, {})
    trays.add("anna", dict.fromkeys(full, 1), START, {})
    with pytest.raises(Problem, match="at most 512 changes"):
        trays.add("anna", {SPEED_1: 10}, START, {})
    assert trays.changes("anna", START) == dict.fromkeys(full, 1)


def test_of_too_many_trays_the_oldest_is_emptied() -> None:
    trays = Trays()
    for number in range(MAX_TRAYS):
        trays.add(f"person {number}", {SPEED_1: number}, START, {})
    trays.add("person 0", {SPEED_2: 0}, START, {})
    trays.add("anna", {SPEED_1: 10}, START, {})
    assert trays.changes("person 1", START) == {}
    assert trays.changes("person 0", START) == {SPEED_1: 0, SPEED_2: 0}
    assert trays.changes("anna", START) == {SPEED_1: 10}


class TrayModel(RuleBasedStateMachine):
    """``self.log``: when, who, and each place with its new value, or None where it was removed."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.log: list[tuple[float, str, ValuePlace, int | None]] = []
        self.trays = Trays()

    def expected(self, who: str) -> dict[ValuePlace, int]:
        """What this person's entries of the log come down to."""
        found: dict[ValuePlace, int] = {}
        added = 0.0
        for at, _, place, raw in [entry for entry in self.log if entry[1] == who]:
            if raw is None:
                found.pop(place, None)
                continue
            if at - added >= LASTS_S:
                found = {}
            found[place], added = raw, at
        return found if self.now - added < LASTS_S else {}

    @rule(seconds=st.sampled_from([1.0, LASTS_S / 2, LASTS_S - 1]))
    def time_passes(self, seconds: float) -> None:
        self.now += seconds

    @rule(
        who=st.sampled_from(["anna", "ben"]),
        places=st.lists(st.sampled_from(ALL), min_size=1, max_size=3),
        raw=st.integers(0, 2),
    )
    def add(self, who: str, places: list[ValuePlace], raw: int) -> None:
        self.trays.add(who, dict.fromkeys(places, raw), Monotonic(self.now), {})
        self.log += [(self.now, who, place, raw) for place in places]

    @rule(who=st.sampled_from(["anna", "ben"]), place=st.sampled_from(ALL), raw=st.integers(0, 2))
    def remove(self, who: str, place: ValuePlace, raw: int) -> None:
        if self.expected(who).get(place) == raw:
            self.log.append((self.now, who, place, None))
        self.trays.remove(who, {place: raw})

    @invariant()
    def holds_the_newest_value_of_each_place(self) -> None:
        for who in ("anna", "ben"):
            held = self.trays.changes(who, Monotonic(self.now))
            assert list(held.items()) == list(self.expected(who).items())


TestTray = TrayModel.TestCase
