"""Fields in groups: what differs, and later ones in the place of earlier ones."""

from __future__ import annotations

from app.line.live.fields import Groups, merge_groups, put_fields


def test_only_fields_that_differ_go_on() -> None:
    shown: Groups = {}
    assert put_fields(shown, "a/1", {"speed": "1.0", "state": "run"}) == {
        "a/1": {"speed": "1.0", "state": "run"}
    }
    assert put_fields(shown, "a/1", {"speed": "1.1", "state": "run"}) == {"a/1": {"speed": "1.1"}}
    assert shown == {"a/1": {"speed": "1.1", "state": "run"}}


def test_a_group_without_a_difference_does_not_go_on() -> None:
    shown: Groups = {"a/1": {"speed": "1.0"}}
    assert put_fields(shown, "a/1", {"speed": "1.0"}) == {}


def test_later_fields_take_the_place_of_earlier_ones_and_leave_the_others() -> None:
    first: Groups = {"a/1": {"speed": "1.0", "state": "run"}}
    second: Groups = {"a/1": {"speed": "1.1"}, "a/2": {"speed": "2.0"}}
    assert merge_groups({}, first, second) == {
        "a/1": {"speed": "1.1", "state": "run"},
        "a/2": {"speed": "2.0"},
    }
    assert first == {"a/1": {"speed": "1.0", "state": "run"}}
    assert second["a/1"] == {"speed": "1.1"}
