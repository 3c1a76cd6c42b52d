"""A batch edit: what its review warns of, and what ends the writing."""

from __future__ import annotations

import pytest

from app.engineering.sets.batch import BatchRow, refuse_moved, rows_of_batch, write_batch
from app.engineering.sets.restore_plan import NO_RAMP
from app.errors import Problem
from app.line.live.bus_live import LiveState
from bus.contract import ParameterValue
from bus.messages import Message
from tests.app.played_commands import ANNA, PlayedCommands, a_bus, factory, responding


def line(*, run: bool) -> LiveState:
    live = a_bus()
    responding(live, run=run)
    return live


def typed(live: LiveState, number: int, *values: str) -> list[BatchRow]:
    return rows_of_batch(live.buses["dry-end"], number, dict(zip((1, 2), values, strict=True)))


@pytest.mark.parametrize(
    ("number", "run", "warned"),
    [(20, False, True), (20, True, True), (6, True, True), (6, False, False), (12, True, False)],
)
def test_the_review_warns_where_the_machine_changes(number: int, run: bool, warned: bool) -> None:
    assert [bool(row.warning) for row in typed(line(run=run), number, "3", "4")] == [warned, warned]


def test_the_review_warns_of_a_ramp_of_nothing() -> None:
    rows = typed(line(run=False), 7, "0.0", "0.1")
    assert [row.warning for row in rows] == [NO_RAMP, None]


def test_a_speed_or_ratio_is_not_converted_while_it_is_not_known_which_it_is() -> None:
    """A follower's ratio of 1.5, taken for a speed, would be a ratio of 0.0015."""
    live = line(run=False)
    unit = live.buses["dry-end"].units[1]
    assert [row.wanted for row in typed(live, 9, "1.5", "")] == [15, None]
    del unit.parameters[8]
    [row, _] = typed(live, 9, "1.5", "")
    assert (row.wanted, row.fault) == (None, Message.of("unit_mode_unknown", unit=1))


def test_a_value_that_moved_since_the_review_is_not_written() -> None:
    live = line(run=False)
    reviewed = {row.unit: row.reviewed for row in typed(live, 6, "20", "")}
    refuse_moved(typed(live, 6, "20", ""), reviewed)
    live.buses["dry-end"].apply([ParameterValue(unit=2, number=6, at=2.0, raw=101)])
    refuse_moved(typed(live, 6, "20", ""), reviewed)
    live.buses["dry-end"].apply([ParameterValue(unit=1, number=6, at=2.0, raw=101)])
    refuse_moved(typed(live, 6, "20", ""), {})
    with pytest.raises(Problem, match="Unwind: the value has changed") as refused:
        refuse_moved(typed(live, 6, "20", ""), reviewed)
    assert (refused.value.status, refused.value.code) == (409, "moved")


def test_the_review_of_a_secret_holds_nothing_of_it() -> None:
    live = line(run=False)
    live.buses["dry-end"].apply([ParameterValue(unit=1, number=21, at=2.0, raw=4711)])
    [row, _] = typed(live, 21, "12", "")
    assert (row.reviewed, row.changes) == ("", True)
    refuse_moved([row], {1: row.reviewed})


@pytest.mark.parametrize(
    ("code", "outcomes"),
    [
        ("rights_withdrawn", ["rights_withdrawn", "not_sent"]),
        ("controlled", ["controlled", "not_sent"]),
        ("blocked", ["blocked", "blocked"]),
    ],
)
async def test_a_refusal_of_the_person_ends_it_and_one_of_a_unit_does_not(
    code: str, outcomes: list[str]
) -> None:
    live = line(run=False)
    commands = PlayedCommands(
        live,
        {1: factory(), 2: factory()},
        objects={6: Problem(403, code, Message.of("system_error", error="no longer"))},
    )
    rows = typed(live, 6, "20", "30")
    results = await write_batch(commands, ANNA, 6, rows, confirm=False)  # type: ignore[arg-type]
    assert [result.outcome for result in results] == outcomes
    assert {str(result.message) for result in results} == {"no longer"}
    assert len(commands.sent) == outcomes.count(code)
