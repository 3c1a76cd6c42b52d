"""Which app a worker goes to: only to addresses that it was started with."""

from __future__ import annotations

import pytest

from bus.worker.addresses import AppAddresses

A, B, C = "http://a:8000", "https://b:8000", "http://c:8000"


def test_it_goes_to_the_home_that_is_named_where_that_is_known() -> None:
    addresses = AppAddresses([A, B, C])
    assert addresses.feed == "ws://a:8000/feed"
    assert addresses.leave("http://c:8000/")
    assert addresses.feed == "ws://c:8000/feed"


@pytest.mark.parametrize("home", ["http://evil:8000", "http://b:8000", "", "no address", "http://a:8000"])
def test_any_other_address_is_not_followed(home: str) -> None:
    """Neither one that is not in the list, nor one of the list without its TLS."""
    addresses = AppAddresses([A, B])
    assert not addresses.leave(home)
    assert addresses.feed == "wss://b:8000/feed", "the next of the list"


def test_two_that_name_each_other_are_believed_once() -> None:
    addresses = AppAddresses([A, B, C])
    assert addresses.leave(B)
    assert not addresses.leave(A)
    assert addresses.feed == "ws://c:8000/feed"
    addresses.linked()
    assert addresses.leave(A), "after a link it is believed again"


def test_one_address_stays() -> None:
    addresses = AppAddresses([A, A])
    assert not addresses.are_several
    assert not addresses.leave(B)
    assert addresses.feed == "ws://a:8000/feed"
