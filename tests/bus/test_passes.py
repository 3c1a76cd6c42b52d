"""Which address a scan asks next: nobody is absent after one question."""

from __future__ import annotations

from bus.line.scan.passes import Passes


def asked(addresses: range, answers: dict[int, int]) -> tuple[list[int], list[int]]:
    """Which are asked, and how much is settled after each; ``answers``: unit -> the question it answers."""
    passes, seen, settled = Passes(addresses), list[int](), list[int]()
    for unit in passes:
        seen.append(unit)
        if seen.count(unit) == answers.get(unit):
            passes.found()
        else:
            passes.no_response()
        settled.append(passes.settled)
    assert settled == sorted(settled)
    assert settled[-1] == passes.questions
    assert passes.done == len(addresses)
    return seen, settled


def test_the_silent_are_asked_twice() -> None:
    assert asked(range(1, 4), {2: 1}) == ([1, 2, 3, 1, 3], [1, 3, 4, 5, 6])


def test_and_again_as_long_as_that_finds_somebody() -> None:
    assert asked(range(1, 3), {1: 2})[0] == [1, 2, 1, 2, 2]
    assert asked(range(1, 4), {1: 2, 2: 3})[0] == [1, 2, 3, 1, 2, 3, 2, 3, 3]


def test_four_times_at_the_most() -> None:
    assert asked(range(1, 5), {1: 2, 2: 3, 3: 4})[0].count(4) == 4


def test_where_everybody_answers_nobody_is_asked_twice() -> None:
    assert asked(range(1, 4), {1: 1, 2: 1, 3: 1}) == ([1, 2, 3], [2, 4, 6])
