"""What may go wrong between a line and its broker: said in words, limited, and nothing is lost or doubled."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from app.line.history.service import History
from app.system.mqtt import session
from bus.contract import Reading
from tests.app.broker import Relay, listening, running
from tests.app.fake_worker import PlayedWorker, reading, until
from tests.app.sparkplug import Host
from tests.app.system.test_mqtt_broker import as_received, node_of, site

UNITS = (1, 2, 16)


@pytest.fixture(autouse=True)
def _soon_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "RETRY_S", (0.2,))


async def feed(worker: PlayedWorker, sent: list[Reading], rounds: int) -> None:
    """Let every unit respond some times, each with another speed than before."""
    for _ in range(rounds):
        for unit in UNITS:
            sent.append(reading(unit, actual=1001 + len(sent)))
            await worker.update(sent[-1])
            await asyncio.sleep(0.01)


def received(host: Host, unit: int) -> list[tuple[int, object]]:
    """The speeds of a unit that a host was given, by their time."""
    return sorted((at, value) for at, value, _ in host.readings[f"Unit {unit}", "Speed/Actual"])


async def test_each_reading_comes_once_over_losses(tmp_path: Path) -> None:
    """It is in order too: what was missed, and what is of the present."""
    host = Host("dry-end", "Mill 7")
    async with running(tmp_path) as broker, listening(broker, host):
        relay = Relay(broker)
        async with relay.running(), site(tmp_path / "site", relay) as house:
            worker = await house.worker()
            await until(lambda: len(host.values) == 3, "every unit is born")
            first = {unit: received(host, unit) for unit in UNITS}
            sent: list[Reading] = []
            for births in range(2, 5):
                await feed(worker, sent, 10)
                # What is on its way in the moment of the loss may come twice: nothing is.
                newest = (sent[-1].actual or 0) / 10
                await until(
                    lambda newest=newest: host.values["Unit 16"]["Speed/Actual"] == newest, "received"
                )
                await asyncio.sleep(0.2)
                relay.cut()
                await until(lambda: node_of(house).status.fault is not None, "the connection is lost")
                await feed(worker, sent, 10)
                await until(lambda: house.services[History].status.waiting == 0, "stored")
                await until(lambda births=births: host.births >= births, "it is born again")
            await feed(worker, sent, 10)
            expected = {unit: [as_received(each) for each in sent if each.unit == unit] for unit in UNITS}
            for unit in UNITS:
                await until(
                    lambda unit=unit: len(received(host, unit)) >= len(expected[unit]) + len(first[unit]),
                    "all is received",
                )
            await asyncio.sleep(1.2)
    for unit in UNITS:
        assert received(host, unit) == first[unit] + expected[unit]
        for is_old in (True, False):
            times = [at for at, _, old in host.readings[f"Unit {unit}", "Speed/Actual"] if old is is_old]
            assert times == sorted(times)
    assert host.faults == []
