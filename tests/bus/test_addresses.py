"""Which app a worker goes to: only to addresses that it was started with."""

from __future__ import annotations

from bus.worker.uplink import AppAddresses

A, B = "http://a:8000", "https://b:8000/"


def test_it_goes_to_each_address_in_turn() -> None:
    addresses = AppAddresses([A, B])
    seen = []
    for _ in range(3):
        seen.append(addresses.feed)
        addresses.leave()
    assert seen == ["ws://a:8000/feed", "wss://b:8000/feed", "ws://a:8000/feed"]


def test_one_address_stays() -> None:
    addresses = AppAddresses([A, A])
    assert not addresses.are_several
    addresses.leave()
    assert addresses.feed == "ws://a:8000/feed"
