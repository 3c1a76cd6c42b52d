"""Display units, with the parameters as they were at that time."""

from __future__ import annotations

from app.line.history.series.values import VALUES, ParameterStep, scaling


def shown(name: str, raw: int, steps: list[tuple[int, int, int]], at: int = 100, **how: object) -> float:
    found = scaling(
        VALUES[name],
        [ParameterStep(*step) for step in steps],
        ratio=bool(how.get("ratio")),
        estop_healthy=1 if how.get("healthy", 1) else 0,
    )
    return found.at(at).apply(raw)


def test_decimals_divide() -> None:
    assert shown("actual", 12345, [(0, 3, 1)]) == 1234.5


def test_unknown_decimals_leave_the_integer() -> None:
    assert shown("commanded", 12345, []) == 12345
    assert shown("commanded", 12345, [(0, 3, 9)]) == 12345


def test_a_change_counts_from_when_it_was_read() -> None:
    steps = [(50, 3, 1), (80, 3, 2)]
    assert [shown("actual", 1000, steps, at) for at in (10, 50, 79, 80)] == [100.0, 100.0, 100.0, 10.0]


def test_the_analog_input_spans_low_to_high() -> None:
    steps = [(0, 22, 0), (0, 23, 100)]
    assert [shown("analog", raw, steps) for raw in (0, 51, 255)] == [0.0, 20.0, 100.0]


def test_a_falling_analog_input_is_known_as_such() -> None:
    steps = [ParameterStep(0, 22, 100), ParameterStep(0, 23, 0)]
    assert scaling(VALUES["analog"], steps, ratio=False, estop_healthy=1).at(0).falling


def test_a_follower_may_speak_in_ratios() -> None:
    steps = [(0, 3, 1), (0, 8, 1)]
    assert shown("commanded", 10_000, steps, ratio=True) == 1.0
    assert shown("commanded", 10_000, steps, ratio=False) == 1000.0
    assert shown("commanded", 10_000, [(0, 3, 1), (0, 8, 0)], ratio=True) == 1000.0


def test_an_emergency_stop_is_one_when_it_is_active() -> None:
    assert [shown("estop", raw, []) for raw in (0, 1)] == [1.0, 0.0]
    assert [shown("estop", raw, [], healthy=0) for raw in (0, 1)] == [0.0, 1.0]
    assert [shown("run", raw, []) for raw in (0, 1)] == [0.0, 1.0]
