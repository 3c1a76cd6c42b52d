"""Which worker has a bus, and when another may take it; the time is passed in."""

from __future__ import annotations

import pytest

from app.line.feed.bus_feed import Credential, Ending, Holder

A = Credential("a", "dry-end", "192.0.2.1")
B = Credential("b", "dry-end", "192.0.2.2")
OWN = Credential("worker", "dry-end", "127.0.0.1", own=True)


@pytest.mark.parametrize("ending", Ending)
def test_a_bus_is_reserved_for_as_long_as_its_ending_allows(ending: Ending) -> None:
    holder = Holder("w1", A)
    assert not holder.yields_to("w2", A, 1e9), "while it is connected, another is always refused"
    holder.connection_ended(ending, 100.0)
    for credential in (A, B):
        assert not holder.yields_to("w2", credential, 99.9 + ending.value)
        assert holder.yields_to("w2", credential, 100.0 + ending.value)


def test_the_same_process_may_return_at_any_time_and_only_by_its_own_token() -> None:
    holder = Holder("w1", A)
    assert holder.yields_to("w1", A, 0.0)
    assert not holder.yields_to("w1", B, 0.0), "a worker's id is no secret"


@pytest.mark.parametrize(("port_seen", "yields"), [(False, True), (True, False)])
def test_a_child_yields_to_a_worker_elsewhere_until_its_port_was_open(port_seen: bool, yields: bool) -> None:
    holder = Holder("w1", OWN, port_seen)
    assert holder.yields_to("w2", A, 0.0) is yields
    assert not holder.yields_to("w2", OWN, 0.0)


@pytest.mark.parametrize("port_seen", [False, True])
def test_a_childs_successor_need_not_wait(port_seen: bool) -> None:
    holder = Holder("w1", OWN, port_seen)
    holder.connection_ended(Ending.CUT, 100.0)
    assert holder.yields_to("w2", OWN, 100.0)
    assert holder.yields_to("w2", A, 100.0) is not port_seen


def test_a_worker_elsewhere_never_yields_to_a_child() -> None:
    holder = Holder("w1", A)
    assert not holder.yields_to("w2", OWN, 0.0)
