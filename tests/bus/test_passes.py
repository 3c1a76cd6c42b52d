"""Which address a scan requests next: no unit is absent after one request."""

from __future__ import annotations

from bus.line.examination import PASSES, Passes


def requested(addresses: range, responses: dict[int, int]) -> tuple[list[int], list[int]]:
    """Return the requested addresses, and the progress after each; ``responses``: unit -> the try that it
    responds to.
    """
    passes, seen, settled = Passes(addresses), list[int](), list[int]()
    for unit in passes:
        seen.append(unit)
        passes.note(found=seen.count(unit) == responses.get(unit))
        settled.append(passes.settled)
    assert settled == sorted(settled)
    assert settled[-1] == PASSES * len(addresses)
    assert passes.done == len(addresses)
    return seen, settled


def test_addresses_without_a_response_are_probed_twice() -> None:
    assert requested(range(1, 4), {2: 1}) == ([1, 2, 3, 1, 3], [1, 3, 4, 5, 6])


def test_passes_repeat_while_they_find_a_unit() -> None:
    assert requested(range(1, 3), {1: 2})[0] == [1, 2, 1, 2, 2]
    assert requested(range(1, 4), {1: 2, 2: 3})[0] == [1, 2, 3, 1, 2, 3, 2, 3, 3]


def test_four_times_at_the_most() -> None:
    assert requested(range(1, 5), {1: 2, 2: 3, 3: 4})[0].count(4) == 4


def test_where_all_units_respond_none_is_probed_twice() -> None:
    assert requested(range(1, 4), {1: 1, 2: 1, 3: 1}) == ([1, 2, 3], [2, 4, 6])
