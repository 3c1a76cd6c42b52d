"""Attacks on the home of a bus: a server that names itself, a worker that makes up epochs."""

from __future__ import annotations

import pytest
from structlog.testing import capture_logs

from app.home.homes import MAX_EPOCHS_MISSED, Homes
from app.home.lease import Lease
from bus.contract import MAX_EPOCH, Hello, MalformedMessageError, decode_from_worker, encode
from bus.contract.clock_offset import ClockOffset
from bus.instants import monotonic_now, unix_now
from bus.worker.outbox import Outbox
from bus.worker.uplink import Uplink
from tests.app.stage import hello
from tests.bus.fake_app import TOKEN, FakeApp
from tests.bus.test_uplink import FakeReceiver


async def test_a_server_that_names_itself_as_the_home_gets_no_token() -> None:
    """An attacker at one address of a worker could else lead it, and its token, anywhere."""
    with capture_logs() as logs:
        async with FakeApp() as first, FakeApp() as stranger:
            first.refuses, first.home = "not here", stranger.url
            uplink = Uplink([first.url], TOKEN, Outbox(), FakeReceiver(), ClockOffset(), unix_now)
            for _ in range(3):
                assert await uplink._attempt()
            assert stranger.messages == []
    assert f"its home is {stranger.url}" in logs[0]["why"]


@pytest.mark.parametrize("above", [1, 10**9])
async def test_a_worker_that_makes_up_an_epoch_uses_none_up(above: int) -> None:
    """Epochs end at 2 to the power of 53: a worker must not bring a bus there."""
    homes = Homes("a", "http://a", is_shared=True)
    homes.hold("dry-end", Lease(7, monotonic_now()))
    assert not await homes.outnumber("dry-end", 7 + MAX_EPOCHS_MISSED + above)
    assert homes.epoch("dry-end") == 7
    assert not homes.outnumbered


@pytest.mark.parametrize("epoch", [-1, MAX_EPOCH + 1, 2**63])
def test_an_epoch_outside_its_bounds_makes_no_hello(epoch: int) -> None:
    with pytest.raises(MalformedMessageError):
        decode_from_worker(encode(Hello(5, "b", "w", hello().sent_at, "s", "p", hello().sent_at, epoch)))
